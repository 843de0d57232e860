"""Triangles of filled bodies without their solids: time, memory, volume, closedness, and a picture.

    python -m benchmarks.triangles [--bodies box,stem] [--cell 1] [--thickness 0.12] [--deviation 0.01]
        [--skin MM] [--graded] [--picture FOLDER]

With --graded the wall is as thick on average, and 40 % thicker above than below.

Bodies are those of `benchmarks.layers`. Columns: whole and cut cells, triangles; wall and CPU seconds; memory at its peak; the
volume over what another route says (the box: that of one exact cell times their number; the stem: random points in the body by
a fine mesh of it, with their standard error), and the difference as a distance over the area, in deviations; seconds and
size of the STL file, and what trimesh says of it, up to five million triangles; seconds of the picture.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

import build123d as bd

import tpmscad
from benchmarks.layers import cpu_seconds, expected_share, grade_thickness, make_stem

MAX_READ_TRIANGLES = 5_000_000


def describe_file(path: Path, triangles: int) -> str:
    """What trimesh says of a file."""
    if triangles > MAX_READ_TRIANGLES:
        return "not read by trimesh"
    import trimesh

    read = trimesh.load(path)
    return f"trimesh: {'watertight' if read.is_watertight else 'OPEN'}, volume {read.volume:.6g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", default="box,stem")
    parser.add_argument("--cell", type=float, default=1.0)
    parser.add_argument("--thickness", type=float, default=0.12)
    parser.add_argument("--deviation", type=float, default=0.01)
    parser.add_argument("--skin", type=float)
    parser.add_argument("--graded", action="store_true")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    bodies = {"box": lambda: bd.Pos(15, 15, 10) * bd.Box(30, 30, 20), "stem": make_stem}
    asked = {"cell": given.cell, "deviation": given.deviation, "skin": given.skin}
    for name in given.bodies.split(","):
        body = bodies[name]()
        asked["thickness"] = grade_thickness(body, given.thickness) if given.graded else given.thickness
        begun, used = time.perf_counter(), cpu_seconds()
        part = tpmscad.infill_triangles(body, "gyroid", **asked)
        wall, cpu = time.perf_counter() - begun, cpu_seconds() - used
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        words = ""
        if given.skin is None and not given.graded:
            share, error = expected_share(name, body, given.cell, given.thickness)
            off = part.volume - share * body.volume
            apart, distance = off / (share * body.volume), off / part.area / given.deviation
            words = f"volume {apart:+.1e} (+- {error / share:.0e}), {distance:+.2f}, "
        with tempfile.TemporaryDirectory() as folder:
            file, begun = Path(folder) / "part.stl", time.perf_counter()
            part.write(file)
            writing, size = time.perf_counter() - begun, file.stat().st_size / 1e6
            words += f"file {writing:.1f} s {size:.0f} MB, {describe_file(file, len(part.triangles))}"
        if given.picture is not None:
            begun = time.perf_counter()
            part.render(given.picture / f"{name}.png", section="y")
            words += f", picture {time.perf_counter() - begun:.1f} s"
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(
            f"{name:5s} {part.whole_cells:6d} whole {part.cut_cells:6d} cut {len(part.triangles):9d} triangles, "
            f"{wall:6.1f} s wall {cpu:6.1f} s CPU {memory:5.2f} GiB, {words}, {most:.2f} GiB in all",
            flush=True,
        )


if __name__ == "__main__":
    main()
