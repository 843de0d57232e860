"""Tracing of the curves that two faces have in common, from their ends, and of the closed ones that no edge meets.

A point of a curve is (u, v, s, r) with S(u, v) = Q(s, r). From each end at which the curve enters both faces it is traced in
steps of a small turn, each corrected by Newton's method in the plane normal to the step, until it passes another end. Every
end is a start or a goal, so that what does not pair up is seen.

Curves without ends are found by exclusion. Two cells, one of each face, are dropped if they are apart along a normal of one of
them, or along the curve. Where the derivatives vary so little in them that a curve passes once at most, the point on it is found
by Newton's method; it lies on a curve that is known, or is the seed of a closed one. Else both cells are divided.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached, njit_inner
from tpmscad._typing import Array, IntArray
from tpmscad.errors import TrimmingError, format_point
from tpmscad.trimming.intersect.network_hits import CurveEnds, Network, locate_in_faces
from tpmscad.trimming.operands.network_tables import (
    BREAK_U,
    BREAK_V,
    SENSE,
    SPANS_U,
    SPANS_V,
    FaceCells,
    NetworkFaces,
    PatchPolynomials,
    evaluate_face,
    is_in_region,
)

MAX_TURN = 0.12
"""Radians by which a curve turns in one step: degree-7 interpolation of the steps is then near the tolerance."""

MAX_RANGE_FRACTION = 0.12
"""Part of a face's parameter ranges that one step passes at most."""

MAX_RATE_CHANGE = 0.35
"""Relative change of d(u, v)/dx in a step. Beside a point at which a patch is singular d(u, v)/dx goes like the inverse root
of the distance, so that steps must shrink with it; with steps of the turn alone the spline through the points swings widely
there."""

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

REASONS = {
    LOST: "a common curve of two faces leaves them without crossing an edge",
    TANGENT: "two faces are tangent where they meet",
    STUCK: "a common curve of two faces could not be followed",
    CONTRARY: "the ends of the common curves of two faces do not pair up",
    TOUCHING: "two faces touch, or coincide in a part",
}
"""What went wrong with a pair of faces, by the outcome of its trace."""

APART, CROSSING, UNDECIDED, SINGLE = range(4)
"""Outcomes of the test of two cells."""


@dataclass(frozen=True, slots=True, eq=False)
class TracedCurve:
    """A curve of the pair of faces in row `pair`, between two ends, -1 for both of a closed one.

    `points` (n, 10): position, (u, v) on the first face, (s, r) on the second, and unit tangent.
    """

    pair: int
    start: int
    end: int
    points: Array


def trace_curves(
    first: Network, second: Network, joined: NetworkFaces, ends: CurveEnds, match_tol: float
) -> list[TracedCurve]:
    """All curves that the faces of two networks have in common; TrimmingError where one is not resolved.

    `joined`: the faces of the first network, then those of the second.
    """
    patches, pairs = joined.patches, ends.pairs + np.array([0, len(first.faces.low)])
    starts, enters = ends.start, ends.enters
    work, path = make_work(), np.empty((MAX_STEPS + 2, 10))
    curves: list[TracedCurve] = []
    for k in np.flatnonzero(np.diff(starts)).tolist():
        f, g = pairs[k].tolist()
        own = range(starts[k], starts[k + 1])
        places, settled = np.empty((len(own), 3)), ends.parameters[own.start : own.stop].copy()
        for i in range(len(own)):
            outcome = _settle(patches, f, g, settled[i], work)
            places[i] = work.jet_f[0]
            _check_outcome(outcome, places[i])
        free = ~enters[own.start : own.stop]
        if 2 * free.sum() != len(own):
            _check_outcome(CONTRARY, places[0])
        for i in np.flatnonzero(~free).tolist():
            outcome, goal, count = _trace(patches, f, g, settled[i], i, places, len(own), path, match_tol, work)
            if outcome == ARRIVED and not free[goal]:
                outcome = CONTRARY
            _check_outcome(outcome, path[count - 1, :3])
            free[goal] = False
            curves.append(TracedCurve(k, own[i], own[goal], path[:count].copy()))
    return curves + _trace_closed_curves(first, second, joined, pairs, curves, match_tol, work, path)


