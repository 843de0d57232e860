"""The options and arguments that commands share, with their help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer


def parse_numbers(text: str) -> float | tuple[float, ...]:
    """One number, or several with commas between."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a number, nor numbers with commas between") from None
    return values if len(values) > 1 else values[0]


def complete_surface_name(incomplete: str) -> list[str]:
    """Names of the catalogue, for the shell's completion."""
    from tpmscad.catalogue import CATALOGUE

    return [name for name in CATALOGUE if name.startswith(incomplete)]


SurfaceArgument = Annotated[
    str, typer.Argument(autocompletion=complete_surface_name, help="Name of the surface, see `tpmscad surfaces`.")
]
CellOption = Annotated[
    Any,
    typer.Option(parser=parse_numbers, metavar="L|X,Y,Z", help="Edge length of the cell, mm, or one for each axis."),
]
CellsOption = Annotated[
    Any, typer.Option(parser=parse_numbers, metavar="N|X,Y,Z", help="Number of cells along every axis, or along each.")
]
ThicknessOption = Annotated[
    float | None, typer.Option(metavar="MM", help="Wall thickness along the normal, mm. This, or one of the next two.")
]
OffsetOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="LO,HI",
        help="Signed normal distances of the wall's two sides, mm; one distance for --kind skeletal.",
    ),
]
VolumeFractionOption = Annotated[
    float | None, typer.Option(metavar="0..1", help="Solid share of the whole cell, which sets the distances.")
]
TolOption = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Greatest deviation from the reference, mm.  [default: a thousandth of the cell]"),
]
KindOption = Annotated[
    Literal["sheet", "skeletal"], typer.Option(help="Between two offset surfaces, or on one side of one.")
]
SideOption = Annotated[Literal["+", "-"], typer.Option(help="Which side is solid, for --kind skeletal.")]
ReferenceOption = Annotated[
    Literal["minimal", "nodal"] | None,
    typer.Option(help="The exact minimal surface, the default where there is one, or the trigonometric one."),
]
BoundaryOption = Annotated[
    Literal["box", "natural"], typer.Option(help="Flat caps in the planes of the box, or whole patches bridged.")
]
PhaseOption = Annotated[
    Any, typer.Option(parser=parse_numbers, metavar="X,Y,Z", help="Shift of the lattice, in cells.")
]
InstancedOption = Annotated[bool, typer.Option("--instanced", help="Store one cell and place it, as an assembly.")]
SchemaOption = Annotated[Literal["ap242", "ap214"], typer.Option(help="STEP application protocol.")]
OutputOption = Annotated[Path, typer.Option("--output", "-o", metavar="FILE.step", help="The STEP file to write.")]
PictureOption = Annotated[Path, typer.Option("--output", "-o", metavar="FILE.png", help="The picture to write.")]
ReportOption = Annotated[Path | None, typer.Option(metavar="FILE.json", help="Write what was measured as JSON.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar and no summary.")]
StepFileArgument = Annotated[
    Path, typer.Argument(metavar="FILE.step", exists=True, dir_okay=False, help="A STEP file.")
]
MetricsOption = Annotated[
    bool, typer.Option("--metrics", help="Also volume fraction, surface, hydraulic diameter, smallest wall and pore.")
]
WithinOption = Annotated[
    Path | None,
    typer.Option(
        metavar="BODY.step",
        exists=True,
        dir_okay=False,
        help="Metrics within this body, instead of the box around all.",
    ),
]
