"""Closed polyhedra that fill an endless periodic solid, and their copies: neighbours share nodes, sides between them vanish.

The pieces of one cell are stored once. A *side* is a group of triangles towards a neighbour, which has a side of its own there;
all others bound the solid. Nodes are known by integers, a base point and a shift in cells, so that copies that meet
in a node have it once, whatever its coordinates. What is left open where a piece is missing is closed by its sides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.triangles.closed_mesh import SolidMesh, narrow_indices
from tpmscad.errors import TrimmingError

SURFACE = -1
"""Neighbour of the triangles that bound the solid."""

LATTICE, BETWEEN_PIECES = 0, -1
"""Faces of the triangles of placed pieces: those that bound the solid, and sides."""

POINTS_PER_BATCH = 500_000
"""Points that are computed at a time, which limits the memory."""

Scale = Callable[[Array], Array]
"""Points (n, 3) to factors of the arms of each wall (n, w)."""


@dataclass(frozen=True, slots=True, eq=False)
class RepeatedPieces:
    """The P pieces of one cell of edges `cell` (3,), with outward normals, within the boxes [low, high], (P, 3) each.

    Node i lies at base[b] + shift * cell + s arm[b, w], with its base point b, wall w and shift in cells as the columns of `node`
    (n, 5); s is 1, or the scale at base[b] + shift * cell. triangles (m, 3) of nodes, of each the piece (m,), the piece `beyond`
    it (m,), SURFACE where there is none, and the cell of that seen from its own, beyond_shift (m, 3).
    """

    cell: Array
    low: Array
    high: Array
    base: Array
    arm: Array
    node: IntArray
    triangles: IntArray
    piece: IntArray
    beyond: IntArray
    beyond_shift: IntArray

    @property
    def points(self) -> Array:
        """The nodes of the pieces of one cell (n, 3), for the scale 1."""
        base, wall, shift = self.node[:, 0], self.node[:, 1], self.node[:, 2:]
        return np.asarray(self.base[base] + shift * self.cell + self.arm[base, wall])

    @property
    def surface_count(self) -> int:
        """Triangles of a cell that bound the solid."""
        return int((self.beyond == SURFACE).sum())

    def place(self, whole: BoolArray, cut: BoolArray, origin: IntArray, scale: Scale | None = None) -> PlacedPieces:
        """Copies of pieces, chosen by cells from `origin` and piece: (x, y, z, P); whole ones without sides, cut ones closed."""
        least = self.node[:, 2:].min(axis=0)
        rows = np.zeros(np.array(whole.shape[:3]) + np.ptp(self.node[:, 2:], axis=0), np.int32)
        cells = np.argwhere((whole | cut).any(axis=3))
        for shift in np.unique(self.node[:, 2:], axis=0) - least:
            rows[tuple((cells + shift).T)] = 1
        places = np.argwhere(rows) + least + origin
        rows[rows > 0] = np.arange(len(places))
        walls = self.arm.shape[1]
        columns = self.node[:, 0] * walls + self.node[:, 1]
        groups = [*self._groups(whole, False), *self._groups(cut, True)]
        of_whole = np.array([not closed for _, _, closed, _ in groups], bool)

        def find_rows(at: IntArray, nodes: IntArray) -> IntArray:
            return np.asarray(rows[tuple(np.moveaxis(at[:, None] + self.node[nodes, 2:] - least, 2, 0))])

        used = np.zeros((2, len(places), len(self.base) * walls), bool)
        for at, chosen, closed, _ in groups:
            nodes = np.unique(self.triangles[chosen])
            used[int(closed), find_rows(at, nodes), columns[nodes]] = True
        in_both = used.all(axis=0)
        used[1] &= ~used[0]
        number = np.zeros(used.shape[1:], np.int32)
        n_whole = int(used[0].sum())
        number[used[0]] = np.arange(n_whole)
        number[used[1]] = n_whole + np.arange(int(used[1].sum()))
        common, keys = number[in_both], np.concatenate([np.flatnonzero(used[0]), np.flatnonzero(used[1])])
        del used, in_both
        points = np.empty((len(keys), 3))
        for start in range(0, len(keys), POINTS_PER_BATCH):
            part = slice(start, start + POINTS_PER_BATCH)
            row, column = np.divmod(keys[part], number.shape[1])
            mid = self.base[column // walls] + places[row] * self.cell
            arm, wall = self.arm[column // walls, column % walls], column % walls
            points[part] = mid + (arm if scale is None else np.take_along_axis(scale(mid), wall[:, None], axis=1) * arm)
        ends = np.cumsum([0, *(len(at) * len(chosen) for at, chosen, _, _ in groups)])
        split = int(ends[int(of_whole.sum())])  # groups of whole pieces come first
        found: IntArray = narrow_indices(np.empty((int(ends[-1]), 3), np.int32))
        for (at, chosen, _, _), first, last in zip(groups, ends[:-1].tolist(), ends[1:].tolist(), strict=True):
            nodes, local = np.unique(self.triangles[chosen], return_inverse=True)
            own = found[first:last].reshape(len(at), 3 * len(chosen))
            np.take(number[find_rows(at, nodes), columns[nodes]], local.ravel(), axis=1, out=own, mode="clip")
        faces: IntArray = narrow_indices(np.repeat([face for _, _, _, face in groups], np.diff(ends)[: len(groups)]))
        return PlacedPieces(points, n_whole, common, found[:split], found[split:], faces[split:], walls)

    def _groups(self, chosen: BoolArray, closed: bool) -> list[tuple[IntArray, IntArray, bool, int]]:
        """Cells (k, 3), triangles that they all show, whether they are closed, and the face of the triangles."""
        padded = np.pad(chosen, [(1, 1)] * 3 + [(0, 0)])
        found = []
        for piece in range(len(self.low)):
            own, at = np.flatnonzero(self.piece == piece), np.argwhere(chosen[..., piece])
            if not len(at):
                continue
            found.append((at, own[self.beyond[own] == SURFACE], closed, LATTICE))
            if not closed:
                continue
            own = own[self.beyond[own] != SURFACE]
            sides = np.column_stack([self.beyond[own], self.beyond_shift[own]])
            for side in np.unique(sides, axis=0):
                beside = np.clip(at + 1 + side[1:], 0, np.array(padded.shape[:3]) - 1)
                shows = ~padded[(*beside.T, side[0])]
                found.append((at[shows], own[(sides == side).all(axis=1)], closed, BETWEEN_PIECES))
        return found


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPieces:
    """Copies of pieces: points (n, 3), of which whole ones use the first `n_whole`, and cut ones the `common` ones of these, too.

    whole (m, 3): triangles of the surface of whole pieces. cut (k, 3): closed triangles of cut ones, and their faces (k,).
    """

    points: Array
    n_whole: int
    common: IntArray
    whole: IntArray
    cut: IntArray
    cut_face: IntArray
    n_walls: int

    @property
    def block(self) -> SolidMesh:
        """The cut pieces as one closed mesh."""
        mesh = SolidMesh(self.points, self.cut, self.cut_face).select(np.ones(len(self.cut), bool))
        return split_pinched_edges(mesh) if self.n_walls == 2 else mesh


def split_pinched_edges(mesh: SolidMesh) -> SolidMesh:
    """A block of walls with doubled ends of the edges in which two pairs of sides meet: two triangles meet in every edge.

    Manifold does the same, but may then take a side for a face of the lattice.
    """
    sides = np.sort(directed_sides(mesh.triangles[mesh.face == BETWEEN_PIECES]), axis=1)
    distinct, count = np.unique(sides, axis=0, return_counts=True)
    pinched = np.zeros(len(mesh.points), bool)
    pinched[distinct[count > 2]] = True
    near = np.flatnonzero(pinched[mesh.triangles].any(axis=1))
    if not len(near):
        return mesh
    triangles = mesh.triangles[near].astype(np.int64)
    sides = directed_sides(triangles)
    _, label, count = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(label.ravel(), kind="stable")
    order = order[count[label.ravel()[order]] == 2].reshape(-1, 2)
    corner = np.arange(triangles.size).reshape(-1, 3)
    ends = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
    one, other = ends[order[:, 0]], ends[order[:, 1]]
    links = np.concatenate([np.stack([one[:, 0], other[:, 1]], axis=1), np.stack([one[:, 1], other[:, 0]], axis=1)])
    point = triangles.ravel()
    fan = label_linked(triangles.size, links[pinched[point[links[:, 0]]]])
    at = np.flatnonzero(pinched[point])
    pairs, index = np.unique(np.stack([point[at], fan[at]], axis=1), axis=0, return_inverse=True)
    again = np.append(False, pairs[1:, 0] == pairs[:-1, 0])
    number = np.where(again, len(mesh.points) + np.cumsum(again) - 1, pairs[:, 0])
    point[at] = number[index.ravel()]
    new = mesh.triangles.copy()
    new[near] = point.reshape(-1, 3)
    return SolidMesh(np.concatenate([mesh.points, mesh.points[pairs[again, 0]]]), new, mesh.face)


def directed_sides(triangles: IntArray) -> IntArray:
    """The sides (3 m, 2) of triangles (m, 3), from corner k to k + 1."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)


