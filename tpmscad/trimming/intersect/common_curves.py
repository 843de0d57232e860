"""The common curves of two networks as splines: position and parameters on both faces, interpolated together.

The traced points are the first sites, at parameters near to the arc length. Where the spline misses a face, sites are added half
way: the spline's own points, moved onto both faces in the planes normal to it, so that the parameter is as smooth as the spline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import TrimmingError, format_point
from tpmscad.index_ranges import repeat_rows
from tpmscad.rigid_motion import Motion
from tpmscad.splines.alike_curves import AlikeCurves, interpolate_alike
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.trimming.intersect.common_points import Work, correct_point, find_tangent, make_work
from tpmscad.trimming.intersect.congruent_pairs import sort_ends
from tpmscad.trimming.intersect.face_face import trace_curves
from tpmscad.trimming.intersect.network_hits import CurveEnds, Network, evaluate_faces
from tpmscad.trimming.operands.network_tables import join_faces
from tpmscad.trimming.operands.patch_polynomials import PatchPolynomials, find_starts

DEGREE = 7
"""Degree of the curves; those of lattices' trims are of the same."""

MIN_SITES = 9
"""Least number of sites of a curve, one more than the degree needs."""

MAX_REFINEMENTS = 10
"""Times that intervals of a curve are halved at most."""

DEVIATION_MARGIN = 1.2
"""Factor on measured deviations: between the places where a curve is measured they are a little greater."""

MIN_LAST_STEP = 0.3
"""Part of the step before below which the last step is joined to it."""

MAX_STEP_RATIO = 2.2
"""Greatest ratio of adjacent steps: with four, a spline of degree 7 through the points of a hairpin swings by any length."""

SMOOTHING_STEPS = 3
"""Steps on either side of one over which the trend of their lengths is taken."""

