"""What the rclpy peers share: a node that spins in a thread, calls that repeat (a first call to a Rust service can be lost),
waiting for messages, goals."""

import os
import sys
import threading
import time
import traceback
import uuid

import rclpy
from unique_identifier_msgs.msg import UUID
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

PATIENCE = 60.0


def latched(depth=16):
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def reliable(depth=200):
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)


def check(condition, text):
    if not condition:
        raise SystemExit(f"FAILED: {text}")


def say(text):
    print(text, flush=True)


class Peer:
    """An rclpy node with its executor in a thread."""

    def __init__(self, name, namespace="/patchmill"):
        self.namespace = namespace
        self.node = rclpy.create_node(name)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self._spin, daemon=True)
        self.thread.start()
        self._clients = {}
        self._actions = []

    def _spin(self):
        spinning = True
        while spinning:
            spinning = False
            try:
                self.executor.spin()
            except Exception as error:  # noqa: BLE001 (the executor ends with the context)
                if rclpy.ok():
                    print(f"executor: {error!r}", file=sys.stderr)
                    # Seen once: the answer to a goal came twice. rclpy raises for the second one and would never spin again;
                    # the first one stands.
                    spinning = "accepted with the same ID" in str(error)

    def full(self, name):
        return name if name.startswith("/") else f"{self.namespace}/{name}"

    def wait(self, what, condition, patience=PATIENCE):
        end = time.monotonic() + patience
        while True:
            value = condition()
            if value:
                return value
            check(time.monotonic() < end, f"{what}: not within {patience} s")
            time.sleep(0.02)

    def collect(self, kind, topic, qos):
        """Messages of a topic as they come, in a list."""
        messages = []
        subscription = self.node.create_subscription(kind, self.full(topic), messages.append, qos)
        return messages, subscription

    def call(self, kind, name, request, patience=PATIENCE):
        """Calls a service, repeating the request every three seconds."""
        name = self.full(name)
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        check(client.wait_for_service(patience), f"service {name} is not there")
        end = time.monotonic() + patience
        while time.monotonic() < end:
            future = client.call_async(request)
            attempt = min(time.monotonic() + 3.0, end)
            while not future.done() and time.monotonic() < attempt:
                time.sleep(0.005)
            if future.done():
                return future.result()
            client.remove_pending_request(future)
        raise SystemExit(f"FAILED: no answer of {name} within {patience} s")

    def goal(self, kind, name, goal, feedback):
        """Sends a goal, repeating it with its id every three seconds; the handle, accepted or not."""
        client = ActionClient(self.node, kind, self.full(name))
        self._actions.append(client)
        check(client.wait_for_server(PATIENCE), f"action {name} is not there")
        goal_id = UUID(uuid=list(uuid.uuid4().bytes))
        send = lambda: client.send_goal_async(goal, feedback_callback=feedback, goal_uuid=goal_id)
        return self.repeated(send, f"answer to a goal of {name}", PATIENCE)

    def accepted(self, kind, name, goal, feedback):
        handle = self.goal(kind, name, goal, feedback)
        check(handle.accepted, f"a goal of {name} was rejected")
        return handle

    def cancel(self, handle):
        return self.repeated(handle.cancel_goal_async, "answer to the cancel", PATIENCE)

    def result(self, handle, what, patience=120.0):
        """The end of a goal; the question for it is repeated as well: the first can be lost."""
        return self.repeated(handle.get_result_async, what, patience)

    def repeated(self, ask, what, patience):
        """The first answer to any of the repetitions."""
        futures, end, again = [], time.monotonic() + patience, 0.0
        while True:
            now = time.monotonic()
            if now >= again:
                futures.append(ask())
                again = now + 3.0
            done = [future for future in futures if future.done()]
            if done:
                return done[0].result()
            check(now < end, f"{what}: not within {patience} s")
            time.sleep(0.005)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()


def run(main):
    """Runs a script; its executors' threads do not hold up the end."""
    rclpy.init()
    code = 0
    try:
        main()
    except SystemExit as error:
        print(error.code, file=sys.stderr, flush=True)
        code = 1
    except Exception:  # noqa: BLE001
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
