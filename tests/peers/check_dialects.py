#!/usr/bin/env python3
"""Holds programs in tilted planes against the joint program of the same plan.

usage: check_dialects.py PLAN_FOLDER siemens|heidenhain|fanuc ...
Each dialect is read by a parser of its own, written from the control's manual; the joint program goes through forward
kinematics from machine.urdf. Block by block the tip has to be the same within 0.2 um, the tool axis within 1e-6 rad, rapid
or feed and the feed equal; every turn has to follow a retract, name the proven rotary positions and choose them where the
control lets a program choose. Prints one JSON object: dialect -> figures. Exit 1 with the first difference.
"""
import json
import math
import sys
from pathlib import Path

from dialects import fanuc, heidenhain, siemens
from dialects.blocks import NotUnderstood
from dialects.machine import Machine, joint_program

READERS = {"siemens": (siemens, "program.mpf"), "heidenhain": (heidenhain, "program.h"), "fanuc": (fanuc, "program.nc")}
TIP, AXIS = 2e-4, 1e-6    # mm, rad


def same_poses(control, wanted):
    if len(control.poses) != len(wanted):
        raise NotUnderstood(f"{len(control.poses)} poses, program.ngc has {len(wanted)}")
    tips, axes = [0.0], [0.0]
    for pose, (proven, _) in zip(control.poses, wanted):
        tip, axis = math.dist(pose.tip, proven.tip), math.dist(pose.axis, proven.axis)
        where = f"line {pose.line} (line {proven.line} of program.ngc)"
        if not (tip <= TIP and axis <= AXIS):
            raise NotUnderstood(f"{where}: tip {tip:.6f} mm off, axis {axis:.2e} rad off")
        if pose.rapid != proven.rapid or abs(pose.feed - proven.feed) > 1e-9 * proven.feed:
            raise NotUnderstood(f"{where}: rapid {pose.rapid} F{pose.feed}, there rapid {proven.rapid} F{proven.feed}")
        tips.append(tip)
        axes.append(axis)
    return {"blocks": len(wanted), "tip_um": round(max(tips) * 1e3, 4), "axis_rad": max(axes)}


def same_turns(control, wanted, machine):
    starts = [n for n in range(len(wanted)) if n == 0 or wanted[n][1] != wanted[n - 1][1]]
    if [turn.poses_before for turn in control.turns] != starts:
        raise NotUnderstood("it turns at other places than program.ngc")
    chosen = 0
    for turn, start in zip(control.turns, starts):
        pose, rotary = wanted[start]
        if turn.rotary != rotary:
            raise NotUnderstood(f"line {turn.line}: it names {turn.rotary}, proven are {rotary}")
        tilt = (rotary[machine.tilting] + 180.0) % 360.0 - 180.0
        if turn.choice in ("positive", "negative"):
            right = tilt > 0 if turn.choice == "positive" else tilt < 0
        elif turn.choice == "":
            right = abs(tilt) < 1e-6
        else:
            others = [t for t in machine.tilts(pose.axis) if abs(t - tilt) > 1e-3]
            right = all((tilt > t) == (turn.choice == "larger") for t in others)
            chosen += bool(others)
        if not right:
            raise NotUnderstood(f"line {turn.line}: it chooses {turn.choice!r}, {machine.tilting} was proven at {tilt}")
        chosen += turn.choice in ("positive", "negative")
    return {"planes": len(starts), "chosen": chosen}


def main():
    folder = Path(sys.argv[1])
    machine = Machine((folder / "machine.urdf").read_text())
    wanted = joint_program((folder / "program.ngc").read_text(), machine)
    figures = {}
    for name in sys.argv[2:]:
        reader, file = READERS[name]
        try:
            control = reader.read((folder / file).read_text())
            figures[name] = same_poses(control, wanted) | same_turns(control, wanted, machine)
        except NotUnderstood as error:
            sys.exit(f"{file}: {error}")
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
