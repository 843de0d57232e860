"""Foot points of many points on a B-spline surface: signed distance, gradient, Hessian and parameters, by compiled loops.

The search is global. Of the cells of the surface (`foot_surface`) only those are kept whose ball may hold a foot of a chunk of
points that lie together; for each point, then, those whose box is nearer than the best foot so far, the nearest first. From the
cell's parameters Newton's method minimises |S - p|^2 / 2, with the Hessian

    H_ij = S_i . S_j + (S - p) . S_ij = I - d II

modified where it is not safely positive definite, and with the parameters kept in their box. A cell is left out if no second
minimum can be there: the greatest normal curvature k on the way from the foot to the cell, the length L of the way and the
distance d of the foot satisfy k L < 1 and k (d + k L^2 / 2) < 1, so that |S - p|^2 is convex along the way.

At the foot, with the unit normal n along S_u x S_v and J = [S_u S_v],

    d = (S - p) . n with reversed sign,    grad d = n,    Hess d = -J I^-1 II (I - d II)^-1 J^T.

A foot is forced to the border if the surface ends before the normal through the point reaches it. Then d is the distance from the
tangent plane there: continuous, in absolute value at most the distance, and no distance function. A foot at a pole without a
tangent plane is forced, too; there d is the distance from the pole.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.foot_cells import WINDOWS, FootCells, FootSurface
from tpmscad.brep.foot_poles import (
    POLE_CHART,
    SAFE_DETERMINANT,
    SAFE_DIAGONAL,
    STEP_TOL,
    find_pole,
    settle_at_pole,
    turn_at_pole,
    write_pole_hessian,
)
from tpmscad.brep.foot_surface import SpanPolynomials, evaluate_spans

CHUNK = 32
"""Points for which cells are selected together."""

GRID_BITS = 6
"""Points are ordered along a grid of 2^6 boxes in each direction, so that chunks are compact."""

MAX_STEPS = 80
"""Newton steps of a run; more than 30 were seen only next to centres of curvature."""

NOISE_STEP = 1e-11
"""In sizes: steps below it that no longer shrink are round-off, which grows next to centres of curvature."""

SMALL_STEP = 1e-6
"""In sizes: below it Newton's steps are not tested by their distance, which no longer changes by more than its round-off."""

CONVEX = 0.9
"""Bound in place of 1 in the test that leaves cells out."""

CHORD = 1.15
"""Length of a way along the surface over its chord, at most, where it turns by less than a radian."""

FORCED_TANGENT = 1e-10
"""In sizes: tangential part of p - S above which a foot on the border is forced."""

NEAR_POLE = 1e-4
"""Of the greatest |S_u|: nearer to a smooth pole the Hessian is that of the pole, for S_u . S_u has too few digits."""

SINGULAR_AREA = 1e-12
"""Of the product of the greatest |S_u| and |S_v|: a foot with a smaller |S_u x S_v| is at a pole without a tangent plane."""


class FootPoints(NamedTuple):
    """Of n points.

    Attributes
    ----------
    distance : (n,)
        Signed distance, positive on the side of S_u x S_v.
    gradient : (n, 3)
        Unit normals at the feet.
    hessian : (n, 3, 3)
        Second derivatives of the distance; zero where forced; no rows if it was not asked for.
    parameters : (n, 2)
        u and v of the feet.
    forced : (n,)
        Whether the foot is forced to the border: distance and gradient are those of the tangent plane there, or to a pole
        without one.
    runs, steps : (n,), (n,)
        Newton runs, and Newton steps of all runs.
    failures : int
        Points whose run has not converged.
    """

    distance: Array
    gradient: Array
    hessian: Array
    parameters: Array
    forced: BoolArray
    runs: IntArray
    steps: IntArray
    failures: int


