"""One gyroid sheet as a STEP file, three ways: this program, microgen from PyPI, and flat facets at the deviation of ours.

    python -m benchmarks.comparison [--python PATH]

The solid is |f| < 0.3 in one cell of edge 1, f = sin x cos y + sin y cos z + sin z cos x. microgen runs in an environment of its
own, made for the purpose, or in that of the interpreter PATH. Every file is read by the same kernel, and judged by points on the
faces that the reader finds: their distance from |f| = 0.3, to first order; faces in the box's planes are left out.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.TopAbs import TopAbs_SOLID
from OCP.TopLoc import TopLoc_Location

import tpmscad
from benchmarks.facets import Array, facets
from tpmscad import fields
from tpmscad.kernel.occt.exploration import faces_of, list_subshapes
from tpmscad.kernel.step.step_reader import read_step

LEVEL = 0.3
LOW, HIGH = np.full(3, -0.5), np.full(3, 0.5)
TOL = 5e-3
"""Deviation asked of this program, in cells: about microgen's own at its default resolution."""

PEER = "microgen==1.3.2"
PEER_SCRIPT = """
import sys, time
begun = time.process_time()
import cadquery, microgen
shape = microgen.Tpms(surface_function=microgen.surface_functions.gyroid, offset=0.6, resolution=20).generate(type_part="sheet")
cadquery.exporters.export(cadquery.Workplane(obj=shape), sys.argv[1])
print(time.process_time() - begun)
"""


def gyroid(points: Array) -> tuple[Array, Array]:
    """f and its gradient (n, 3) at points (n, 3)."""
    s, c = np.sin(2 * np.pi * points), np.cos(2 * np.pi * points)
    following = np.roll(np.arange(3), -1)
    value = (s * c[:, following]).sum(axis=1)
    before = np.roll(np.arange(3), 1)
    return value, 2 * np.pi * (c * c[:, following] - s * s[:, before])


def surface_points(path: Path) -> tuple[int, int, Array]:
    """The number of faces and of solids of a STEP file, and a point of its surfaces for each triangle of the kernel's mesh."""
    shape = read_step(path).shape
    BRepMesh_IncrementalMesh(shape, 2e-3, False, 0.3)
    found = []
    faces = faces_of(shape)
    for face in faces:
        mesh = BRep_Tool.Triangulation_s(face, TopLoc_Location())
        if mesh is None:
            continue
        surface = BRep_Tool.Surface_s(face)
        for k in range(1, mesh.NbTriangles() + 1):
            at = [mesh.UVNode(node) for node in mesh.Triangle(k).Get()]
            point = surface.Value(sum(p.X() for p in at) / 3, sum(p.Y() for p in at) / 3)
            found.append((point.X(), point.Y(), point.Z()))
    return len(faces), len(list_subshapes(shape, TopAbs_SOLID)), np.array(found)


def measure_deviation(points: Array) -> float:
    """Greatest distance from |f| = LEVEL of points off the box's planes, to first order."""
    inner = points[(np.abs(np.abs(points) - 0.5) > 1e-6).all(axis=1)]
    value, gradient = gyroid(inner)
    return float((np.abs(np.abs(value) - LEVEL) / np.linalg.norm(gradient, axis=1)).max())


def print_row(name: str, path: Path, seconds: float) -> float:
    """Print a row of the table, and return the deviation."""
    faces, solids, points = surface_points(path)
    deviation = measure_deviation(points)
    print(f"{name:34s}{faces:8d}{path.stat().st_size / 1e6:9.2f}{seconds:9.1f}{solids:8d}{deviation:11.1e}", flush=True)
    return deviation


def peer_python(folder: Path) -> Path:
    """The interpreter of a new environment with the peer."""
    subprocess.run([sys.executable, "-m", "venv", folder / "peer"], check=True)
    python = folder / "peer" / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", PEER], check=True)
    return python


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--python", type=Path, help=f"interpreter of an environment with {PEER}; without it, one is made"
    )
    given = parser.parse_args().python
    field = fields.sheet(fields.tpms("gyroid", 1.0), -LEVEL, LEVEL)
    at = np.random.default_rng(0).uniform(-1, 1, (100, 3))
    np.testing.assert_allclose(
        fields.tpms("gyroid", 1.0)(at), gyroid(at)[0], atol=1e-12
    )  # the same solid is asked of all
    print(f"{'':34s}{'faces':>8s}{'MB':>9s}{'CPU s':>9s}{'solids':>8s}{'deviation':>11s}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begun = time.process_time()
        model = tpmscad.solidify(field, (tuple(LOW), tuple(HIGH)), tol=TOL)
        model.export_step(folder / "ours.step")
        deviation = print_row(f"tpmscad, tol {TOL:g}", folder / "ours.step", time.process_time() - begun)
        print(
            f"{'flat facets at that deviation':34s}{facets(field, LOW, HIGH, deviation)}   (* scaled from a part)",
            flush=True,
        )
        python = given or peer_python(folder)
        run = [python, "-c", PEER_SCRIPT, folder / "peer.step"]
        answer = subprocess.run(run, capture_output=True, text=True, check=True)
        print_row(f"{PEER}, resolution 20", folder / "peer.step", float(answer.stdout.split()[-1]))


if __name__ == "__main__":
    main()
