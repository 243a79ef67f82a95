#!/usr/bin/env python3
"""The kernels of patchmill beside their peers, on the same meshes and this machine: two tables.

Drop-cutter (bull nose 38.1 mm, corner 6 mm) beside opencamlib's BatchDropCutter; rolling ball beside the shrinking ball
on a SciPy KD-tree, both with a largest ball of radius CAP for the peer and the 32.1 mm shadow and the whole part for ours;
k-means of 1 to 8 clusters beside scikit-learn's, on z-scored position and curvature of a surface's samples.

    python3 -m venv /tmp/bench && /tmp/bench/bin/pip install -r tests/peers/requirements-bench.txt
    cargo build --release -p patchmill_geometry -p patchmill_surface_partitioning --examples
    /tmp/bench/bin/python tests/peers/bench.py [--sizes 5000,100000] [--samples 250000] [--threads 2] [--json]

Add 1000000 to the sizes for a run of some minutes. Opencamlib gets fewer points on larger meshes: rates are of what
each was given. Rates are of wall time, without the building of trees; the machine should be idle.
"""
import argparse
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
import opencamlib
from scipy.spatial import cKDTree
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

ROOT = pathlib.Path(__file__).resolve().parents[2]
SIDE = 150.0  # of the mesh, mm
DIAMETER, CORNER = 38.1, 6.0  # of the cutter, mm
CAP = 60.0  # largest ball of the shrinking ball, mm
TRIANGLES_DROPPED = 4e6  # opencamlib: points times triangles, so that a run takes seconds


def surface(x, y):
    """Height and its gradient, mm: hollows of R 20 mm and up beside crowns."""
    a, b = 2 * np.pi / 90, 2 * np.pi / 70
    z = 6 * np.sin(a * x) * np.cos(b * y) + 0.002 * (x - 75) ** 2
    zx = 6 * a * np.cos(a * x) * np.cos(b * y) + 0.004 * (x - 75)
    zy = -6 * b * np.sin(a * x) * np.sin(b * y)
    return z, zx, zy


