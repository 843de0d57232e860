"""tpmscad infill"""

from __future__ import annotations

from typing import Annotated, Any

import typer

from tpmscad.cli.options import (
    Cell,
    Kind,
    Offset,
    Output,
    Phase,
    Quiet,
    Reference,
    Report,
    Schema,
    Side,
    StepFile,
    Surface,
    Thickness,
    Tol,
    VolumeFraction,
    numbers,
)
from tpmscad.cli.output import STEP_SUFFIXES, progress_bar, reported, writable, write_model, write_report

Rotation = Annotated[
    Any, typer.Option(parser=numbers, metavar="X,Y,Z", help="Degrees by which the lattice is turned about x, y, z.")
]
Skin = Annotated[float | None, typer.Option(metavar="MM", help="Thickness of a wall kept all around the body, mm.")]


def infill(
    body: StepFile,
    surface: Surface,
    cell: Cell,
    output: Output,
    thickness: Thickness = None,
    offset: Offset = None,
    volume_fraction: VolumeFraction = None,
    skin: Skin = None,
    tol: Tol = None,
    kind: Kind = "sheet",
    side: Side = "-",
    reference: Reference = None,
    phase: Phase = "0,0,0",
    rotation: Rotation = "0,0,0",
    schema: Schema = "ap242",
    report: Report = None,
    quiet: Quiet = False,
) -> None:
    """Fill the solid in a STEP file with a lattice, anchored at the origin of the file's coordinates."""
    writable(output, STEP_SUFFIXES)
    with reported(report):
        from tpmscad import parts

        with progress_bar(f"{surface} infill", quiet) as progress:
            model = parts.infill(
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
