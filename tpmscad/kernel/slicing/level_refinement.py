"""Triangulations whose corners show every level that the exact faces reach.

Between its corners a face may rise above all of them, and a plane near the top of a round face misses the triangle. Sides along
which the height has an extremum beyond both ends, and triangles with a critical point of the height inside, get a node there if
a level lies between; this repeats until no level is missed. Extrema are found by the regula falsi on the slope along a side,
critical points from the gradients at the corners, which is exact for quadratic heights and converges by repetition for others.
Edges have nodes at their extrema already.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import IntArray
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


def _split_sides(
    mesh: FaceTriangles, surfaces: Surfaces, levels: LevelSets, which: IntArray
) -> tuple[FaceTriangles, IntArray, IntArray]:
    """The mesh with sides of some triangles (a,) split at extrema that reach beyond a level, one side of a triangle at a time.

    Returns the triangles that changed, too, and those with sides that are still to be split.
    """
    twin = mesh.twin[which]
    side = np.unique(np.minimum(3 * which[:, None] + np.arange(3), twin)[twin >= 0])
    triangle, corner = divmod(side, 3)
    nodes, face = np.stack([mesh.triangles[triangle, (corner + k) % 3] for k in (0, 1)], axis=1), mesh.face[triangle]
    share, point, turning = find_extrema(lines_on_faces(surfaces, face, mesh.uv[nodes]), len(side), EXTREMUM_STEPS)
    ends = levels.rank(mesh.points[nodes, 2].ravel(), np.repeat(face, 2)).reshape(-1, 2)
    reached = levels.rank(point[:, 2], face)
    due = turning & ((reached > ends.max(axis=1)) | (reached < ends.min(axis=1)))
    side, share = side[due], share[due]
    chosen = choose_apart(mesh, side, np.random.default_rng(0).random(len(side)))
    missed = side[~chosen] // 3
    mesh, changed = split_sides(mesh, surfaces, side[chosen], share[chosen])
    return mesh, changed, missed


def _split_triangles(
    mesh: FaceTriangles, surfaces: Surfaces, levels: LevelSets, which: IntArray
) -> tuple[FaceTriangles, IntArray]:
    """The mesh with some triangles (a,) split at critical points that reach beyond a level, and all that changed."""
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
    which, nodes, face = which[inside], nodes[inside], face[inside]
    uv = np.einsum("nk,nkd->nd", weights[inside], mesh.uv[nodes])
    rank = levels.rank(mesh.points[nodes, 2].ravel(), np.repeat(face, 3)).reshape(-1, 3)
    reached = levels.rank(surfaces(face, uv)[0][:, 2], face)
    due = (reached > rank.max(axis=1)) | (reached < rank.min(axis=1))
    return split_triangles(mesh, surfaces, which[due], uv[due])
