"""Elements around an edge or at both sides of a face put together anew, where that makes the worst of them better.

An edge inside is removed with the elements around it: the ring of corners opposite it is divided into triangles, and each of
these joined to both ends of the edge. An edge between two facets of one smooth face is flipped with them; where one element lies
between both, it goes. Two elements with a common face become three around a new edge.

Source: Freitag and Ollivier-Gooch, Tetrahedral mesh improvement using swapping and smoothing, Int. J. Numer. Meth. Engng 40
(1997) 3979.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from tpmscad._typing import Array
from tpmscad.meshing.editable_mesh import Change, EditableMesh, unit_normal
from tpmscad.meshing.element_shapes import TETRA_EDGES, TETRA_FACES, add_middles

MOST_AROUND = 7
"""Corners around an edge that is removed: 42 divisions into triangles."""

LEAST_COSINE, LEAST_COSINE_ON_FACE = 0.85, 0.3
"""Of the angle between facets of the same groups whose common edge is flipped, and by which they may turn: where they are of
different faces, and of one, which has no creases."""


def swap_around(mesh: EditableMesh, cell: int) -> int:
    """Make the best of the swaps at an element's edges and faces that help; the number of swaps."""
    corners = mesh.cells[cell, :4].tolist()
    if not mesh.has_room():
        return 0
    swaps = [change for i, j in TETRA_EDGES for change in _removals_of_edge(mesh, corners[i], corners[j])]
    for face in TETRA_FACES:
        if (change := _remove_face(mesh, cell, {corners[i] for i in face})) is not None:
            swaps.append(change)
    return mesh.make_best(swaps)


@functools.cache
def _divisions(n: int) -> tuple[tuple[tuple[int, int, int], ...], ...]:
    """All divisions of a polygon with n corners into triangles by its diagonals."""

    def divide(i: int, j: int) -> list[tuple[tuple[int, int, int], ...]]:
        if j - i < 2:
            return [()]
        return [(*one, *two, (i, k, j)) for k in range(i + 1, j) for one in divide(i, k) for two in divide(k, j)]

    return tuple(divide(0, n - 1))


def _removals_of_edge(mesh: EditableMesh, a: int, b: int) -> list[Change]:
    """The ways to remove an edge with the elements around it; none if it cannot go."""
    cells = sorted(mesh.cells_at[a] & mesh.cells_at[b])
    facets = sorted(mesh.facets_at[a] & mesh.facets_at[b])
    if len(cells) > MOST_AROUND or len(facets) not in (0, 2):
        return []
    after = {}
    for cell in cells:
        x, y = (n for n in mesh.cells[cell, :4].tolist() if n not in (a, b))
        if _volume(mesh, a, b, x, y) < 0:
            x, y = y, x
        after[x] = y, cell
    if len(after) < len(cells):
        return []
    ends = [next(n for n in mesh.facets[f, :3].tolist() if n not in (a, b)) for f in facets]
    flip: tuple[int, int] | None = None
    if facets:
        if not _may_flip(mesh, a, b, facets, ends):
            return []
        flip = ends[0], ends[1]
        paths = [path for start in ends if (path := _follow(after, start, set(ends)))]
        if sum(len(path) - 1 for path in paths) < len(cells):
            return []
    else:
        start = min(after)
        path = _follow(after, start, {start})
        if len(path) - 1 < len(cells):
            return []
        paths = [path[:-1]]
    options: list[list[tuple[tuple[int, ...], int]]] = [[]]
    for path in paths:
        like = after[path[0]][1]
        if any(mesh.region_of(after[n][1]) != mesh.region_of(like) for n in path[:-1]):
            return []
        grown = []
        for division in _divisions(len(path)) if len(path) > 2 else ((),):
            rows = []
            for i, k, j in division:
                x, y, z = path[i], path[k], path[j]
                rows += [((x, y, z, b), like), ((x, z, y, a), like)]
            grown += [[*each, *rows] for each in options]
        options = grown
    middles: dict[frozenset[int], int] = {}
    found = (_make_change(mesh, cells, rows, middles, facets, (a, b), flip) for rows in options)
    return [change for change in found if change is not None]


def _follow(after: dict[int, tuple[int, int]], start: int, stops: set[int]) -> list[int]:
    """Corners from one to the first that is a stop; empty if there is no way."""
    path = [start]
    while path[-1] in after and len(path) <= len(after):
        path.append(after[path[-1]][0])
        if path[-1] in stops:
            return path
    return []


def _may_flip(mesh: EditableMesh, a: int, b: int, facets: list[int], ends: list[int]) -> bool:
    """Whether two facets are one smooth quadrilateral whose other diagonal is no edge of a facet, and which has no image."""
    normals = [mesh.normal(f) for f in facets]
    has_image = len(mesh.images_of(a)) > 1 and len(mesh.images_of(b)) > 1
    return not (
        has_image
        or ends[0] == ends[1]
        or mesh.label_of(facets[0]) != mesh.label_of(facets[1])
        or _along(mesh, facets[0], a, b) == _along(mesh, facets[1], a, b)
        or normals[0] @ normals[1] < _least_cosine(mesh, facets)
        or mesh.facets_at[ends[0]] & mesh.facets_at[ends[1]]
    )


