"""tpmscad infill: a CAD body filled with a lattice."""

from __future__ import annotations

from tpmscad import workflows
from tpmscad.cli.options import (
    CellOption,
    KindOption,
    OffsetOption,
    OutputOption,
    PhaseOption,
    QuietOption,
    ReferenceOption,
    ReportOption,
    RotationOption,
    SchemaOption,
    SideOption,
    SkinOption,
    StepFileArgument,
    SurfaceArgument,
    ThicknessOption,
    TolOption,
    VolumeFractionOption,
)
from tpmscad.cli.output import make_and_write


def infill(
    body: StepFileArgument,
    surface: SurfaceArgument,
    cell: CellOption,
    output: OutputOption,
    thickness: ThicknessOption = None,
    offset: OffsetOption = None,
    volume_fraction: VolumeFractionOption = None,
    skin: SkinOption = None,
    tol: TolOption = None,
    kind: KindOption = "sheet",
    side: SideOption = "-",
    reference: ReferenceOption = None,
    phase: PhaseOption = "0,0,0",
    rotation: RotationOption = "0,0,0",
    schema: SchemaOption = "ap242",
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Fill the solid in a STEP file with a lattice that is anchored at the origin of the file's coordinates."""
    make_and_write(
        f"{surface} infill",
        lambda progress: workflows.infill(
            body,
            surface,
            cell=cell,
            thickness=thickness,
            offset=offset,
            volume_fraction=volume_fraction,
            skin=skin,
            tol=tol,
            kind=kind,
            side=side,
            reference=reference,
            phase=phase,
            rotation=rotation,
            progress=progress,
        ),
        output,
        report=report,
        quiet=quiet,
        schema=schema,
    )
