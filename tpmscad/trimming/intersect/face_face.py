"""Tracing of the curves that two faces have in common, from their ends, and of the closed ones that no edge meets.

A point of a curve is (u, v, s, r) with S(u, v) = Q(s, r). From each end at which the curve enters both faces it is traced in steps
of a small turn, each corrected by Newton's method in the plane normal to the step, until it passes another end. Every end is
a start or a goal, so that what does not pair up is seen.

Curves without ends are found by exclusion. Two cells, one of each face, are dropped if they are apart along a normal of one of
them, or along the curve. Where the derivatives vary so little in them that a curve passes once at most, the point on it is found
by Newton's method; it lies on a curve that is known, or is the seed of a closed one. Else both cells are divided.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.trimming.operands.network_tables import (
    BREAK_U,
    BREAK_V,
    SENSE,
    SPANS_U,
    SPANS_V,
    FaceCells,
    FaceTable,
    PatchPolynomials,
    evaluate_face,
    is_in_region,
)

MAX_TURN = 0.12
"""Radians by which a curve turns in one step: degree-7 interpolation of the steps is then near the tolerance."""

MAX_RANGE_FRACTION = 0.12
"""Part of a face's parameter ranges that one step passes at most."""

MAX_OVERSHOOT = 0.3
"""Part of the ranges by which a curve may leave a face before it is lost: it passes its end within a step."""

MAX_STEPS = 20_000
"""Steps of one curve."""

MIN_STEP = 1e-8
"""Step, relative to the first one tried, below which a curve is lost."""

MAX_DRIFT = 0.2
"""Distance of a corrected point from the predicted one, in steps: a farther one may lie on another curve."""

NEAR_PATH = 0.1
"""Distance from a step's chord, in steps, up to which a point may lie on the curve: it bulges by a 60th part."""

NEWTON_STEPS = 15
"""Largest number of Newton steps of a correction."""

STEP_TOL = 1e-14
"""Step, relative to the parameter ranges, at which a correction has converged."""

MIN_SINE = 1e-5
"""Sine of the angle between two faces below which a curve is not traced."""

MAX_DIVISIONS = 8
"""Halvings of two cells. What still is not resolved touches within 2^-16 of their bulge, without a crossing that is known."""

MAX_BOXES = 200_000
"""Pairs of cells of two faces, after which these count as lying in one another."""

INJECTIVE = 0.7
"""Bound in place of 1 in the test that a curve passes two cells once at most."""

SEED_REACH = 1.5
"""Half width, in cells, within which a point found for two cells is examined."""

ARRIVED, LOST, TANGENT, STUCK, CONTRARY, TOUCHING = range(6)
"""Outcomes of a trace: at another end; beyond a face without an end; faces tangent; no convergence; at a start; contact."""


class TracedCurves(NamedTuple):
    """The curves of n pairs of faces, and what went wrong.

    Attributes
    ----------
    pair : (C,)
        The row of the pair of each curve.
    start, end : (C,)
        The ends it joins, -1 for both of a closed curve.
    first : (C + 1,)
        Where its points start.
    points : (P, 10)
        Position, (u, v) on the first face, (s, r) on the second, and unit tangent.
    trouble : (T, 5)
        Row of the pair, outcome, and place of what was not resolved.
    """

    pair: IntArray
    start: IntArray
    end: IntArray
    first: IntArray
    points: Array
    trouble: Array


