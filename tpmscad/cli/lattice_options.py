"""The options that describe a lattice: its cell, its wall, where it lies, and what bounds it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import typer

from tpmscad.catalogue import CATALOGUE, find_surface
from tpmscad.cli.options import parse_numbers

CELL_PANEL = "Cell and position"
WALL_PANEL = "Wall: give one of --thickness, --offset, --volume-fraction, --porosity"
SKIN_PANEL = "Skin"


def complete_surface_name(incomplete: str) -> list[str]:
    """Names of the catalogue that begin so, for the completion of the shell."""
    return [name for name in CATALOGUE if name.startswith(incomplete)]


def check_surface_name(name: str) -> str:
    """The name, before anything else is loaded; InvalidRequest if the catalogue does not know it."""
    find_surface(name)
    return name


def parse_faces(text: str) -> tuple[str | int, ...]:
    """Numbers of faces, and selectors such as >Z, between commas."""
    return tuple(int(part) if part.isdigit() else part for part in text.replace(" ", "").split(","))


SurfaceArgument = Annotated[
    str,
    typer.Argument(
        autocompletion=complete_surface_name,
        callback=check_surface_name,
        help="Name of the surface; see `tpmscad surfaces`.",
    ),
]
CellOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="L|X,Y,Z",
        help="Edge length of the cell, or one for each axis, mm. Required, unless --pore-size is given.",
        rich_help_panel=CELL_PANEL,
    ),
]
CellsOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="N|X,Y,Z",
        help="Number of cells along every axis, or along x, y and z.",
        rich_help_panel=CELL_PANEL,
    ),
]
ThicknessOption = Annotated[
    float | None, typer.Option(metavar="MM", help="Wall thickness along the normal, mm.", rich_help_panel=WALL_PANEL)
]
OffsetOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="LO,HI",
        help="Signed normal distances of the two sides of the wall, mm; one distance for --kind skeletal.",
        rich_help_panel=WALL_PANEL,
    ),
]
SheetOffsetOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="LO,HI",
        help="Signed normal distances of the two sides of the wall, mm.",
        rich_help_panel=WALL_PANEL,
    ),
]
VolumeFractionOption = Annotated[
    float | None,
    typer.Option(
        metavar="0..1",
        help="Solid fraction of the whole cell, from which the distances follow.",
        rich_help_panel=WALL_PANEL,
    ),
]
PorosityOption = Annotated[
    float | None,
    typer.Option(metavar="0..1", help="Void fraction: 1 - the volume fraction.", rich_help_panel=WALL_PANEL),
]
PoreSizeOption = Annotated[
    float | None,
    typer.Option(
        metavar="MM",
        help="Diameter of the largest sphere in the void, mm, from which the cell follows; together with --porosity or "
        "--volume-fraction, instead of --cell.",
        rich_help_panel=CELL_PANEL,
    ),
]
KindOption = Annotated[
    Literal["sheet", "skeletal"],
    typer.Option(help="Solid between two surfaces, or on one side of one.", rich_help_panel=WALL_PANEL),
]
SideOption = Annotated[
    Literal["+", "-"], typer.Option(help="Solid side, for --kind skeletal.", rich_help_panel=WALL_PANEL)
]
ReferenceOption = Annotated[
    Literal["minimal", "nodal"] | None,
    typer.Option(
        help="The exact minimal surface, or the trigonometric one.",
        show_default="minimal, if the catalogue has it",
        rich_help_panel=WALL_PANEL,
    ),
]
BoundaryOption = Annotated[
    Literal["box", "natural"] | None,
    typer.Option(
        help="Planar caps in the box, or whole patches bridged by gap faces.",
        show_default="box; natural with --map",
        rich_help_panel=CELL_PANEL,
    ),
]
PhaseOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="X,Y,Z",
        help="Shift of the lattice, in cells.",
        show_default="one piece in a box",
        rich_help_panel=CELL_PANEL,
    ),
]
BodyPhaseOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="X,Y,Z",
        help="Shift of the lattice, in cells.",
        show_default="0,0,0",
        rich_help_panel=CELL_PANEL,
    ),
]
MapOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME[:RADIUS]",
        help="Wrap the lattice: `cylinder` closes a ring of the cells along x round the z axis, `cylinder:20` bends it with a "
        "radius of 20 mm; `sphere:20` makes a dome.",
        rich_help_panel=CELL_PANEL,
    ),
]
RotationOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="X,Y,Z",
        help="Rotation of the lattice about x, then its own y and z, degrees.",
        rich_help_panel=CELL_PANEL,
    ),
]
SkinOption = Annotated[
    float | None,
    typer.Option(
        metavar="MM",
        help="Thickness of a solid wall kept along the boundary of the body, mm.",
        show_default="no skin",
        rich_help_panel=SKIN_PANEL,
    ),
]
OpenFacesOption = Annotated[
    Any,
    typer.Option(
        parser=parse_faces,
        metavar="FACES",
        help='Plane faces without skin, to let powder or fluid out: ">Z,<Z" for those farthest up and down (also X and Y), or '
        "numbers in the order of the file.",
        rich_help_panel=SKIN_PANEL,
    ),
]