def write_mesh(path, triangles):
    """A binary STL of about so many triangles; gives its vertices and the surface's normals there."""
    cells = max(2, round(math.sqrt(triangles / 2)))
    line = np.linspace(0, SIDE, cells + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    z, zx, zy = surface(x, y)
    p = np.stack([x, y, z], -1)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    corners = np.concatenate([np.stack([a, b, c], 2).reshape(-1, 3, 3), np.stack([a, c, d], 2).reshape(-1, 3, 3)])
    record = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    record["n"] = normal / np.linalg.norm(normal, axis=1)[:, None]
    record["v"] = corners
    with open(path, "wb") as out:
        out.write(b"bench".ljust(80) + np.uint32(len(corners)).tobytes() + record.tobytes())
    n = np.stack([-zx, -zy, np.ones_like(zx)], -1)
    return len(corners), p.reshape(-1, 3), (n / np.linalg.norm(n, axis=-1, keepdims=True)).reshape(-1, 3)


def ours(example, mesh, threads, *more):
    binary = ROOT / "target" / "release" / "examples" / example
    if not binary.exists():
        sys.exit(
            f"{binary} is missing: cargo build --release -p patchmill_geometry -p patchmill_surface_partitioning --examples"
        )
    run = subprocess.run(
        [binary, mesh, *map(str, more)],
        env={**os.environ, "RAYON_NUM_THREADS": str(threads)},
        capture_output=True,
        text=True,
    )
    if run.returncode:
        sys.exit(run.stderr.strip())
    return json.loads(run.stdout)


def opencamlib_drops(path, points, threads):
    """Seconds to build, points a second. The cutter has to outlive the run."""
    stl = opencamlib.STLSurf()
    opencamlib.STLReader(str(path), stl)
    cutter = opencamlib.BullCutter(DIAMETER, CORNER, 100.0)
    start = time.perf_counter()
    batch = opencamlib.BatchDropCutter()
    batch.setThreads(threads)
    batch.setSTL(stl)
    batch.setCutter(cutter)
    build = time.perf_counter() - start
    side = max(2, round(math.sqrt(points)))
    line = SIDE * (0.05 + 0.9 * (np.arange(side) + 0.5) / side)
    for y in line:
        for x in line:
            batch.appendPoint(opencamlib.CLPoint(float(x), float(y), -100.0))
    start = time.perf_counter()
    batch.run()
    return build, side * side / (time.perf_counter() - start)


def shrinking_ball(points, normals, samples, threads):
    """Seconds to build, balls a second: all samples' balls shrink together until nothing is inside of them."""
    start = time.perf_counter()
    tree = cKDTree(points)
    build = time.perf_counter() - start
    chosen = np.linspace(0, len(points) - 1, samples).astype(int)
    p, n = points[chosen], normals[chosen]
    start = time.perf_counter()
    radius, active = np.full(samples, CAP), np.arange(samples)
    for _ in range(60):
        centre = p[active] + n[active] * radius[active, None]
        distance, nearest = tree.query(centre, workers=threads)
        d = points[nearest] - p[active]
        height = np.einsum("ij,ij->i", d, n[active])
        inside = (distance < radius[active] * (1 - 1e-6)) & (nearest != chosen[active]) & (height > 1e-9)
        if not inside.any():
            break
        active = active[inside]
        radius[active] = np.einsum("ij,ij->i", d[inside], d[inside]) / (2 * height[inside])
    return build, samples / (time.perf_counter() - start)


def measure(triangles, arguments):
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "mesh.stl"
        count, points, normals = write_mesh(path, triangles)
        threads, rows = arguments.threads, []

        def row(kernel, mine, peer, build, rate):
            deviation = mine.get("max_relative_deviation", mine["max_deviation_mm"])
            rows.append(
                {
                    "kernel": kernel,
                    "triangles": count,
                    "patchmill_per_second": mine["points_per_second"],
                    "peer": peer,
                    "peer_per_second": round(rate, 1),
                    "ratio": round(mine["points_per_second"] / rate, 1),
                    "patchmill_build_seconds": mine["build_seconds"],
                    "peer_build_seconds": round(build, 4),
                    "deviation_from_brute_force": deviation,
                    "patchmill_peak_memory_mib": mine["peak_memory_mib"],
                }
            )

        few = int(min(10_000, max(25, TRIANGLES_DROPPED / count)))
        peer = opencamlib_drops(path, few, threads)
        row("drop-cutter, mm", ours("drop_cutter", path, threads, arguments.points, 0), "opencamlib", *peer)
        balls = min(len(points), 20_000)
        peer = shrinking_ball(points, normals, balls, threads)
        for name, shadow in [("rolling ball, 32.1 mm", "32.1"), ("rolling ball, whole part", "unlimited")]:
            mine = ours("rolling_ball", path, threads, arguments.points, shadow)
            row(name, mine, f"KD-tree, R <= {CAP:.0f}", *peer)
        return rows


def measure_k_means(samples, threads):
    """Seconds and inertia of ours and of scikit-learn's (n_init=10), k = 1 to 8."""
    side = max(4, round(math.sqrt(samples)))
    line = np.linspace(0, SIDE, side)
    x, y = np.meshgrid(line, line, indexing="ij")
    z, zx, _ = surface(x, y)
    features = np.stack([x, y, z, np.gradient(zx, line, axis=0)], -1).reshape(-1, 4)
    features = (features - features.mean(0)) / features.std(0)
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "features.f64"
        features.astype("<f8").tofile(path)
        mine = ours("k_means", path, threads)
    start, peer = time.perf_counter(), []
    with threadpool_limits(threads):
        for k in range(1, 9):
            peer.append(KMeans(k, n_init=10, random_state=0).fit(features).inertia_)
    return {
        "samples": len(features),
        "patchmill_seconds": mine["seconds"],
        "scikit_learn_seconds": round(time.perf_counter() - start, 3),
        "inertia_ratios": [round(a / b, 6) for a, b in zip(mine["inertia"], peer)],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="5000,100000", help="triangles of the meshes, comma-separated")
    parser.add_argument("--points", type=int, default=100_000, help="points for our kernels")
    parser.add_argument("--samples", type=int, default=250_000, help="samples for k-means")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="the figures as JSON instead of the table")
    arguments = parser.parse_args()
    try:
        sizes = [int(size) for size in arguments.sizes.split(",")]
    except ValueError:
        parser.error(f"--sizes is {arguments.sizes!r}, expected whole numbers with commas between")
    if min(sizes) < 8 or max(sizes) > 10_000_000 or arguments.points < 1 or arguments.threads < 1:
        parser.error("expected sizes from 8 to 10000000, and at least one point and thread")
    if arguments.samples < 16:
        parser.error("expected at least 16 samples")
    rows = [row for size in sizes for row in measure(size, arguments)]
    clusters = measure_k_means(arguments.samples, arguments.threads)
    if arguments.json:
        print(json.dumps({"kernels": rows, "k_means": clusters}))
        return
    print(f"| kernel | triangles | patchmill /s | peer | peer /s | ratio | build s | peer build s | off brute force |")
    print("|---|---|---|---|---|---|---|---|---|")
    for r in rows:
        print(
            f"| {r['kernel']} | {r['triangles']} | {r['patchmill_per_second']:.0f} | {r['peer']} |"
            f" {r['peer_per_second']:.0f} | {r['ratio']:.0f} | {r['patchmill_build_seconds']:.3f} |"
            f" {r['peer_build_seconds']:.3f} | {r['deviation_from_brute_force']:.0e} |"
        )
    print("\n| k-means, k = 1 to 8 | patchmill s | scikit-learn s | inertia / scikit-learn's, k = 1 to 8 |\n|---|---|---|---|")
    ratios = ", ".join(f"{ratio:.4f}" for ratio in clusters["inertia_ratios"])
    print(
        f"| {clusters['samples']} samples | {clusters['patchmill_seconds']:.2f} |"
        f" {clusters['scikit_learn_seconds']:.1f} | {ratios} |"
    )


if __name__ == "__main__":
    main()
