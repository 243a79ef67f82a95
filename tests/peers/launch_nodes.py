#!/usr/bin/env python3
"""Prints, as JSON, the nodes that a launch file would start.

usage: launch_nodes.py FILE.launch.py [name:=value ...]

The packages `launch` and `launch_ros` are not on PyPI, so this stands in for the few names of them that the file uses: it records the
arguments of Node(...) and refuses keywords that launch_ros's Node (Jazzy) does not take. That ros2 launch starts the nodes is not shown by
this; what it would start, by the file's own code, is.
"""

import importlib.util
import json
import sys
import types

NODE_KEYWORDS = {"package", "executable", "name", "namespace", "exec_name", "parameters", "remappings", "ros_arguments", "arguments"}
PROCESS_KEYWORDS = {"cwd", "env", "additional_env", "output", "output_format", "prefix", "shell", "sigterm_timeout", "sigkill_timeout",
                    "emulate_tty", "respawn", "respawn_delay", "on_exit", "condition"}


class Context:
    """Values of the launch arguments."""

    def __init__(self, given):
        self.values = given


class DeclareLaunchArgument:
    def __init__(self, name, *, default_value=None, description=None):
        if not description or default_value is None:
            raise ValueError(f"argument {name} has no default or description")
        self.name, self.default = name, default_value


class LaunchConfiguration:
    def __init__(self, name):
        self.name = name

    def perform(self, context):
        return context.values[self.name]


class OpaqueFunction:
    def __init__(self, *, function):
        self.function = function


class Node:
    def __init__(self, **keywords):
        unknown = set(keywords) - NODE_KEYWORDS - PROCESS_KEYWORDS
        if unknown or "executable" not in keywords:
            raise TypeError(f"Node with {sorted(keywords)}")
        self.keywords = keywords

    def described(self):
        k = self.keywords
        exits = [k["on_exit"](types.SimpleNamespace(returncode=code, process_name="n"), None) for code in (0, 1, -9)]
        return {
            "executable": k["executable"],
            "name": k["name"],
            "namespace": k["namespace"],
            "parameters": k["parameters"],
            "remappings": [f"{before}:={after}" for before, after in k["remappings"]],
            "environment": k["additional_env"],
            "shuts_down": [any(isinstance(action, Shutdown) for action in actions) for actions in exits],
        }


class LogInfo:
    def __init__(self, *, msg):
        self.msg = msg


class Shutdown:
    def __init__(self, *, reason):
        self.reason = reason


class LaunchDescription:
    def __init__(self, entities):
        self.entities = entities


def stand_in():
    """Puts the names where the launch file imports them from."""
    modules = {
        "launch": [LaunchDescription],
        "launch.actions": [DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown],
        "launch.substitutions": [LaunchConfiguration],
        "launch_ros": [],
        "launch_ros.actions": [Node],
    }
    for name, classes in modules.items():
        sys.modules[name] = types.ModuleType(name)
        for entry in classes:
            setattr(sys.modules[name], entry.__name__, entry)


def main():
    stand_in()
    spec = importlib.util.spec_from_file_location("launch_file", sys.argv[1])
    module = importlib.util.module_from_spec(spec)
    sys.dont_write_bytecode = True
    spec.loader.exec_module(module)
    given = dict(rule.split(":=", 1) for rule in sys.argv[2:])
    nodes = []
    context = Context({})
    for entity in module.generate_launch_description().entities:
        if isinstance(entity, DeclareLaunchArgument):
            context.values[entity.name] = given.pop(entity.name, entity.default)
        elif isinstance(entity, OpaqueFunction):
            nodes += [node.described() for node in entity.function(context)]
        else:
            nodes.append(entity.described())
    if given:
        raise ValueError(f"the file declares no argument {', '.join(given)}")
    print(json.dumps(nodes))


if __name__ == "__main__":
    main()
