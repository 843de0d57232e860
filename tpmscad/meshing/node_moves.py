"""Corners of poor tetrahedra moved to where the worst element around them is best, on the faces and curves that they lie on."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tpmscad._typing import Array
from tpmscad.meshing.editable_mesh import CREASE_COSINE, Change, EditableMesh, carry_middles, unit_normal
from tpmscad.meshing.element_shapes import scaled_jacobians

FIRST_STEP, LAST_STEP = 0.2, 0.01
"""In element sizes: steps of the search, which are halved where none helps."""

MOST_STEPS = 12
"""Of one search: later passes go on with it."""

LEAST_MOVE_GAIN = 0.0002
"""Of the worst scaled Jacobian by a move."""

MOST_TRIED = 3
"""Of the moves at a step, those that are estimated to help most: their nodes are put on the faces, which takes longest."""

LEAST_COSINE = 0.85
"""Of the angle by which a facet may turn."""

DIRECTIONS = np.array([v for v in np.ndindex(3, 3, 3) if np.abs(np.array(v) - 1).sum() in (1, 3)], float) - 1.0
"""(14, 3): those of the axes and of the diagonals of a cube."""

IN_PLANE = np.array([(np.cos(t), np.sin(t)) for t in np.arange(6) * np.pi / 3])
"""(6, 2): those of a regular hexagon's corners."""


def move_node(mesh: EditableMesh, node: int, size: float, edge: tuple[int, int] | None = None) -> int:
    """Move a corner, or the middle of an edge between two, with its images; the number of nodes moved."""
    star = _Star(mesh, node, edge)
    if not star.is_apart:
        return 0
    first, facets = star.nodes[0], star.on_faces
    directions = _list_directions(mesh, {f for own in star.facets for f in own})
    moved, step, worst = 0, FIRST_STEP * size, mesh.quality_of(star.every_cell)
    for _ in range(MOST_STEPS if len(directions) else 0):
        estimates = star.estimate(step * directions)
        order = np.argsort(-estimates)[:MOST_TRIED]
        for direction in directions[order[estimates[order] > worst + LEAST_MOVE_GAIN]]:
            changes = star.move(mesh.project_on(facets, mesh.points[first] + step * direction))
            found = mesh.worst_after(changes, worst + LEAST_MOVE_GAIN)
            if found is not None and not any(_turns(mesh, each) for each in changes):
                for each in changes:
                    mesh.apply(each)
                worst, moved = found, len(star.nodes)
                break
        else:
            step *= 0.5
            if step < LAST_STEP * size:
                break
    return moved


class _Star:
    """The elements and facets at a node and at each of its images, and the edges between corners that end there."""

    def __init__(self, mesh: EditableMesh, node: int, edge: tuple[int, int] | None) -> None:
        self.mesh = mesh
        self.nodes = mesh.images_of(node)
        ends: list[tuple[int, ...]] = [(n,) for n in self.nodes]
        if edge is not None:
            images = [(a, b) for a in mesh.images_of(edge[0]) for b in mesh.images_of(edge[1])]
            of_middle = {mesh.middle(a, b): (a, b) for a, b in images if mesh.cells_at[a] & mesh.cells_at[b]}
            ends = [of_middle[n] for n in self.nodes]
        self.cells = [sorted(set[int].intersection(*(mesh.cells_at[n] for n in own))) for own in ends]
        self.facets = [sorted(set[int].intersection(*(mesh.facets_at[n] for n in own))) for own in ends]
        self.every_cell = [c for own in self.cells for c in own]
        first = ends[0]
        self.on_faces = set(self.facets[0]) if len(first) == 1 else mesh.facets_near(*first)
        self.is_apart = len(set(self.every_cell)) == len(self.every_cell)
        self.middles = [
            [(other, mesh.middle(n, other), mesh.facets_near(n, other)) for other in mesh.neighbours(n)]
            for n in (self.nodes if mesh.is_curved and edge is None else ())
        ]
        self.used, rows = np.unique(mesh.cells[self.every_cell], return_inverse=True)
        self.rows = rows.reshape(len(self.every_cell), -1)
        spokes = [
            (n, other, middle) for n, own in zip(self.nodes, self.middles, strict=False) for other, middle, _ in own
        ]
        self.spokes = np.array(spokes, np.int64).reshape(-1, 3)

    def estimate(self, moves: Array) -> Array:
        """The worst scaled Jacobian (k,) after each of k moves, with no node put back on its faces."""
        mesh, near = self.mesh, self.mesh.points
        points = np.repeat(near[self.used][None], len(moves), axis=0)
        points[:, np.searchsorted(self.used, self.nodes)] += moves[:, None]
        if len(self.spokes):
            start, other, middle = near[self.spokes.T]
            places = carry_middles(other, start, start + moves[:, None], middle)
            points[:, np.searchsorted(self.used, self.spokes[:, 2])] = places
        rows = self.rows + len(self.used) * np.arange(len(moves))[:, None, None]
        found = scaled_jacobians(mesh.kind, points.reshape(-1, 3), rows.reshape(-1, self.rows.shape[1]))
        return np.asarray(found.reshape(len(moves), -1).min(axis=1))

    def move(self, place: Array) -> list[Change]:
        """The change at each of the corners if the first goes to a place."""
        mesh, found = self.mesh, []
        places: dict[int, Array] = {}
        for k, (node, cells) in enumerate(zip(self.nodes, self.cells, strict=True)):
            end = place + (mesh.periods_off[node] - mesh.periods_off[self.nodes[0]]) * mesh.periods
            own = {node: end}
            for other, middle, facets in self.middles[k] if self.middles else ():
                first = places.get(int(mesh.original[middle]))
                if first is None:
                    own[middle] = mesh.place_middle(other, mesh.points[node], end, middle, facets)
                    places[middle] = own[middle]
                else:
                    own[middle] = first + mesh.periods_off[middle] * mesh.periods
            found.append(Change(cells, mesh.cells[cells], cells, own))
        return found


def _list_directions(mesh: EditableMesh, facets: Iterable[int]) -> Array:
    """Unit vectors (n, 3) along which a node on facets may go: within all their faces; none at a corner."""
    normals: dict[int, list[Array]] = {}
    for facet in facets:
        normals.setdefault(mesh.label_of(facet), []).append(mesh.normal(facet))
    directions = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1)[:, None]
    across = np.zeros((0, 3))
    for of_label in normals.values():
        mean = np.sum(of_label, axis=0)
        mean /= max(float(np.linalg.norm(mean)), 1e-300)
        if (np.array(of_label) @ mean).min() < CREASE_COSINE:
            return np.zeros((0, 3))
        across = np.vstack([across, mean])
    if len(across):
        _, values, rows = np.linalg.svd(across)
        free = rows[int((values > 0.1).sum()) :]
        if len(free) == 0:
            return np.zeros((0, 3))
        if len(free) == 1:
            return np.vstack([free, -free])
        return np.asarray(IN_PLANE @ free)
    return np.asarray(directions)


def _turns(mesh: EditableMesh, change: Change) -> bool:
    """Whether a facet around a node that moves turns too far."""
    corners = {n for n in change.points if mesh.facets_at[n]}
    facets = {f for n in corners for f in mesh.facets_at[n]}
    for facet in facets:
        after = np.array([change.points.get(n, mesh.points[n]) for n in mesh.facets[facet, :3].tolist()])
        if not mesh.normal(facet) @ unit_normal(after) > LEAST_COSINE:
            return True
    return False