CHECKS = np.array([0.15, 0.38, 0.62, 0.85])
"""Fractions of the intervals between sites at which a curve is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class CommonCurves:
    """A arcs on a face of each network, on [0, 1], with the second solid on the left seen from outside on the first network.

    `faces` (A, 2): the faces; `start`, `end` (A,): vertices, numbered as those of ends, and behind them those on no edge,
    `points` (n, 3); `curve` (A,): the arc's number in `curves` and in `pcurves`, those on the first network and on the second;
    copies share them. `motion` (A,): that of the second face, which the curves are moved by; `deviation` (A,): their distance
    from both faces.
    """

    faces: IntArray
    start: IntArray
    end: IntArray
    points: Array
    curve: IntArray
    motion: Motion
    curves: tuple[BSplineCurve, ...]
    pcurves: tuple[tuple[BSplineCurve, ...], tuple[BSplineCurve, ...]]
    deviation: Array


def trace_common_curves(
    first: Network, second: Network, ends: CurveEnds, n_vertices: int, tol: float, edges: tuple[IntArray, Array]
) -> CommonCurves:
    """The common curves of two networks, fitted to half of `tol`; TrimmingError where one is not resolved.

    n_vertices: the number of vertices so far; those on no edge follow. edges: as in `trace_curves`.
    """
    joined, ends = join_faces(first.faces, second.faces), sort_ends(ends)
    paths: list[Array] = []
    faces: list[IntArray] = []
    curve_of: list[int] = []
    start: list[int] = []
    end: list[int] = []
    loose: list[Array] = []
    pieces_of: dict[int, tuple[int, list[Array]]] = {}  # where they start, and their paths
    fitted_faces: list[IntArray] = []
    lines = _list_knot_lines(first.brep), _list_knot_lines(second.brep)
    placed = second.brep.faces.motion
    for number, curve in enumerate(trace_curves(first, second, joined, ends, tol, edges)):
        f, g = pair = ends.pairs[curve.pair]
        is_closed = curve.start < 0  # a closed curve has two edges at least
        if curve.like == number:
            own, half = curve.points, len(curve.points) // 2
            of_pair = [*lines[0][first.brep.faces.carrier[f]], *lines[1][second.brep.faces.carrier[g]]]
            pieces: list[Array] = []
            for part in (own[: half + 1], own[half:]) if is_closed else (own,):
                pieces += _cut_at_lines(joined.patches, np.array([f, g + len(first.faces.low)]), part, of_pair)
            pieces_of[number] = len(paths), pieces
            paths += pieces
            fitted_faces += [pair] * len(pieces)
        first_path, pieces = pieces_of[curve.like]
        between = [piece[0, :3] for piece in (pieces if is_closed else pieces[1:])]
        if curve.like != number and between:
            moved = placed[int(g)].apply(placed[int(fitted_faces[first_path][1])].apply_inverse(np.array(between)))
            between = list(moved)
        numbers = list(range(n_vertices + len(loose), n_vertices + len(loose) + len(between)))
        loose += between
        if is_closed:
            numbers.append(numbers[0])
        else:
            numbers = [int(ends.vertex[curve.start]), *numbers, int(ends.vertex[curve.end])]
        faces += [pair] * len(pieces)
        curve_of += range(first_path, first_path + len(pieces))
        start += numbers[:-1]
        end += numbers[1:]
    of_path = np.array(fitted_faces, np.int64).reshape(-1, 2)
    splines, deviation = _fit_paths(joined.patches, of_path + np.array([0, len(first.faces.low)]), paths, 0.5 * tol)
    face, curve_number = np.array(faces, np.int64).reshape(-1, 2), np.array(curve_of, np.int64)
    return CommonCurves(
        faces=face,
        start=np.array(start, np.int64),
        end=np.array(end, np.int64),
        points=np.array(loose).reshape(-1, 3),
        curve=curve_number,
        motion=placed[face[:, 1]],
        curves=tuple(
            BSplineCurve(placed[g].apply_inverse(poles[:, :3]), knots, DEGREE)
            for (knots, poles), g in zip(splines, of_path[:, 1].tolist(), strict=True)
        ),
        pcurves=(
            tuple(BSplineCurve(poles[:, 3:5].copy(), knots, DEGREE) for knots, poles in splines),
            tuple(BSplineCurve(poles[:, 5:7].copy(), knots, DEGREE) for knots, poles in splines),
        ),
        deviation=DEVIATION_MARGIN * deviation[curve_number],
    )


KNOT_CONTINUITY = 1
"""Greatest continuity of a surface across a knot line at which curves are cut: a curve that crosses a jump of the curvature is
not smooth in the parameters, and its spline converges with the square of its steps."""

KNOT_STEPS = 40
"""Bisections to the point in which a curve crosses a knot line."""

MIN_PIECE_STEPS, KNOT_MARGIN = 0.1, 1e-6
"""Of a step of a path: its points that are nearer to a knot line are left out; where an end of it is nearer, it is not cut."""


def _list_knot_lines(brep: Brep) -> list[tuple[Array, Array]]:
    """For each carrier its inner knots along u and along v across which it is no smoother than C^KNOT_CONTINUITY."""
    none = np.zeros(0), np.zeros(0)
    return [c.knot_lines(KNOT_CONTINUITY) if isinstance(c, BSplineSurface) else none for c in brep.carriers]


def _cut_at_lines(patches: PatchPolynomials, face: IntArray, path: Array, lines: Sequence[Array]) -> list[Array]:
    """The pieces of a path (n, 10) between the lines of constant u, v, s and r that it crosses."""
    places, rows = [np.arange(float(len(path)))], [path]
    for column, values in enumerate(lines, start=3):
        for value in values.tolist():
            side = path[:, column] > value
            for k in np.flatnonzero(side[:-1] != side[1:]).tolist():
                low, high = 0.0, 1.0
                for _ in range(KNOT_STEPS):
                    x = 0.5 * (low + high)
                    guess = (1 - x) * path[k] + x * path[k + 1]
                    row = _correct(patches, face[None], guess[None, :7], guess[None, 7:])
                    low, high = (x, high) if (row[0, column] > value) == side[k] else (low, x)
                known = np.concatenate([[0.0, len(path) - 1.0], *places[1:]])
                if np.abs(known - k - x).min() > KNOT_MARGIN:
                    places.append(np.array([k + x]))
                    rows.append(row)
    if len(rows) == 1:
        return [path]
    at, cuts = np.concatenate(places), np.concatenate(places[1:])
    kept = np.abs(at[:, None] - cuts).min(axis=1) > MIN_PIECE_STEPS
    kept[[0, len(path) - 1]] = kept[len(path) :] = True
    order = np.flatnonzero(kept)[np.argsort(at[kept])]
    ends = [0, *np.flatnonzero(order >= len(path)).tolist(), len(order) - 1]
    points = np.concatenate(rows)[order]
    return [points[i : j + 1] for i, j in zip(ends[:-1], ends[1:], strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """Points of paths one after another, `points` (N, 10), path i from start[i] to start[i + 1] - 1.

    `face` (P, 2): both faces of each.
    """

    points: Array
    start: IntArray
    face: IntArray

    @property
    def owner(self) -> IntArray:
        """The path of each point: (N,)."""
        return np.repeat(np.arange(len(self.face)), np.diff(self.start))

    @property
    def steps(self) -> Array:
        """Length (N - 1,) of the step from each point to the next, NaN behind the last point of a path."""
        length = np.linalg.norm(np.diff(self.points[:, :3], axis=0), axis=1)
        length[self.start[1:-1] - 1] = np.nan
        return length


def _fit_paths(
    patches: PatchPolynomials, face: IntArray, paths: list[Array], tol: float
) -> tuple[list[tuple[Array, Array]], Array]:
    """Knots on [0, 1] and poles (n, 7) of (x, u, v, s, r) for each path (n, 10), and its largest distance from both faces."""
    result: list[tuple[Array, Array]] = [(np.zeros(0), np.zeros((0, 7)))] * len(paths)
    deviation = np.zeros(len(paths))
    if not paths:
        return result, deviation
    start = find_starts([len(p) for p in paths])
    sites = grade_sites(patches, _join_last_steps(Paths(np.concatenate(paths), start, face)))
    points = np.split(sites.points, sites.start[1:-1])
    at: list[Array] = [np.zeros(0)] * len(paths)
    left = np.arange(len(paths))
    for refinement in range(MAX_REFINEMENTS + 1):
        count, missed = np.array([len(points[i]) for i in left.tolist()]), []
        for n in np.unique(count).tolist():
            members = left[count == n]
            values = np.stack([points[i][:, :7] for i in members.tolist()])
            t = np.stack([at[i] for i in members.tolist()]) if refinement else _choose_parameters(values)
            splines = interpolate_alike(t, values, DEGREE)
            apart = np.where(
                _find_turned(splines, t, values), np.inf, _measure_deviations(patches, face[members], splines, t)
            )
            deviation[members] = apart.max(axis=1)
            for k in np.flatnonzero(deviation[members] <= tol).tolist():
                knots = splines.knots[k]
                result[members[k]] = (knots - knots[0]) / (knots[-1] - knots[0]), splines.poles[k]
            k = np.flatnonzero(~(deviation[members] <= tol))
            missed.append(members[k])
            if len(k) and refinement < MAX_REFINEMENTS:
                splines = AlikeCurves(splines.knots[k], splines.poles[k], DEGREE)
                halved = _choose_intervals(t[k], apart[k] > tol)
                _halve_intervals(patches, face, splines, members[k], t[k], halved, points, at)
        left = np.concatenate(missed)
        if not len(left):
            return result, deviation
    worst = int(left[np.argmax(deviation[left])])
    raise TrimmingError(
        f"a common curve of two faces near {format_point(points[worst][0, :3])} is still {deviation[worst]:.2g} off them at "
        f"{len(points[worst])} points, over {tol:.2g}: the faces are nearly tangent there, or one of them is not smooth"
    )


def _choose_intervals(t: Array, failing: BoolArray) -> BoolArray:
    """The intervals (m, n - 1) between sites t (m, n) to halve: those that fail, and those that are too long beside them then."""
    halved, step = failing.copy(), np.diff(t, axis=1)
    while True:
        length = np.pad(np.where(halved, 0.5 * step, step), ((0, 0), (1, 1)), constant_values=np.inf)
        beside = np.minimum(length[:, :-2], length[:, 2:])
        long = (length[:, 1:-1] > MAX_STEP_RATIO * beside) & ~halved
        if not long.any():
            return halved
        halved |= long


def _halve_intervals(
    patches: PatchPolynomials,
    face: IntArray,
    splines: AlikeCurves,
    members: IntArray,
    t: Array,
    halved: BoolArray,
    points: list[Array],
    at: list[Array],
) -> None:
    """Give the paths `members` (m,), at sites t (m, n), sites in the middles of intervals (m, n - 1): in `points` and `at`."""
    middles = 0.5 * (t[:, 1:] + t[:, :-1])
    row, _ = np.nonzero(halved)
    guess, normal = splines(middles)[halved], splines(middles, 1)[:, :, :3][halved]
    a, b = (
        np.concatenate([points[i][part, :7] for i in members.tolist()])[halved.ravel()]
        for part in (slice(-1), slice(1, None))
    )
    turned = _find_turned(splines, t, np.stack([points[i][:, :7] for i in members.tolist()]))[halved]
    guess[turned], normal[turned] = 0.5 * (a + b)[turned], (b - a)[turned, :3]
    found = np.split(_correct(patches, face[members[row]], guess, normal), np.cumsum(halved.sum(axis=1))[:-1])
    for k, i in enumerate(members.tolist()):
        where = np.flatnonzero(halved[k]) + 1
        points[i] = np.insert(points[i], where, found[k], axis=0)
        at[i] = np.insert(t[k], where, middles[k][halved[k]])


def _join_last_steps(paths: Paths) -> Paths:
    """The paths without a last point but one that is much nearer to the end than to the point before."""
    long = np.flatnonzero(np.diff(paths.start) >= 3)
    end, steps = paths.start[long + 1] - 1, paths.steps
    drop = end[steps[end - 1] < MIN_LAST_STEP * steps[end - 2]] - 1
    dropped = np.bincount(paths.owner[drop], minlength=len(paths.face))
    start = paths.start - find_starts(dropped)
    return Paths(np.delete(paths.points, drop, axis=0), start, paths.face)


def grade_sites(patches: PatchPolynomials, paths: Paths) -> Paths:
    """The paths with points between theirs: `MIN_SITES` at least, and no step longer than its neighbours by `MAX_STEP_RATIO`."""
    parts = -(-(MIN_SITES - 1) // np.maximum(np.diff(paths.start) - 1, 1))[paths.owner[:-1]]
    while True:
        parts[paths.start[1:-1] - 1] = 1
        if (parts > 1).any():
            paths = _insert_sites(patches, paths, parts)
        step = np.concatenate([[np.nan], paths.steps, [np.nan]])
        beside = np.fmin(step[:-2], step[2:])  # NaN if a path has one step, which never is longer
        parts = np.where(step[1:-1] > MAX_STEP_RATIO * beside, 2, 1)
        if parts.max(initial=1) == 1:
            return paths


def _insert_sites(patches: PatchPolynomials, paths: Paths, parts: IntArray) -> Paths:
    """Steps divided into `parts` (N - 1,), by cubic Hermite interpolation of the points and tangents."""
    row, step = repeat_rows(parts - 1)
    x = ((step + 1) / parts[row])[:, None]
    a, b = paths.points[row], paths.points[row + 1]
    chord = (b - a)[:, :3]
    h = np.linalg.norm(chord, axis=1, keepdims=True)
    guess = (a + (b - a) * x)[:, :7]  # the parameters need a guess only
    bulge = h * ((1 - x) * a[:, 7:] - x * b[:, 7:]) - (1 - 2 * x) * chord
    guess[:, :3] += x * (1 - x) * bulge
    owner = paths.owner[row]
    found = _correct(patches, paths.face[owner], guess, (1 - x) * a[:, 7:] + x * b[:, 7:])
    added = np.bincount(owner, minlength=len(paths.face))
    start = paths.start + find_starts(added)
    return Paths(np.insert(paths.points, row + 1, found, axis=0), start, paths.face)


def _choose_parameters(paths: Array) -> Array:
    """Parameters (m, n) of the sites of paths (m, n, k), positions first: steps of their lengths, over the trend of these around.

    A spline of degree 7 in arc length through 14 sites, each step 1.6 times the one before, multiplies an error by up to 3e6,
    and a curve that leaves the fold of a patch swung by any length. Over the trend, a geometric mean of SMOOTHING_STEPS on
    either side taken twice, such steps are even, and the speed of the curve is as smooth as the trend.
    """
    lengths = np.log(np.linalg.norm(np.diff(paths[:, :, :3], axis=1), axis=2))
    n = min(SMOOTHING_STEPS, (lengths.shape[1] - 1) // 2)
    trend = lengths
    for _ in range(2):  # reflected in its ends, a geometric sequence is its own trend
        before = 2 * trend[:, :1] - trend[:, n:0:-1]
        after = 2 * trend[:, -1:] - trend[:, -2 : -n - 2 : -1]
        extended = np.concatenate([before, trend, after], axis=1)
        trend = sliding_window_view(extended, 2 * n + 1, axis=1).mean(axis=2)
    return np.concatenate([np.zeros((len(paths), 1)), np.cumsum(np.exp(lengths - trend), axis=1)], axis=1)


def _find_turned(splines: AlikeCurves, t: Array, values: Array) -> BoolArray:
    """Whether splines run back in intervals (m, n - 1) between sites t (m, n) of values (m, n, 7), and so swing beyond them."""
    checks = (t[:, :-1, None] + np.diff(t, axis=1)[:, :, None] * CHECKS).reshape(len(t), -1)
    velocity = splines(checks, 1)[:, :, :3].reshape(len(t), -1, len(CHECKS), 3)
    return np.asarray((np.einsum("mnkd,mnd->mnk", velocity, np.diff(values[:, :, :3], axis=1)) <= 0).any(axis=2))


def _measure_deviations(patches: PatchPolynomials, face: IntArray, splines: AlikeCurves, t: Array) -> Array:
    """Largest distances (m, n - 1) of splines, between sites t (m, n), from both their faces (m, 2) at equal parameters."""
    checks = (t[:, :-1, None] + np.diff(t, axis=1)[:, :, None] * CHECKS).reshape(len(t), -1)
    values = splines(checks).reshape(-1, 7)
    owner = np.repeat(face, checks.shape[1], axis=0)
    apart = np.zeros(len(values))
    for column, uv in ((0, values[:, 3:5]), (1, values[:, 5:7])):
        points = evaluate_faces(patches, owner[:, column], np.ascontiguousarray(uv))[:, 0]
        apart = np.maximum(apart, np.linalg.norm(points - values[:, :3], axis=1))
    return np.asarray(apart.reshape(len(t), -1, len(CHECKS)).max(axis=2))


def _correct(patches: PatchPolynomials, face: IntArray, guess: Array, normal: Array) -> Array:
    """Rows (n, 10) as of a path, in the planes through points (n, 7) near the curve; TrimmingError if one is not found."""
    found, good = correct_points(
        patches, *(np.ascontiguousarray(column) for column in (face, guess, normal)), make_work()
    )
    if not good.all():
        at = format_point(guess[np.flatnonzero(~good)[0], :3])
        raise TrimmingError(f"a common curve of two faces could not be followed near {at}")
    return found


@njit_cached
def correct_points(
    patches: PatchPolynomials, face: IntArray, guess: Array, normal: Array, work: Work
) -> tuple[Array, BoolArray]:  # pragma: no cover - compiled
    """Rows (n, 10) as of a path, in the planes through points (n, 7) normal to directions (n, 3), and which converged (n,)."""
    result, good = np.empty((len(guess), 10)), np.empty(len(guess), np.bool_)
    at = np.empty(4)
    for i in range(len(guess)):
        f, g = face[i, 0], face[i, 1]
        for c in range(4):
            at[c] = guess[i, 3 + c]
        good[i] = correct_point(patches, f, g, at, guess[i, :3], normal[i], work)
        find_tangent(patches, f, g, work)
        for c in range(4):
            result[i, 3 + c] = at[c]
        for d in range(3):
            result[i, d] = 0.5 * (work.jet_f[0, d] + work.jet_g[0, d])
            result[i, 7 + d] = work.tangent[d]
    return result, good
