"""Moments (area, volume, first moments) of OCCT faces by Gauss quadrature on their own geometry.

Untrimmed spline patches are integrated on tensor Gauss grids, many at once. Trimmed spline faces, planar faces and faces on
quadrics are reduced to line integrals by Green's theorem (`spline_face_moments`, `quadric_face_moments`). The volume is exact to
round-off, the area to about 1e-9. Extrusions are made faces of splines first. Faces on other surfaces (revolutions,
rational splines) are left to OCCT's adaptive quadrature, whose error may reach 3e-8 on trimmed tori.

BRepGProp in place of this module would meet all tolerances of lattices when it is given a relative error, but takes twice as long
(docs/measurements.md, `face_moments`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve2d
from OCP.BRepBuilderAPI import BRepBuilderAPI_NurbsConvert
from OCP.BRepGProp import BRepGProp, BRepGProp_Domain, BRepGProp_Face, BRepGProp_Vinert
from OCP.Geom import Geom_Plane, Geom_SurfaceOfLinearExtrusion
from OCP.gp import gp_Pnt, gp_Trsf, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.TopAbs import TopAbs_FORWARD
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

from tpmscad._typing import Array
from tpmscad.kernel.measure.edge_quadrature import EdgeNodeCache
from tpmscad.kernel.measure.quadric_face_moments import quadric_face_moments, recognise_quadric
from tpmscad.kernel.measure.spline_face_moments import (
    TrimmedSplineFace,
    gauss_grid,
    moment_integrands,
    trimmed_face_moments,
)
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import box_center, box_corners, box_of_edges
from tpmscad.kernel.occt.exploration import edges_of, faces_of, orientation_sign
from tpmscad.splines.bspline import BSplineSurface

T = TypeVar("T")

MIN_AREA_POINTS = 16
"""Least Gauss points per knot cell and direction: the area density contains a square root and is no polynomial."""

OCCT_QUADRATURE_REL_TOL = 1e-13
"""Relative error requested of OCCT for faces on other surfaces. At 1e-9 turned arcs of splines were off by 2e-7, at 1e-11 by
3e-9, all in the same time."""

BORDER_FRACTION = 1e-9
"""Distance from the patch's side, as a fraction of its parameter range, up to which an edge lies on that side. At 1e-6 a body
that touches the lattice along sides of patches cost 3e-8 of the volume: the slivers between were counted."""

FACES_PER_BATCH = 64
"""Faces evaluated at once; more faces need more memory and are no faster."""


SplineSpaceKey = tuple[bytes, bytes, int, int]
"""Knots and degrees of a surface; surfaces with the same key are evaluated together."""


def _batches(items: list[T]) -> list[list[T]]:
    """Consecutive groups of at most FACES_PER_BATCH items."""
    return [items[start : start + FACES_PER_BATCH] for start in range(0, len(items), FACES_PER_BATCH)]


def face_moments(faces: Sequence[TopoDS_Face]) -> Array:
    """Area, int x . n dA / 3 and int x (x . n) dA / 4 of each face over its own orientation: (F, 5).

    Summed over a closed boundary they are the area, the volume, and the volume times the centroid.
    """
    result = np.empty((len(faces), 5))
    nodes_of = EdgeNodeCache()
    whole: dict[SplineSpaceKey, list[tuple[int, BSplineSurface]]] = {}
    trimmed: dict[SplineSpaceKey, list[tuple[int, TrimmedSplineFace]]] = {}
    for i, face in enumerate(faces):
        geometry = BRep_Tool.Surface_s(face)
        is_integrated = isinstance(geometry, Geom_Plane) or convert.is_plain_spline(geometry)
        quadric = None if is_integrated else recognise_quadric(face)
        if quadric is None and isinstance(geometry, Geom_SurfaceOfLinearExtrusion):
            face = _as_spline_face(face)
            geometry = BRep_Tool.Surface_s(face)
        if isinstance(geometry, Geom_Plane):
            result[i] = _planar_face_moments(face, geometry, nodes_of)
        elif convert.is_plain_spline(geometry):
            surface = convert.surface_from_occt(geometry)
            edges = edges_of(face)
            space = (surface.knots_u.tobytes(), surface.knots_v.tobytes(), surface.degree_u, surface.degree_v)
            if _covers_patch(edges, face, surface):
                whole.setdefault(space, []).append((i, surface))
            else:
                trimmed.setdefault(space, []).append((i, TrimmedSplineFace(surface, edges, face)))
        elif quadric is not None:
            result[i] = orientation_sign(face) * quadric_face_moments(face, quadric, nodes_of)
        else:
            result[i] = _occt_face_moments(face)
    for patches in whole.values():
        for chunk in _batches(patches):
            result[[i for i, _ in chunk]] = _untrimmed_moments([s for _, s in chunk])
    for (_, _, degree_u, degree_v), parts in trimmed.items():
        points = max(3 * degree_u, MIN_AREA_POINTS), max(3 * degree_v, MIN_AREA_POINTS)
        for chunk in _batches(parts):
            directions = np.array([orientation_sign(part.face) for _, part in chunk])[:, None]
            moments = trimmed_face_moments([part for _, part in chunk], nodes_of, points)
            result[[i for i, _ in chunk]] = directions * moments
    outward = np.array([orientation_sign(face) for face in faces])
    result[:, 1:] *= outward[:, None]
    return result


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


def _as_spline_face(face: TopoDS_Face) -> TopoDS_Face:
    """The face on a B-spline surface in place of an extrusion.

    OCCT's Gauss quadrature does not split extrusions at the knots of their curves: volumes were found off by 4 to 9 % at any
    tolerance asked for.
    """
    return convert.as_face(BRepBuilderAPI_NurbsConvert(face, True).Shape().Oriented(face.Orientation()))


def _untrimmed_moments(surfaces: Sequence[BSplineSurface]) -> Array:
    """Moments of untrimmed patches with the same knots and degrees: (F, 5)."""
    s = surfaces[0]
    # 2 p points integrate the densities of volume and centroid, of degrees 3 p - 1 and 4 p - 1, exactly
    nodes = gauss_grid(s, (max(2 * s.degree_u, MIN_AREA_POINTS), max(2 * s.degree_v, MIN_AREA_POINTS)))
    f = moment_integrands(np.stack([s.poles for s in surfaces]), nodes)
    return np.einsum("a,b,fabk->fk", *nodes.weights, f, optimize=True)


def _covers_patch(edges: Sequence[Any], face: TopoDS_Face, surface: BSplineSurface) -> bool:
    """True if the face is an untrimmed patch: four edges, each along a different side of the parameter rectangle."""
    if len(edges) != 4:
        return False
    (u0, u1), (v0, v1) = surface.domain
    sides = set()
    for edge in edges:
        curve = BRepAdaptor_Curve2d(edge, face)
        low, high = curve.FirstParameter(), curve.LastParameter()
        ends = np.array([curve.Value(t).Coord() for t in (low, 0.5 * (low + high), high)])
        for axis, (bottom, top) in enumerate(((u0, u1), (v0, v1))):
            span = top - bottom
            for side, bound in enumerate((bottom, top)):
                if (np.abs(ends[:, axis] - bound) < BORDER_FRACTION * span).all():
                    sides.add((axis, side))
    return len(sides) == 4


def _planar_face_moments(face: TopoDS_Face, plane: Geom_Plane, nodes_of: EdgeNodeCache) -> Array:
    """Moments of a planar face from the curves of its edges: (5,)."""
    frame = plane.Pln().Position()
    x_axis, y_axis = (np.array(d.Coord()) for d in (frame.XDirection(), frame.YDirection()))
    origin = np.array(frame.Location().Coord())
    m = np.zeros(3)  # integrals of 1, u and v
    face_sign = orientation_sign(face)  # the edges of a reversed face are reversed too
    for edge in edges_of(face):
        nodes, sign = nodes_of(edge)
        u, v = (nodes.points - origin) @ x_axis, (nodes.points - origin) @ y_axis
        m += np.stack([u, u**2 / 2, u * v]) @ (face_sign * sign * nodes.weights * (nodes.tangents @ y_axis))
    height = origin @ np.cross(x_axis, y_axis)
    first = m[0] * origin + m[1] * x_axis + m[2] * y_axis
    return np.concatenate([[m[0], height * m[0] / 3.0], height * first / 4.0])


def _occt_face_moments(face: TopoDS_Face) -> Array:
    """Moments by OCCT's adaptive quadrature, over the forward orientation of the face: (5,)."""
    forward = convert.as_face(face.Oriented(TopAbs_FORWARD))
    area = GProp_GProps()
    BRepGProp.SurfaceProperties_s(forward, area, OCCT_QUADRATURE_REL_TOL)
    # VolumeProperties of a single face chooses its own reference point; Vinert uses the given one.
    domain = BRepGProp_Domain(forward)
    cone = BRepGProp_Vinert(BRepGProp_Face(forward), domain, gp_Pnt(0.0, 0.0, 0.0), OCCT_QUADRATURE_REL_TOL)
    volume = cone.Mass()
    centre = np.array(cone.CentreOfMass().Coord()) * volume if volume else np.zeros(3)
    return np.array([area.Mass(), volume, *centre])
