#!/usr/bin/env python3
"""Whole plans of one surface as meshes of more and more triangles: wall time, CPU time and memory of `patchmill plan`, one table.

Passes, proof, bag and report included. The surface is 150 x 150 mm, z = 4 mm sin(2 pi x/150) cos(2 pi y/150), smallest concave
radius 142 mm; the tool is the default one. Nothing but Python's standard library and the binary is needed:

    cargo build --release
    python3 tests/benches/scaling.py [--sizes 5000,100000,1000000] [--strategy fastest]

Five million triangles take a minute or two and a 250 MB file in the temporary folder; the machine should be idle.
"""
import argparse
import json
import math
import os
import pathlib
import struct
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
SIDE, HEIGHT = 150.0, 4.0  # mm


def write_mesh(path, triangles, side=SIDE):
    """A binary STL of about so many triangles, the first `side` mm of the surface along x and y; gives their number."""
    cells = max(2, round(math.sqrt(triangles / 2)))
    line = [side * i / cells for i in range(cells + 1)]
    turn = 2 * math.pi / SIDE
    across, along = [math.sin(turn * x) for x in line], [math.cos(turn * y) for y in line]

    def vertex(i, j):
        return line[i], line[j], HEIGHT * across[i] * along[j]

    with open(path, "wb") as out:
        out.write(b"scaling".ljust(80) + struct.pack("<I", 2 * cells * cells))
        for i in range(cells):
            near, far = ([struct.pack("<3f", *vertex(k, j)) for j in range(cells + 1)] for k in (i, i + 1))
            row = bytearray()
            for j in range(cells):
                a, b, c, d = near[j], far[j], far[j + 1], near[j + 1]
                # Facet normals of zero are for the reader to work out.
                row += bytes(12) + a + b + c + bytes(14) + a + c + d + bytes(2)
            out.write(row)
    return 2 * cells * cells


def plan(mesh, folder, strategy, binary):
    """Wall and CPU seconds, peak memory in MiB and the summary of one plan."""
    start = time.perf_counter()
    child = os.posix_spawn(
        binary,
        [binary, "plan", mesh, "--strategy", strategy, "--out", folder],
        os.environ,
        file_actions=[(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)],
    )
    _, status, usage = os.wait4(child, 0)
    if status:
        sys.exit(f"patchmill plan {mesh} ended with code {os.waitstatus_to_exitcode(status)}")
    wall = time.perf_counter() - start
    summary = json.loads(pathlib.Path(folder, "summary.json").read_text())
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, summary


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="5000,20000,100000,300000,1000000,5000000", help="triangles, comma-separated")
    parser.add_argument("--strategy", default="fastest", choices=["fastest", "rolling-ball"])
    parser.add_argument("--mesh", metavar="FILE", help="write the mesh of the first size, and plan nothing")
    parser.add_argument("--side", type=float, default=SIDE, help="with --mesh: of the mesh, mm")
    parser.add_argument("--binary", default=str(ROOT / "target" / "release" / "patchmill"))
    arguments = parser.parse_args()
    try:
        sizes = [int(size) for size in arguments.sizes.split(",")]
    except ValueError:
        parser.error(f"--sizes is {arguments.sizes!r}, expected whole numbers with commas between")
    if min(sizes) < 8:
        parser.error("expected at least 8 triangles")
    if arguments.mesh:
        print(f"{arguments.mesh}: {write_mesh(arguments.mesh, sizes[0], arguments.side)} triangles")
        return
    if not os.access(arguments.binary, os.X_OK):
        sys.exit(f"{arguments.binary} is missing: cargo build --release")
    print("| triangles | planned s | CPU s | peak memory MiB | machining time s | area within |\n|---|---|---|---|---|---|")
    for size in sizes:
        with tempfile.TemporaryDirectory() as folder:
            mesh = os.path.join(folder, "mesh.stl")
            count = write_mesh(mesh, size)
            wall, cpu, memory, summary = plan(mesh, os.path.join(folder, "plan"), arguments.strategy, arguments.binary)
        within = summary["proof"]["area_within_scallop"]
        print(
            f"| {count} | {wall:.1f} | {cpu:.0f} | {memory:.0f} | {summary['machining_time_s']:.1f} | {within:.5f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
