"""Drives the stack by rclpy as a workcell would: load_surface, goals with feedback, cancel in mid-planning, a whole plan, a
late joiner's view of every latched product and its chunks by service.

usage: drive.py SURFACE BIG_SURFACE PROGRAM    PROGRAM: program.ngc of the same plan by `patchmill plan`, for comparison
(both surfaces inside surface_ingestion's directory; BIG_SURFACE takes some seconds to plan)
"""

import hashlib
import math
import os
import sys
import time

from action_msgs.msg import GoalStatus
from patchmill_msgs.action import PlanSurface
from patchmill_msgs.msg import (
    Evaluation,
    Job,
    MeshManifest,
    PartitionCandidate,
    ProgramManifest,
    ResidualMapManifest,
    RollingBallFieldManifest,
    SamplesManifest,
    StageStatus,
    ToolpathManifest,
    TrajectoryManifest,
)
from patchmill_msgs.srv import (
    GetFieldChunk,
    GetMeshChunk,
    GetProgramChunk,
    GetResidualChunk,
    GetSamplesChunk,
    GetToolpathChunk,
    GetTrajectoryChunk,
    LoadSurface,
)

from ros2_client import Peer, check, latched, run, say

STAGES = ["surface_ingestion", "rolling_ball_analysis", "surface_partitioning", "path_generation", "machine_interface"]


def job(patches_max):
    job = Job()
    # As the command line of `patchmill plan` converts its defaults, to the last bit.
    job.tool.r1, job.tool.r2, job.tool.length = 13.05 / 1e3, 6 / 1e3, 100 / 1e3
    job.scallop_height, job.gouge_tolerance = 0.0254 / 1e3, 0.005 / 1e3
    job.lead_min, job.inclination_max = math.radians(5), math.radians(75)
    job.pass_chord, job.clearance = 1e-6, 10e-3
    job.feed, job.spindle_speed = 2000 / 60e3, 6000 * math.tau / 60
    job.patches_min, job.patches_max = 1, patches_max
    job.acceleration_linear, job.acceleration_rotary = 5.0, 20.0
    job.lead_radius, job.path_tolerance = 2 / 1e3, 0.002 / 1e3
    return job


def plan(path, patches_max):
    goal = PlanSurface.Goal()
    goal.path, goal.job = path, job(patches_max)
    return goal


