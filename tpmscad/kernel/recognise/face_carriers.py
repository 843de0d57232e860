"""The plane or quadric that underlies an OCCT face, by its type or by canonical recognition of a spline surface."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepTools import BRepTools
from OCP.GeomAbs import GeomAbs_Cone, GeomAbs_Cylinder, GeomAbs_Plane, GeomAbs_Sphere, GeomAbs_Torus
from OCP.gp import gp_Cone, gp_Cylinder, gp_Pln, gp_Pnt, gp_Sphere, gp_Vec
from OCP.ShapeAnalysis import ShapeAnalysis_CanonicalRecognition
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.carriers import (
    Circle,
    ConicalSurface,
    CylindricalSurface,
    Plane,
    Quadric,
    SphericalSurface,
    ToroidalSurface,
)
from tpmscad.brep.curve_recognition import recognise_line_or_circle
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE, axis_frame
from tpmscad.kernel.occt.seams import turn_seam_aside
from tpmscad.kernel.recognise.edge_curves import UnsupportedFace

EXACT_REL_TOL = 1e-10
"""In body sizes: deviation of an edge from its surfaces, and of a surface from the plane or quadric it is recognised as."""

CHECK_SAMPLES = 9
"""Points along an edge, and along each parameter of a face, at which that deviation is measured."""


def recognise_carrier(face: TopoDS_Face, size: float) -> Plane | Quadric:
    """Plane or quadric that underlies the face, which its seam does not cross. Raises UnsupportedFace if there is none."""
    adaptor = BRepAdaptor_Surface(face, False)
    kind = adaptor.GetType()
    if kind == GeomAbs_Plane:
        return Plane(*axis_frame(adaptor.Plane()))
    if kind == GeomAbs_Cylinder:
        return _carrier_of_radius(CylindricalSurface, _with_clear_seam(adaptor.Cylinder(), face))
    if kind == GeomAbs_Cone:
        return _cone(_with_clear_seam(adaptor.Cone(), face), evaluate_mid_face(face)[1])
    if kind == GeomAbs_Sphere:
        return _carrier_of_radius(SphericalSurface, adaptor.Sphere())
    if kind == GeomAbs_Torus:
        torus = _with_clear_seam(adaptor.Torus(), face)
        if torus.MajorRadius() <= torus.MinorRadius():
            raise UnsupportedFace("is a torus that intersects itself")
        return ToroidalSurface(*axis_frame(torus), torus.MajorRadius(), torus.MinorRadius())
    found = _recognise_spline(face, size)
    if found is None:
        raise UnsupportedFace(f"is free-form ({str(kind).split('_')[-1]}), neither plane nor quadric")
    return found


def _with_clear_seam(value: Any, face: TopoDS_Face) -> Any:
    """The cylinder, cone or torus of a face, with its seam beside the face."""
    low, high, *_ = BRepTools.UVBounds_s(face)
    return turn_seam_aside(value, low, high)


def _recognise_spline(face: TopoDS_Face, size: float) -> Plane | Quadric | None:
    """Plane or quadric with which a surface of another type agrees to EXACT_REL_TOL, or None."""
    recognition = ShapeAnalysis_CanonicalRecognition(face)
    points = _sample_face_grid(face)
    pln, cylinder, cone, sphere = gp_Pln(), gp_Cylinder(), gp_Cone(), gp_Sphere()
    tol = EXACT_REL_TOL * size
    near = max(tol, CONFUSION_TOLERANCE)  # below it the kernel recognises no plane; what it finds is measured
    for found in (
        lambda: Plane(*axis_frame(pln)) if recognition.IsPlane(near, pln) else None,
        lambda: _carrier_of_radius(CylindricalSurface, cylinder) if recognition.IsCylinder(near, cylinder) else None,
        lambda: _cone(cone, evaluate_mid_face(face)[1]) if recognition.IsCone(near, cone) else None,
        lambda: _carrier_of_radius(SphericalSurface, sphere) if recognition.IsSphere(near, sphere) else None,
        lambda: _fit_torus(points, tol),
        lambda: _fit_torus(np.swapaxes(points, 0, 1), tol),
    ):
        carrier = found()
        if carrier is not None and np.abs(carrier.distance(points)).max() <= tol:
            return carrier
    return None


def _fit_torus(points: Array, tol: float) -> ToroidalSurface | None:
    """Torus through points (n, m, 3) whose rows are circles around the tube, or None.

    OCCT does not recognise tori.
    """
    circles = [
        found[0]
        for found in (recognise_line_or_circle(row, tol) for row in points)
        if found and isinstance(found[0], Circle)
    ]
    if len(circles) < len(points):
        return None
    ring = recognise_line_or_circle(np.array([circle.origin for circle in circles]), tol)
    if ring is None or not isinstance(ring[0], Circle) or ring[0].radius <= circles[0].radius:
        return None
    return ToroidalSurface(ring[0].origin, ring[0].x_axis, ring[0].normal, ring[0].radius, circles[0].radius)


def _carrier_of_radius(kind: Callable[..., Quadric], value: gp_Cylinder | gp_Sphere) -> Quadric:
    """A cylinder or a sphere of OCCT as a carrier."""
    return kind(*axis_frame(value), value.Radius())


def _cone(value: gp_Cone, point: Array) -> ConicalSurface:
    """The nappe of an OCCT cone that contains a point of the face; OCCT cones have two nappes."""
    origin, x_axis, axis = axis_frame(value)
    radius, angle = value.RefRadius(), value.SemiAngle()
    height = float((point - origin) @ axis)
    if radius + height * np.tan(angle) >= 0:
        return ConicalSurface(origin, x_axis, axis, radius, angle)
    from_apex = height + radius / np.tan(angle)
    away = np.sign(from_apex)
    return ConicalSurface(origin + height * axis, x_axis, away * axis, abs(from_apex * np.tan(angle)), abs(angle))


def evaluate_mid_face(face: TopoDS_Face) -> tuple[tuple[float, float], Array, Array, Array]:
    """Values near the middle of the face's parameter box, which is away from poles.

    Returns (u, v), the point, S_u x S_v, and the point at a slightly larger u.
    """
    surface = BRepAdaptor_Surface(face, False)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    u, v = 0.47 * u0 + 0.53 * u1, 0.47 * v0 + 0.53 * v1
    point, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
    surface.D1(u, v, point, along_u, along_v)
    beside = surface.Value(u + 0.01 * (u1 - u0), v).Coord()
    return (u, v), np.array(point.Coord()), np.cross(along_u.Coord(), along_v.Coord()), np.array(beside)


def _sample_face_grid(face: TopoDS_Face) -> Array:
    """Points on a grid of the face's parameters: (CHECK_SAMPLES, CHECK_SAMPLES, 3)."""
    surface = BRepAdaptor_Surface(face, False)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    grid = [
        surface.Value(u, v).Coord()
        for u in np.linspace(u0, u1, CHECK_SAMPLES)
        for v in np.linspace(v0, v1, CHECK_SAMPLES)
    ]
    return np.array(grid).reshape(CHECK_SAMPLES, CHECK_SAMPLES, 3)
