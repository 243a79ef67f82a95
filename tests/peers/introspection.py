"""What a person sees who introspects the stack with ROS 2 tools: nodes, topics, services, actions with types, publishers' QoS (held
against the table of msgs/README.md), what every node takes, gives and serves (against its own README), parameters with description, range and
read-only, refusals with a reason, /parameter_events, /rosout.

usage: introspection.py REPOSITORY NODE...
"""

import re
import sys
import time
from pathlib import Path

from rcl_interfaces.msg import Log, Parameter, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, GetParameterTypes, ListParameters, SetParameters, SetParametersAtomically
from rclpy.action import get_action_names_and_types, get_action_server_names_and_types_by_node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from patchmill_msgs.srv import LoadSurface
from ros2_client import PATIENCE, Peer, check, latched, reliable, run, say

NAMESPACE = "/patchmill"
STAGES = ["surface_ingestion", "rolling_ball_analysis", "surface_partitioning", "path_generation", "machine_interface"]
# Message packages by the README's short names; everything else is patchmill_msgs.
STANDARD = ("std_msgs", "sensor_msgs", "tf2_msgs", "diagnostic_msgs", "trajectory_msgs", "visualization_msgs", "geometry_msgs")


def table(readme):
    """Rows of the README's table as (name, type, QoS); `…` and `<node>` expanded, both names of a row with chunks."""
    with open(readme, encoding="utf-8") as text:
        lines = text.read().splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("| name | type | from | QoS |"))
    rows = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        names, types, sender, qos = [cell.strip() for cell in line.strip("|").split("|")]
        names = re.findall(r"`([^`]+)`", names)
        if len(names) == 2 and names[1].startswith("…"):
            names[1] = names[0] + names[1][1:]
        rows.append((names, re.findall(r"`([^`]+)`", types), sender, qos))
    return rows


def full_type(short, kind):
    if short.startswith(STANDARD):
        package, name = short.split("/")
        return f"{package}/{kind}/{name}"
    return f"patchmill_msgs/{kind}/{short.removeprefix('patchmill_msgs/')}"


def absolute(name):
    return name if name.startswith("/") else f"{NAMESPACE}/{name}"


def expected(readme):
    """({topic: (type, latched depth or None)}, {service: type}, {action: type}) that the README promises."""
    topics, services, actions = {}, {}, {}
    for names, types, sender, qos in table(readme):
        cells = qos.split("·")
        if not qos:
            for name in names:
                target = actions if types[0] in ("PlanSurface", "ExecuteProgram") else services
                kind = "action" if target is actions else "srv"
                if name == "<node>/get_…_chunk":
                    continue  # named one by one below
                if name.startswith("<node>/"):
                    for stage in STAGES[1:]:
                        services[absolute(f"{stage}/{name.split('/')[1]}")] = full_type(types[0], kind)
                else:
                    target[absolute(name)] = full_type(types[0], kind)
            continue
        for place, name in enumerate(names):
            type_name = full_type(types[min(place, len(types) - 1)], "msg")
            rule = cells[min(place, len(cells) - 1)].strip()
            depth = int(rule.split(",")[1]) if rule.startswith(("latched", "series")) else None
            for one in [f"{s}/{name.split('/')[1]}" for s in STAGES] if name.startswith("<node>/") else [name]:
                topics[absolute(one)] = (type_name, depth)
    for service, kind in {
        "surface_ingestion/get_mesh_chunk": "GetMeshChunk",
        "surface_ingestion/get_samples_chunk": "GetSamplesChunk",
        "rolling_ball_analysis/get_field_chunk": "GetFieldChunk",
        "path_generation/get_toolpath_chunk": "GetToolpathChunk",
        "machine_interface/get_program_chunk": "GetProgramChunk",
        "machine_interface/get_trajectory_chunk": "GetTrajectoryChunk",
        "machine_interface/get_residual_chunk": "GetResidualChunk",
    }.items():
        services[absolute(service)] = f"patchmill_msgs/srv/{kind}"
    return topics, services, actions


