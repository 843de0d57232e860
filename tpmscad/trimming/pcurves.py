"""Parameter curves of space curves on the body's quadrics: with the curve's parameter, interpolated until near enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import numpy as np

from tpmscad.patches.carriers import Cone, Plane, Quadric, Sphere
from tpmscad.patches.complex import Edges
from tpmscad.splines.bspline import Curve, design
from tpmscad.splines.stacked import points_at
from tpmscad.trimming.fitting import DEGREE, SPANS, interpolation
from tpmscad.trimming.regions import Region, repeated
from tpmscad.trimming.tool import Array, Ints, TrimmingError

CHECKS = 4
"""Points between knots where the deviation is measured."""

NEAREST = 32
"""Intervals in which the point of a curve nearest to an axis is looked for, again and again."""

WIDTH = 2.0
"""Angles that turn within less than this many spans get knots of their own."""

FINE = 4001
"""Points from which graded knots are read off."""

LEAST = 0.1
"""Nearer to a pole than this part of the tolerance the angle is of no account."""


def on_wall(curves: Sequence[Curve], edges: Edges, edge: Ints, region: Region, tol: float) -> tuple[list[Curve], Array]:
    """Parameter curves of edges on a round face, and how far they are off."""
    own, (low, high) = [curves[c] for c in edges.curve[edge]], edges.span[edge].T
    part = (high - low) / np.array([c.domain[1] - c.domain[0] for c in own])  # of the curve, which was fitted as finely
    least = (part * np.array([len(c.poles) - c.degree for c in own])).astype(np.int64)
    places = edges.rotation[edge], edges.translation[edge]
    return parameter_curves(own, places, edges.span[edge], region, tol, least)


def parameter_curves(
    curves: Sequence[Curve], places: tuple[Array, Array], span: Array, region: Region, tol: float, least: Ints
) -> tuple[list[Curve], Array]:
    """`parameter_curve` for n curves, moved by `places`, rotations (n, 3, 3) and translations (n, 3), over spans (n, 2).

    All that need no more than `least` (n,) spans are made together.
    """
    made: list[Curve | None] = [None] * len(curves)
    error = np.zeros(len(curves))
    first = np.array(SPANS)[np.minimum(np.searchsorted(SPANS, least), len(SPANS) - 1)]
    for spans in np.unique(first).tolist():
        knots, sites, inverse, checks, basis = _space(spans)
        rows = np.flatnonzero(first == spans)
        low, high = span[rows].T
        t = low[:, None] + (high - low)[:, None] * np.concatenate([sites, checks])
        index = np.repeat(np.arange(len(rows)), t.shape[1])
        local = points_at([curves[i] for i in rows.tolist()], index, t.ravel())[0].reshape(*t.shape, 3)
        points = local @ np.swapaxes(places[0][rows], 1, 2) + places[1][rows, None]
        on_curve, between = points[:, : len(sites)], points[:, len(sites) :]
        uv = _in_one_piece(region.carrier, on_curve)
        middle = uv[:, [len(sites) // 2]]
        poles = inverse @ (uv + (repeated(middle, region.carrier, region.middle) - middle))
        u, v = np.moveaxis(basis @ poles, -1, 0)
        error[rows] = np.linalg.norm(region.carrier(u, v) - between, axis=2).max(axis=1)
        for k in np.flatnonzero(error[rows] < tol + np.abs(region.carrier.distance(between)).max(axis=1)):
            made[rows[k]] = Curve(poles[k].copy(), low[k] + (high[k] - low[k]) * knots, DEGREE)
    result = []
    for i, curve in enumerate(made):
        if curve is None:
            placed = partial(_placed, curves[i], places[0][i], places[1][i])
            curve, error[i] = parameter_curve(placed, span[i], region, tol, int(least[i]))
        result.append(curve)
    return result, error


def _placed(curve: Curve, rotation: Array, translation: Array, t: Array) -> Array:
    return curve(t) @ rotation.T + translation


def parameter_curve(
    curve: Callable[[Array], Array], span: Array, region: Region, tol: float, least: int
) -> tuple[Curve, float]:
    """The curve in the face's (u, v) that runs with `curve` over the span, and how far it is from it at most.

    least: spans to begin with.

    TrimmingError where `tol` is not reached.
    """
    low, high = float(span[0]), float(span[1])
    close = _closest_to_axis(lambda x: curve(low + (high - low) * x), region.carrier, tol)
    error = np.inf
    for spans in [s for s in SPANS if s >= least] or SPANS[-1:]:
        graded = close is not None and _worth_grading(close[1], spans)
        knots, sites, inverse, checks, rows = _graded(spans, *close) if graded and close else _space(spans)
        uv = _in_one_piece(region.carrier, curve(low + (high - low) * sites))
        uv = uv + (repeated(uv[len(uv) // 2], region.carrier, region.middle) - uv[len(uv) // 2])
        poles = inverse @ uv
        u, v = (rows @ poles).T
        points = curve(low + (high - low) * checks)
        error = float(np.linalg.norm(region.carrier(u, v) - points, axis=1).max())
        if error < tol + np.abs(region.carrier.distance(points)).max():  # which no parameters can mend
            return Curve(poles, low + (high - low) * knots, DEGREE), error
    raise TrimmingError(
        f"a cut's parameters on the body are still {error:.3g} off, near {curve(np.array([low]))[0].round(6)}"
    )


def _closest_to_axis(
    curve: Callable[[Array], Array], carrier: Plane | Quadric, tol: float
) -> tuple[float, float] | None:
    """Where on [0, 1] a curve passes a pole or an apex, by which angles turn quickly, and over what part of it they do."""
    if not isinstance(carrier, Sphere | Cone):
        return None

    def away(x: Array) -> Array:
        arm = curve(x) - carrier.origin
        return np.asarray(np.linalg.norm(arm - (arm @ carrier.axis)[:, None] * carrier.axis, axis=1))

    low, high = 0.0, 1.0
    for _ in range(8):  # narrowed down around the nearest sample
        x = np.linspace(low, high, NEAREST + 1)
        r = away(x)
        i = int(r.argmin())
        low, high = float(x[max(i - 1, 0)]), float(x[min(i + 1, NEAREST)])
    ends = curve(np.array([low, high]))
    speed = float(np.linalg.norm(ends[1] - ends[0])) / (high - low)
    return float(x[i]), max(float(r[i]), LEAST * tol) / max(speed, 1e-300)


def _worth_grading(width: float, spans: int) -> bool:
    return width * spans < WIDTH


def _graded(spans: int, at: float, width: float) -> tuple[Array, Array, Array, Array, Array]:
    """As `_space`, with knots ever denser towards `at`, to a fraction of `width` there."""
    low, high = float(np.arcsinh(-at / width)), float(np.arcsinh((1.0 - at) / width))
    s = np.linspace(low, high, FINE)
    x = at + width * np.sinh(s)
    x[[0, -1]] = 0.0, 1.0
    even = s + (high - low) * x  # half of the knots in even steps
    inner = np.interp(np.linspace(even[0], even[-1], spans + 1), even, x)[1:-1]
    knots = np.concatenate([np.zeros(DEGREE + 1), inner, np.ones(DEGREE + 1)])
    sites = np.array([knots[i + 1 : i + DEGREE + 1].mean() for i in range(spans + DEGREE)])
    ends = knots[DEGREE:-DEGREE]
    checks = np.unique(ends[:-1, None] + np.diff(ends)[:, None] * np.linspace(0.0, 1.0, CHECKS + 1))
    inverse = np.asarray(np.linalg.inv(design(knots, DEGREE, sites)))
    return knots, sites, inverse, checks, design(knots, DEGREE, checks)


def _in_one_piece(carrier: Plane | Quadric, points: Array) -> Array:
    uv = carrier.parameters(points)
    for axis, period in enumerate(carrier.period):
        if period:
            uv[..., axis] = np.unwrap(uv[..., axis], period=period)
    return uv


@lru_cache(maxsize=16)
def _space(spans: int) -> tuple[Array, Array, Array, Array, Array]:
    """Knots, Greville sites and the inverse of interpolation there; places between, and the basis there."""
    knots, sites, inverse = interpolation(spans)
    checks = np.linspace(0.0, 1.0, CHECKS * spans + 1)
    return knots, sites, inverse, checks, design(knots, DEGREE, checks)
