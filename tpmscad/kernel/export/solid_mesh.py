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
from OCP.BRepTools import BRepTools
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array, IntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.triangles.closed_mesh import SolidMesh
from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.child_process import may_use_threads
from tpmscad.kernel.occt.construction import make_compound
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
class EdgeSegments:
    """Chords between neighbouring nodes of edges: number of the edge (s,), both nodes (s, 2), their curve parameters (s, 2)."""

    edge: IntArray
    nodes: IntArray
    parameters: Array


@dataclass(frozen=True, slots=True, eq=False)
class ParametricMesh:
    """A closed mesh of a solid that knows where its corners lie on faces and edges.

    mesh: also with triangles that a degenerate edge collapses to a line in space. faces: of the solid, in the order in which the
    mesh numbers them. nodes: of the corners as each face numbers its own, before they are welded, (m, 3). uv: parameters of the
    corners on the face, (m, 3, 2). segment: of each side of a triangle, from corner k to k + 1, the number of the edge segment
    that it is, or -1 inside a face, (m, 3). edges: all but degenerate ones.
    """

    mesh: SolidMesh
    faces: tuple[TopoDS_Face, ...]
    nodes: IntArray
    uv: Array
    segment: IntArray
    edges: tuple[TopoDS_Edge, ...]
    segments: EdgeSegments


def mesh_solids(shape: Any, deviation: float, angle: float) -> tuple[SolidMesh, ...]:
    """A closed mesh of each solid, its chords within `deviation` of faces and edges, its facets turned by `angle` (rad) at most.

    The triangulation that the shape may carry is neither used nor changed. Raises KernelError if OCCT cannot close a mesh.
    """
    return tuple(closed for _, closed in _mesh_closed(shape, deviation, angle))


def mesh_parametrically(shape: Any, deviation: float, angle: float) -> tuple[ParametricMesh, ...]:
    """As `mesh_solids`, with parameters on faces and edges."""
    return tuple(parametric for parametric, _ in _mesh_closed(shape, deviation, angle))


def mesh_faces(faces: Sequence[TopoDS_Face], deviation: float, angle: float) -> list[ParametricMesh]:
    """A mesh of each face by itself, which is open at the edges of the face only.

    The faces keep the triangulation. Raises KernelError if OCCT leaves a face without triangles or with a gap.
    """
    due, found = list(enumerate(faces)), dict[int, ParametricMesh]()
    for halvings in range(MAX_REFINEMENTS + 1):
        shapes = make_compound([face for _, face in due])
        BRepTools.Clean_s(shapes)
        BRepMesh_IncrementalMesh(shapes, deviation / 2**halvings, False, angle, may_use_threads())
        for number, face in due:
            mesh = _weld_solid(face)
            if mesh is not None and _covers_its_face(mesh):
                found[number] = mesh
        due = [(number, face) for number, face in due if number not in found]
        if not due:
            return [found[number] for number in range(len(faces))]
    raise KernelError("triangulate", f"no mesh of a face within {deviation:g}: try another deviation", due[0][1])


def _covers_its_face(mesh: ParametricMesh) -> bool:
    """Whether every side inside the face has a triangle on either side, and every edge segment one."""
    inside, n = mesh.segment < 0, int(mesh.nodes.max(initial=0)) + 1
    tail, head = mesh.nodes, np.roll(mesh.nodes, -1, axis=1)
    along, against = (np.sort((a * n + b)[inside]) for a, b in ((tail, head), (head, tail)))
    used = np.bincount(mesh.segment[~inside], minlength=len(mesh.segments.edge))
    return np.array_equal(along, against) and bool((used == 1).all())


def _mesh_closed(shape: Any, deviation: float, angle: float) -> list[tuple[ParametricMesh, SolidMesh]]:
    """Of each solid the mesh as OCCT made it, and the closed one without collapsed triangles and repeated chords."""
    topods = unwrap(shape)
    for halvings in range(MAX_REFINEMENTS + 1):
        copy = BRepBuilderAPI_Copy(topods, False, False).Shape()
        BRepMesh_IncrementalMesh(copy, deviation / 2**halvings, False, angle, may_use_threads())
        meshes = [_weld_solid(solid) for solid in solids_of(copy)]
        pairs = [(mesh, _drop_collapsed(mesh.mesh)) for mesh in meshes if mesh is not None]
        if len(pairs) == len(meshes) > 0 and not any(count_open_sides(closed.triangles) for _, closed in pairs):
            return pairs
    raise KernelError("triangulate", f"no closed mesh within {deviation:g} of the faces: try another deviation", topods)


def count_open_sides(triangles: IntArray) -> int:
    """Number of sides of triangles (m, 3) that no other triangle runs through in the opposite direction exactly once."""
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    n = int(triangles.max(initial=0)) + 1
    along, against = np.sort(tail * n + head), np.sort(head * n + tail)
    if len(np.unique(along)) == len(along) and np.array_equal(along, against):
        return 0
    return max(1, len(np.setxor1d(along, against)), len(along) - len(np.unique(along)))


