"""Cut curves as B-splines: one parameter for the parameter curve on the patch and the curve in space, fitted in batches.

Sites lie exactly on the cut. Interpolation is linear, so a space curve through sites in a plane lies in the plane to round-off;
what is left to measure is |S(pc(t)) - C(t)|; on curved surfaces also the curve's distance from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import TrimmingError
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.trimming.intersect.curve_parametrisation import PatchSurfacePairs, map_foci_to_space
from tpmscad.trimming.operands.implicit_surfaces import ImplicitSurfaces

CURVE_DEGREE = 7
SPAN_COUNT_STAGES = ((4, 6, 8), (11, 16), (23, 32), (45, 64), (91, 128), (181,))
SPAN_COUNTS = tuple(spans for stage in SPAN_COUNT_STAGES for spans in stage)
"""Degree and numbers of spans. Measured on 189 random cuts of a gyroid patch at 5e-9 of the cell: on average 26 poles, as
with degree 9; 28 with degrees 5 and 13; 30 if the spans are doubled each time. Numbers of a stage share the points by which
length and turning are measured; those are skipped that leave too much of the last error even at the full order of convergence."""

NODES_PER_SPAN = 4
"""Points along a curve for each span of a stage's last number, which carry its length and turning. With 8 there are as many
poles in the end."""

INITIAL_PATH_POINTS = NODES_PER_SPAN * SPAN_COUNT_STAGES[0][-1] + 1
"""Points of the coarse paths that are brought onto the cuts first; curves with foci keep all that they have."""

CHECKS_PER_SPAN = 5
"""Points between knots where the deviation is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedArc:
    """A cut curve on one patch: parameter curve and space curve (in the patch's own frame) on [0, 1], measured deviation."""

    pcurve: BSplineCurve
    curve: BSplineCurve
    deviation: float


def fit_arcs(
    surfaces: Sequence[BSplineSurface],
    levels: ImplicitSurfaces,
    paths: Sequence[Array],
    foci: Sequence[Array],
    tol: float,
) -> tuple[FittedArc, ...]:
    """The sections of surfaces by n levels along coarse paths with exact ends, within tol.

    surfaces: one for each path, all of one spline space.

    foci: for each path points (k, 3) of (u, v) and radius there, about which it may turn sharply.
    Ends may be off their level (by less than a snap): the parameter curve starts there, the space curve in the level's zeros.
    """
    if not paths:
        return ()
    s = surfaces[0]
    poles, space = np.stack([surface.poles for surface in surfaces]), (s.knots_u, s.knots_v, s.degree_u, s.degree_v)
    sections = PatchSurfacePairs(poles, space, levels, map_foci_to_space(surfaces, foci))
    result: list[FittedArc | None] = [None] * len(paths)
    sharp = np.array([len(own) > 0 for own in foci])
    calm = [
        path if own else _thin_path(path, INITIAL_PATH_POINTS) for path, own in zip(paths, sharp.tolist(), strict=True)
    ]
    for waiting in (np.flatnonzero(~sharp), np.flatnonzero(sharp)):
        error = np.zeros(0)
        for problem in (sections, sections.without_foci()):  # far foci may do harm
            if len(waiting) == 0:
                break
            problem = problem.of(waiting)
            found, error = _fit_fewest_spans(
                problem,
                problem.project_inner_sites(_refine_paths([calm[i] for i in waiting], INITIAL_PATH_POINTS)),
                tol,
            )
            for i, cut in zip(waiting.tolist(), found, strict=True):
                result[i] = cut
            waiting = waiting[[cut is None for cut in found]]
        if len(waiting):
            raise TrimmingError(
                f"a cut curve is still {error.max():.3g} from its patch with {SPAN_COUNTS[-1]} spans, over {tol:.3g}"
            )
    return tuple(c for c in result if c is not None)


