"""The arguments and options of the commands, with their help texts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from tpmscad.catalogue import CATALOGUE


def parse_numbers(text: str) -> float | tuple[float, ...]:
    """One number, or a tuple of the numbers between commas."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is neither a number nor a list of numbers with commas between") from None
    return values if len(values) > 1 else values[0]


def complete_surface_name(incomplete: str) -> list[str]:
    """Names of the catalogue that begin so, for the completion of the shell."""
    return [name for name in CATALOGUE if name.startswith(incomplete)]


SurfaceArgument = Annotated[
    str, typer.Argument(autocompletion=complete_surface_name, help="Name of the surface; see `tpmscad surfaces`.")
]
CellOption = Annotated[
    Any,
    typer.Option(parser=parse_numbers, metavar="L|X,Y,Z", help="Edge length of the cell, or one for each axis, mm."),
]
CellsOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers, metavar="N|X,Y,Z", help="Number of cells along every axis, or along x, y and z."
    ),
]
ThicknessOption = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Wall thickness along the normal, mm. Give this or one of the next two."),
]
OffsetOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="LO,HI",
        help="Signed normal distances of the two sides of the wall, mm; one distance for --kind skeletal.",
    ),
]
VolumeFractionOption = Annotated[
    float | None,
    typer.Option(metavar="0..1", help="Solid fraction of the whole cell, from which the distances follow."),
]
TolOption = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Greatest deviation from the surface, mm.  [default: a thousandth of the cell]"),
]
KindOption = Annotated[
    Literal["sheet", "skeletal"],
    typer.Option(help="Solid between two surfaces, or on one side of one."),
]
SideOption = Annotated[Literal["+", "-"], typer.Option(help="Solid side, for --kind skeletal.")]
ReferenceOption = Annotated[
    Literal["minimal", "nodal"] | None,
    typer.Option(help="The exact minimal surface (the default if the catalogue has it), or the trigonometric one."),
]
BoundaryOption = Annotated[
    Literal["box", "natural"],
    typer.Option(help="Planar caps in the box, or whole patches bridged by gap faces."),
]
PhaseOption = Annotated[
    Any, typer.Option(parser=parse_numbers, metavar="X,Y,Z", help="Shift of the lattice, in cells.")
]
InstancedOption = Annotated[
    bool, typer.Option("--instanced", help="Store one cell and place it once for each, as an assembly.")
]
SchemaOption = Annotated[Literal["ap242", "ap214"], typer.Option(help="STEP application protocol.")]
OutputOption = Annotated[Path, typer.Option("--output", "-o", metavar="FILE.step", help="The STEP file to write.")]
PictureOption = Annotated[Path, typer.Option("--output", "-o", metavar="FILE.png", help="The picture to write.")]
ReportOption = Annotated[Path | None, typer.Option(metavar="FILE.json", help="Write the certificate as JSON.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress bar and no summary.")]
StepFileArgument = Annotated[
    Path, typer.Argument(metavar="FILE.step", exists=True, dir_okay=False, help="A STEP file.")
]
MetricsOption = Annotated[
    bool,
    typer.Option(
        "--metrics", help="Measure volume fraction, wetted surface, hydraulic diameter, smallest wall and pore, too."
    ),
]
WithinOption = Annotated[
    Path | None,
    typer.Option(
        metavar="BODY.step",
        exists=True,
        dir_okay=False,
        help="The body whose volume the metrics refer to; by default the bounding box.",
    ),
]
RotationOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers, metavar="X,Y,Z", help="Rotation of the lattice about x, then its own y and z, degrees."
    ),
]
SkinOption = Annotated[
    float | None, typer.Option(metavar="MM", help="Thickness of a solid wall kept along the boundary of the body, mm.")
]
RecipeArgument = Annotated[
    Path,
    typer.Argument(metavar="FILE.toml", exists=True, dir_okay=False, help="The recipe; see examples/*.toml."),
]
RecipeOutputOption = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="FILE.step", help="The STEP file to write.")
]
DryRunOption = Annotated[
    bool, typer.Option("--dry-run", help="Read and check the recipe; make no solid and write no STEP file.")
]
AllowErrorsOption = Annotated[
    bool, typer.Option("--allow-errors", help="Make the solid of a blend even if topological errors remain.")
]
