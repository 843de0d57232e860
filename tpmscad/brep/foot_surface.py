"""A polynomial B-spline surface prepared for the search of foot points: polynomials of its spans, and cells that bound it.

The surface is stored as one tensor of monomials per knot span, in two local parameters on [-1, 1]. Horner's rule then gives points
and derivatives to second order, and an end span goes on beyond the border of the surface by the same polynomial.

A grid of cells, some hundreds of rectangles of the parameters, covers the surface. Each has a box, in axes of its own, that
contains the Bezier poles of the surface over the cell, hence the surface: the distance of a point from the box is a lower bound of
its distance from the surface in the cell. Cells are about as long as wide, shorter where the normals turn, and independent of the
knots: a cell may hold several short spans.

All parameters in here are measured from the start of the surface's domain, all points from the middle of its poles, so that the
place of the surface costs no digits.
"""

from __future__ import annotations

from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tpmscad._typing import Array, IntArray
from tpmscad.splines.basis import bezier_interpolation, design_matrices
from tpmscad.splines.bspline import BSplineSurface

MAX_DEGREE = 9
"""Up to this degree monomials on [-1, 1] lose no more than two digits."""

CELLS = 400
"""Number of cells of a flat surface: more of them make boxes tighter and their list longer."""

TURN_PER_CELL = 0.4
"""Radians by which the normal turns at most from one line of cells to the next, roughly."""

MAX_LINES = 96
"""Most cells along one parameter."""

SAMPLES_PER_PIECE = 5
"""Lines in each direction, in the part of a cell within a span, on which curvatures are sampled."""

CURVATURE_MARGIN = 1.25
"""Widening of sampled curvatures, of which a surface has greater ones between the samples."""

SINGULAR_RATIO = 1e-7
"""Of the largest |S_u| |S_v| of a surface: where |S_u x S_v| is less, at poles, curvatures are not computed from it."""

POLE_SPREAD = 1e-10
"""In sizes of the surface: a side whose poles all lie within this is one point."""

POLE_DIRECTIONS = 24
"""Directions about a pole of the surface from which its curvatures are found."""

SMOOTH_POLE = 1e-4
"""A pole is smooth if the tangents about it are in one plane, and their curvatures those of one surface, within this fraction."""

WINDOWS = (1, 4)
"""Cells to either side of a cell within which largest curvatures and lengths are stored."""


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
    pole : (4,)
        1 for a side, numbered as those of a spline surface, that is a smooth point of the surface, -1 for another point, else 0.
    pole_normal, pole_curvature : (4, 3), (4, 3, 3)
        Unit normals there, and the second fundamental form as a matrix in space, for smooth poles.
    """

    breaks_u: Array
    breaks_v: Array
    monomials: Array
    box: Array
    period: Array
    speed: Array
    size: float
    pole: IntArray
    pole_normal: Array
    pole_curvature: Array


class FootCells(NamedTuple):
    """The grid of mu x mv cells, v running faster.

    Attributes
    ----------
    lines_u, lines_v : (mu + 1,), (mv + 1,)
        Ends of the cells.
    point : (m, 3)
        Points of the surface at the middle of the cells.
    radius : (m,)
        Of balls around them that contain the cells.
    axes : (m, 3, 3)
        Orthonormal axes in rows: along u, in the tangent plane, along the normal S_u x S_v.
    low, high : (m, 3)
        Box that contains the cell, along these axes from the point.
    start : (m, 3)
        1 / a, b, 1 / c of the affine map (s, t) -> (a s + b t, c t) from [-1, 1]^2 to the first two axes, 0 for infinite ones.
    curvature, length_u, length_v : (w + 1, m)
        Largest normal curvature, and greatest length of a cell along u and v, over the cells of each window and over all.
    """

    lines_u: Array
    lines_v: Array
    point: Array
    radius: Array
    axes: Array
    low: Array
    high: Array
    start: Array
    curvature: Array
    length_u: Array
    length_v: Array


class FootSurface(NamedTuple):
    """What the search reads of a surface: the middle of its poles (3,), the start (2,) of its domain, its spans and its cells."""

    centre: Array
    origin: Array
    spans: SpanPolynomials
    cells: FootCells


def prepare_foot_surface(
    surface: BSplineSurface, closed: tuple[bool, bool] = (False, False), continuation: float = 0.0
) -> FootSurface:
    """The data of a surface for the search of foot points.

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
    FootSurface
        Monomials and cells.

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
    centre = 0.5 * (low + high)
    origin = np.array([interval[0] for interval in surface.domain])
    breaks, (left, right) = zip(
        *(
            _span_powers(knots, degree, start)
            for knots, degree, start in zip((surface.knots_u, surface.knots_v), degrees, origin, strict=True)
        ),
        strict=True,
    )
    poles = surface.poles - centre
    monomials = np.einsum("aku,uvc,blv->abklc", left, poles, right, optimize=True)
    box = np.array([[b[0], b[-1]] for b in breaks])
    size = float(np.linalg.norm(high - low))
    sides = np.array([np.ptp(side, axis=0).max() for side in (poles[:, 0], poles[-1], poles[:, -1], poles[0])])
    is_point = sides <= POLE_SPREAD * size
    end = {(0, 0): 3, (0, 1): 1, (1, 0): 0, (1, 1): 2}  # sides by parameter and end
    for axis in (0, 1):
        for far in (0, 1):
            if closed[axis] or is_point[end[axis, far]]:
                continue
            speed = _border_speed(monomials, breaks, axis, far)
            span = breaks[axis][-1] - breaks[axis][-2] if far else breaks[axis][1] - breaks[axis][0]
            box[axis, far] += (1 if far else -1) * min(0.5 * span, continuation / max(speed, 1e-300))
    period = np.array([b[-1] if c else 0.0 for b, c in zip(breaks, closed, strict=True)])
    spans = SpanPolynomials(
        np.ascontiguousarray(breaks[0]),
        np.ascontiguousarray(breaks[1]),
        np.ascontiguousarray(monomials),
        box,
        period,
        np.zeros(2),
        size,
        np.where(is_point, -1, 0),
        np.zeros((4, 3)),
        np.zeros((4, 3, 3)),
    )
    fastest = np.array(
        [np.linalg.norm(evaluate_grid(spans, *_fine_lines(spans), *d), axis=2).max() for d in ((1, 0), (0, 1))]
    )
    spans = _describe_poles(spans._replace(speed=fastest))
    return FootSurface(centre, origin, spans, _make_cells(spans))