@njit_cached
def trace_curves(
    first: FaceTable,
    second: FaceTable,
    pairs: IntArray,
    end_start: IntArray,
    end_parameters: Array,
    end_enters: BoolArray,
    match_tol: float,
) -> tuple[IntArray, Array, Array]:  # pragma: no cover - compiled
    """All curves of pairs (n, 2) of faces; those of pair k have the ends end_start[k] to end_start[k + 1] - 1.

    The ends are corrected in `end_parameters` (E, 4). Returns rows (pair, start, end, first point), points (P, 10) and the
    trouble, as in `TracedCurves`.
    """
    curves, points, trouble = np.empty((64, 4), np.int64), np.empty((1024, 10)), np.empty((16, 5))
    n_curves, n_points, n_trouble = 0, 0, 0
    path = np.empty((MAX_STEPS + 2, 10))
    work = make_work()
    p, q = first.patches, second.patches
    seed = np.empty(4)
    for k in range(len(pairs)):
        f, g = pairs[k, 0], pairs[k, 1]
        e0, e1 = end_start[k], end_start[k + 1]
        places = np.empty((e1 - e0 + 1, 3))
        free = np.ones(e1 - e0, np.bool_)
        before = n_curves
        failed = False
        for e in range(e0, e1):
            outcome = _settle(p, f, q, g, end_parameters[e], work)
            places[e - e0] = work.jet_f[0]
            if outcome != ARRIVED:
                trouble, n_trouble = _note(trouble, n_trouble, k, outcome, work.jet_f[0])
                failed = True
        if failed:
            continue
        for e in range(e0, e1):
            if not end_enters[e]:
                continue
            outcome, goal, count = _trace(
                p, f, q, g, end_parameters[e], e - e0, places, e1 - e0, path, match_tol, work
            )
            if outcome == ARRIVED and (end_enters[e0 + goal] or not free[goal]):
                outcome = CONTRARY
            if outcome != ARRIVED:
                trouble, n_trouble = _note(trouble, n_trouble, k, outcome, path[count - 1, :3])
                failed = True
                continue
            free[goal] = False
            curves, n_curves, points, n_points = _append(
                curves, n_curves, points, n_points, path, count, k, e, e0 + goal
            )
        for e in range(e0, e1):
            if not end_enters[e] and free[e - e0] and not failed:
                trouble, n_trouble = _note(trouble, n_trouble, k, CONTRARY, places[e - e0])
                failed = True
        while not failed:
            outcome = _find_seed(
                first, f, second, g, curves[before:n_curves], points, n_points, seed, match_tol, work
            )
            if outcome == LOST:
                break
            if outcome == TOUCHING:
                trouble, n_trouble = _note(trouble, n_trouble, k, TOUCHING, work.jet_f[0])
                break
            evaluate_face(p, f, seed[0], seed[1], work.jet_f)
            places[e1 - e0] = work.jet_f[0]
            outcome, goal, count = _trace(
                p, f, q, g, seed, -1, places, e1 - e0 + 1, path, match_tol, work
            )
            if outcome == ARRIVED and goal != e1 - e0:
                outcome = CONTRARY
            if outcome != ARRIVED:
                trouble, n_trouble = _note(trouble, n_trouble, k, outcome, path[count - 1, :3])
                break
            curves, n_curves, points, n_points = _append(curves, n_curves, points, n_points, path, count, k, -1, -1)
    return curves[:n_curves], points[:n_points], trouble[:n_trouble]


class Work(NamedTuple):
    """Arrays that the loops write to: jets (3, 3) of both faces, the linear system (4, 5), tangent (3,), steps (4,)."""

    jet_f: Array
    jet_g: Array
    system: Array
    tangent: Array
    rate: Array
    point: Array


@njit_cached
def make_work() -> Work:  # pragma: no cover - compiled
    return Work(np.empty((3, 3)), np.empty((3, 3)), np.empty((4, 5)), np.empty(3), np.empty(4), np.empty(4))


@njit_cached
def _note(
    trouble: Array, count: int, pair: int, outcome: int, place: Array
) -> tuple[Array, int]:  # pragma: no cover - compiled
    """Add a row to the trouble."""
    if count == len(trouble):
        trouble = np.concatenate((trouble, np.empty_like(trouble)))
    trouble[count, 0], trouble[count, 1] = pair, outcome
    trouble[count, 2:] = place
    return trouble, count + 1


@njit_cached
def _append(
    curves: IntArray, n_curves: int, points: Array, n_points: int, path: Array, count: int, pair: int, start: int, end: int
) -> tuple[IntArray, int, Array, int]:  # pragma: no cover - compiled
    """Add a curve and its points."""
    if n_curves == len(curves):
        curves = np.concatenate((curves, np.empty_like(curves)))
    while n_points + count > len(points):
        points = np.concatenate((points, np.empty_like(points)))
    curves[n_curves, 0], curves[n_curves, 1], curves[n_curves, 2], curves[n_curves, 3] = pair, start, end, n_points
    points[n_points : n_points + count] = path[:count]
    return curves, n_curves + 1, points, n_points + count


