"""The true extent of OCCT shapes, of which no boundary representation in arrays is known: booleans, offsets, imports.

OCCT bounds a B-spline face by its poles, or by the surface over the parameter box of the face. Here its edges bound a face, and
so do the points inside it where a coordinate is stationary (`tpmscad.brep.extents`).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Tool
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepClass import BRepClass_FaceClassifier
from OCP.Geom import Geom_ConicalSurface, Geom_CylindricalSurface, Geom_Plane
from OCP.gp import gp_Pnt2d
from OCP.TopAbs import TopAbs_OUT
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.extents import EXTENT_RTOL, extend_by_surface
from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import box_corners, box_of_edges
from tpmscad.kernel.occt.exploration import faces_of, unwrap

BOUNDED_BY_EDGES = (Geom_Plane, Geom_CylindricalSurface, Geom_ConicalSurface)
"""Surfaces on which no coordinate has an extreme inside a face, but on a line that meets its edges."""

CLASSIFIER_TOL = 1e-9
"""Distance in parameters below which the kernel's classifier puts a point on the border of a face."""


def shape_bounds(shape: Any) -> tuple[Array, Array]:
    """Opposite corners (3,), (3,) of the smallest box that contains a build123d, CadQuery or TopoDS shape.

    Within the kernel's accuracy of the boxes of edges, about 1e-7 in model units; faces that are neither B-splines nor planes,
    cylinders or cones have the kernel's optimal box. KernelError for a shape without edges and faces.
    """
    topods, splines = unwrap(shape), []
    box = box_of_edges(topods)
    for face in faces_of(topods):
        geometry = BRep_Tool.Surface_s(face)
        if convert.is_plain_spline(geometry):
            splines.append((face, geometry))
        elif not isinstance(geometry, BOUNDED_BY_EDGES):
            BRepBndLib.AddOptimal_s(face, box, False, False)
    if box.IsVoid():
        raise KernelError("bounds", "the shape has neither edges nor faces")
    low, high = box_corners(box)
    reach = np.concatenate([-low, high])
    tol = EXTENT_RTOL * float((reach[:3] + reach[3:]).max())
    for face, geometry in splines:
        if _poles_exceed(face, reach + tol):
            reach = extend_by_surface(convert.surface_from_occt(geometry), partial(face_contains, face), reach, tol)
    return -reach[:3], reach[3:]


def _poles_exceed(face: TopoDS_Face, reach: Array) -> bool:
    """Whether the kernel's box of a face by its poles exceeds the reach (6,)."""
    box = Bnd_Box()
    BRepBndLib.Add_s(face, box, False)
    low, high = box_corners(box)
    return bool((np.concatenate([-low, high]) > reach).any())


def face_contains(face: TopoDS_Face, uv: Array, tol: float = CLASSIFIER_TOL) -> bool:
    """Whether parameters (2,) lie in a face or within `tol` of its border, in parameters."""
    at = gp_Pnt2d(float(uv[0]), float(uv[1]))
    return bool(BRepClass_FaceClassifier(face, at, tol).State() != TopAbs_OUT)
