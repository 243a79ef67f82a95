"""Reads a Fanuc program that uses G68.2, after the Series 30i-B User's Manual for machining centers (Tilted working plane
indexing, Tool axis direction control).

Euler angles: I about Z, J about the X turned by I, K about the Z turned by both. The tool length offset must be off when a
plane is defined, G53.1 turns the axes, and the tip is where the program says once G43 is on.
"""
import re

from . import rotations
from .blocks import Control, NotUnderstood

HARMLESS = {17, 21, 40, 54, 80, 94}
WORD = re.compile(r"([A-Z])(-?\d+\.?\d*)")


class Fanuc:
    def __init__(self):
        self.control = Control()
        self.motion = self.feed = self.defined = None
        self.length, self.home, self.absolute, self.ended, self.set_up = False, False, False, False, set()

    def block(self, number, text):
        words = WORD.findall(text)
        if "".join(letter + value for letter, value in words) != text.replace(" ", ""):
            raise NotUnderstood(text)
        codes = [float(value) for letter, value in words if letter == "G"]
        values = {letter: float(value) for letter, value in words if letter not in "GMT"}
        if len(values) != sum(letter not in "GMT" for letter, _ in words):
            raise NotUnderstood("a letter twice")
        for code in codes:
            self.preparatory(code, codes, values, number)
        for letter, value in words:
            if letter == "M":
                if int(value) not in (3, 5, 6, 30):
                    raise NotUnderstood(f"M{value}")
                self.set_up.add(f"M{value}")
                self.ended |= value == "30"
            elif letter not in "GTSHFXYZIJKP":
                raise NotUnderstood(f"letter {letter}")
        if "F" in values:
            self.feed = values["F"]
        at = {a: values[a] for a in "XYZ" if a in values}
        if at and not {28.0, 68.2} & set(codes):
            self.move(number, at)

    def preparatory(self, code, codes, values, number):
        if code in (0, 1):
            self.motion = code
        elif code in HARMLESS:
            self.set_up.add(code)
        elif code in (90, 91):
            self.absolute = code == 90
        elif code == 28:
            if self.absolute or self.control.plane is not None or values != {"Z": 0.0}:
                raise NotUnderstood("only G91 G28 Z0 outside any plane is a retract")
            self.home = True
        elif code == 43:
            if values.get("H") != 1.0 or "Z" not in values or self.control.plane is None:
                raise NotUnderstood("G43 H1 comes with the first Z in the plane")
            self.length = True
        elif code == 49:
            self.length = False
        elif code == 69:
            self.control.leave()
            self.defined = None
        elif code == 68.2:
            if self.control.plane is not None or self.length or not self.absolute:
                raise NotUnderstood("G68.2 in a plane, with a tool length offset, or under G91")
            if any(values.get(a) != 0.0 for a in "XYZ") or not all(a in values for a in "IJK"):
                raise NotUnderstood("G68.2 X0 Y0 Z0 I J K was expected")
            i, j, k = (values[a] for a in "IJK")
            self.defined = rotations.product(rotations.z(i), rotations.x(j), rotations.z(k))
        elif code == 53.1:
            if self.defined is None or not self.home or codes != [53.1]:
                raise NotUnderstood("G53.1 without a plane or without a retract")
            choices = {None: "", 1.0: "positive", 2.0: "negative"}
            self.control.turn(number, self.defined, choices[values.get("P")])
            self.motion, self.home, self.defined = None, False, None
        else:
            raise NotUnderstood(f"G{code}")

    def move(self, number, at):
        if self.motion is None or not self.absolute or not {17, 21, 54, 94, "M3", "M6"} <= self.set_up:
            raise NotUnderstood("a motion before its G code, the units, the tool or the spindle")
        if "Z" in at and not self.length:
            raise NotUnderstood("a move along Z without tool length offset")
        if self.home or (self.motion == 1 and self.feed is None):
            raise NotUnderstood("a motion between retract and turn, or without a feed")
        self.control.move(number, self.motion == 0, self.feed, at)


def read(text):
    fanuc = Fanuc()
    lines = text.splitlines()
    if lines[0] != "%" or lines[-1] != "%" or not re.fullmatch(r"O\d{4} \([^()]*\)", lines[1]):
        raise NotUnderstood("% and program number at the ends")
    for number, line in enumerate(lines[2:-1], 3):
        try:
            comment = re.fullmatch(r"\(([^()a-z]*)\)", line)
            if comment:
                fanuc.control.comment(comment.group(1))
            else:
                fanuc.block(number, line)
        except NotUnderstood as error:
            raise NotUnderstood(f"line {number}: {error}") from error
    if not fanuc.ended:
        raise NotUnderstood("no M30")
    return fanuc.control