@njit_cached
def _range_of(patches: PatchPolynomials, f: int, axis: int) -> float:  # pragma: no cover - compiled
    """The length of the range of u (axis 0) or v of a face."""
    first = patches.layout[f, BREAK_U + axis]
    return patches.breaks[first + patches.layout[f, SPANS_U + axis]] - patches.breaks[first]


@njit_cached
def correct_point(
    first: PatchPolynomials, f: int, second: PatchPolynomials, g: int, at: Array, origin: Array, normal: Array, work: Work
) -> bool:  # pragma: no cover - compiled
    """Move (u, v, s, r) `at` onto both faces in the plane through `origin` with `normal`; whether it has converged.

    The jets of both faces there are left in `work`.
    """
    a = work.system
    moved = np.inf
    for _ in range(NEWTON_STEPS):
        evaluate_face(first, f, at[0], at[1], work.jet_f)
        evaluate_face(second, g, at[2], at[3], work.jet_g)
        a[3, 4] = 0.0
        for c in range(4):
            a[3, c] = 0.0
        for d in range(3):
            for c in range(2):
                a[d, c], a[d, 2 + c] = work.jet_f[1 + c, d], -work.jet_g[1 + c, d]
                a[3, c] += 0.5 * work.jet_f[1 + c, d] * normal[d]
                a[3, 2 + c] += 0.5 * work.jet_g[1 + c, d] * normal[d]
            a[d, 4] = work.jet_g[0, d] - work.jet_f[0, d]
            a[3, 4] -= (0.5 * (work.jet_f[0, d] + work.jet_g[0, d]) - origin[d]) * normal[d]
        if not solve_four(a):
            return False
        step = 0.0
        for c in range(4):
            at[c] += a[c, 4]
            table, face = (first, f) if c < 2 else (second, g)
            step = max(step, abs(a[c, 4]) / _range_of(table, face, c % 2))
        if not step < 10.0:
            return False
        if step < STEP_TOL or (step >= moved and step < 1e-11):
            return True
        moved = step
    return False


@njit_cached
def solve_four(a: Array) -> bool:  # pragma: no cover - compiled
    """Solve the 4 x 4 system a[:, :4] x = a[:, 4] in place, x in the last column; False if it is singular."""
    for k in range(4):
        best = k
        for i in range(k + 1, 4):
            if abs(a[i, k]) > abs(a[best, k]):
                best = i
        if not abs(a[best, k]) > 0.0:
            return False
        if best != k:
            for c in range(k, 5):
                a[k, c], a[best, c] = a[best, c], a[k, c]
        for i in range(k + 1, 4):
            m = a[i, k] / a[k, k]
            for c in range(k + 1, 5):
                a[i, c] -= m * a[k, c]
    for k in range(3, -1, -1):
        for c in range(k + 1, 4):
            a[k, 4] -= a[k, c] * a[c, 4]
        a[k, 4] /= a[k, k]
    return True


@njit_cached
def find_tangent(
    first: PatchPolynomials, f: int, second: PatchPolynomials, g: int, work: Work
) -> float:  # pragma: no cover - compiled
    """Fill in the unit tangent n_f x n_g and the rates of (u, v, s, r) along it from the jets; returns the sine of the angle.

    The normals lead out of the solids: on the first face the second solid is on the left of the tangent, seen from outside.
    """
    p, q = work.jet_f, work.jet_g
    nx, ny, nz = p[1, 1] * p[2, 2] - p[1, 2] * p[2, 1], p[1, 2] * p[2, 0] - p[1, 0] * p[2, 2], p[1, 0] * p[2, 1] - p[1, 1] * p[2, 0]
    mx, my, mz = q[1, 1] * q[2, 2] - q[1, 2] * q[2, 1], q[1, 2] * q[2, 0] - q[1, 0] * q[2, 2], q[1, 0] * q[2, 1] - q[1, 1] * q[2, 0]
    n = np.sqrt(nx * nx + ny * ny + nz * nz)
    m = np.sqrt(mx * mx + my * my + mz * mz)
    tx, ty, tz = ny * mz - nz * my, nz * mx - nx * mz, nx * my - ny * mx
    t = np.sqrt(tx * tx + ty * ty + tz * tz)
    sine = t / (n * m)
    if not sine > 0.0:
        return 0.0
    t *= first.layout[f, SENSE] * second.layout[g, SENSE]
    tangent = work.tangent
    tangent[0], tangent[1], tangent[2] = tx / t, ty / t, tz / t
    for side in range(2):
        jet = p if side == 0 else q
        uu, uv, vv, tu, tv = 0.0, 0.0, 0.0, 0.0, 0.0
        for d in range(3):
            uu += jet[1, d] * jet[1, d]
            uv += jet[1, d] * jet[2, d]
            vv += jet[2, d] * jet[2, d]
            tu += jet[1, d] * tangent[d]
            tv += jet[2, d] * tangent[d]
        det = uu * vv - uv * uv
        work.rate[2 * side] = (tu * vv - tv * uv) / det
        work.rate[2 * side + 1] = (tv * uu - tu * uv) / det
    return sine


