"""Closed triangle meshes of files: STL, OBJ, PLY and 3MF, and of `trimesh` objects.

A mesh is closed if the directions of the triangles cancel at every edge; the winding number of a point is then defined, and
triangles may meet at an edge in any even number. Solid is where the winding number is positive, and the mesh is made the boundary
of that (`mesh_shells`). Small holes are closed by a fan of triangles round their centre; whatever was changed is told in a note.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.fields.data.mesh_files import read_mesh_file
from tpmscad.fields.data.mesh_shells import list_half_edges, list_open_edges, unite_shells
from tpmscad.file_suffixes import READ_TRIANGLE_SUFFIXES, list_suffixes

WELD_FRACTION = 1e-6
"""Of the largest extent: distance up to which vertices are one, if the mesh is open without; STL files round to 6e-8 of it."""

MAX_HOLE_FRACTION = 0.05
"""Of the largest extent: size of a hole that is closed."""


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """A mesh: vertices (k, 3), triangles (m, 3), outward where it is closed, its name in messages, and what was changed."""

    vertices: Array
    triangles: IntArray
    name: str = "the mesh"
    notes: tuple[str, ...] = field(default=(), compare=False)

    @property
    def corners(self) -> Array:
        """Corners (m, 3, 3) of the triangles."""
        return self.vertices[self.triangles]

    @property
    def volume(self) -> float:
        """The volume enclosed; of triangles as they are read, parts that overlap count twice."""
        a, b, c = np.moveaxis(self.corners - self.vertices.mean(axis=0), 1, 0)
        return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0)

    @property
    def euler_characteristic(self) -> int:
        """Of the surface: vertices - edges + triangles."""
        edges = np.unique(np.sort(list_half_edges(self.triangles), axis=1), axis=0)
        return len(np.unique(self.triangles)) - len(edges) + len(self.triangles)


def is_mesh_path(source: Any) -> bool:
    """Whether a source is the path of a triangle mesh, by its suffix."""
    return isinstance(source, str | os.PathLike) and Path(source).suffix.lower() in READ_TRIANGLE_SUFFIXES


def is_mesh_object(source: Any) -> bool:
    """Whether a source holds arrays of vertices and faces, as meshes of trimesh and others do."""
    arrays = getattr(source, "vertices", None), getattr(source, "faces", None)
    return all(array is not None and not callable(array) and np.shape(array)[1:] == (3,) for array in arrays)


def read_triangles(file: Path) -> TriangleMesh:
    """The triangles of a file as they are, closed or not, with vertices at one place made one, in millimetres.

    InvalidRequest if the file is missing, unreadable or empty. A note tells how many triangles are left out as they have no area.
    """
    name, vertices, triangles, notes = read_mesh_file(file)
    _require_triangles(name, vertices, triangles)
    vertices, joined = _weld(vertices, triangles, 0.0)
    if lost := len(triangles) - len(joined):
        notes = (
            *notes,
            f"{name}: {lost} of {len(triangles)} triangles have two corners at one place and were left out",
        )
    if not len(joined):
        raise InvalidRequest(f"{name} holds no triangle with three corners")
    return TriangleMesh(vertices, joined, name, notes)


def read_triangle_mesh(source: Any) -> TriangleMesh:
    """The closed mesh of a file, or of an object with arrays `vertices` and `faces`.

    InvalidRequest if the file is missing or unreadable, or the mesh is open; it names the number of open edges and a place.
    """
    if is_mesh_object(source):
        name, vertices, triangles, notes = "the mesh", source.vertices, source.faces, ()
    elif isinstance(source, str | os.PathLike):
        name, vertices, triangles, notes = read_mesh_file(Path(source))
    else:
        raise InvalidRequest(
            f"{type(source).__name__} is no mesh: give the path of a file, "
            f"{list_suffixes(READ_TRIANGLE_SUFFIXES)}, or an object with arrays "
            "`vertices` (k, 3) and `faces` (m, 3)"
        )
    return close_mesh(name, np.asarray(vertices, float), np.asarray(triangles, np.int64), notes)


def close_mesh(name: str, vertices: Array, triangles: IntArray, notes: tuple[str, ...] = ()) -> TriangleMesh:
    """The closed mesh of triangles (m, 3) between vertices (k, 3); InvalidRequest if it cannot be closed."""
    _require_triangles(name, vertices, triangles)
    extent = float(np.ptp(vertices[triangles].reshape(-1, 3), axis=0).max())
    made = TriangleMesh(*_weld(vertices, triangles, 0.0), name, notes)
    if len(list_open_edges(made.triangles)):
        vertices, triangles = _weld(made.vertices, made.triangles, WELD_FRACTION * extent)
        if not len(list_open_edges(triangles)):
            note = f"{name}: vertices nearer than {WELD_FRACTION * extent:.2g} were made one"
            made = TriangleMesh(vertices, triangles, name, (*notes, note))
        made = _orient(made)
        made = _fill_holes(made, extent)
    if made.volume < 0:
        made = replace(
            made,
            triangles=made.triangles[:, ::-1],
            notes=(*made.notes, f"{name} was inside out: its triangles were reversed"),
        )
    if not abs(made.volume) > 0:
        raise InvalidRequest(f"{name} encloses no volume: a body is a closed mesh")
    vertices, triangles, told = unite_shells(name, made.vertices, made.triangles)
    return replace(made, vertices=vertices, triangles=triangles, notes=(*made.notes, *told))


def _require_triangles(name: str, vertices: Array, triangles: IntArray) -> None:
    """InvalidRequest unless there are triangles between vertices that exist and are finite."""
    if not len(triangles):
        raise InvalidRequest(f"{name} holds no triangles")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InvalidRequest(
            f"{name}: a triangle has the vertex {triangles.max()} of {len(vertices)}, numbered from 0; save the mesh again"
        )
    if not np.isfinite(vertices[triangles]).all():
        raise InvalidRequest(f"{name} has vertices that are not finite: save the mesh again")


def _weld(vertices: Array, triangles: IntArray, radius: float) -> tuple[Array, IntArray]:
    """The mesh with vertices within a radius made one, without triangles that have become edges."""
    if radius > 0:
        pairs = cKDTree(vertices).query_pairs(radius, output_type="ndarray")
        links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(vertices),) * 2)
        label = connected_components(links, directed=False)[1]
        _, first, number = np.unique(label, return_index=True, return_inverse=True)
    else:
        _, first, number = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    joined = number.ravel()[triangles]
    kept = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
    used, joined = np.unique(joined[kept], return_inverse=True)
    return vertices[first[used]], joined.reshape(-1, 3)


def _orient(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with neighbours in the same direction, where edges join two triangles; told if some were reversed."""
    triangles = mesh.triangles
    half = list_half_edges(triangles)
    owner = np.tile(np.arange(len(triangles)), 3)
    _, which, count = np.unique(np.sort(half, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.ravel(), kind="stable")
    pairs = order[np.repeat(count == 2, count)].reshape(-1, 2)
    against = (half[pairs[:, 0]] == half[pairs[:, 1]]).all(axis=1)
    if not against.any():
        return mesh
    # two nodes for each triangle, as it is and reversed: neighbours are linked as they agree
    one, other = owner[pairs].T
    m = len(triangles)
    rows = np.concatenate([one, one + m])
    columns = np.concatenate([np.where(against, other + m, other), np.where(against, other, other + m)])
    label = connected_components(coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * m, 2 * m)))[1]
    if (label[:m] == label[m:]).any():
        return mesh  # one-sided: the open edges that remain are told
    reverse = label[:m] > label[m:]
    parts = np.minimum(label[:m], label[m:])
    n_parts = int(parts.max()) + 1
    minority = np.bincount(parts, reverse, n_parts) * 2 > np.bincount(parts, minlength=n_parts)
    reverse ^= minority[parts]
    fixed = np.where(reverse[:, None], triangles[:, ::-1], triangles)
    note = f"{mesh.name}: {int(reverse.sum())} of {m} triangles faced the wrong way and were reversed"
    return replace(mesh, triangles=fixed, notes=(*mesh.notes, note))


