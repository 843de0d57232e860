"""tpmscad check, render and slice: the content of a STEP file, its picture, and its layers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import tpmscad
from tpmscad.atomic_file import validate_output_path
from tpmscad.cli.options import (
    OUTPUT_PANEL,
    MetricsOption,
    PictureOption,
    QuietOption,
    ReportOption,
    StepFileArgument,
    WithinOption,
    parse_numbers,
)
from tpmscad.cli.output import (
    check_report,
    given_options,
    progress_bar,
    report_unmet_request,
    write_report,
)
from tpmscad.errors import TpmscadError


def parse_size(text: str) -> tuple[int, int]:
    """Width and height in pixels of a text such as 1600x1200."""
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        raise typer.BadParameter(f"{text!r} is no size in pixels: write 1600x1200")
    return int(width), int(height)


def parse_direction(text: str) -> str | tuple[float, ...]:
    """An axis such as -x, or the numbers of a vector."""
    if "," not in text:
        return text
    vector = parse_numbers(text)
    return vector if isinstance(vector, tuple) else text


VerboseCheckOption = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", help="Tell shells, edges, centroid and tolerance, too.", rich_help_panel=OUTPUT_PANEL
    ),
]
ViewOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|X,Y,Z",
        help="iso, front, back, left, right, top or bottom, or the direction from the part to the eye.",
        show_default="iso",
    ),
]
SectionOption = Annotated[
    str | None,
    typer.Option(metavar="AXIS=MM", help="Cut the part open by a plane: z=5, z for the middle, x=0,y=0 for a quarter."),
]
SizeOption = Annotated[
    Any,
    typer.Option(
        parser=parse_size, metavar="WxH", help="Width and height of the picture, pixels.", show_default="1200x900"
    ),
]
HideOption = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="Leave out the piece of this name, such as `wall`; may be given several times."),
]
ColorByOption = Annotated[
    Literal["piece", "tag", "curvature"] | None,
    typer.Option(
        help="A colour for each solid, for each group of faces, or for the mean curvature.",
        show_default="the colours in the file",
    ),
]

PRINT_PANEL = "Check before printing"
PrintOption = Annotated[
    bool,
    typer.Option(
        "--print",
        help="Check the part before printing, too: smallest wall and gap, overhang, closed cavities.",
        rich_help_panel=PRINT_PANEL,
    ),
]
MinWallOption = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Least wall, mm.", show_default="measured only", rich_help_panel=PRINT_PANEL),
]
MinGapOption = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Least gap, mm.", show_default="measured only", rich_help_panel=PRINT_PANEL),
]
MaxOverhangOption = Annotated[
    float | None,
    typer.Option(
        metavar="DEGREES",
        help="Greatest overhang from the build direction: 0 is a vertical wall, 90 a ceiling.",
        show_default="measured only",
        rich_help_panel=PRINT_PANEL,
    ),
]
BuildDirectionOption = Annotated[
    Any,
    typer.Option(
        parser=parse_direction,
        metavar="AXIS|X,Y,Z",
        help="From the build plate upwards: z, -x, or a vector.",
        show_default="z",
        rich_help_panel=PRINT_PANEL,
    ),
]

HeightOption = Annotated[
    float,
    typer.Option(
        metavar="MM", help="Height of a layer, mm; layers are cut in their middle.", rich_help_panel=OUTPUT_PANEL
    ),
]
ChordErrorOption = Annotated[
    float | None,
    typer.Option(
        metavar="MM",
        help="Greatest distance of a chord from the exact contour, mm.",
        show_default="a quarter of the height",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
SlicesOption = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="The file to write: .svg, .cli (Common Layer Interface) or .3mf (slice extension).",
        rich_help_panel=OUTPUT_PANEL,
    ),
]


def check(
    file: StepFileArgument,
    metrics: MetricsOption = False,
    within: WithinOption = None,
    printing: PrintOption = False,
    min_wall: MinWallOption = None,
    min_gap: MinGapOption = None,
    max_overhang: MaxOverhangOption = None,
    build_direction: BuildDirectionOption = None,
    report: ReportOption = None,
    verbose: VerboseCheckOption = False,
    quiet: QuietOption = False,
) -> None:
    """Read a STEP file with the kernel: solids, shells, faces, validity, closedness, volume, area, units, tolerances.

    With --print, check it before printing, too; exit status 1 if a limit is not kept.
    """
    check_report(report)
    limits = given_options(
        min_wall=min_wall, min_gap=min_gap, max_overhang=max_overhang, build_direction=build_direction
    )
    if limits and not printing:
        given = ", ".join(f"--{name.replace('_', '-')}" for name in limits)
        raise typer.BadParameter(f"{given} limits the check before printing: add --print")
    with progress_bar(f"reading {file.name}", quiet):
        found = tpmscad.check_step(file)
    content, text = found.to_dict(), found.summary(verbose=verbose)
    if found.ok and (metrics or within):
        with progress_bar(f"measuring {file.name}", quiet):
            measured = tpmscad.measure(file, within=within)
        content["metrics"] = measured.to_dict()
        text += f"\n{measured}"
    faults: list[str] = []
    if found.ok and printing:
        with progress_bar(f"checking {file.name} before printing", quiet):
            judged = tpmscad.check_print(file, **limits)
        content["print"] = judged.to_dict()
        text += f"\n{judged}"
        faults = [str(fault) for fault in judged.faults]
    write_report(report, content)
    if not quiet:
        print(text)
    if not found.ok:
        raise TpmscadError(f"{file} does not hold valid closed solids: {found}" if quiet else f"{file} fails the check")
    if faults:
        raise TpmscadError(f"{file} cannot be printed within the limits: " + "; ".join(faults))


def render(
    file: StepFileArgument,
    output: PictureOption,
    view: ViewOption = None,
    section: SectionOption = None,
    size: SizeOption = None,
    color_by: ColorByOption = None,
    hide: HideOption = None,
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Draw a STEP file as a PNG picture, without a display."""
    validate_output_path(output, (".png",))
    with report_unmet_request(report):
        with progress_bar(f"drawing {file.name}", quiet):
            tpmscad.render_step(
                file,
                output,
                **given_options(view=view, section=section, size=size, color_by=color_by, hide=hide or None),
            )
        write_report(report, {"file": str(file), "picture": str(output), "bytes": output.stat().st_size})


def slice_file(
    file: StepFileArgument,
    height: HeightOption,
    output: SlicesOption,
    chord_error: ChordErrorOption = None,
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Slice a STEP file for layered manufacturing: closed contours of every layer, straight from the exact faces."""
    validate_output_path(output, (".svg", ".cli", ".3mf"))
    with report_unmet_request(report):
        with progress_bar(f"slicing {file.name}", quiet):
            from tpmscad.studies._slice_step import slice_step  # loads the kernel

            found = slice_step(file, height, chord_error)
            found.write(output)
        write_report(
            report,
            {
                "file": str(file),
                "slices": str(output),
                "layers": len(found),
                "contours": found.n_contours,
                "points": found.n_points,
                "volume": found.volume,
                "chord_error": found.chord_error,
                "unresolved": found.unresolved,
            },
        )
    if not quiet:
        print(found)
