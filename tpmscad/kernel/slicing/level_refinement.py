"""Triangulations whose corners show every level that the exact faces reach.

Between its corners a face may rise above all of them, and a plane near the top of a round face misses the triangle. Sides along
which the height has an extremum beyond both ends, and triangles with a critical point of the height inside, get a node there if
a level lies between; this repeats until no level is missed. Extrema are found by the regula falsi on the slope along a side,
critical points from the gradients at the corners, which is exact for quadratic heights and converges by repetition for others.
Edges have nodes at their extrema already.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.triangles.height_extrema import find_extrema
from tpmscad.brep.triangles.measured_deviation import (
    FaceTriangles,
    Surfaces,
    choose_apart,
    split_sides,
    split_triangles,
)
from tpmscad.kernel.slicing.level_crossings import LevelSets, lines_on_faces

MAX_PASSES = 40
"""Passes over the triangles that may still miss a level; five to ten are common."""

EXTREMUM_STEPS = 4
"""Steps towards an extremum, whose height is then exact to the square of its position's error."""

MIN_DETERMINANT = 1e-6
"""Determinant of the scaled gradients at the corners below which they vanish along a line instead of at a point."""

HEIGHT_MARGIN, REACH_FACTOR = 1e-3, 1.5
"""Height by which faces are taken to reach beyond their nodes: in sizes of the solid, and in heights of extrema beyond them."""

MIN_BARYCENTRIC = 0.02
"""Barycentric coordinate below which a critical point counts as one of a side."""


def resolve_levels(mesh: FaceTriangles, surfaces: Surfaces, levels: LevelSets) -> FaceTriangles:
    """The mesh with nodes added until its corners lie between the same levels as the faces between them."""
    sides_due = inside_due = np.arange(len(mesh.triangles))
    for _ in range(MAX_PASSES):
        if len(sides_due):
            mesh, changed, missed = _split_sides(mesh, surfaces, levels, sides_due)
            sides_due, inside_due = np.union1d(changed, missed), np.union1d(inside_due, changed)
        elif len(inside_due):
            mesh, changed = _split_triangles(mesh, surfaces, levels, inside_due)
            sides_due = inside_due = changed
        else:
            break
    return mesh


def bound_heights(mesh: FaceTriangles, surfaces: Surfaces, size: float) -> Array:
    """Heights (F, 2) between which each face of a solid lies: beyond its nodes by more than extrema in its triangles are."""
    every, ranges = np.arange(len(mesh.triangles)), np.full((mesh.face.max() + 1, 2), [np.inf, -np.inf])
    z = mesh.points[mesh.triangles, 2]
    np.minimum.at(ranges[:, 0], mesh.face, z.min(axis=1))
    np.maximum.at(ranges[:, 1], mesh.face, z.max(axis=1))
    side, _, point, turning = _find_extrema(mesh, surfaces, every)
    which, _, top = _find_critical_points(mesh, surfaces, every)
    face = mesh.face[np.append(side[turning] // 3, which)]
    height = np.append(point[turning, 2], top[:, 2])
    margin = np.full(ranges.shape, HEIGHT_MARGIN * size)
    np.maximum.at(margin[:, 0], face, REACH_FACTOR * (ranges[face, 0] - height))
    np.maximum.at(margin[:, 1], face, REACH_FACTOR * (height - ranges[face, 1]))
    return ranges + margin * [-1.0, 1.0]


def _split_sides(
    mesh: FaceTriangles, surfaces: Surfaces, levels: LevelSets, which: IntArray
) -> tuple[FaceTriangles, IntArray, IntArray]:
    """The mesh with sides of some triangles (a,) split at extrema that reach beyond a level, one side of a triangle at a time.

    Returns the triangles that changed, too, and those with sides that are still to be split.
    """
    side, share, point, turning = _find_extrema(mesh, surfaces, which)
    side, share, point = side[turning], share[turning], point[turning]
    due = _reach_beyond(mesh, levels, _ends_of_sides(mesh, side), mesh.face[side // 3], point)
    side, share = side[due], share[due]
    chosen = choose_apart(mesh, side, np.random.default_rng(0).random(len(side)))
    missed = side[~chosen] // 3
    mesh, changed = split_sides(mesh, surfaces, side[chosen], share[chosen])
    return mesh, changed, missed


def _split_triangles(
    mesh: FaceTriangles, surfaces: Surfaces, levels: LevelSets, which: IntArray
) -> tuple[FaceTriangles, IntArray]:
    """The mesh with some triangles (a,) split at critical points that reach beyond a level, and all that changed."""
    which, uv, point = _find_critical_points(mesh, surfaces, which)
    due = _reach_beyond(mesh, levels, mesh.triangles[which], mesh.face[which], point)
    return split_triangles(mesh, surfaces, which[due], uv[due])


def _reach_beyond(mesh: FaceTriangles, levels: LevelSets, nodes: IntArray, face: IntArray, point: Array) -> BoolArray:
    """Whether a level lies between points (n, 3) on faces (n,) and the heights of their nodes (n, k)."""
    count = nodes.shape[1]
    rank = levels.rank(mesh.points[nodes, 2].ravel(), np.repeat(face, count)).reshape(-1, count)
    reached = levels.rank(point[:, 2], face)
    return np.asarray((reached > rank.max(axis=1)) | (reached < rank.min(axis=1)))


def _ends_of_sides(mesh: FaceTriangles, side: IntArray) -> IntArray:
    triangle, corner = divmod(side, 3)
    return np.stack([mesh.triangles[triangle, (corner + k) % 3] for k in (0, 1)], axis=1)


def _find_extrema(mesh: FaceTriangles, surfaces: Surfaces, which: IntArray) -> tuple[IntArray, Array, Array, BoolArray]:
    """The sides (n,) inside faces of some triangles (a,), and shares, points (n, 3) and presence of their extrema."""
    twin = mesh.twin[which]
    side = np.unique(np.minimum(3 * which[:, None] + np.arange(3), twin)[twin >= 0])
    line = lines_on_faces(surfaces, mesh.face[side // 3], mesh.uv[_ends_of_sides(mesh, side)])
    return side, *find_extrema(line, len(side), EXTREMUM_STEPS)


def _find_critical_points(mesh: FaceTriangles, surfaces: Surfaces, which: IntArray) -> tuple[IntArray, Array, Array]:
    """Those of some triangles (a,) that have a critical point of the height inside, its parameters and the point, (n, 3)."""
    nodes, face = mesh.triangles[which], mesh.face[which]
    _, xu, xv = surfaces(np.repeat(face, 3), mesh.uv[nodes].reshape(-1, 2))
    gradients = np.stack([xu[:, 2], xv[:, 2]], axis=1).reshape(-1, 3, 2)
    matrix = np.concatenate([np.swapaxes(gradients, 1, 2), np.ones((len(which), 1, 3))], axis=1)
    scale = np.abs(gradients).max(axis=(1, 2))
    matrix[:, :2] /= np.where(scale > 0.0, scale, 1.0)[:, None, None]
    solvable = np.abs(np.linalg.det(matrix)) > MIN_DETERMINANT
    weights = np.full((len(which), 3), -1.0)
    weights[solvable] = np.linalg.solve(matrix[solvable], np.array([0.0, 0.0, 1.0])[:, None])[..., 0]
    inside = weights.min(axis=1) > MIN_BARYCENTRIC
    uv = np.einsum("nk,nkd->nd", weights[inside], mesh.uv[nodes[inside]])
    return which[inside], uv, surfaces(face[inside], uv)[0]
