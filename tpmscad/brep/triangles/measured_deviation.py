"""Distances of chords from curves and of triangles from surfaces, and the division of what is too far.

A distance is measured at points of a grid on each chord or triangle, from the foot point. Between the points of the grid the
signed distance may exceed the larger neighbour by a sixth of its second difference, as for a quadratic function; this is added,
so that the figures are bounds wherever the distance is smooth between the points of a grid. A foot point that has not converged
gives a greater distance, never a smaller one.

A triangle that is too far from its surface is halved, together with its neighbour, at the middle of the side whose middle is
farthest from the surface (after M. C. Rivara, "Mesh refinement processes based on the generalized bisection of simplices",
SIAM J. Numer. Anal. 21 (1984), 604, who takes the longest side). Sides on edges, which neighbouring faces share, stay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.memory_limit import require_memory

Surfaces = Callable[[IntArray, Array], tuple[Array, Array, Array]]
"""Points and derivatives by u and v, (n, 3) each, of surfaces by number (n,) at parameters (n, 2)."""

Curves = Callable[[IntArray, Array], tuple[Array, Array]]
"""Points and derivatives, (n, 3) each, of curves by number (n,) at parameters (n,)."""

FOOT_STEPS = 12
"""Steps of Gauss and Newton towards a foot point, which starts at the same share of the corners' parameters. One or two serve but
beside the apex of a cone."""

FOOT_REL_TOL, FOOT_TOL = 0.02, 1e-3
"""In distances of the point, and in deviations: a foot point is not moved by less. A hundredth of the distance along the surface
makes up for 5e-5 of the distance itself."""

CHORD_FOOT_STEPS = 3
"""Positions at which the foot point of a point of a chord is sought."""

LEAST_DETERMINANT = 1e-12
"""Of the squared lengths of both derivatives: below it a surface is singular, and its foot point is not moved."""

CHORD_PARTS = 8
"""Parts of a chord between the points at which its distance is measured; second differences are those of a triangle's side, so
that a triangle beside the chord has no greater bound."""

TRIANGLE_PARTS = 4
"""Parts of a side of a triangle between the points of its grid."""

CLEAR_FRACTION, FAR_FRACTION = 0.6, 1.6
"""A triangle counts as within the deviation if an estimate from four points is below the first fraction of it, and as beyond it
above the second: only between these the distance is bounded."""

CURVE_SAMPLES = 64
"""Parts of an edge between the points from which its curvature is estimated, before chords are measured."""

BATCH = 200_000
"""Chords or triangles that are measured at a time, which limits the memory."""

BYTES_PER_CHORD = 1000
"""Memory taken at the peak for each chord of an edge, with what OCCT keeps of it, as measured."""

BYTES_PER_TRIANGLE = 600
"""Memory taken at the peak for each triangle while some are halved, as measured."""

PREDICTED_FRACTION, PREDICTIONS = 0.91, 4
"""Part of the deviation for which the number of chords is predicted, and predictions for ever less of it, before chords that miss
the deviation are halved, which makes up to twice as many as needed."""

MAX_HALVINGS = 40
"""Rounds in which chords and triangles are halved."""


def _make_grid(parts: int) -> tuple[Array, Array]:
    """Barycentric coordinates (k, 3) of the points of a grid on a triangle, and the rows (r, k) of its second differences."""
    at = [(i, j, parts - i - j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    number = {point: k for k, point in enumerate(at)}
    rows = []
    for (i, j, k), middle in number.items():
        for di, dj, dk in ((1, -1, 0), (0, 1, -1), (-1, 0, 1)):
            ends = [number[p] for p in ((i + di, j + dj, k + dk), (i - di, j - dj, k - dk)) if p in number]
            if len(ends) == 2:
                row = np.zeros(len(at))
                row[ends], row[middle] = 1.0, -2.0
                rows.append(row)
    return np.array(at) / parts, np.array(rows)


GRID, SECOND_DIFFERENCES = _make_grid(TRIANGLE_PARTS)

SIDE_MIDDLES = np.array([[1, 1, 0], [0, 1, 1], [1, 0, 1]]) / 2.0
"""Barycentric coordinates of the middles of the sides from corner k to k + 1."""

MIDDLES = np.concatenate([SIDE_MIDDLES, np.full((1, 3), 1.0 / 3.0)])


def bound_chords(curves: Curves, curve: IntArray, ends: Array, points: Array) -> Array:
    """Greatest distances (c,) of chords from curves (c,) between parameters `ends` (c, 2), where they have points (c, 2, 3)."""
    if len(curve) > BATCH:
        parts = (slice(start, start + BATCH) for start in range(0, len(curve), BATCH))
        return np.concatenate([bound_chords(curves, curve[part], ends[part], points[part]) for part in parts])
    share = np.linspace(0.0, 1.0, CHORD_PARTS + 1)
    t = (ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])).ravel()
    at = (points[:, :1] + share[:, None] * (points[:, 1:] - points[:, :1])).reshape(-1, 3)
    which, low, high = (np.repeat(a, len(share)) for a in (curve, ends.min(axis=1), ends.max(axis=1)))
    best = np.full(len(t), np.inf)
    for _ in range(CHORD_FOOT_STEPS):
        position, along = curves(which, t)
        miss = at - position
        best = np.minimum(best, np.linalg.norm(miss, axis=1))
        speed = np.einsum("ni,ni->n", along, along)
        move = np.divide(np.einsum("ni,ni->n", miss, along), speed, out=np.zeros_like(speed), where=speed > 0)
        t = np.clip(t + move, low, high)
    distance = best.reshape(-1, len(share))
    step = CHORD_PARTS // TRIANGLE_PARTS
    bend = np.abs(distance[:, 2 * step :] - 2.0 * distance[:, step:-step] + distance[:, : -2 * step])
    return np.asarray(distance.max(axis=1, initial=0.0) + bend.max(axis=1, initial=0.0) / 6.0)


def divide_curves(
    curves: Curves, span: Array, deviation: Array, angle: float, least: IntArray, symmetric: BoolArray
) -> list[Array]:
    """Shares of the span (n, 2) of each curve between which its chords keep a deviation (n,) and turn by `angle` (rad) at most.

    Each begins with 0 and ends with 1, and has `least` (n,) chords or more. Those of a symmetric curve are so themselves.
    """
    if not len(span):
        return []
    n, share = len(span), np.linspace(0.0, 1.0, CURVE_SAMPLES + 1)
    t = span[:, :1] + share * (span[:, 1:] - span[:, :1])
    _, slope = (a.reshape(n, -1, 3) for a in curves(np.repeat(np.arange(n), len(share)), t.ravel()))
    speed = np.linalg.norm(slope, axis=2)
    middle = 0.5 * (slope[:, 1:] + slope[:, :-1])
    square = np.einsum("nki,nki->nk", middle, middle)
    jump = np.diff(slope, axis=1)
    along = np.divide(np.einsum("nki,nki->nk", jump, middle), square, out=np.zeros_like(square), where=square > 0)
    across = np.linalg.norm(jump - along[..., None] * middle, axis=2)
    length = 0.5 * (speed[:, 1:] + speed[:, :-1]) * np.abs(span[:, 1:] - span[:, :-1]) / CURVE_SAMPLES
    turn = np.divide(across, np.sqrt(square), out=np.zeros_like(square), where=square > 0)
    # an arc of the length l that turns by a is a l / 8 away from its chord
    parts = np.maximum(np.sqrt(turn * length / (8.0 * PREDICTED_FRACTION * deviation[:, None])), turn / angle)
    counts = np.maximum(np.ceil(parts.sum(axis=1)), least)
    require_memory(
        float(counts.sum()),
        BYTES_PER_CHORD,
        f"{counts.sum():.0f} chords of edges",
        "raise the deviation",
    )
    floor = 1e-3 * np.maximum(parts.sum(axis=1), 1e-9)[:, None] / CURVE_SAMPLES
    grown = np.cumsum(np.concatenate([np.zeros((n, 1)), parts + floor], axis=1), axis=1)
    found, due = [np.zeros(0)] * n, np.arange(n)
    for attempt in range(MAX_HALVINGS):
        for i in due.tolist() if attempt < PREDICTIONS else ():
            count = int(np.ceil(counts[i] * PREDICTED_FRACTION ** (-0.5 * attempt)))
            found[i] = np.interp(np.linspace(0.0, grown[i, -1], count + 1), grown[i], share)
        which = np.repeat(due, [len(found[i]) - 1 for i in due.tolist()])
        shares = np.concatenate([np.stack([found[i][:-1], found[i][1:]], axis=1) for i in due.tolist()])
        ends = span[which, :1] + shares * (span[which, 1:] - span[which, :1])
        points = curves(np.repeat(which, 2), ends.ravel())[0].reshape(-1, 2, 3)
        far = bound_chords(curves, which, ends, points) > deviation[which]
        due = np.unique(which[far])
        if not len(due):
            break
        for i in due.tolist() if attempt + 1 >= PREDICTIONS else ():
            own = which == i
            found[i] = np.sort(np.concatenate([found[i], shares[own & far].mean(axis=1)]))
    for i in np.flatnonzero(symmetric).tolist():
        found[i] = _symmetrise(found[i])
    return found


def _symmetrise(shares: Array) -> Array:
    """Ascending shares with their mirror images; those that agree become one."""
    both = np.sort(np.concatenate([shares, 1.0 - shares]))
    first = np.flatnonzero(np.diff(both, prepend=-1.0) > 1e-2 * np.diff(shares).min())
    kept = np.add.reduceat(both, first) / np.diff(first, append=len(both))
    kept = 0.5 * (kept + (1.0 - kept[::-1]))
    kept[[0, -1]] = 0.0, 1.0
    return kept


@dataclass(frozen=True, slots=True, eq=False)
class FaceTriangles:
    """Triangles of faces, each on nodes of its own.

    points (n, 3), uv (n, 2): of the nodes, in space and on the surface of their face. triangles (m, 3): nodes, counter-clockwise
    in the parameters. face (m,): number of the surface. twin (m, 3): of the side from corner k to k + 1 of triangle t, which is
    the side 3 t + k, the same side of its neighbour, or -1 on an edge.
    """

    points: Array
    uv: Array
    triangles: IntArray
    face: IntArray
    twin: IntArray


def pair_sides(triangles: IntArray, n: int) -> IntArray:
    """The twin (m, 3) of each side of triangles on n nodes, see `FaceTriangles`."""
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    keys, against = tail * n + head, head * n + tail
    order = np.argsort(keys, kind="stable")
    at = np.minimum(np.searchsorted(keys[order], against), len(keys) - 1)
    return np.where(keys[order][at] == against, order[at], -1).reshape(-1, 3)


def _measure_at(
    surfaces: Surfaces, face: IntArray, points: Array, uv: Array, grid: Array, limits: Array, deviation: float
) -> Array:
    """Signed distances (c, k) of points with barycentric coordinates (k, 3) of triangles from their surfaces."""
    points, uv, face = (grid @ points).reshape(-1, 3), (grid @ uv).reshape(-1, 2), np.repeat(face, len(grid))
    low, high = limits[face, 0], limits[face, 1]
    best, side, due = np.full(len(points), np.inf), np.ones(len(points)), np.arange(len(points))
    for _ in range(FOOT_STEPS):
        position, along_u, along_v = surfaces(face[due], uv[due])
        miss = points[due] - position
        distance = np.linalg.norm(miss, axis=1)
        better = distance < best[due]
        best[due[better]] = distance[better]
        side[due[better]] = np.sign(np.einsum("ni,ni->n", miss, np.cross(along_u, along_v)))[better]
        uu, cross, vv = (
            np.einsum("ni,ni->n", a, b) for a, b in ((along_u, along_u), (along_u, along_v), (along_v, along_v))
        )
        ru, rv = np.einsum("ni,ni->n", along_u, miss), np.einsum("ni,ni->n", along_v, miss)
        determinant = uu * vv - cross**2
        regular = determinant > LEAST_DETERMINANT * uu * vv
        scale = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=regular)
        move = np.stack([(vv * ru - cross * rv) * scale, (uu * rv - cross * ru) * scale], axis=1)
        # where one parameter would leave the face, the other takes its own best step
        leaves = (uv[due] + move < low[due]) | (uv[due] + move > high[due])
        move[:, 0] = np.where(leaves[:, 1], np.divide(ru, uu, out=np.zeros_like(uu), where=uu > 0), move[:, 0])
        move[:, 1] = np.where(leaves[:, 0], np.divide(rv, vv, out=np.zeros_like(vv), where=vv > 0), move[:, 1])
        new = np.clip(uv[due] + move, low[due], high[due])
        move = new - uv[due]
        uv[due] = new
        way = np.linalg.norm(move[:, :1] * along_u + move[:, 1:] * along_v, axis=1)
        due = due[(way > FOOT_TOL * deviation) & (way > FOOT_REL_TOL * distance)]
        if not len(due):
            break
    return (np.where(side < 0, -best, best)).reshape(-1, len(grid))


def bound_triangles(
    surfaces: Surfaces, face: IntArray, points: Array, uv: Array, limits: Array, deviation: float
) -> tuple[Array, Array]:
    """Bounds (c,) on the distance of triangles from their surfaces (c,), and distances of the middles of their sides (c, 3).

    points (c, 3, 3), uv (c, 3, 2): of the corners. limits (f, 2, 2): least and greatest parameters of each surface. deviation: to
    which the distances are of interest.
    """
    bound, middles = np.zeros(len(face)), np.zeros((len(face), 3))
    at = [int(np.flatnonzero((np.abs(GRID - row) < 1e-9).all(axis=1))[0]) for row in SIDE_MIDDLES]
    for start in range(0, len(face), BATCH):
        part = slice(start, start + BATCH)
        signed = _measure_at(surfaces, face[part], points[part], uv[part], GRID, limits, deviation)
        # beside the border of a surface the sign is arbitrary, and the distance itself is smooth
        bend = np.minimum(
            *(np.abs(d @ SECOND_DIFFERENCES.T).max(axis=1, initial=0.0) for d in (signed, np.abs(signed)))
        )
        bound[part] = np.abs(signed).max(axis=1, initial=0.0) + bend / 6.0
        middles[part] = np.abs(signed[:, at])
    return bound, middles


def _bound_near(
    surfaces: Surfaces, mesh: FaceTriangles, chosen: IntArray, limits: Array, deviation: float
) -> tuple[Array, Array]:
    """As `bound_triangles`, of some triangles of a mesh, where that decides; of the others an estimate from four points.

    A quadratic function that vanishes at the corners is at most 4/3 of its greatest value at the middles of sides, and 4/9 of
    their sum at the centre; by what it is not, the estimate is raised.
    """
    bound, middles = np.zeros(len(chosen)), np.zeros((len(chosen), 3))
    for start in range(0, len(chosen), BATCH):
        part = slice(start, start + BATCH)
        nodes, face = mesh.triangles[chosen[part]], mesh.face[chosen[part]]
        signed = _measure_at(surfaces, face, mesh.points[nodes], mesh.uv[nodes], MIDDLES, limits, deviation)
        sides, centre = signed[:, :3], signed[:, 3]
        middles[part] = np.abs(sides)
        bound[part] = middles[part].max(axis=1) * 4.0 / 3.0 + 2.0 * np.abs(centre - sides.sum(axis=1) * 4.0 / 9.0)
    due = np.flatnonzero((bound > CLEAR_FRACTION * deviation) & (bound < FAR_FRACTION * deviation))
    nodes = mesh.triangles[chosen[due]]
    exact = surfaces, mesh.face[chosen[due]], mesh.points[nodes], mesh.uv[nodes], limits, deviation
    bound[due], middles[due] = bound_triangles(*exact)
    return bound, middles


def refine_triangles(
    mesh: FaceTriangles, surfaces: Surfaces, n_faces: int, deviation: float
) -> tuple[FaceTriangles, Array]:
    """The mesh with triangles halved until all are within `deviation` of their surfaces, and bounds on the distance of each face.

    A bound (n_faces,) is above the deviation where halving does not help, because an edge does not lie on the face.
    """
    limits = np.empty((n_faces, 2, 2))
    limits[:, 0], limits[:, 1] = np.inf, -np.inf
    for k in range(3):
        np.minimum.at(limits[:, 0], mesh.face, mesh.uv[mesh.triangles[:, k]])
        np.maximum.at(limits[:, 1], mesh.face, mesh.uv[mesh.triangles[:, k]])
    bound, middles = _bound_near(surfaces, mesh, np.arange(len(mesh.triangles)), limits, deviation)
    for _ in range(MAX_HALVINGS):
        far = np.flatnonzero(bound > deviation)
        if not len(far):
            break
        require_memory(
            len(bound) + 2.0 * len(far),
            BYTES_PER_TRIANGLE,
            f"{len(bound)} triangles",
            f"raise deviation = {deviation:g}",
        )
        mesh, changed = _halve(mesh, surfaces, far, bound, middles)
        added = len(mesh.triangles) - len(bound)
        bound = np.concatenate([bound, np.zeros(added)])
        middles = np.concatenate([middles, np.zeros((added, 3))])
        bound[changed], middles[changed] = _bound_near(surfaces, mesh, changed, limits, deviation)
    most = np.flatnonzero((bound > 0.75 * bound.max(initial=0.0)) & (bound <= CLEAR_FRACTION * deviation))
    nodes = mesh.triangles[most]  # where no bound was near the deviation, the greatest ones are not estimates either
    bound[most] = bound_triangles(surfaces, mesh.face[most], mesh.points[nodes], mesh.uv[nodes], limits, deviation)[0]
    reached = np.zeros(n_faces)
    np.maximum.at(reached, mesh.face, bound)
    return mesh, reached


def _halve(
    mesh: FaceTriangles, surfaces: Surfaces, far: IntArray, bound: Array, middles: Array
) -> tuple[FaceTriangles, IntArray]:
    """Some of the triangles `far` from their surfaces halved, each with its neighbour; and the numbers of all that changed.

    A triangle without a neighbour is divided in three at its centre.
    """
    inside = mesh.twin[far] >= 0
    alone = far[~inside.any(axis=1)]
    far, inside = far[inside.any(axis=1)], inside[inside.any(axis=1)]
    corners = mesh.points[mesh.triangles[far]]
    length = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    score = middles[far] + 1e-3 * bound[far, None] * length / length.max(axis=1, keepdims=True)
    choice = np.where(inside, score, -1.0).argmax(axis=1)
    side = 3 * far + choice
    side, first = np.unique(np.minimum(side, mesh.twin.ravel()[side]), return_index=True)
    best = choose_apart(mesh, side, score[np.arange(len(far)), choice][first])
    mesh, changed = split_sides(mesh, surfaces, side[best], np.full(int(best.sum()), 0.5))
    if not len(alone):
        return mesh, changed
    mesh, divided = split_triangles(mesh, surfaces, alone, mesh.uv[mesh.triangles[alone]].mean(axis=1))
    return mesh, np.concatenate([changed, divided])


def choose_apart(mesh: FaceTriangles, side: IntArray, score: Array) -> BoolArray:
    """Which of distinct sides (n,) that have twins to split: those with a greater score (n,) than others of both triangles."""
    rank = np.empty(len(side))
    rank[np.lexsort((side, score))] = np.arange(len(side))
    pair = np.stack([side // 3, mesh.twin.ravel()[side] // 3], axis=1)
    best = np.full(len(mesh.triangles), -1.0)
    np.maximum.at(best, pair.ravel(), np.repeat(rank, 2))
    return np.asarray((best[pair] <= rank[:, None]).all(axis=1))


def split_sides(
    mesh: FaceTriangles, surfaces: Surfaces, side: IntArray, share: Array
) -> tuple[FaceTriangles, IntArray]:
    """Sides (n,) that have twins split at shares (n,) of the way along them; and the numbers of the triangles that changed.

    No two of the sides are of one triangle.
    """
    m, n, twin = len(mesh.triangles), len(mesh.points), mesh.twin
    (t, k), (s, j) = divmod(side, 3), divmod(twin.ravel()[side], 3)
    a, b, c = (mesh.triangles[t, (k + i) % 3] for i in range(3))
    d = mesh.triangles[s, (j + 2) % 3]
    fresh = n + np.arange(len(side))
    uv = mesh.uv[a] + share[:, None] * (mesh.uv[b] - mesh.uv[a])
    t2, s2 = m + np.arange(len(side)), m + len(side) + np.arange(len(side))
    outer = [twin[one, (at + step) % 3] for one, at in ((t, k), (s, j)) for step in (1, 2)]  # bc, ca, ad, db
    moved = np.arange(3 * m)
    for one, at, half in ((t, k, t2), (s, j, s2)):
        moved[3 * one + (at + 1) % 3] = 3 * half + 1
        moved[3 * one + (at + 2) % 3] = 3 * one + 2
    bc, ca, ad, db = (np.where(each >= 0, moved[np.maximum(each, 0)], -1) for each in outer)

    triangles = np.concatenate([mesh.triangles, np.stack([fresh, b, c], axis=1), np.stack([fresh, a, d], axis=1)])
    triangles[t], triangles[s] = np.stack([a, fresh, c], axis=1), np.stack([b, fresh, d], axis=1)
    new = np.where(twin >= 0, moved[np.maximum(twin, 0)], -1)
    new = np.concatenate([new, np.stack([3 * s, bc, 3 * t + 1], axis=1), np.stack([3 * t, ad, 3 * s + 1], axis=1)])
    new[t] = np.stack([3 * s2, 3 * t2 + 2, ca], axis=1)
    new[s] = np.stack([3 * t2, 3 * s2 + 2, db], axis=1)
    face = np.concatenate([mesh.face, mesh.face[t], mesh.face[s]])
    points = surfaces(mesh.face[t], uv)[0]
    halved = FaceTriangles(np.concatenate([mesh.points, points]), np.concatenate([mesh.uv, uv]), triangles, face, new)
    return halved, np.concatenate([t, s, t2, s2])


def split_triangles(
    mesh: FaceTriangles, surfaces: Surfaces, which: IntArray, uv: Array
) -> tuple[FaceTriangles, IntArray]:
    """Triangles (n,) divided in three at parameters (n, 2) within them; and the numbers of the triangles that changed."""
    m, n = len(mesh.triangles), len(mesh.points)
    a, b, c = mesh.triangles[which].T
    fresh, second, third = n + np.arange(len(which)), m + np.arange(len(which)), m + len(which) + np.arange(len(which))
    moved = np.arange(3 * m)
    moved[3 * which + 1], moved[3 * which + 2] = 3 * second, 3 * third
    twin = np.where(mesh.twin >= 0, moved[np.maximum(mesh.twin, 0)], -1)
    ab, bc, ca = twin[which].T
    triangles = np.concatenate([mesh.triangles, np.stack([b, c, fresh], axis=1), np.stack([c, a, fresh], axis=1)])
    triangles[which] = np.stack([a, b, fresh], axis=1)
    twin[which] = np.stack([ab, 3 * second + 2, 3 * third + 1], axis=1)
    of_second = np.stack([bc, 3 * third + 2, 3 * which + 1], axis=1)
    of_third = np.stack([ca, 3 * which + 2, 3 * second + 1], axis=1)
    divided = FaceTriangles(
        np.concatenate([mesh.points, surfaces(mesh.face[which], uv)[0]]),
        np.concatenate([mesh.uv, uv]),
        triangles,
        np.concatenate([mesh.face, mesh.face[which], mesh.face[which]]),
        np.concatenate([twin, of_second, of_third]),
    )
    return divided, np.concatenate([which, second, third])
