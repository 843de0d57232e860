"""Edges inside, opposite to an edge on a face, split where their new middle node, moved inwards, makes flat elements better.

An element with two facets of one smooth face is flat at their common edge, however its nodes lie in the face: all edges that
meet there touch one plane. Its opposite edge is split, with all elements around, and the new node goes away from the face.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.meshing.editable_mesh import Change, EditableMesh
from tpmscad.meshing.element_shapes import TETRA_EDGES, add_middles

OPPOSITE = ((0, 5), (1, 3), (2, 4))
"""Pairs of edges of a tetrahedron without a common corner, in the order of `TETRA_EDGES`."""

STEPS = np.array([0.0, 0.1, 0.2, 0.35, 0.5, 0.7])
"""Of the element size: how far the new node goes."""

MOST_AROUND = 9
"""Elements around an edge that is split."""


def split_edge(mesh: EditableMesh, cell: int, size: float) -> int:
    """Split the edge of an element where this helps most; the number of edges split."""
    if not mesh.has_room():
        return 0
    corners = mesh.cells[cell, :4].tolist()
    edges = [(corners[i], corners[j]) for i, j in TETRA_EDGES]
    splits = []
    for pair in OPPOSITE:
        for on_face, inside in (pair, pair[::-1]):
            for place in _list_places(mesh, edges[on_face], edges[inside], size):
                if (change := _make_change(mesh, *edges[inside], place)) is not None:
                    splits.append(change)
    return mesh.make_best(splits)


def _list_places(mesh: EditableMesh, on_face: tuple[int, int], inside: tuple[int, int], size: float) -> Array:
    """Where the node that splits an edge inside may go (n, 3); none if its opposite edge is not between two facets."""
    if len(mesh.facets_at[on_face[0]] & mesh.facets_at[on_face[1]]) < 2:
        return np.zeros((0, 3))
    if mesh.facets_at[inside[0]] & mesh.facets_at[inside[1]]:
        return np.zeros((0, 3))
    start = mesh.points[list(inside)].mean(axis=0)
    away = start - mesh.points[list(on_face)].mean(axis=0)
    return np.asarray(start + size * STEPS[:, None] * away / max(float(np.linalg.norm(away)), 1e-300))


def _make_change(mesh: EditableMesh, a: int, b: int, place: Array) -> Change | None:
    """The elements around an edge as twice as many around a new node; None if they are too many."""
    cells = sorted(mesh.cells_at[a] & mesh.cells_at[b])
    if len(cells) > MOST_AROUND:
        return None
    new = mesh.n_points
    points: dict[int, Array] = {new: place}
    made: dict[frozenset[int], int] = {}

    def middle(i: int, j: int) -> int:
        if new not in (i, j):
            return mesh.middle(i, j)
        pair = frozenset((i, j))
        if pair not in made:
            made[pair] = new + 1 + len(made)
            points[made[pair]] = 0.5 * (place + mesh.points[i if j == new else j])
        return made[pair]

    rows = []
    for cell in cells:
        corners = mesh.cells[cell, :4].tolist()
        rows += [tuple(new if n == end else n for n in corners) for end in (a, b)]
    return Change(cells, add_middles(rows, middle, mesh.cells.shape[1]), [c for c in cells for _ in range(2)], points)