def find_foot_points(surface: FootSurface, points: Array, order: int = 2) -> FootPoints:
    """Foot points of points on a surface, each the nearest of all.

    Parameters
    ----------
    surface : FootSurface
        The surface, of `prepare_foot_surface`.
    points : ndarray, shape (n, 3)
        Points in model units.
    order : int, optional
        With 2 the Hessian is filled in, too.

    Returns
    -------
    FootPoints
        Distances, derivatives and parameters; `failures` says how many runs have not converged.
    """
    local = np.ascontiguousarray(points, float) - surface.centre
    n = len(local)
    distance, gradient, parameters = np.empty(n), np.empty((n, 3)), np.empty((n, 2))
    hessian = np.zeros((n if order > 1 else 0, 3, 3))
    forced, runs, steps = np.empty(n, np.bool_), np.empty(n, np.int64), np.empty(n, np.int64)
    failures = _find_all(
        surface.spans,
        surface.cells,
        local,
        _order_points(local),
        distance,
        gradient,
        hessian,
        parameters,
        forced,
        runs,
        steps,
    )
    parameters += surface.origin
    return FootPoints(distance, gradient, hessian, parameters, forced, runs, steps, failures)


def _order_points(points: Array) -> IntArray:
    """Numbers (n,) of the points in an order in which consecutive ones lie together: by interleaved bits of their boxes."""
    if len(points) <= CHUNK:
        return np.arange(len(points))
    low = points.min(axis=0)
    side = max(float(np.ptp(points, axis=0).max()), 1e-300)
    boxes = np.minimum((points - low) * (2**GRID_BITS / side), 2**GRID_BITS - 1).astype(np.int64)
    spread = np.zeros(2**GRID_BITS, np.int64)
    for bit in range(GRID_BITS):
        spread |= ((np.arange(2**GRID_BITS) >> bit) & 1) << (3 * bit)
    key = spread[boxes[:, 0]] | spread[boxes[:, 1]] << 1 | spread[boxes[:, 2]] << 2
    return np.argsort(key, kind="stable")


