"""Reads a SINUMERIK program that uses CYCLE800, after the Programming Manual Job Planning (Programming cycles externally).

_MODE, axis by axis (bits 7 and 6 zero): bits 1-0, 3-2, 5-4 name the axes of the first, second and third rotation, 01 X,
10 Y, 11 Z; every rotation starts from the coordinate system that the one before has left.
"""
import re

from . import rotations
from .blocks import Control, NotUnderstood

HARMLESS = {"G17", "G40", "G54", "G90", "G94", "G710", "G642", "RTLION", "M3", "M5", "M6", "M30", "T1", "D1"}
ABOUT = {1: rotations.x, 2: rotations.y, 3: rotations.z}


def swivel(arguments):
    """(plane, choice) of a CYCLE800 with parameters."""
    if len(arguments) != 16:
        raise NotUnderstood(f"CYCLE800 has 16 parameters, here are {len(arguments)}")
    retract, status, mode = int(arguments[0]), int(arguments[2]), int(arguments[3])
    if retract not in (1, 2, 4):
        raise NotUnderstood("the rotary axes turn without a retract")
    if not re.fullmatch(r'"[A-Z0-9_]*"', arguments[1]) or status != 0 or mode >> 6 != 0 or int(arguments[15]) != 1:
        raise NotUnderstood("swivel data set, status, mode or plane")
    if any(float(arguments[i]) != 0 for i in (4, 5, 6, 10, 11, 12)):
        raise NotUnderstood("a reference point that is not the origin")
    order = [mode & 3, mode >> 2 & 3, mode >> 4 & 3]
    if sorted(order) != [1, 2, 3]:
        raise NotUnderstood(f"mode {mode} does not rotate about each axis once")
    plane = rotations.product(*(ABOUT[axis](float(a)) for axis, a in zip(order, arguments[7:10])))
    choices = {1: "larger", -1: "smaller"}
    if int(arguments[13]) not in choices:
        raise NotUnderstood("a swivel that does not move the rotary axes")
    return plane, choices[int(arguments[13])]


def read(text):
    control, motion, feed, set_up = Control(), None, None, set()
    for number, line in enumerate(text.splitlines(), 1):
        code, _, comment = line.partition(";")
        control.comment(comment)
        code = code.strip()
        try:
            if code == "CYCLE800()":
                control.leave()
                motion = None
                continue
            if code.startswith("CYCLE800("):
                control.turn(number, *swivel([a.strip() for a in code[9:].removesuffix(")").split(",")]))
                motion = None
                continue
            words = {}
            for word in code.split():
                if word in ("G0", "G1"):
                    motion = word
                elif word in HARMLESS or re.fullmatch(r"S\d+|CTOL=[\d.]+", word):
                    set_up.add(word)
                elif re.fullmatch(r"F\d+(\.\d+)?", word):
                    feed = float(word[1:])
                elif re.fullmatch(r"[XYZ]-?\d+\.\d{4}", word) and word[0] not in words:
                    words[word[0]] = float(word[1:])
                else:
                    raise NotUnderstood(f"word {word}")
            if words:
                if motion is None or not {"G54", "G90", "G94", "G710", "D1", "M3"} <= set_up:
                    raise NotUnderstood("a motion before its G code, the units or the tool")
                if motion == "G1" and feed is None:
                    raise NotUnderstood("a feed move without a feed")
                control.move(number, motion == "G0", feed, words)
        except NotUnderstood as error:
            raise NotUnderstood(f"line {number}: {error}") from error
    if "M30" not in set_up:
        raise NotUnderstood("no M30")
    return control
