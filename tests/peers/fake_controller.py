"""Plays ros2_control's joint trajectory controller as far as it takes a trajectory from its topic: one that breaks the controller's
rules is refused with the reason (exit 1). After the first good one it stays until whoever sent it has left, as a controller would:
gone at once, it may take its acknowledgement along, and the sender waits for that.

usage: fake_controller.py
"""

from trajectory_msgs.msg import JointTrajectory

from ros2_client import Peer, check, reliable, run, say

JOINTS = ["x", "y", "z", "a", "c"]
TOPIC = "/joint_trajectory_controller/joint_trajectory"


def seconds(point):
    return point.time_from_start.sec + point.time_from_start.nanosec * 1e-9


def validate(trajectory):
    """The rules of JointTrajectoryController::validate_trajectory_msg with its default parameters."""
    check(sorted(trajectory.joint_names) == sorted(JOINTS), f"joints {trajectory.joint_names}, the controller has {JOINTS}")
    check(trajectory.points, "there are no points")
    stamp = trajectory.header.stamp
    check((stamp.sec, stamp.nanosec) == (0, 0), "a start time that has passed already")
    times = [seconds(point) for point in trajectory.points]
    check(all(a < b for a, b in zip(times, times[1:])), "times do not increase")
    for point in trajectory.points:
        check(len(point.positions) == len(point.velocities) == len(JOINTS), "positions or velocities of other joints")
        check(not point.effort, "efforts are not taken")
    check(all(v == 0.0 for v in trajectory.points[-1].velocities), "the last point does not stand still")
    return times[-1]


def main():
    peer = Peer("joint_trajectory_controller")
    taken, _ = peer.collect(JointTrajectory, TOPIC, reliable(10))
    trajectory = peer.wait("a trajectory", lambda: taken and taken[0], 120.0)
    say(f"taken: {len(trajectory.points)} points, {validate(trajectory):.1f} s")
    peer.wait("the sender's leave", lambda: not peer.node.count_publishers(TOPIC))
    peer.close()


run(main)
