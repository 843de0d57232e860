"""Unions and intersections of solids and of their complements, by the kernel's general fuse.

A complement is kept as a flag, and De Morgan's laws bring every combination to fuses and cuts of many solids in one operation:
the intersection of a solid with the complements of others is a cut by their union. Half-spaces are blocks beside the box.
Many solids are united in groups of which no two members touch: curves within the union are left out before others cross them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from OCP.Bnd import Bnd_OBB
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeSphere
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.TopoDS import TopoDS_Shape, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.errors import KernelError
from tpmscad.fields.analysis.outermost_extremes import combine_complements
from tpmscad.kernel.boolean.boolean_operations import sort_by_volume, translate_occt_errors
from tpmscad.kernel.boolean.sphere_frames import ACROSS, SKEW
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import solids_of

REACH, REACH_STEP = 1.5, 0.013
"""In diagonals of the box: how far half-spaces reach from its middle, and what every other reaches more."""

END, END_STEP = 0.1, 0.013
"""In radii: how far a cylinder at least goes on beyond the box, and what every other goes more. Ends 1.5 diagonals beyond it met
others there, which took 4 of 17 s for 76 struts."""


@dataclass(frozen=True, slots=True, eq=False)
class SolidSet:
    """The points of a shape, or those outside it if `complement` is set."""

    shape: TopoDS_Shape
    complement: bool = False


def make_quadric_set(
    kind: str,
    point: Array,
    axis: Array,
    radius: float,
    lo: Array,
    hi: Array,
    number: int,
    frame: tuple[Array, Array] = (np.array(SKEW), np.array(ACROSS)),
) -> SolidSet:
    """A half-space, ball or endless cylinder, as far as it reaches in a box; kinds "plane", "sphere", "cylinder".

    The shape of a half-space is a block behind the plane. `number` makes the far ends of all different. frame:
    directions of the poles and of the seam of a sphere (`choose_sphere_frame`).
    """
    reach = (REACH + REACH_STEP * number) * float(np.linalg.norm(hi - lo))
    if kind == "sphere":
        poles, seam = (gp_Dir(*direction.tolist()) for direction in frame)
        return SolidSet(BRepPrimAPI_MakeSphere(gp_Ax2(gp_Pnt(*point.tolist()), poles, seam), radius).Solid())
    middle = 0.5 * (lo + hi)
    along = float((middle - point) @ axis)
    direction = gp_Dir(*axis.tolist())
    if kind == "cylinder":
        first, last = _clip_axis(point, axis, lo - radius, hi + radius) or (along - reach, along + reach)
        first, last = (end + side * (END + END_STEP * number) * radius for end, side in ((first, -1), (last, +1)))
        start = point + first * axis
        frame = gp_Ax2(gp_Pnt(*start.tolist()), direction, gp_Dir(*np.cross(axis, _skew_to(axis)).tolist()))
        return SolidSet(BRepPrimAPI_MakeCylinder(frame, radius, last - first).Solid())
    foot = middle - along * axis
    frame = gp_Ax2(gp_Pnt(*foot.tolist()), direction)
    across = sum(np.array(d.Coord()) for d in (frame.XDirection(), frame.YDirection()))
    corner = foot - reach * axis - reach * across
    return SolidSet(
        BRepPrimAPI_MakeBox(
            gp_Ax2(gp_Pnt(*corner.tolist()), direction, frame.XDirection()), 2 * reach, 2 * reach, reach
        ).Solid()
    )


def _clip_axis(point: Array, axis: Array, lo: Array, hi: Array) -> tuple[float, float] | None:
    """The ends of a line in a box, as distances from its point; None if it misses the box."""
    across = axis == 0
    if ((point < lo) | (point > hi))[across].any():
        return None
    at = np.sort(np.stack([lo - point, hi - point])[:, ~across] / axis[~across], axis=0)
    first, last = float(at[0].max()), float(at[1].min())
    return (first, last) if first < last else None


def _skew_to(axis: Array) -> Array:
    """A direction that is neither along an axis nor along this one."""
    first, second = np.array(SKEW), np.array(ACROSS)
    return first if abs(first @ axis) < abs(second @ axis) else second


def combine_sets(sign: int, sets: Sequence[SolidSet]) -> SolidSet:
    """The intersection (sign +1) or union (-1) of sets; KernelError if the kernel fails."""
    pairs = [(each.shape, each.complement) for each in sets]
    return SolidSet(*combine_complements(sign, pairs, _unite, _intersect, _subtract))


def _unite(shapes: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    """The union of shapes: of groups whose members are apart from each other, two at a time."""
    united = group_apart(shapes)
    while len(united) > 1:
        pairs = zip(united[::2], united[1::2], strict=False)
        united = [*(_run(BRepAlgoAPI_Fuse, [a], [b]) for a, b in pairs), *united[len(united) - len(united) % 2 :]]
    return united[0]


def group_apart(shapes: Sequence[TopoDS_Shape]) -> list[TopoDS_Shape]:
    """Shapes as few compounds, in each of which their oriented bounding boxes are apart from each other."""
    groups: list[list[tuple[TopoDS_Shape, Bnd_OBB]]] = []
    for shape in shapes:
        box = Bnd_OBB()
        BRepBndLib.AddOBB_s(shape, box)
        box.Enlarge(convert.CONFUSION_TOLERANCE)
        for group in groups:
            if all(box.IsOut(other) for _, other in group):
                group.append((shape, box))
                break
        else:
            groups.append([(shape, box)])
    return [group[0][0] if len(group) == 1 else make_compound([shape for shape, _ in group]) for group in groups]


def _intersect(shapes: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    return reduce(lambda first, other: _run(BRepAlgoAPI_Common, [first], [other]), shapes)


def _subtract(shape: TopoDS_Shape, taken: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    return _run(BRepAlgoAPI_Cut, [shape], [_unite(taken)]) if taken else shape


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
