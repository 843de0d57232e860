"""tpmscad lattice: a lattice of a minimal surface in a box."""

from __future__ import annotations

from tpmscad import workflows
from tpmscad.cli.options import (
    BoundaryOption,
    CellOption,
    CellsOption,
    InstancedOption,
    KindOption,
    OffsetOption,
    OutputOption,
    PhaseOption,
    QuietOption,
    ReferenceOption,
    ReportOption,
    SchemaOption,
    SideOption,
    SurfaceArgument,
    ThicknessOption,
    TolOption,
    VolumeFractionOption,
)
from tpmscad.cli.output import make_and_write


def lattice(
    surface: SurfaceArgument,
    cell: CellOption,
    output: OutputOption,
    cells: CellsOption = "1,1,1",
    thickness: ThicknessOption = None,
    offset: OffsetOption = None,
    volume_fraction: VolumeFractionOption = None,
    tol: TolOption = None,
    kind: KindOption = "sheet",
    side: SideOption = "-",
    reference: ReferenceOption = None,
    boundary: BoundaryOption = "box",
    phase: PhaseOption = "0,0,0",
    instanced: InstancedOption = False,
    schema: SchemaOption = "ap242",
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Make a lattice of a minimal surface that fills the box from the origin to CELLS x CELL, and write it as STEP."""
    make_and_write(
        f"{surface} lattice",
        lambda progress: workflows.lattice(
            surface,
            cell=cell,
            cells=cells,
            thickness=thickness,
            offset=offset,
            volume_fraction=volume_fraction,
            tol=tol,
            kind=kind,
            side=side,
            reference=reference,
            boundary=boundary,
            phase=phase,
            progress=progress,
        ),
        output,
        report=report,
        quiet=quiet,
        instanced=instanced,
        schema=schema,
    )
