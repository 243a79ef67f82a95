"""Starts the nodes under ros2 launch: ros2 launch launch_scripts/bringup.launch.py [namespace:=/NAME] [params:=FILE] ...

The same nodes, names, parameters and remaps as bringup.sh, which explains the arguments; a test holds the two together. The nodes need no
ament package: they are started by their path. When a node ends with an error all are ended.
"""

import shutil
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

HERE = Path(__file__).resolve().parent
ARGUMENTS = [
    ("namespace", "/patchmill", "namespace of all nodes"),
    ("params", str(HERE / "config" / "patchmill.yaml"), "ROS 2 parameter file"),
    ("domain", "", "ROS domain; empty: ROS_DOMAIN_ID, else 0"),
    ("only", "", "start these nodes only, separated by commas"),
    ("without", "", "start all but these nodes, separated by commas"),
    ("remap", "", "FROM:=TO of topics, services or actions in all nodes, separated by spaces"),
    ("prefix", "", "folder of the executables; empty: target/release of this checkout, else PATH"),
]


def known_nodes():
    """The names in config/nodes.txt."""
    lines = (HERE / "config" / "nodes.txt").read_text(encoding="utf-8").split("\n")
    return [line for line in lines if line and not line.startswith("#")]


def chosen_nodes(only, without):
    """Names to start, in the order of nodes.txt."""
    only, without = ([name for name in text.split(",") if name] for text in (only, without))
    known = known_nodes()
    unknown = [name for name in only + without if name not in known]
    if unknown:
        raise RuntimeError(f"there is no node '{unknown[0]}': the nodes are {' '.join(known)}")
    return [name for name in known if (not only or name in only) and name not in without]


def find_executable(name, prefix):
    """Absolute path of an executable."""
    folders = [Path(prefix)] if prefix else [HERE.parent / "target" / "release"]
    for folder in folders:
        if (folder / name).is_file():
            return str((folder / name).resolve())
    found = None if prefix else shutil.which(name)
    if found is None:
        raise RuntimeError(f"there is no executable {name} in {folders[0]}{'' if prefix else ' or on PATH'}")
    return found


def on_exit(event, _context):
    """Ends all when a node ended with an error."""
    if event.returncode == 0:
        return []
    text = f"{event.process_name} ended with code {event.returncode}: ending all"
    return [LogInfo(msg=text), Shutdown(reason=text)]


def start_nodes(context):
    """The nodes as the launch arguments say."""
    value = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    environment = {"ROS_DOMAIN_ID": value["domain"]} if value["domain"] else {}
    remaps = [tuple(rule.split(":=", 1)) for rule in value["remap"].split()]
    return [
        Node(
            executable=find_executable(name, value["prefix"]),
            name=name,
            namespace=value["namespace"],
            parameters=[str(Path(value["params"]).resolve())],
            remappings=remaps,
            additional_env=environment,
            output="screen",
            on_exit=on_exit,
        )
        for name in chosen_nodes(value["only"], value["without"])
    ]


def generate_launch_description():
    """What ros2 launch asks for."""
    arguments = [DeclareLaunchArgument(name, default_value=default, description=text) for name, default, text in ARGUMENTS]
    return LaunchDescription([*arguments, OpaqueFunction(function=start_nodes)])
