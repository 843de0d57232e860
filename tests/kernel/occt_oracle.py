"""The kernel's own ways to do what tpmscad does otherwise: for tests and benchmarks to compare with, not used by the program."""

from __future__ import annotations

from collections.abc import Iterable

from OCP.BRepAlgoAPI import BRepAlgoAPI_Common
from OCP.BRepBuilderAPI import BRepBuilderAPI_Sewing
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox
from OCP.TopAbs import TopAbs_SHELL
from OCP.TopoDS import TopoDS_Shape

from tpmscad._typing import Array
from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_solid
from tpmscad.kernel.occt.exploration import list_subshapes


def intersect_with_box(shape: TopoDS_Shape, low: Array, high: Array) -> TopoDS_Shape:
    """The part of a solid in a box, by the kernel's boolean. KernelError if it gives up."""
    operation = BRepAlgoAPI_Common(shape, BRepPrimAPI_MakeBox(convert.point(low), convert.point(high)).Shape())
    if not operation.IsDone():
        raise KernelError("common with a box", "BRepAlgoAPI_Common failed", shape)
    return operation.Shape()


def sew_solids(faces: Iterable[TopoDS_Shape], tolerance: float) -> tuple[TopoDS_Shape, ...]:
    """Solids of faces that share nothing, by sewing: one for each shell it makes, whichever way out."""
    sewing = BRepBuilderAPI_Sewing(tolerance)
    for face in faces:
        sewing.Add(face)
    sewing.Perform()
    return tuple(make_solid([convert.as_shell(s)]) for s in list_subshapes(sewing.SewedShape(), TopAbs_SHELL))