def close_walls(
    cell: Array,
    mid: Array,
    arms: Array,
    triangles: IntArray,
    block: IntArray,
    outward: IntArray,
    reach: tuple[float, float],
    weld_tol: float,
) -> RepeatedPieces:
    """The pieces of a wall between two surfaces over the patches of a mid surface, which repeats after `cell` (3,).

    mid (P, k, 3): points of each patch, neighbours have them alike but for a translation by cells; arms (2, P, k, 3) from them to
    the lower and the upper surface; triangles (2, m, 3): of a patch's points, for either surface, counter-clockwise from the
    upper side where outward (P,) is 1, clockwise where it is -1. The triangles of a patch make a piece for each of the blocks
    (m,) from 0 on. Sides are ruled between both surfaces. reach: the least and the greatest scale.
    TrimmingError if a patch has no neighbours.
    """
    n, k = mid.shape[:2]
    points = mid.reshape(-1, 3)
    first, base_of = _find_translates(points, cell, weld_tol)
    shift = np.rint((points - points[first[base_of]]) / cell).astype(np.int64)
    places = np.column_stack([base_of, shift])
    found = np.where((outward > 0)[:, None, None], triangles[:, None], triangles[:, None, :, ::-1])
    placed = (found + k * np.arange(n)[:, None, None]).reshape(2, -1, 3)
    count = int(block.max()) + 1
    piece = (np.arange(n)[:, None] * count + block).ravel()
    walls, pieces = [], []
    for corners in placed:  # a side of a patch may be a point
        around = places[corners]
        kept = (around != np.roll(around, 1, axis=1)).any(axis=2).all(axis=1)
        walls.append(corners[kept])
        pieces.append(piece[kept])
    sides, of, beyond, step = _pair_open_sides(walls[1], pieces[1], places)
    a, b = sides.T
    one = np.stack([2 * a, 2 * b, 2 * b + 1], axis=1)
    two = np.stack([2 * a, 2 * b + 1, 2 * a + 1], axis=1)
    everything = np.concatenate([2 * walls[0][:, ::-1], 2 * walls[1] + 1, one, two])
    n_surface = len(walls[0]) + len(walls[1])
    columns = np.insert(np.repeat(places, 2, axis=0), 1, np.tile([0, 1], len(points)), axis=1)
    node, index = np.unique(columns, axis=0, return_inverse=True)
    both = np.moveaxis(arms, 0, 2).reshape(-1, 2, 3)
    low, high = np.full((n * count, 3), np.inf), np.full((n * count, 3), -np.inf)
    for corners, of_wall, wall in zip(walls, pieces, (0, 1), strict=True):
        for scale in reach:
            ends_of = (points + scale * both[:, wall])[corners]
            np.minimum.at(low, of_wall, ends_of.min(axis=1))
            np.maximum.at(high, of_wall, ends_of.max(axis=1))
    return RepeatedPieces(
        cell=cell,
        low=low,
        high=high,
        base=points[first],
        arm=both[first],
        node=node,
        triangles=index.ravel()[everything],
        piece=np.concatenate([*pieces, of, of]),
        beyond=np.concatenate([np.full(n_surface, SURFACE), beyond, beyond]),
        beyond_shift=np.concatenate([np.zeros((n_surface, 3), np.int64), step, step]),
    )


