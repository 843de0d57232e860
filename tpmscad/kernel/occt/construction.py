"""Shells, solids and compounds from OCCT shapes that already share their edges and vertices."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from OCP.BRep import BRep_Builder
from OCP.TopAbs import TopAbs_SOLID
from OCP.TopoDS import TopoDS_Compound, TopoDS_Face, TopoDS_Shape, TopoDS_Shell, TopoDS_Solid

from tpmscad.kernel.occt import convert
from tpmscad.kernel_wheels import explained_load_failure


def make_compound(shapes: Iterable[TopoDS_Shape]) -> TopoDS_Compound:
    """Compound of the shapes."""
    builder, result = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(result)
    for shape in shapes:
        builder.Add(result, shape)
    return result


def make_shell(faces: Iterable[TopoDS_Face]) -> TopoDS_Shell:
    """Shell of the faces, flagged as closed without a check."""
    builder, shell = BRep_Builder(), TopoDS_Shell()
    builder.MakeShell(shell)
    for face in faces:
        builder.Add(shell, face)
    shell.Closed(True)
    return shell


def make_solid(shells: Iterable[TopoDS_Shell]) -> TopoDS_Solid:
    """Solid of an outer shell and the void shells inside it."""
    builder, solid = BRep_Builder(), TopoDS_Solid()
    builder.MakeSolid(solid)
    for shell in shells:
        builder.Add(solid, shell)
    return solid


def copy_placement(shape: TopoDS_Shape) -> Any:
    """The same solid or compound with a placement of its own: moving the result leaves `shape` where it is."""
    placed = shape.Located(shape.Location())
    return convert.as_solid(placed) if shape.ShapeType() == TopAbs_SOLID else convert.as_compound(placed)


def to_build123d(shape: TopoDS_Shape, solids: int) -> Any:
    """The shape as a build123d Solid, or as a Compound if it holds more than one solid; moving it leaves `shape` in place."""
    with explained_load_failure("build123d"):
        from build123d import Compound, Solid  # imported here: it takes seconds, and writing a file does not need it

    return Solid(copy_placement(shape)) if solids == 1 else Compound(copy_placement(shape))
