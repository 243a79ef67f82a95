"""Writes job_cdr.hex with `rosbags` (PyPI): python msgs/tests/job_cdr.py > msgs/tests/job_cdr.hex"""

import re
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

here = Path(__file__).resolve().parent.parent
store = get_typestore(Stores.ROS2_JAZZY)
types = {}
for path in sorted((here / "msg").glob("*.msg")):
    types.update(get_types_from_msg(path.read_text(), f"patchmill_msgs/msg/{path.stem}"))
store.register(types)

t = store.types
Job, Tool, HolderSection = (t[f"patchmill_msgs/msg/{name}"] for name in ("Job", "Tool", "HolderSection"))
Vector3 = t["geometry_msgs/msg/Vector3"]
Header, Time = t["std_msgs/msg/Header"], t["builtin_interfaces/msg/Time"]
zero = {"float64": 0.0, "uint8": 0, "string": ""}
values = {}
for line in (here / "msg" / "Job.msg").read_text().splitlines():
    match = re.match(r"(float64|uint8|string) +(\w+) *(#.*)?$", line)
    if match:
        values[match[2]] = zero[match[1]]
values.update(
    header=Header(stamp=Time(sec=7, nanosec=8), frame_id="workpiece"),
    job_id="ab",
    surface_id="cdé",
    tool=Tool(
        r1=0.01305,
        r2=0.006,
        length=0.1,
        flute_length=0.03,
        shank_radius=0.008,
        holder=[HolderSection(length=0.025, radius_low=0.02, radius_high=0.0315)],
    ),
    scallop_height=25.4e-6,
    patches_min=1,
    patches_max=8,
    pattern=1,
    acceleration_linear=5.0,
    placement=1,
    mount_position=Vector3(x=0.1, y=-0.2, z=0.3),
    mount_rpy=Vector3(x=0.0, y=0.5, z=-1.5),
    machine_urdf="<robot/>",
)
print(bytes(store.serialize_cdr(Job(**values), "patchmill_msgs/msg/Job")).hex())