def _least_cosine(mesh: EditableMesh, facets: list[int]) -> float:
    """Of the angle between two facets of the same groups that belong to one smooth surface."""
    on_face = mesh.faces_of_facets is not None and mesh.faces[facets[0]] & mesh.faces[facets[1]]
    return LEAST_COSINE_ON_FACE if on_face else LEAST_COSINE


def _along(mesh: EditableMesh, facet: int, a: int, b: int) -> bool:
    """Whether a facet runs from one of its corners to the other."""
    corners = mesh.facets[facet, :3].tolist()
    return bool((corners.index(b) - corners.index(a)) % 3 == 1)


def _remove_face(mesh: EditableMesh, cell: int, face: set[int]) -> Change | None:
    """The two elements at a face as three around a new edge; None if there is no such edge."""
    x, y, z = face
    both = sorted(mesh.cells_at[x] & mesh.cells_at[y] & mesh.cells_at[z])
    if len(both) != 2 or mesh.facets_at[x] & mesh.facets_at[y] & mesh.facets_at[z]:
        return None
    if mesh.region_of(both[0]) != mesh.region_of(both[1]):
        return None
    a, b = (next(n for n in mesh.cells[c, :4].tolist() if n not in face) for c in both)
    if mesh.cells_at[a] & mesh.cells_at[b]:
        return None
    if _volume(mesh, x, y, z, b) < 0:
        y, z = z, y
    rows = [((a, b, *pair), cell) for pair in ((x, y), (y, z), (z, x))]
    return _make_change(mesh, both, rows, {}, [], (a, b), None)


def _make_change(
    mesh: EditableMesh,
    cells: list[int],
    rows: Sequence[tuple[tuple[int, ...], int]],
    middles: dict[frozenset[int], int],
    facets: list[int],
    edge: tuple[int, int],
    flip: tuple[int, int] | None,
) -> Change | None:
    """The change from elements to others, and from two facets at an edge to those at another; None if one were there twice.

    `middles`: nodes in the middle of edges that are there, which the changes around one edge have in common; it grows.
    """
    a, b = edge
    points: dict[int, Array] = {}
    made: dict[frozenset[int], int] = {}

    def middle(i: int, j: int) -> int:
        pair = frozenset((i, j))
        if pair not in middles and mesh.cells_at[i] & mesh.cells_at[j]:
            middles[pair] = mesh.middle(i, j)
        if pair in middles:
            return middles[pair]
        if pair not in made:
            made[pair] = mesh.n_points + len(made)
            place = 0.5 * (mesh.points[i] + mesh.points[j])
            points[made[pair]] = mesh.project_on(facets, place) if flip and pair == frozenset(flip) else place
        return made[pair]

    inside = {frozenset(p) for cell in cells for p in _pairs(mesh.cells[cell, :4].tolist())}
    new = {frozenset(p) for row, _ in rows for p in _pairs(list(row))} - inside
    if any(mesh.cells_at[i] & mesh.cells_at[j] for i, j in map(tuple, new)):
        return None
    new_facets: list[tuple[int, ...]] = []
    around: list[int] = []
    if flip is not None:
        for facet, other, drop in zip(facets, flip[::-1], (b, a), strict=True):
            new_facets.append(tuple(other if n == drop else n for n in mesh.facets[facet, :3].tolist()))
        normals = [mesh.normal(f) for f in facets]
        least = _least_cosine(mesh, facets)
        if any(unit_normal(mesh.points[list(row)]) @ n < least for row in new_facets for n in normals):
            return None
        if (
            mesh.is_curved and frozenset(flip) in inside
        ):  # an edge inside comes to lie on the face, and so does its middle
            at = mesh.middle(*flip)
            points[at] = mesh.project_on(facets, 0.5 * (mesh.points[flip[0]] + mesh.points[flip[1]]))
            around = sorted((mesh.cells_at[flip[0]] & mesh.cells_at[flip[1]]) - set(cells))
    found = add_middles([row for row, _ in rows], middle, mesh.cells.shape[1])
    return Change(
        [*cells, *around],
        np.concatenate([found, mesh.cells[around]]),
        [*(like for _, like in rows), *around],
        points,
        facets,
        add_middles(new_facets, middle, mesh.facets.shape[1]),
        facets,
    )


def _pairs(corners: list[int]) -> list[tuple[int, int]]:
    return [(corners[i], corners[j]) for i, j in TETRA_EDGES]


def _volume(mesh: EditableMesh, a: int, b: int, c: int, d: int) -> float:
    """Six times the signed volume of a tetrahedron."""
    p = mesh.points
    return float(np.linalg.det(np.stack([p[b] - p[a], p[c] - p[a], p[d] - p[a]])))
