"""Mutable polygon mesh with half-edge look-up, and the edits that simplify it without a change of topology.

Every simplification merges vertices into others: along a diagonal of a quadrilateral (Tarini et al. 2010) or across a strip of
quadrilaterals (Daniels et al. 2008). The removal of the edge between two triangles is the only other edit. Doublets, inner
vertices of valence two, are removed with the edit that makes them. An edit is planned only if the mesh stays a two-manifold with
at most one edge between two vertices, with allowed valences and with the same boundary on the box.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.vectors import next_corner

Polygon = tuple[int, ...]
"""Vertices of a polygon, counter-clockwise as seen from the void."""

HalfEdge = tuple[int, int]
"""An edge of a polygon as its first and second vertex."""

MIN_VALENCE = 3
MAX_VALENCE = 12
"""Limits on the number of polygons round a vertex; the lower one holds inside the box only. The upper one should not bind where
`quality` allows the angles: 7 stopped the collapses of 65 % of the triangles left, which cost three patches each."""

PATCHES_PER_TRIANGLE = 3

NO_CORNERS = (-1, -1, -1, -1)
"""The row of a number that no polygon has."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshEdit:
    """A planned edit: polygons removed by number and added by corners, vertices merged into others, doublets, patches saved."""

    removed: tuple[int, ...]
    added: tuple[Polygon, ...]
    merges: dict[int, int]
    doublets: set[int]
    patches_saved: int

    @property
    def vertices(self) -> set[int]:
        """Corners of the added polygons and the vertices that vanish."""
        return {v for polygon in self.added for v in polygon} | set(self.merges) | self.doublets


@dataclass(frozen=True, slots=True, eq=False)
class AppliedEdit:
    """An edit with all that its inverse needs: new numbers, old polygons by number, and the planes of their sides on the box.

    Edits that removed one of the new polygons must be undone first.
    """

    edit: MeshEdit
    new_numbers: list[int]
    old_polygons: dict[int, Polygon]
    old_box_sides: dict[HalfEdge, int]


def sides_of(polygon: Polygon) -> Iterator[HalfEdge]:
    """The half-edges of a polygon, from the one that ends at its first vertex."""
    return zip((polygon[-1], *polygon), polygon, strict=False)


def is_valence_allowed(count: int, inside: bool) -> bool:
    """Whether a vertex may have this number of polygons round it."""
    return count <= MAX_VALENCE and (count >= MIN_VALENCE or not inside)


def is_manifold_vertex(vertex: int, polygons: Iterable[Polygon], inside: bool) -> bool:
    """Whether the polygons round a vertex form one disk (inside the box) or one half-disk (on the box)."""
    next_neighbour = {}
    for polygon in polygons:
        i = polygon.index(vertex)
        next_neighbour[polygon[(i + 1) % len(polygon)]] = polygon[i - 1]
    first = set(next_neighbour) - set(next_neighbour.values())
    if len(first) > 1 or bool(first) == inside:
        return False
    current = start = next(iter(first)) if first else next(iter(next_neighbour))
    for _ in next_neighbour:
        current = next_neighbour.get(current, -1)
    if first:
        return current not in next_neighbour
    return current == start and len(set(next_neighbour.values())) == len(next_neighbour)


def count_patches(corners: IntArray) -> IntArray:
    """Patches (...) that polygons (..., 4), triangles padded with -1, become: one, or three for a triangle."""
    return np.where(corners[..., 3] < 0, PATCHES_PER_TRIANGLE, 1)


