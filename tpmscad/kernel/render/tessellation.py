"""Triangulation of OCCT shapes for drawing, with normals evaluated on the surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepGProp import BRepGProp_Face
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopLoc import TopLoc_Location

from tpmscad._typing import Array, IntArray
from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import faces_of, orientation_sign, unwrap

MAX_FACET_ANGLE = 0.35
"""Radians between neighbouring facets; since normals are exact, only silhouettes show the facets."""


@dataclass(frozen=True, slots=True, eq=False)
class Tessellation:
    """Points (n, 3), outward unit normals (n, 3), and triangles (m, 3) as indices of points."""

    points: Array
    normals: Array
    triangles: IntArray


def tessellate(shape: Any, deflection: float) -> Tessellation:
    """Triangles within `deflection` of the shape's faces. Raises KernelError if no face can be triangulated."""
    topods = unwrap(shape)
    BRepMesh_IncrementalMesh(topods, deflection, False, MAX_FACET_ANGLE, True)
    points, normals, corners, count = [], [], [], 0
    for face in faces_of(topods):
        mesh = BRep_Tool.Triangulation_s(face, TopLoc_Location())
        if mesh is None:
            continue
        local, uv = _mesh_nodes(mesh)
        matrix = convert.matrix_from_occt(face.Location().Transformation())
        triples = np.array([mesh.Triangle(i).Get() for i in range(1, mesh.NbTriangles() + 1)]) - 1
        points.append(local @ matrix[:, :3].T + matrix[:, 3])
        normals.append(_face_normals(face, uv))
        corners.append((triples[:, ::-1] if orientation_sign(face) < 0 else triples) + count)
        count += len(local)
    if not points:
        raise KernelError("triangulate", "the shape has no face that can be drawn", topods)
    return Tessellation(np.concatenate(points), np.concatenate(normals), np.concatenate(corners))


def _mesh_nodes(mesh: Any) -> tuple[Array, Array]:
    """Points (n, 3) and parameters (n, 2) of a triangulation."""
    numbers = range(1, mesh.NbNodes() + 1)
    return np.array([mesh.Node(i).Coord() for i in numbers]), np.array([mesh.UVNode(i).Coord() for i in numbers])


def _face_normals(face: Any, uv: Array) -> Array:
    """Outward unit normals of the placed face at its parameters; zero at singular points."""
    surface = BRepGProp_Face(face)
    point, normal = gp_Pnt(), gp_Vec()
    found = []
    for u, v in uv.tolist():
        surface.Normal(u, v, point, normal)
        found.append(normal.Coord())
    vectors = np.array(found)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
