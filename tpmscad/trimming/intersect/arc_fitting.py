"""Fitting of arcs by B-splines: a pcurve on the patch and a space curve with a common parameter, in batches.

The interpolation sites are projected onto the intersection exactly. Interpolation is linear in the sites, so a space curve
through sites in a plane lies in the plane to round-off. What remains to be measured is |S(p(t)) - C(t)| for the pcurve p and the
space curve C and, unless the surface is a plane, the distance of C from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import UntracedCurve
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.knots import greville_abscissae
from tpmscad.trimming.intersect.arrangement import FittedArc
from tpmscad.trimming.intersect.curve_parametrisation import PatchSurfacePairs, map_foci_to_space
from tpmscad.trimming.operands.quadric_table import QuadricTable

CURVE_DEGREE = 7
"""Degree of fitted curves: among 5 to 13 it needs the fewest poles, together with 9."""

SPAN_COUNT_STAGES = ((4, 6, 8), (11, 16), (23, 32), (45, 64), (91, 128), (181,))
"""Numbers of spans that are tried, in stages; those of a stage share the points that carry arc length and turning."""

SPAN_COUNTS = tuple(spans for stage in SPAN_COUNT_STAGES for spans in stage)

NODES_PER_SPAN = 4
"""Points that carry arc length and turning, per span of the last number of a stage."""

INITIAL_PATH_POINTS = NODES_PER_SPAN * SPAN_COUNT_STAGES[0][-1] + 1
"""Points of a coarse path that are projected first; paths with foci keep all of theirs."""

CHECKS_PER_SPAN = 5
"""Points per span at which the deviation is measured."""

END_DEVIATION_MARGIN = 1.01
"""Factor on the deviation of an arc's ends, which are off by the vertex tolerance; it bounds the arc's from below."""


@dataclass(frozen=True, slots=True, eq=False)
class CoarsePath:
    """A path (m, 2) in (u, v) near an arc, with exact ends, and the foci (k, 3) of the arc: (u, v) and radius in (u, v)."""

    points: Array
    foci: Array


def fit_arcs(
    patches: Sequence[BSplineSurface], implicit: QuadricTable, paths: Sequence[CoarsePath], tol: float
) -> tuple[FittedArc, ...]:
    """The arcs of n patches of one spline space with n implicit surfaces along n paths, within tol.

    An end of a path may be off its surface by less than the vertex tolerance: the pcurve ends there, the space curve at the
    nearest point of the surface. TrimmingError if the tolerance is not reached.
    """
    if not paths:
        return ()
    s = patches[0]
    poles, space = np.stack([patch.poles for patch in patches]), (s.knots_u, s.knots_v, s.degree_u, s.degree_v)
    pairs = PatchSurfacePairs(poles, space, implicit, map_foci_to_space(patches, [path.foci for path in paths]))
    result: list[FittedArc | None] = [None] * len(paths)
    has_foci = np.array([len(path.foci) > 0 for path in paths])
    initial = [path.points if len(path.foci) else _thin_path(path.points, INITIAL_PATH_POINTS) for path in paths]
    for pending in (np.flatnonzero(~has_foci), np.flatnonzero(has_foci)):
        error = np.zeros(0)
        # Grading towards distant foci may be harmful; a patch that is nearly singular needs grading of its own; and where the
        # curvature passes zero steeply, the parameter varies faster than the curve: 2e-7 remain that way at 181 spans, 4e-9
        # with arc length alone.
        for graded in (pairs, pairs.without_foci(), pairs.following_pcurves(), pairs.following_arc_length()):
            if len(pending) == 0:
                break
            problem = graded.take(pending)
            refined = _refine_paths([initial[i] for i in pending], INITIAL_PATH_POINTS)
            found, error = _fit_fewest_spans(problem, problem.project_inner_sites(refined), tol)
            for i, arc in zip(pending.tolist(), found, strict=True):
                result[i] = arc
            pending = pending[[arc is None for arc in found]]
        if len(pending):
            raise UntracedCurve(
                f"an intersection curve deviates by {error.max():.3g} from its patch with {SPAN_COUNTS[-1]} spans; "
                f"the tolerance is {tol:.3g}"
            )
    return tuple(arc for arc in result if arc is not None)


def _fit_fewest_spans(pairs: PatchSurfacePairs, uv: Array, tol: float) -> tuple[list[FittedArc | None], Array]:
    """Curves with the fewest spans that reach the tolerance, None where none does, and the errors of the latter."""
    result: list[FittedArc | None] = [None] * len(uv)
    pending, error, last_spans = np.arange(len(uv)), np.full(len(uv), np.inf), np.ones(len(uv))
    limit = np.maximum(tol, END_DEVIATION_MARGIN * pairs.distances(uv[:, [0, -1]]).max(axis=1))
    even = pairs.parametrise(uv)
    for stage in SPAN_COUNT_STAGES:
        problem = pairs.take(pending)
        even = problem.parametrise(problem.evaluate_at(even, np.linspace(0.0, 1.0, NODES_PER_SPAN * stage[-1] + 1)))
        done = np.zeros(len(pending), bool)
        for spans in stage:
            cannot_reach_tol = np.isfinite(error) & (error * (last_spans / spans) ** (CURVE_DEGREE + 1) > limit)
            rows = np.flatnonzero(~done & (~cannot_reach_tol | (spans == SPAN_COUNTS[-1])))
            if len(rows) == 0:
                continue
            own = problem.take(rows)
            knots, sites, inverse = build_interpolation(spans)
            on_curve = own.evaluate_at(even.take(rows), sites)
            pcurve, curve = inverse @ on_curve, inverse @ own.project_to_surfaces(own.points(on_curve))
            error[rows], last_spans[rows] = _measure_deviation(own, pcurve, curve, spans), spans
            good = np.flatnonzero(error[rows] <= limit[rows])
            for k in good:
                result[pending[rows[k]]] = FittedArc(
                    BSplineCurve(pcurve[k].copy(), knots, CURVE_DEGREE),
                    BSplineCurve(curve[k].copy(), knots, CURVE_DEGREE),
                    float(error[rows[k]]),
                )
            done[rows[good]] = True
        pending, even, limit = pending[~done], even.take(np.flatnonzero(~done)), limit[~done]
        error, last_spans = error[~done], last_spans[~done]
        if len(pending) == 0:
            break
    return result, error


def _thin_path(path: Array, most: int) -> Array:
    """At most `most` points of a path, its ends included."""
    return path[np.round(np.linspace(0, len(path) - 1, min(most, len(path)))).astype(int)]


def _refine_paths(paths: Sequence[Array], least: int) -> Array:
    """Polylines with one number of points, at least `least`, by bisecting the longest segments: (n, m, 2)."""
    count = max(least, max(len(path) for path in paths))
    result = []
    for path in paths:
        while len(path) < count:
            length = np.linalg.norm(np.diff(path, axis=0), axis=1)
            at = np.sort(np.argsort(-length, kind="stable")[: count - len(path)])
            path = np.insert(path, at + 1, 0.5 * (path[at] + path[at + 1]), axis=0)
        result.append(path)
    return np.stack(result)


def _measure_deviation(pairs: PatchSurfacePairs, pcurve: Array, curve: Array, spans: int) -> Array:
    """Largest sampled deviation (n,) of the space curves from the pcurves on the patches, and from the surfaces."""
    t = np.linspace(0.0, 1.0, spans * CHECKS_PER_SPAN + 1)
    rows = design_matrix(build_interpolation(spans)[0], CURVE_DEGREE, t)
    in_space = rows @ curve
    off = np.linalg.norm(pairs.points(rows @ pcurve) - in_space, axis=2).max(axis=1)
    if pairs.surfaces.is_plane.all():  # the space curve lies in the plane
        return off
    return np.asarray(np.maximum(off, np.abs(pairs.surfaces.value(in_space)).max(axis=1)))


@lru_cache(maxsize=16)
def build_interpolation(spans: int) -> tuple[Array, Array, Array]:
    """Uniform knots, their Greville sites, and the inverse of the collocation matrix there."""
    knots = np.concatenate([np.zeros(CURVE_DEGREE), np.arange(spans + 1) / spans, np.ones(CURVE_DEGREE)])
    sites = greville_abscissae(knots, CURVE_DEGREE)
    return knots, sites, np.asarray(np.linalg.inv(design_matrix(knots, CURVE_DEGREE, sites)))
