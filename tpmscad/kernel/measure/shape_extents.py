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
from OCP.BRepTools import BRepTools
from OCP.Geom import (
    Geom_ConicalSurface,
    Geom_CylindricalSurface,
    Geom_Plane,
    Geom_SphericalSurface,
    Geom_ToroidalSurface,
)
from OCP.gp import gp_Pnt2d
from OCP.ShapeAnalysis import ShapeAnalysis_Surface
from OCP.TopAbs import TopAbs_OUT
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.carriers import SphericalSurface, ToroidalSurface
from tpmscad.brep.extents import EXTENT_RTOL, extend_by_surface, stationary_parameters
from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import box_corners, box_of_edges
from tpmscad.kernel.occt.exploration import faces_of, unwrap
from tpmscad.kernel.recognise.face_carriers import recognise_carrier

BOUNDED_BY_EDGES = (Geom_Plane, Geom_CylindricalSurface, Geom_ConicalSurface)
"""Surfaces on which no coordinate has an extreme inside a face, but on a line that meets its edges."""

TWO_PI = 2 * np.pi

CLASSIFIER_TOL = 1e-9
"""Distance in parameters below which the kernel's classifier puts a point on the border of a face."""


def shape_bounds(shape: Any) -> tuple[Array, Array]:
    """Opposite corners (3,), (3,) of the smallest box that contains a build123d, CadQuery or TopoDS shape.

    Within the kernel's accuracy of the boxes of edges, about 1e-7 in model units; swept, offset and rational surfaces, and tori
    that meet themselves, have the kernel's optimal box. KernelError for a shape without edges and faces.
    """
    topods, splines, round_points = unwrap(shape), [], [np.zeros((0, 3))]
    box = box_of_edges(topods)
    for face in faces_of(topods):
        geometry = BRep_Tool.Surface_s(face)
        if convert.is_plain_spline(geometry):
            splines.append((face, geometry))
        elif is_round(geometry):
            round_points.append(_find_extreme_points(face))
        elif not isinstance(geometry, BOUNDED_BY_EDGES):
            BRepBndLib.AddOptimal_s(face, box, False, False)
    inside = np.concatenate(round_points)
    if box.IsVoid() and not len(inside):
        raise KernelError("bounds", "the shape has neither edges nor faces")
    corners = np.concatenate([inside, *([] if box.IsVoid() else [np.array(box_corners(box))])])
    reach = np.concatenate([-corners.min(axis=0), corners.max(axis=0)])
    tol = EXTENT_RTOL * float((reach[:3] + reach[3:]).max())
    for face, geometry in splines:
        if _poles_exceed(face, reach + tol):
            reach = extend_by_surface(convert.surface_from_occt(geometry), partial(face_contains, face), reach, tol)
    return -reach[:3], reach[3:]


def is_round(geometry: Any) -> bool:
    """Whether a surface is a sphere, or a torus that does not meet itself."""
    return isinstance(geometry, Geom_SphericalSurface) or (
        isinstance(geometry, Geom_ToroidalSurface) and geometry.MajorRadius() > geometry.MinorRadius()
    )


def _find_extreme_points(face: TopoDS_Face) -> Array:
    """The points (n, 3) inside a face on a sphere or a torus where a coordinate is stationary.

    The kernel's optimal box is that of the whole sphere, whatever the face.
    """
    carrier = recognise_carrier(face, 1.0)
    assert isinstance(carrier, SphericalSurface | ToroidalSurface)
    uv = stationary_parameters(carrier, np.concatenate([-np.eye(3), np.eye(3)])).reshape(-1, 2)
    points = carrier(uv[:, 0], uv[:, 1])
    surface = ShapeAnalysis_Surface(BRep_Tool.Surface_s(face))
    low_u, high_u, low_v, high_v = BRepTools.UVBounds_s(face)
    contained = []
    for point in points:
        at = surface.ValueOfUV(convert.point(point), CLASSIFIER_TOL)
        u, v = low_u + (at.X() - low_u) % TWO_PI, at.Y()
        if isinstance(carrier, ToroidalSurface):
            v = low_v + (v - low_v) % TWO_PI
        contained.append(u <= high_u and low_v <= v <= high_v and face_contains(face, np.array([u, v])))
    return np.asarray(points[contained])


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