def _trace_closed_curves(
    first: Network,
    second: Network,
    joined: NetworkFaces,
    pairs: IntArray,
    known: list[TracedCurve],
    match_tol: float,
    work: Work,
    path: Array,
) -> list[TracedCurve]:
    """The curves of pairs of faces that have no ends, besides the known ones.

    The polygons of loops let some seeds in that lie just outside: their curves are known from then on, but not wanted.
    """
    closed: list[TracedCurve] = []
    outside: list[TracedCurve] = []
    seed, k = np.empty(4), 0
    while True:
        ordered = sorted([*known, *closed, *outside], key=lambda curve: curve.pair)
        points = np.concatenate([np.zeros((0, 10)), *(curve.points for curve in ordered)])
        bounds = np.concatenate([[0], np.cumsum([len(curve.points) for curve in ordered])]).astype(np.int64)
        of_pair = np.searchsorted([curve.pair for curve in ordered], np.arange(len(pairs) + 1)).astype(np.int64)
        outcome, k = _find_seed(joined, pairs, k, of_pair, bounds, points, seed, match_tol, work)
        if k == len(pairs):
            return closed
        _check_outcome(outcome, work.jet_f[0])
        f, g = pairs[k].tolist()
        inside = [
            locate_in_faces(n, np.array([i]), uv[None])[0][0]
            for n, i, uv in ((first, f, seed[:2]), (second, g - len(first.faces.low), seed[2:]))
        ]
        evaluate_face(joined.patches, f, seed[0], seed[1], work.jet_f)
        places = work.jet_f[:1].copy()
        outcome, _, count = _trace(joined.patches, f, g, seed, -1, places, 1, path, match_tol, work)
        curve = TracedCurve(k, -1, -1, path[:count].copy())
        if all(inside) or count == 1:
            _check_outcome(outcome, path[count - 1, :3])
            closed.append(curve)
        else:
            outside.append(curve)


def _check_outcome(outcome: int, place: Array) -> None:
    """TrimmingError, with the place, unless the outcome is that a curve has arrived."""
    if outcome != ARRIVED:
        raise TrimmingError(f"{REASONS[outcome]} near {format_point(place)}")


class Work(NamedTuple):
    """Arrays that loops write to: both jets (3, 3), a system (4, 5), tangent (3,), rates (4,), a point (4,), and a plane."""

    jet_f: Array
    jet_g: Array
    system: Array
    tangent: Array
    rate: Array
    point: Array
    place: Array
    normal: Array


def make_work() -> Work:
    """Arrays to write to."""
    return Work(
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((4, 5)),
        np.empty(3),
        np.empty(4),
        np.empty(4),
        np.empty(3),
        np.empty(3),
    )


@njit_inner
def _range_of(patches: PatchPolynomials, f: int, axis: int) -> float:  # pragma: no cover - compiled
    """The length of the range of u (axis 0) or v of a face."""
    begin = patches.layout[f, BREAK_U + axis]
    return patches.breaks[begin + patches.layout[f, SPANS_U + axis]] - patches.breaks[begin]


@njit_inner
def correct_point(
    patches: PatchPolynomials,
    f: int,
    g: int,
    at: Array,
    origin: Array,
    normal: Array,
    work: Work,
) -> bool:  # pragma: no cover - compiled
    """Move (u, v, s, r) `at` onto both faces in the plane through `origin` with `normal`; whether it has converged.

    The jets of both faces there are left in `work`.
    """
    a = work.system
    moved = np.inf
    for _ in range(NEWTON_STEPS):
        evaluate_face(patches, f, at[0], at[1], work.jet_f)
        evaluate_face(patches, g, at[2], at[3], work.jet_g)
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
            face = f if c < 2 else g
            step = max(step, abs(a[c, 4]) / _range_of(patches, face, c % 2))
        if not step < 10.0:
            return False
        if step < STEP_TOL or (step >= moved and step < 1e-11):
            return True
        moved = step
    return False


@njit_inner
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