def _span_powers(knots: Array, degree: int, start: float) -> tuple[Array, Array]:
    """Ends of the spans from `start`, and matrices (m, degree + 1, n) from poles to monomials in each span's parameter on [-1, 1]."""
    ends = np.unique(knots[degree : len(knots) - degree])
    half = 0.5 * np.diff(ends)
    orders = range(degree + 1)
    rows = design_matrices(knots, degree, ends[:-1] + half, orders)
    powers = np.stack([row * (half**k / factorial(k))[:, None] for k, row in zip(orders, rows, strict=True)], axis=1)
    return ends - start, powers


def _power_rows(breaks: Array, degree: int, t: Array, order: int) -> tuple[IntArray, Array]:
    """The span of each parameter (n,), and rows (n, degree + 1) that take its monomials to the derivative of the given order."""
    span = np.clip(np.searchsorted(breaks, t, side="right") - 1, 0, len(breaks) - 2)
    scale = 2.0 / (breaks[span + 1] - breaks[span])
    local = (t - breaks[span]) * scale - 1.0
    rows = np.zeros((len(t), degree + 1))
    for k in range(order, degree + 1):
        rows[:, k] = factorial(k) / factorial(k - order) * local ** (k - order) * scale**order
    return span, rows


def evaluate_grid(spans: SpanPolynomials, u: Array, v: Array, du: int = 0, dv: int = 0) -> Array:
    """Points, or the mixed derivative of orders (du, dv), on the grid of all u with all v: (len(u), len(v), 3)."""
    span_u, rows_u = _power_rows(spans.breaks_u, spans.monomials.shape[2] - 1, u, du)
    span_v, rows_v = _power_rows(spans.breaks_v, spans.monomials.shape[3] - 1, v, dv)
    half = np.einsum("uk,ubklc->ublc", rows_u, spans.monomials[span_u], optimize=True)
    return np.einsum("vl,uvlc->uvc", rows_v, half[:, span_v], optimize=True)


def _border_speed(monomials: Array, breaks: tuple[Array, ...], axis: int, far: int) -> float:
    """Greatest length of the derivative across a border."""
    spans = SpanPolynomials(
        *breaks, monomials, np.zeros((2, 2)), np.zeros(2), np.zeros(2), 0.0, np.zeros(4, int), np.zeros(0), np.zeros(0)
    )
    along = _subdivide(breaks[1 - axis], 9)
    at = np.array([breaks[axis][-1 if far else 0]])
    slopes = evaluate_grid(spans, at, along, 1, 0) if axis == 0 else evaluate_grid(spans, along, at, 0, 1)
    return float(np.linalg.norm(slopes, axis=2).max())


