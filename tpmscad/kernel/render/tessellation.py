"""Triangulation of OCCT shapes for drawing, with normals and curvatures evaluated on the surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepLProp import BRepLProp_SLProps
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.BRepTools import BRepTools
from OCP.TopLoc import TopLoc_Location

from tpmscad._typing import Array, IntArray
from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.child_process import may_use_threads
from tpmscad.kernel.occt.exploration import faces_of, orientation_sign, unwrap
from tpmscad.kernel.occt.geometry_evaluators import OutwardNormals

MAX_FACET_ANGLE = 0.35
"""Radians between neighbouring facets; since normals are exact, only silhouettes show the facets."""

SINGULAR_TOL = 1e-9
"""Length of a derivative below which a point of a surface has no curvature."""


@dataclass(frozen=True, slots=True, eq=False)
class Tessellation:
    """Triangles of a shape: points, normals and parameters on the faces' surfaces, each face with points of its own.

    points (n, 3), outward unit normals (n, 3), parameters (n, 2), the face of each point (n,), triangles (m, 3) as indices of
    points. Faces are numbered in the order of `faces_of`.
    """

    points: Array
    normals: Array
    parameters: Array
    face: IntArray
    triangles: IntArray


def tessellate(shape: Any, deflection: float, angle: float = MAX_FACET_ANGLE) -> Tessellation:
    """Triangles within `deflection` of the shape's faces. Raises KernelError if no face can be triangulated.

    A shape that had no triangles before has none afterwards.
    """
    topods = unwrap(shape)
    faces = faces_of(topods)
    had_triangles = any(_triangulation(face) is not None for face in faces)
    BRepMesh_IncrementalMesh(topods, deflection, False, angle, may_use_threads())
    points, normals, parameters, owner, corners, count = [], [], [], [], [], 0
    for number, face in enumerate(faces):
        mesh = _triangulation(face)
        if mesh is None:
            continue
        nodes = range(1, mesh.NbNodes() + 1)
        local, uv = (np.array([read(i).Coord() for i in nodes]) for read in (mesh.Node, mesh.UVNode))
        matrix = convert.matrix_from_occt(face.Location().Transformation())
        triples = np.array([mesh.Triangle(i).Get() for i in range(1, mesh.NbTriangles() + 1)]) - 1
        points.append(local @ matrix[:, :3].T + matrix[:, 3])
        normals.append(OutwardNormals(face)(uv)[1])
        parameters.append(uv)
        owner.append(np.full(len(local), number))
        corners.append((triples[:, ::-1] if orientation_sign(face) < 0 else triples) + count)
        count += len(local)
    if not had_triangles:
        BRepTools.Clean_s(topods)
    if not points:
        raise KernelError("triangulate", "the shape has no face that can be drawn", topods)
    return Tessellation(*map(np.concatenate, (points, normals, parameters, owner, corners)))


def mean_curvatures(faces: Sequence[Any], parameters: Array, face_of_point: IntArray) -> Array:
    """Mean curvature at points of faces, given by their parameters (n, 2) and ordered by face (n,): (n,).

    It is half the sum of the principal curvatures of the surface, positive where the solid is convex; NaN at singular points.
    """
    values = np.full(len(parameters), np.nan)
    starts = np.searchsorted(face_of_point, np.arange(len(faces) + 1))
    for face, start, stop in zip(faces, starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        local = BRepLProp_SLProps(BRepAdaptor_Surface(face), 2, SINGULAR_TOL)
        sign = -orientation_sign(face)  # OCCT counts a surface that bends towards its normal as positive
        for i in range(start, stop):
            local.SetParameters(*parameters[i].tolist())
            if local.IsCurvatureDefined():
                values[i] = sign * local.MeanCurvature()
    return values


def _triangulation(face: Any) -> Any:
    """The triangulation of a face, None if it has none."""
    return BRep_Tool.Triangulation_s(face, TopLoc_Location())
