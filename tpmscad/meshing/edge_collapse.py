"""Short edges of flat tetrahedra collapsed: one end goes to the other, and the elements between them vanish.

Patches of a fitted surface end where they like, so that a side of the box may pass a corner of patches at a hundredth of the
element size. A mesh that has a node in every vertex is as flat there as the edge is short. An edge of an element below the
quality wanted is collapsed if it is short, if all facets at the end which goes continue facets at the edge, in group and
normal, if they do not turn, and if the worst element around gets better. Nodes that are images of each other go together.

Source of the condition that keeps the topology: Dey, Edelsbrunner, Guha and Nekhayev, Topology preserving edge contraction,
Publ. Inst. Math. 66 (1999) 23.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.meshing.element_shapes import TETRA_EDGES, jacobian_coefficients, scaled_jacobians
from tpmscad.meshing.mesh_arrays import sort_nodes
from tpmscad.meshing.volume_mesh import VolumeMesh

POOR = 0.1
"""Scaled Jacobian below which the edges of an element are tried."""
SHORT = 0.5
"""In element sizes: length above which edges are kept."""

ALTERNATIONS = 6
"""Projections on each of the faces that meet in an edge: the distance from it falls by half or more with each."""

LEAST_COSINE = 0.98
"""Of the angle by which a facet may turn: that of a curved surface turns by its curvature times the length of the edge."""

CREASE_COSINE = 0.85
"""Of the angle between facets at a node beyond which a crease is taken to run between them, along which alone the node may go."""

MAX_PASSES = 8


Project = Callable[[int, Array], Array]
"""From the number of a facet and a point (3,) to the nearest point of the face that the facet is of."""


def collapse_short_edges(mesh: VolumeMesh, size: float, project: Project | None = None) -> VolumeMesh:
    """The mesh of tetrahedra without the short edges of its poor elements; `collapsed` of the result counts them.

    Size: the element size wanted, model units. Middles of edges that end in another node keep their height over the chord, in
    proportion to the square of its length, and are projected on the faces that they lie on, if these are known.
    """
    (kind,) = mesh.cells
    state = _CollapsibleMesh(mesh, project)
    count = 0
    for _ in range(MAX_PASSES):
        quality = scaled_jacobians(kind, state.points, state.cells[state.alive])
        poor = quality < POOR
        cells = np.flatnonzero(state.alive)[poor][np.argsort(quality[poor])]
        done = sum(state.collapse_best_edge(cell, SHORT * size) for cell in cells.tolist())
        if not done:
            break
        count += done
    return replace(state.build(), collapsed=count) if count else mesh


@dataclass(frozen=True, slots=True, eq=False)
class _Collapse:
    """What a collapse changes: numbers of nodes, places of middles, the elements and facets that vanish and those that change."""

    renamed: dict[int, int]
    moved: dict[int, Array]
    gone: list[int]
    changed: list[int]
    gone_facets: list[int]
    changed_facets: list[int]


class _CollapsibleMesh:
    """A mesh whose edges are collapsed in place, with the elements and facets at each corner."""

    def __init__(self, mesh: VolumeMesh, project: Project | None) -> None:
        self.project = project
        ((self.kind, cells),), ((self.facet_kind, facets),) = mesh.cells.items(), mesh.facets.items()
        self.mesh, self.points = mesh, mesh.points.copy()
        self.cells, self.facets = cells.copy(), facets.copy()
        self.alive, self.alive_facets = np.ones(len(cells), bool), np.ones(len(facets), bool)
        self.cells_at = _list_uses(cells[:, :4], len(self.points))
        self.facets_at = _list_uses(facets[:, :3], len(self.points))
        self.labels = np.zeros(len(facets), np.int64)  # facets of the same groups have the same number
        for of_group in mesh.facet_groups.values():
            key = 2 * self.labels
            key[of_group] += 1
            self.labels = np.unique(key, return_inverse=True)[1]
        self.original, self.periods_off = mesh.periodic_ties()
        self.images: dict[int, list[int]] = {}
        for node in np.flatnonzero(np.bincount(self.original, minlength=len(self.points))[self.original] > 1).tolist():
            self.images.setdefault(int(self.original[node]), []).append(node)

    def collapse_best_edge(self, cell: int, longest: float) -> int:
        """Collapse the shortest edge of an element that can be; the number of edges collapsed, images included."""
        if not self.alive[cell]:
            return 0
        corners = self.cells[cell, :4]
        ends = corners[np.array(TETRA_EDGES)]
        lengths = np.linalg.norm(self.points[ends[:, 0]] - self.points[ends[:, 1]], axis=1)
        for i in np.argsort(lengths):
            if lengths[i] > longest:
                return 0
            for gone, kept in (ends[i].tolist(), ends[i][::-1].tolist()):
                pairs = self._find_images(gone, kept)
                found = [self._examine(a, b) for a, b in pairs]
                collapses = [each for each in found if each is not None]
                if (
                    collapses
                    and len(collapses) == len(pairs)
                    and _are_apart(collapses)
                    and all(map(self._improves, collapses))
                ):
                    for each in collapses:
                        self._apply(each)
                    return len(pairs)
        return 0

    def _find_images(self, gone: int, kept: int) -> list[tuple[int, int]]:
        """The edge and its images; none if the end that goes has an image that has no such edge."""
        own = self.images.get(int(self.original[gone]), [gone])
        if len(own) == 1:
            return [(gone, kept)]
        off = self.periods_off[kept] - self.periods_off[gone]
        others = {tuple(self.periods_off[n]): n for n in self.images.get(int(self.original[kept]), [kept])}
        found = [(node, others.get(tuple(self.periods_off[node] + off), -1)) for node in own]
        return found if all(b >= 0 for _, b in found) else []

    def _neighbours(self, node: int) -> set[int]:
        return set(self.cells[list(self.cells_at[node]), :4].ravel().tolist()) - {node}

    def _examine(self, gone: int, kept: int) -> _Collapse | None:
        """The collapse of an edge, None if it would change the topology or what nodes lie on."""
        between = self.cells_at[gone] & self.cells_at[kept]
        facets = self.facets_at[gone] & self.facets_at[kept]
        changed_facets = self.facets_at[gone] - facets
        if not between or not all(self._continues(facet, facets) for facet in changed_facets):
            return None
        ring = {n for cell in between for n in self.cells[cell, :4].tolist()} - {gone, kept}
        if self._neighbours(gone) & self._neighbours(kept) != ring:
            return None
        opposite = {frozenset(set(self.cells[cell, :4].tolist()) - {gone, kept}) for cell in between}
        if self._ring_edges(gone, ring) & self._ring_edges(kept, ring) != opposite:
            return None
        renamed, moved = {gone: kept}, {}
        if self.cells.shape[1] > 4:
            middle = {node: self._middle(gone, node) for node in self._neighbours(gone)}
            for node in ring:
                renamed[middle[node]] = self._middle(kept, node)
            for node in middle.keys() - ring - {kept}:
                moved[middle[node]] = self._place_middle(gone, kept, node, middle[node])
        if any(self._turns(facet, gone, kept) for facet in changed_facets):
            return None
        changed = self.cells_at[gone] - between
        return _Collapse(renamed, moved, sorted(between), sorted(changed), sorted(facets), sorted(changed_facets))

    def _continues(self, facet: int, others: set[int]) -> bool:
        """Whether one of other facets is of the same groups, with no crease between both."""
        normal = self._normal(self.points[self.facets[facet, :3]])
        return any(
            self.labels[other] == self.labels[facet]
            and normal @ self._normal(self.points[self.facets[other, :3]]) > CREASE_COSINE
            for other in others
        )

    @staticmethod
    def _normal(corners: Array) -> Array:
        vector = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-300))

    def _labels_of(self, facets: set[int]) -> set[int]:
        return set(self.labels[list(facets)].tolist())

    def _ring_edges(self, node: int, ring: set[int]) -> set[frozenset[int]]:
        """Edges between nodes of a ring that make a triangle with a node, where an element has it."""
        return {
            frozenset(pair)
            for cell in self.cells_at[node]
            for pair in combinations([n for n in self.cells[cell, :4].tolist() if n in ring], 2)
        }

    def _middle(self, a: int, b: int) -> int:
        """The node in the middle of an edge."""
        cell = next(iter(self.cells_at[a] & self.cells_at[b]))
        corners = self.cells[cell, :4].tolist()
        edge = {corners.index(a), corners.index(b)}
        return int(self.cells[cell, 4 + [set(each) for each in TETRA_EDGES].index(edge)])

    def _place_middle(self, gone: int, kept: int, node: int, middle: int) -> Array:
        """Where the middle of an edge goes whose end goes to another node."""
        former, chord = self.points[node] - self.points[gone], self.points[node] - self.points[kept]
        height = self.points[middle] - 0.5 * (self.points[node] + self.points[gone])
        place = np.asarray(self.points[kept] + 0.5 * chord + height * (chord @ chord) / (former @ former))
        facets = sorted(self.facets_at[gone] & self.facets_at[node])
        if self.project is None or not facets:
            return place
        if len(self._labels_of(set(facets))) == 1:
            return min((self.project(f, place) for f in facets), key=lambda p: float(np.linalg.norm(p - place)))
        for facet in ALTERNATIONS * facets:  # to the curve in which faces of two groups meet
            place = self.project(facet, place)
        return place

    def _turns(self, facet: int, gone: int, kept: int) -> bool:
        """Whether the normal of a facet turns too far."""
        corners = self.facets[facet, :3]
        before = self.points[corners]
        after = np.where((corners == gone)[:, None], self.points[kept], before)
        return not self._normal(before) @ self._normal(after) > LEAST_COSINE

    def _improves(self, collapse: _Collapse) -> bool:
        """Whether the worst element around is better afterwards, and none is inverted."""
        before = scaled_jacobians(self.kind, self.points, self.cells[collapse.gone + collapse.changed]).min()
        used, nodes = np.unique(self._rename(self.cells[collapse.changed], collapse), return_inverse=True)
        nodes = nodes.reshape(-1, self.cells.shape[1])
        points = np.array([collapse.moved.get(node, self.points[node]) for node in used.tolist()])
        return bool(
            len(nodes)
            and scaled_jacobians(self.kind, points, nodes).min() > before
            and jacobian_coefficients(self.kind, points, nodes).min() > 0
        )

    def _rename(self, nodes: IntArray, collapse: _Collapse) -> IntArray:
        found = nodes.copy()
        for old, new in collapse.renamed.items():
            found[nodes == old] = new
        return found

    def _apply(self, collapse: _Collapse) -> None:
        gone, kept = next(iter(collapse.renamed.items()))
        for node, place in collapse.moved.items():
            self.points[node] = place
        self.cells[collapse.changed] = self._rename(self.cells[collapse.changed], collapse)
        self.facets[collapse.changed_facets] = self._rename(self.facets[collapse.changed_facets], collapse)
        for cell in collapse.gone:
            self.alive[cell] = False
            for node in self.cells[cell, :4].tolist():
                self.cells_at[node].discard(cell)
        for facet in collapse.gone_facets:
            self.alive_facets[facet] = False
            for node in self.facets[facet, :3].tolist():
                self.facets_at[node].discard(facet)
        self.cells_at[kept] |= set(collapse.changed)
        self.facets_at[kept] |= set(collapse.changed_facets)
        self.cells_at[gone], self.facets_at[gone] = set(), set()

    def build(self) -> VolumeMesh:
        """The mesh of what is left, with images exactly at their places."""
        periods = np.where(np.isnan(self.mesh.periods), 0.0, self.mesh.periods)
        made = replace(
            self.mesh,
            points=self.points[self.original] + self.periods_off * periods,
            cells={self.kind: self.cells[self.alive]},
            facets={self.facet_kind: self.facets[self.alive_facets]},
            cell_groups={name: _renumber(of, self.alive) for name, of in self.mesh.cell_groups.items()},
            facet_groups={name: _renumber(of, self.alive_facets) for name, of in self.mesh.facet_groups.items()},
        )
        return sort_nodes(made)


def _are_apart(collapses: list[_Collapse]) -> bool:
    """Whether no element is changed by two collapses."""
    every = [cell for each in collapses for cell in (*each.gone, *each.changed)]
    return len(every) == len(set(every))


def _list_uses(nodes: IntArray, count: int) -> list[set[int]]:
    """For each node the rows that have it."""
    found: list[set[int]] = [set() for _ in range(count)]
    for row, own in enumerate(nodes.tolist()):
        for node in own:
            found[node].add(row)
    return found


def _renumber(numbers: IntArray, alive: BoolArray) -> IntArray:
    """Numbers of those rows that are left, counted anew."""
    return np.asarray((np.cumsum(alive) - 1)[numbers[alive[numbers]]])
