"""The arguments and options that commands share, with their help texts: files, reports, tolerance."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

OUTPUT_PANEL = "Result"

MODEL_FORMATS = ".step, .stl, .3mf, .brep or .glb"

_NUMBER_WITH_UNIT = re.compile(r"[-+.,x\d]+ *(mm|cm|um|µm|m|in|inch|°|deg|%)$", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+$")


def parse_numbers(text: str) -> float | tuple[float, ...]:
    """One number, or a tuple of the numbers between commas or letters x."""
    try:
        values = tuple(float(part) for part in text.lower().replace("x", ",").split(","))
    except ValueError:
        remedy = remedy_for_number(text)
        raise typer.BadParameter(
            f"{text!r} is neither a number nor a list of numbers with commas between{remedy}"
        ) from None
    return values if len(values) > 1 else values[0]


def remedy_for_number(text: str) -> str:
    """What to write for a number with a unit or a decimal comma, after a colon; "" for other texts."""
    if match := _NUMBER_WITH_UNIT.match(text):
        return (
            ": leave the sign out, 0.7 is 70 %"
            if match[1] == "%"
            else ": leave the unit out, lengths are in mm and angles in degrees"
        )
    return ": write a decimal point" if _DECIMAL_COMMA.match(text) else ""


OutputOption = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help=f"The file to write; its name ends in {MODEL_FORMATS}.",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
DomainsOutputOption = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="The file to write; its name ends in .step, .3mf, .brep or .glb. Only .brep keeps the faces that the domains share.",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
OptionalOutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help=f"The file to write; its name ends in {MODEL_FORMATS}.",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
DeviationOption = Annotated[
    float | None,
    typer.Option(
        metavar="MM",
        help="Greatest distance of the triangles of .stl, .3mf and .glb from the solid, mm.",
        show_default="the tolerance",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
SchemaOption = Annotated[
    Literal["ap242", "ap214"],
    typer.Option(help="Application protocol of a .step file.", rich_help_panel=OUTPUT_PANEL),
]
InstancedOption = Annotated[
    bool,
    typer.Option(
        "--instanced",
        help="Store one cell in a .step file and place it once for each, as an assembly.",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
SlabOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="N|X,Y,Z",
        help="Write the lattice in slabs of N cells along z, or of X,Y,Z cells, each a solid in a .step file of its own: "
        "lattice_{:03d}.step, or with the number appended. Files of an interrupted run are kept.",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
JobsOption = Annotated[
    int,
    typer.Option(min=1, metavar="N", help="Processes that share the work.", rich_help_panel=OUTPUT_PANEL),
]
KeepLooseOption = Annotated[
    bool,
    typer.Option(
        "--keep-loose",
        help="Keep loose pieces below 1 % of the largest one's volume, which are left out otherwise.",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
VerifyOption = Annotated[
    Literal["kernel"] | None,
    typer.Option(
        help="Let the kernel read a whole .step file and check every face, however large.",
        show_default="an excerpt of large files",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
PictureOption = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="FILE.png", help="The picture to write.", rich_help_panel=OUTPUT_PANEL),
]
ReportOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE.json", help="Write what was measured as JSON.", rich_help_panel=OUTPUT_PANEL),
]
QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show no progress bar and no summary.", rich_help_panel=OUTPUT_PANEL)
]
VerboseOption = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", help="Tell every figure of the certificate, with its bound.", rich_help_panel=OUTPUT_PANEL
    ),
]
StepFileArgument = Annotated[
    Path, typer.Argument(metavar="FILE.step", exists=True, dir_okay=False, help="A STEP file, or a .brep file.")
]
BodyArgument = Annotated[
    Path,
    typer.Argument(metavar="BODY.step", exists=True, dir_okay=False, help="A STEP file with one solid."),
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
        help="The body whose volume the metrics refer to.",
        show_default="the bounding box",
    ),
]
RecipeArgument = Annotated[
    Path,
    typer.Argument(
        metavar="FILE.toml",
        exists=True,
        dir_okay=False,
        help="The recipe; `tpmscad template` prints one to start from.",
    ),
]
FieldFileArgument = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        exists=True,
        dir_okay=False,
        help="A recipe (.toml; `tpmscad template solidify` prints one), or an array (.npy, .vti, .vtk, .nrrd, .nii).",
    ),
]
DryRunOption = Annotated[
    bool,
    typer.Option("--dry-run", help="Check the recipe and all it names; make no solid.", rich_help_panel=OUTPUT_PANEL),
]
AllowErrorsOption = Annotated[
    bool,
    typer.Option(
        "--allow-errors", help="Make the solid even if topological errors remain.", rich_help_panel=OUTPUT_PANEL
    ),
]
ARRAY_PANEL = "An array"
LevelOption = Annotated[
    float | None,
    typer.Option(metavar="VALUE", help="Solid where the array exceeds this.", rich_help_panel=ARRAY_PANEL),
]
SpacingOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="MM|X,Y,Z",
        help="Distance of neighbouring samples of the array, mm.",
        show_default="of the file, or 1",
        rich_help_panel=ARRAY_PANEL,
    ),
]
OriginOption = Annotated[
    Any,
    typer.Option(
        parser=parse_numbers,
        metavar="X,Y,Z",
        help="Position of the first sample of the array, mm.",
        show_default="of the file, or 0,0,0",
        rich_help_panel=ARRAY_PANEL,
    ),
]
ArrayTolOption = Annotated[
    float | None,
    typer.Option(
        "--tol",
        metavar="MM",
        help="Greatest deviation from the surface in an array, mm.",
        show_default="a tenth of the spacing",
        rich_help_panel=ARRAY_PANEL,
    ),
]
