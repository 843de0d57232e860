"""Feet of many points on a B-spline surface, the nearest of all: by the nodes of a grid and Newton's method, in compiled loops.

A run starts at each node that is nearer to the point than its eight neighbours, the nearest one first, unless the spacing of the
nodes rules out a nearer foot there. It minimises |S - p|^2 / 2 with the Hessian I - d II, or with the metric I where that is not
positive definite, and with the parameters kept in their box. Near a centre of curvature two feet may have one nearest node; there
runs start beside the foot, too, along its greatest curvature. The distance is that along the normal n = S_u x S_v at the foot, to
the tangent plane where the surface ends before the normal through the point reaches it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.brep.foot_surface import (
    SIDES,
    SpanPolynomials,
    divide_evenly,
    evaluate_spans,
    find_centre,
    find_point_sides,
    tabulate_spans,
)
from tpmscad.splines.bspline import BSplineSurface

MAX_STARTS = 64
"""Nodes from which runs of one point start at most."""

MAX_STEPS = 60
"""Newton steps of a run; more than 30 were seen only next to centres of curvature."""

STEP_TOL, NOISE_STEP = 3e-15, 1e-11
"""In sizes: length of a step at which a run has converged, and below which steps that no longer shrink are round-off."""

SMALL_STEP = 1e-6
"""In sizes: steps below it are not tested by the distance, which no longer changes by more than its round-off."""

SAFE_RATIO = 1e-3
"""Least ratios of the Hessian's diagonal and determinant to those of the metric with which it is used."""

NEAR_POLE = 1e-8
"""Of the greatest |S_u| or |S_v|: below it the normal is found from S_uv, for S_u x S_v has too few digits."""

SMOOTH_POLE = 1e-4
"""Difference of normals from two sides of a pole up to which it has a tangent plane; else the normal is the way to the point."""

NEAR_CENTRE = 0.3
"""1 - d k at a foot, with its greatest curvature, below which there may be another foot near by, along this curvature."""

TWIN_RATIO = 1.02
"""Of the least squared distance: up to which it is looked for beside a foot that is not the nearest."""

SIDE_STEPS = (-3.2, -1.6, -0.8, -0.35, 0.35, 0.8, 1.6, 3.2)
"""In reaches of the node: where runs start beside such a foot."""

REACH = 0.75
"""Of the longest diagonal of the cells about a node: how far a foot is from its nearest node; a half if cells were flat."""


class SurfaceGrid(NamedTuple):
    """A surface for the search: the middle of its poles (3,), the start (2,) of its domain, its polynomials, and a grid of nodes.

    lines_u, lines_v: (a,), (b,) parameters of the nodes. nodes: (a, b, 3). reach (a, b): how far from a node a foot is whose
    nearest node it is, at most.
    """

    centre: Array
    origin: Array
    spans: SpanPolynomials
    lines_u: Array
    lines_v: Array
    nodes: Array
    reach: Array


class SurfaceFeet(NamedTuple):
    """Of n points: (u, v) (n, 2) of the feet, signed distances (n,) along the unit normals (n, 3) there."""

    parameters: Array
    distance: Array
    gradient: Array


def make_surface_grid(surface: BSplineSurface, closed: tuple[bool, bool], continuation: float) -> SurfaceGrid:
    """The data of a surface for the search of feet, with arguments and errors as of `tabulate_spans`."""
    local, spans = tabulate_spans(surface, closed, continuation)
    lines = divide_evenly(local, spans.box, float(spans.speed.prod()))
    nodes, origin = local.grid(*lines), np.array([interval[0] for interval in surface.domain])
    diagonals = nodes[1:, 1:] - nodes[:-1, :-1], nodes[1:, :-1] - nodes[:-1, 1:]
    cells = np.pad(np.max(np.linalg.norm(diagonals, axis=3), axis=0), 1)
    reach = REACH * np.max([cells[1:, 1:], cells[1:, :-1], cells[:-1, 1:], cells[:-1, :-1]], axis=0)
    is_point = find_point_sides(surface)
    for axis, sides in enumerate(SIDES):  # from a pole a run has no direction
        for end, side in zip((0, -1), sides, strict=True):
            np.moveaxis(nodes, axis, 0)[end if is_point[side] else slice(0, 0)] = np.inf
    return SurfaceGrid(find_centre(surface), origin, spans, *lines, np.ascontiguousarray(nodes), reach)