class PolygonMesh:
    """The polygons of a mesh by number, with their half-edges and the polygons round each vertex; edited in place.

    `corners_of[number]` are a polygon's corners, `polygons_at_vertex[v]` the numbers round a vertex, `polygon_of_half_edge[a, b]`
    the polygon on the left of an edge. `rows` (N, 4) holds the corners as an array, -1 in the last place of triangles and
    throughout where a number is unused. `n_fixed[v]` counts the fixed coordinates of a vertex; `plane_of_side[a, b]`, a < b, is
    the face of the box.
    """

    def __init__(self, mesh: QuadMesh) -> None:
        self.mesh = mesh
        self.n_fixed = mesh.fixed.sum(axis=1).tolist()
        self.corners_of: dict[int, Polygon] = {}
        self.polygons_at_vertex: list[set[int]] = [set() for _ in range(len(mesh.vertices))]
        self.polygon_of_half_edge: dict[HalfEdge, int] = {}
        self.next_number = 0
        self._rows = np.full((2 * len(mesh.corners), 4), -1)
        self._outdated_rows: set[int] = set()
        self._side_keys = np.sort(mesh.side_ends @ [len(mesh.vertices), 1])
        on_box = mesh.side_plane >= 0
        self.plane_of_side = {
            (min(a, b), max(a, b)): int(p)
            for (a, b), p in zip(mesh.side_ends[on_box].tolist(), mesh.side_plane[on_box], strict=True)
        }
        for row in mesh.corners.tolist():
            self._append(tuple(row) if row[3] >= 0 else tuple(row[:3]))

    @property
    def rows(self) -> IntArray:
        """The polygons as an array (N, 4), brought up to date at once: to write rows one by one takes as long as the edits."""
        if self._outdated_rows:
            while self.next_number > len(self._rows):
                self._rows = np.concatenate([self._rows, np.full(self._rows.shape, -1)])
            numbers, self._outdated_rows = list(self._outdated_rows), set()
            polygons = [self.corners_of.get(number, NO_CORNERS) for number in numbers]
            self._rows[numbers] = [polygon if len(polygon) == 4 else (*polygon, -1) for polygon in polygons]
        return self._rows

    def plan_collapse(self, merges: dict[int, int], vanishing: Iterable[int]) -> MeshEdit | None:
        """The edit that merges vertices into others.

        None if a polygon outside `vanishing` would degenerate, or if the result would not be a two-manifold with the same
        boundary.
        """
        expected = set(vanishing)
        removed = {f for v in merges for f in self.polygons_at_vertex[v]}
        added: list[Polygon] = []
        for number in sorted(removed):
            corners = [merges.get(v, v) for v in self.corners_of[number]]
            corners = [v for i, v in enumerate(corners) if v != corners[i - 1]]
            if len(corners) < 3 or len(set(corners)) < len(corners):
                if number not in expected:
                    return None
            else:
                added.append(tuple(corners))
        return self._validate_edit(removed, added, merges)

    def plan_edge_removal(self, one: int, other: int, a: int, b: int) -> MeshEdit | None:
        """The edit that joins two triangles to a quadrilateral by removing their edge from a to b; None if it is not valid."""
        (c,), (d,) = ([v for v in self.corners_of[number] if v not in (a, b)] for number in (one, other))
        return self._validate_edit({one, other}, [(a, d, b, c)], {})

    def apply(self, edit: MeshEdit) -> AppliedEdit:
        """Apply an edit that was planned for the mesh as it is."""
        old_polygons, old_box_sides = {f: self.corners_of[f] for f in edit.removed}, self.box_sides(edit.removed)
        for (a, b), plane in old_box_sides.items():
            del self.plane_of_side[a, b]
            c, d = edit.merges.get(a, a), edit.merges.get(b, b)
            if c != d:
                self.plane_of_side[min(c, d), max(c, d)] = plane
        for number in edit.removed:
            self._remove(number)
        return AppliedEdit(edit, [self._append(polygon) for polygon in edit.added], old_polygons, old_box_sides)

    def undo(self, applied: AppliedEdit) -> None:
        """Undo an applied edit; its new polygons must still be there."""
        for a, b in self._half_edges_on_box(applied.new_numbers):
            del self.plane_of_side[min(a, b), max(a, b)]
        for number in applied.new_numbers:
            self._remove(number)
        for number, polygon in applied.old_polygons.items():
            self._insert(number, polygon)
        self.plane_of_side.update(applied.old_box_sides)

    def box_sides(self, numbers: Iterable[int]) -> dict[HalfEdge, int]:
        """Sides of these polygons on the box, the lesser vertex first, with their planes."""
        edges = self._half_edges_on_box(numbers)
        return {(min(e), max(e)): self.plane_of_side[min(e), max(e)] for e in edges}

    def are_reversed_sides(self, ends: IntArray) -> BoolArray:
        """Whether the original mesh has sides from the second to the first of the vertices (n, 2)."""
        count, keys = len(self.mesh.vertices), self._side_keys
        wanted = ends[:, 0] + count * ends[:, 1]
        return np.asarray(keys[np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)] == wanted)

    def _append(self, polygon: Polygon) -> int:
        number, self.next_number = self.next_number, self.next_number + 1
        self._insert(number, polygon)
        return number

    def _insert(self, number: int, polygon: Polygon) -> None:
        self.corners_of[number] = polygon
        self._outdated_rows.add(number)
        for a, b in sides_of(polygon):
            self.polygons_at_vertex[b].add(number)
            self.polygon_of_half_edge[a, b] = number

    def _remove(self, number: int) -> None:
        polygon = self.corners_of.pop(number)
        self._outdated_rows.add(number)
        for a, b in sides_of(polygon):
            self.polygons_at_vertex[b].discard(number)
            del self.polygon_of_half_edge[a, b]

    def _validate_edit(self, removed: set[int], added: list[Polygon], merges: dict[int, int]) -> MeshEdit | None:
        """The edit with its doublets removed, or None if it is not valid or saves no patch; extends `removed` and `added`."""
        doublets: set[int] = set()
        if not self._remove_doublets(removed, added, doublets):
            return None
        if not (
            self._keeps_edges_manifold(removed, added, merges) and self._keeps_vertices_valid(removed, added, merges)
        ):
            return None
        saved = sum(_patch_count(self.corners_of[f]) for f in removed) - sum(map(_patch_count, added))
        return MeshEdit(tuple(sorted(removed)), tuple(added), merges, doublets, saved) if saved > 0 else None

    def _keeps_edges_manifold(self, removed: set[int], added: list[Polygon], merges: dict[int, int]) -> bool:
        """Whether every half-edge occurs once after the edit, and the boundary on the box is the image of the old one."""
        half_edges = self.polygon_of_half_edge
        edges = [edge for polygon in added for edge in sides_of(polygon)]
        distinct = set(edges)
        if len(distinct) < len(edges) or any(half_edges.get(e, -1) not in removed and e in half_edges for e in edges):
            return False
        old = [edge for number in removed for edge in sides_of(self.corners_of[number]) if edge[::-1] not in half_edges]
        images = {(merges.get(a, a), merges.get(b, b)) for a, b in old}
        boundary = {(a, b) for a, b in images if a != b}
        gone = removed | {-1}
        opened = {(a, b) for a, b in edges if (b, a) not in distinct and half_edges.get((b, a), -1) in gone}
        return opened == boundary

    def _keeps_vertices_valid(self, removed: set[int], added: list[Polygon], merges: dict[int, int]) -> bool:
        """Whether the corners of the added polygons have allowed valences, and merged vertices a disk or half-disk round them."""
        count = _count_corners(added)
        for v, n in count.items():
            if not is_valence_allowed(n + len(self.polygons_at_vertex[v] - removed), not self.n_fixed[v]):
                return False
        for v in set(merges.values()) & set(count):
            star = [p for p in added if v in p] + [self.corners_of[f] for f in self.polygons_at_vertex[v] - removed]
            if not is_manifold_vertex(v, star, not self.n_fixed[v]):
                return False
        return True

    def _remove_doublets(self, removed: set[int], added: list[Polygon], doublets: set[int]) -> bool:
        """Join the two polygons at each doublet, in place; False if a joined polygon degenerates or none is left."""
        while added:
            count = _count_corners(added)
            odd = [
                v
                for v, n in count.items()
                if n <= 2 and not self.n_fixed[v] and n + len(self.polygons_at_vertex[v] - removed) == 2
            ]
            if not odd:
                break
            v = min(odd)
            untouched = sorted(self.polygons_at_vertex[v] - removed)
            one, other = [list(p) for p in added if v in p] + [list(self.corners_of[f]) for f in untouched]
            i, k = one.index(v), other.index(v)
            first, second = one[i + 1 :] + one[:i], other[k + 1 :] + other[:k]
            corners = first + second[1:-1]
            if first[0] != second[-1] or first[-1] != second[0]:
                return False
            if len(corners) < 3 or len(set(corners)) < len(corners):
                return False
            removed |= self.polygons_at_vertex[v]
            added[:] = [p for p in added if v not in p] + [tuple(corners)]
            doublets.add(v)
        return bool(added)

    def _half_edges_on_box(self, numbers: Iterable[int]) -> list[HalfEdge]:
        """Half-edges of these polygons that have no opposite and whose ends lie on the box."""
        n_fixed, half_edges = self.n_fixed, self.polygon_of_half_edge
        polygons = (self.corners_of[number] for number in numbers)
        near = [polygon for polygon in polygons if any(map(n_fixed.__getitem__, polygon))]  # next to none
        edges = [edge for polygon in near for edge in sides_of(polygon)]
        return [(a, b) for a, b in edges if n_fixed[a] and n_fixed[b] and (b, a) not in half_edges]


