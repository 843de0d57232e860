"""Triangulations whose corners show every level that the exact faces reach.

Between its corners a face may rise above all of them, and a plane near the top of a round face misses the triangle. Sides along
which the height has an extremum beyond both ends, and triangles with a critical point of the height inside, get a node there if
a level lies between; this repeats until no level is missed. Extrema are found by the regula falsi on the slope along a side,
critical points from the gradients at the corners, which is exact for quadratic heights and converges by repetition for others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, IntArray
from tpmscad.kernel.export.solid_mesh import EdgeSegments
from tpmscad.kernel.slicing.level_crossings import LevelSets, SideEvaluator, Sides, lines_of_sides, number_sides
from tpmscad.kernel.slicing.surface_triangulation import SurfaceTriangulation

MAX_PASSES = 40
"""Passes over the triangles that may still miss a level; five to ten are common."""

EXTREMUM_STEPS = 4
"""Steps of the regula falsi towards an extremum, whose height is then exact to the square of its position's error."""

MIN_DETERMINANT = 1e-6
"""Determinant of the scaled gradients at the corners below which they vanish along a line instead of at a point."""

MIN_BARYCENTRIC = 0.02
"""Barycentric coordinate below which a critical point counts as one of a side."""


def resolve_levels(mesh: SurfaceTriangulation, levels: LevelSets) -> SurfaceTriangulation:
    """The mesh with nodes added until its corners lie between the same levels as the faces between them."""
    sides_due = np.ones(len(mesh.triangles), bool)
    inside_due = sides_due.copy()
    for _ in range(MAX_PASSES):
        if sides_due.any():
            which = np.flatnonzero(sides_due)
            mesh, again, parents = _split_sides(mesh, levels, which)
            sides_due = again
        elif inside_due.any():
            which = np.flatnonzero(inside_due)
            mesh, parents = _split_triangles(mesh, levels, which)
            inside_due[which] = False
            sides_due = np.zeros(len(mesh.triangles), bool)
        else:
            break
        new = np.ones(len(mesh.triangles), bool)
        new[: len(inside_due) - len(parents)] = False
        inside_due = np.concatenate([np.delete(inside_due, parents), np.ones(int(new.sum()), bool)])
        sides_due |= new
    return mesh


def _corner_gradients(mesh: SurfaceTriangulation, which: IntArray) -> Array:
    """Derivatives of the height with respect to u and v at the corners of some triangles (a,): (a, 3, 2)."""
    _, xu, xv = mesh.surfaces(np.repeat(mesh.face[which], 3), mesh.uv[which].reshape(-1, 2))
    return np.stack([xu[:, 2], xv[:, 2]], axis=1).reshape(-1, 3, 2)