@njit_cached
def _settle(
    first: PatchPolynomials, f: int, second: PatchPolynomials, g: int, at: Array, work: Work
) -> int:  # pragma: no cover - compiled
    """Move an end onto both faces, in the plane normal to the curve through the middle of its two points."""
    evaluate_face(first, f, at[0], at[1], work.jet_f)
    evaluate_face(second, g, at[2], at[3], work.jet_g)
    if find_tangent(first, f, second, g, work) < MIN_SINE:
        return TANGENT
    origin = 0.5 * (work.jet_f[0] + work.jet_g[0])
    normal = work.tangent.copy()
    return ARRIVED if correct_point(first, f, second, g, at, origin, normal, work) else STUCK


@njit_cached
def _leaves(table: PatchPolynomials, f: int, u: float, v: float) -> bool:  # pragma: no cover - compiled
    """Whether (u, v) is farther beyond the domain of a face than a curve may overshoot."""
    bu, bv = table.layout[f, BREAK_U], table.layout[f, BREAK_V]
    u0, u1 = table.breaks[bu], table.breaks[bu + table.layout[f, SPANS_U]]
    v0, v1 = table.breaks[bv], table.breaks[bv + table.layout[f, SPANS_V]]
    du, dv = MAX_OVERSHOOT * (u1 - u0), MAX_OVERSHOOT * (v1 - v0)
    return u < u0 - du or u > u1 + du or v < v0 - dv or v > v1 + dv


@njit_cached
def _largest_step(
    first: PatchPolynomials, f: int, second: PatchPolynomials, g: int, rate: Array
) -> float:  # pragma: no cover - compiled
    """The length that passes `MAX_RANGE_FRACTION` of a parameter range at the rates given."""
    result = np.inf
    for c in range(4):
        table, face = (first, f) if c < 2 else (second, g)
        span = _range_of(table, face, c % 2)
        result = min(result, MAX_RANGE_FRACTION * span / max(abs(rate[c]), 1e-300))
    return result


