"""Files of results of every kind: whether their meshes are watertight, how far their volume is off, size and time.

    python -m benchmarks.exports

Meshes are read by trimesh, exact files by the kernel. The volume error of a mesh is in units of the deviation asked times the
area, of which one is the most that is allowed; that of an exact file is relative.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import build123d as bd
import trimesh

import tpmscad
from tpmscad import fields
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.step.step_reader import read_step

DEVIATION = 0.02
SUFFIXES = ("step", "brep", "stl", "3mf", "glb")
WALL = {"cell": 10, "thickness": 1, "tol": 0.02}
RESULTS: dict[str, Callable[[], tpmscad.Model]] = {
    "gyroid": lambda: tpmscad.lattice("gyroid", **WALL),
    "gyroid 2x2x2": lambda: tpmscad.lattice("gyroid", cells=(2, 2, 2), **WALL),
    "P": lambda: tpmscad.lattice("P", **WALL),
    "D skeletal": lambda: tpmscad.lattice("D", cell=10, offset=0.3, kind="skeletal", tol=0.02),
    "gyroid in a ball": lambda: tpmscad.infill(bd.Sphere(7), "gyroid", **WALL),
    "P in a drum": lambda: tpmscad.infill(bd.Cylinder(7, 12), "P", **WALL),
    "P in a prism": lambda: tpmscad.infill(bd.extrude(bd.Ellipse(6, 5), 10), "P", **WALL),
    "P in a skin": lambda: tpmscad.infill(bd.Box(13, 12, 11), "P", skin=1.0, **WALL),
    "graded field": lambda: tpmscad.solidify(
        fields.sheet(fields.tpms("gyroid", 10.0), -0.3, 0.3), ((0, 0, 0), (10, 9, 8)), tol=0.02
    ),
    "channel": lambda: tpmscad.fluid_domains(bd.Box(12, 11, 10), "P", **WALL).plus,
}


def read_mesh(path: Path) -> trimesh.Trimesh:
    """The mesh of a file in mm, equal points united."""
    loaded = trimesh.load(path)
    mesh = loaded if isinstance(loaded, trimesh.Trimesh) else loaded.to_geometry()
    points = 1e3 * mesh.vertices if path.suffix == ".glb" else mesh.vertices
    return trimesh.Trimesh(points, mesh.faces)


def judge(model: tpmscad.Model, path: Path) -> tuple[bool, float]:
    """Whether a file is watertight or valid, and its volume error."""
    if path.suffix in (".stl", ".3mf", ".glb"):
        mesh = read_mesh(path)
        return bool(mesh.is_watertight), abs(mesh.volume - model.volume) / (DEVIATION * model.area)
    shape = read_step(path).shape if path.suffix == ".step" else bd.import_brep(path)
    report = check_shape(shape)
    return report.ok, abs(report.volume - model.volume) / model.volume


def main() -> None:
    """Print the table."""
    print(f"{'result':18}{'file':6}{'closed':8}{'volume error':>13}{'MB':>8}{'seconds':>9}{'kB/face':>9}")
    for name, make in RESULTS.items():
        model = make()
        for suffix in SUFFIXES:
            with tempfile.TemporaryDirectory() as folder:
                path, begun = Path(folder) / f"part.{suffix}", time.perf_counter()
                options = {} if suffix in ("step", "brep") else {"deviation": DEVIATION}
                model.export(path, **options)
                seconds, size = time.perf_counter() - begun, path.stat().st_size
                closed, error = judge(model, path)
            per_face = f"{size / 1e3 / model.certificate.n_faces:9.2f}" if suffix in ("step", "brep") else ""
            print(f"{name:18}{suffix:6}{closed!s:8}{error:13.1e}{size / 1e6:8.2f}{seconds:9.2f}{per_face}", flush=True)


if __name__ == "__main__":
    main()
