"""Two stacks in two namespaces of one domain plan different parts at once; neither sees the other's messages.

usage: two_stacks.py NAMESPACE SURFACE NAMESPACE SURFACE
"""

import sys

from action_msgs.msg import GoalStatus
from patchmill_msgs.action import PlanSurface
from patchmill_msgs.msg import Evaluation, MeshManifest, PartitionCandidate, ProgramManifest, ToolpathManifest

from drive import plan
from ros2_client import Peer, check, latched, run, say

WATCHED = [
    ("surface/mesh", MeshManifest),
    ("partition/candidates", PartitionCandidate),
    ("toolpath/candidates", ToolpathManifest),
    ("machine/evaluation", Evaluation),
    ("machine/program", ProgramManifest),
]


def main():
    cells = [(sys.argv[1], sys.argv[2]), (sys.argv[3], sys.argv[4])]
    peers, messages, handles, running, together = [], [], [], set(), []
    for place, (namespace, surface) in enumerate(cells):
        peer = Peer(f"cell_{place}", namespace)
        peers.append(peer)
        messages.append([peer.collect(kind, topic, latched())[0] for topic, kind in WATCHED])

        def feedback(_, place=place):
            running.add(place)
            together.append(len(running))

        handles.append(peer.accepted(PlanSurface, "plan_surface", plan(surface, 3), feedback))
    results = []
    for peer, handle, (namespace, surface) in zip(peers, handles, cells):
        end = peer.result(handle, f"result of {namespace}")
        check(end.status == GoalStatus.STATUS_SUCCEEDED, f"{namespace}: {end.result.text}")
        say(f"{namespace}: {surface}: {end.result.text}")
        results.append(end.result)
    check(2 in together, "the two goals did not run at the same time")
    check(results[0].surface_id != results[1].surface_id, "both planned the same surface")
    for peer, lists, result, (namespace, _) in zip(peers, messages, results, cells):
        peer.wait(f"the products of {namespace}", lambda lists=lists: all(lists))
        for (topic, _), received in zip(WATCHED, lists):
            foreign = {m.surface_id for m in received} - {result.surface_id}
            check(not foreign, f"{namespace}/{topic} carried the surface of another stack")
    say("neither stack saw a message of the other")


run(main)