@njit_cached
def _trace(
    first: PatchPolynomials,
    f: int,
    second: PatchPolynomials,
    g: int,
    start: Array,
    own: int,
    places: Array,
    n_places: int,
    path: Array,
    match_tol: float,
    work: Work,
) -> tuple[int, int, int]:  # pragma: no cover - compiled
    """Trace the curve from `start` (4,) along its tangent to the first of the places (n, 3) that it passes, not `own` at first.

    Returns the outcome, the place, and the number of points in `path`.
    """
    at, new, origin = start.copy(), np.empty(4), np.empty(3)
    evaluate_face(first, f, at[0], at[1], work.jet_f)
    evaluate_face(second, g, at[2], at[3], work.jet_g)
    if find_tangent(first, f, second, g, work) < MIN_SINE:
        path[0, :3] = work.jet_f[0]
        return TANGENT, -1, 1
    path[0, :3], path[0, 3:7], path[0, 7:] = work.jet_f[0], at, work.tangent
    rate = work.rate.copy()
    count = 1
    h = 0.5 * _largest_step(first, f, second, g, rate)
    least = MIN_STEP * h
    while count < MAX_STEPS:
        h = min(h, _largest_step(first, f, second, g, rate))
        if h < least:
            return STUCK, -1, count
        here, along = path[count - 1, :3], path[count - 1, 7:]
        for d in range(3):
            origin[d] = here[d] + h * along[d]
        for c in range(4):
            new[c] = at[c] + h * rate[c]
        if not correct_point(first, f, second, g, new, origin, along, work):
            h *= 0.5
            continue
        drift = 0.0
        for d in range(3):
            drift += (work.jet_f[0, d] - origin[d]) ** 2
        sine = find_tangent(first, f, second, g, work)
        cosine = 0.0
        for d in range(3):
            cosine += work.tangent[d] * along[d]
        if drift > (MAX_DRIFT * h) ** 2 or not cosine > np.cos(MAX_TURN):
            h *= 0.5
            continue
        if sine < MIN_SINE:
            return TANGENT, -1, count
        path[count, :3], path[count, 3:7], path[count, 7:] = work.jet_f[0], new, work.tangent
        rate[:] = work.rate
        best, nearest = -1, np.inf
        for k in range(n_places):
            if k == own and count == 1:
                continue
            if own < 0 and k == n_places - 1 and count < 3:
                continue
            ahead = _pass_fraction(path, count - 1, places[k])
            if 0.0 < ahead < nearest and _meets(first, f, second, g, path, count - 1, ahead, places[k], match_tol, work):
                best, nearest = k, ahead
        if best >= 0:
            _meets(first, f, second, g, path, count - 1, nearest, places[best], match_tol, work)
            find_tangent(first, f, second, g, work)
            path[count, :3], path[count, 3:7], path[count, 7:] = work.jet_f[0], work.point, work.tangent
            return ARRIVED, best, count + 1
        at[:] = new
        count += 1
        if _leaves(first, f, at[0], at[1]) or _leaves(second, g, at[2], at[3]):
            return LOST, -1, count
        if cosine > np.cos(0.4 * MAX_TURN):
            h *= 1.6
    return STUCK, -1, count


@njit_cached
def _pass_fraction(path: Array, row: int, place: Array) -> float:  # pragma: no cover - compiled
    """The fraction of the step from `row` at which it passes a place that is near its chord; -1 if it does not."""
    square, along, apart = 0.0, 0.0, 0.0
    for d in range(3):
        chord, arm = path[row + 1, d] - path[row, d], place[d] - path[row, d]
        square += chord * chord
        along += chord * arm
        apart += arm * arm
    ahead = along / square
    if not -1e-9 < ahead < 1.0 + 1e-9 or apart - ahead * along > NEAR_PATH**2 * square:
        return -1.0
    return max(ahead, 1e-300)


@njit_cached
def _meets(
    first: PatchPolynomials,
    f: int,
    second: PatchPolynomials,
    g: int,
    path: Array,
    row: int,
    ahead: float,
    place: Array,
    match_tol: float,
    work: Work,
) -> bool:  # pragma: no cover - compiled
    """Whether the curve passes a place, at about a fraction of the step from `row`; its parameters go to `work.point`."""
    along = path[row, 7:] * (1.0 - ahead) + path[row + 1, 7:] * ahead
    work.point[:] = path[row, 3:7] * (1.0 - ahead) + path[row + 1, 3:7] * ahead
    if not correct_point(first, f, second, g, work.point, place, along, work):
        return False
    apart = 0.0
    for d in range(3):
        apart = max(apart, abs(work.jet_f[0, d] - place[d]))
    return apart <= match_tol


@njit_cached
def _is_known(
    first: PatchPolynomials,
    f: int,
    second: PatchPolynomials,
    g: int,
    curves: IntArray,
    points: Array,
    n_points: int,
    place: Array,
    match_tol: float,
    work: Work,
) -> bool:  # pragma: no cover - compiled
    """Whether a place lies on one of the curves (rows of `trace_curves`)."""
    for k in range(len(curves)):
        last = curves[k + 1, 3] if k + 1 < len(curves) else n_points
        for row in range(curves[k, 3], last - 1):
            ahead = _pass_fraction(points, row, place)
            if ahead > 0.0 and _meets(first, f, second, g, points, row, ahead, place, match_tol, work):
                return True
    return False


