"""What a control makes of a program: poses of the tool, block by block, and turns of the rotary axes."""
from dataclasses import dataclass, field

from . import rotations


class NotUnderstood(Exception):
    pass


@dataclass
class Pose:
    line: int
    rapid: bool
    feed: float       # mm/min; 0 for rapids
    tip: list         # mm, workpiece frame
    axis: list        # unit, tip to spindle, workpiece frame


@dataclass
class Turn:
    line: int
    poses_before: int
    choice: str       # positive, negative, larger, smaller, or "" where the program leaves it to the control
    rotary: dict      # letter -> degrees, from the comment before it


@dataclass
class Control:
    """A control whose coordinates count in one plane at a time, the origin at the work offset's."""
    poses: list = field(default_factory=list)
    turns: list = field(default_factory=list)
    plane: list = None        # columns: the plane's axes in the workpiece frame; None: no plane
    at: dict = field(default_factory=dict)
    announced: dict = field(default_factory=dict)

    def comment(self, text):
        """Keeps `rotary axes A 1.00000 C 2.00000` of a plane's comment."""
        words = text.lower().split()
        if "plane" in words[:1] and "axes" in words:
            values = words[words.index("axes") + 1:]
            self.announced = {letter.upper(): float(v) for letter, v in zip(values[::2], values[1::2])}

    def turn(self, line, plane, choice):
        if not self.announced:
            raise NotUnderstood("a turn without a comment that names the rotary positions")
        self.plane, self.at = plane, {}
        self.turns.append(Turn(line, len(self.poses), choice, self.announced))
        self.announced = {}

    def leave(self):
        self.plane, self.at = None, {}

    def move(self, line, rapid, feed, words):
        """`words`: axis letter -> mm. Where a coordinate is not known yet only rapids move, and no pose is known."""
        if self.plane is None:
            raise NotUnderstood("a motion outside any plane: where it goes depends on the machine")
        known = len(self.at) == 3
        self.at.update(words)
        if len(self.at) < 3:
            if not rapid:
                raise NotUnderstood("a feed move from a position that the program does not give")
            return
        if not rapid and not known:
            raise NotUnderstood("a feed move from a position that the program does not give")
        tip = rotations.turned(self.plane, [self.at[a] for a in "XYZ"])
        axis = [row[2] for row in self.plane]
        self.poses.append(Pose(line, rapid, 0.0 if rapid else feed, tip, axis))
