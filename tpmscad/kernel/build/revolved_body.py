"""Bodies of revolution as solids of the kernel: a closed profile of segments and arcs, turned about an axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeWire
from OCP.BRepPrimAPI import BRepPrimAPI_MakeRevol
from OCP.GC import GC_MakeArcOfCircle
from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt
from OCP.TopoDS import TopoDS_Edge, TopoDS_Shape

from tpmscad._typing import Array
from tpmscad.errors import KernelError


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
