"""Closed triangle meshes of OCCT solids, welded by topology.

OCCT triangulates each face for itself, on the common points of its edges. Nodes are identified along shared edges and at shared
vertices, never by distance, so that a mesh of a closed solid is closed whatever the size of its triangles. A degenerate edge (the
pole of a sphere) becomes one node, and the triangles that this collapses are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.TopLoc import TopLoc_Location
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tpmscad._typing import Array, IntArray
from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.child_process import may_use_threads
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    edges_of,
    faces_of,
    first_vertex,
    last_vertex,
    orientation_sign,
    solids_of,
    unwrap,
)

MAX_REFINEMENTS = 3
"""Attempts at half the deviation when OCCT leaves a face without triangles or a mesh open."""


MAX_SPLIT_PASSES = 20
"""Passes over chords that are split; each splits one chord of a triangle."""


@dataclass(frozen=True, slots=True, eq=False)
class SolidMesh:
    """A closed mesh: points (n, 3), triangles (m, 3) with outward normals, and the face of the solid of each triangle (m,).

    Faces are numbered in the order of `faces_of`.
    """

    points: Array
    triangles: IntArray
    face: IntArray

    @property
    def volume(self) -> float:
        """The volume enclosed, about the middle of the points to keep its digits."""
        a, b, c = ((self.points - self.points.mean(axis=0))[self.triangles[:, k]] for k in range(3))
        return float((a * np.cross(b, c)).sum() / 6.0)

    @property
    def area(self) -> float:
        """Area of the triangles."""
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def mesh_solids(shape: Any, deviation: float, angle: float) -> tuple[SolidMesh, ...]:
    """A closed mesh of each solid, its chords within `deviation` of faces and edges, its facets turned by `angle` (rad) at most.

    The triangulation that the shape may carry is neither used nor changed. Raises KernelError if OCCT cannot close a mesh.
    """
    topods = unwrap(shape)
    for halvings in range(MAX_REFINEMENTS + 1):
        copy = BRepBuilderAPI_Copy(topods, False, False).Shape()
        BRepMesh_IncrementalMesh(copy, deviation / 2**halvings, False, angle, may_use_threads())
        meshes = [_weld_solid(solid) for solid in solids_of(copy)]
        closed = tuple(mesh for mesh in meshes if mesh is not None and count_open_sides(mesh.triangles) == 0)
        if len(closed) == len(meshes) > 0:
            return closed
    raise KernelError("triangulate", f"no closed mesh within {deviation:g} of the faces: try another deviation", topods)


def count_open_sides(triangles: IntArray) -> int:
    """Number of sides of triangles (m, 3) that no other triangle runs through in the opposite direction exactly once."""
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    n = int(triangles.max(initial=0)) + 1
    along, against = np.sort(tail * n + head), np.sort(head * n + tail)
    if len(np.unique(along)) == len(along) and np.array_equal(along, against):
        return 0
    return max(1, len(np.setxor1d(along, against)), len(along) - len(np.unique(along)))


def _weld_solid(solid: Any) -> SolidMesh | None:
    """The mesh of a triangulated solid; None if a face has no triangles."""
    points, corners, owners = [], [], []
    same: list[tuple[Sequence[int], Sequence[int]]] = []
    of_edge: dict[ShapeKey, Sequence[int]] = {}
    of_vertex: dict[ShapeKey, int] = {}
    count = 0
    for number, face in enumerate(faces_of(solid)):
        location = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face, location)
        if mesh is None:
            return None
        for edge in edges_of(face):
            line = BRep_Tool.PolygonOnTriangulation_s(edge, mesh, location)
            if line is None:
                return None
            nodes = [count + line.Node(i) - 1 for i in range(1, line.NbNodes() + 1)]
            if BRep_Tool.Degenerated_s(edge):
                vertex = of_vertex.setdefault(ShapeKey(first_vertex(edge)), nodes[0])
                same.append((nodes, [vertex] * len(nodes)))
                continue
            first = of_edge.setdefault(ShapeKey(edge), nodes)
            if len(first) != len(nodes):
                return None
            same.append((first, nodes))
            for vertex, node in ((first_vertex(edge), nodes[0]), (last_vertex(edge), nodes[-1])):
                same.append(([of_vertex.setdefault(ShapeKey(vertex), node)], [node]))
        matrix = convert.matrix_from_occt(location.Transformation())
        local = np.array([mesh.Node(i).Coord() for i in range(1, mesh.NbNodes() + 1)])
        triples = np.array([mesh.Triangle(i).Get() for i in range(1, mesh.NbTriangles() + 1)]).reshape(-1, 3) - 1
        mirrored = np.linalg.det(matrix[:, :3]) < 0
        points.append(local @ matrix[:, :3].T + matrix[:, 3])
        corners.append((triples[:, ::-1] if (orientation_sign(face) < 0) != mirrored else triples) + count)
        owners.append(np.full(len(triples), number))
        count += len(local)
    one = np.concatenate([np.asarray(a) for a, _ in same])
    two = np.concatenate([np.asarray(b) for _, b in same])
    graph = coo_matrix((np.ones(len(one), bool), (one, two)), shape=(count, count))
    n, label = connected_components(graph, directed=False)
    welded = np.empty((n, 3))
    welded[label] = np.concatenate(points)
    triangles, owner = label.astype(np.int64)[np.concatenate(corners)], np.concatenate(owners)
    proper = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return _split_repeated_chords(SolidMesh(welded, triangles[proper], owner[proper]))


def _split_repeated_chords(mesh: SolidMesh) -> SolidMesh:
    """The mesh with every chord that more than two triangles share split at its middle, face by face but for one.

    Where two faces are close to tangent along their common edge, both may have a chord between the same two of its nodes. The
    surface of the mesh stays the same.
    """
    points, triangles, owner = mesh.points, mesh.triangles, mesh.face
    for _ in range(MAX_SPLIT_PASSES):
        ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
        _, chord, uses = np.unique(ends[:, 0] * len(points) + ends[:, 1], return_inverse=True, return_counts=True)
        repeated = np.flatnonzero(uses[chord] > 2)
        if len(repeated) == 0:
            break
        of_face: dict[tuple[int, int], list[int]] = {}
        for side in repeated.tolist():
            of_face.setdefault((int(chord[side]), int(owner[side // 3])), []).append(side)
        touched = set[int]()
        kept = {number for (number, _), sides in of_face.items() if len(sides) != 2}  # an edge between faces stays
        made: list[tuple[int, int, int]] = []
        makers: list[int] = []
        middles: list[Array] = []
        for (number, _), sides in of_face.items():
            members = {side // 3 for side in sides}
            if len(sides) != 2 or members & touched:
                kept.add(number)
                continue
            if number not in kept:
                kept.add(number)  # the first face keeps its chord
                continue
            touched |= members
            middle = len(points) + len(middles)
            middles.append(points[ends[sides[0]]].mean(axis=0))
            for side in sides:
                t, k = divmod(side, 3)
                a, b, c = (int(triangles[t, (k + i) % 3]) for i in range(3))
                made += [(a, middle, c), (middle, b, c)]
                makers += [int(owner[t])] * 2
        if not made:
            break
        rest = np.setdiff1d(np.arange(len(triangles)), list(touched))
        points = np.concatenate([points, middles])
        triangles = np.concatenate([triangles[rest], made])
        owner = np.concatenate([owner[rest], makers])
    return SolidMesh(points, triangles, owner)