def _fill_holes(mesh: TriangleMesh, extent: float) -> TriangleMesh:
    """The mesh with its small holes closed; InvalidRequest if larger ones remain."""
    edges = list_open_edges(mesh.triangles)
    if not len(edges):
        return mesh
    n = len(mesh.vertices)
    label = connected_components(coo_array((np.ones(len(edges)), tuple(edges.T)), shape=(n, n)), directed=False)[1]
    vertices, triangles = [mesh.vertices], [mesh.triangles]
    filled: list[tuple[float, Array]] = []
    left: list[IntArray] = []
    for part in np.unique(label[edges[:, 0]]).tolist():
        own = edges[label[edges[:, 0]] == part]
        rim = mesh.vertices[own[:, 0]]
        size = float(np.ptp(rim, axis=0).max())
        simple = len(np.unique(own[:, 0])) == len(own) == len(np.unique(own[:, 1]))
        if not simple or size > MAX_HOLE_FRACTION * extent:
            left.append(own)
            continue
        triangles.append(np.column_stack([own[:, ::-1], np.full(len(own), n + len(filled))]))
        vertices.append(rim.mean(axis=0)[None])
        filled.append((size, rim.mean(axis=0)))
    if left:
        count, first = sum(map(len, left)), mesh.vertices[left[0][0, 0]]
        size = max(float(np.ptp(mesh.vertices[own[:, 0]], axis=0).max()) for own in left)
        raise InvalidRequest(
            f"{mesh.name} is open: {count} edges bound one triangle only, the first near {format_point(first, 5)}, in "
            f"{len(left)} hole{'s' if len(left) > 1 else ''} up to {size:.3g} wide; holes up to {MAX_HOLE_FRACTION * extent:.3g} "
            "are closed, a twentieth of its size: close the others in the program that made it"
        )
    size, at = max(filled, key=lambda hole: hole[0])
    one = len(filled) == 1
    note = (
        f"{mesh.name}: {len(filled)} hole{'' if one else 's'} closed, {'' if one else 'the largest '}{size:.3g} wide near "
        f"{format_point(at, 5)}"
    )
    return replace(
        mesh, vertices=np.concatenate(vertices), triangles=np.concatenate(triangles), notes=(*mesh.notes, note)
    )
