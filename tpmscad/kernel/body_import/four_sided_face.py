"""Charts of four-sided faces of a CAD part: points of the face as a function of two parameters from 0 to 1.

The four sides are curves in the parameter plane of the face's surface. A bilinearly blended Coons patch of them fills the region
that they bound, so that its image lies on the surface exactly, whatever surface it is. On a face that is a whole patch of its
surface the chart is the surface's own parametrisation. A face that closes on itself, as a whole
cylinder does, has its seam as two sides.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepTools import BRepTools, BRepTools_WireExplorer
from OCP.TopAbs import TopAbs_FACE, TopAbs_WIRE
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import list_subshapes, orientation_sign, require_shape

N_SIDES = 4


class FourSidedFace:
    """The chart of a four-sided face: called with s (n,) and t (m,), it returns points (n, m, 3) on their grid."""

    def __init__(self, face: Any, name: str) -> None:
        self._face = _single_face(face, name)
        self._surface = BRepAdaptor_Surface(self._face)
        self._sides = _list_sides(self._face, name)

    def __call__(self, s: Array, t: Array) -> Array:
        """Points (n, m, 3) at the grid of s and t, each from 0 to 1."""
        lower, right, upper, left = self._sides
        a, b = _points(lower, s)[:, None], _points(upper, 1 - s)[:, None]
        c, d = _points(left, 1 - t)[None], _points(right, t)[None]
        u, v = s[:, None, None], t[None, :, None]
        corners = np.stack([_points(side, np.zeros(1))[0] for side in self._sides])
        p00, p10, p11, p01 = (corner[None, None] for corner in corners)
        bilinear = (1 - u) * (1 - v) * p00 + u * (1 - v) * p10 + (1 - u) * v * p01 + u * v * p11
        plane = (1 - v) * a + v * b + (1 - u) * c + u * d - bilinear
        flat = plane.reshape(-1, 2)
        points = [self._surface.Value(float(x), float(y)) for x, y in flat]
        return np.array([(p.X(), p.Y(), p.Z()) for p in points]).reshape(len(s), len(t), 3)


def _single_face(face: Any, name: str) -> TopoDS_Face:
    """The face of a build123d or CadQuery object, a TopoDS face, or a shape or workplane that holds a single one."""
    if hasattr(face, "vals"):  # a CadQuery Workplane
        values = face.vals()
        face = values[0] if len(values) == 1 else face
    faces = list_subshapes(require_shape(face), TopAbs_FACE)
    if len(faces) != 1:
        raise InvalidRequest(f"{name} holds {len(faces)} faces: give one face of the part")
    return convert.as_face(faces[0])


def _list_sides(face: TopoDS_Face, name: str) -> list[tuple[Any, float, float]]:
    """The parameter curves of the four sides around the face, each with the parameters of its start and end."""
    wires = list_subshapes(face, TopAbs_WIRE)
    if len(wires) != 1:
        raise InvalidRequest(f"{name} has {len(wires) - 1} holes: a map needs a face of four sides without a hole")
    sides = []
    explorer = BRepTools_WireExplorer(BRepTools.OuterWire_s(face), face)
    while explorer.More():
        edge = explorer.Current()
        if not BRep_Tool.Degenerated_s(edge):
            curve = BRep_Tool.CurveOnSurface_s(edge, face, 0.0, 1.0)
            low, high = BRep_Tool.Range_s(edge, face)
            sides.append((curve, low, high) if orientation_sign(edge) > 0 else (curve, high, low))
        explorer.Next()
    if len(sides) != N_SIDES:
        raise InvalidRequest(
            f"{name} has {len(sides)} edges: a map needs a face of {N_SIDES} sides; split or join its edges in the CAD system"
        )
    return sides


def _points(side: tuple[Any, float, float], fractions: Array) -> Array:
    """Points (n, 2) in the parameter plane at fractions (n,) of a side."""
    curve, start, end = side
    points = [curve.Value(float(x)) for x in start + (end - start) * fractions]
    return np.array([(p.X(), p.Y()) for p in points])
