"""Unions and intersections of solids and of their complements, by the kernel's general fuse.

A complement is kept as a flag, and De Morgan's laws bring every combination to fuses and cuts of many solids in one operation:
the intersection of a solid with the complements of others is a cut by all of them at once. Half-spaces are blocks beside the box.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeSphere
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.TopoDS import TopoDS_Shape, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.errors import KernelError
from tpmscad.fields.analysis.outermost_extremes import combine_complements
from tpmscad.kernel.boolean.boolean_operations import sort_by_volume, translate_occt_errors
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import solids_of

REACH, REACH_STEP = 1.5, 0.013
"""In diagonals of the box: how far cylinders and half-spaces reach from its middle, and what every other reaches more."""


SKEW, ACROSS = (0.6120, 0.2391, 0.7538), (0.7712, -0.4386, -0.4614)
"""Direction of the poles of spheres, and of their seams: planes along axes and diagonals meet neither."""


@dataclass(frozen=True, slots=True, eq=False)
class SolidSet:
    """The points of a shape, or those outside it if `complement` is set."""

    shape: TopoDS_Shape
    complement: bool = False


def make_quadric_set(
    kind: str, point: Array, axis: Array, radius: float, lo: Array, hi: Array, number: int
) -> SolidSet:
    """A half-space, ball or endless cylinder, as far as it reaches in a box; kinds "plane", "sphere", "cylinder".

    The shape of a half-space is a block behind the plane. `number` makes the far ends of all different.
    """
    reach = (REACH + REACH_STEP * number) * float(np.linalg.norm(hi - lo))
    if kind == "sphere":
        return SolidSet(
            BRepPrimAPI_MakeSphere(gp_Ax2(gp_Pnt(*point.tolist()), gp_Dir(*SKEW), gp_Dir(*ACROSS)), radius).Solid()
        )
    middle = 0.5 * (lo + hi)
    along = float((middle - point) @ axis)
    direction = gp_Dir(*axis.tolist())
    if kind == "cylinder":
        start = point + (along - reach) * axis
        frame = gp_Ax2(gp_Pnt(*start.tolist()), direction, gp_Dir(*np.cross(axis, _skew_to(axis)).tolist()))
        return SolidSet(BRepPrimAPI_MakeCylinder(frame, radius, 2 * reach).Solid())
    foot = middle - along * axis
    frame = gp_Ax2(gp_Pnt(*foot.tolist()), direction)
    across = sum(np.array(d.Coord()) for d in (frame.XDirection(), frame.YDirection()))
    corner = foot - reach * axis - reach * across
    return SolidSet(
        BRepPrimAPI_MakeBox(
            gp_Ax2(gp_Pnt(*corner.tolist()), direction, frame.XDirection()), 2 * reach, 2 * reach, reach
        ).Solid()
    )


def _skew_to(axis: Array) -> Array:
    """A direction that is neither along an axis nor along this one."""
    first, second = np.array(SKEW), np.array(ACROSS)
    return first if abs(first @ axis) < abs(second @ axis) else second


def combine_sets(sign: int, sets: Sequence[SolidSet]) -> SolidSet:
    """The intersection (sign +1) or union (-1) of sets; KernelError if the kernel fails."""
    pairs = [(each.shape, each.complement) for each in sets]
    return SolidSet(*combine_complements(sign, pairs, _unite, _intersect, _subtract))


def _unite(shapes: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    return _run(BRepAlgoAPI_Fuse, shapes[:1], shapes[1:])


def _intersect(shapes: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    return reduce(lambda first, other: _run(BRepAlgoAPI_Common, [first], [other]), shapes)


def _subtract(shape: TopoDS_Shape, taken: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    return _run(BRepAlgoAPI_Cut, [shape], taken)


def make_box_set(lo: Array, hi: Array) -> SolidSet:
    """A box along the axes."""
    return SolidSet(BRepPrimAPI_MakeBox(gp_Pnt(*lo.tolist()), gp_Pnt(*hi.tolist())).Solid())


def list_solids(shape: TopoDS_Shape) -> tuple[TopoDS_Solid, ...]:
    """The solids of a shape, largest first."""
    return sort_by_volume(solids_of(shape))


def _run(kind: Callable[[], Any], arguments: Sequence[TopoDS_Shape], tools: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    """One operation of the general fuse; the first argument if there are no tools."""
    if not tools:
        return arguments[0]
    name = "combination of solids"
    with translate_occt_errors(name, arguments[0]):
        operation = kind()
        operation.SetArguments(convert.shape_list(arguments))
        operation.SetTools(convert.shape_list(tools))
        operation.SetNonDestructive(True)
        operation.Build()
        if not operation.IsDone() or operation.Shape().IsNull():
            raise KernelError(name, "the kernel's Boolean operation failed", arguments[0])
        return operation.Shape()