def graph(peer, readme, nodes):
    topics, services, actions = expected(readme)
    check(len(topics) >= 25 and len(services) >= 15 and len(actions) == 2, f"the README's table was not read: {topics}")
    wanted = {(name, NAMESPACE) for name in nodes}
    peer.wait("all nodes", lambda: wanted <= set(peer.node.get_node_names_and_namespaces()))
    found = lambda: dict(peer.node.get_topic_names_and_types())
    missing = lambda: [t for t in topics if not peer.node.get_publishers_info_by_topic(t)]
    peer.wait("publishers of every topic of the README", lambda: not missing()) if missing() else None
    for topic, (kind, depth) in topics.items():
        check(found().get(topic) == [kind], f"{topic} has type {found().get(topic)}, the README says {kind}")
        # A publisher is known before the name of its node.
        named = lambda: all(i.node_name in nodes for i in peer.node.get_publishers_info_by_topic(topic))
        peer.wait(f"publishers of {topic} by the stack's nodes only", named)
        for info in peer.node.get_publishers_info_by_topic(topic):
            qos = info.qos_profile
            check(qos.reliability == ReliabilityPolicy.RELIABLE, f"{topic} is not reliable")
            durability = DurabilityPolicy.TRANSIENT_LOCAL if depth else DurabilityPolicy.VOLATILE
            check(qos.durability == durability, f"{topic} is {qos.durability}, the README says {durability}")
            check(info.node_name in nodes and info.node_namespace == NAMESPACE, f"{topic} is published by {info.node_name}")
    # Nothing that the README does not name.
    own = lambda name: name.startswith(NAMESPACE) and "/_action/" not in name
    published = {t for t in found() if own(t) and peer.node.get_publishers_info_by_topic(t)}
    check(published <= set(topics), f"not in the README: {sorted(published - set(topics))}")
    def all_served():
        return {k: v for node in nodes for k, v in peer.node.get_service_names_and_types_by_node(node, NAMESPACE)}

    all_offered = lambda: dict(get_action_names_and_types(peer.node))
    peer.wait("services of the README", lambda: set(services) <= set(all_served()))
    peer.wait("actions of the README", lambda: set(actions) <= set(all_offered()))
    served, offered = all_served(), all_offered()
    for service, kind in services.items():
        check(served.get(service) == [kind], f"{service} has type {served.get(service)}, the README says {kind}")
    parameter = re.compile(r"/(list|describe|get|set)_parameter|/get_parameter_types|/_action/")
    extra = {s for s in served if not parameter.search(s)} - set(services)
    check(not extra, f"services not in the README: {sorted(extra)}")
    for action, kind in actions.items():
        check(offered.get(action) == [kind], f"{action} has type {offered.get(action)}, the README says {kind}")
    say(f"graph: {len(wanted)} nodes, {len(topics)} topics with type and QoS, {len(services)} services, {len(actions)} actions as in the README")


def of_node(repository, node):
    """{"takes", "gives", "serves": names} by the node's own README; actions are among those served."""
    rows = {"takes": set(), "gives": set(), "serves": set()}
    for line in (repository / "nodes" / node / "README.md").read_text(encoding="utf-8").splitlines():
        word = line.strip("| ").split(" ")[0]
        if line.startswith(f"| {word} |") and word in rows:
            rows[word] |= {absolute(name) for name in re.findall(r"`([^`]+)`", line)}
    return rows


def ends(peer, repository, nodes):
    """Every node takes, gives and serves what its README says, and nothing else."""
    # Of every node, and of parameter services and actions within.
    common = re.compile(r"^/rosout$|^/parameter_events$|/_action/|/(list|describe|get|set)_parameter|/get_parameter_types")
    names = lambda pairs: {name for name, _ in pairs if not common.search(name)}
    for node in nodes:
        says = of_node(repository, node)
        finds = {
            "takes": lambda: names(peer.node.get_subscriber_names_and_types_by_node(node, NAMESPACE)),
            "gives": lambda: names(peer.node.get_publisher_names_and_types_by_node(node, NAMESPACE)),
            "serves": lambda: names(peer.node.get_service_names_and_types_by_node(node, NAMESPACE))
            | names(get_action_server_names_and_types_by_node(peer.node, node, NAMESPACE)),
        }
        for word, find in finds.items():
            end = time.monotonic() + PATIENCE
            while find() != says[word] and time.monotonic() < end:
                time.sleep(0.1)
            more, less = sorted(find() - says[word]), sorted(says[word] - find())
            check(not more and not less, f"{node} {word} {more} beside what its README says, and not {less}")
    say(f"ends: what {len(nodes)} nodes take, give and serve is what their READMEs say")


def value(kind, **field):
    return ParameterValue(type=kind, **field)


def parameters(peer, nodes):
    count = 0
    for node in nodes:
        listed = peer.call(ListParameters, f"{node}/list_parameters", ListParameters.Request()).result.names
        check("use_sim_time" in listed and listed == sorted(listed), f"{node} lists {listed}")
        described = peer.call(DescribeParameters, f"{node}/describe_parameters", DescribeParameters.Request(names=listed)).descriptors
        values = peer.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=listed)).values
        types = peer.call(GetParameterTypes, f"{node}/get_parameter_types", GetParameterTypes.Request(names=listed)).types
        check([d.name for d in described] == listed, f"{node} describes {[d.name for d in described]}")
        check([v.type for v in values] == list(types) == [d.type for d in described], f"{node}: types differ")
        for name, descriptor, now in zip(listed, described, values):
            check(len(descriptor.description) >= 10, f"{node} {name} has the description '{descriptor.description}'")
            ranges = list(descriptor.integer_range) + list(descriptor.floating_point_range)
            number = {ParameterType.PARAMETER_INTEGER: now.integer_value, ParameterType.PARAMETER_DOUBLE: now.double_value}.get(now.type)
            if number is not None:
                check(len(ranges) == 1 and ranges[0].from_value <= number <= ranges[0].to_value, f"{node} {name} has the range {ranges}")
            count += 1
            refuse(peer, node, descriptor, ranges)
    say(f"parameters: {count} of {len(nodes)} nodes with description and range; bad values refused with a reason")


