"""The arguments and options that commands share, with their help texts: files, reports, tolerance."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from tpmscad.file_suffixes import (
    DOMAIN_SUFFIXES,
    MODEL_SUFFIXES,
    READ_TRIANGLE_SUFFIXES,
    TRIANGLE_SUFFIXES,
    list_suffixes,
)

OUTPUT_PANEL = "Result"
ARRAY_PANEL = "An array"

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


def parse_labels(text: str) -> Any:
    """One whole number or several, or the word all."""
    return text if text == "all" else parse_numbers(text)


def parse_solid(text: str) -> Any:
    """The number of a solid, or a word."""
    return int(text) if text.isdecimal() else text


def remedy_for_number(text: str) -> str:
    """What to write for a number with a unit or a decimal comma, after a colon; "" for other texts."""
    if match := _NUMBER_WITH_UNIT.match(text):
        if match[1] == "%":
            return f": write {float(text.strip().rstrip('%').replace(',', '.')) / 100:g}"
        return ": leave the unit out, lengths are in mm and angles in degrees"
    return ": write a decimal point" if _DECIMAL_COMMA.match(text) else ""


def result_option(*names: str, **settings: Any) -> Any:
    """An option on where the result goes and how, or on what is said of it."""
    return typer.Option(*names, rich_help_panel=OUTPUT_PANEL, **settings)


def output_option(help: str, metavar: str = "FILE") -> Any:
    """The option for the file to write."""
    return result_option("--output", "-o", metavar=metavar, help=help)


def input_file(metavar: str, help: str, *, dir_okay: bool = False) -> Any:
    """The operand for a file that exists, or a folder where that is one."""
    return typer.Argument(metavar=metavar, exists=True, dir_okay=dir_okay, help=help)


def array_option(*names: str, **settings: Any) -> Any:
    """An option on an array of samples."""
    return typer.Option(*names, rich_help_panel=ARRAY_PANEL, **settings)


def part_option(help: str) -> Any:
    """An option that names a CAD file beside an array."""
    return array_option(metavar="PART.step", exists=True, dir_okay=False, help=help)


MODEL_OUTPUT = output_option(f"The file to write; its name ends in {list_suffixes(MODEL_SUFFIXES)}.")
OutputOption = Annotated[Path, MODEL_OUTPUT]
OptionalOutputOption = Annotated[Path | None, MODEL_OUTPUT]
DomainsOutputOption = Annotated[
    Path,
    output_option(
        f"The file to write; its name ends in {list_suffixes(DOMAIN_SUFFIXES)}. "
        "Only .brep keeps the faces that the domains share."
    ),
]
DeviationOption = Annotated[
    float | None,
    result_option(
        metavar="MM",
        help=f"Greatest distance of the triangles of {list_suffixes(TRIANGLE_SUFFIXES, 'and')} from the solid, mm.",
        show_default="the tolerance",
    ),
]
SchemaOption = Annotated[Literal["ap242", "ap214"], result_option(help="Application protocol of a .step file.")]
InstancedOption = Annotated[
    bool,
    result_option("--instanced", help="Store one cell in a .step file and place it once for each, as an assembly."),
]
SlabOption = Annotated[
    Any,
    result_option(
        parser=parse_numbers,
        metavar="N|X,Y,Z",
        help="Write the lattice in slabs of N cells along z, or of X,Y,Z cells, each a solid in a .step file of its own: "
        "lattice_{:03d}.step, or with the number appended. Files of an interrupted run are kept.",
    ),
]
JobsOption = Annotated[int, result_option(min=1, metavar="N", help="Processes that share the work.")]
KeepLooseOption = Annotated[
    bool,
    result_option(
        "--keep-loose",
        help="Keep loose pieces below 1 % of the largest one's volume, which are left out otherwise.",
    ),
]
VerifyOption = Annotated[
    Literal["kernel"] | None,
    result_option(
        help="Let the kernel read a whole .step file and check every face, however large.",
        show_default="an excerpt of large files",
    ),
]
PictureOption = Annotated[Path, output_option("The picture to write.", "FILE.png")]
ReportOption = Annotated[Path | None, result_option(metavar="FILE.json", help="Write what was measured as JSON.")]
ProgressOption = Annotated[
    Literal["bar", "lines"],
    result_option(
        help="A bar in a terminal, or on standard error a line of JSON for each step, for programs that run this one: "
        '{"stage": "trim", "done": 0.25}.',
    ),
]
QuietOption = Annotated[bool, result_option("--quiet", "-q", help="Show no progress bar and no summary.")]
VerboseOption = Annotated[
    bool, result_option("--verbose", "-v", help="Tell every figure of the certificate, with its bound.")
]
StepFileArgument = Annotated[Path, input_file("FILE.step", "A STEP, IGES or BREP file.")]
AnyFileArgument = Annotated[
    Path, input_file("FILE", f"A STEP, IGES or BREP file, or triangles: {list_suffixes(READ_TRIANGLE_SUFFIXES)}.")
]
BodyArgument = Annotated[
    Path,
    input_file(
        "BODY.step",
        "A STEP, IGES or BREP file, of which --solid chooses one of several solids, or a closed mesh: "
        f"{list_suffixes(READ_TRIANGLE_SUFFIXES)}.",
    ),
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
RecipeArgument = Annotated[Path, input_file("FILE.toml", "The recipe; `tpmscad template` prints one to start from.")]
FieldFileArgument = Annotated[
    Path,
    input_file(
        "FILE",
        "A recipe (.toml; `tpmscad template solidify` prints one), or an image: .npy, .npz, .nii, .nrrd, .mha, .mhd, .tif, .mrc, "
        ".map, .vti, .vtu, .vtk, .raw; a folder of slices, DICOM or .tif; or beams, .3mf.",
        dir_okay=True,
    ),
]
DryRunOption = Annotated[bool, result_option("--dry-run", help="Check the recipe and all it names; make no solid.")]
AllowErrorsOption = Annotated[
    bool, result_option("--allow-errors", help="Make the solid even if topological errors remain.")
]
LevelOption = Annotated[
    float | None, array_option(metavar="VALUE", help="Solid where the grey values of the array exceed this.")
]
ArrayFractionOption = Annotated[
    float | None,
    array_option(
        "--volume-fraction",
        metavar="0..1",
        help="Instead of --level: the part of the volume that is to be solid, from which the level follows.",
    ),
]
AsSurfaceOption = Annotated[
    str | None,
    array_option(
        "--as",
        metavar="SURFACE",
        help="Make a lattice of this surface whose volume fraction is the density in the array; needs --cell.",
    ),
]
ArrayCellOption = Annotated[
    Any, array_option("--cell", parser=parse_numbers, metavar="MM|X,Y,Z", help="Edge of the lattice's cell, with --as.")
]
SmoothingOption = Annotated[
    float | None,
    array_option(
        metavar="SAMPLES",
        help="Width of a Gaussian that takes noise from grey values, in samples.",
        show_default="none",
    ),
]
LabelOption = Annotated[
    Any,
    array_option(
        parser=parse_labels,
        metavar="N|N,N|all",
        help="Solid where the array has this label, or one of these, with a smooth surface within half a voxel.",
        show_default="all but 0, of an array of integers",
    ),
]
AmongOption = Annotated[
    Any,
    array_option(
        parser=parse_labels,
        metavar="N,N|all",
        help="With --label: the labels with which it shares its faces; their solids, made one by one, touch exactly.",
    ),
]
KeepOption = Annotated[
    Path | None, part_option("A CAD file whose solids the result contains, with their exact faces: bosses, flanges.")
]
ClearOption = Annotated[
    Path | None, part_option("A CAD file whose solids stay empty: bolts in their bores, what moves past.")
]
CentredOption = Annotated[
    bool | None,
    array_option(
        "--cell-data/--point-data",
        help="Whether the values belong to cells (voxels, elements), which reach half a spacing further, or to points.",
        show_default="of the file, or points",
    ),
]
FrameOption = Annotated[
    Literal["RAS", "LPS", "file"] | None,
    array_option(
        help="Frame of the result, for an image that states one: RAS (x to the right, y anterior, z superior), LPS, or that of "
        "the file.",
        show_default="RAS",
    ),
]
VolumeOption = Annotated[
    int | None,
    array_option(metavar="N", help="Which of the volumes of a file, or of the DICOM series of a folder, from 0 on."),
]
ArrayNameOption = Annotated[
    str | None,
    array_option(metavar="NAME", help="Which of the arrays of a VTK or .npz file.", show_default="the active one"),
]
SpacingOption = Annotated[
    Any,
    array_option(
        parser=parse_numbers,
        metavar="MM|X,Y,Z",
        help="Distance of neighbouring samples of the array, mm.",
        show_default="of the file, or 1",
    ),
]
OriginOption = Annotated[
    Any,
    array_option(
        parser=parse_numbers,
        metavar="X,Y,Z",
        help="Position of the first sample of the array, mm.",
        show_default="of the file, or 0,0,0",
    ),
]
ArrayTolOption = Annotated[
    float | None,
    array_option(
        "--tol",
        metavar="MM",
        help="Greatest deviation from the surface in an array, mm.",
        show_default="a tenth of the spacing",
    ),
]