def _fit_fewest_spans(sections: PatchSurfacePairs, uv: Array, tol: float) -> tuple[list[FittedArc | None], Array]:
    """Curves with as few spans as will do, None where the most do not, and how far those are off."""
    result: list[FittedArc | None] = [None] * len(uv)
    waiting, error, tried = np.arange(len(uv)), np.full(len(uv), np.inf), np.ones(len(uv))
    limit = np.maximum(tol, 1.01 * sections.off(uv[:, [0, -1]]).max(axis=1))  # snapped ends are off by their snap
    spread = sections.parametrise(uv)
    for stage in SPAN_COUNT_STAGES:
        problem = sections.of(waiting)
        spread = problem.parametrise(problem.sampled(spread, np.linspace(0.0, 1.0, NODES_PER_SPAN * stage[-1] + 1)))
        done = np.zeros(len(waiting), bool)
        for spans in stage:
            hopeless = np.isfinite(error) & (error * (tried / spans) ** (CURVE_DEGREE + 1) > limit)
            rows = np.flatnonzero(~done & (~hopeless | (spans == SPAN_COUNTS[-1])))
            if len(rows) == 0:
                continue
            own = problem.of(rows)
            knots, sites, inverse = build_interpolation(spans)
            on_curve = own.sampled(spread.of(rows), sites)
            pcurve, curve = inverse @ on_curve, inverse @ own.dropped(own.points(on_curve))
            error[rows], tried[rows] = _measure_deviation(own, pcurve, curve, spans), spans
            good = np.flatnonzero(error[rows] <= limit[rows])
            for k in good:
                cut = (
                    BSplineCurve(pcurve[k].copy(), knots, CURVE_DEGREE),
                    BSplineCurve(curve[k].copy(), knots, CURVE_DEGREE),
                )
                result[waiting[rows[k]]] = FittedArc(*cut, float(error[rows[k]]))
            done[rows[good]] = True
        waiting, spread, limit = waiting[~done], spread.of(np.flatnonzero(~done)), limit[~done]
        error, tried = error[~done], tried[~done]
        if len(waiting) == 0:
            break
    return result, error


def _thin_path(path: Array, most: int) -> Array:
    """At most so many points of a path, its ends among them."""
    return path[np.round(np.linspace(0, len(path) - 1, min(most, len(path)))).astype(int)]


def _refine_paths(paths: Sequence[Array], least: int) -> Array:
    """Polylines brought to one number of points, at least `least`, by halving longest segments: (n, m, 2)."""
    count = max(least, max(len(path) for path in paths))
    result = []
    for path in paths:
        while len(path) < count:
            length = np.linalg.norm(np.diff(path, axis=0), axis=1)
            at = np.sort(np.argsort(-length, kind="stable")[: count - len(path)])
            path = np.insert(path, at + 1, 0.5 * (path[at] + path[at + 1]), axis=0)
        result.append(path)
    return np.stack(result)


def _measure_deviation(problem: PatchSurfacePairs, pcurve: Array, curve: Array, spans: int) -> Array:
    t = np.linspace(0.0, 1.0, spans * CHECKS_PER_SPAN + 1)
    rows = design_matrix(build_interpolation(spans)[0], CURVE_DEGREE, t)
    in_space = rows @ curve
    off = np.linalg.norm(problem.points(rows @ pcurve) - in_space, axis=2).max(axis=1)
    if problem.levels.flat.all():  # the curve lies in the plane
        return off
    return np.asarray(np.maximum(off, np.abs(problem.levels.value(in_space)).max(axis=1)))


@lru_cache(maxsize=16)
def build_interpolation(spans: int) -> tuple[Array, Array, Array]:
    """Knots, Greville sites, and the inverse of interpolation there."""
    knots = np.concatenate([np.zeros(CURVE_DEGREE), np.arange(spans + 1) / spans, np.ones(CURVE_DEGREE)])
    sites = np.array([knots[i + 1 : i + CURVE_DEGREE + 1].mean() for i in range(spans + CURVE_DEGREE)])
    return knots, sites, np.asarray(np.linalg.inv(design_matrix(knots, CURVE_DEGREE, sites)))
