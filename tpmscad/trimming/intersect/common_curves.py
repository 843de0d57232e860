"""The common curves of two networks as splines: position and parameters on both faces, interpolated together.

The traced points are the first sites, at parameters near to the arc length. Where the spline misses a face, sites are added half
way: the spline's own points, moved onto both faces in the planes normal to it, so that the parameter is as smooth as the spline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import UntracedCurve, format_point
from tpmscad.index_ranges import repeat_rows
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.trimming.intersect.common_points import Work, correct_point, find_tangent, make_work
from tpmscad.trimming.intersect.face_face import trace_curves
from tpmscad.trimming.intersect.network_hits import CurveEnds, Network, evaluate_faces
from tpmscad.trimming.operands.network_tables import PatchPolynomials, join_faces

DEGREE = 7
"""Degree of the curves; those of lattices' trims are of the same."""

MIN_SITES = 9
"""Least number of sites of a curve, one more than the degree needs."""

MAX_REFINEMENTS = 6
"""Times that the sites of a curve are doubled at most."""

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

    `faces` (A, 2): the faces; `start`, `end` (A,): vertices, numbered as the hits, and behind them those on no edge, `points`
    (n, 3); `curves`, `first_pcurves`, `second_pcurves`: position and parameters; `deviation` (A,): their measured distance.
    """

    faces: IntArray
    start: IntArray
    end: IntArray
    points: Array
    curves: tuple[BSplineCurve, ...]
    first_pcurves: tuple[BSplineCurve, ...]
    second_pcurves: tuple[BSplineCurve, ...]
    deviation: Array


def trace_common_curves(first: Network, second: Network, ends: CurveEnds, n_hits: int, tol: float) -> CommonCurves:
    """The common curves of two networks, fitted to half of `tol`; TrimmingError where one is not resolved."""
    joined = join_faces(first.faces, second.faces)
    traced = trace_curves(first, second, joined, ends, tol)
    paths: list[Array] = []
    faces: list[IntArray] = []
    start: list[int] = []
    end: list[int] = []
    loose: list[Array] = []
    for curve in traced:
        own = curve.points
        if curve.start >= 0:
            paths.append(own)
            faces.append(ends.pairs[curve.pair])
            start.append(int(ends.vertex[curve.start]))
            end.append(int(ends.vertex[curve.end]))
            continue
        half = len(own) // 2  # a closed curve has two edges
        paths += [own[: half + 1], own[half:]]
        faces += [ends.pairs[curve.pair]] * 2
        number = n_hits + len(loose)
        loose += [own[0, :3], own[half, :3]]
        start += [number, number + 1]
        end += [number + 1, number]
    face = np.array(faces, np.int64).reshape(-1, 2)
    splines, deviation = _fit_paths(joined.patches, face + np.array([0, len(first.faces.low)]), paths, 0.5 * tol)
    return CommonCurves(
        faces=face,
        start=np.array(start, np.int64),
        end=np.array(end, np.int64),
        points=np.array(loose).reshape(-1, 3),
        curves=tuple(_take_columns(s, slice(0, 3)) for s in splines),
        first_pcurves=tuple(_take_columns(s, slice(3, 5)) for s in splines),
        second_pcurves=tuple(_take_columns(s, slice(5, 7)) for s in splines),
        deviation=deviation,
    )


def _take_columns(spline: BSpline, columns: slice) -> BSplineCurve:
    """Some coordinates of a spline, on [0, 1]."""
    knots = (spline.t - spline.t[0]) / (spline.t[-1] - spline.t[0])
    return BSplineCurve(np.ascontiguousarray(spline.c[:, columns]), knots, spline.k)


def _fit_paths(
    patches: PatchPolynomials, face: IntArray, paths: list[Array], tol: float
) -> tuple[list[BSpline], Array]:
    """A spline (x, u, v, s, r) for each path (n, 10), and its largest distance from both faces."""
    if not paths:
        return [], np.zeros(0)
    sites = grade_sites(patches, face, [_join_last_step(p) for p in paths])
    at = [_choose_parameters(p) for p in sites]
    values = [p[:, :7] for p in sites]
    splines = [make_interp_spline(t, v, DEGREE) for t, v in zip(at, values, strict=True)]
    deviation = np.zeros(len(paths))
    left = np.arange(len(paths))
    for refinement in range(MAX_REFINEMENTS + 1):
        deviation[left] = _measure_deviations(patches, face, splines, at, left)
        left = left[~(deviation[left] <= tol)]
        if not len(left):
            return splines, deviation
        if refinement == MAX_REFINEMENTS:
            break
        middles = [0.5 * (at[i][1:] + at[i][:-1]) for i in left]
        guess = np.concatenate([splines[i](t) for i, t in zip(left, middles, strict=True)])
        normal = np.concatenate([splines[i](t, 1)[:, :3] for i, t in zip(left, middles, strict=True)])
        owner = np.repeat(left, [len(t) for t in middles])
        found = _correct(patches, face[owner], guess, normal)
        for i, new, t in zip(left, np.split(found, np.cumsum([len(t) for t in middles])[:-1]), middles, strict=True):
            order = np.argsort(np.concatenate([at[i], t]), kind="stable")
            at[i] = np.concatenate([at[i], t])[order]
            values[i] = np.concatenate([values[i], new[:, :7]])[order]
            splines[i] = make_interp_spline(at[i], values[i], DEGREE)
    worst = left[np.argmax(deviation[left])]
    raise UntracedCurve(
        f"a common curve of two faces near {format_point(values[worst][0, :3])} is still {deviation[worst]:.2g} off them at "
        f"{len(at[worst])} points, over {tol:.2g}: the faces are nearly tangent there, or one of them is not smooth"
    )


def _join_last_step(path: Array) -> Array:
    """A path without its last point but one if that is much nearer to the end than to the point before."""
    if len(path) < 3:
        return path
    before, last = np.linalg.norm(np.diff(path[-3:, :3], axis=0), axis=1)
    return np.delete(path, -2, axis=0) if last < MIN_LAST_STEP * before else path


def grade_sites(patches: PatchPolynomials, face: IntArray, paths: list[Array]) -> list[Array]:
    """The paths with points between theirs: `MIN_SITES` at least, and no step longer than its neighbours by `MAX_STEP_RATIO`."""
    result = list(paths)
    parts = {i: np.full(len(p) - 1, -(-(MIN_SITES - 1) // (len(p) - 1))) for i, p in enumerate(paths)}
    while True:
        parts = {i: own for i, own in parts.items() if own.max() > 1}
        if parts:
            _insert_sites(patches, face, result, parts)
        parts = {}
        for i, path in enumerate(result):
            step = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1)
            beside = np.full(len(step), np.inf)
            beside[1:] = step[:-1]
            beside[:-1] = np.minimum(beside[:-1], step[1:])
            parts[i] = np.where(step > MAX_STEP_RATIO * beside, 2, 1)
        if all(own.max() == 1 for own in parts.values()):
            return result


def _insert_sites(patches: PatchPolynomials, face: IntArray, paths: list[Array], parts: dict[int, IntArray]) -> None:
    """Divide the steps of paths, in place, into `parts` (n,), by cubic Hermite interpolation of the points and tangents."""
    guesses, normals, owners = [], [], []
    for i, own in parts.items():
        path = paths[i]
        row, step = repeat_rows(own - 1)
        x = ((step + 1) / own[row])[:, None]
        a, b = path[row], path[row + 1]
        chord = (b - a)[:, :3]
        h = np.linalg.norm(chord, axis=1, keepdims=True)
        guess = (a + (b - a) * x)[:, :7]  # the parameters need a guess only
        bulge = h * ((1 - x) * a[:, 7:] - x * b[:, 7:]) - (1 - 2 * x) * chord
        guess[:, :3] += x * (1 - x) * bulge
        guesses.append(guess)
        normals.append((1 - x) * a[:, 7:] + x * b[:, 7:])
        owners.append(np.full(len(row), i))
    found = _correct(patches, face[np.concatenate(owners)], np.concatenate(guesses), np.concatenate(normals))
    for (i, own), new in zip(parts.items(), np.split(found, np.cumsum([len(g) for g in guesses])[:-1]), strict=True):
        at = np.repeat(np.arange(1, len(own) + 1), own - 1)
        paths[i] = np.insert(paths[i], at, new, axis=0)


def _choose_parameters(path: Array) -> Array:
    """Parameters (n,) of the sites of a path: steps of their lengths, over the trend of the lengths around.

    A spline of degree 7 in arc length through 14 sites, each step 1.6 times the one before, multiplies an error by up to 3e6,
    and a curve that leaves the fold of a patch swung by any length. Over the trend, a geometric mean of SMOOTHING_STEPS on
    either side taken twice, such steps are even, and the speed of the curve is as smooth as the trend.
    """
    lengths = np.log(np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1))
    n = min(SMOOTHING_STEPS, (len(lengths) - 1) // 2)
    trend = lengths
    for _ in range(2):  # reflected in its ends, a geometric sequence is its own trend
        before, after = 2 * trend[0] - trend[n:0:-1], 2 * trend[-1] - trend[-2 : -n - 2 : -1]
        trend = np.convolve(np.concatenate([before, trend, after]), np.full(2 * n + 1, 1 / (2 * n + 1)), "valid")
    return np.concatenate([[0.0], np.cumsum(np.exp(lengths - trend))])


def _measure_deviations(
    patches: PatchPolynomials,
    face: IntArray,
    splines: list[BSpline],
    at: list[Array],
    index: IntArray,
) -> Array:
    """Largest distances (m,) of the splines `index` (m,) from both their faces at equal parameters."""
    checks = [(t[:-1, None] + np.diff(t)[:, None] * CHECKS).ravel() for t in (at[i] for i in index)]
    values = np.concatenate([splines[i](t) for i, t in zip(index, checks, strict=True)])
    count = np.array([len(t) for t in checks])
    owner = np.repeat(index, count)
    apart = np.zeros(len(owner))
    for column, uv in ((0, values[:, 3:5]), (1, values[:, 5:7])):
        points = evaluate_faces(patches, face[owner, column], np.ascontiguousarray(uv))[:, 0]
        apart = np.maximum(apart, np.linalg.norm(points - values[:, :3], axis=1))
    return np.maximum.reduceat(apart, np.concatenate([[0], np.cumsum(count)[:-1]]))


def _correct(patches: PatchPolynomials, face: IntArray, guess: Array, normal: Array) -> Array:
    """Rows (n, 10) as of a path, in the planes through points (n, 7) near the curve; UntracedCurve if one is not found."""
    found, good = correct_points(
        patches, *(np.ascontiguousarray(column) for column in (face, guess, normal)), make_work()
    )
    if not good.all():
        at = format_point(guess[np.flatnonzero(~good)[0], :3])
        raise UntracedCurve(f"a common curve of two faces could not be followed near {at}")
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