@njit_inner
def find_tangent(patches: PatchPolynomials, f: int, g: int, work: Work) -> float:  # pragma: no cover - compiled
    """Fill in the unit tangent n_f x n_g and the rates of (u, v, s, r) along it from the jets; returns the sine of the angle.

    The normals lead out of the solids: on the first face the second solid is on the left of the tangent, seen from outside.
    """
    p, q = work.jet_f, work.jet_g
    nx, ny, nz = (
        p[1, 1] * p[2, 2] - p[1, 2] * p[2, 1],
        p[1, 2] * p[2, 0] - p[1, 0] * p[2, 2],
        p[1, 0] * p[2, 1] - p[1, 1] * p[2, 0],
    )
    mx, my, mz = (
        q[1, 1] * q[2, 2] - q[1, 2] * q[2, 1],
        q[1, 2] * q[2, 0] - q[1, 0] * q[2, 2],
        q[1, 0] * q[2, 1] - q[1, 1] * q[2, 0],
    )
    n = np.sqrt(nx * nx + ny * ny + nz * nz)
    m = np.sqrt(mx * mx + my * my + mz * mz)
    tx, ty, tz = ny * mz - nz * my, nz * mx - nx * mz, nx * my - ny * mx
    t = np.sqrt(tx * tx + ty * ty + tz * tz)
    sine = t / (n * m)
    if not sine > 0.0:
        return 0.0
    t *= patches.layout[f, SENSE] * patches.layout[g, SENSE]
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
def _settle(patches: PatchPolynomials, f: int, g: int, at: Array, work: Work) -> int:  # pragma: no cover - compiled
    """Move an end onto both faces, in the plane normal to the curve through the middle of its two points."""
    evaluate_face(patches, f, at[0], at[1], work.jet_f)
    evaluate_face(patches, g, at[2], at[3], work.jet_g)
    if find_tangent(patches, f, g, work) < MIN_SINE:
        return TANGENT
    for d in range(3):
        work.place[d] = 0.5 * (work.jet_f[0, d] + work.jet_g[0, d])
        work.normal[d] = work.tangent[d]
    return ARRIVED if correct_point(patches, f, g, at, work.place, work.normal, work) else STUCK


@njit_inner
def _leaves(table: PatchPolynomials, f: int, u: float, v: float) -> bool:  # pragma: no cover - compiled
    """Whether (u, v) is farther beyond the domain of a face than a curve may overshoot."""
    bu, bv = table.layout[f, BREAK_U], table.layout[f, BREAK_V]
    u0, u1 = table.breaks[bu], table.breaks[bu + table.layout[f, SPANS_U]]
    v0, v1 = table.breaks[bv], table.breaks[bv + table.layout[f, SPANS_V]]
    du, dv = MAX_OVERSHOOT * (u1 - u0), MAX_OVERSHOOT * (v1 - v0)
    return u < u0 - du or u > u1 + du or v < v0 - dv or v > v1 + dv


@njit_inner
def _largest_step(patches: PatchPolynomials, f: int, g: int, rate: Array) -> float:  # pragma: no cover - compiled
    """The length that passes `MAX_RANGE_FRACTION` of a parameter range at the rates given."""
    result = np.inf
    for c in range(4):
        face = f if c < 2 else g
        span = _range_of(patches, face, c % 2)
        result = min(result, MAX_RANGE_FRACTION * span / max(abs(rate[c]), 1e-300))
    return result


