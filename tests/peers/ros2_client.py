"""What the rclpy peers share: a node that spins in a thread, calls, waiting for messages, goals. Everything is asked once, as
anybody's rclpy node does."""

import os
import sys
import threading
import time
import traceback

import rclpy
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
        self._actions = {}

    def _spin(self):
        try:
            self.executor.spin()
        except Exception as error:  # noqa: BLE001 (the executor ends with the context)
            if rclpy.ok():
                print(f"executor: {error!r}", file=sys.stderr)

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
        """Calls a service, once."""
        name = self.full(name)
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        check(client.wait_for_service(patience), f"service {name} is not there")
        return self.answer(client.call_async(request), f"answer of {name}", patience)

    def goal(self, kind, name, goal, feedback):
        """Sends a goal; the handle, accepted or not."""
        # One for all goals: a new one's feedback may come before the two have met.
        if name not in self._actions:
            self._actions[name] = ActionClient(self.node, kind, self.full(name))
        client = self._actions[name]
        check(client.wait_for_server(PATIENCE), f"action {name} is not there")
        sent = client.send_goal_async(goal, feedback_callback=feedback)
        return self.answer(sent, f"answer to a goal of {name}", PATIENCE)

    def accepted(self, kind, name, goal, feedback):
        handle = self.goal(kind, name, goal, feedback)
        check(handle.accepted, f"a goal of {name} was rejected")
        return handle

    def cancel(self, handle):
        return self.answer(handle.cancel_goal_async(), "answer to the cancel", PATIENCE)

    def result(self, handle, what, patience=120.0):
        """The end of a goal."""
        return self.answer(handle.get_result_async(), what, patience)

    def answer(self, future, what, patience):
        end = time.monotonic() + patience
        while not future.done():
            check(time.monotonic() < end, f"{what}: not within {patience} s")
            time.sleep(0.005)
        return future.result()

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
