"""Corners of poor tetrahedra moved to where the worst element around them is best, on the faces and curves that they lie on."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.meshing.editable_mesh import CREASE_COSINE, Change, EditableMesh, unit_normal
from tpmscad.meshing.element_shapes import scaled_jacobians

FIRST_STEP, LAST_STEP = 0.2, 0.01
"""In element sizes: steps of the search, which are halved where none helps."""

LEAST_GAIN = 0.01
"""In parts of the worst scaled Jacobian: less is no reason for another step as long."""

LEAST_COSINE = 0.85
"""Of the angle by which a facet may turn."""

DIRECTIONS = np.array([v for v in np.ndindex(3, 3, 3) if np.abs(np.array(v) - 1).sum() in (1, 3)], float) - 1.0
"""(14, 3): those of the axes and of the diagonals of a cube."""


def move_node(mesh: EditableMesh, node: int, size: float) -> int:
    """Move a corner with its images; the number of nodes moved."""
    star = _Star(mesh, int(mesh.original[node]))
    directions = _list_directions(mesh, star.nodes)
    if not star.is_apart or not len(directions):
        return 0
    moved, step, worst = 0, FIRST_STEP * size, star.worst()
    while step >= LAST_STEP * size:
        start = mesh.points[star.nodes[0]]
        tried = []
        for direction in directions:
            changes = star.move(mesh.project_on(mesh.facets_at[star.nodes[0]], start + step * direction))
            tried.append((mesh.worst_after(changes), changes))
        best, changes = max(tried, key=lambda each: each[0])
        if best > LEAST_GAIN * abs(worst) + worst and not any(_turns(mesh, each) for each in changes):
            for each in changes:
                mesh.apply(each)
            worst, moved = best, len(star.nodes)
        else:
            step *= 0.5
    return moved


class _Star:
    """The elements at a corner and at each of its images, and the edges between corners that end there."""

    def __init__(self, mesh: EditableMesh, node: int) -> None:
        self.mesh, self.nodes = mesh, mesh.images_of(node)
        self.cells = [sorted(mesh.cells_at[n]) for n in self.nodes]
        self.is_apart = len({c for own in self.cells for c in own}) == sum(map(len, self.cells))
        self.middles = [
            [(other, mesh.middle(n, other), mesh.facets_at[n] & mesh.facets_at[other]) for other in mesh.neighbours(n)]
            for n in (self.nodes if mesh.is_curved else ())
        ]

    def worst(self) -> float:
        """The worst scaled Jacobian as it is."""
        mesh = self.mesh
        return float(scaled_jacobians(mesh.kind, mesh.points, mesh.cells[[c for own in self.cells for c in own]]).min())

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


def _list_directions(mesh: EditableMesh, nodes: list[int]) -> Array:
    """Unit vectors (n, 3) along which a node and its images may go: within all faces that they lie on; none at a corner."""
    normals: dict[int, list[Array]] = {}
    for facet in (f for node in nodes for f in mesh.facets_at[node]):
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
        directions = directions @ free.T @ free
        lengths = np.linalg.norm(directions, axis=1)
        directions = directions[lengths > 0.3] / lengths[lengths > 0.3, None]
        if len(free) == 1:
            return np.vstack([free, -free])
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
