"""Parameter curves of space curves on the body's quadrics: with the curve's parameter, interpolated until near enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Edges
from tpmscad.brep.carriers import ConicalSurface, Plane, Quadric, SphericalSurface
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.trimming.intersect.arc_fitting import CURVE_DEGREE, SPAN_COUNTS, build_interpolation
from tpmscad.trimming.operands.face_regions import FaceRegion, shift_to_period

CHECKS_PER_SPAN = 4
"""Points between knots where the deviation is measured."""

AXIS_SEARCH_INTERVALS = 32
"""Intervals in which the point of a curve nearest to an axis is looked for, again and again."""

GRADING_SPANS = 2.0
"""Angles that turn within less than this many spans get knots of their own."""

GRADING_SAMPLES = 4001
"""Points from which graded knots are read off."""

MIN_POLE_DISTANCE_TOLS = 0.1
"""Nearer to a pole than this part of the tolerance the angle is of no account."""


def fit_edge_pcurves(
    curves: Sequence[BSplineCurve], edges: Edges, edge: IntArray, region: FaceRegion, tol: float
) -> tuple[list[BSplineCurve], Array]:
    """Parameter curves of edges on a round face, and how far they are off."""
    own, (low, high) = [curves[c] for c in edges.curve[edge]], edges.span[edge].T
    part = (high - low) / np.array([c.domain[1] - c.domain[0] for c in own])  # of the curve, which was fitted as finely
    least = (part * np.array([len(c.poles) - c.degree for c in own])).astype(np.int64)
    return fit_pcurves(own, edges.motion[edge], edges.span[edge], region, tol, least)


def fit_pcurves(
    curves: Sequence[BSplineCurve],
    motion: Motion,
    span: Array,
    region: FaceRegion,
    tol: float,
    least: IntArray,
) -> tuple[list[BSplineCurve], Array]:
    """`parameter_curve` for n curves, each moved by its `motion` (n,), over spans (n, 2).

    All that need no more than `least` (n,) spans are made together.
    """
    made: list[BSplineCurve | None] = [None] * len(curves)
    error = np.zeros(len(curves))
    first = np.array(SPAN_COUNTS)[np.minimum(np.searchsorted(SPAN_COUNTS, least), len(SPAN_COUNTS) - 1)]
    for spans in np.unique(first).tolist():
        knots, sites, inverse, checks, basis = _build_uniform_space(spans)
        rows = np.flatnonzero(first == spans)
        low, high = span[rows].T
        t = low[:, None] + (high - low)[:, None] * np.concatenate([sites, checks])
        index = np.repeat(np.arange(len(rows)), t.shape[1])
        local = evaluate_curves([curves[i] for i in rows.tolist()], index, t.ravel())[0].reshape(*t.shape, 3)
        points = local @ np.swapaxes(motion.rotation[rows], 1, 2) + motion.translation[rows, None]
        on_curve, between = points[:, : len(sites)], points[:, len(sites) :]
        uv = _unwrap_parameters(region.carrier, on_curve)
        middle = uv[:, [len(sites) // 2]]
        poles = inverse @ (uv + (shift_to_period(middle, region.carrier, region.reference_parameters) - middle))
        u, v = np.moveaxis(basis @ poles, -1, 0)
        error[rows] = np.linalg.norm(region.carrier(u, v) - between, axis=2).max(axis=1)
        for k in np.flatnonzero(error[rows] < tol + np.abs(region.carrier.distance(between)).max(axis=1)):
            made[rows[k]] = BSplineCurve(poles[k].copy(), low[k] + (high[k] - low[k]) * knots, CURVE_DEGREE)
    result = []
    for i, curve in enumerate(made):
        if curve is None:
            placed = partial(_evaluate_placed_curve, curves[i], motion[i])
            curve, error[i] = fit_pcurve(placed, span[i], region, tol, int(least[i]))
        result.append(curve)
    return result, error


def _evaluate_placed_curve(curve: BSplineCurve, motion: Motion, t: Array) -> Array:
    return motion.apply(curve(t))


def fit_pcurve(
    curve: Callable[[Array], Array], span: Array, region: FaceRegion, tol: float, least: int
) -> tuple[BSplineCurve, float]:
    """The curve in the face's (u, v) that runs with `curve` over the span, and how far it is from it at most.

    least: spans to begin with.

    TrimmingError where `tol` is not reached.
    """
    low, high = float(span[0]), float(span[1])
    close = _find_closest_to_axis(lambda x: curve(low + (high - low) * x), region.carrier, tol)
    error = np.inf
    for spans in [s for s in SPAN_COUNTS if s >= least] or SPAN_COUNTS[-1:]:
        graded = close is not None and _needs_grading(close[1], spans)
        knots, sites, inverse, checks, rows = (
            _build_graded_space(spans, *close) if graded and close else _build_uniform_space(spans)
        )
        uv = _unwrap_parameters(region.carrier, curve(low + (high - low) * sites))
        uv = uv + (shift_to_period(uv[len(uv) // 2], region.carrier, region.reference_parameters) - uv[len(uv) // 2])
        poles = inverse @ uv
        u, v = (rows @ poles).T
        points = curve(low + (high - low) * checks)
        error = float(np.linalg.norm(region.carrier(u, v) - points, axis=1).max())
        if error < tol + np.abs(region.carrier.distance(points)).max():  # which no parameters can mend
            return BSplineCurve(poles, low + (high - low) * knots, CURVE_DEGREE), error
    raise TrimmingError(
        f"a cut's parameters on the body are still {error:.3g} off, near {curve(np.array([low]))[0].round(6)}"
    )


def _find_closest_to_axis(
    curve: Callable[[Array], Array], carrier: Plane | Quadric, tol: float
) -> tuple[float, float] | None:
    """Where on [0, 1] a curve passes a pole or an apex, by which angles turn quickly, and over what part of it they do."""
    if not isinstance(carrier, SphericalSurface | ConicalSurface):
        return None

    def away(x: Array) -> Array:
        arm = curve(x) - carrier.origin
        return np.asarray(np.linalg.norm(arm - (arm @ carrier.axis)[:, None] * carrier.axis, axis=1))

    low, high = 0.0, 1.0
    for _ in range(8):  # narrowed down around the nearest sample
        x = np.linspace(low, high, AXIS_SEARCH_INTERVALS + 1)
        r = away(x)
        i = int(r.argmin())
        low, high = float(x[max(i - 1, 0)]), float(x[min(i + 1, AXIS_SEARCH_INTERVALS)])
    ends = curve(np.array([low, high]))
    speed = float(np.linalg.norm(ends[1] - ends[0])) / (high - low)
    return float(x[i]), max(float(r[i]), MIN_POLE_DISTANCE_TOLS * tol) / max(speed, 1e-300)


def _needs_grading(width: float, spans: int) -> bool:
    return width * spans < GRADING_SPANS


def _build_graded_space(spans: int, at: float, width: float) -> tuple[Array, Array, Array, Array, Array]:
    """As `_space`, with knots ever denser towards `at`, to a fraction of `width` there."""
    low, high = float(np.arcsinh(-at / width)), float(np.arcsinh((1.0 - at) / width))
    s = np.linspace(low, high, GRADING_SAMPLES)
    x = at + width * np.sinh(s)
    x[[0, -1]] = 0.0, 1.0
    even = s + (high - low) * x  # half of the knots in even steps
    inner = np.interp(np.linspace(even[0], even[-1], spans + 1), even, x)[1:-1]
    knots = np.concatenate([np.zeros(CURVE_DEGREE + 1), inner, np.ones(CURVE_DEGREE + 1)])
    sites = np.array([knots[i + 1 : i + CURVE_DEGREE + 1].mean() for i in range(spans + CURVE_DEGREE)])
    ends = knots[CURVE_DEGREE:-CURVE_DEGREE]
    checks = np.unique(ends[:-1, None] + np.diff(ends)[:, None] * np.linspace(0.0, 1.0, CHECKS_PER_SPAN + 1))
    inverse = np.asarray(np.linalg.inv(design_matrix(knots, CURVE_DEGREE, sites)))
    return knots, sites, inverse, checks, design_matrix(knots, CURVE_DEGREE, checks)


def _unwrap_parameters(carrier: Plane | Quadric, points: Array) -> Array:
    uv = carrier.parameters(points)
    for axis, period in enumerate(carrier.period):
        if period:
            uv[..., axis] = np.unwrap(uv[..., axis], period=period)
    return uv


@lru_cache(maxsize=16)
def _build_uniform_space(spans: int) -> tuple[Array, Array, Array, Array, Array]:
    """Knots, Greville sites and the inverse of interpolation there; places between, and the basis there."""
    knots, sites, inverse = build_interpolation(spans)
    checks = np.linspace(0.0, 1.0, CHECKS_PER_SPAN * spans + 1)
    return knots, sites, inverse, checks, design_matrix(knots, CURVE_DEGREE, checks)
