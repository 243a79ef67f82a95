#!/usr/bin/env python3
"""How long rclpy takes to find a node, from the start of its process.

usage: discovery.py EXECUTABLE RUNS    EXECUTABLE: rolling_ball_analysis
Prints one JSON object: seconds of every run until the node is in the graph, its subscription matched, its latched status heard.
"""

import json
import os
import signal
import subprocess
import sys
import time

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile

from patchmill_msgs.msg import Job, StageStatus

NAME = "rolling_ball_analysis"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def run(node, jobs, executable, times):
    heard = []
    status = node.create_subscription(StageStatus, f"/patchmill/{NAME}/status", lambda _: heard.append(time.monotonic()), LATCHED)
    began = time.monotonic()
    process = subprocess.Popen([executable], stderr=subprocess.DEVNULL)
    first = {}
    while len(first) < 3:
        if time.monotonic() - began > 60:
            raise TimeoutError(f"only {sorted(first)} within a minute")
        rclpy.spin_once(node, timeout_sec=0.002)
        now = time.monotonic()
        if NAME in node.get_node_names():
            first.setdefault("graph", now)
        if jobs.get_subscription_count() > 0:
            first.setdefault("matched", now)
        if heard:
            first.setdefault("heard", heard[0])
    for key, at in first.items():
        times[key].append(at - began)
    process.send_signal(signal.SIGTERM)
    process.wait(20)
    node.destroy_subscription(status)
    while NAME in node.get_node_names() or jobs.get_subscription_count() > 0:
        rclpy.spin_once(node, timeout_sec=0.01)
        if time.monotonic() - began > 120:
            raise TimeoutError("the node stays in the graph after its end")


def main():
    rclpy.init()
    node = rclpy.create_node("discovery_observer")
    jobs = node.create_publisher(Job, "/patchmill/job", LATCHED)
    times = {"graph": [], "matched": [], "heard": []}
    for _ in range(int(sys.argv[2])):
        run(node, jobs, sys.argv[1], times)
    print(json.dumps(times))
    sys.stdout.flush()
    # The interpreter's own way out takes rclpy's threads down in no set order.
    os._exit(0)


if __name__ == "__main__":
    main()
