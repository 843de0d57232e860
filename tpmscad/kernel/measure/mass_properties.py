"""Moments (area, volume, first moments) of OCCT faces along their loops, by Green's theorem.

The loops are those of the edges' curves in space (`loop_nodes`), the integrals those of `brep.moments.loop_integrals`. The
volume is exact to round-off, the area to about 1e-9. Extrusions are made faces of splines first. Faces on other surfaces
(revolutions, rational splines) are left to OCCT's adaptive quadrature, whose error may reach 3e-8 on trimmed tori.

BRepGProp in place of this module would meet all tolerances of lattices when it is given a relative error, but takes twice as long
(docs/measurements.md, `face_moments`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepBuilderAPI import BRepBuilderAPI_NurbsConvert
from OCP.BRepGProp import BRepGProp, BRepGProp_Domain, BRepGProp_Face, BRepGProp_Vinert
from OCP.Geom import Geom_SurfaceOfLinearExtrusion
from OCP.GeomAbs import GeomAbs_Cone, GeomAbs_Cylinder, GeomAbs_Plane, GeomAbs_Sphere, GeomAbs_Torus
from OCP.gp import gp_Pnt, gp_Trsf, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.TopAbs import TopAbs_FORWARD
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

from tpmscad._typing import Array
from tpmscad.brep.carriers import Carrier, Plane
from tpmscad.brep.moments.integral_properties import lift_planar_moments
from tpmscad.brep.moments.loop_integrals import integrate_at_nodes
from tpmscad.kernel.measure.edge_quadrature import EdgeNodeCache
from tpmscad.kernel.measure.loop_nodes import find_loop_nodes
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import box_center, box_corners, box_of_edges
from tpmscad.kernel.occt.exploration import faces_of, orientation_sign
from tpmscad.kernel.recognise.edge_curves import UnsupportedFace
from tpmscad.kernel.recognise.face_carriers import evaluate_mid_face, recognise_carrier
from tpmscad.splines.bspline import BSplineSurface

ELEMENTARY = (GeomAbs_Plane, GeomAbs_Cylinder, GeomAbs_Cone, GeomAbs_Sphere, GeomAbs_Torus)

OCCT_QUADRATURE_REL_TOL = 1e-13
"""Relative error requested of OCCT for faces on other surfaces. At 1e-9 turned arcs of splines were off by 2e-7, at 1e-11 by
3e-9, all in the same time."""


def face_moments(faces: Sequence[TopoDS_Face]) -> Array:
    """Area, int x . n dA / 3 and int x (x . n) dA / 4 of each face over its own orientation: (F, 5).

    Summed over a closed boundary they are the area, the volume, and the volume times the centroid.
    """
    nodes_of = EdgeNodeCache()
    return np.array([_integrate_face(face, nodes_of) for face in faces]).reshape(-1, 5)


def _integrate_face(face: TopoDS_Face, nodes_of: EdgeNodeCache) -> Array:
    """The five moments of a face."""
    face, surface = _find_surface(face)
    if surface is None:
        return _occt_face_moments(face)
    u, v, dv = find_loop_nodes(face, surface, nodes_of).T
    side = orientation_sign(face)
    if not isinstance(surface, BSplineSurface):
        _, point, normal, _ = evaluate_mid_face(face)
        side *= 1 if normal @ surface.gradient(point) > 0 else -1
    if isinstance(surface, Plane):
        in_plane = np.stack([u, u**2 / 2, u * v]) @ dv
        frame = np.stack([surface.origin, surface.x_axis, surface.y_axis, surface.normal])
        (moments,) = lift_planar_moments(in_plane[None], frame[None])
    else:
        start = None if isinstance(surface, BSplineSurface) else np.array([u.min()])
        (moments,) = integrate_at_nodes(surface, u, v, dv, np.zeros(len(u), np.int64), 1, start)
    # loops run round the face's own normal, of which only the area takes the side
    return np.concatenate([[side * moments[0], moments[4:13:4].sum() / 3.0], moments[13:] / 4.0])


def _find_surface(face: TopoDS_Face) -> tuple[TopoDS_Face, Carrier | None]:
    """A face and the plane, quadric or spline on which it is integrated; None for other surfaces.

    An extrusion is made a face of a spline: OCCT's Gauss quadrature does not split extrusions at the knots of their curves, and
    volumes were found off by 4 to 9 % at any tolerance asked for.
    """
    if BRepAdaptor_Surface(face, False).GetType() in ELEMENTARY:
        try:
            return face, recognise_carrier(face, 1.0)
        except UnsupportedFace:
            return face, None
    if isinstance(BRep_Tool.Surface_s(face), Geom_SurfaceOfLinearExtrusion):
        face = convert.as_face(BRepBuilderAPI_NurbsConvert(face, True).Shape().Oriented(face.Orientation()))
    geometry = BRep_Tool.Surface_s(face)
    return face, convert.surface_from_occt(geometry) if convert.is_plain_spline(geometry) else None


def solid_moments(solid: TopoDS_Shape) -> Array:
    """Area, volume, and volume times centroid of a closed solid: (5,).

    They are integrated about the centre of its bounding box: faces agree along their edges to a tolerance only, and what is
    missing between them counts with its distance from the origin.
    """
    edges = box_of_edges(solid)
    centre = box_center(solid) if edges.IsVoid() else np.mean(box_corners(edges), axis=0)
    shift = gp_Trsf()
    shift.SetTranslation(gp_Vec(*(-centre).tolist()))
    moments = face_moments(faces_of(solid.Moved(TopLoc_Location(shift)))).sum(axis=0)
    moments[2:] += moments[1] * centre
    return np.asarray(moments)


def _occt_face_moments(face: TopoDS_Face) -> Array:
    """The five moments by OCCT's adaptive quadrature."""
    forward = convert.as_face(face.Oriented(TopAbs_FORWARD))
    area = GProp_GProps()
    BRepGProp.SurfaceProperties_s(forward, area, OCCT_QUADRATURE_REL_TOL)
    # VolumeProperties of a single face chooses its own reference point; Vinert uses the given one.
    domain = BRepGProp_Domain(forward)
    cone = BRepGProp_Vinert(BRepGProp_Face(forward), domain, gp_Pnt(0.0, 0.0, 0.0), OCCT_QUADRATURE_REL_TOL)
    volume = cone.Mass()
    centre = np.array(cone.CentreOfMass().Coord()) * volume if volume else np.zeros(3)
    outward = orientation_sign(face)
    return np.array([area.Mass(), outward * volume, *(outward * centre)])


def measure_face(face: TopoDS_Shape) -> tuple[float, tuple[float, float, float]]:
    """Area and centroid of a face."""
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(face, properties)
    x, y, z = properties.CentreOfMass().Coord()
    return properties.Mass(), (x, y, z)