def _weld_solid(solid: Any) -> ParametricMesh | None:
    """The mesh of a triangulated solid; None if a face has no triangles."""
    points, corners, owners, parameters, segments = [], [], [], [], []
    lines: list[tuple[TopoDS_Edge, list[int], list[float]]] = []
    faces = tuple(faces_of(solid))
    same: list[tuple[Sequence[int], Sequence[int]]] = []
    of_edge: dict[ShapeKey, tuple[Sequence[int], int]] = {}
    of_vertex: dict[ShapeKey, int] = {}
    count, n_segments = 0, 0
    for number, face in enumerate(faces):
        location = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face, location)
        if mesh is None:
            return None
        ends: list[IntArray] = []
        numbers: list[IntArray] = []
        for edge in edges_of(face):
            line = BRep_Tool.PolygonOnTriangulation_s(edge, mesh, location)
            if line is None:
                return None
            own = [count + line.Node(i) - 1 for i in range(1, line.NbNodes() + 1)]
            if BRep_Tool.Degenerated_s(edge):
                vertex = of_vertex.setdefault(ShapeKey(first_vertex(edge)), own[0])
                same.append((own, [vertex] * len(own)))
                continue
            if ShapeKey(edge) not in of_edge:
                at = line.Parameters()
                lines.append((edge, own, [at.Value(i) for i in range(1, line.NbNodes() + 1)]))
                of_edge[ShapeKey(edge)] = own, n_segments
                n_segments += len(own) - 1
            first, start = of_edge[ShapeKey(edge)]
            if len(first) != len(own):
                return None
            same.append((first, own))
            ends.append(np.sort(np.stack([own[:-1], own[1:]], axis=1), axis=1) - count)
            numbers.append(start + np.arange(len(own) - 1, dtype=np.int64))
            for vertex, node in ((first_vertex(edge), own[0]), (last_vertex(edge), own[-1])):
                same.append(([of_vertex.setdefault(ShapeKey(vertex), node)], [node]))
        matrix = convert.matrix_from_occt(location.Transformation())
        local = np.array([mesh.Node(i).Coord() for i in range(1, mesh.NbNodes() + 1)])
        on_face = np.array([mesh.UVNode(i).Coord() for i in range(1, mesh.NbNodes() + 1)])
        triples = np.array([mesh.Triangle(i).Get() for i in range(1, mesh.NbTriangles() + 1)]).reshape(-1, 3) - 1
        mirrored = np.linalg.det(matrix[:, :3]) < 0
        outward = triples[:, ::-1] if (orientation_sign(face) < 0) != mirrored else triples
        points.append(local @ matrix[:, :3].T + matrix[:, 3])
        corners.append(outward + count)
        parameters.append(on_face[outward])
        segments.append(_find_segments(outward, np.concatenate(ends), np.concatenate(numbers), len(local)))
        owners.append(np.full(len(triples), number))
        count += len(local)
    label = label_linked(count, np.concatenate([np.column_stack(pairs) for pairs in same]))
    welded = np.empty((1 + int(label.max()), 3))
    welded[label] = np.concatenate(points)
    sizes = [len(nodes) - 1 for _, nodes, _ in lines]
    side_ends, at = (
        np.concatenate([np.stack([values[:-1], values[1:]], axis=1) for values in rows])
        for rows in ([label[nodes] for _, nodes, _ in lines], [np.array(along) for _, _, along in lines])
    )
    nodes = np.concatenate(corners)
    return ParametricMesh(
        SolidMesh(welded, label[nodes], np.concatenate(owners)),
        faces,
        nodes,
        np.concatenate(parameters),
        np.concatenate(segments),
        tuple(edge for edge, _, _ in lines),
        EdgeSegments(np.repeat(np.arange(len(lines)), sizes), side_ends.astype(np.int64), at),
    )


def _find_segments(triangles: IntArray, ends: IntArray, numbers: IntArray, n: int) -> IntArray:
    """Of each side of triangles (m, 3) on n nodes of a face, the number of the segment with its ends (k, 2), or -1: (m, 3)."""
    keys = ends @ [n, 1]
    order = np.argsort(keys)
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1) @ [n, 1]
    at = np.minimum(np.searchsorted(keys[order], sides), len(keys) - 1)
    return np.where(keys[order][at] == sides, numbers[order][at], -1)


def _drop_collapsed(mesh: SolidMesh) -> SolidMesh:
    """The mesh without triangles that have a node twice, and without repeated chords."""
    proper = (mesh.triangles != np.roll(mesh.triangles, 1, axis=1)).all(axis=1)
    return _split_repeated_chords(SolidMesh(mesh.points, mesh.triangles[proper], mesh.face[proper]))


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
