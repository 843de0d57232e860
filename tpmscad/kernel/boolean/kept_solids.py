"""Solids that are kept in a body: grown beyond the faces that they share with it, so that cuts are transversal; and its holes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakePrism
from OCP.GeomAbs import GeomAbs_Cylinder, GeomAbs_Plane
from OCP.gp import gp_Ax2, gp_Cylinder, gp_Dir, gp_Pnt, gp_Vec
from OCP.TopAbs import TopAbs_ON
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.kernel.boolean.boolean_operations import estimate_volume, intersect_solids, merge_faces
from tpmscad.kernel.boolean.hollow_body import outward_plane
from tpmscad.kernel.boolean.solid_trees import SolidSet, combine_sets, list_solids
from tpmscad.kernel.measure.shape_sampling import interior_points
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import faces_of, orientation_sign
from tpmscad.rigid_motion import Motion

GROWTH = 0.05
"""Of a solid's size: how far it is grown beyond a face that it shares with a body."""

INSET = 0.37
"""Of that length: how deep in the solid what is added begins."""

VOLUME_RTOL = 1e-6
"""Of volumes that must be equal, of few faces, by the kernel."""

FULL_TURN_RTOL = 1e-6
"""Of a full turn: what the faces of a hole may miss of it together."""


SEAM_ANGLE = 1.0
"""Radians by which the seam of what is kept round a hole is turned, lest it meet seams of coaxial faces."""


@dataclass(frozen=True, slots=True, eq=False)
class Hole:
    """A round hole: a point (3,) of its axis, the unit direction (3,), the radius, and its ends along the axis."""

    point: Array
    axis: Array
    radius: float
    low: float
    high: float

    def grow(self, width: float) -> TopoDS_Solid:
        """The cylinder that reaches a width beyond the hole all round."""
        start = gp_Pnt(*(self.point + (self.low - width) * self.axis).tolist())
        frame = gp_Ax2(start, gp_Dir(*self.axis.tolist()))
        frame.Rotate(frame.Axis(), SEAM_ANGLE)
        return BRepPrimAPI_MakeCylinder(frame, self.radius + width, self.high - self.low + 2 * width).Solid()


def find_holes(solid: TopoDS_Solid) -> tuple[Hole, ...]:
    """The round holes of a solid, through or blind: its concave cylinders that go all round."""
    parts: list[tuple[Hole, float]] = []
    for face in faces_of(solid):
        surface = BRepAdaptor_Surface(face)
        cylinder = _find_bore(face, surface)
        if cylinder is None:
            continue
        axis = np.array(cylinder.Axis().Direction().Coord())
        axis *= np.sign(axis[np.abs(axis).argmax()])
        point = np.array(cylinder.Location().Coord())
        ends = [axis @ np.array(surface.Value(surface.FirstUParameter(), v).Coord()) for v in _v_range(surface)]
        foot = point - (point @ axis) * axis
        turn = surface.LastUParameter() - surface.FirstUParameter()
        parts.append((Hole(foot, axis, cylinder.Radius(), min(ends), max(ends)), turn))
    return tuple(_join_round(parts))


def _find_bore(face: TopoDS_Face, surface: BRepAdaptor_Surface) -> gp_Cylinder | None:
    """The cylinder of a face on the surface of a bore; None for other faces, those of shafts included."""
    if surface.GetType() != GeomAbs_Cylinder:
        return None
    cylinder = surface.Cylinder()
    return None if (orientation_sign(face) > 0) == cylinder.Position().Direct() else cylinder


def _v_range(surface: BRepAdaptor_Surface) -> tuple[float, float]:
    return surface.FirstVParameter(), surface.LastVParameter()


def _join_round(parts: list[tuple[Hole, float]]) -> Iterator[Hole]:
    """Parts of one cylinder and the same length, where they go all round together."""
    while parts:
        first, turn = parts.pop()
        for other in [p for p in parts if _is_same(first, p[0])]:
            turn += other[1]
            parts.remove(other)
        if turn >= 2 * np.pi * (1 - FULL_TURN_RTOL):
            yield first


def _is_same(first: Hole, other: Hole) -> bool:
    values = [np.r_[h.point, h.axis, h.radius, h.low, h.high] for h in (first, other)]
    return bool(np.abs(values[0] - values[1]).max() < 10 * CONFUSION_TOLERANCE)


def grow_beyond(kept: TopoDS_Solid, body: TopoDS_Solid) -> TopoDS_Solid | None:
    """A solid within a body, grown beyond the faces that it shares with it; the part of both in the body is the same.

    None if it reaches beyond the body already, shares no face, or is not grown so: planes and whole cylinders of holes are.
    """
    if abs(_common_volume(kept, body) / estimate_volume(kept) - 1) > VOLUME_RTOL:
        return None
    reach, added = GROWTH * box_diagonal(kept), []
    classify = BRepClass3d_SolidClassifier(body)
    faces = faces_of(kept)
    for face, point in zip(faces, interior_points(faces), strict=True):
        classify.Perform(convert.point(point), CONFUSION_TOLERANCE)
        if classify.State() == TopAbs_ON:
            grown = _grow_face(face, reach)
            if grown is None:
                return None
            added.append(SolidSet(grown))
    if not added:
        return None
    # what is added begins in the solid, so that no edge is left in the faces of the body
    beyond = combine_sets(-1, added)
    core = combine_sets(+1, [SolidSet(kept), SolidSet(beyond.shape, complement=True)])
    solids = list_solids(merge_faces(combine_sets(-1, [core, beyond]).shape))
    if len(solids) != 1 or abs(_common_volume(solids[0], body) / estimate_volume(kept) - 1) > VOLUME_RTOL:
        return None
    return solids[0]


def _grow_face(face: TopoDS_Face, reach: float) -> TopoDS_Shape | None:
    """What lies before a plane face up to a distance, or within a face that goes round a hole; None before others."""
    surface = BRepAdaptor_Surface(face)
    if surface.GetType() == GeomAbs_Plane:
        out = outward_plane(face).normal
        inside = convert.transform_shape(face, Motion(np.eye(3), -INSET * reach * out))
        return BRepPrimAPI_MakePrism(inside, gp_Vec(*((1 + INSET) * reach * out).tolist())).Shape()
    cylinder = _find_bore(face, surface)
    if cylinder is None:
        return None
    low, high = _v_range(surface)
    axis = cylinder.Position()
    start = axis.Location().Translated(gp_Vec(axis.Direction()).Multiplied(low - reach))
    frame = gp_Ax2(start, axis.Direction())
    return BRepPrimAPI_MakeCylinder(frame, cylinder.Radius(), high - low + 2 * reach).Solid()


def _common_volume(first: TopoDS_Solid, second: TopoDS_Solid) -> float:
    """The volume that two solids of few faces have in common."""
    return sum(map(estimate_volume, intersect_solids(first, second)))
