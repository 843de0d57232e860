"""Pcurves of space curves on the body's quadrics, with the parameter of the space curve, by interpolation.

The space curve is mapped to the carrier's parameters at Greville sites and interpolated with more and more spans, until the
pcurve's image is within the tolerance of the curve. Near a pole of a surface or the apex of a cone the angle varies within a
small part of the curve; there the knots are graded: they are uniform in arsinh of the distance along the curve.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Edges
from tpmscad.brep.carriers import ConicalSurface, SphericalSurface
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.splines.knots import greville_abscissae
from tpmscad.trimming.intersect.arc_fitting import CURVE_DEGREE, SPAN_COUNTS, build_interpolation
from tpmscad.trimming.operands.face_regions import FaceRegion, shift_to_period

CHECKS_PER_SPAN = 4
"""Points per span at which the deviation is measured."""

AXIS_SEARCH_INTERVALS = 32
"""Intervals of each step of the search for the point of a curve nearest to an axis."""

AXIS_SEARCH_STEPS = 8
"""Steps of this search; each narrows it down to the two intervals about the nearest sample."""

GRADING_SPANS = 2.0
"""Number of spans below which an angle that varies within them needs graded knots."""

GRADING_SAMPLES = 4001
"""Samples of the grading function, from which the knots are interpolated."""

MIN_POLE_DISTANCE_TOLS = 0.1
"""Distance from a pole, in tolerances, below which the angle has no effect."""

MIN_SPEED = 1e-300
"""Lower bound of a curve's speed used as a divisor."""


class _PcurveSpace(NamedTuple):
    """A spline space on [0, 1]: knots, Greville sites, the inverse of the collocation matrix, check points, the basis there."""

    knots: Array
    sites: Array
    inverse: Array
    checks: Array
    basis: Array


def fit_edge_pcurves(
    curves: Sequence[BSplineCurve], edges: Edges, edge: IntArray, region: FaceRegion, tol: float
) -> tuple[list[BSplineCurve], Array]:
    """Pcurves of the edges `edge` (n,) on a curved face of the body, and their deviations (n,)."""
    own, (low, high) = [curves[c] for c in edges.curve[edge]], edges.span[edge].T
    part = (high - low) / np.array(
        [c.domain[1] - c.domain[0] for c in own]
    )  # the pcurve starts with the curve's density of spans
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
    """Pcurves of n curves, each placed by its `motion` (n,), over the spans (n, 2), and their deviations (n,).

    The curves for which `least` (n,) spans suffice are interpolated in batches, the others one by one by `fit_pcurve`.
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
    """The pcurve of `curve` over the span, with the same parameter, and its largest sampled deviation.

    least: the smallest number of spans to try. TrimmingError if the tolerance is not reached.
    """
    low, high = float(span[0]), float(span[1])
    close = _find_closest_to_axis(lambda x: curve(low + (high - low) * x), region.carrier, tol)
    error = np.inf
    for spans in [s for s in SPAN_COUNTS if s >= least] or SPAN_COUNTS[-1:]:
        is_graded = close is not None and close[1] * spans < GRADING_SPANS
        space = _build_graded_space(spans, *close) if close and is_graded else _build_uniform_space(spans)
        knots, sites, inverse, checks, rows = space
        uv = _unwrap_parameters(region.carrier, curve(low + (high - low) * sites))
        uv = uv + (shift_to_period(uv[len(uv) // 2], region.carrier, region.reference_parameters) - uv[len(uv) // 2])
        poles = inverse @ uv
        u, v = (rows @ poles).T
        points = curve(low + (high - low) * checks)
        error = float(np.linalg.norm(region.carrier(u, v) - points, axis=1).max())
        if (
            error < tol + np.abs(region.carrier.distance(points)).max()
        ):  # the curve's own distance is no error of the pcurve
            return BSplineCurve(poles, low + (high - low) * knots, CURVE_DEGREE), error
    raise TrimmingError(
        f"a pcurve on the body deviates by {error:.3g} with {SPAN_COUNTS[-1]} spans, near "
        f"{curve(np.array([low]))[0].round(6)}; the tolerance is {tol:.3g}"
    )


def _find_closest_to_axis(
    curve: Callable[[Array], Array], carrier: BodyCarrier, tol: float
) -> tuple[float, float] | None:
    """The position in [0, 1] where a curve is nearest to a pole or an apex, and the width within which its angle varies."""
    poles = [p for _, p in carrier.poles_across_v()] if isinstance(carrier, FreeFormSurface) else []
    if not poles and not isinstance(carrier, SphericalSurface | ConicalSurface):
        return None

    def away(x: Array) -> Array:
        if poles:
            return np.asarray(np.min([np.linalg.norm(curve(x) - pole, axis=1) for pole in poles], axis=0))
        assert isinstance(carrier, SphericalSurface | ConicalSurface)
        arm = curve(x) - carrier.origin
        return np.asarray(np.linalg.norm(arm - (arm @ carrier.axis)[:, None] * carrier.axis, axis=1))

    low, high = 0.0, 1.0
    for _ in range(AXIS_SEARCH_STEPS):
        x = np.linspace(low, high, AXIS_SEARCH_INTERVALS + 1)
        r = away(x)
        i = int(r.argmin())
        low, high = float(x[max(i - 1, 0)]), float(x[min(i + 1, AXIS_SEARCH_INTERVALS)])
    ends = curve(np.array([low, high]))
    speed = float(np.linalg.norm(ends[1] - ends[0])) / (high - low)
    return float(x[i]), max(float(r[i]), MIN_POLE_DISTANCE_TOLS * tol) / max(speed, MIN_SPEED)


def _build_graded_space(spans: int, at: float, width: float) -> _PcurveSpace:
    """A space with knots graded towards `at`, where their spacing is a fraction of `width`."""
    low, high = float(np.arcsinh(-at / width)), float(np.arcsinh((1.0 - at) / width))
    s = np.linspace(low, high, GRADING_SAMPLES)
    x = at + width * np.sinh(s)
    x[[0, -1]] = 0.0, 1.0
    even = s + (high - low) * x  # half of the knots are uniform
    inner = np.interp(np.linspace(even[0], even[-1], spans + 1), even, x)[1:-1]
    knots = np.concatenate([np.zeros(CURVE_DEGREE + 1), inner, np.ones(CURVE_DEGREE + 1)])
    sites = greville_abscissae(knots, CURVE_DEGREE)
    ends = knots[CURVE_DEGREE:-CURVE_DEGREE]
    checks = np.unique(ends[:-1, None] + np.diff(ends)[:, None] * np.linspace(0.0, 1.0, CHECKS_PER_SPAN + 1))
    inverse = np.asarray(np.linalg.inv(design_matrix(knots, CURVE_DEGREE, sites)))
    return _PcurveSpace(knots, sites, inverse, checks, design_matrix(knots, CURVE_DEGREE, checks))


def _unwrap_parameters(carrier: BodyCarrier, points: Array) -> Array:
    uv = carrier.parameters(points)
    for axis, period in enumerate(carrier.period):
        if period:
            uv[..., axis] = np.unwrap(uv[..., axis], period=period)
    return uv


@lru_cache(maxsize=16)
def _build_uniform_space(spans: int) -> _PcurveSpace:
    """The space with uniform knots, as for fitted arcs."""
    knots, sites, inverse = build_interpolation(spans)
    checks = np.linspace(0.0, 1.0, CHECKS_PER_SPAN * spans + 1)
    return _PcurveSpace(knots, sites, inverse, checks, design_matrix(knots, CURVE_DEGREE, checks))
