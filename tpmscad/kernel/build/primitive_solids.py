"""Exact solids of the kernel: the primitive regions of fields (a box, a ball, a cylinder with ends), and bodies of revolution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeWire
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeRevol, BRepPrimAPI_MakeSphere
from OCP.GC import GC_MakeArcOfCircle
from OCP.gp import gp_Ax1, gp_Ax2, gp_Dir, gp_Pnt
from OCP.TopoDS import TopoDS_Edge, TopoDS_Shape

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.fields.kinds.primitive_regions import BoxRegion, CylinderRegion, SphereRegion

PrimitiveRegion = BoxRegion | SphereRegion | CylinderRegion
"""Regions of `tpmscad.fields` that stand for the solids they describe."""


def make_region_solid(region: PrimitiveRegion) -> TopoDS_Shape:
    """The solid of a finite primitive region; InvalidRequest if the region is infinite."""
    if isinstance(region, BoxRegion):
        if not np.isfinite([region.lo, region.hi]).all():
            raise InvalidRequest(f"the box from {list(region.lo)} to {list(region.hi)} is infinite: give every corner")
        return BRepPrimAPI_MakeBox(gp_Pnt(*region.lo), gp_Pnt(*region.hi)).Solid()
    if isinstance(region, SphereRegion):
        return BRepPrimAPI_MakeSphere(gp_Pnt(*region.center), region.radius).Solid()
    if region.height is None:
        raise InvalidRequest("the cylinder has no ends: give its height")
    foot = np.subtract(region.center, np.multiply(region.axis, region.height / 2))
    axes = gp_Ax2(gp_Pnt(*foot.tolist()), gp_Dir(*region.axis))
    return BRepPrimAPI_MakeCylinder(axes, region.radius, region.height).Solid()


def revolve_profile(sides: Array, straight: Sequence[bool], origin: Array, axis: Array, angle: float) -> TopoDS_Shape:
    """The solid that a profile sweeps when it turns by `angle` (radians, at most 2 pi) about a line.

    sides (n, 3, 3): start, middle and end of each side, in order and closed; where not `straight`, an arc of a circle. The
    profile lies in a plane with the line through `origin` along `axis`. KernelError if the kernel makes no solid of it.
    """
    wire = BRepBuilderAPI_MakeWire()
    for points, is_straight in zip(sides, straight, strict=True):
        wire.Add(_make_side(points, is_straight))
    face = BRepBuilderAPI_MakeFace(wire.Wire(), True)
    line = gp_Ax1(gp_Pnt(*origin.tolist()), gp_Dir(*axis.tolist()))
    full = angle >= 2 * np.pi
    revolution = BRepPrimAPI_MakeRevol(face.Face(), line) if full else BRepPrimAPI_MakeRevol(face.Face(), line, angle)
    if not revolution.IsDone():
        raise KernelError("revolution of a profile", "not done", face.Face())
    return revolution.Shape()


def _make_side(points: Array, straight: bool) -> TopoDS_Edge:
    start, middle, end = (gp_Pnt(*p) for p in points.tolist())
    if straight:
        return BRepBuilderAPI_MakeEdge(start, end).Edge()
    return BRepBuilderAPI_MakeEdge(GC_MakeArcOfCircle(start, middle, end).Value()).Edge()