def extract_mesh(
    polygons: PolygonMesh, vertices: Array, size: Array, numbers: Iterable[int]
) -> tuple[QuadMesh, IntArray]:
    """The quad mesh of the polygons of these numbers, and the original number (V',) of each of its vertices.

    Sides keep the directions that they have in the original mesh.
    """
    corners = polygons.rows[np.fromiter(numbers, np.int64)]
    present, mesh = corners >= 0, polygons.mesh
    is_used = np.zeros(len(mesh.vertices), bool)
    is_used[corners[present]] = True
    ids, renumbered = np.flatnonzero(is_used), np.cumsum(is_used) - 1
    small = np.where(present, renumbered[corners], -1)
    one, other = small[present], next_corner(small)[present]
    keys = np.minimum(one, other) * len(ids) + np.maximum(one, other)
    keys, side, uses = np.unique(keys, return_inverse=True, return_counts=True)
    ends = np.stack(np.divmod(keys, max(1, len(ids))), axis=1)
    sides = np.full(corners.shape, -1)
    sides[present] = side.ravel()
    plane = np.full(len(ends), -1)
    on_box = np.asarray(mesh.fixed[ids].any(axis=1))
    open_sides = np.flatnonzero((uses == 1) & on_box[ends].all(axis=1))
    plane[open_sides] = [polygons.plane_of_side.get((a, b), -1) for a, b in ids[ends[open_sides]].tolist()]
    turned = polygons.are_reversed_sides(ids[ends])
    ends[turned] = ends[turned, ::-1]
    of_vertices = (vertices[ids], mesh.start_positions[ids], mesh.fixed[ids], mesh.leaf[ids], size[ids])
    return QuadMesh(*of_vertices, small, sides, ends, plane), ids


def _count_corners(polygons: Iterable[Polygon]) -> Counter[int]:
    """Number of these polygons round each of their vertices, in the order of first occurrence."""
    return Counter(v for polygon in polygons for v in polygon)


def _patch_count(polygon: Polygon) -> int:
    return 1 if len(polygon) == 4 else PATCHES_PER_TRIANGLE