def _split_sides(
    mesh: SurfaceTriangulation, levels: LevelSets, which: IntArray
) -> tuple[SurfaceTriangulation, NDArray[np.bool_], IntArray]:
    """Split sides of some triangles (a,) at extrema that reach beyond a level.

    Of the sides of a triangle one is split at a time. Returns the mesh, the triangles with sides still to be split, and the
    numbers of the triangles that were replaced; new ones come last.
    """
    sides, triangles = number_sides(mesh), mesh.triangles
    number = np.unique(sides.of_corner[which])
    fraction, point, turning = _find_extrema(mesh, sides, number)
    ends = levels.rank(mesh.points[:, 2], mesh.face_of_node)[sides.nodes[number]]
    reached = levels.rank(point[:, 2], sides.face[number])
    due = turning & ((reached > ends.max(axis=1)) | (reached < ends.min(axis=1)))

    priority = np.full(len(sides.nodes), -1)
    priority[number[due]] = np.random.default_rng(0).permutation(int(due.sum()))
    of_triangle = priority[sides.of_corner].max(axis=1)
    chosen = priority >= 0
    chosen[sides.of_corner[priority[sides.of_corner] < of_triangle[:, None]]] = False
    taken = due & chosen[number]
    again = (of_triangle >= 0) & ~chosen[sides.of_corner].any(axis=1)

    node_of_side = np.full(len(sides.nodes), -1)
    node_of_side[number[taken]] = len(mesh.points) + np.arange(int(taken.sum()))
    along = np.zeros(len(sides.nodes))
    along[number] = fraction
    segments, halves = _split_segments(mesh, sides.segment, sides.nodes, along, node_of_side)

    parents, k = np.nonzero(chosen[sides.of_corner])
    side = sides.of_corner[parents, k]
    a, b, c = (triangles[parents, (k + j) % 3] for j in range(3))
    v = node_of_side[side]
    share = np.where(a == sides.nodes[side, 0], along[side], 1.0 - along[side])[:, None]
    uv_a, uv_b, uv_c = (mesh.uv[parents, (k + j) % 3] for j in range(3))
    uv_v = (1.0 - share) * uv_a + share * uv_b
    seg_b, seg_c = (mesh.segment[parents, (k + j) % 3] for j in (1, 2))
    first = np.where(a == sides.nodes[side, 0], halves[side, 0], halves[side, 1])
    second = np.where(a == sides.nodes[side, 0], halves[side, 1], halves[side, 0])
    none = np.full(len(parents), -1)
    own_a, own_b, own_c = (mesh.nodes[parents, (k + j) % 3] for j in range(3))
    own_v = int(mesh.nodes.max()) + 1 + v - len(mesh.points)
    children = (
        np.concatenate([np.stack([a, v, c], axis=1), np.stack([v, b, c], axis=1)]),
        np.concatenate([np.stack([own_a, own_v, own_c], axis=1), np.stack([own_v, own_b, own_c], axis=1)]),
        np.concatenate([np.stack([uv_a, uv_v, uv_c], axis=1), np.stack([uv_v, uv_b, uv_c], axis=1)]),
        np.concatenate([np.stack([first, none, seg_c], axis=1), np.stack([second, seg_b, none], axis=1)]),
    )
    return (
        _replace(mesh, parents, children, point[taken], segments),
        np.append(np.delete(again, parents), np.zeros(2 * len(parents), bool)),
        parents,
    )


def _find_extrema(mesh: SurfaceTriangulation, sides: Sides, which: IntArray) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Of some sides (n,): fraction and point (n, 3) of an extremum of the height, and whether there is one (n,)."""
    fraction, point, turning = np.empty(len(which)), np.empty((len(which), 3)), np.empty(len(which), bool)
    for members, line in lines_of_sides(mesh, sides, which):
        fraction[members], point[members], turning[members] = _regula_falsi(line, len(members))
    return fraction, point, turning


def _regula_falsi(line: SideEvaluator, n: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Fractions (n,) where the slope vanishes, the points there (n, 3), and whether it changes its sign at all (n,)."""
    everyone = np.arange(n)
    t, point = np.full(n, 0.5), np.zeros((n, 3))
    low, high = line(np.zeros(n), everyone)[1], line(np.ones(n), everyone)[1]
    turning = low * high < 0.0
    some = np.flatnonzero(turning)
    a, b, slope_a, slope_b = np.zeros(len(some)), np.ones(len(some)), low[some], high[some]
    for _ in range(EXTREMUM_STEPS if len(some) else 0):
        at = (a * slope_b - b * slope_a) / (slope_b - slope_a)
        point[some], slope = line(at, some)
        t[some] = at
        left = slope * slope_a > 0.0
        a, slope_a = np.where(left, at, a), np.where(left, slope, slope_a)
        b, slope_b = np.where(left, b, at), np.where(left, slope_b, slope)
        slope_b = np.where(slope_b == slope_a, -slope_a, slope_b)
    return t, point, turning