@njit_cached
def _find_seed(
    first: FaceTable,
    f: int,
    second: FaceTable,
    g: int,
    curves: IntArray,
    points: Array,
    n_points: int,
    seed: Array,
    match_tol: float,
    work: Work,
) -> int:  # pragma: no cover - compiled
    """ARRIVED with a `seed` (4,) in both regions on no known curve, LOST if there is none, TOUCHING for a contact there."""
    stack = np.empty((16 * MAX_DIVISIONS + 32, 5))
    boxes = 0
    p, q = first.patches, second.patches
    origin, normal = np.empty(3), np.empty(3)
    for a in range(first.cells.first[f], first.cells.first[f + 1]):
        outside = False
        for d in range(3):
            x, r = first.cells.centre[a, d], first.cells.radius[a]
            outside = outside or x + r < second.low[g, d] or x - r > second.high[g, d]
        if outside:
            continue
        for b in range(second.cells.first[g], second.cells.first[g + 1]):
            apart = 0.0
            for d in range(3):
                apart += (first.cells.centre[a, d] - second.cells.centre[b, d]) ** 2
            reach = first.cells.radius[a] + second.cells.radius[b]
            if apart > reach * reach:
                continue
            stack[0, :4], stack[0, 4] = 0.0, 1.0
            size = 1
            while size:
                size -= 1
                w = stack[size, 4]
                box = stack[size, :4].copy()
                boxes += 1
                state = _examine_cells(p, f, q, g, first.cells, a, second.cells, b, box, w, seed, origin, normal, work)
                if state == 0:
                    continue
                if state == 1:
                    in_regions = is_in_region(first.regions, f, seed[0], seed[1]) and is_in_region(second.regions, g, seed[2], seed[3])
                    if in_regions and not _is_known(
                        p, f, q, g, curves, points, n_points, origin, match_tol, work
                    ):
                        return ARRIVED
                    continue
                if w < 2.0**-MAX_DIVISIONS or boxes > MAX_BOXES:
                    u = first.cells.middle[a, 0] + first.cells.half[a, 0] * box[0]
                    v = first.cells.middle[a, 1] + first.cells.half[a, 1] * box[1]
                    s = second.cells.middle[b, 0] + second.cells.half[b, 0] * box[2]
                    r = second.cells.middle[b, 1] + second.cells.half[b, 1] * box[3]
                    if state == 2 and is_in_region(first.regions, f, u, v) and is_in_region(second.regions, g, s, r):
                        evaluate_face(p, f, u, v, work.jet_f)
                        return TOUCHING
                    if boxes > MAX_BOXES:
                        return LOST
                    continue
                for i in range(16):
                    for c in range(4):
                        stack[size, c] = box[c] + 0.5 * w * (2 * ((i >> c) & 1) - 1)
                    stack[size, 4] = 0.5 * w
                    size += 1
    return LOST


