"""A mesh of tetrahedra that is changed in place, some elements at a time, where that makes its worst elements better.

A change puts elements and facets in the place of others and moves nodes. Nodes that are images of each other move together, and
their elements are judged together. Middles of edges go along with the corners: those on faces are projected on these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.meshing.element_shapes import (
    TETRA_EDGES,
    determinants,
    jacobian_coefficients,
    scaled_jacobians,
)
from tpmscad.meshing.mesh_arrays import sort_nodes
from tpmscad.meshing.volume_mesh import VolumeMesh

NEWTON_STEPS = 12
"""To the curve in which faces meet: each goes to the planes that touch them at the nearest points."""

ON_FACE = 1e-9
"""Model units: distance up to which a point is on a face."""

LEAST_ANGLE = 0.05
"""Radians: angle between faces below which they are taken for one."""

CREASE_COSINE = 0.85
"""Of the angle between facets at a node beyond which a crease is taken to run between them, along which alone the node may go."""

SPARE = 0.25
"""Of the elements and nodes: rows for new ones."""

LEAST_GAIN = 1e-6
"""Of the worst scaled Jacobian: what is no better than this is round-off."""

EDGE_NUMBERS = {frozenset(ends): number for number, ends in enumerate(TETRA_EDGES)}
"""Number of an edge of a tetrahedron, given its two corners."""


@dataclass(frozen=True, slots=True, eq=False)
class FacesOfFacets:
    """The number of the face (m,) that each facet is of, and the nearest point of a face, by its number, to a point (3,)."""

    face: IntArray
    project: Callable[[int, Array], Array]


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Elements and facets that go, the rows of nodes that come, with the number of one that each is like, and places of nodes."""

    gone: list[int]
    cells: IntArray
    like: list[int]
    points: dict[int, Array] = field(default_factory=dict)
    gone_facets: list[int] = field(default_factory=list)
    facets: IntArray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    facets_like: list[int] = field(default_factory=list)


