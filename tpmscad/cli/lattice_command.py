"""tpmscad lattice"""

from __future__ import annotations

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
from tpmscad.cli.output import (
    STEP_SUFFIXES,
    check_writable,
    progress_bar,
    report_unmet_request,
    write_model,
    write_report,
)


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
    """Make a lattice of a minimal surface, filling the box from the origin to CELLS x CELL, as a STEP file."""
    check_writable(output, STEP_SUFFIXES)
    with report_unmet_request(report):
        from tpmscad.workflows import lattice_solid

        with progress_bar(f"{surface} lattice", quiet) as progress:
            model = lattice_solid.lattice(
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
            )
            write_model(model, output, progress, instanced=instanced, schema=schema)
        write_report(report, model.certificate.to_dict())
    if not quiet:
        print(model.certificate)
