"""OCCT's triangles of faces on given nodes of their edges.

OCCT divides edges by itself, unless a face has a triangulation already on whose nodes they are divided: it then takes these nodes
and makes the triangles anew where the triangulation is too coarse. So each face is given one triangle with the nodes of its edges
and a deflection beyond all bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.IMeshTools import IMeshTools_Parameters
from OCP.Poly import Poly_PolygonOnTriangulation, Poly_Triangle, Poly_Triangulation
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.triangles.measured_deviation import pair_sides
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.child_process import may_use_threads
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of

STALE_DEFLECTION = 1e30
"""Deflection of the triangulation that holds the nodes of a face's edges: OCCT takes them and makes the triangles anew."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceMesh:
    """What OCCT made of a face: parameters of the nodes (n, 2), triangles (m, 3), and nodes along each use of an edge."""

    uv: Array
    triangles: IntArray
    lines: list[IntArray]
    poles: list[tuple[IntArray, TopoDS_Edge]]


def mesh_on_nodes(
    faces: Sequence[TopoDS_Face], lines: Sequence[list[tuple[Array, Array]]], deflection: float, angle: float
) -> list[FaceMesh | BoolArray]:
    """OCCT's triangles of faces on given nodes of their edges; where it could not keep these, the uses that it divided anew."""
    copies = [convert.as_face(BRepBuilderAPI_Copy(face, False, False).Shape()) for face in faces]
    for face, own in zip(copies, lines, strict=True):
        _impose_nodes(face, own)
    parameters = IMeshTools_Parameters()
    parameters.Deflection, parameters.Angle = deflection, angle
    parameters.InParallel = may_use_threads()
    BRepMesh_IncrementalMesh(make_compound(copies), parameters)
    return [_read_mesh(face, own) for face, own in zip(copies, lines, strict=True)]


def _impose_nodes(face: TopoDS_Face, lines: list[tuple[Array, Array]]) -> None:
    """Give a face a stale triangulation that holds the nodes of its edges."""
    builder, location = BRep_Builder(), face.Location()
    back = location.Inverted().Transformation()
    stale = Poly_Triangulation(max(3, sum(len(t) for t, _ in lines)), 1, False)
    stale.SetTriangle(1, Poly_Triangle(1, 2, 3))
    stale.Deflection(STALE_DEFLECTION)
    builder.UpdateFace(face, stale)
    edges = [edge for edge in edges_of(face) if not BRep_Tool.Degenerated_s(edge)]
    count, polygons = 0, dict[ShapeKey, Any]()
    for edge, (t, points) in zip(edges, lines, strict=True):
        nodes, reals = convert.int_array(len(t)), convert.real_array(len(t))
        for k, (at, point) in enumerate(zip(t.tolist(), points, strict=True), 1):
            node = convert.point(point)
            stale.SetNode(count + k, node if location.IsIdentity() else node.Transformed(back))
            nodes.SetValue(k, count + k)
            reals.SetValue(k, at)
        count += len(t)
        polygon = Poly_PolygonOnTriangulation(nodes, reals)
        polygon.Deflection(0.0)
        seam = polygons.get(ShapeKey(edge))
        if seam is None:
            polygons[ShapeKey(edge)] = polygon
            builder.UpdateEdge(edge, polygon, stale, location)
        else:
            builder.UpdateEdge(edge, seam, polygon, stale, location)


def _read_mesh(face: TopoDS_Face, lines: list[tuple[Array, Array]]) -> FaceMesh | BoolArray:
    """The triangulation of a face, if it covers the face on the given nodes; else the uses of edges with other nodes."""
    location = TopLoc_Location()
    mesh, other = BRep_Tool.Triangulation_s(face, location), np.zeros(len(lines), bool)
    if mesh is None or mesh.Deflection() == STALE_DEFLECTION or not mesh.HasUVNodes():
        return other
    own: list[IntArray] = []
    poles: list[tuple[IntArray, TopoDS_Edge]] = []
    for edge in edges_of(face):
        line = BRep_Tool.PolygonOnTriangulation_s(edge, mesh, location)
        if line is None:
            return other
        nodes = np.array([line.Node(i) - 1 for i in range(1, line.NbNodes() + 1)])
        if BRep_Tool.Degenerated_s(edge):
            poles.append((nodes, edge))
            continue
        other[len(own)] = len(nodes) != len(lines[len(own)][0])
        own.append(nodes)
    if other.any():
        return other
    uv = np.array([mesh.UVNode(i).Coord() for i in range(1, mesh.NbNodes() + 1)])
    triangles = np.array([mesh.Triangle(i).Get() for i in range(1, mesh.NbTriangles() + 1)]).reshape(-1, 3) - 1
    found = FaceMesh(uv, triangles, own, poles)
    return found if _covers_its_face(found) else other


def _covers_its_face(mesh: FaceMesh) -> bool:
    """Whether every side inside the face has a triangle on either side, and every chord of an edge one."""
    n = len(mesh.uv)
    if not len(mesh.triangles):
        return False
    sides = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    open_sides = sides[pair_sides(mesh.triangles, n).ravel() < 0]
    chords = np.concatenate(
        [np.stack([line[:-1], line[1:]], axis=1) for line in (*mesh.lines, *(nodes for nodes, _ in mesh.poles))]
    )
    chords = chords[chords[:, 0] != chords[:, 1]]  # OCCT makes one node of those that are closer than it resolves
    keys, expected = (np.sort(np.sort(each, axis=1) @ [n, 1]) for each in (open_sides, chords))
    along = np.sort(sides @ [n, 1])
    return np.array_equal(keys, expected) and bool((along[1:] != along[:-1]).all())
