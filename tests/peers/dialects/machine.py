"""Forward kinematics from a machine's URDF, and the joint program's poses by it. Metres and degrees inside."""
import math
import re
import xml.etree.ElementTree as ElementTree

from . import rotations
from .blocks import NotUnderstood, Pose


def _numbers(element, name, default):
    return [float(v) for v in (element.get(name, default) if element is not None else default).split()]


class Machine:
    def __init__(self, urdf):
        root = ElementTree.fromstring(urdf)
        above = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
        self.work, self.tool = self._chain(above, "workpiece"), self._chain(above, "tool_tip")
        while self.work and self.tool and self.work[0]["name"] == self.tool[0]["name"]:
            del self.work[0], self.tool[0]
        moving = {j["letter"]: j for j in self.work + self.tool if j["letter"]}
        self.rotary = sorted(letter for letter in moving if letter in "ABC")
        self.limits = {letter: moving[letter]["limits"] for letter in self.rotary}
        # Seen from the tool the first rotary axis: the last one of the head, else the table's nearest the base.
        order = [j["letter"] for j in self.work[::-1] + self.tool if j["letter"] in self.rotary]
        self.tilting = order[-1]
        self.zero = self._zero()

    @staticmethod
    def _chain(above, link):
        chain = []
        while link in above:
            joint = above[link]
            letter = ""
            if joint.get("type") != "fixed":
                letter = re.sub(r"axis|joint|_", "", joint.get("name").lower()).upper()
            origin, axis, limit = joint.find("origin"), joint.find("axis"), joint.find("limit")
            direction = _numbers(axis, "xyz", "1 0 0")
            length = math.sqrt(sum(c * c for c in direction))
            roll, pitch, yaw = (math.degrees(a) for a in _numbers(origin, "rpy", "0 0 0"))
            limits = None
            if joint.get("type") == "revolute":
                limits = [math.degrees(float(limit.get(end))) for end in ("lower", "upper")]
            chain.append({
                "name": joint.get("name"), "letter": letter, "axis": [c / length for c in direction], "limits": limits,
                "xyz": _numbers(origin, "xyz", "0 0 0"),
                "rotation": rotations.product(rotations.z(yaw), rotations.y(pitch), rotations.x(roll)),
            })
            link = joint.find("parent").get("link")
        return chain[::-1]

    @staticmethod
    def _placed(chain, joints):
        rotation, place = rotations.IDENTITY, [0.0, 0.0, 0.0]
        for joint in chain:
            place = [p + d for p, d in zip(place, rotations.turned(rotation, joint["xyz"]))]
            rotation = rotations.product(rotation, joint["rotation"])
            value = joints.get(joint["letter"], 0.0)
            if joint["letter"] and joint["letter"] in "XYZ":
                shift = rotations.turned(rotation, [c * value for c in joint["axis"]])
                place = [p + d for p, d in zip(place, shift)]
            elif joint["letter"]:
                rotation = rotations.product(rotation, rotations.about(joint["axis"], value))
        return rotation, place

    def pose(self, joints):
        """(tip in m, tool axis), workpiece frame; `joints`: letter -> m or degrees."""
        work, at = self._placed(self.work, joints)
        tool, tip = self._placed(self.tool, joints)
        back = [list(column) for column in zip(*work)]
        return (rotations.turned(back, [t - a for t, a in zip(tip, at)]),
                rotations.turned(back, [row[2] for row in tool]))

    def _zero(self):
        """Joint values that put the tip at the workpiece origin, rotary axes at 0 (Cramer's rule)."""
        origin = self.pose({})[0]
        columns = [[t - o for t, o in zip(self.pose({a: 1.0})[0], origin)] for a in "XYZ"]

        def determinant(m):
            a, b, c = m
            return (a[0] * (b[1] * c[2] - b[2] * c[1]) - b[0] * (a[1] * c[2] - a[2] * c[1])
                    + c[0] * (a[1] * b[2] - a[2] * b[1]))

        wanted, whole = [-o for o in origin], determinant(columns)
        return {a: determinant(columns[:i] + [wanted] + columns[i + 1:]) / whole for i, a in enumerate("XYZ")}

    def tilts(self, axis):
        """Angles of the tilting axis, degrees, of all rotary positions within the travel that give this tool axis."""
        found = []

        def miss(q):
            return [a - b for a, b in zip(self.pose(dict(zip(self.rotary, q)))[1], axis)]

        ranges = [self.limits[letter] or [-180.0, 180.0] for letter in self.rotary]
        grid = [[low + (high - low) * i / 24 for i in range(25)] for low, high in ranges]
        for start in ((a, b) for a in grid[0] for b in grid[1]):
            if math.hypot(*miss(start)) > 0.35:
                continue
            q = list(start)
            for _ in range(30):
                r = miss(q)
                if math.hypot(*r) < 1e-11:
                    break
                step = 1e-4
                columns = [[(b - a) / step for a, b in zip(r, miss([q[0] + step * (i == 0), q[1] + step * (i == 1)]))]
                           for i in range(2)]
                aa, ab, bb = (sum(p * s for p, s in zip(columns[m], columns[n])) for m, n in ((0, 0), (0, 1), (1, 1)))
                ra, rb = (sum(p * s for p, s in zip(columns[m], r)) for m in range(2))
                scale = aa * bb - ab * ab
                if abs(scale) < 1e-18:
                    break
                q = [q[0] - (bb * ra - ab * rb) / scale, q[1] - (aa * rb - ab * ra) / scale]
            if math.hypot(*miss(q)) < 1e-9:
                turns = [self._within(v, self.limits[letter]) for letter, v in zip(self.rotary, q)]
                tilt = turns[self.rotary.index(self.tilting)]
                if None not in turns and all(abs(tilt - f) > 1e-4 for f in found):
                    found.append(tilt)
        return found

    @staticmethod
    def _within(value, limits):
        if limits is None:
            return (value + 180.0) % 360.0 - 180.0
        fitting = [v for v in (value + 360.0 * n for n in range(-3, 4)) if limits[0] - 1e-6 <= v <= limits[1] + 1e-6]
        return min(fitting, key=abs) if fitting else None


def joint_program(text, machine):
    """Poses and rotary positions (letter -> degrees) of program.ngc, from the first block on in which all axes are known."""
    at, motion, feed, found = {}, None, None, []
    for number, line in enumerate(text.splitlines(), 1):
        moved = False
        for letter, value in re.findall(r"([A-Z])\s*(-?\d+\.?\d*)", re.sub(r"\([^)]*\)", "", line)):
            if letter == "G" and value in ("0", "1"):
                motion = value
            elif letter == "F":
                feed = float(value)
            elif letter in "XYZABC":
                at[letter], moved = float(value), True
        if not moved or len(at) < 5:
            continue
        joints = {a: at[a] / 1e3 + machine.zero[a] for a in "XYZ"} | {a: at[a] for a in machine.rotary}
        if len(joints) != len(at):
            raise NotUnderstood(f"line {number}: the letters of the program are not the machine's")
        tip, axis = machine.pose(joints)
        rapid = motion == "0"
        pose = Pose(number, rapid, 0.0 if rapid else feed, [c * 1e3 for c in tip], axis)
        found.append((pose, {a: at[a] for a in machine.rotary}))
    return found
