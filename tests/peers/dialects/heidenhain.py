"""Reads a Klartext program that uses PLANE SPATIAL, after the TNC 640 User's Manual (The PLANE function).

Spatial angles: SPA about X, SPB about Y, SPC about Z of the workpiece's own, untilted coordinate system, in this order;
the same as C, then B about the turned Y, then A about the turned X.
"""
import re

from . import rotations
from .blocks import Control, NotUnderstood

NUMBER = r"([+-]\d+\.\d+)"
PLANE = re.compile(rf"PLANE SPATIAL SPA{NUMBER} SPB{NUMBER} SPC{NUMBER} TURN FMAX(?: SEQ([+-]))? TABLE ROT")
HARMLESS = re.compile(r"TOOL CALL 1 Z S\d+|CYCL DEF 32\.0 TOLERANCE|CYCL DEF 32\.1 T[\d.]+|M3|M5|M30")


def read(text):
    control, feed, retracted, ended, seen = Control(), None, False, False, set()
    lines = text.splitlines()
    for number, line in enumerate(lines):
        try:
            count, _, block = line.partition(" ")
            if count != str(number):
                raise NotUnderstood(f"block number {count}")
            block, _, comment = block.partition(";")
            control.comment(comment)
            block = block.strip()
            plane = PLANE.fullmatch(block)
            if number == 0 or ended:
                word = "BEGIN" if number == 0 else "END"
                if block != f"{word} PGM program MM":
                    raise NotUnderstood(f"{word} PGM … MM was expected")
            elif not block:
                pass
            elif plane:
                if not retracted:
                    raise NotUnderstood("the rotary axes turn without a retract")
                a, b, c = (float(angle) for angle in plane.groups()[:3])
                choice = {"+": "positive", "-": "negative", None: ""}[plane.group(4)]
                control.turn(number, rotations.product(rotations.z(c), rotations.y(b), rotations.x(a)), choice)
                retracted = False
            elif block == "PLANE RESET STAY":
                control.leave()
            elif block == "M140 MB MAX":
                retracted = True
            elif HARMLESS.fullmatch(block):
                seen.add(block.split()[0])
                ended = block == "M30"
            elif block.startswith("L "):
                words, rapid = {}, False
                for word in block.split()[1:]:
                    if re.fullmatch(r"[XYZ][+-]\d+\.\d{4}", word) and word[0] not in words:
                        words[word[0]] = float(word[1:])
                    elif word == "FMAX":
                        rapid = True
                    elif re.fullmatch(r"F\d+(\.\d+)?", word):
                        feed = float(word[1:])
                    elif word != "R0":
                        raise NotUnderstood(f"word {word}")
                if not words or not {"TOOL", "M3"} <= seen:
                    raise NotUnderstood("a motion without coordinates, tool or spindle")
                if retracted:
                    raise NotUnderstood("a motion between retract and turn")
                if not rapid and feed is None:
                    raise NotUnderstood("a feed move without a feed")
                control.move(number, rapid, feed, words)
            else:
                raise NotUnderstood(block)
        except NotUnderstood as error:
            raise NotUnderstood(f"block {number}: {error}") from error
    if not lines[-1].endswith("END PGM program MM"):
        raise NotUnderstood("no END PGM")
    return control
