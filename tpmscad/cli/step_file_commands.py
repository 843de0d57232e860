"""tpmscad check, render and slice: the content of a STEP file, its picture, and its layers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import tpmscad
from tpmscad.cli.derived_options import Request, take_options_of
from tpmscad.cli.options import (
    AnyFileArgument,
    MetricsOption,
    PictureOption,
    QuietOption,
    ReportOption,
    StepFileArgument,
    WithinOption,
    output_option,
    result_option,
)
from tpmscad.cli.output import (
    OutputRequest,
    check_report,
    progress_bar,
    report_unmet_request,
    tell,
    write_layers,
    write_report,
)
from tpmscad.errors import TpmscadError
from tpmscad.file_suffixes import LAYER_WRITERS, READ_TRIANGLE_SUFFIXES
from tpmscad.requests.study_options import PrintOptions, RenderStepOptions, SliceStepOptions

VerboseCheckOption = Annotated[
    bool, result_option("--verbose", "-v", help="Tell shells, edges, centroid and tolerance, too.")
]
FacesOption = Annotated[
    bool, typer.Option("--faces", help="List the faces, too: the label of each in a filled body, kind, area and place.")
]
SolidOption = Annotated[
    int | None, typer.Option("--solid", min=1, metavar="N", help="Report on the solid of this number only.")
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
SlicesOption = Annotated[
    Path, output_option("The file to write: .svg, .cli (Common Layer Interface) or .3mf (slice extension).")
]


@take_options_of(PrintOptions, panel=PRINT_PANEL)
def check(
    limits: Request,
    file: AnyFileArgument,
    solid: SolidOption = None,
    faces: FacesOption = False,
    metrics: MetricsOption = False,
    within: WithinOption = None,
    printing: PrintOption = False,
    report: ReportOption = None,
    verbose: VerboseCheckOption = False,
    quiet: QuietOption = False,
) -> None:
    """Read a CAD file or triangles: solids, faces, validity, closedness, volume, area, units, tolerances, healing.

    With --print, check it before printing, too; exit status 1 if a limit is not kept.
    """
    check_report(report)
    if limits and not printing:
        given = ", ".join(f"--{name.replace('_', '-')}" for name in limits)
        raise typer.BadParameter(f"{given} limits the check before printing: add --print")
    if file.suffix.lower() in READ_TRIANGLE_SUFFIXES and (metrics or within or printing):
        raise typer.BadParameter(
            f"--metrics, --within and --print measure the faces of CAD solids, which the triangles of {file.name} are not: "
            "leave them out, or check the STEP file"
        )
    with progress_bar(f"reading {file.name}", quiet):
        found = tpmscad.check_step(file, faces=faces, solid=solid)
    content, text = found.to_dict(), found.summary(verbose=verbose)
    part = file if solid is None or not found.ok else tpmscad.read_body(file, solid=solid, heal=False)
    if found.ok and (metrics or within):
        with progress_bar(f"measuring {file.name}", quiet):
            measured = tpmscad.measure(part, within=within)
        content["metrics"] = measured.to_dict()
        text += f"\n{measured}"
    faults: list[str] = []
    if found.ok and printing:
        with progress_bar(f"checking {file.name} before printing", quiet):
            judged = tpmscad.check_print(part, **limits)
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


@take_options_of(RenderStepOptions)
def render(
    request: Request,
    file: AnyFileArgument,
    output: PictureOption,
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Draw a CAD file, or triangles as they are, as a PNG picture, without a display."""
    writing = OutputRequest(output, report, quiet, suffixes=(".png",))
    with report_unmet_request(report):
        with progress_bar(f"drawing {file.name}", quiet):
            tpmscad.render_step(file, output, **request)
        write_report(report, {"file": str(file), "picture": str(output), "bytes": output.stat().st_size})
    tell("", writing)


@take_options_of(SliceStepOptions)
def slice_file(
    request: Request,
    file: StepFileArgument,
    output: SlicesOption,
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Slice a STEP file for layered manufacturing: closed contours of every layer, straight from the exact faces."""
    writing = OutputRequest(output, report, quiet, suffixes=tuple(LAYER_WRITERS))
    with progress_bar(f"slicing {file.name}", quiet):
        from tpmscad.studies._slice_step import slice_step  # loads the kernel

        found = slice_step(file, **request)
    write_layers(found, file, writing)