@njit_cached
def _find_all(
    spans: SpanPolynomials,
    cells: FootCells,
    points: Array,
    order: IntArray,
    distance: Array,
    gradient: Array,
    hessian: Array,
    parameters: Array,
    forced: BoolArray,
    runs: IntArray,
    steps: IntArray,
) -> int:  # pragma: no cover - compiled
    """Fill in the foot points of points (n, 3), in the given order; returns how many have not converged."""
    n, m = len(points), len(cells.radius)
    nv = len(cells.lines_v) - 1
    near, own, bound, apart = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(m), np.empty(m)
    middle = np.empty((3, m))
    jet, best = np.empty(18), np.empty(18)
    place, span = np.empty(2), np.zeros(2, np.int64)
    failures = 0
    for begin in range(0, n, CHUNK):
        end = min(begin + CHUNK, n)
        cx, cy, cz = 0.0, 0.0, 0.0
        for k in range(begin, end):
            i = order[k]
            cx, cy, cz = cx + points[i, 0], cy + points[i, 1], cz + points[i, 2]
        cx, cy, cz = cx / (end - begin), cy / (end - begin), cz / (end - begin)
        reach = 0.0
        for k in range(begin, end):
            i = order[k]
            reach = max(reach, (points[i, 0] - cx) ** 2 + (points[i, 1] - cy) ** 2 + (points[i, 2] - cz) ** 2)
        reach = np.sqrt(reach)
        least = np.inf
        for c in range(m):
            x, y, z = cx - cells.point[c, 0], cy - cells.point[c, 1], cz - cells.point[c, 2]
            apart[c] = np.sqrt(x * x + y * y + z * z)
            least = min(least, apart[c])
        count = 0
        for c in range(m):
            if apart[c] - cells.radius[c] <= least + 2.0 * reach:
                near[count] = c
                for r in range(3):
                    middle[r, count] = cells.point[c, r]
                count += 1
        for k in range(begin, end):
            i = order[k]
            px, py, pz = points[i, 0], points[i, 1], points[i, 2]
            nearest = np.inf
            for h in range(count):
                x, y, z = px - middle[0, h], py - middle[1, h], pz - middle[2, h]
                bound[h] = x * x + y * y + z * z
                nearest = min(nearest, bound[h])
            nearest = np.sqrt(nearest) * (1.0 + 1e-14)
            chosen, least, kept = 0, np.inf, np.int64(0)  # a literal 0 would compile `_leave_out` twice
            for h in range(count):
                apart_square, c = bound[h], near[h]
                if apart_square > (nearest + cells.radius[c]) ** 2:
                    continue
                x, y, z = px - middle[0, h], py - middle[1, h], pz - middle[2, h]
                square = 0.0
                for r in range(3):
                    t = x * cells.axes[c, r, 0] + y * cells.axes[c, r, 1] + z * cells.axes[c, r, 2]
                    t = max(max(t - cells.high[c, r], cells.low[c, r] - t), 0.0)
                    square += t * t
                # boxes that overlap are told apart by their middles
                first = square + 0.05 * apart_square
                if first < least:
                    chosen, least = kept, first
                bound[kept], own[kept] = square, c
                kept += 1
            u, v, best_square, n_runs, n_steps, converged = 0.0, 0.0, np.inf, 0, 0, True
            while chosen >= 0:
                bound[chosen] = np.inf
                c = own[chosen]
                cu, cv = c // nv, c % nv
                # the parameters whose point in the plane of the cell is nearest
                x, y, z = px - cells.point[c, 0], py - cells.point[c, 1], pz - cells.point[c, 2]
                s = x * cells.axes[c, 0, 0] + y * cells.axes[c, 0, 1] + z * cells.axes[c, 0, 2]
                t = x * cells.axes[c, 1, 0] + y * cells.axes[c, 1, 1] + z * cells.axes[c, 1, 2]
                t = min(max(t * cells.start[c, 2], -1.0), 1.0)
                s = min(max((s - cells.start[c, 1] * t) * cells.start[c, 0], -1.0), 1.0)
                low, high = cells.lines_u[cu], cells.lines_u[cu + 1]
                place[0] = 0.5 * ((low + high) + s * (high - low))
                low, high = cells.lines_v[cv], cells.lines_v[cv + 1]
                place[1] = 0.5 * ((low + high) + t * (high - low))
                taken = _descend(spans, px, py, pz, place, span, jet)
                n_runs, n_steps = n_runs + 1, n_steps + abs(taken)
                square = (jet[0] - px) ** 2 + (jet[1] - py) ** 2 + (jet[2] - pz) ** 2
                if square < best_square:
                    best_square, converged, u, v = square, taken > 0, place[0], place[1]
                    for r in range(18):
                        best[r] = jet[r]
                _leave_out(spans, cells, place, np.sqrt(square), own, kept, bound, best_square, taken > 0)
                chosen, least = -1, best_square * (1.0 - 1e-14)
                for h in range(kept):
                    if bound[h] < least:
                        chosen, least = h, bound[h]
            runs[i], steps[i] = n_runs, n_steps
            failures += not converged
            parameters[i, 0], parameters[i, 1] = u, v
            _write_jet(spans, i, px, py, pz, u, v, best, distance, gradient, hessian, forced)
    return failures


