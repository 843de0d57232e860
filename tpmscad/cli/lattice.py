"""tpmscad lattice"""

from __future__ import annotations

from tpmscad.cli.options import (
    Boundary,
    Cell,
    Cells,
    Instanced,
    Kind,
    Offset,
    Output,
    Phase,
    Quiet,
    Reference,
    Report,
    Schema,
    Side,
    Surface,
    Thickness,
    Tol,
    VolumeFraction,
)
from tpmscad.cli.output import STEP_SUFFIXES, progress_bar, reported, writable, write_model, write_report


def lattice(
    surface: Surface,
    cell: Cell,
    output: Output,
    cells: Cells = "1,1,1",
    thickness: Thickness = None,
    offset: Offset = None,
    volume_fraction: VolumeFraction = None,
    tol: Tol = None,
    kind: Kind = "sheet",
    side: Side = "-",
    reference: Reference = None,
    boundary: Boundary = "box",
    phase: Phase = "0,0,0",
    instanced: Instanced = False,
    schema: Schema = "ap242",
    report: Report = None,
    quiet: Quiet = False,
) -> None:
    """Make a lattice of a minimal surface, filling the box from the origin to CELLS x CELL, as a STEP file."""
    writable(output, STEP_SUFFIXES)
    with reported(report):
        from tpmscad import workflows

        with progress_bar(f"{surface} lattice", quiet) as progress:
            model = workflows.lattice(
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
