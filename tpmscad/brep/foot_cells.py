"""Cells of a spline surface for the search of foot points: rectangles of its parameters with boxes and curvatures.

A grid of some hundreds of cells covers the surface. Each has a box, in axes of its own, that contains the Bezier poles of the
surface over the cell, hence the surface: the distance of a point from the box is a lower bound of its distance from the surface
in the cell. Cells are about as long as wide, shorter where the normals turn, and independent of the knots: a cell may hold
several short spans. Curvatures are sampled, with a margin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tpmscad._typing import Array, IntArray
from tpmscad.brep.foot_surface import (
    SINGULAR_RATIO,
    SpanPolynomials,
    divide_evenly,
    find_centre,
    find_inner_knots,
    find_point_sides,
    subdivide,
    tabulate_spans,
    unit,
)
from tpmscad.splines.basis import bezier_interpolation, design_matrix
from tpmscad.splines.bspline import BSplineSurface

SAMPLES_PER_PIECE = 5
"""Lines in each direction, in the part of a cell within a span, on which curvatures are sampled."""

CURVATURE_MARGIN = 1.25
"""Widening of sampled curvatures, of which a surface has greater ones between the samples."""

WINDOWS = (1, 4)
"""Cells to either side of a cell within which largest curvatures and lengths are stored."""

BOX_PAD = 1e-12
"""In sizes of the surface: round-off of the Bezier poles, by which boxes are larger."""


POLE_DIRECTIONS = 24
"""Directions about a pole of the surface from which its curvatures are found."""

SMOOTH_POLE = 1e-4
"""A pole is smooth if the tangents about it are in one plane, and their curvatures those of one surface, within this fraction."""


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


def make_cells(local: BSplineSurface, box: Array, closed: tuple[bool, bool], area: float, size: float) -> FootCells:
    """The cells of a surface over a box (2, 2) of its parameters, with the greatest |S_u| |S_v| and the size of the surface."""
    lines = divide_evenly(local, box, area)
    knots, degrees = (local.knots_u, local.knots_v), (local.degree_u, local.degree_v)
    # A piece is what a cell and a span have in common along one parameter; end spans go on to the border of the box.
    pieces = [
        np.union1d(own, t[(t > own[0]) & (t < own[-1])]) for own, t in zip(lines, find_inner_knots(local), strict=True)
    ]
    first = [np.searchsorted(p, own[:-1]) for p, own in zip(pieces, lines, strict=True)]
    cell = [np.searchsorted(own, 0.5 * (p[1:] + p[:-1])) - 1 for p, own in zip(pieces, lines, strict=True)]
    left, right = (_bezier_rows(p, t, d) for p, t, d in zip(pieces, knots, degrees, strict=True))
    half = np.tensordot(left, local.poles, 1)
    poles = np.moveaxis(np.tensordot(right, half, (2, 2)), (0, 1), (1, 3))

    middle_u, middle_v = (0.5 * (line[1:] + line[:-1]) for line in lines)
    point = local.grid(middle_u, middle_v)
    corners = local.grid(*lines)
    a = 0.25 * (corners[1:, 1:] + corners[1:, :-1] - corners[:-1, 1:] - corners[:-1, :-1])
    b = 0.25 * (corners[1:, 1:] - corners[1:, :-1] + corners[:-1, 1:] - corners[:-1, :-1])
    axes, start = _cell_frames(a, b)

    at = np.ix_(*cell)
    arms = poles - point[at][:, :, None, None]
    inside = np.einsum("abrc,abijc->abijr", axes[at], arms, optimize=True)
    low = _reduce(np.minimum, inside.min(axis=(2, 3)), first)
    high = _reduce(np.maximum, inside.max(axis=(2, 3)), first)
    radius = np.sqrt(_reduce(np.maximum, np.einsum("abijc,abijc->abij", arms, arms).max(axis=(2, 3)), first))
    # A control polygon is longer than its curve, and those of lines between the rows of poles are shorter than the longest row.
    along = [np.linalg.norm(np.diff(poles, axis=2 + k), axis=4).sum(axis=2 + k).max(axis=2) for k in (0, 1)]
    length_u = np.maximum.reduceat(np.add.reduceat(along[0], first[0], axis=0), first[1], axis=1)
    length_v = np.maximum.reduceat(np.add.reduceat(along[1], first[1], axis=1), first[0], axis=0)
    curvature = _reduce(np.maximum, _piece_curvatures(local, pieces[0], pieces[1], area), first)

    pad = BOX_PAD * size
    tables = [_widen(values, closed) for values in (CURVATURE_MARGIN * curvature, length_u, length_v)]
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


def _bezier_rows(pieces: Array, knots: Array, degree: int) -> Array:
    """Matrices (n, degree + 1, N) from the poles of a spline to Bezier poles over pieces of its spans."""
    nodes, to_poles = bezier_interpolation(degree)
    at = pieces[:-1, None] + np.diff(pieces)[:, None] * nodes
    return to_poles @ design_matrix(knots, degree, at.ravel()).reshape(*at.shape, -1)


def _cell_frames(a: Array, b: Array) -> tuple[Array, Array]:
    """Axes (..., 3, 3) and the affine map (..., 3) of cells with half sides a and b (..., 3)."""
    scale = np.sqrt(np.maximum((a**2).sum(axis=-1), (b**2).sum(axis=-1)))[..., None]
    first = unit(np.where(scale > 0, a / np.maximum(scale, 1e-300), 0.0), 1e-9)
    fallback = unit(b, 0.0)  # a = 0: the cell is a line, its axes are those of b and anything at a right angle
    other = unit(np.cross(fallback, np.eye(3)[np.abs(fallback).argmin(axis=-1)]), 0.0)
    other = np.where(other.any(axis=-1, keepdims=True), other, np.eye(3)[0])
    first = np.where(first.any(axis=-1, keepdims=True), first, other)
    across = b - (b * first).sum(axis=-1, keepdims=True) * first
    second = unit(np.where(scale > 0, across / np.maximum(scale, 1e-300), 0.0), 1e-9)
    other = unit(np.cross(first, np.eye(3)[np.abs(first).argmin(axis=-1)]), 0.0)
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


def _piece_curvatures(local: BSplineSurface, pieces_u: Array, pieces_v: Array, area: float) -> Array:
    """Largest sampled normal curvature of each piece: (pu, pv)."""
    lines = [subdivide(p, SAMPLES_PER_PIECE) for p in (pieces_u, pieces_v)]
    # at a border of a piece the sample belongs to its own span
    inset = [1e-9 * np.repeat(np.diff(p), SAMPLES_PER_PIECE) for p in (pieces_u, pieces_v)]
    side = np.array([1.0, *[0.0] * (SAMPLES_PER_PIECE - 2), -1.0])
    u, v = (
        line + step * np.tile(side, len(line) // SAMPLES_PER_PIECE) for line, step in zip(lines, inset, strict=True)
    )
    su, sv, suu, suv, svv = (local.grid(u, v, *d) for d in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2)))
    normal = np.cross(su, sv)
    length = np.linalg.norm(normal, axis=2)
    regular = length > SINGULAR_RATIO * area
    length = np.where(regular, length, 1.0)
    normal /= length[..., None]
    e, f, g = ((a * b).sum(axis=2) for a, b in ((su, su), (su, sv), (sv, sv)))
    p, q, r = ((a * normal).sum(axis=2) for a in (suu, suv, svv))
    mean = 0.5 * (p * g - 2 * q * f + r * e) / length**2
    gauss = (p * r - q * q) / length**2
    largest = np.where(regular, np.abs(mean) + np.sqrt(np.maximum(mean**2 - gauss, 0.0)), 0.0)
    n = SAMPLES_PER_PIECE
    return largest.reshape(len(u) // n, n, len(v) // n, n).max(axis=(1, 3))


def _widen(values: Array, wrap: tuple[bool, bool]) -> Array:
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


class FootSurface(NamedTuple):
    """What the search reads of a surface: the middle of its poles (3,), the start (2,) of its domain, its spans and its cells."""

    centre: Array
    origin: Array
    spans: SpanPolynomials
    cells: FootCells


def prepare_foot_surface(
    surface: BSplineSurface, closed: tuple[bool, bool] = (False, False), continuation: float = 0.0
) -> FootSurface:
    """The data of a surface for the search of foot points, with arguments and errors as of `tabulate_spans`."""
    local, spans = tabulate_spans(surface, closed, continuation)
    is_point = np.flatnonzero(find_point_sides(surface))
    pole, normal, curvature = _describe_poles(local, is_point, spans.speed, spans.size)
    spans = spans._replace(pole=pole, pole_normal=normal, pole_curvature=curvature)
    origin = np.array([interval[0] for interval in surface.domain])
    cells = make_cells(local, spans.box, closed, float(spans.speed.prod()), spans.size)
    return FootSurface(find_centre(surface), origin, spans, cells)


def _describe_poles(
    local: BSplineSurface, points: IntArray, speed: Array, size: float
) -> tuple[IntArray, Array, Array]:
    """Marks, normals and curvatures of the sides, of which some are points.

    About such a point the tangents t across the side are in one plane, and their normal curvatures are t . K t with one matrix K.
    """
    pole, normal, curvature = np.zeros(4, np.int64), np.zeros((4, 3)), np.zeros((4, 3, 3))
    for side in points.tolist():
        pole[side] = -1
        across = 1 if side in (0, 2) else 0
        far = side in (1, 2)
        along = np.linspace(*local.domain[1 - across], POLE_DIRECTIONS + 1)[:-1]
        at = np.array([local.domain[across][int(far)]])

        def derivative(a: int, b: int, across: int = across, along: Array = along, at: Array = at) -> Array:
            """Derivative a times across the side and b times along it: (POLE_DIRECTIONS, 3)."""
            grid = local.grid(along, at, b, a) if across else local.grid(at, along, a, b)
            return grid.reshape(-1, 3)

        first, second, turning = derivative(1, 0), derivative(2, 0), derivative(1, 1)
        tangent = unit(first, SINGULAR_RATIO * speed[across])
        # S_u = (v - v0) S_uv to first order, so that S_u x S_v has the direction of +- S_uv x S_v
        cross = np.cross(turning, first) if across else np.cross(first, turning)
        normals = unit(cross * (-1.0 if far else 1.0), 0.0)
        n = unit(normals.sum(axis=0), 0.0)
        if np.abs(tangent @ n).max() > SMOOTH_POLE or not tangent.any(axis=1).all() or not n.any():
            continue
        e = unit(np.cross(n, tangent[0]), 0.0)
        x, y = tangent @ tangent[0], tangent @ e
        bend = second @ n / np.einsum("nk,nk->n", first, first)
        rows = np.stack([x * x, 2 * x * y, y * y], axis=1)
        (a, b, c), *_ = np.linalg.lstsq(rows, bend, rcond=1e-10)
        if np.abs(rows @ [a, b, c] - bend).max() > SMOOTH_POLE * (np.abs(bend).max() + 1.0 / size):
            continue
        frame = np.stack([tangent[0], e])
        pole[side], normal[side], curvature[side] = 1, n, frame.T @ np.array([[a, b], [b, c]]) @ frame
    return pole, normal, curvature