def find_feet(grid: SurfaceGrid, points: Array) -> SurfaceFeet:
    """The nearest feet of points (n, 3) on a surface."""
    local = np.ascontiguousarray(points, float) - grid.centre
    feet = SurfaceFeet(np.empty((len(local), 2)), np.empty(len(local)), np.empty((len(local), 3)))
    _find_all(grid, local, feet)
    return feet._replace(parameters=feet.parameters + grid.origin)


@njit_cached
def _find_all(grid: SurfaceGrid, points: Array, feet: SurfaceFeet) -> None:  # pragma: no cover - compiled
    """Fill in the feet of points (n, 3), all in the frame of the grid."""
    nu, nv = grid.reach.shape
    farthest = grid.reach.max()
    wrap_u, wrap_v = grid.spans.period[0] > 0.0, grid.spans.period[1] > 0.0
    square, start = np.empty((nu, nv)), np.empty((MAX_STARTS, 5))  # u, v, squared distance, its bound, reach
    jet, place, way, span = np.empty(18), np.empty(2), np.empty(2), np.zeros(2, np.int64)
    for i in range(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        least = np.inf
        for a in range(nu):
            for b in range(nv):
                x, y, z = px - grid.nodes[a, b, 0], py - grid.nodes[a, b, 1], pz - grid.nodes[a, b, 2]
                square[a, b] = x * x + y * y + z * z
                least = min(least, square[a, b])
        count, limit = 0, (np.sqrt(least) + 2.0 * farthest) ** 2
        for a in range(nu):
            for b in range(nv):
                if square[a, b] < limit and count < MAX_STARTS and _is_least(square, a, b, wrap_u, wrap_v):
                    r = grid.reach[a, b]
                    start[count, 0], start[count, 1] = grid.lines_u[a], grid.lines_v[b]
                    start[count, 2], start[count, 4] = square[a, b], r
                    start[count, 3] = square[a, b] - 2.0 * r * r - 0.5 * r * np.sqrt(square[a, b])
                    count += 1
        best, of_nodes = np.inf, count
        while True:
            chosen, least = -1, np.inf
            for k in range(count):
                if start[k, 3] < best and start[k, 2] < least:
                    chosen, least = k, start[k, 2]
            if chosen < 0:
                break
            start[chosen, 3] = np.inf
            place[0], place[1] = start[chosen, 0], start[chosen, 1]
            reached = _descend(grid.spans, px, py, pz, place, span, jet)
            if reached < best:
                best = reached
                feet.parameters[i, 0], feet.parameters[i, 1] = place[0], place[1]
            is_near = chosen < of_nodes and reached < TWIN_RATIO * best
            if is_near and _find_flattest_way(jet, px, py, pz, way) < NEAR_CENTRE:
                for step in SIDE_STEPS:
                    if count < MAX_STARTS:
                        for k in range(2):
                            start[count, k] = place[k] + step * start[chosen, 4] * way[k]
                        start[count, 2] = start[count, 3] = 0.0
                        count += 1
        evaluate_spans(grid.spans, feet.parameters[i, 0], feet.parameters[i, 1], span, jet)
        _write_normal(grid.spans, i, px - jet[0], py - jet[1], pz - jet[2], jet, feet)


@njit_cached
def _find_flattest_way(jet: Array, px: float, py: float, pz: float, way: Array) -> float:  # pragma: no cover - compiled
    """Fill in the (u, v) of length 1 in space along which |S - p|^2 rises the least; returns 1 - d k for that curvature."""
    x, y, z = jet[0] - px, jet[1] - py, jet[2] - pz
    e = jet[3] * jet[3] + jet[4] * jet[4] + jet[5] * jet[5]
    f = jet[3] * jet[6] + jet[4] * jet[7] + jet[5] * jet[8]
    g = jet[6] * jet[6] + jet[7] * jet[7] + jet[8] * jet[8]
    a = e + x * jet[9] + y * jet[10] + z * jet[11]
    b = f + x * jet[12] + y * jet[13] + z * jet[14]
    c = g + x * jet[15] + y * jet[16] + z * jet[17]
    area = e * g - f * f
    if not area > 1e-12 * e * g:
        return 1.0
    half, product = 0.5 * (a * g - 2.0 * b * f + c * e) / area, (a * c - b * b) / area
    root = half - np.sqrt(max(half * half - product, 0.0))
    a, b, c = a - root * e, b - root * f, c - root * g
    way[0], way[1] = (b, -a) if abs(a) / e > abs(c) / g else (c, -b)
    length = np.sqrt(e * way[0] * way[0] + 2.0 * f * way[0] * way[1] + g * way[1] * way[1])
    if not length > 0.0:  # a sphere
        way[0], way[1], length = 1.0, 0.0, np.sqrt(e)
    way /= length
    return root


@njit_cached
def _is_least(square: Array, a: int, b: int, wrap_u: bool, wrap_v: bool) -> bool:  # pragma: no cover - compiled
    """Whether a node is nearer than its neighbours; of equally near ones the first counts."""
    nu, nv = square.shape
    for da in range(-1, 2):
        for db in range(-1, 2):
            c, d = a + da, b + db
            if wrap_u:
                c %= nu
            if wrap_v:
                d %= nv
            if (da == 0 and db == 0) or not (0 <= c < nu and 0 <= d < nv):
                continue
            if square[c, d] < square[a, b] or (square[c, d] == square[a, b] and c * nv + d < a * nv + b):
                return False
    return True


@njit_cached
def _descend(
    spans: SpanPolynomials, px: float, py: float, pz: float, place: Array, span: IntArray, jet: Array
) -> float:  # pragma: no cover - compiled
    """Move `place` (2,) to a foot of p and leave the jet there, or next to it; returns the squared distance."""
    box, period = spans.box, spans.period
    u, v = _keep_in_box(spans, place[0], 0), _keep_in_box(spans, place[1], 1)
    evaluate_spans(spans, u, v, span, jet)
    x, y, z = jet[0] - px, jet[1] - py, jet[2] - pz
    square, last = x * x + y * y + z * z, np.inf
    for _ in range(MAX_STEPS):
        gu, gv = x * jet[3] + y * jet[4] + z * jet[5], x * jet[6] + y * jet[7] + z * jet[8]
        e = jet[3] * jet[3] + jet[4] * jet[4] + jet[5] * jet[5] + 1e-30 * spans.speed[0] ** 2
        f = jet[3] * jet[6] + jet[4] * jet[7] + jet[5] * jet[8]
        g = jet[6] * jet[6] + jet[7] * jet[7] + jet[8] * jet[8] + 1e-30 * spans.speed[1] ** 2
        a = e + x * jet[9] + y * jet[10] + z * jet[11]
        b = f + x * jet[12] + y * jet[13] + z * jet[14]
        c = g + x * jet[15] + y * jet[16] + z * jet[17]
        at_u = period[0] == 0.0 and ((u <= box[0, 0] and gu >= 0.0) or (u >= box[0, 1] and gu <= 0.0))
        at_v = period[1] == 0.0 and ((v <= box[1, 0] and gv >= 0.0) or (v >= box[1, 1] and gv <= 0.0))
        # at a pole one parameter moves nothing, and its derivatives are round-off
        at_u = at_u or e <= 1e-24 * spans.speed[0] ** 2
        at_v = at_v or g <= 1e-24 * spans.speed[1] ** 2
        du, dv = 0.0, 0.0
        if not (at_u or at_v):
            if not (a > SAFE_RATIO * e and c > SAFE_RATIO * g and a * c - b * b > SAFE_RATIO * (e * g - f * f)):
                a, c = e, g
                b = f if e * g - f * f > 1e-12 * e * g else 0.0
            determinant = a * c - b * b
            du, dv = (b * gv - c * gu) / determinant, (b * gu - a * gv) / determinant
            # a step out of the box is one along the border
            at_u = period[0] == 0.0 and ((u <= box[0, 0] and du < 0.0) or (u >= box[0, 1] and du > 0.0))
            at_v = period[1] == 0.0 and ((v <= box[1, 0] and dv < 0.0) or (v >= box[1, 1] and dv > 0.0))
        if at_u or at_v:
            du = 0.0 if at_u else -gu / max(a, SAFE_RATIO * e)
            dv = 0.0 if at_v else -gv / max(c, SAFE_RATIO * g)
        length = np.sqrt(max(e * du * du + 2.0 * f * du * dv + g * dv * dv, 0.0))
        if length <= STEP_TOL * spans.size or (length <= NOISE_STEP * spans.size and length > 0.5 * last):
            break
        # a step that leaves the box ends on its border, in the same direction: clipped one by one the parameters could rise
        share = 1.0
        if period[0] == 0.0 and not box[0, 0] <= u + du <= box[0, 1]:
            share = ((box[0, 0] if du < 0.0 else box[0, 1]) - u) / du
        if period[1] == 0.0 and not box[1, 0] <= v + share * dv <= box[1, 1]:
            share = ((box[1, 0] if dv < 0.0 else box[1, 1]) - v) / dv
        last, before, falls = length, square, False
        for _ in range(16):
            to_u, to_v = _keep_in_box(spans, u + share * du, 0), _keep_in_box(spans, v + share * dv, 1)
            evaluate_spans(spans, to_u, to_v, span, jet)
            x, y, z = jet[0] - px, jet[1] - py, jet[2] - pz
            square = x * x + y * y + z * z
            falls = square <= before or share * length <= SMALL_STEP * spans.size
            if falls:
                break
            share *= 0.4
        if not falls:
            square = before
            break
        u, v = to_u, to_v
    place[0], place[1] = u, v
    return square


@njit_cached
def _keep_in_box(spans: SpanPolynomials, t: float, axis: int) -> float:  # pragma: no cover - compiled
    """A parameter shifted by periods, or stopped at the border; next to a pole steps of 1e16 periods leave a shift no digits."""
    if spans.period[axis] > 0.0:
        t -= spans.period[axis] * np.floor(t / spans.period[axis])
    return min(max(t, spans.box[axis, 0]), spans.box[axis, 1])


@njit_cached
def _write_normal(
    spans: SpanPolynomials, i: int, x: float, y: float, z: float, jet: Array, feet: SurfaceFeet
) -> None:  # pragma: no cover - compiled
    """Write normal and distance of point i from its vector to the foot, reversed, and the jet of the foot."""
    length_u = np.sqrt(jet[3] * jet[3] + jet[4] * jet[4] + jet[5] * jet[5]) / spans.speed[0]
    length_v = np.sqrt(jet[6] * jet[6] + jet[7] * jet[7] + jet[8] * jet[8]) / spans.speed[1]
    normal = np.empty((2, 3))
    if min(length_u, length_v) >= NEAR_POLE:
        _cross(jet, 3, 6, 1.0, normal[0])
        normal[1] = normal[0]
    else:  # S_u is (v - v0) S_uv next to a pole across v, S_v is (u - u0) S_uv across u
        across = 1 if length_u < length_v else 0
        low, high = spans.box[across]
        is_low = 2.0 * feet.parameters[i, across] < low + high
        for k in range(2):  # from two sides: at a smooth pole they agree
            place = feet.parameters[i].copy()
            place[across] = low if is_low else high
            beside = place[1 - across] + 0.5 * k * (spans.box[1 - across, 1] - spans.box[1 - across, 0])
            place[1 - across] = beside if beside <= spans.box[1 - across, 1] else 2.0 * place[1 - across] - beside
            evaluate_spans(spans, place[0], place[1], np.zeros(2, np.int64), jet)
            _cross(jet, 12 if across else 3, 6 if across else 12, 1.0 if is_low else -1.0, normal[k])
    if not np.abs(normal[1] - normal[0]).max() < SMOOTH_POLE:
        normal[0, 0], normal[0, 1], normal[0, 2] = x, y, z
        normal[0] /= max(np.sqrt(x * x + y * y + z * z), 1e-300)
    nx, ny, nz = normal[0]
    feet.gradient[i, 0], feet.gradient[i, 1], feet.gradient[i, 2] = nx, ny, nz
    feet.distance[i] = x * nx + y * ny + z * nz


@njit_cached
def _cross(jet: Array, one: int, other: int, sign: float, normal: Array) -> None:  # pragma: no cover - compiled
    """Write the unit vector along the product of two derivatives of a jet, not a number if it vanishes."""
    x = sign * (jet[one + 1] * jet[other + 2] - jet[one + 2] * jet[other + 1])
    y = sign * (jet[one + 2] * jet[other] - jet[one] * jet[other + 2])
    z = sign * (jet[one] * jet[other + 1] - jet[one + 1] * jet[other])
    area = np.sqrt(x * x + y * y + z * z)
    if area > 0.0:
        normal[0], normal[1], normal[2] = x / area, y / area, z / area
    else:
        normal[:] = np.nan