def _split_segments(
    mesh: SurfaceTriangulation, segment: IntArray, nodes: IntArray, along: Array, node_of_side: IntArray
) -> tuple[EdgeSegments, IntArray]:
    """The segments with the halves of the sides that get a node, and the numbers of both halves of each side, or -1: (k, 2)."""
    table = mesh.segments
    halves = np.full((len(segment), 2), -1)
    cut = np.flatnonzero((node_of_side >= 0) & (segment >= 0))
    own, v = segment[cut], node_of_side[cut]
    against = table.nodes[own, 0] != nodes[cut, 0]
    share = np.where(against, 1.0 - along[cut], along[cut])
    t0, t1 = table.parameters[own].T
    middle = (1.0 - share) * t0 + share * t1
    lower = len(table.edge) + np.arange(len(cut))
    upper = lower + len(cut)
    halves[cut] = np.where(against[:, None], np.stack([upper, lower], axis=1), np.stack([lower, upper], axis=1))
    return (
        EdgeSegments(
            np.concatenate([table.edge, table.edge[own], table.edge[own]]),
            np.concatenate(
                [table.nodes, np.stack([table.nodes[own, 0], v], axis=1), np.stack([v, table.nodes[own, 1]], axis=1)]
            ),
            np.concatenate([table.parameters, np.stack([t0, middle], axis=1), np.stack([middle, t1], axis=1)]),
        ),
        halves,
    )


def _split_triangles(
    mesh: SurfaceTriangulation, levels: LevelSets, which: IntArray
) -> tuple[SurfaceTriangulation, IntArray]:
    """Split some triangles (a,) at critical points of the height that reach beyond a level.

    Returns the mesh and the numbers of the triangles that were replaced; new ones come last.
    """
    gradients = _corner_gradients(mesh, which)
    matrix = np.concatenate([np.swapaxes(gradients, 1, 2), np.ones((len(which), 1, 3))], axis=1)
    scale = np.abs(gradients).max(axis=(1, 2))
    matrix[:, :2] /= np.where(scale > 0.0, scale, 1.0)[:, None, None]
    solvable = np.abs(np.linalg.det(matrix)) > MIN_DETERMINANT
    weights = np.full((len(which), 3), -1.0)
    weights[solvable] = np.linalg.solve(matrix[solvable], np.array([0.0, 0.0, 1.0])[:, None])[..., 0]
    inside = weights.min(axis=1) > MIN_BARYCENTRIC
    which, weights = which[inside], weights[inside]
    uv = np.einsum("nk,nkd->nd", weights, mesh.uv[which])
    point = mesh.surfaces(mesh.face[which], uv)[0]
    rank = levels.rank(mesh.points[:, 2], mesh.face_of_node)[mesh.triangles[which]]
    reached = levels.rank(point[:, 2], mesh.face[which])
    due = (reached > rank.max(axis=1)) | (reached < rank.min(axis=1))
    parents, uv = which[due], uv[due]
    v = len(mesh.points) + np.arange(len(parents))
    own_v = int(mesh.nodes.max()) + 1 + np.arange(len(parents))
    corners, own, at, segments = [], [], [], []
    for k in range(3):
        pair = [k, (k + 1) % 3]
        corners.append(np.column_stack([mesh.triangles[parents][:, pair], v]))
        own.append(np.column_stack([mesh.nodes[parents][:, pair], own_v]))
        at.append(np.concatenate([mesh.uv[parents][:, pair], uv[:, None]], axis=1))
        segments.append(np.column_stack([mesh.segment[parents, k], np.full((len(parents), 2), -1)]))
    children = np.concatenate(corners), np.concatenate(own), np.concatenate(at), np.concatenate(segments)
    return _replace(mesh, parents, children, point[due], mesh.segments), parents


def _replace(
    mesh: SurfaceTriangulation,
    parents: IntArray,
    children: tuple[IntArray, IntArray, Array, IntArray],
    points: Array,
    segments: EdgeSegments,
) -> SurfaceTriangulation:
    """The mesh with children in place of their parents, all first children before all second ones, and points added."""
    corners, nodes, uv, segment = children
    copies = len(corners) // max(len(parents), 1)
    return replace(
        mesh,
        points=np.concatenate([mesh.points, points]),
        triangles=np.concatenate([np.delete(mesh.triangles, parents, axis=0), corners]),
        face=np.concatenate([np.delete(mesh.face, parents), np.tile(mesh.face[parents], copies)]),
        nodes=np.concatenate([np.delete(mesh.nodes, parents, axis=0), nodes]),
        uv=np.concatenate([np.delete(mesh.uv, parents, axis=0), uv]),
        segment=np.concatenate([np.delete(mesh.segment, parents, axis=0), segment]),
        segments=segments,
    )
