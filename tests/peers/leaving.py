"""A node that ends is gone for rclpy at once, with its topics, not only when its lease of 50 s has run out.

usage: leaving.py EXECUTABLE    of a node that listens to `job`; it is started and ended (SIGTERM)
"""

import signal
import subprocess
import sys
import time

import rclpy

from ros2_client import check, run, say

PATIENCE = 20.0
# From the end of the process.
AT_ONCE = 5.0


def seen(node):
    return node.count_subscribers("/patchmill/job"), node.count_publishers("/diagnostics")


def until(node, wanted, patience):
    end = time.monotonic() + patience
    while not wanted(seen(node)) and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.05)
    return wanted(seen(node))


def main():
    node = rclpy.create_node("observer")
    process = subprocess.Popen([sys.argv[1]], stderr=subprocess.DEVNULL)
    try:
        check(until(node, all, PATIENCE), f"{sys.argv[1]} does not show up: {seen(node)}")
        process.send_signal(signal.SIGTERM)
        process.wait(PATIENCE)
        check(until(node, lambda ends: not any(ends), AT_ONCE), f"{AT_ONCE} s after its end there are still {seen(node)}")
    finally:
        process.kill()
    say("gone at once")


run(main)
