"""Layers of filled bodies without their solids: time, memory, volume, and the file read again.

    python -m benchmarks.layers [--bodies box,stem] [--cell 1] [--thickness 0.12] [--height 0.03333] [--chord-error 0.005]
        [--graded] [--skin 1 --open-faces ">Z"]

Bodies are a box of whole cells, a stem, a cylinder 40 mm wide and high, and files of CAD bodies. With --graded the wall is 40 %
thicker above than below, and as thick on average.

Columns: cells that the body's volume holds; layers, contours and points; wall and CPU seconds, those of child processes included;
memory at its peak; the volume over what another route says (the box: that of one cell times their number; others: random points
in the body by a fine mesh of it, with their standard error; nothing with a skin); seconds and size of the .cli file, and the
greatest difference of the area that a reader of its text finds from that of its layers, in chord errors times lengths.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import build123d as bd
import numpy as np

import tpmscad
from benchmarks.trial_judges import NodalFunction, signed_distance
from tpmscad.brep.winding_numbers import winding_numbers
from tpmscad.kernel.export.layer_files import Layer
from tpmscad.kernel.export.solid_mesh import mesh_solids

SAMPLES = 400_000

BODY_DEVIATION = 5e-4
"""Of the triangles that tell which points lie in a body, mm."""


def make_stem() -> bd.Solid:
    """A loft 40 mm long, as wide as the stem of a hip."""
    profiles = [
        bd.Pos(0, 0, 0) * bd.Ellipse(4, 3.2).face(),
        bd.Pos(0.6, 0, 14) * bd.Ellipse(5, 4).face(),
        bd.Pos(2.2, 0, 28) * bd.Ellipse(7.5, 5.2).face(),
        bd.Pos(4.5, 0, 40) * bd.Ellipse(11, 6.5).face(),
    ]
    return bd.loft(profiles).solid()


def grade_thickness(body: bd.Shape, mean: float) -> Callable[[np.ndarray], np.ndarray]:
    """A thickness that grows with the height in a body, by 40 % of its mean."""
    box = body.bounding_box()
    return lambda points: mean * (1 + 0.4 * ((points[..., 2] - box.min.Z) / box.size.Z - 0.5))


def expected_share(name: str, body: bd.Shape, cell: float, thickness: float) -> tuple[float, float]:
    """Volume fraction of the filling, and its standard error."""
    if name == "box":
        return tpmscad.lattice("gyroid", cell=cell, thickness=thickness, loose="keep").volume / cell**3, 0.0
    box = body.bounding_box()
    rng = np.random.default_rng(3)
    points = np.array(tuple(box.min)) + rng.random((SAMPLES, 3)) * np.array(tuple(box.size))
    (mesh,) = mesh_solids(body.wrapped, BODY_DEVIATION, 0.1)
    inside_body = [winding_numbers(mesh.points, mesh.triangles, some) > 0 for some in np.array_split(points, 200)]
    points = points[np.concatenate(inside_body)]
    function = NodalFunction(tpmscad.surfaces.find_surface("gyroid").formula, (cell,) * 3, (0, 0, 0))
    inside = np.abs(signed_distance(function, points, thickness / 2, cell)) < thickness / 2
    return float(inside.mean()), float(inside.std() / np.sqrt(len(points)))


def read_areas(path: Path) -> np.ndarray:
    """The area of each layer of a .cli file, by its text."""
    areas: list[float] = []
    for line in path.read_text(encoding="ascii").splitlines():
        if line.startswith("$$LAYER/"):
            areas.append(0.0)
        elif line.startswith("$$POLYLINE/"):
            x, y = np.array(line.split(",", 3)[3].split(","), float).reshape(-1, 2).T
            areas[-1] += 0.5 * float(x[:-1] @ y[1:] - x[1:] @ y[:-1])
    return np.array(areas)


def worst_area(layers: list[Layer], read: np.ndarray, chord_error: float) -> float:
    return max(
        abs(a - layer.area) / max(chord_error * layer.perimeter, 1e-12) for a, layer in zip(read, layers, strict=True)
    )


def cpu_seconds() -> float:
    own, children = (resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", default="box,stem")
    parser.add_argument("--cell", type=float, default=1.0)
    parser.add_argument("--thickness", type=float, default=0.12)
    parser.add_argument("--height", type=float, default=0.03333)
    parser.add_argument("--chord-error", type=float, default=0.005)
    parser.add_argument("--graded", action="store_true")
    parser.add_argument("--skin", type=float)
    parser.add_argument("--open-faces")
    given = parser.parse_args()
    skin = {name: value for name, value in vars(given).items() if name in ("skin", "open_faces") and value is not None}
    bodies = {
        "box": lambda: bd.Pos(15, 15, 10) * bd.Box(30, 30, 20),
        "stem": make_stem,
        "cylinder": lambda: bd.Pos(0, 0, 20) * bd.Cylinder(20, 40),
    }
    for name in given.bodies.split(","):
        body = bodies[name]() if name in bodies else bd.import_step(name)
        begun, used = time.perf_counter(), cpu_seconds()
        layers = tpmscad.infill_layers(
            body,
            "gyroid",
            cell=given.cell,
            thickness=grade_thickness(body, given.thickness) if given.graded else given.thickness,
            height=given.height,
            chord_error=given.chord_error,
            **skin,
        )
        wall, cpu = time.perf_counter() - begun, cpu_seconds() - used
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        share, error = (np.nan, np.nan) if given.skin else expected_share(name, body, given.cell, given.thickness)
        apart = layers.volume / (share * body.volume) - 1
        with tempfile.TemporaryDirectory() as folder:
            file, begun = Path(folder) / "layers.cli", time.perf_counter()
            layers.write(file)
            writing, size = time.perf_counter() - begun, file.stat().st_size / 1e6
            off = worst_area(list(layers), read_areas(file), given.chord_error)
        print(
            f"{name:5s} {body.volume / given.cell**3:7.0f} cells {len(layers):5d} layers {layers.n_contours:7d} contours "
            f"{layers.n_points:9d} points, {wall:6.1f} s wall {cpu:6.1f} s CPU {memory:5.2f} GiB, volume {apart:+.1e} "
            f"(+- {error / share:.0e}), file {writing:5.1f} s {size:6.1f} MB, areas off by {off:.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