def _subdivide(breaks: Array, lines: int) -> Array:
    """`lines` equidistant parameters in each span with both ends, ascending: ends of spans occur twice."""
    return (breaks[:-1, None] + np.diff(breaks)[:, None] * np.linspace(0.0, 1.0, lines)).ravel()


def _fine_lines(spans: SpanPolynomials) -> tuple[Array, Array]:
    """Parameters along u and v, close enough to follow the surface, from one end of the box to the other."""
    lines = []
    for breaks, (low, high) in zip((spans.breaks_u, spans.breaks_v), spans.box, strict=True):
        per_span = max(3, min(33, 200 // len(breaks)))
        inner = _subdivide(breaks, per_span)
        lines.append(np.unique(np.concatenate([[low], inner[(inner > low) & (inner < high)], [high]])))
    return lines[0], lines[1]


def _unit(vectors: Array, least: float) -> Array:
    """Unit vectors (..., 3), zero where the length is not above `least`."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > least, vectors / np.maximum(length, 1e-300), 0.0)


def _describe_poles(spans: SpanPolynomials) -> SpanPolynomials:
    """The spans with normals and curvatures of the sides that are smooth points.

    About such a point the tangents t across the side are in one plane, and their normal curvatures are t . K t with one matrix K.
    """
    pole, normal, curvature = spans.pole.copy(), np.zeros((4, 3)), np.zeros((4, 3, 3))
    for side in np.flatnonzero(pole):
        across = 1 if side in (0, 2) else 0
        far = side in (1, 2)
        along = np.linspace(*spans.box[1 - across], POLE_DIRECTIONS + 1)[:-1]
        at = spans.box[across, [int(far)]]

        def derivative(a: int, b: int, across: int = across, along: Array = along, at: Array = at) -> Array:
            """Derivative a times across the side and b times along it: (POLE_DIRECTIONS, 3)."""
            grid = evaluate_grid(spans, along, at, b, a) if across else evaluate_grid(spans, at, along, a, b)
            return grid.reshape(-1, 3)

        first, second, turning = derivative(1, 0), derivative(2, 0), derivative(1, 1)
        tangent = _unit(first, SINGULAR_RATIO * spans.speed[across])
        # S_u = (v - v0) S_uv to first order, so that S_u x S_v has the direction of +- S_uv x S_v
        cross = np.cross(turning, first) if across else np.cross(first, turning)
        normals = _unit(cross * (-1.0 if far else 1.0), 0.0)
        n = _unit(normals.sum(axis=0), 0.0)
        if np.abs(tangent @ n).max() > SMOOTH_POLE or not tangent.any(axis=1).all() or not n.any():
            continue
        e = _unit(np.cross(n, tangent[0]), 0.0)
        x, y = tangent @ tangent[0], tangent @ e
        bend = second @ n / np.einsum("nk,nk->n", first, first)
        rows = np.stack([x * x, 2 * x * y, y * y], axis=1)
        (a, b, c), *_ = np.linalg.lstsq(rows, bend, rcond=1e-10)
        if np.abs(rows @ [a, b, c] - bend).max() > SMOOTH_POLE * (np.abs(bend).max() + 1.0 / spans.size):
            continue
        frame = np.stack([tangent[0], e])
        pole[side], normal[side], curvature[side] = 1, n, frame.T @ np.array([[a, b], [b, c]]) @ frame
    return spans._replace(pole=pole, pole_normal=normal, pole_curvature=curvature)


def _cell_lines(spans: SpanPolynomials) -> tuple[Array, Array]:
    """Ends of the cells along u and v: even in length, and in the angle by which the normals turn."""
    fine = _fine_lines(spans)
    points = evaluate_grid(spans, *fine)
    cross = np.cross(evaluate_grid(spans, *fine, 1, 0), evaluate_grid(spans, *fine, 0, 1))
    normals = _unit(cross, SINGULAR_RATIO * float(spans.speed.prod()))
    steps, turns = [], []
    for axis in (0, 1):
        steps.append(np.linalg.norm(np.diff(points, axis=axis), axis=2).max(axis=1 - axis))
        one, other = np.moveaxis(normals, axis, 0)[:-1], np.moveaxis(normals, axis, 0)[1:]
        regular = one.any(axis=2) & other.any(axis=2)
        turns.append(np.where(regular, np.linalg.norm(other - one, axis=2), 0.0).max(axis=1))
    side = np.sqrt(steps[0].sum() * steps[1].sum() / CELLS)
    lines = []
    for axis in (0, 1):
        measure = np.append(0.0, np.cumsum(steps[axis] / side + turns[axis] / TURN_PER_CELL))
        count = int(np.clip(np.ceil(measure[-1]), 1, MAX_LINES))
        inner = np.interp(np.arange(1, count) * measure[-1] / count, measure, fine[axis])
        lines.append(np.concatenate([spans.box[axis, :1], inner, spans.box[axis, 1:]]))
    return lines[0], lines[1]


def _make_cells(spans: SpanPolynomials) -> FootCells:
    """The cells of a surface."""
    lines = _cell_lines(spans)
    breaks = (spans.breaks_u, spans.breaks_v)
    degrees = (spans.monomials.shape[2] - 1, spans.monomials.shape[3] - 1)
    # A piece is what a cell and a span have in common along one parameter.
    pieces = [np.union1d(own, b[(b > own[0]) & (b < own[-1])]) for own, b in zip(lines, breaks, strict=True)]
    first = [np.searchsorted(p, own[:-1]) for p, own in zip(pieces, lines, strict=True)]
    cell = [np.searchsorted(own, 0.5 * (p[1:] + p[:-1])) - 1 for p, own in zip(pieces, lines, strict=True)]
    span, to_bezier = zip(
        *(_bezier_rows(p, b, d) for p, b, d in zip(pieces, breaks, degrees, strict=True)), strict=True
    )
    own = spans.monomials[np.ix_(*span)]
    poles = np.einsum("aik,abklc,bjl->abijc", to_bezier[0], own, to_bezier[1], optimize=True)

    middle = [0.5 * (line[1:] + line[:-1]) for line in lines]
    point = evaluate_grid(spans, *middle)
    corners = evaluate_grid(spans, *lines)
    a = 0.25 * (corners[1:, 1:] + corners[1:, :-1] - corners[:-1, 1:] - corners[:-1, :-1])
    b = 0.25 * (corners[1:, 1:] - corners[1:, :-1] + corners[:-1, 1:] - corners[:-1, :-1])
    axes, start = _cell_frames(a, b)

    at = np.ix_(*cell)
    arms = poles - point[at][:, :, None, None]
    local = np.einsum("abrc,abijc->abijr", axes[at], arms, optimize=True)
    low = _reduce(np.minimum, local.min(axis=(2, 3)), first)
    high = _reduce(np.maximum, local.max(axis=(2, 3)), first)
    radius = np.sqrt(_reduce(np.maximum, np.einsum("abijc,abijc->abij", arms, arms).max(axis=(2, 3)), first))
    # A control polygon is longer than its curve, and those of lines between the rows of poles are shorter than the longest row.
    along = [np.linalg.norm(np.diff(poles, axis=2 + k), axis=4).sum(axis=2 + k).max(axis=2) for k in (0, 1)]
    length_u = np.maximum.reduceat(np.add.reduceat(along[0], first[0], axis=0), first[1], axis=1)
    length_v = np.maximum.reduceat(np.add.reduceat(along[1], first[1], axis=1), first[0], axis=0)
    curvature = _reduce(np.maximum, _piece_curvatures(spans, pieces[0], pieces[1]), first)

    pad = 1e-14 * spans.size  # round-off of the poles
    wrap = spans.period > 0
    tables = [_widen(values, wrap) for values in (CURVATURE_MARGIN * curvature, length_u, length_v)]
    m = point.shape[0] * point.shape[1]
    return FootCells(
        *lines,
        np.ascontiguousarray(point.reshape(m, 3)),
        radius.ravel() + pad,
        np.ascontiguousarray(axes.reshape(m, 3, 3)),
        low.reshape(m, 3) - pad,
        high.reshape(m, 3) + pad,
        np.ascontiguousarray(start.reshape(m, 3)),
        *tables,
    )


def _bezier_rows(pieces: Array, breaks: Array, degree: int) -> tuple[IntArray, Array]:
    """The span of each piece, and matrices (n, degree + 1, degree + 1) from its monomials to Bezier poles over the piece."""
    nodes, to_poles = bezier_interpolation(degree)
    width = np.diff(pieces)
    middle = pieces[:-1] + 0.5 * width
    span = np.clip(np.searchsorted(breaks, middle) - 1, 0, len(breaks) - 2)
    local = 2.0 * (pieces[:-1, None] + width[:, None] * nodes - breaks[span, None]) / np.diff(breaks)[span, None] - 1.0
    return span, to_poles @ (local[..., None] ** np.arange(degree + 1))


def _cell_frames(a: Array, b: Array) -> tuple[Array, Array]:
    """Axes (..., 3, 3) and the affine map (..., 3) of cells with half sides a and b (..., 3)."""
    scale = np.sqrt(np.maximum((a**2).sum(axis=-1), (b**2).sum(axis=-1)))[..., None]
    first = _unit(np.where(scale > 0, a / np.maximum(scale, 1e-300), 0.0), 1e-9)
    fallback = _unit(b, 0.0)  # a = 0: the cell is a line, its axes are those of b and anything at a right angle
    other = _unit(np.cross(fallback, np.eye(3)[np.abs(fallback).argmin(axis=-1)]), 0.0)
    other = np.where(other.any(axis=-1, keepdims=True), other, np.eye(3)[0])
    first = np.where(first.any(axis=-1, keepdims=True), first, other)
    across = b - (b * first).sum(axis=-1, keepdims=True) * first
    second = _unit(np.where(scale > 0, across / np.maximum(scale, 1e-300), 0.0), 1e-9)
    other = _unit(np.cross(first, np.eye(3)[np.abs(first).argmin(axis=-1)]), 0.0)
    second = np.where(second.any(axis=-1, keepdims=True), second, other)
    axes = np.stack([first, second, np.cross(first, second)], axis=-2)
    entries = np.stack([(a * first).sum(axis=-1), (b * first).sum(axis=-1), (b * second).sum(axis=-1)], axis=-1)
    for k in (0, 2):
        large = entries[..., k] > 1e-9 * scale[..., 0]
        entries[..., k] = np.where(large, 1.0 / np.where(large, entries[..., k], 1.0), 0.0)
    return axes, entries


def _reduce(function: np.ufunc, values: Array, first: list[IntArray]) -> Array:
    """Values (pu, pv, ...) of pieces reduced to cells (mu, mv, ...)."""
    return function.reduceat(function.reduceat(values, first[0], axis=0), first[1], axis=1)


def _piece_curvatures(spans: SpanPolynomials, pieces_u: Array, pieces_v: Array) -> Array:
    """Largest sampled normal curvature of each piece: (pu, pv)."""
    lines = [_subdivide(p, SAMPLES_PER_PIECE) for p in (pieces_u, pieces_v)]
    # at a border of a piece the sample belongs to its own span
    inset = [1e-9 * np.repeat(np.diff(p), SAMPLES_PER_PIECE) for p in (pieces_u, pieces_v)]
    side = np.array([1.0, *[0.0] * (SAMPLES_PER_PIECE - 2), -1.0])
    u, v = (
        line + step * np.tile(side, len(line) // SAMPLES_PER_PIECE) for line, step in zip(lines, inset, strict=True)
    )
    su, sv, suu, suv, svv = (evaluate_grid(spans, u, v, *d) for d in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2)))
    normal = np.cross(su, sv)
    area = np.linalg.norm(normal, axis=2)
    regular = area > SINGULAR_RATIO * float(spans.speed.prod())
    area = np.where(regular, area, 1.0)
    normal /= area[..., None]
    e, f, g = ((a * b).sum(axis=2) for a, b in ((su, su), (su, sv), (sv, sv)))
    p, q, r = ((a * normal).sum(axis=2) for a in (suu, suv, svv))
    mean = 0.5 * (p * g - 2 * q * f + r * e) / area**2
    gauss = (p * r - q * q) / area**2
    largest = np.where(regular, np.abs(mean) + np.sqrt(np.maximum(mean**2 - gauss, 0.0)), 0.0)
    n = SAMPLES_PER_PIECE
    return largest.reshape(len(u) // n, n, len(v) // n, n).max(axis=(1, 3))


def _widen(values: Array, wrap: Array) -> Array:
    """Greatest values (w + 1, m) over the windows about each of the cells (mu, mv), and over all cells."""
    rows = []
    for width in WINDOWS:
        table = values
        for axis in (0, 1):
            reach = min(width, table.shape[axis] - 1) if wrap[axis] else width
            padding = [(reach, reach) if k == axis else (0, 0) for k in (0, 1)]
            padded = np.pad(table, padding, mode="wrap" if wrap[axis] else "edge")
            table = sliding_window_view(padded, 2 * reach + 1, axis=axis).max(axis=-1)
        rows.append(table.ravel())
    rows.append(np.full(values.size, values.max()))
    return np.ascontiguousarray(np.stack(rows))
