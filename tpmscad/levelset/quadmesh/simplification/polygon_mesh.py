"""Whether the polygons round the vertices of a layout are one fan each, and as many as are wanted.

Polygons of a layout that can be merged: vertices collapsed into others, sides taken out, the surface's topology kept.

Every simplification is a set of vertices that go into others (Tarini et al., "Practical quad mesh simplification", 2010: the
collapse of a diagonal; Daniels et al., "Quadrilateral mesh simplification", 2008: the collapse of a strip), after which corners
where only two polygons meet are taken out. A change is made only if the mesh stays a two-manifold without two sides between the
same vertices and its sides on the box stay there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.vectors import next_corner

Polygon = tuple[int, ...]

MIN_VALENCE, MAX_VALENCE = 3, 7
"""Polygons round a vertex inside the box."""


def is_valence_allowed(count: int, inside: bool) -> bool:
    """Whether so many polygons are wanted round a vertex."""
    return count <= MAX_VALENCE and (count >= MIN_VALENCE or not inside)


def is_manifold_vertex(vertex: int, polygons: Iterable[Polygon], inside: bool) -> bool:
    """Whether polygons follow each other round a vertex: all the way inside, from side to side on the box."""
    following = {}
    for polygon in polygons:
        i = polygon.index(vertex)
        following[polygon[(i + 1) % len(polygon)]] = polygon[i - 1]
    first = set(following) - set(following.values())
    if len(first) > 1 or bool(first) == inside:
        return False
    at = start = next(iter(first)) if first else next(iter(following))
    for _ in following:
        at = following.get(at, -1)
    return at not in following if first else at == start and len(set(following.values())) == len(following)


__all__ = ["AppliedEdit", "MeshEdit", "Polygon", "PolygonMesh", "extract_mesh"]


@dataclass(frozen=True, slots=True, eq=False)
class MeshEdit:
    """Polygons by number that go, polygons that come, which vertices went `into` which, those that were `dropped` as
    only two polygons met there, and the patches saved."""

    old: tuple[int, ...]
    new: tuple[Polygon, ...]
    into: dict[int, int]
    dropped: set[int]
    saved: int

    @property
    def vertices(self) -> set[int]:
        """What the change touches: corners of the polygons that come, and the vertices that go."""
        return {v for polygon in self.new for v in polygon} | set(self.into) | self.dropped


@dataclass(frozen=True, slots=True, eq=False)
class AppliedEdit:
    """A change that was made, and what it takes to undo it: the numbers of its new polygons, its old ones, and their sides on
    the box with their planes. Changes whose `old` polygons are among these numbers have to be undone before it."""

    change: MeshEdit
    numbers: list[int]
    old: dict[int, Polygon]
    plane: dict[tuple[int, int], int]


class PolygonMesh:
    """The polygons of a mesh by number, with what is around each vertex; changed in place. `rows` has the corners by
    number, -1 last in triangles and throughout where there is none."""

    def __init__(self, mesh: QuadMesh) -> None:
        self.mesh = mesh
        self.fixed = mesh.fixed.sum(axis=1).tolist()
        self.polygon: dict[int, Polygon] = {}
        self.around: list[set[int]] = [set() for _ in range(len(mesh.vertices))]
        self.beside: dict[tuple[int, int], int] = {}
        self.next = 0
        self.rows = np.full((2 * len(mesh.corners), 4), -1)
        on_box = mesh.side_plane >= 0
        self.plane = {
            (min(a, b), max(a, b)): int(p)
            for (a, b), p in zip(mesh.side_ends[on_box].tolist(), mesh.side_plane[on_box], strict=True)
        }
        for row in mesh.corners.tolist():
            self._add(tuple(row) if row[3] >= 0 else tuple(row[:3]))

    def _add(self, polygon: Polygon) -> int:
        number, self.next = self.next, self.next + 1
        self._put(number, polygon)
        return number

    def _put(self, number: int, polygon: Polygon) -> None:
        self.polygon[number] = polygon
        if number >= len(self.rows):
            self.rows = np.concatenate([self.rows, np.full(self.rows.shape, -1)])
        self.rows[number, : len(polygon)] = polygon
        for i, v in enumerate(polygon):
            self.around[v].add(number)
            self.beside[polygon[i - 1], v] = number

    def _take(self, number: int) -> None:
        polygon = self.polygon.pop(number)
        self.rows[number] = -1
        for i, v in enumerate(polygon):
            self.around[v].discard(number)
            del self.beside[polygon[i - 1], v]

    def plan_collapse(self, into: dict[int, int], vanishing: Iterable[int]) -> MeshEdit | None:
        """What it takes that vertices go into others; None where more than the `vanishing` polygons would go with them, or the
        mesh would not stay what it is."""
        expected = set(vanishing)
        old = {f for v in into for f in self.around[v]}
        new: list[Polygon] = []
        for number in sorted(old):
            corners = [into.get(v, v) for v in self.polygon[number]]
            corners = [v for i, v in enumerate(corners) if v != corners[i - 1]]
            if len(corners) < 3 or len(set(corners)) < len(corners):
                if number not in expected:
                    return None
            else:
                new.append(tuple(corners))
        return self._checked(old, new, into)

    def joined(self, one: int, other: int, a: int, b: int) -> MeshEdit | None:
        """The triangles `one` and `other` made a quadrilateral: their side from a to b taken out."""
        (c,), (d,) = ([v for v in self.polygon[number] if v not in (a, b)] for number in (one, other))
        return self._checked({one, other}, [(a, d, b, c)], {})

    def _checked(self, old: set[int], new: list[Polygon], into: dict[int, int]) -> MeshEdit | None:
        dropped: set[int] = set()
        if not self._without_doublets(old, new, dropped):
            return None
        edges = [(polygon[i - 1], v) for polygon in new for i, v in enumerate(polygon)]
        here = set(edges)
        if len(here) < len(edges) or any(self.beside.get(e, -1) not in old and e in self.beside for e in edges):
            return None
        kept = set()
        for number in old:
            polygon = self.polygon[number]
            for i, v in enumerate(polygon):
                if (v, polygon[i - 1]) not in self.beside:
                    kept.add((into.get(polygon[i - 1], polygon[i - 1]), into.get(v, v)))
        kept = {(a, b) for a, b in kept if a != b}
        opened = {(a, b) for a, b in edges if (b, a) not in here and self.beside.get((b, a), -1) in old | {-1}}
        if opened != kept:
            return None
        count: dict[int, int] = {}
        for polygon in new:
            for v in polygon:
                count[v] = count.get(v, 0) + 1
        if not all(is_valence_allowed(n + len(self.around[v] - old), not self.fixed[v]) for v, n in count.items()):
            return None
        for v in set(into.values()) & set(count):
            beside = [p for p in new if v in p] + [self.polygon[f] for f in self.around[v] - old]
            if not is_manifold_vertex(v, beside, not self.fixed[v]):
                return None
        saved = sum(_patch_count(self.polygon[f]) for f in old) - sum(map(_patch_count, new))
        return MeshEdit(tuple(sorted(old)), tuple(new), into, dropped, saved) if saved > 0 else None

    def _without_doublets(self, old: set[int], new: list[Polygon], dropped: set[int]) -> bool:
        """Polygons joined where only two meet at an inner vertex, in place; False where that leaves nothing."""
        while new:
            inside: dict[int, int] = {}
            for polygon in new:
                for v in polygon:
                    inside[v] = inside.get(v, 0) + 1
            odd = [v for v, n in inside.items() if not self.fixed[v] and n + len(self.around[v] - old) == 2]
            if not odd:
                break
            v = min(odd)
            one, other = [list(p) for p in new if v in p] + [
                list(self.polygon[f]) for f in sorted(self.around[v] - old)
            ]
            i, k = one.index(v), other.index(v)
            first, second = one[i + 1 :] + one[:i], other[k + 1 :] + other[:k]
            corners = first + second[1:-1]
            if first[0] != second[-1] or first[-1] != second[0]:
                return False
            if len(corners) < 3 or len(set(corners)) < len(corners):
                return False
            old |= self.around[v]
            new[:] = [p for p in new if v not in p] + [tuple(corners)]
            dropped.add(v)
        return bool(new)

    def apply(self, change: MeshEdit) -> list[int]:
        """Make a change that `collapsed` or `joined` gave for the mesh as it is; the numbers of the new polygons."""
        for a, b in _box_side_list(change.old, self):
            plane = self.plane.pop((min(a, b), max(a, b)))
            c, d = change.into.get(a, a), change.into.get(b, b)
            if c != d:
                self.plane[min(c, d), max(c, d)] = plane
        for number in change.old:
            self._take(number)
        return [self._add(polygon) for polygon in change.new]

    def undo(
        self, change: MeshEdit, numbers: list[int], before: dict[int, Polygon], plane: dict[tuple[int, int], int]
    ) -> None:
        """Take a change back: `before` are its old polygons, `plane` their sides on the box."""
        for a, b in _box_side_list(numbers, self):
            del self.plane[min(a, b), max(a, b)]
        for number in numbers:
            self._take(number)
        for number, polygon in before.items():
            self._put(number, polygon)
        self.plane.update(plane)

    def box_sides(self, numbers: Iterable[int]) -> dict[tuple[int, int], int]:
        """Sides of these polygons on the box, with their planes."""
        return {(min(e), max(e)): self.plane[min(e), max(e)] for e in _box_side_list(numbers, self)}


def _box_side_list(numbers: Iterable[int], polygons: PolygonMesh) -> list[tuple[int, int]]:
    found, fixed, beside = [], polygons.fixed, polygons.beside
    for number in numbers:
        polygon = polygons.polygon[number]
        a = polygon[-1]
        for b in polygon:
            if fixed[a] and fixed[b] and (b, a) not in beside:
                found.append((a, b))
            a = b
    return found


def _patch_count(polygon: Polygon) -> int:
    return 1 if len(polygon) == 4 else 3


def extract_mesh(
    polygons: PolygonMesh, vertices: Array, size: Array, numbers: Iterable[int]
) -> tuple[QuadMesh, IntArray]:
    """The mesh of polygons of these numbers, and which of all vertices its own are. Sides run as the first mesh's do."""
    corners = polygons.rows[np.fromiter(numbers, np.int64)]
    present = corners >= 0
    of, place = np.unique(corners[present], return_inverse=True)
    small = np.full(corners.shape, -1)
    small[present] = place.ravel()
    one, other = small[present], next_corner(small)[present]
    keys = np.minimum(one, other) * len(of) + np.maximum(one, other)
    keys, number, uses = np.unique(keys, return_inverse=True, return_counts=True)
    ends = np.stack(np.divmod(keys, max(1, len(of))), axis=1)
    sides = np.full(corners.shape, -1)
    sides[present] = number.ravel()
    plane = np.full(len(ends), -1)
    mesh = polygons.mesh
    on_box = mesh.fixed[of].any(axis=1)
    open_sides = np.flatnonzero((uses == 1) & on_box[ends].all(axis=1))
    known = polygons.plane
    plane[open_sides] = [known.get((a, b), -1) for a, b in of[ends[open_sides]].tolist()]
    count = len(mesh.vertices)
    turned = np.isin(of[ends] @ [1, count], mesh.side_ends @ [count, 1])
    ends[turned] = ends[turned, ::-1]
    own = (vertices[of], mesh.start[of], mesh.fixed[of], mesh.cell[of], size[of])
    return QuadMesh(*own, small, sides, ends, plane), of
