"""The other way to a STEP file: marching cubes, a planar face for each triangle, the kernel's writer. For comparison only."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Builder
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeVertex
from OCP.gp import gp_Pnt
from OCP.TopoDS import TopoDS_Shell, TopoDS_Solid, TopoDS_Wire
from skimage.measure import marching_cubes

from tpmscad.fields import Field
from tpmscad.kernel.export.shape_file import write_shape

Array = NDArray[np.float64]

MOST = 4000
"""Triangles built and written; of more, a part of so many is, and time and size are scaled: both grow in proportion."""

FAR = 1e9
"""The field's value outside the box: the isosurface then closes on the box's faces."""


@dataclass(frozen=True, slots=True)
class Facets:
    """What triangles cost: how many, MB of STEP, CPU seconds from field to file, and their deviation from the level set.

    `timed` is how many were really built and written.
    """

    count: int
    megabytes: float
    seconds: float
    deviation: float
    timed: int

    def __str__(self) -> str:
        scaled = "" if self.timed == self.count else "*"
        return f"{self.count:8d} {self.megabytes:8.1f}{scaled} {self.seconds:7.1f}{scaled}"


def facets(field: Field, low: Array, high: Array, deviation: float) -> Facets:
    """Marching cubes on the grid that reaches the deviation, found from its second order, and its STEP file."""
    trial, _, _ = _cubes(field, low, high, 64)
    lines = int(np.ceil(64 * (_deviation(field, trial) / deviation) ** 0.5))
    begun = time.process_time()
    triangles, points, corners = _cubes(field, low, high, lines)
    meshed = time.process_time() - begun
    timed = min(MOST, len(corners))
    begun = time.process_time()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "facets.step"
        middle = (len(corners) - timed) // 2  # the first ones may all lie in one face of the box
        write_shape(_solid(points, corners[middle : middle + timed]), path)
        size = path.stat().st_size / 1e6
    share = len(corners) / timed
    written = time.process_time() - begun
    return Facets(len(corners), size * share, meshed + written * share, _deviation(field, triangles), timed)


def _cubes(field: Field, low: Array, high: Array, lines: int) -> tuple[Array, Array, NDArray[np.int64]]:
    """Triangles off the box (n, 3, 3), and all points and corners, on about so many grid lines along the longest edge."""
    step = float((high - low).max()) / lines
    counts = np.ceil((high - low) / step).astype(int)
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    values = np.pad(field.on_grid(*axes), 1, constant_values=FAR)
    points, corners, _, _ = marching_cubes(values, 0.0, spacing=tuple((high - low) / counts))
    points = np.asarray(points + low - (high - low) / counts, float)
    area = np.linalg.norm(np.cross(*(points[corners[:, k]] - points[corners[:, 0]] for k in (1, 2))), axis=1)
    corners = corners[area > 1e-9 * step**2]
    triangles = points[corners]
    inside = ((triangles > low + step) & (triangles < high - step)).all(axis=(1, 2))
    return triangles[inside], points, corners


def _deviation(field: Field, triangles: Array) -> float:
    """The greatest distance from the level set, to first order, of the triangles' corners, middles and edges' middles."""
    probes = np.concatenate(
        [
            triangles.reshape(-1, 3),
            triangles.mean(axis=1),
            (0.5 * (triangles + np.roll(triangles, 1, axis=1))).reshape(-1, 3),
        ]
    )
    value, slope = field.value_and_gradient(probes)
    return float((np.abs(value) / np.linalg.norm(slope, axis=1)).max())


def _solid(points: Array, corners: NDArray[np.int64]) -> TopoDS_Solid:
    """Planar faces on shared edges; open where the triangles are."""
    builder, shell, solid = BRep_Builder(), TopoDS_Shell(), TopoDS_Solid()
    builder.MakeShell(shell)
    used = {i: BRepBuilderAPI_MakeVertex(gp_Pnt(*points[i].tolist())).Vertex() for i in np.unique(corners).tolist()}
    edges: dict[tuple[int, int], object] = {}
    for triangle in corners.tolist():
        wire = TopoDS_Wire()
        builder.MakeWire(wire)
        for i, j in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            key = (min(i, j), max(i, j))
            if key not in edges:
                edges[key] = BRepBuilderAPI_MakeEdge(used[key[0]], used[key[1]]).Edge()
            builder.Add(wire, edges[key] if (i, j) == key else edges[key].Reversed())
        wire.Closed(True)
        builder.Add(shell, BRepBuilderAPI_MakeFace(wire, True).Face())
    builder.MakeSolid(solid)
    builder.Add(solid, shell)
    return solid
