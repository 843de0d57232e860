"""Tracing of the curves that two faces have in common, from their ends, and of the closed ones that no edge meets.

A point of a curve is (u, v, s, r) with S(u, v) = Q(s, r). From each end at which the curve enters both faces it is traced in
steps of a small turn, each corrected by Newton's method in the plane normal to the step, until it passes another end. Every
end is a start or a goal, so that what does not pair up is seen. Curves without ends are traced from seeds (`closed_curve_seeds`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad._compiled_loops import njit_cached, njit_inner
from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane
from tpmscad.errors import TrimmingError, format_point
from tpmscad.trimming.intersect.closed_curve_seeds import NONE, UNRESOLVED, find_seed, list_searched_pairs
from tpmscad.trimming.intersect.common_points import (
    MIN_SINE,
    Work,
    correct_point,
    find_tangent,
    make_work,
    meets,
    pass_fraction,
    range_of,
)
from tpmscad.trimming.intersect.congruent_pairs import group_congruent_pairs
from tpmscad.trimming.intersect.network_hits import CurveEnds, Network, locate_in_faces
from tpmscad.trimming.operands.network_tables import NetworkFaces
from tpmscad.trimming.operands.patch_polynomials import (
    BREAK_U,
    BREAK_V,
    PLANAR,
    SPANS_U,
    SPANS_V,
    PatchPolynomials,
    evaluate_face,
    find_starts,
)

MAX_TURN = 0.12
"""Radians by which a curve turns in one step: degree-7 interpolation of the steps is then near the tolerance."""

MAX_RANGE_FRACTION = 0.12
"""Part of a face's parameter ranges that one step passes at most."""

MAX_RATE_CHANGE = 0.35
"""Relative change of d(u, v)/dx in a step. Beside a point at which a patch is singular d(u, v)/dx goes like the inverse root
of the distance, so that steps must shrink with it; with steps of the turn alone the spline through the points swings widely
there."""

STEEP_SINE, MIN_MIDDLE_SINE = 0.5, 0.5
"""Sine of the angle between both faces below which the middle of a step is looked at, and the part of the sine at its end that
there must be: beside a point of contact two branches run towards each other, and a step may cross from the one to the other."""

MAX_OVERSHOOT = 0.3
"""Part of the ranges by which a curve may leave a face before it is lost: it passes its end within a step."""

MAX_STEPS = 20_000
"""Steps of one curve."""

MIN_STEP = 1e-8
"""Step, relative to the first one tried, below which a curve is lost."""

MAX_DRIFT = 0.2
"""Distance of a corrected point from the predicted one, in steps: a farther one may lie on another curve."""

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


@dataclass(frozen=True, slots=True, eq=False)
class TracedCurve:
    """A curve of the pair of faces in row `pair`, between two ends, -1 for both of a closed one.

    `points` (n, 10): position, (u, v) on the first face, (s, r) on the second, and unit tangent, of the curve `like`, of which it
    is a copy, moved with the second face; `like` is its own number if it was traced.
    """

    pair: int
    start: int
    end: int
    points: Array
    like: int


def trace_curves(
    first: Network,
    second: Network,
    joined: NetworkFaces,
    ends: CurveEnds,
    match_tol: float,
    edges: tuple[IntArray, Array],
) -> list[TracedCurve]:
    """All curves that the faces of two networks have in common; TrimmingError where one is not resolved.

    `joined`: the faces of the first network, then those of the second. `ends`: sorted, so that congruent pairs are found.
    `edges`: pairs of faces (n, 2) that have an edge in common, and its points (n, m, 10), as of a curve; these are not traced.
    """
    patches, pairs = joined.patches, ends.pairs + np.array([0, len(first.faces.low)])
    starts, enters = ends.start, ends.enters
    work, path = make_work(), np.empty((MAX_STEPS + 2, 10))
    curves: list[TracedCurve] = []
    found: dict[int, range] = {}
    rows = np.flatnonzero(np.diff(starts))
    congruent = group_congruent_pairs(first.brep, second.brep, ends, rows)
    for number, (k, like) in enumerate(zip(rows.tolist(), congruent.tolist(), strict=True)):
        begin = len(curves)
        if like != number:
            offset = int(starts[k] - starts[rows[like]])
            for c in (curves[i] for i in found[like]):
                curves.append(TracedCurve(k, c.start + offset, c.end + offset, c.points, c.like))
            continue
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
            curves.append(TracedCurve(k, own[i], own[goal], path[:count].copy(), len(curves)))
        found[number] = range(begin, len(curves))
    closed = _trace_closed_curves(first, second, joined, ends, curves, edges, match_tol, work, path)
    return curves + [replace(curve, like=len(curves) + i) for i, curve in enumerate(closed)]


