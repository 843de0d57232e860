"""STEP files by the kernel's own writer, and solids after the kernel's healing: for what our writer cannot bring across."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from OCP.ShapeFix import ShapeFix_Shape
from OCP.TopoDS import TopoDS_Solid

from tpmscad.atomic_file import atomic_write
from tpmscad.errors import KernelError
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.occt.exploration import solids_of
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.kernel.step.step_reader import silence_occt
from tpmscad.kernel_wheels import explained_load_failure


def write_with_kernel(solids: Sequence[NamedSolid], path: Path, name: str, verify: Callable[[Path], None]) -> None:
    """Write solids under their names, without labels and colours of faces; no file is left if `verify` raises."""
    with explained_load_failure("build123d"):
        import build123d  # imported here: it takes seconds, and hardly any file needs this writer

    named = [build123d.Solid(of.solid, label=of.name) for of in solids]
    whole = named[0] if len(named) == 1 else build123d.Compound(label=name, children=named)
    with atomic_write(path) as aside, silence_occt():
        if not build123d.export_step(whole, aside):
            raise KernelError("export_step", "the kernel's writer wrote no file")
        verify(aside)


def heal_solid(solid: TopoDS_Solid, precision: float) -> TopoDS_Solid:
    """The solid after the kernel's healing with gaps up to `precision` in model units; KernelError if it is no valid solid."""
    fix = ShapeFix_Shape(solid)
    fix.SetPrecision(precision)
    fix.SetMaxTolerance(precision)
    fix.Perform()
    healed = solids_of(fix.Shape())
    if len(healed) != 1 or not is_valid(healed[0]):
        raise KernelError("healing", f"the solid stays invalid with gaps up to {precision:g} mm closed", solid)
    return healed[0]