def set_one(peer, node, name, new):
    request = SetParameters.Request(parameters=[Parameter(name=name, value=new)])
    return peer.call(SetParameters, f"{node}/set_parameters", request).results[0]


def refuse(peer, node, descriptor, ranges):
    """Values out of range and of another type, and any value of a read-only parameter."""
    name = descriptor.name
    bad = [value(ParameterType.PARAMETER_BYTE_ARRAY, byte_array_value=[b"x"])]
    if ranges and descriptor.type == ParameterType.PARAMETER_DOUBLE:
        bad += [value(ParameterType.PARAMETER_DOUBLE, double_value=v) for v in (ranges[0].to_value * 2.0, float("nan"))]
    if ranges and descriptor.type == ParameterType.PARAMETER_INTEGER and ranges[0].to_value < 2**62:
        bad += [value(ParameterType.PARAMETER_INTEGER, integer_value=ranges[0].to_value + 1)]
    if descriptor.read_only and descriptor.type == ParameterType.PARAMETER_STRING:
        bad += [value(ParameterType.PARAMETER_STRING, string_value="other")]
    for new in bad:
        result = set_one(peer, node, name, new)
        check(not result.successful and name in result.reason, f"{node} {name}: {new} gave {result}")


def changes(peer):
    """A good value is taken, and told on /parameter_events; an atomic change with one bad value changes nothing."""
    events, _ = peer.collect(ParameterEvent, "/parameter_events", QoSProfile(depth=100))
    node = "surface_partitioning"
    peer.wait("the publisher of /parameter_events", lambda: peer.node.count_publishers("/parameter_events") >= 1)
    integer = lambda v: value(ParameterType.PARAMETER_INTEGER, integer_value=v)

    def told():
        check(set_one(peer, node, "restarts", integer(7)).successful, "restarts = 7 was refused")
        time.sleep(0.2)
        return [e for e in events if e.node == f"{NAMESPACE}/{node}" and any(p.name == "restarts" for p in e.changed_parameters)]

    event = peer.wait("a parameter event", told)[0]
    check(event.changed_parameters[0].value.integer_value == 7, f"{event}")
    request = SetParametersAtomically.Request(
        parameters=[Parameter(name="restarts", value=integer(9)), Parameter(name="max_iterations", value=integer(0))]
    )
    result = peer.call(SetParametersAtomically, f"{node}/set_parameters_atomically", request).result
    check(not result.successful and "max_iterations" in result.reason, f"{result}")
    now = peer.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=["restarts"])).values[0]
    check(now.integer_value == 7, f"a refused atomic change left restarts = {now.integer_value}")
    unknown = set_one(peer, node, "no_such", integer(1))
    check(not unknown.successful and "no_such" in unknown.reason, f"{unknown}")
    say("parameter changes: taken, on /parameter_events, atomic; an unknown one refused: " + unknown.reason)


def rosout(peer):
    """A stage's log lines come with its node name."""
    lines, _ = peer.collect(Log, "/rosout", latched(100))
    peer.wait("publishers of /rosout", lambda: peer.node.count_publishers("/rosout") >= 2)
    surface = '{"kind":"algebraic","expression":"x*x/400","x":[0,30],"y":[0,20]}'

    def heard():
        request = LoadSurface.Request(inline_json=surface, samples_per_side=10 + len(lines) % 5)
        answer = peer.call(LoadSurface, "surface_ingestion/load_surface", request)
        check(answer.code == 0, answer.text)
        time.sleep(0.3)
        return [line for line in lines if line.name.split(".")[-1] == "surface_ingestion" and "triangles" in line.msg]

    line = peer.wait("a log line on /rosout", heard)[0]
    say(f"/rosout: [{line.name}] {line.msg}")


def main():
    repository, nodes = Path(sys.argv[1]), sys.argv[2:]
    peer = Peer("introspection", "/patchmill")
    graph(peer, repository / "msgs/README.md", nodes)
    ends(peer, repository, nodes)
    parameters(peer, nodes)
    changes(peer)
    rosout(peer)
    peer.close()


run(main)
