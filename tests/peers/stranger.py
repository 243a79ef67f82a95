"""A participant without keys (rclpy's Fast DDS from PyPI is built without DDS Security): what it sees of a stack, and whether it is heard.

usage: stranger.py PATIENCE    says `ready` when it listens; on a line on stdin (or its end) waits for a message of each topic, then tries to
be heard in three ways, each at most PATIENCE s, and prints as one JSON document what it saw and who answered
"""

import json
import sys
import time

from patchmill_msgs.action import PlanSurface
from patchmill_msgs.msg import Job, MeshManifest, ProgramManifest, StageStatus
from patchmill_msgs.srv import LoadSurface
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rcl_interfaces.msg import Log

from drive import STAGES, job, plan
from ros2_client import Peer, latched, run, say

WATCHED = [("job", Job), ("surface/mesh", MeshManifest), ("machine/program", ProgramManifest)] + [
    (f"{stage}/status", StageStatus) for stage in STAGES
]
# For each thing that might happen, s: as long as it takes where it has to, some seconds where it must not.
PATIENCE = float(sys.argv[1])


def within(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


def others(peer, topic):
    """Ends of a topic that are not the stranger's own."""
    ends = peer.node.get_publishers_info_by_topic(topic) + peer.node.get_subscriptions_info_by_topic(topic)
    return [end for end in ends if end.node_name != "stranger"]


def loaded(peer):
    client = peer.node.create_client(LoadSurface, peer.full("surface_ingestion/load_surface"))
    if not client.wait_for_service(PATIENCE):
        return False
    answer = client.call_async(LoadSurface.Request(path="surface_3.json"))
    return within(answer.done) and answer.result().code == 0


def goal_taken(peer):
    client = ActionClient(peer.node, PlanSurface, peer.full("plan_surface"))
    if not client.wait_for_server(PATIENCE):
        return False
    sent = client.send_goal_async(plan("surface_3.json", 1))
    return within(sent.done) and sent.result().accepted


def job_told(peer):
    """Publishes a job under a name of its own; whether anybody of the stack listens is found in the stack's bag."""
    publisher = peer.node.create_publisher(Job, peer.full("job"), latched())
    message = job(1)
    message.job_id = "stranger"
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        publisher.publish(message)
        if publisher.get_subscription_count() > 1:
            # Itself and somebody else: given time to arrive.
            publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
            return True
        time.sleep(0.1)
    return False


def main():
    peer = Peer("stranger")
    watched = {topic: peer.collect(kind, topic, latched()) for topic, kind in WATCHED}
    watched["/rosout"] = peer.collect(Log, "/rosout", latched(100))
    say("ready")
    sys.stdin.readline()
    within(lambda: all(messages for messages, _ in watched.values()))
    seen = {topic: len(messages) for topic, (messages, _) in watched.items()}
    answered = {"job": job_told(peer), "load_surface": loaded(peer), "plan_surface": goal_taken(peer)}
    topics = [peer.full(topic) for topic, _ in WATCHED]
    nodes = sorted(name for name, namespace in peer.node.get_node_names_and_namespaces() if name != "stranger")
    say(
        json.dumps(
            {
                "messages": seen,
                "ends": sum(len(others(peer, topic)) for topic in topics),
                "nodes": nodes,
                "answered": answered,
            }
        )
    )


run(main)
