"""A polynomial B-spline surface prepared for the search of its feet: the polynomials of its spans, and lines of nodes.

The surface is stored as one tensor of monomials per knot span, in two local parameters on [-1, 1]. Horner's rule then gives
points and derivatives to second order, and an end span goes on beyond the border of the surface by the same polynomial.

All parameters in here are measured from the start of the surface's domain, all points from the middle of its poles, so that the
place of the surface costs no digits.
"""

from __future__ import annotations

from math import factorial
from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.splines.basis import apply_span_bases, design_matrices
from tpmscad.splines.bspline import BSplineSurface

MAX_DEGREE = 9
"""Up to this degree monomials on [-1, 1] lose no more than two digits."""

SIDES = ((3, 1), (0, 2))
"""Numbers of the sides of a spline surface at the low and the high end of u, and of v."""

POLE_SPREAD = 1e-10
"""In sizes of the surface: a side whose poles all lie within this is one point."""

CELLS = 400
"""Number of cells between the nodes of a flat surface."""

TURN_PER_CELL = 0.4
"""Radians by which the normal turns at most from one line of cells to the next, roughly."""

MAX_CELLS = 96 * 96
"""Most cells of a surface. The number along one parameter alone has no limit: a thread of several turns takes 200 by 8."""

SINGULAR_RATIO = 1e-7
"""Of the largest |S_u| |S_v| of a surface: where |S_u x S_v| is less, at poles, curvatures are not computed from it."""


class SpanPolynomials(NamedTuple):
    """The surface span by span, a named tuple, which compiled functions take.

    Attributes
    ----------
    breaks_u, breaks_v : (nu + 1,), (nv + 1,)
        Ends of the spans.
    monomials : (nu, nv, degree_u + 1, degree_v + 1, 3)
        Coefficients of the powers of two local parameters, which run from -1 to 1 over the span.
    box : (2, 2)
        Lowest and highest u, and v, where feet are sought: the domain and its continuation.
    period : (2,)
        Periods of u and v, 0 for none.
    speed : (2,)
        Greatest |S_u| and |S_v|.
    size : float
        Diagonal of the box of the poles.
    """

    breaks_u: Array
    breaks_v: Array
    monomials: Array
    box: Array
    period: Array
    speed: Array
    size: float


def tabulate_spans(
    surface: BSplineSurface, closed: tuple[bool, bool] = (False, False), continuation: float = 0.0
) -> tuple[BSplineSurface, SpanPolynomials]:
    """A surface measured from the middle of its poles and the start of its domain, and its polynomials.

    Parameters
    ----------
    surface : BSplineSurface
        Surface in space, of degrees up to `MAX_DEGREE`, without creases.
    closed : tuple of bool, optional
        Whether the surface is closed along u, and along v, with one tangent plane on both sides of the seam.
    continuation : float, optional
        Length in model units by which it goes on beyond each of its borders, at most. It goes on by half an end span at most, and
        neither beyond a point nor beyond a seam.

    Returns
    -------
    local : BSplineSurface
        The surface with its frame moved.
    spans : SpanPolynomials
        Its monomials.

    Raises
    ------
    ValueError
        If the surface is not in space, a degree is too high, or the continuation is negative.
    """
    degrees = surface.degree_u, surface.degree_v
    if surface.poles.shape[2] != 3 or min(degrees) < 1 or max(degrees) > MAX_DEGREE:
        raise ValueError(
            f"degrees {degrees} in {surface.poles.shape[2]} dimensions: in space they are 1 to {MAX_DEGREE}"
        )
    if not continuation >= 0.0:
        raise ValueError(f"a surface can't go on by {continuation} beyond its border")
    flat = surface.poles.reshape(-1, 3)
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = float(np.linalg.norm(high - low))
    origin = np.array([interval[0] for interval in surface.domain])
    poles = surface.poles - find_centre(surface)
    local = BSplineSurface(poles, surface.knots_u - origin[0], surface.knots_v - origin[1], *degrees)
    (breaks_u, left), (breaks_v, right) = (
        span_powers(knots, degree) for knots, degree in zip((local.knots_u, local.knots_v), degrees, strict=True)
    )
    box = np.array(local.domain)
    is_point = find_point_sides(surface)
    for axis, breaks in enumerate((breaks_u, breaks_v)):
        for far in (0, 1):
            if closed[axis] or is_point[SIDES[axis][far]]:
                continue
            span = breaks[-1] - breaks[-2] if far else breaks[1] - breaks[0]
            step = min(0.5 * span, continuation / max(_border_speed(local, axis, far), 1e-300))
            box[axis, far] += step if far else -step
    fine = fine_lines(local, box)
    speed = np.array([np.linalg.norm(local.grid(*fine, *d), axis=2).max() for d in ((1, 0), (0, 1))])
    spans = SpanPolynomials(
        breaks_u,
        breaks_v,
        apply_span_bases(left, poles, right),
        box,
        np.where(closed, (breaks_u[-1], breaks_v[-1]), 0.0),
        speed,
        size,
    )
    return local, spans


def find_centre(surface: BSplineSurface) -> Array:
    """The middle (3,) of the box of the poles of a surface."""
    flat = surface.poles.reshape(-1, 3)
    return np.asarray(0.5 * (flat.min(axis=0) + flat.max(axis=0)))


def find_point_sides(surface: BSplineSurface) -> BoolArray:
    """Whether each side of a surface, numbered as by `BSplineSurface.side`, is one point: (4,)."""
    size = float(np.linalg.norm(np.ptp(surface.poles.reshape(-1, surface.poles.shape[2]), axis=0)))
    return np.array([np.ptp(surface.side(i).poles, axis=0).max() <= POLE_SPREAD * size for i in range(4)])


