#!/usr/bin/env python3
"""A workcell's side, by rclpy: plans a surface with a running patchmill stack, gathers the program as one joint trajectory, and hands it to
ros2_control's joint trajectory controller.

usage: workcell.py SURFACE [--namespace /patchmill] [--controller /joint_trajectory_controller] [--patches N]
SURFACE: a file inside the directory that surface_ingestion loads from. Needs patchmill_msgs (see workcell.md).
"""

import argparse
import math
import sys

import rclpy
from action_msgs.msg import GoalStatus
from patchmill_msgs.action import PlanSurface
from patchmill_msgs.msg import Job, TrajectoryManifest
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from trajectory_msgs.msg import JointTrajectory


def the_job(patches: int) -> Job:
    """What to make, in SI units. Every field has to be set: the comments of Job.msg say what they are."""
    job = Job()
    job.tool.r1, job.tool.r2, job.tool.length = 13.05e-3, 6e-3, 0.1
    job.scallop_height, job.gouge_tolerance = 0.0254e-3, 0.005e-3
    job.lead_min, job.inclination_max = math.radians(5), math.radians(75)
    job.pass_chord, job.clearance = 1e-6, 10e-3
    job.feed, job.spindle_speed = 2.0 / 60, 6000 * math.tau / 60
    job.patches_min, job.patches_max = 1, patches
    job.strategy = Job.STRATEGY_FASTEST
    job.acceleration_linear, job.acceleration_rotary = 5.0, 20.0
    job.lead_radius, job.path_tolerance = 2e-3, 0.002e-3
    return job


class Workcell(Node):
    """Asks for plans, listens to trajectories, commands the controller."""

    def __init__(self, namespace: str, controller: str):
        super().__init__("workcell")
        latched = lambda depth: QoSProfile(
            depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        self.parts: list[JointTrajectory] = []
        self.manifests: list[TrajectoryManifest] = []
        self.planner = ActionClient(self, PlanSurface, f"{namespace}/plan_surface")
        # A program comes in parts of at most 60 KiB; a late joiner gets those of the newest program only.
        self.create_subscription(JointTrajectory, f"{namespace}/machine/trajectory", self.take_part, latched(1000))
        self.create_subscription(TrajectoryManifest, f"{namespace}/machine/joint_trajectory", self.manifests.append, latched(16))
        self.controller = self.create_publisher(JointTrajectory, f"{controller}/joint_trajectory", 1)

    def take_part(self, part: JointTrajectory) -> None:
        start = part.points[0].time_from_start
        if start.sec == 0 and start.nanosec == 0:
            self.parts.clear()
        self.parts.append(part)

    def until(self, what: str, condition, seconds: float):
        """Spins until the condition holds."""
        end = self.get_clock().now().nanoseconds + seconds * 1e9
        while not (value := condition()):
            if self.get_clock().now().nanoseconds > end:
                raise SystemExit(f"{what}: not within {seconds} s")
            rclpy.spin_once(self, timeout_sec=0.05)
        return value

    def done(self, future, what: str, seconds: float):
        self.until(what, future.done, seconds)
        return future.result()

    def plan(self, surface: str, patches: int):
        """The result of a goal, with the feedback printed."""
        if not self.planner.wait_for_server(timeout_sec=60.0):
            raise SystemExit("there is no planner: is the stack up, on this ROS_DOMAIN_ID?")
        show = lambda m: print(f"  {m.feedback.stage} {m.feedback.fraction:.0%} {m.feedback.text}", flush=True)
        goal = PlanSurface.Goal(path=surface, job=the_job(patches))
        handle = self.done(self.planner.send_goal_async(goal, feedback_callback=show), "an answer to the goal", 60.0)
        if not handle.accepted:
            raise SystemExit("the goal was rejected")
        answer = self.done(handle.get_result_async(), "the plan", 600.0)
        if answer.status != GoalStatus.STATUS_SUCCEEDED:
            raise SystemExit(f"no plan: {answer.result.text} (code {answer.result.code}, stage {answer.result.stage})")
        return answer.result

    def trajectory(self, stamp) -> JointTrajectory:
        """All parts of the program with that stamp, as one message."""
        manifest = self.until(
            "the trajectory's manifest", lambda: next((m for m in self.manifests if m.header.stamp == stamp), None), 60.0
        )
        self.until("the trajectory", lambda: sum(len(p.points) for p in self.parts) == manifest.point_count, 60.0)
        whole = JointTrajectory(joint_names=self.parts[0].joint_names)
        whole.points = [point for part in self.parts for point in part.points]
        return whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surface")
    parser.add_argument("--namespace", default="/patchmill")
    parser.add_argument("--controller", default="/joint_trajectory_controller")
    parser.add_argument("--patches", type=int, default=4)
    arguments = parser.parse_args()
    rclpy.init()
    cell = Workcell(arguments.namespace, arguments.controller)
    plan = cell.plan(arguments.surface, arguments.patches)
    print(plan.text, f"largest gouge {plan.program.proof.gouge_max * 1e6:.1f} µm", sep="\n")
    trajectory = cell.trajectory(plan.program.header.stamp)
    last = trajectory.points[-1].time_from_start
    cell.until("a joint trajectory controller", lambda: cell.controller.get_subscription_count() > 0, 60.0)
    cell.controller.publish(trajectory)
    # Published is not yet sent: leaving at once would take it along.
    if not cell.controller.wait_for_all_acked(rclpy.duration.Duration(seconds=10)):
        raise SystemExit("the controller did not take the trajectory within 10 s")
    print(f"sent {len(trajectory.points)} points of {', '.join(trajectory.joint_names)}, {last.sec + last.nanosec * 1e-9:.1f} s")
    rclpy.shutdown()


if __name__ == "__main__":
    sys.exit(main())
