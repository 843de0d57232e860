"""One cell of an endless lattice as a closed polyhedron that repeats: opposite sides are alike to the last bit.

The triangles of whole patches are clipped to the cell; triangles with a common side are cut in a common point. Points on opposite
sides are identified by translation, and the solid's part of each side is filled with triangles once, for both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.loops import follow_paths
from tpmscad.brep.sections.periodic_section import close_along_sides
from tpmscad.brep.triangles.closed_mesh import is_closed, load_manifold, weld_points
from tpmscad.brep.triangles.repeated_pieces import SURFACE, RepeatedPieces, directed_sides
from tpmscad.errors import TrimmingError

MATCH_REL_TOL = 1e-8
"""In cells: distance of a point on a side from the translate of its partner on the opposite one."""


def find_periodic_cell(points: Array, triangles: IntArray, low: Array, cell: Array) -> RepeatedPieces:
    """The cell [low, low + cell] of a lattice whose triangles cover it and what is around it.

    TrimmingError if the triangles do not repeat, or a side of the cell touches them.
    """
    high = low + cell
    for axis in range(3):
        points, triangles = clip_triangles(points, triangles, axis, float(low[axis]), 1)
        points, triangles = clip_triangles(points, triangles, axis, float(high[axis]), -1)
    shift = (points == high).astype(np.int64)
    base, node_base = weld_points(np.where(shift > 0, low, points), MATCH_REL_TOL * float(cell.max()))
    base = np.concatenate([base, low[None]])
    nodes = _Nodes(node_base, shift)
    sides = _find_open_sides(triangles, len(points))
    found, beyond = [triangles], [np.zeros((len(triangles), 3), np.int64)]
    for axis in range(3):
        on = (points[sides][..., axis] == low[axis]).all(axis=1)
        lower, upper = nodes.fill_side(points, sides[on], axis, low, high, corner=len(base) - 1)
        found += [lower, upper]
        beyond += [np.tile(sign * np.eye(3, dtype=np.int64)[axis], (len(lower), 1)) for sign in (-1, 1)]
    closed, shifts = np.concatenate(found), np.concatenate(beyond)
    if not is_closed(closed):
        raise TrimmingError("the triangles of a cell do not repeat in the next one")
    node = np.insert(np.array(list(nodes.number)), 1, 0, axis=1)
    piece = np.zeros(len(closed), np.int64)
    neighbour = np.where(shifts.any(axis=1), 0, SURFACE)
    arm = np.zeros((len(base), 1, 3))
    return RepeatedPieces(cell, low[None], high[None], base, arm, node, closed, piece, neighbour, shifts)


class _Nodes:
    """Nodes by base point and shift; those of the clipped triangles are the first ones."""

    def __init__(self, base: IntArray, shift: IntArray) -> None:
        rows = np.column_stack([base, shift])
        self.rows = rows
        self.number: dict[tuple[int, ...], int] = {tuple(row): i for i, row in enumerate(rows.tolist())}
        if len(self.number) < len(rows):
            raise TrimmingError("two points of a cell are one")

    def find(self, base: int, shift: IntArray) -> int:
        return self.number.setdefault((base, *(int(s) for s in shift)), len(self.number))

    def fill_side(
        self, points: Array, sides: IntArray, axis: int, low: Array, high: Array, corner: int
    ) -> tuple[IntArray, IntArray]:
        """Triangles that fill the lower side of the cell across an axis, in which open sides (n, 2) lie, and the upper one."""
        across = [(axis + 1) % 3, (axis + 2) % 3]
        arcs, loops = _chain(sides)
        polygons = close_along_sides([points[a][:, across] for a in arcs], low[across], high[across])
        polygons += [points[loop][:, across] for loop in loops]
        if not polygons:
            return np.zeros((0, 3), np.int64), np.zeros((0, 3), np.int64)
        at = {tuple(points[v][across].tolist()): v for path in (*arcs, *loops) for v in path}
        lower, upper = [], []
        for point in np.concatenate(polygons):
            v = at.get(tuple(point.tolist()))
            shift = self.rows[v, 1:].copy() if v is not None else np.zeros(3, np.int64)
            if v is None:
                shift[across] = point == high[across]
            base = corner if v is None else int(self.rows[v, 0])
            lower.append(self.find(base, shift))
            shift[axis] = 1
            upper.append(self.find(base, shift))
        inside = np.asarray(load_manifold().triangulate(polygons), np.int64).reshape(-1, 3)
        return np.array(lower)[inside[:, ::-1]], np.array(upper)[inside]


def _chain(sides: IntArray) -> tuple[list[list[int]], list[list[int]]]:
    """Open paths and closed loops of directed sides (n, 2), as nodes."""
    nodes, ends = np.unique(sides, return_inverse=True)
    tail, head = ends.reshape(-1, 2).T
    if len(np.unique(tail)) < len(tail):
        raise TrimmingError("triangles of a cell meet in a point of its side")
    following = np.full(len(nodes), -1)
    following[tail] = head
    order, starts = follow_paths(following)
    paths = [nodes[path].tolist() for path in np.split(order, starts[1:-1]) if len(path)]
    n_open = int((following < 0).sum())  # these come first
    return paths[:n_open], paths[n_open:]


def _find_open_sides(triangles: IntArray, n: int) -> IntArray:
    """The sides (k, 2) of triangles that no other one runs through the other way."""
    sides = directed_sides(triangles)
    return sides[~np.isin(sides[:, 0] * n + sides[:, 1], sides[:, 1] * n + sides[:, 0])]


def clip_triangles(points: Array, triangles: IntArray, axis: int, at: float, keep: int) -> tuple[Array, IntArray]:
    """The part of a mesh where keep * (x[axis] - at) > 0, with `keep` 1 or -1; cut points lie at `at` exactly."""
    height = keep * (points[:, axis] - at)
    inside = height > 0
    count = inside[triangles].sum(axis=1)
    whole, cut = triangles[count == 3], triangles[(count == 1) | (count == 2)]
    alone = inside[cut].sum(axis=1) == 1
    lone = np.where(alone, inside[cut].argmax(axis=1), (~inside[cut]).argmax(axis=1))
    cut = np.take_along_axis(cut, (lone[:, None] + np.arange(3)) % 3, axis=1)
    sides = np.sort(np.concatenate([cut[:, [0, 1]], cut[:, [0, 2]]]), axis=1)
    distinct, number = np.unique(sides, axis=0, return_inverse=True)
    a, b = distinct.T
    share = (height[a] / (height[a] - height[b]))[:, None]
    new = points[a] + share * (points[b] - points[a])
    new[:, axis] = at
    p, q = np.split(len(points) + number.ravel(), 2)
    lone_in, pair = cut[alone], cut[~alone]
    found = [
        whole,
        np.stack([lone_in[:, 0], p[alone], q[alone]], axis=1),
        np.stack([p[~alone], pair[:, 1], pair[:, 2]], axis=1),
        np.stack([p[~alone], pair[:, 2], q[~alone]], axis=1),
    ]
    return _drop_unused(np.concatenate([points, new]), found)


def _drop_unused(points: Array, triangles: Sequence[IntArray]) -> tuple[Array, IntArray]:
    used, index = np.unique(np.concatenate(triangles), return_inverse=True)
    return points[used], index.reshape(-1, 3)