@njit_cached
def _trace(
    patches: PatchPolynomials,
    f: int,
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
    at, new, origin, along, rate = np.empty(4), np.empty(4), np.empty(3), np.empty(3), np.empty(4)
    for c in range(4):
        at[c] = start[c]
    evaluate_face(patches, f, at[0], at[1], work.jet_f)
    evaluate_face(patches, g, at[2], at[3], work.jet_g)
    if find_tangent(patches, f, g, work) < MIN_SINE:
        _store(path, np.int64(0), at, work)
        return TANGENT, -1, 1
    _store(path, np.int64(0), at, work)
    for c in range(4):
        rate[c] = work.rate[c]
    count: int = np.int64(1)  # type: ignore[assignment]  # callees would be compiled again for a literal
    h = 0.5 * _largest_step(patches, f, g, rate)
    least = MIN_STEP * h
    while count < MAX_STEPS:
        h = min(h, _largest_step(patches, f, g, rate))
        if h < least:
            return STUCK, -1, count
        for d in range(3):
            along[d] = path[count - 1, 7 + d]
            origin[d] = path[count - 1, d] + h * along[d]
        for c in range(4):
            new[c] = at[c] + h * rate[c]
        if not correct_point(patches, f, g, new, origin, along, work):
            h *= 0.5
            continue
        drift = 0.0
        for d in range(3):
            drift += (work.jet_f[0, d] - origin[d]) ** 2
        sine = find_tangent(patches, f, g, work)
        cosine = 0.0
        for d in range(3):
            cosine += work.tangent[d] * along[d]
        swerves = drift > (MAX_DRIFT * h) ** 2 or not cosine > np.cos(MAX_TURN)
        if swerves or _changes(rate, work.rate) > MAX_RATE_CHANGE or _jumps(at, new, rate, h):
            h *= 0.5
            continue
        if sine < MIN_SINE:
            return TANGENT, -1, count
        _store(path, count, new, work)
        for c in range(4):
            rate[c] = work.rate[c]
        best: int = np.int64(-1)  # type: ignore[assignment]
        nearest = np.inf
        for k in range(n_places):
            if k == own and count == 1:
                continue
            if own < 0 and k == n_places - 1 and count < 3:
                continue
            ahead = _pass_fraction(path, count - 1, places, k)
            if 0.0 < ahead < nearest and _meets(patches, f, g, path, count - 1, ahead, places, k, match_tol, work):
                best, nearest = k, ahead
        if best >= 0:
            _meets(patches, f, g, path, count - 1, nearest, places, best, match_tol, work)
            find_tangent(patches, f, g, work)
            _store(path, count, work.point, work)
            return ARRIVED, best, count + 1
        for c in range(4):
            at[c] = new[c]
        count += 1
        if _leaves(patches, f, at[0], at[1]) or _leaves(patches, g, at[2], at[3]):
            return LOST, -1, count
        if cosine > np.cos(0.4 * MAX_TURN):
            h *= 1.6
    return STUCK, -1, count


@njit_inner
def _changes(before: Array, after: Array) -> float:  # pragma: no cover - compiled
    """The greater relative change of d(u, v)/dx on the two faces."""
    result = 0.0
    for side in range(2):
        a, b, apart = 0.0, 0.0, 0.0
        for c in range(2 * side, 2 * side + 2):
            a += before[c] * before[c]
            b += after[c] * after[c]
            apart += (after[c] - before[c]) ** 2
        result = max(result, apart / max(min(a, b), 1e-300))
    return np.sqrt(result)


@njit_inner
def _jumps(before: Array, after: Array, rate: Array, h: float) -> bool:  # pragma: no cover - compiled
    """Whether the parameters of a step differ from h d(u, v)/dx by more than its change over the step explains.

    Beyond its ranges a patch may fold: a step that ends there is near in space, and on the curve's other branch.
    """
    for side in range(2):
        square, apart = 0.0, 0.0
        for c in range(2 * side, 2 * side + 2):
            square += (h * rate[c]) ** 2
            apart += (after[c] - before[c] - h * rate[c]) ** 2
        if apart > MAX_RATE_CHANGE**2 * square:
            return True
    return False


@njit_inner
def _copy_point(jet: Array, places: Array, row: int) -> None:  # pragma: no cover - compiled
    """Write the point of a jet to a row of places."""
    for d in range(3):
        places[row, d] = jet[0, d]


@njit_inner
def _store(path: Array, row: int, at: Array, work: Work) -> None:  # pragma: no cover - compiled
    """Write the point of the first face, parameters and tangent to a row of a path."""
    for d in range(3):
        path[row, d] = work.jet_f[0, d]
        path[row, 7 + d] = work.tangent[d]
    for c in range(4):
        path[row, 3 + c] = at[c]


@njit_inner
def _pass_fraction(path: Array, row: int, places: Array, k: int) -> float:  # pragma: no cover - compiled
    """The fraction of the step from `row` at which it passes a place that is near its chord; -1 if it does not."""
    square, along, apart = 0.0, 0.0, 0.0
    for d in range(3):
        chord, arm = path[row + 1, d] - path[row, d], places[k, d] - path[row, d]
        square += chord * chord
        along += chord * arm
        apart += arm * arm
    ahead = along / square
    if not -1e-9 < ahead < 1.0 + 1e-9 or apart - ahead * along > NEAR_PATH**2 * square:
        return -1.0
    return max(ahead, 1e-300)


@njit_inner
def _meets(
    patches: PatchPolynomials,
    f: int,
    g: int,
    path: Array,
    row: int,
    ahead: float,
    places: Array,
    k: int,
    match_tol: float,
    work: Work,
) -> bool:  # pragma: no cover - compiled
    """Whether the curve passes a place, at about a fraction of the step from `row`; its parameters go to `work.point`."""
    for d in range(3):
        work.normal[d] = path[row, 7 + d] * (1.0 - ahead) + path[row + 1, 7 + d] * ahead
        work.place[d] = places[k, d]
    for c in range(4):
        work.point[c] = path[row, 3 + c] * (1.0 - ahead) + path[row + 1, 3 + c] * ahead
    if not correct_point(patches, f, g, work.point, work.place, work.normal, work):
        return False
    apart = 0.0
    for d in range(3):
        apart = max(apart, abs(work.jet_f[0, d] - places[k, d]))
    return apart <= match_tol


@njit_inner
def _is_known(
    patches: PatchPolynomials,
    f: int,
    g: int,
    of_pair: IntArray,
    pair: int,
    bounds: IntArray,
    points: Array,
    places: Array,
    match_tol: float,
    work: Work,
) -> bool:  # pragma: no cover - compiled
    """Whether the first of the places lies on one of the known curves of a pair, as `_find_seed` gets them."""
    for k in range(of_pair[pair], of_pair[pair + 1]):
        for row in range(bounds[k], bounds[k + 1] - 1):
            ahead = _pass_fraction(points, row, places, np.int64(0))
            if ahead > 0.0 and _meets(patches, f, g, points, row, ahead, places, np.int64(0), match_tol, work):
                return True
    return False


@njit_cached
def _find_seed(
    faces: NetworkFaces,
    pairs: IntArray,
    begin: int,
    of_pair: IntArray,
    bounds: IntArray,
    points: Array,
    seed: Array,
    match_tol: float,
    work: Work,
) -> tuple[int, int]:  # pragma: no cover - compiled
    """ARRIVED and the next pair from `begin` on with a `seed` (4,) on no known curve; len(pairs) if there is none.

    The seed lies in the loops of both faces. TOUCHING and the pair for a contact that is not resolved. Pair k has the curves
    of_pair[k] to of_pair[k + 1] - 1, and curve c has the points bounds[c] to bounds[c + 1] - 1.
    """
    stack = np.empty((8 * MAX_DIVISIONS + 16, 6))
    origin, normal, box = np.empty((1, 3)), np.empty(3), np.empty(4)
    cells = faces.cells
    for k in range(begin, len(pairs)):
        f, g = pairs[k, 0], pairs[k, 1]
        boxes = 0
        for a in range(cells.first[f], cells.first[f + 1]):
            outside = False
            for d in range(3):
                at, r = cells.centre[a, d], cells.radius[a]
                outside = outside or at + r < faces.low[g, d] or at - r > faces.high[g, d]
            if outside:
                continue
            for b in range(cells.first[g], cells.first[g + 1]):
                apart = 0.0
                for d in range(3):
                    apart += (cells.centre[a, d] - cells.centre[b, d]) ** 2
                reach = cells.radius[a] + cells.radius[b]
                if apart > reach * reach:
                    continue
                for c in range(4):
                    stack[0, c] = 0.0
                stack[0, 4], stack[0, 5] = 1.0, 1.0
                size = 1
                while size:
                    size -= 1
                    w, x = stack[size, 4], stack[size, 5]
                    for c in range(4):
                        box[c] = stack[size, c]
                    boxes += 1
                    state = _examine_cells(faces.patches, f, g, cells, a, b, box, w, x, seed, origin, normal, work)
                    if state == APART:
                        continue
                    if state == CROSSING:
                        in_regions = is_in_region(faces.regions, f, seed[0], seed[1])
                        if (
                            in_regions
                            and is_in_region(faces.regions, g, seed[2], seed[3])
                            and not _is_known(faces.patches, f, g, of_pair, k, bounds, points, origin, match_tol, work)
                        ):
                            return ARRIVED, k
                        continue
                    divide_first = w * cells.radius[a] > x * cells.radius[b]
                    if (w if divide_first else x) < 2.0**-MAX_DIVISIONS or boxes > MAX_BOXES:
                        if state == UNDECIDED:
                            state = _settle_smallest_box(
                                faces,
                                f,
                                g,
                                a,
                                b,
                                box,
                                w,
                                x,
                                of_pair,
                                k,
                                bounds,
                                points,
                                seed,
                                origin,
                                normal,
                                match_tol,
                                work,
                            )
                            if state == CROSSING:
                                return ARRIVED, k
                            if state == UNDECIDED:
                                return TOUCHING, k
                        continue
                    shift = 0 if divide_first else 2
                    half = 0.5 * (w if divide_first else x)
                    for i in range(4):
                        for c in range(4):
                            stack[size, c] = box[c]
                        stack[size, shift] += half * (2 * (i & 1) - 1)
                        stack[size, shift + 1] += half * (2 * (i >> 1) - 1)
                        stack[size, 4], stack[size, 5] = (half, x) if divide_first else (w, half)
                        size += 1
    return LOST, len(pairs)


@njit_inner
def _settle_smallest_box(
    faces: NetworkFaces,
    f: int,
    g: int,
    a: int,
    b: int,
    box: Array,
    w: float,
    x: float,
    of_pair: IntArray,
    pair: int,
    bounds: IntArray,
    points: Array,
    seed: Array,
    origin: Array,
    normal: Array,
    match_tol: float,
    work: Work,
) -> int:  # pragma: no cover - compiled
    """The outcome for parts of two cells that are divided no further: where a patch is singular no bound decides.

    CROSSING with a `seed` on no known curve, UNDECIDED if neither a point nor a known curve is found near by, with the place in
    the jet of the first face; else SINGLE.
    """
    cells = faces.cells
    hu, hv, hs, hr = cells.half[a, 0], cells.half[a, 1], cells.half[b, 0], cells.half[b, 1]
    u, v = cells.middle[a, 0] + hu * box[0], cells.middle[a, 1] + hv * box[1]
    s, r = cells.middle[b, 0] + hs * box[2], cells.middle[b, 1] + hr * box[3]
    if not (is_in_region(faces.regions, f, u, v) and is_in_region(faces.regions, g, s, r)):
        return SINGLE
    evaluate_face(faces.patches, f, u, v, work.jet_f)
    evaluate_face(faces.patches, g, s, r, work.jet_g)
    sine = find_tangent(faces.patches, f, g, work)
    reach, apart = 0.0, 0.0
    for d in range(3):
        reach += w * (abs(work.jet_f[1, d]) * hu + abs(work.jet_f[2, d]) * hv)
        reach += x * (abs(work.jet_g[1, d]) * hs + abs(work.jet_g[2, d]) * hr)
        apart += abs(work.jet_f[0, d] - work.jet_g[0, d])
        origin[0, d] = 0.5 * (work.jet_f[0, d] + work.jet_g[0, d])
        work.place[d], normal[d] = origin[0, d], work.tangent[d]
    bend = w * w * (cells.bend[a, 0] + cells.bend[a, 1] + cells.bend[a, 2])
    reach = 4.0 * (reach + bend + x * x * (cells.bend[b, 0] + cells.bend[b, 1] + cells.bend[b, 2]) + apart)
    seed[0], seed[1], seed[2], seed[3] = u, v, s, r
    if sine > MIN_SINE and correct_point(faces.patches, f, g, seed, work.place, normal, work):
        moved = 0.0
        for d in range(3):
            moved = max(moved, abs(work.jet_f[0, d] - origin[0, d]))
        if moved < reach:
            if not (
                is_in_region(faces.regions, f, seed[0], seed[1]) and is_in_region(faces.regions, g, seed[2], seed[3])
            ):
                return SINGLE
            _copy_point(work.jet_f, origin, 0)
            known = _is_known(faces.patches, f, g, of_pair, pair, bounds, points, origin, match_tol, work)
            return SINGLE if known else CROSSING
    for row in range(bounds[of_pair[pair]], bounds[of_pair[pair + 1]] - 1):
        square, along, arm = 0.0, 0.0, 0.0
        for d in range(3):
            chord, way = points[row + 1, d] - points[row, d], origin[0, d] - points[row, d]
            square, along, arm = square + chord * chord, along + chord * way, arm + way * way
        ahead = min(max(along / max(square, 1e-300), 0.0), 1.0)
        if arm - 2.0 * ahead * along + ahead * ahead * square < reach * reach:
            return SINGLE
    evaluate_face(faces.patches, f, u, v, work.jet_f)
    return UNDECIDED


@njit_inner
def _examine_cells(
    patches: PatchPolynomials,
    f: int,
    g: int,
    cells: FaceCells,
    a: int,
    b: int,
    box: Array,
    w: float,
    x: float,
    seed: Array,
    origin: Array,
    normal: Array,
    work: Work,
) -> int:  # pragma: no cover - compiled
    """APART without a common point, CROSSING with one in `seed` and `origin`, SINGLE for one curve at most, else UNDECIDED."""
    hu, hv = cells.half[a, 0], cells.half[a, 1]
    hs, hr = cells.half[b, 0], cells.half[b, 1]
    u, v = cells.middle[a, 0] + hu * box[0], cells.middle[a, 1] + hv * box[1]
    s, r = cells.middle[b, 0] + hs * box[2], cells.middle[b, 1] + hr * box[3]
    evaluate_face(patches, f, u, v, work.jet_f)
    evaluate_face(patches, g, s, r, work.jet_g)
    sine = find_tangent(patches, f, g, work)
    p, q = work.jet_f, work.jet_g
    uu, uv, vv = cells.bend[a, 0], cells.bend[a, 1], cells.bend[a, 2]
    ss, sr, rr = cells.bend[b, 0], cells.bend[b, 1], cells.bend[b, 2]
    rest = w * w * (0.5 * (uu + vv) + uv) + x * x * (0.5 * (ss + rr) + sr)
    for axis in range(3):
        if axis == 0:
            _cross(p, normal)
        elif axis == 1:
            _cross(q, normal)
        else:
            if not sine > 0.0:
                break
            for d in range(3):
                normal[d] = work.tangent[d]
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
        reach = w * (abs(gu) * hu + abs(gv) * hv) + x * (abs(gs) * hs + abs(gr) * hr)
        if abs(apart) > (1.0 + 1e-6) * reach + rest * np.sqrt(length) + 1e-14 * shift:
            return APART
    if sine < MIN_SINE:
        return UNDECIDED
    # columns of the inverse of the map (parameters) -> (difference, coordinate along the curve), in units of the cells
    size, along = 0.0, 0.0
    for c in range(4):
        for k in range(4):
            jet, h = p if k < 2 else q, (hu, hv, hs, hr)[k]
            work.system[3, k] = 0.0
            for d in range(3):
                work.system[d, k] = h * jet[1 + k % 2, d] if k < 2 else -h * jet[1 + k % 2, d]
                work.system[3, k] += 0.5 * h * jet[1 + k % 2, d] * work.tangent[d]
            work.system[k, 4] = 1.0 if k == c else 0.0
        if not solve_four(work.system):
            return UNDECIDED
        along = 0.0
        for k in range(4):
            along = max(along, abs(work.system[k, 4]))
        size += along * along if c < 3 else 0.0
    vary = w * (uu + 2.0 * uv + vv) + x * (ss + 2.0 * sr + rr)
    if (np.sqrt(size) + 0.5 * along) * vary > INJECTIVE:
        return UNDECIDED
    for d in range(3):
        work.place[d], normal[d] = 0.5 * (p[0, d] + q[0, d]), work.tangent[d]
    seed[0], seed[1], seed[2], seed[3] = u, v, s, r
    if not correct_point(patches, f, g, seed, work.place, normal, work):
        return SINGLE
    if abs(seed[0] - u) > SEED_REACH * w * hu or abs(seed[1] - v) > SEED_REACH * w * hv:
        return SINGLE
    if abs(seed[2] - s) > SEED_REACH * x * hs or abs(seed[3] - r) > SEED_REACH * x * hr:
        return SINGLE
    _copy_point(work.jet_f, origin, 0)
    return CROSSING


@njit_inner
def _cross(jet: Array, out: Array) -> None:  # pragma: no cover - compiled
    """S_u x S_v."""
    out[0] = jet[1, 1] * jet[2, 2] - jet[1, 2] * jet[2, 1]
    out[1] = jet[1, 2] * jet[2, 0] - jet[1, 0] * jet[2, 2]
    out[2] = jet[1, 0] * jet[2, 1] - jet[1, 1] * jet[2, 0]