def load(peer, surface):
    answer = peer.call(LoadSurface, "surface_ingestion/load_surface", LoadSurface.Request(path=surface))
    check(answer.code == 0 and answer.triangle_count > 0, f"load_surface: {answer.text}")
    say(f"load_surface: {answer.text}")
    bad = peer.call(LoadSurface, "surface_ingestion/load_surface", LoadSurface.Request(path="no_such_file.stl"))
    check(bad.code // 100 == 1 and "no_such_file" in bad.text, f"a missing file gave {bad.code} '{bad.text}'")
    return answer.surface_id


def processor_seconds():
    """Of the stages' processes, given by PATCHMILL_PIDS."""
    total = 0
    for pid in os.environ["PATCHMILL_PIDS"].split(","):
        with open(f"/proc/{pid}/stat", encoding="ascii") as stat:
            fields = stat.read().rsplit(")", 1)[1].split()
        total += int(fields[11]) + int(fields[12])
    return total / os.sysconf("SC_CLK_TCK")


def cancel(peer, surface):
    """A goal cancelled while stages work: CANCELED within a second, the stages idle, no more processor time."""
    statuses = {}
    subscriptions = [
        peer.node.create_subscription(
            StageStatus, peer.full(f"{stage}/status"), lambda m: statuses.__setitem__(m.node, m), latched(1)
        )
        for stage in STAGES
    ]
    feedback = []
    handle = peer.accepted(PlanSurface, "plan_surface", plan(surface, 8), lambda m: feedback.append(m.feedback))
    peer.wait("feedback of path_generation", lambda: any(f.stage == "path_generation" for f in feedback))
    began = time.monotonic()
    answer = peer.cancel(handle)
    check(len(answer.goals_canceling) == 1, "the cancel was not accepted")
    end = peer.result(handle, "result of the cancelled goal")
    check(end.status == GoalStatus.STATUS_CANCELED and end.result.code == 605, f"ended {end.status} {end.result.text}")
    idle = lambda: all(statuses.get(s) and statuses[s].state == StageStatus.IDLE for s in STAGES[1:])
    peer.wait("idle stages", idle)
    took = time.monotonic() - began
    time.sleep(max(0.0, began + 1.0 - time.monotonic()))
    before = processor_seconds()
    time.sleep(2.0)
    used = processor_seconds() - before
    say(f"cancel: {len(feedback)} feedbacks, idle {took:.3f} s after the cancel, {used:.2f} s of processor in 2 s from 1 s on")
    check(used < 0.5, f"the stages went on working after the cancel: {used} s of processor time in 2 s")
    for subscription in subscriptions:
        peer.node.destroy_subscription(subscription)


def whole(peer, surface):
    feedback = []
    began = time.monotonic()
    handle = peer.accepted(PlanSurface, "plan_surface", plan(surface, 3), lambda m: feedback.append(m.feedback))
    end = peer.result(handle, "result")
    took = time.monotonic() - began
    result = end.result
    check(end.status == GoalStatus.STATUS_SUCCEEDED and result.code == 0, f"{end.status} {result.code} {result.text}")
    check({f.stage for f in feedback} >= set(STAGES), f"feedback came from {({f.stage for f in feedback})} only")
    check(len(result.evaluation.candidates) == 3, "the result has not all candidates")
    check(result.program.proof is not None and result.program.machining_time > 0.0, "the result has no program")
    say(f"plan_surface: {result.text}, {len(feedback)} feedbacks, {took:.2f} s")
    return result


def rejected(peer, surface):
    goal = plan(surface, 3)
    goal.job.scallop_height = -1.0
    handle = peer.goal(PlanSurface, "plan_surface", goal, lambda _: None)
    check(not handle.accepted, "a goal with a negative scallop height was accepted")
    goal = plan("no_such_file.json", 3)
    handle = peer.accepted(PlanSurface, "plan_surface", goal, lambda _: None)
    end = peer.result(handle, "result of a missing file")
    check(end.status == GoalStatus.STATUS_ABORTED and end.result.stage == "surface_ingestion", "a missing file was not refused")
    say(f"bad goals: rejected; aborted with {end.result.code} '{end.result.text}'")


LARGE = [
    # manifest topic, manifest type, chunk service, service type, whether by candidate, what a chunk holds
    ("surface/mesh", MeshManifest, "surface_ingestion/get_mesh_chunk", GetMeshChunk, False,
     lambda m, c: sum(len(x.triangles) for x in c) == m.triangle_count),
    ("surface/samples", SamplesManifest, "surface_ingestion/get_samples_chunk", GetSamplesChunk, False, None),
    ("analysis/rolling_ball_field", RollingBallFieldManifest, "rolling_ball_analysis/get_field_chunk", GetFieldChunk, False, None),
    ("toolpath/candidates", ToolpathManifest, "path_generation/get_toolpath_chunk", GetToolpathChunk, True, None),
    ("machine/program", ProgramManifest, "machine_interface/get_program_chunk", GetProgramChunk, False, None),
    ("machine/joint_trajectory", TrajectoryManifest, "machine_interface/get_trajectory_chunk", GetTrajectoryChunk, False,
     lambda m, c: sum(len(x.trajectory.points) for x in c) == m.point_count),
    ("machine/residual_map", ResidualMapManifest, "machine_interface/get_residual_chunk", GetResidualChunk, False,
     lambda m, c: max(max(x.leftover) for x in c) == m.leftover_max and sum(len(x.points) for x in c) == m.point_count),
]


def late_joiner(result):
    """A subscriber that comes when all is over gets every latched product, and every chunk by service."""
    peer = Peer("late_joiner")
    count = 0
    for topic, kind, service, service_kind, by_candidate, holds in LARGE:
        wanted = 3 if by_candidate else 1
        of_plan = lambda m: m.surface_id == result.surface_id and getattr(m, "job_id", result.job_id) in ("", result.job_id)
        messages, _ = peer.collect(kind, topic, latched())
        peer.wait(f"manifests on {topic}", lambda: len([m for m in messages if of_plan(m)]) >= wanted)
        for manifest in [m for m in messages if of_plan(m)][-wanted:]:
            chunks = []
            for index in range(manifest.chunk_count):
                request = service_kind.Request(index=index)
                request.id = result.surface_id if topic.startswith("surface/") else result.job_id
                if by_candidate:
                    request.candidate_index = manifest.candidate_index
                answer = peer.call(service_kind, service, request)
                check(answer.code == 0 and answer.chunk.index == index, f"{service} {index}: {answer.text}")
                chunks.append(answer.chunk)
            check(holds is None or holds(manifest, chunks), f"{topic}: the chunks do not hold what the manifest says")
            count += len(chunks)
            if topic == "machine/program":
                program = "".join(chunk.text for chunk in chunks)
                check(hashlib.sha256(program.encode()).hexdigest() == manifest.content_hash, "the program's hash differs")
            if topic == "machine/residual_map":
                deepest, highest = (max(0.0, -manifest.leftover_min), manifest.leftover_max)
                proof = result.program.proof
                check((deepest, highest) == (proof.gouge_max, proof.scallop_max), "the map is not the proof's")
            if topic == "machine/joint_trajectory":
                times = [p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for c in chunks for p in c.trajectory.points]
                check(all(a < b for a, b in zip(times, times[1:])), "trajectory times do not increase")
    for topic, kind, wanted in [("partition/candidates", PartitionCandidate, 3), ("machine/evaluation", Evaluation, 1), ("job", Job, 1)]:
        messages, _ = peer.collect(kind, topic, latched())
        peer.wait(f"messages on {topic}", lambda: len([m for m in messages if m.job_id == result.job_id]) >= wanted)
    say(f"late joiner: every latched product, {count} chunks by service")
    peer.close()
    return program


def main():
    surface, big, reference = sys.argv[1:]
    peer = Peer("drive")
    surface_id = load(peer, surface)
    rejected(peer, surface)
    cancel(peer, big)
    result = whole(peer, surface)
    check(result.surface_id == surface_id, "the plan's surface is not the loaded one")
    program = late_joiner(result)
    with open(reference, encoding="utf-8") as text:
        check(text.read() == program, "the program differs from that of `patchmill plan`")
    say("the program is byte for byte that of `patchmill plan`")
    peer.close()


if __name__ == "__main__":
    run(main)