def _move_to_pair(curve: TracedCurve, base: int, pair: tuple[int, int], first: Brep, second: Brep) -> Array:
    """The points (n, 10) of a curve on the pair of faces given; those of the curve are on the second network's face `base`."""
    motion, own = second.faces.motion[pair[1]], second.faces.motion[base]
    points = curve.points.copy()
    points[:, :3] = motion.apply(own.apply_inverse(points[:, :3]))
    points[:, 7:] = motion.apply_to_vectors(own.apply_inverse_to_vectors(points[:, 7:]))
    plane = first.carriers[first.faces.carrier[pair[0]]]
    if isinstance(plane, Plane):
        points[:, 3:5] = plane.parameters(first.faces.motion[pair[0]].apply_inverse(points[:, :3]))
    return points


def _trace_closed_curves(
    first: Network,
    second: Network,
    joined: NetworkFaces,
    ends: CurveEnds,
    known: list[TracedCurve],
    edges: tuple[IntArray, Array],
    match_tol: float,
    work: Work,
    path: Array,
) -> list[TracedCurve]:
    """The curves of pairs of faces that have no ends, besides the known ones and the edges that they have in common.

    The polygons of loops let some seeds in that lie just outside: their curves are known from then on, but not wanted. Of
    congruent pairs the first is searched, and the others if it has such curves, which may lie in the loops of those.
    """
    n_first = len(first.faces.low)
    pairs = ends.pairs + np.array([0, n_first])
    candidates = list_searched_pairs(joined, pairs)
    domains = _list_domains(joined.patches)
    like = group_congruent_pairs(first.brep, second.brep, ends, candidates, (domains[:n_first], domains[n_first:]))
    is_first = like == np.arange(len(like))
    beside = np.zeros(len(like), bool)
    factors = np.array([len(second.brep.faces), 1])
    keys = ends.pairs @ factors
    closed: list[TracedCurve] = []
    for part in (is_first, ~is_first):
        own = np.flatnonzero(part & (is_first | beside[like]))
        rows = candidates[own]
        curves = []
        for i in np.flatnonzero(np.isin([curve.pair for curve in known], rows)).tolist():
            curve, (f, g) = known[i], ends.pairs[known[i].pair].tolist()
            base = int(ends.pairs[known[curve.like].pair, 1])
            moved = curve.points if curve.like == i else _move_to_pair(curve, base, (f, g), first.brep, second.brep)
            curves.append(replace(curve, points=moved))
        at = np.searchsorted(keys, edges[0] @ factors)
        for i in np.flatnonzero(np.isin(at, rows)).tolist():
            curves.append(TracedCurve(int(at[i]), -1, -1, edges[1][i], -1))
        has_others = np.zeros(len(rows), bool)
        searched, found, outside = np.ascontiguousarray(pairs[rows]), list[TracedCurve](), list[TracedCurve]()
        seed, k = np.empty(4), 0
        while True:
            ordered = sorted([*curves, *found, *outside], key=lambda curve: curve.pair)
            points = np.concatenate([np.zeros((0, 10)), *(curve.points for curve in ordered)])
            bounds = find_starts([len(curve.points) for curve in ordered])
            of_pair = np.searchsorted([curve.pair for curve in ordered], np.append(rows, len(pairs))).astype(np.int64)
            outcome, k = find_seed(joined, searched, k, of_pair, bounds, points, seed, has_others, match_tol, work)
            if outcome == NONE:
                break
            if outcome == UNRESOLVED:
                _check_outcome(TOUCHING, work.jet_f[0])
            has_others[k] = True
            f, g = searched[k].tolist()
            inside = [
                locate_in_faces(n, np.array([i]), uv[None])[0][0]
                for n, i, uv in ((first, f, seed[:2]), (second, g - n_first, seed[2:]))
            ]
            evaluate_face(joined.patches, f, seed[0], seed[1], work.jet_f)
            places = work.jet_f[:1].copy()
            outcome, _, count = _trace(joined.patches, f, g, seed, -1, places, 1, path, match_tol, work)
            curve = TracedCurve(int(rows[k]), -1, -1, path[:count].copy(), -1)
            if all(inside) or count == 1:
                _check_outcome(outcome, path[count - 1, :3])
                found.append(curve)
            else:
                outside.append(curve)
        beside[own] = has_others
        closed += found
    return closed


