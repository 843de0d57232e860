"""tpmscad infill"""

from __future__ import annotations

from typing import Annotated, Any

import typer

from tpmscad.cli.options import (
    CellOption,
    KindOption,
    OffsetOption,
    OutputOption,
    PhaseOption,
    QuietOption,
    ReferenceOption,
    ReportOption,
    SchemaOption,
    SideOption,
    StepFileArgument,
    SurfaceArgument,
    ThicknessOption,
    TolOption,
    VolumeFractionOption,
    parse_numbers,
)
from tpmscad.cli.output import (
    STEP_SUFFIXES,
    check_writable,
    progress_bar,
    report_unmet_request,
    write_model,
    write_report,
)

RotationOption = Annotated[
    Any,
    typer.Option(parser=parse_numbers, metavar="X,Y,Z", help="Degrees by which the lattice is turned about x, y, z."),
]
SkinOption = Annotated[
    float | None, typer.Option(metavar="MM", help="Thickness of a wall kept all around the body, mm.")
]


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
    """Fill the solid in a STEP file with a lattice, anchored at the origin of the file's coordinates."""
    check_writable(output, STEP_SUFFIXES)
    with report_unmet_request(report):
        from tpmscad import workflows

        with progress_bar(f"{surface} infill", quiet) as progress:
            model = workflows.infill(
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
            )
            write_model(model, output, progress, schema=schema)
        write_report(report, model.certificate.to_dict())
    if not quiet:
        print(model.certificate)
