"""A node started with every ROS argument, as rclpy sees it: renamed, in another namespace, a topic remapped, parameters from a
file and the command line (which wins), info lines switched off.

usage: arguments.py     (the test starts surface_ingestion as /line/loader)
"""

import time

from patchmill_msgs.msg import MeshManifest
from patchmill_msgs.srv import LoadSurface
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters

from ros2_client import Peer, check, latched, run, say


def main():
    peer = Peer("arguments", "/line")
    peer.wait("/line/loader", lambda: ("loader", "/line") in peer.node.get_node_names_and_namespaces())
    names = ["samples_per_side", "max_triangles", "chord_tolerance_mm"]
    values = peer.call(GetParameters, "loader/get_parameters", GetParameters.Request(names=names)).values
    found = (values[0].integer_value, values[1].integer_value, values[2].double_value)
    check(found == (12, 5000, 0.002), f"parameters are {found}")
    lines, _ = peer.collect(Log, "/rosout", latched(100))
    meshes, _ = peer.collect(MeshManifest, "/shared/mesh", latched())
    own, _ = peer.collect(MeshManifest, "surface/mesh", latched())
    surface = '{"kind":"algebraic","expression":"x*x/400","x":[0,30],"y":[0,20]}'
    answer = peer.call(LoadSurface, "surface_ingestion/load_surface", LoadSurface.Request(inline_json=surface))
    check(answer.code == 0 and answer.sample_count == 144, f"{answer.code} {answer.text}, {answer.sample_count} samples")
    peer.wait("the mesh under its new name", lambda: meshes)
    bad = peer.call(LoadSurface, "surface_ingestion/load_surface", LoadSurface.Request(inline_json=surface, samples_per_side=900000))
    check(bad.code // 100 == 1, f"a grid of 900000 samples a side gave {bad.code} '{bad.text}'")
    time.sleep(0.5)
    check(not own, "the mesh also came under its old name")
    check(not [line for line in lines if line.name.endswith("loader") and line.level <= 20], "info lines came at --log-level warn")
    say(f"arguments: /line/loader with {dict(zip(names, found))}, mesh on /shared/mesh, no info lines")


run(main)
