"""What a lattice is trimmed by: a convex polyhedron as planes, straight edges and corners.

The solid that is kept lies on the negative side of every plane. Each tool edge runs from one corner to another with the first
of its two planes' faces on its left, seen from outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpmscad.errors import InvalidRequest, TpmscadError
from tpmscad.patches.carriers import Plane

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class TrimmingError(TpmscadError):
    """The cut met a situation that it can't resolve with certainty; the message says where."""


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """K planes with outward normals, N corners (N, 3), M edges: corners (M, 2) and planes left and right of each (M, 2)."""

    planes: tuple[Plane, ...]
    corners: Array
    edge_corners: Ints
    edge_planes: Ints

    @property
    def normals(self) -> Array:
        return np.stack([plane.normal for plane in self.planes])

    @property
    def heights(self) -> Array:
        """n . x on each plane: (K,)."""
        return np.array([plane.normal @ plane.origin for plane in self.planes])

    def length(self, edge: int) -> float:
        a, b = self.corners[self.edge_corners[edge]]
        return float(np.linalg.norm(b - a))

    def distances(self, points: ArrayLike) -> Array:
        """Signed distances of points (..., 3) from the planes, negative inside: (..., K)."""
        return np.asarray(points, float) @ self.normals.T - self.heights


def polyhedron(corners: ArrayLike, loops: Sequence[Sequence[int]]) -> Tool:
    """The convex polyhedron whose faces are the loops of corners, counter-clockwise as seen from outside."""
    points = np.asarray(corners, float)
    planes = []
    left_of: dict[tuple[int, int], int] = {}
    for index, loop in enumerate(loops):
        a, b, c = points[list(loop[:3])]
        x = (b - a) / np.linalg.norm(b - a)
        normal = np.cross(x, c - a)
        planes.append(Plane(a, x, normal / np.linalg.norm(normal)))
        left_of |= {(i, j): index for i, j in zip(loop, [*loop[1:], loop[0]], strict=True)}
    edges = [(i, j) for i, j in left_of if i < j]
    sides = [(left_of[e], left_of[e[1], e[0]]) for e in edges]
    tool = Tool(tuple(planes), points, np.array(edges), np.array(sides))
    if (tool.distances(points) > 1e-9 * np.ptp(points)).any():
        raise InvalidRequest("the trimming polyhedron is not convex, or a face's corners do not run counter-clockwise")
    return tool


def box(lo: ArrayLike, hi: ArrayLike) -> Tool:
    """The box between two corners; its planes are x, y, z = lo, then x, y, z = hi, exactly."""
    low, high = np.asarray(lo, float), np.asarray(hi, float)
    if low.shape != (3,) or high.shape != (3,) or not np.isfinite([low, high]).all() or (high <= low).any():
        raise InvalidRequest(f"a box needs finite corners lo < hi in x, y and z, not {low} and {high}")
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])  # corner number = x + 2 y + 4 z
    loops = [(0, 4, 6, 2), (0, 1, 5, 4), (0, 2, 3, 1), (1, 3, 7, 5), (2, 6, 7, 3), (4, 5, 7, 6)]
    return polyhedron(np.where(corners, high, low), loops)


def shifted(tool: Tool, by: Array) -> Tool:
    """The same polyhedron with each plane moved outwards by `by` (K,); three planes meet in every corner."""
    planes = tuple(
        Plane(p.origin + d * p.normal, p.x_axis, p.normal) if d else p for p, d in zip(tool.planes, by, strict=True)
    )
    heights = tool.heights + by
    corners = np.empty_like(tool.corners)
    for i in range(len(corners)):
        meeting = np.unique(tool.edge_planes[(tool.edge_corners == i).any(axis=1)])[:3]
        corners[i] = np.linalg.solve(tool.normals[meeting], heights[meeting])
    return Tool(planes, corners, tool.edge_corners, tool.edge_planes)