def _list_domains(patches: PatchPolynomials) -> Array:
    """The parameters (F, 4) between which faces are known: u0, u1, v0, v1; 0 of planes, and of faces that meet none."""
    domains, layout = np.zeros((len(patches.layout), 4)), patches.layout
    curved = (layout[:, PLANAR] == 0) & (layout[:, SPANS_U] > 0)
    layout = layout[curved]
    first, spans = layout[:, [BREAK_U, BREAK_V]], layout[:, [SPANS_U, SPANS_V]]
    domains[curved] = patches.breaks[np.stack([first, first + spans], axis=2).reshape(-1, 4)]
    return domains


def trace_from(patches: PatchPolynomials, f: int, g: int, start: Array, match_tol: float) -> tuple[Array, bool]:
    """The points (n, 10) of a common curve from `start` (4,) on, and whether it returns there.

    It ends beyond the domain of a face, or where it cannot be followed.
    """
    work, path, places = make_work(), np.empty((MAX_STEPS + 2, 10)), np.empty((1, 3))
    evaluate_face(patches, f, start[0], start[1], work.jet_f)
    places[0] = work.jet_f[0]
    outcome, _, count = _trace(patches, f, g, start, -1, places, 1, path, match_tol, work)
    return path[:count].copy(), outcome == ARRIVED


def _check_outcome(outcome: int, place: Array) -> None:
    """TrimmingError, with the place, unless the outcome is that a curve has arrived."""
    if outcome != ARRIVED:
        raise TrimmingError(f"{REASONS[outcome]} near {format_point(place)}")


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
        span = range_of(patches, face, c % 2)
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
    at, new, middle, rate = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    origin, along = np.empty(3), np.empty(3)
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
        if sine < STEEP_SINE:
            for d in range(3):
                origin[d] = 0.5 * (path[count - 1, d] + work.jet_f[0, d])
            for c in range(4):
                middle[c] = 0.5 * (at[c] + new[c])
            found = correct_point(patches, f, g, middle, origin, along, work)
            between = find_tangent(patches, f, g, work)
            turned = 0.0
            for d in range(3):
                turned += work.tangent[d] * along[d]
                origin[d] = path[count - 1, d] + h * along[d]
            if not found or between < MIN_MIDDLE_SINE * sine or not turned > np.cos(MAX_TURN):
                h *= 0.5
                continue
            if not correct_point(patches, f, g, new, origin, along, work):
                h *= 0.5
                continue
            find_tangent(patches, f, g, work)
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
            ahead = pass_fraction(path, count - 1, places, k)
            if 0.0 < ahead < nearest and meets(patches, f, g, path, count - 1, ahead, places, k, match_tol, work):
                best, nearest = k, ahead
        if best >= 0:
            meets(patches, f, g, path, count - 1, nearest, places, best, match_tol, work)
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
def _store(path: Array, row: int, at: Array, work: Work) -> None:  # pragma: no cover - compiled
    """Write the point of the first face, parameters and tangent to a row of a path."""
    for d in range(3):
        path[row, d] = work.jet_f[0, d]
        path[row, 7 + d] = work.tangent[d]
    for c in range(4):
        path[row, 3 + c] = at[c]
