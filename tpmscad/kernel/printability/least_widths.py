"""The smallest wall and the smallest gap of OCCT shapes, each with a lower bound (`tpmscad.brep.least_width`).

The bound comes from cells of the faces, the value from two places on the faces themselves: Newton's method makes the segment
between them normal to both. Its steps are those of least length, since parallel sides are as near everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.least_width import LeastWidth, SharpEdges, find_least_widths
from tpmscad.kernel.measure.shape_extents import face_contains
from tpmscad.kernel.measure.shape_report import ShapeReport
from tpmscad.kernel.measure.shape_sampling import find_creases
from tpmscad.kernel.occt.exploration import faces_of, solids_of
from tpmscad.kernel.occt.geometry_evaluators import face_evaluator
from tpmscad.kernel.printability.face_cells import face_cells

EDGE_SPACING = 0.25
"""Distance of samples of sharp edges, in units of volume / area, which is half the wall of a sheet."""

FIRST_CELL_TOL = 0.05
"""Distance between cells and faces at first, in units of volume / area."""

NEWTON_STEPS = 12
"""Steps towards the stationary distance; four or five reach round-off."""

STATIONARY_SINE = 1e-9
"""Sine of the angle between segment and normal at which a distance counts as stationary."""

SINGULAR_RATIO = 1e-6
"""Singular values below this fraction of the largest do not move the ends: the sides are parallel in that direction."""

DIFFERENCE = 1e-6
"""Step of differences in parameters, as a fraction of their size."""

MAX_SHIFT = 2.0
"""Greatest way of the ends in Newton's steps, in widths: a segment farther away is another one."""

MAX_CHANGE = 0.05
"""Greatest part of the width by which these steps may change it."""

CLASSIFIER_TOL = 1e-7
"""Distance in parameters below which the kernel's classifier puts a point on the border of a face."""


def measure_least_widths(shape: object, report: ShapeReport) -> tuple[LeastWidth | None, LeastWidth | None]:
    """The smallest wall and the smallest gap of the closed solids of a shape; None where no sides face each other.

    The bound is at most 2 % of the value below it, or states what could not be decided.
    """
    faces, solids = faces_of(shape), solids_of(shape)
    solid = np.repeat(np.arange(len(solids)), [len(faces_of(each)) for each in solids])
    scale = report.volume / report.area
    creases = find_creases(faces, EDGE_SPACING * scale)
    edges = SharpEdges(creases.points, np.sort(creases.smooth_group[creases.faces], axis=1), EDGE_SPACING * scale)
    cells = face_cells(faces, FIRST_CELL_TOL * scale)
    found = find_least_widths(cells, creases.smooth_group, solid, edges)
    wall, gap = (None if width is None else _refine(faces, width) for width in found)
    return wall, gap


def _refine(faces: Sequence[TopoDS_Face], found: LeastWidth) -> LeastWidth:
    """The width between places on the faces themselves, made normal to both where that is near."""
    pair = [faces[k] for k in found.faces]
    surfaces = [face_evaluator(face) for face in pair]

    def ends(uv: Array) -> Array:
        """Ends (n, 2, 3) of segments at parameters (n, 2, 2)."""
        return np.stack([surfaces[k](uv[:, k])[0] for k in (0, 1)], axis=1)

    def slopes(uv: Array) -> Array:
        """Cosines (n, 4) between segments at parameters (n, 2, 2) and the tangents of both faces."""
        jets = [surfaces[k](uv[:, k]) for k in (0, 1)]
        chord = jets[0][0] - jets[1][0]
        chord = chord / np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-300)
        tangents = [jet[k] for jet in jets for k in (1, 2)]
        return np.stack(
            [(chord * t).sum(axis=1) / np.maximum(np.linalg.norm(t, axis=1), 1e-300) for t in tangents], axis=1
        )

    def width(uv: Array) -> float:
        """Length of the segment at parameters (2, 2)."""
        first, second = ends(uv[None])[0]
        return float(np.linalg.norm(second - first))

    start = ends(found.parameters[None])[0]
    uv, reach = found.parameters, MAX_SHIFT * found.value
    step = DIFFERENCE * max(1.0, float(np.abs(uv).max()))
    for _ in range(NEWTON_STEPS):
        moved = np.concatenate([uv.reshape(1, 4), uv.reshape(1, 4) + step * np.eye(4)]).reshape(5, 2, 2)
        values = slopes(moved)
        if np.abs(values[0]).max() < STATIONARY_SINE:
            break
        change = np.linalg.lstsq((values[1:] - values[0]).T / step, -values[0], rcond=SINGULAR_RATIO)[0]
        uv = uv + change.reshape(2, 2)
        if np.linalg.norm(ends(uv[None])[0] - start, axis=1).max() > reach:
            uv = found.parameters
            break
    settled = bool(np.abs(slopes(uv[None])).max() < np.sqrt(STATIONARY_SINE))
    if not (
        settled
        and all(face_contains(face, at, CLASSIFIER_TOL) for face, at in zip(pair, uv, strict=True))
        and abs(width(uv) - found.value) < MAX_CHANGE * found.value
    ):
        uv = found.parameters
    value, places = width(uv), ends(uv[None])[0]
    return replace(found, bound=min(found.bound, value), value=value, places=places, parameters=uv)