class EditableMesh:
    """The elements and facets of a mesh of one kind of tetrahedra, and those at each corner; all arrays have spare rows."""

    def __init__(self, mesh: VolumeMesh, faces: FacesOfFacets | None) -> None:
        self.mesh, self.faces_of_facets = mesh, faces
        ((self.kind, cells),), ((self.facet_kind, facets),) = mesh.cells.items(), mesh.facets.items()
        spare = 100 + int(SPARE * len(cells))
        self.n_points, self.n_cells = len(mesh.points), len(cells)
        self.points = np.concatenate([mesh.points, np.zeros((2 * spare, 3))])
        self.cells = np.concatenate([cells, np.zeros((spare, cells.shape[1]), np.int64)])
        self.facets = facets.copy()
        self.alive, self.alive_facets = np.arange(len(self.cells)) < len(cells), np.ones(len(facets), bool)
        self.source = np.concatenate(
            [np.arange(len(cells)), np.zeros(spare, np.int64)]
        )  # an element of the same groups
        self.facet_source = np.arange(len(facets))  # a facet of the same groups
        numbers = faces.face if faces is not None else np.zeros(len(facets), np.int64)
        self.faces = [frozenset((face,)) for face in numbers.tolist()]  # those that a facet may reach over
        self.n_changes = 0
        self.changed_at = np.zeros(len(self.points), np.int64)  # the last change of an element at each corner
        self.cells_at = _list_uses(cells[:, :4], len(self.points))
        self.facets_at = _list_uses(facets[:, :3], len(self.points))
        self.labels = _label_groups(len(facets), mesh.facet_groups.values())
        self.regions = _label_groups(len(cells), mesh.cell_groups.values())
        original, off = mesh.periodic_ties()
        self.original = np.concatenate([original, np.arange(len(mesh.points), len(self.points))])
        self.periods_off = np.concatenate([off, np.zeros((2 * spare, 3), np.int64)])
        self.periods = np.where(np.isnan(mesh.periods), 0.0, mesh.periods)
        self.images: dict[int, list[int]] = {}
        for node in np.flatnonzero(np.bincount(original, minlength=len(original))[original] > 1).tolist():
            self.images.setdefault(int(original[node]), []).append(node)

    @property
    def is_curved(self) -> bool:
        """Whether edges have a node in their middle."""
        return self.cells.shape[1] > 4

    def quality(self) -> tuple[IntArray, Array]:
        """Numbers of the elements, and the scaled Jacobian of each."""
        numbers = np.flatnonzero(self.alive)
        return numbers, scaled_jacobians(self.kind, self.points, self.cells[numbers])

    def quality_of(self, cells: Sequence[int]) -> float:
        """The worst scaled Jacobian of some elements."""
        return float(scaled_jacobians(self.kind, self.points, self.cells[list(cells)]).min())

    def images_of(self, node: int) -> list[int]:
        """A node and its images."""
        return self.images.get(int(self.original[node]), [node])

    def neighbours(self, node: int) -> set[int]:
        """Corners that share an element with a corner."""
        return set(self.cells[list(self.cells_at[node]), :4].ravel().tolist()) - {node}

    def middle(self, a: int, b: int) -> int:
        """The node in the middle of an edge."""
        cell = next(iter(self.cells_at[a] & self.cells_at[b]))
        corners = self.cells[cell, :4].tolist()
        return int(self.cells[cell, 4 + EDGE_NUMBERS[frozenset((corners.index(a), corners.index(b)))]])

    def normal(self, facet: int) -> Array:
        """Unit normal of the flat triangle between a facet's corners."""
        return unit_normal(self.points[self.facets[facet, :3]])

    def label_of(self, facet: int) -> int:
        """A number that facets of the same groups have in common."""
        return int(self.labels[self.facet_source[facet]])

    def region_of(self, cell: int) -> int:
        """A number that elements of the same groups have in common."""
        return int(self.regions[self.source[cell]])

    def facets_near(self, a: int, b: int) -> set[int]:
        """Facets at either end of an edge that are of the same groups as one at the edge: its middle may lie on their faces."""
        labels = {self.label_of(f) for f in self.facets_at[a] & self.facets_at[b]}
        if not labels:
            return set()
        return {f for f in self.facets_at[a] | self.facets_at[b] if self.label_of(f) in labels}

    def project_on(self, facets: Iterable[int], place: Array) -> Array:
        """The point of the faces of facets that is nearest to a point; of several groups, of the curve in which they meet."""
        by_label: dict[int, set[int]] = {}
        for f in facets:
            by_label.setdefault(self.label_of(f), set()).update(self.faces[f])
        if len(by_label) < 2:
            return self._project(next(iter(by_label.values())), place) if by_label else place
        normals: dict[int, Array] = {}
        for _ in range(NEWTON_STEPS):
            off = {label: self._project(faces, place) - place for label, faces in by_label.items()}
            gaps = {label: float(np.linalg.norm(vector)) for label, vector in off.items()}
            if max(gaps.values()) <= ON_FACE:
                break
            normals |= {label: vector / gaps[label] for label, vector in off.items() if gaps[label] > ON_FACE}
            rows = np.array([*normals.values()])
            place = place + np.linalg.pinv(rows, LEAST_ANGLE) @ [
                normal @ off[label] for label, normal in normals.items()
            ]
        return place

    def _project(self, faces: Iterable[int], place: Array) -> Array:
        """The nearest point of some faces; the point itself if these are not known."""
        if self.faces_of_facets is None:
            return place
        found = [self.faces_of_facets.project(face, place) for face in sorted(faces)]
        return min(found, key=lambda p: float(np.linalg.norm(p - place)))

    def place_middle(self, node: int, start: Array, end: Array, middle: int, facets: Iterable[int]) -> Array:
        """Where the middle of an edge from a node goes whose other end goes from one place to another."""
        return self.project_on(facets, carry_middles(self.points[node], start, end, self.points[middle]))

    def make_best(self, changes: Sequence[Change]) -> int:
        """Carry out the one of some changes after which the worst element is best, if any is better than before; 1 or 0."""
        changes = [each for each in changes if len(each.cells)]
        if not changes:
            return 0
        start = self._worst_of([self.cells[each.gone] for each in changes], [{} for _ in changes])
        end = self._worst_of([each.cells for each in changes], [each.points for each in changes])
        for k in np.argsort(-end):
            if self.worst_after([changes[k]], float(start[k]) + LEAST_GAIN) is not None:
                self.apply(changes[k])
                return 1
        return 0

    def _worst_of(self, cells: Sequence[IntArray], places: Sequence[Mapping[int, Array]]) -> Array:
        """The worst scaled Jacobian (k,) of each of k blocks of elements, with some of their nodes at other places: in one go."""
        rows, moved = np.concatenate(cells), [place for of in places for place in of.values()]
        points, count, start = self.points[rows], 0, 0
        for block, of in zip(cells, places, strict=True):
            for node in of:
                points[start : start + len(block)][block == node] = moved[count]
                count += 1
            start += len(block)
        nodes = np.arange(rows.size).reshape(rows.shape)
        each = scaled_jacobians(self.kind, points.reshape(-1, 3), nodes)
        starts = np.cumsum([0, *map(len, cells[:-1])])
        return np.asarray(np.minimum.reduceat(each, starts))

    def judge_changes(self, changes: Sequence[Change], straight: bool = False) -> float | None:
        """The worst scaled Jacobian after changes; None if it is no better than before, or if they touch an element twice.

        `straight`: whether elements are judged as if all edges were straight.
        """
        every = [cell for each in changes for cell in each.gone]
        if len(set(every)) < len(every) or not all(len(each.cells) for each in changes):
            return None
        before = (
            scaled_jacobians("tetra", self.points, self.cells[every, :4]).min() if straight else self.quality_of(every)
        )
        return self.worst_after(changes, float(before) + LEAST_GAIN, straight)

    def worst_after(self, changes: Sequence[Change], least: float, straight: bool = False) -> float | None:
        """The worst scaled Jacobian of the elements that changes bring; None if it is not above `least`, or one may be inverted.

        An element may be inverted, too, once its edges are made straight, so that this stays a remedy. What each measure says
        is asked in the order of what it takes.
        """
        worst = 1.0
        for each in changes:
            used, nodes = np.unique(each.cells, return_inverse=True)
            nodes = nodes.reshape(each.cells.shape)
            points = np.array([each.points.get(node, self.points[node]) for node in used.tolist()])
            corners = nodes[:, :4]
            found = (
                scaled_jacobians("tetra", points, corners) if straight else scaled_jacobians(self.kind, points, nodes)
            )
            worst = min(worst, float(found.min()))
            if worst <= least:
                return None
            if not self.is_curved or straight:
                continue
            if not determinants(points[corners[:, 1:]] - points[corners[:, :1]]).min() > 0:
                return None
            if worst > 0 and not jacobian_coefficients(self.kind, points, nodes).min() > 0:
                return None
        return worst

    def apply(self, change: Change) -> None:
        """Carry out a change."""
        self.n_changes += 1
        self.changed_at[self.cells[change.gone, :4]] = self.n_changes
        for node, place in change.points.items():
            self.points[node] = place
            self.n_points = max(self.n_points, node + 1)
        for cell in change.gone:
            self.alive[cell] = False
            for node in self.cells[cell, :4].tolist():
                self.cells_at[node].discard(cell)
        sources = [int(self.source[cell]) for cell in change.like]
        free = len(change.cells) - len(change.gone)
        numbers = [*change.gone[: len(change.cells)], *range(self.n_cells, self.n_cells + free)]
        self.n_cells += max(free, 0)
        for cell, row, source in zip(numbers, change.cells, sources, strict=True):
            self.cells[cell], self.source[cell], self.alive[cell] = row, source, True
            for node in row[:4].tolist():
                self.cells_at[node].add(cell)
        for facet in change.gone_facets:
            self.alive_facets[facet] = False
            for node in self.facets[facet, :3].tolist():
                self.facets_at[node].discard(facet)
        facet_sources = [int(self.facet_source[facet]) for facet in change.facets_like]
        faces: dict[int, frozenset[int]] = {}
        for facet in change.gone_facets:
            faces[self.label_of(facet)] = faces.get(self.label_of(facet), frozenset()) | self.faces[facet]
        places = change.gone_facets[: len(change.facets)]
        for facet, row, source in zip(places, change.facets, facet_sources, strict=True):
            self.facets[facet], self.facet_source[facet], self.alive_facets[facet] = row, source, True
            self.faces[facet] = faces[self.label_of(facet)]
            for node in row[:3].tolist():
                self.facets_at[node].add(facet)

    def has_room(self) -> bool:
        """Whether a swap may bring new elements and nodes."""
        return self.n_cells + 20 < len(self.cells) and self.n_points + 20 < len(self.points)

    def deviation(self) -> float:
        """Greatest distance of a node on facets from the faces that it lies on, with images at their places; 0 without faces."""
        if self.faces_of_facets is None:
            return 0.0
        faces: dict[tuple[int, int], dict[int, None]] = {}
        for facet in np.flatnonzero(self.alive_facets).tolist():
            label, around = (
                self.label_of(facet),
                {f for n in self.facets[facet, :3].tolist() for f in self.facets_at[n]},
            )
            near = {face for f in around if self.label_of(f) == label for face in self.faces[f]}
            for node in self.facets[facet].tolist():
                faces.setdefault((node, label), {}).update(dict.fromkeys([*self.faces[facet], *sorted(near)]))
        points = self.points[self.original] + self.periods_off * self.periods
        worst = 0.0
        for (node, _), own in faces.items():  # its own face first: most nodes lie on it, and need no other
            gap = np.inf
            for face in own:
                gap = min(gap, float(np.linalg.norm(self._project([face], points[node]) - points[node])))
                if gap <= worst:
                    break
            worst = max(worst, gap)
        return worst

    def build(self) -> VolumeMesh:
        """The mesh of what is left, with images exactly at their places."""
        n = self.n_points
        groups = {
            name: np.flatnonzero(np.isin(self.source[self.alive], of)) for name, of in self.mesh.cell_groups.items()
        }
        facet_groups = {
            name: np.flatnonzero(np.isin(self.facet_source[self.alive_facets], of))
            for name, of in self.mesh.facet_groups.items()
        }
        made = replace(
            self.mesh,
            points=(self.points[self.original] + self.periods_off * self.periods)[:n],
            cells={self.kind: self.cells[self.alive]},
            facets={self.facet_kind: self.facets[self.alive_facets]},
            cell_groups=groups,
            facet_groups=facet_groups,
            deviation=self.deviation(),
        )
        return sort_nodes(made)


