"""Publishes a scan of a trough, z = x²/240 + y²/900 in mm over 36 × 36 mm, on surface_ingestion/points until it is killed: 20 164 points
on a grid within an organized cloud whose other points are NaN, as a depth camera gives it.

usage: cloud.py RELIABILITY WIDTH FRAME      RELIABILITY: reliable or best_effort; WIDTH: columns of the cloud, at least 142 (16 bytes a
point, 600 rows or, with 142 columns, 142)
"""

import sys
import time

import numpy
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2, PointField

from ros2_client import Peer, check, run, say

SIDE, HALF = 142, 0.018


def cloud(width, frame):
    height = SIDE if width == SIDE else 600
    points = numpy.full((height, width, 4), numpy.nan, "<f4")
    x, y = numpy.meshgrid(numpy.linspace(-HALF, HALF, SIDE), numpy.linspace(-HALF, HALF, SIDE), indexing="ij")
    z = x * x / 0.24 + y * y / 0.9
    points[-SIDE:, -SIDE:, :3] = numpy.stack([x, y, z], axis=2)
    message = PointCloud2(height=height, width=width, point_step=16, row_step=16 * width, is_dense=width == SIDE)
    message.header.frame_id = frame
    message.fields = [PointField(name=n, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, n in enumerate("xyz")]
    message.data = points.tobytes()
    return message


def main():
    reliability, width, frame = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    peer = Peer("scanner")
    qos = QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy[reliability.upper()])
    publisher = peer.node.create_publisher(PointCloud2, peer.full("surface_ingestion/points"), qos)
    message = cloud(width, frame)
    # A reliable publisher is heard by the reliable reader and the best-effort one, another by the latter alone.
    matched = 2 if reliability == "reliable" else 1
    peer.wait("surface_ingestion's readers", lambda: publisher.get_subscription_count() >= matched)
    check(publisher.get_subscription_count() == matched, f"{publisher.get_subscription_count()} readers")
    say(f"{len(message.data)} bytes, {reliability}")
    while True:
        message.header.stamp = peer.node.get_clock().now().to_msg()
        publisher.publish(message)
        time.sleep(0.5)


run(main)