@njit_cached
def _examine_cells(
    first: PatchPolynomials,
    f: int,
    second: PatchPolynomials,
    g: int,
    cells: FaceCells,
    a: int,
    others: FaceCells,
    b: int,
    box: Array,
    w: float,
    seed: Array,
    origin: Array,
    normal: Array,
    work: Work,
) -> int:  # pragma: no cover - compiled
    """0 if the parts of two cells have no common point, 1 with one in `seed` and `origin`, else 2, or 3 for one curve at most."""
    hu, hv = cells.half[a, 0], cells.half[a, 1]
    hs, hr = others.half[b, 0], others.half[b, 1]
    u, v = cells.middle[a, 0] + hu * box[0], cells.middle[a, 1] + hv * box[1]
    s, r = others.middle[b, 0] + hs * box[2], others.middle[b, 1] + hr * box[3]
    evaluate_face(first, f, u, v, work.jet_f)
    evaluate_face(second, g, s, r, work.jet_g)
    sine = find_tangent(first, f, second, g, work)
    p, q = work.jet_f, work.jet_g
    uu, uv, vv = cells.bend[a, 0], cells.bend[a, 1], cells.bend[a, 2]
    ss, sr, rr = others.bend[b, 0], others.bend[b, 1], others.bend[b, 2]
    rest = w * w * (0.5 * (uu + vv + ss + rr) + uv + sr)
    for axis in range(3):
        if axis == 0:
            _cross(p, normal)
        elif axis == 1:
            _cross(q, normal)
        else:
            if not sine > 0.0:
                break
            normal[:] = work.tangent
        apart, reach, length = 0.0, 0.0, 0.0
        gu, gv, gs, gr, shift = 0.0, 0.0, 0.0, 0.0, 0.0
        for d in range(3):
            apart += (p[0, d] - q[0, d]) * normal[d]
            gu += p[1, d] * normal[d]
            gv += p[2, d] * normal[d]
            gs += q[1, d] * normal[d]
            gr += q[2, d] * normal[d]
            length += normal[d] * normal[d]
            shift += abs(p[0, d] * normal[d])
        reach = w * (abs(gu) * hu + abs(gv) * hv + abs(gs) * hs + abs(gr) * hr)
        if abs(apart) > (1.0 + 1e-6) * reach + rest * np.sqrt(length) + 1e-14 * shift:
            return 0
    if sine < MIN_SINE:
        return 2
    # rows of the inverse of the map (parameters) -> (difference, coordinate along the curve), in units of the cells
    size = 0.0
    for c in range(3):
        for d in range(3):
            m = work.system
            for k in range(2):
                m[d, k] = p[1 + k, d] * (hu if k == 0 else hv)
                m[d, 2 + k] = -q[1 + k, d] * (hs if k == 0 else hr)
            m[d, 4] = 1.0 if d == c else 0.0
        _fill_plane_row(m, p, q, work.tangent, hu, hv, hs, hr)
        m[3, 4] = 0.0
        if not solve_four(m):
            return 2
        row = 0.0
        for k in range(4):
            row = max(row, abs(m[k, 4]))
        size += row * row
    m = work.system
    for d in range(3):
        for k in range(2):
            m[d, k] = p[1 + k, d] * (hu if k == 0 else hv)
            m[d, 2 + k] = -q[1 + k, d] * (hs if k == 0 else hr)
        m[d, 4] = 0.0
    _fill_plane_row(m, p, q, work.tangent, hu, hv, hs, hr)
    m[3, 4] = 1.0
    if not solve_four(m):
        return 2
    along = 0.0
    for k in range(4):
        along = max(along, abs(m[k, 4]))
    vary = w * (uu + 2.0 * uv + vv + ss + 2.0 * sr + rr)
    if (np.sqrt(size) + 0.5 * along) * vary > INJECTIVE:
        return 2
    for d in range(3):
        origin[d], normal[d] = 0.5 * (p[0, d] + q[0, d]), work.tangent[d]
    seed[0], seed[1], seed[2], seed[3] = u, v, s, r
    if not correct_point(first, f, second, g, seed, origin, normal, work):
        return 3
    reach = SEED_REACH * w
    if abs(seed[0] - u) > reach * hu or abs(seed[1] - v) > reach * hv:
        return 3
    if abs(seed[2] - s) > reach * hs or abs(seed[3] - r) > reach * hr:
        return 3
    origin[:] = work.jet_f[0]
    return 1


@njit_cached
def _cross(jet: Array, out: Array) -> None:  # pragma: no cover - compiled
    """S_u x S_v."""
    out[0] = jet[1, 1] * jet[2, 2] - jet[1, 2] * jet[2, 1]
    out[1] = jet[1, 2] * jet[2, 0] - jet[1, 0] * jet[2, 2]
    out[2] = jet[1, 0] * jet[2, 1] - jet[1, 1] * jet[2, 0]


@njit_cached
def _fill_plane_row(
    m: Array, p: Array, q: Array, normal: Array, hu: float, hv: float, hs: float, hr: float
) -> None:  # pragma: no cover - compiled
    """The derivatives of the mean point along a direction, in units of the cells."""
    for k in range(4):
        m[3, k] = 0.0
    for d in range(3):
        m[3, 0] += 0.5 * hu * p[1, d] * normal[d]
        m[3, 1] += 0.5 * hv * p[2, d] * normal[d]
        m[3, 2] += 0.5 * hs * q[1, d] * normal[d]
        m[3, 3] += 0.5 * hr * q[2, d] * normal[d]