def unit_normal(corners: Array) -> Array:
    """Unit normal of a triangle (3, 3), in plain numbers: ten times as fast as on arrays of three."""
    (x, y, z), (x1, y1, z1), (x2, y2, z2) = corners.tolist()
    ux, uy, uz, vx, vy, vz = x1 - x, y1 - y, z1 - z, x2 - x, y2 - y, z2 - z
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return np.array([nx, ny, nz]) / max(math.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)


def carry_middles(fixed: Array, start: Array, end: Array, middles: Array) -> Array:
    """Middles (..., 3) of edges, curved as before, whose ends go from one place to another while the other ends stay."""
    former, chord = fixed - start, fixed - end
    height = middles - 0.5 * (fixed + start)
    lengths = np.maximum((former * former).sum(axis=-1, keepdims=True), 1e-300)
    return np.asarray(end + 0.5 * chord + height * (chord * chord).sum(axis=-1, keepdims=True) / lengths)


def _label_groups(n: int, groups: Iterable[IntArray]) -> IntArray:
    """For each of n items a number that those of the same groups have in common."""
    labels = np.zeros(n, np.int64)
    for of_group in groups:
        key = 2 * labels
        key[of_group] += 1
        labels = np.unique(key, return_inverse=True)[1]
    return labels


def _list_uses(nodes: IntArray, count: int) -> list[set[int]]:
    """For each node the rows that have it."""
    found: list[set[int]] = [set() for _ in range(count)]
    for row, own in enumerate(nodes.tolist()):
        for node in own:
            found[node].add(row)
    return found