def _find_translates(points: Array, cell: Array, tol: float) -> tuple[IntArray, IntArray]:
    """The first of each class of points (n, 3) that are whole cells apart, within a tolerance, and the class of each (n,)."""
    inner = points - np.floor(points / cell) * cell
    inner = np.where(cell - inner < tol, 0.0, inner)
    near = cKDTree(inner, boxsize=cell).query_pairs(tol, output_type="ndarray")
    _, first, label = np.unique(label_linked(len(points), near), return_index=True, return_inverse=True)
    return first, label.ravel()


def _pair_open_sides(
    corners: IntArray, piece: IntArray, places: IntArray
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """The directed sides (s, 2) of triangles (m, 3) of pieces (m,) that no triangle of the same piece has the other way.

    places (n, 4): class and shift in cells of each point. Returns also the piece of each side, the piece beyond it, and the cell
    of that seen from its own, (s, 3). TrimmingError if a side has no partner, or several.
    """
    base, shift = places[:, 0], places[:, 1:]
    sides, of = directed_sides(corners), np.repeat(piece, 3)
    ends = np.concatenate([base[sides], shift[sides[:, 1]] - shift[sides[:, 0]]], axis=1)
    against = np.concatenate([ends[:, 1::-1], -ends[:, 2:]], axis=1)
    start = shift[sides]
    own, other = (np.column_stack([of, table, start[:, i]]) for i, table in ((0, ends), (1, against)))
    _, label = np.unique(np.concatenate([own, other]), axis=0, return_inverse=True)
    of_own, of_other = np.split(label.ravel(), 2)
    is_open = ~np.isin(of_own, of_other)
    sides, of, ends, against, start = sides[is_open], of[is_open], ends[is_open], against[is_open], start[is_open]
    _, label = np.unique(np.concatenate([ends, against]), axis=0, return_inverse=True)
    label, against_label = np.split(label.ravel(), 2)
    order = np.argsort(label)
    at = np.searchsorted(label[order], against_label)
    partner = order[np.minimum(at, len(order) - 1)]
    if len(np.unique(label)) < len(label) or (label[partner] != against_label).any():
        raise TrimmingError("the patches of a cell do not meet their neighbours side by side")
    return sides, of, of[partner], start[:, 0] - start[partner, 1]