@njit_cached
def _leave_out(
    spans: SpanPolynomials,
    cells: FootCells,
    place: Array,
    distance: float,
    near: IntArray,
    count: int,
    bound: Array,
    limit: float,
    converged: bool,
) -> None:  # pragma: no cover - compiled
    """Set the bounds to infinity of cells that hold no nearer foot than the one found at `place`."""
    mu, mv = len(cells.lines_u) - 1, len(cells.lines_v) - 1
    if not converged:
        return
    iu, iv = mu - 1, mv - 1
    while iu > 0 and place[0] < cells.lines_u[iu]:
        iu -= 1
    while iv > 0 and place[1] < cells.lines_v[iv]:
        iv -= 1
    own = iu * mv + iv
    for h in range(count):
        if bound[h] >= limit:
            continue
        ju, jv = abs(near[h] // mv - iu), abs(near[h] % mv - iv)
        if spans.period[0] > 0.0:
            ju = min(ju, mu - ju)
        if spans.period[1] > 0.0:
            jv = min(jv, mv - jv)
        for w in range(len(WINDOWS) + 1):
            if w < len(WINDOWS) and max(ju, jv) > WINDOWS[w]:
                continue
            k = cells.curvature[w, own]
            way = (ju + 1) * cells.length_u[w, own] + (jv + 1) * cells.length_v[w, own]
            if w == len(WINDOWS):  # the way may lead through a pole
                length_u, length_v = cells.length_u[w, own], cells.length_v[w, own]
                if spans.pole[0] == 1:
                    way = min(way, (iv + near[h] % mv + 2) * length_v)
                if spans.pole[2] == 1:
                    way = min(way, (2 * mv - iv - near[h] % mv) * length_v)
                if spans.pole[3] == 1:
                    way = min(way, (iu + near[h] // mv + 2) * length_u)
                if spans.pole[1] == 1:
                    way = min(way, (2 * mu - iu - near[h] // mv) * length_u)
            if k * way < 1.0:
                # a nearer foot is less than 2 d away
                way = min(way, 2.0 * CHORD * distance)
                if k * (distance + 0.5 * k * way * way) < CONVEX:
                    bound[h] = np.inf
                    break


@njit_cached
def _descend(
    spans: SpanPolynomials, px: float, py: float, pz: float, place: Array, span: IntArray, jet: Array
) -> int:  # pragma: no cover - compiled
    """Move `place` (2,) to a foot of p, leave the jet there; returns the number of steps, negative if it has not converged."""
    box, period = spans.box, spans.period
    size = spans.size
    u, v = place[0], place[1]
    if period[0] == 0.0:  # the end of a cell may lie beyond the box by its round-off
        u = min(max(u, box[0, 0]), box[0, 1])
    if period[1] == 0.0:
        v = min(max(v, box[1, 0]), box[1, 1])
    evaluate_spans(spans, u, v, span, jet)
    x, y, z = jet[0] - px, jet[1] - py, jet[2] - pz
    square = x * x + y * y + z * z
    last, turns = np.inf, 0
    damping_u, damping_v = 1e-30 * spans.speed[0] ** 2, 1e-30 * spans.speed[1] ** 2
    for step in range(1, MAX_STEPS + 1):
        gu, gv = x * jet[3] + y * jet[4] + z * jet[5], x * jet[6] + y * jet[7] + z * jet[8]
        e = jet[3] * jet[3] + jet[4] * jet[4] + jet[5] * jet[5] + damping_u
        f = jet[3] * jet[6] + jet[4] * jet[7] + jet[5] * jet[8]
        g = jet[6] * jet[6] + jet[7] * jet[7] + jet[8] * jet[8] + damping_v
        a = e + x * jet[9] + y * jet[10] + z * jet[11]
        b = f + x * jet[12] + y * jet[13] + z * jet[14]
        c = g + x * jet[15] + y * jet[16] + z * jet[17]
        # along a border the second derivative of one parameter counts alone
        only_u, only_v = max(abs(a), SAFE_DIAGONAL * e), max(abs(c), SAFE_DIAGONAL * g)
        if not (a > SAFE_DIAGONAL * e and c > SAFE_DIAGONAL * g and a * c - b * b > SAFE_DETERMINANT * e * g):
            area = e * g - f * f
            if area > 1e-8 * e * g:
                # multiples of the metric are added until no eigenvalue of I - d II is small or negative
                half, product = 0.5 * (a * g - 2.0 * b * f + c * e) / area, (a * c - b * b) / area
                smallest = half - np.sqrt(max(half * half - product, 0.0))
                more = max(abs(smallest), SAFE_DIAGONAL) - smallest
                a, b, c = a + more * e, b + more * f, c + more * g
            else:
                a, b, c = 1.001 * e, f, 1.001 * g
        at_u = period[0] == 0.0 and ((u <= box[0, 0] and gu >= 0.0) or (u >= box[0, 1] and gu <= 0.0))
        at_v = period[1] == 0.0 and ((v <= box[1, 0] and gv >= 0.0) or (v >= box[1, 1] and gv <= 0.0))
        if turns < 2 and (e < NEAR_POLE**2 * spans.speed[0] ** 2 or g < NEAR_POLE**2 * spans.speed[1] ** 2):
            side = find_pole(spans, u, v)
            if side >= 0:
                if settle_at_pole(spans, side, px, py, pz, place, span, jet):
                    return step
                if at_v if side % 2 == 0 else at_u:
                    turns += 1
                    if turn_at_pole(spans, side, px, py, pz, place, span, jet):
                        u, v = place[0], place[1]
                        x, y, z = jet[0] - px, jet[1] - py, jet[2] - pz
                        square = x * x + y * y + z * z
                        continue
                evaluate_spans(spans, u, v, span, jet)
        # at a pole one parameter moves nothing, and its derivatives are round-off
        at_u, at_v = at_u or e <= 1e6 * damping_u, at_v or g <= 1e6 * damping_v
        du, dv = 0.0, 0.0
        if not (at_u or at_v):
            determinant = a * c - b * b
            du, dv = (b * gv - c * gu) / determinant, (b * gu - a * gv) / determinant
            # a step out of the box is one along the border
            at_u = period[0] == 0.0 and ((u <= box[0, 0] and du < 0.0) or (u >= box[0, 1] and du > 0.0))
            at_v = period[1] == 0.0 and ((v <= box[1, 0] and dv < 0.0) or (v >= box[1, 1] and dv > 0.0))
        if at_u and at_v:
            du, dv = 0.0, 0.0
        elif at_u:
            du, dv = 0.0, -gv / only_v
        elif at_v:
            du, dv = -gu / only_u, 0.0
        length = np.sqrt(max(e * du * du + 2.0 * f * du * dv + g * dv * dv, 0.0))
        if length <= STEP_TOL * size or (length <= NOISE_STEP * size and length > 0.5 * last):
            place[0], place[1] = u, v
            return step
        # a step that leaves the box ends on its border, in the same direction: clipped one by one the parameters could rise
        share = 1.0
        if period[0] == 0.0 and not box[0, 0] <= u + du <= box[0, 1]:
            share = ((box[0, 0] if du < 0.0 else box[0, 1]) - u) / du
        if period[1] == 0.0 and not box[1, 0] <= v + share * dv <= box[1, 1]:
            share = ((box[1, 0] if dv < 0.0 else box[1, 1]) - v) / dv
        du, dv = share * du, share * dv
        last = length
        accepted, before = False, square
        for _ in range(16):
            to_u, to_v = u + du, v + dv
            if period[0] > 0.0:
                to_u -= period[0] * np.floor(to_u / period[0])
            else:
                to_u = min(max(to_u, box[0, 0]), box[0, 1])
            if period[1] > 0.0:
                to_v -= period[1] * np.floor(to_v / period[1])
            else:
                to_v = min(max(to_v, box[1, 0]), box[1, 1])
            evaluate_spans(spans, to_u, to_v, span, jet)
            x, y, z = jet[0] - px, jet[1] - py, jet[2] - pz
            square = x * x + y * y + z * z
            if square <= before or length <= SMALL_STEP * size:
                accepted = True
                break
            du, dv, length = 0.4 * du, 0.4 * dv, 0.4 * length
        if not accepted:
            place[0], place[1] = u, v
            evaluate_spans(spans, u, v, span, jet)
            return -step
        u, v = to_u, to_v
    place[0], place[1] = u, v
    return -MAX_STEPS


@njit_cached
def _write_jet(
    spans: SpanPolynomials,
    i: int,
    px: float,
    py: float,
    pz: float,
    u: float,
    v: float,
    jet: Array,
    distance: Array,
    gradient: Array,
    hessian: Array,
    forced: BoolArray,
) -> None:  # pragma: no cover - compiled
    """Write distance, gradient, Hessian and mark of point i from the jet of its foot."""
    box, period = spans.box, spans.period
    x, y, z = px - jet[0], py - jet[1], pz - jet[2]
    e = jet[3] * jet[3] + jet[4] * jet[4] + jet[5] * jet[5]
    f = jet[3] * jet[6] + jet[4] * jet[7] + jet[5] * jet[8]
    g = jet[6] * jet[6] + jet[7] * jet[7] + jet[8] * jet[8]
    side = -1
    if e < (NEAR_POLE * spans.speed[0]) ** 2:
        side = 0 if v - box[1, 0] < box[1, 1] - v else 2
    elif g < (NEAR_POLE * spans.speed[1]) ** 2:
        side = 3 if u - box[0, 0] < box[0, 1] - u else 1
    if side >= 0 and spans.pole[side] != 1:
        side = -1
    nx = jet[4] * jet[8] - jet[5] * jet[7]
    ny = jet[5] * jet[6] - jet[3] * jet[8]
    nz = jet[3] * jet[7] - jet[4] * jet[6]
    area = np.sqrt(nx * nx + ny * ny + nz * nz)
    if side >= 0 and area <= POLE_CHART * spans.speed[0] * spans.speed[1]:
        # n - K (S - P), for S_u has too few digits
        first = 6 if side % 2 == 0 else 3
        away = v - box[1, side // 2] if side % 2 == 0 else u - box[0, side % 3]
        ox, oy, oz = away * jet[first], away * jet[first + 1], away * jet[first + 2]
        curvature, normal = spans.pole_curvature[side], spans.pole_normal[side]
        nx = normal[0] - curvature[0, 0] * ox - curvature[0, 1] * oy - curvature[0, 2] * oz
        ny = normal[1] - curvature[1, 0] * ox - curvature[1, 1] * oy - curvature[1, 2] * oz
        nz = normal[2] - curvature[2, 0] * ox - curvature[2, 1] * oy - curvature[2, 2] * oz
        area = np.sqrt(nx * nx + ny * ny + nz * nz)
    is_singular = side < 0 and area <= SINGULAR_AREA * spans.speed[0] * spans.speed[1]
    if is_singular:  # the direction from which p is seen
        nx, ny, nz = x, y, z
        area = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)
    nx, ny, nz = nx / area, ny / area, nz / area
    d = x * nx + y * ny + z * nz
    distance[i] = d
    gradient[i, 0], gradient[i, 1], gradient[i, 2] = nx, ny, nz
    on_border = period[0] == 0.0 and (u <= box[0, 0] or u >= box[0, 1])
    on_border |= period[1] == 0.0 and (v <= box[1, 0] or v >= box[1, 1])
    x, y, z = x - d * nx, y - d * ny, z - d * nz
    forced[i] = is_singular or (on_border and x * x + y * y + z * z > (FORCED_TANGENT * spans.size) ** 2)
    if len(hessian) == 0:
        return
    if forced[i]:
        for r in range(3):
            for c in range(3):
                hessian[i, r, c] = 0.0
        return
    if side >= 0:
        write_pole_hessian(spans.pole_curvature[side], d, gradient[i], hessian[i])
        return
    p = jet[9] * nx + jet[10] * ny + jet[11] * nz
    q = jet[12] * nx + jet[13] * ny + jet[14] * nz
    s = jet[15] * nx + jet[16] * ny + jet[17] * nz
    # -I^-1 II (I - d II)^-1 = (M^-1 - I^-1) / -d with M = I - d II; without the division by d, from the adjugates:
    # M^-1 - I^-1 = M^-1 d II I^-1
    a, b, c = e - d * p, f - d * q, g - d * s
    by_m, by_i = a * c - b * b, e * g - f * f
    # left = II I^-1, rows; then M^-1 left
    l11, l12 = (p * g - q * f) / by_i, (q * e - p * f) / by_i
    l21, l22 = (q * g - s * f) / by_i, (s * e - q * f) / by_i
    h11, h12 = -(c * l11 - b * l21) / by_m, -(c * l12 - b * l22) / by_m
    h22 = -(a * l22 - b * l12) / by_m
    for r in range(3):
        for k in range(r, 3):
            value = h11 * jet[3 + r] * jet[3 + k] + h22 * jet[6 + r] * jet[6 + k]
            value += h12 * (jet[3 + r] * jet[6 + k] + jet[6 + r] * jet[3 + k])
            hessian[i, r, k] = value
            hessian[i, k, r] = value
