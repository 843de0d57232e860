"""The edges at which faces of a solid meet at an angle: number and lengths, the sharpest wedge, and the curves they make."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d
from OCP.BRepGProp import BRepGProp_Face
from OCP.GCPnts import GCPnts_AbscissaPoint
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array
from tpmscad.fields.analysis.crease_network import count_curves
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, faces_of, first_vertex, last_vertex, orientation_sign

MIN_CREASE_DEG = 0.1
"""Angle between the normals of two faces from which their edge is a crease."""

N_SIDE_POINTS, IN_SIDE_TOL = 5, 1e-5
"""Points of an edge that lies in a side of a box, and their distances from it, model units, a hundred times OCCT's tolerance."""

LENGTH_TOL = 1e-6
"""Absolute error of a length, model units."""


@dataclass(frozen=True, slots=True)
class SolidCreases:
    """Number of creases, their whole length and the shortest, and the least angle of material at one, in degrees, to 360.

    Of those that do not lie in a side of the box: how many curves they make from corner to corner, and the length.
    """

    count: int
    length: float
    shortest: float
    sharpest_deg: float
    inner_curves: int
    inner_length: float


def measure_creases(solids: Any, box: tuple[Array, Array] | None = None) -> SolidCreases:
    """The creases of solids, by the normals of both faces in the middle of each edge; of a box, its corners (3,) are given."""
    uses: dict[ShapeKey, list[tuple[TopoDS_Edge, TopoDS_Face]]] = {}
    for solid in solids:
        for face in faces_of(solid):
            for edge in edges_of(face):
                uses.setdefault(ShapeKey(edge), []).append((edge, face))
    lengths, sharpest, ends, is_inner = [], 360.0, [], []
    vertices: dict[ShapeKey, int] = {}
    for pair in uses.values():
        if len(pair) != 2 or ShapeKey(pair[0][1]) == ShapeKey(pair[1][1]):  # a seam, or the edge of a pole
            continue
        (edge, first), (_, second) = pair
        n, m = _normal_in_middle(edge, first), _normal_in_middle(edge, second)
        turn = float(np.degrees(np.arctan2(np.linalg.norm(np.cross(n, m)), n @ m)))
        if turn < MIN_CREASE_DEG:
            continue
        curve, tangent = BRepAdaptor_Curve(edge), gp_Vec()
        curve.D1(0.5 * (curve.FirstParameter() + curve.LastParameter()), gp_Pnt(), tangent)
        # the first face lies on the left of its edge, seen from outside: at a convex edge the second normal turns to the right
        convex = np.cross(n, m) @ np.array(tangent.Coord()) * orientation_sign(edge) > 0
        sharpest = min(sharpest, 180.0 - turn if convex else 180.0 + turn)
        lengths.append(float(GCPnts_AbscissaPoint.Length_s(curve, LENGTH_TOL)))
        keys = [ShapeKey(end(edge)) for end in (first_vertex, last_vertex)]
        ends.append([vertices.setdefault(key, len(vertices)) for key in keys])
        is_inner.append(box is None or not _is_in_side(curve, *box))
    if not lengths:
        return SolidCreases(0, 0.0, 0.0, 180.0, 0, 0.0)
    inner = np.array(is_inner)
    return SolidCreases(
        len(lengths),
        sum(lengths),
        min(lengths),
        sharpest,
        count_curves(np.array(ends)[inner]),
        float(np.array(lengths)[inner].sum()),
    )


def _is_in_side(curve: BRepAdaptor_Curve, lo: Array, hi: Array) -> bool:
    """Whether an edge lies in a side of a box."""
    parameters = np.linspace(curve.FirstParameter(), curve.LastParameter(), N_SIDE_POINTS)
    points = np.array([curve.Value(t).Coord() for t in parameters.tolist()])
    return bool((np.abs(points[:, None] - np.stack([lo, hi])) < IN_SIDE_TOL).all(axis=0).any())


def _normal_in_middle(edge: TopoDS_Edge, face: TopoDS_Face) -> Array:
    """The outward unit normal of a face in the middle of one of its edges."""
    curve = BRepAdaptor_Curve2d(edge, face)
    at = curve.Value(0.5 * (curve.FirstParameter() + curve.LastParameter()))
    normal = gp_Vec()
    BRepGProp_Face(face, False).Normal(at.X(), at.Y(), gp_Pnt(), normal)
    found = np.array(normal.Coord())
    return found / max(float(np.linalg.norm(found)), 1e-300)
