"""Asks a node once from each of many fresh participants: the answer to a client's first call arrives, though the server may learn
of the client's reader later than of its writer."""

import sys

import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from ros2_client import check, run, say

PATIENCE = 60.0


def first_call(number, service):
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node(f"first_call_{number}", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    client = node.create_client(ListParameters, service)
    check(client.wait_for_service(PATIENCE), f"service {service} is not there")
    future = client.call_async(ListParameters.Request())
    executor.spin_until_future_complete(future, timeout_sec=PATIENCE)
    check(future.done(), f"the first call of client {number} was not answered within {PATIENCE} s")
    check(future.result().result.names, "a node without parameters")
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)


def main():
    service, clients = sys.argv[1], int(sys.argv[2])
    for number in range(clients):
        first_call(number, service)
    say(f"{clients} clients, each asked once, all answered")


run(main)