def span_powers(knots: Array, degree: int) -> tuple[Array, Array]:
    """Ends (m + 1,) of the spans, and matrices (m, degree + 1, n) from poles to monomials in each span's parameter on [-1, 1]."""
    ends = np.unique(knots[degree : len(knots) - degree])
    half = 0.5 * np.diff(ends)
    orders = range(degree + 1)
    rows = design_matrices(knots, degree, ends[:-1] + half, orders)
    powers = np.stack([row * (half**k / factorial(k))[:, None] for k, row in zip(orders, rows, strict=True)], axis=1)
    return ends, powers


def _border_speed(local: BSplineSurface, axis: int, far: int) -> float:
    """Greatest length of the derivative across a border."""
    along = subdivide(np.unique(local.knots_v if axis == 0 else local.knots_u), 9)
    at = np.array([local.domain[axis][far]])
    slopes = local.grid(at, along, 1, 0) if axis == 0 else local.grid(along, at, 0, 1)
    return float(np.linalg.norm(slopes, axis=2).max())


def divide_evenly(local: BSplineSurface, box: Array, area: float) -> tuple[Array, Array]:
    """Ends of the cells along u and v: even in length, and in the angle by which the normals turn."""
    fine = fine_lines(local, box)
    points = local.grid(*fine)
    normals = unit(np.cross(local.grid(*fine, 1, 0), local.grid(*fine, 0, 1)), SINGULAR_RATIO * area)
    steps, turns = [], []
    for axis in (0, 1):
        steps.append(np.linalg.norm(np.diff(points, axis=axis), axis=2).max(axis=1 - axis))
        one, other = np.moveaxis(normals, axis, 0)[:-1], np.moveaxis(normals, axis, 0)[1:]
        regular = one.any(axis=2) & other.any(axis=2)
        turns.append(np.where(regular, np.linalg.norm(other - one, axis=2), 0.0).max(axis=1))
    side = np.sqrt(steps[0].sum() * steps[1].sum() / CELLS)
    measures = [np.append(0.0, np.cumsum(steps[axis] / side + turns[axis] / TURN_PER_CELL)) for axis in (0, 1)]
    wide = max(1.0, np.sqrt(measures[0][-1] * measures[1][-1] / MAX_CELLS))
    lines = []
    for axis, measure in enumerate(measures):
        count = max(1, int(np.ceil(measure[-1] / wide)))
        inner = np.interp(np.arange(1, count) * measure[-1] / count, measure, fine[axis])
        lines.append(np.concatenate([box[axis, :1], inner, box[axis, 1:]]))
    return lines[0], lines[1]


def find_inner_knots(local: BSplineSurface) -> tuple[Array, Array]:
    """Knots between the spans along u and v."""
    ends = [np.unique(local.knots_u), np.unique(local.knots_v)]
    u, v = (t[(t > low) & (t < high)] for t, (low, high) in zip(ends, local.domain, strict=True))
    return u, v


def subdivide(breaks: Array, lines: int) -> Array:
    """`lines` equidistant parameters in each span with both ends, ascending: ends of spans occur twice."""
    return (breaks[:-1, None] + np.diff(breaks)[:, None] * np.linspace(0.0, 1.0, lines)).ravel()


def fine_lines(local: BSplineSurface, box: Array) -> tuple[Array, Array]:
    """Parameters along u and v, close enough to follow the surface, from one end of the box to the other."""
    lines = []
    for inner, (low, high) in zip(find_inner_knots(local), box, strict=True):
        breaks = np.concatenate([[low], inner, [high]])
        lines.append(np.unique(subdivide(breaks, max(3, min(33, 200 // len(breaks))))))
    return lines[0], lines[1]


def unit(vectors: Array, least: float) -> Array:
    """Unit vectors (..., 3), zero where the length is not above `least`."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > least, vectors / np.maximum(length, 1e-300), 0.0)


@njit_cached
def evaluate_spans(
    spans: SpanPolynomials, u: float, v: float, span: IntArray, jet: Array
) -> None:  # pragma: no cover - compiled
    """Fill in S, S_u, S_v, S_uu, S_uv, S_vv (18,) by Horner's rule; `span` is where the search for the span begins and ends."""
    breaks_u, breaks_v, monomials = spans.breaks_u, spans.breaks_v, spans.monomials
    a, b = span[0], span[1]
    while a > 0 and u < breaks_u[a]:
        a -= 1
    while a < len(breaks_u) - 2 and u >= breaks_u[a + 1]:
        a += 1
    while b > 0 and v < breaks_v[b]:
        b -= 1
    while b < len(breaks_v) - 2 and v >= breaks_v[b + 1]:
        b += 1
    span[0], span[1] = a, b
    by_u, by_v = 2.0 / (breaks_u[a + 1] - breaks_u[a]), 2.0 / (breaks_v[b + 1] - breaks_v[b])
    s, t = (u - breaks_u[a]) * by_u - 1.0, (v - breaks_v[b]) * by_v - 1.0
    for c in range(3):
        w, wu, wv, wuu, wuv, wvv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(monomials.shape[2] - 1, -1, -1):
            x, xv, xvv = 0.0, 0.0, 0.0
            for j in range(monomials.shape[3] - 1, -1, -1):
                xvv = xvv * t + xv
                xv = xv * t + x
                x = x * t + monomials[a, b, i, j, c]
            wuu = wuu * s + wu
            wu = wu * s + w
            w = w * s + x
            wuv = wuv * s + wv
            wv = wv * s + xv
            wvv = wvv * s + xvv
        jet[c], jet[3 + c], jet[6 + c] = w, wu * by_u, wv * by_v
        jet[9 + c], jet[12 + c], jet[15 + c] = 2.0 * wuu * by_u * by_u, wuv * by_u * by_v, 2.0 * wvv * by_v * by_v
