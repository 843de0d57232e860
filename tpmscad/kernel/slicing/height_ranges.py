"""Heights between which faces lie: a B-spline lies in the convex hull of its poles."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.kernel.export.solid_mesh import FaceTriangulation
from tpmscad.kernel.occt.geometry_evaluators import (
    ConicEvaluator,
    CurveEvaluator,
    CurveTable,
    LineEvaluator,
    PlaneEvaluator,
    RevolutionEvaluator,
    SplineCurveEvaluator,
    SplineSurfaceEvaluator,
    SurfaceEvaluator,
)
from tpmscad.kernel.slicing.level_crossings import Chords

HEIGHT_MARGIN = 1e-3
"""Height added to every range, in sizes of the solid: edges may lie beside the surfaces of their faces."""

PARAMETER_MARGIN = 0.25
"""In extents of a face in its parameters: how far a face on a quadric may reach beyond the nodes of its triangulation. Between
two nodes an edge turns by half a radian at most, and so leaves its chord by a sixteenth of its length."""


def bound_heights(found: FaceTriangulation, curves: CurveTable, chords: Chords, face: IntArray, size: float) -> Array:
    """Heights (r, 2) between which triangulated faces lie, of whose edges there are chords (k,), each of a face (k,)."""
    ranges, begin = np.empty((len(found.begin) - 1, 2)), found.begin.tolist()
    for r, (surface, first, last) in enumerate(zip(found.surfaces.evaluators, begin[:-1], begin[1:], strict=True)):
        z, (low, high) = found.mesh.points[first:last, 2], _bound_surface(surface, found.mesh.uv[first:last])
        ranges[r] = min(low, z.min()), max(high, z.max())
    of_curve = np.array([_bound_poles(curve) for curve in curves.evaluators]).reshape(-1, 2)[chords.curve]
    np.minimum.at(ranges[:, 0], face, of_curve[:, 0])
    np.maximum.at(ranges[:, 1], face, of_curve[:, 1])
    return ranges + HEIGHT_MARGIN * size * np.array([-1.0, 1.0])


def _bound_surface(evaluator: SurfaceEvaluator, uv: Array) -> tuple[float, float]:
    """Heights between which the inside of a face with nodes at parameters (n, 2) lies, if its edges do."""
    if not isinstance(evaluator, RevolutionEvaluator):
        return _bound_poles(evaluator)
    margin = PARAMETER_MARGIN * np.ptp(uv, axis=0)
    return evaluator.bound_heights(uv.min(axis=0) - margin, uv.max(axis=0) + margin)


def _bound_poles(evaluator: SurfaceEvaluator | CurveEvaluator) -> tuple[float, float]:
    """Heights between which a surface or curve lies: those of its poles.

    Planes and straight lines add nothing to the nodes of the triangulation.
    """
    if isinstance(evaluator, ConicEvaluator):
        z, reach = float(evaluator.origin[2]), float(np.hypot(evaluator.major[2], evaluator.minor[2]))
        return z - reach, z + reach
    if isinstance(evaluator, SplineSurfaceEvaluator | SplineCurveEvaluator):
        z = evaluator.spline.poles[..., 2]
        return float(z.min()), float(z.max())
    return (np.inf, -np.inf) if isinstance(evaluator, PlaneEvaluator | LineEvaluator) else (-np.inf, np.inf)
