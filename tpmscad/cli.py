"""The command line: options in, one workflow called, a file and a report out. No mathematics, no kernel calls.

Exit status 0: made and met. 1: could not be made, or does not meet the request. 2: the request itself can't be carried out
as written (an unknown option, surface or folder; a value out of bounds; options that exclude each other).

The workflows are imported inside the commands: they bring the kernel, which takes seconds to load, and help should not wait.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from tpmscad.errors import InvalidRequest, NotMet, TpmscadError

BAR_DELAY = 1.0
"""Seconds before the progress bar shows: shorter work needs none."""

STEP_SUFFIXES = (".step", ".stp")

Progress = Callable[[str, float], None]
"""Told the name of a stage and how much of it is done, 0 to 1."""

app = typer.Typer(
    name="tpmscad",
    help="Triply periodic minimal surfaces and porous fields as exact, certified NURBS solids. Lengths are in mm.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line on `arguments` (default: those of the process). Always ends in SystemExit."""
    try:
        app(None if arguments is None else list(arguments), prog_name="tpmscad")
    except InvalidRequest as error:
        _fail(error, 2)
    except (TpmscadError, OSError) as error:
        _fail(error, 1)


def _fail(error: Exception, status: int) -> None:
    print("tpmscad:", " ".join(str(error).split()), file=sys.stderr)
    sys.exit(status)


def _numbers(text: str) -> float | tuple[float, ...]:
    """One number, or several with commas between."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a number, nor numbers with commas between") from None
    return values if len(values) > 1 else values[0]


def _writable(path: Path, suffixes: Iterable[str]) -> Path:
    """The path, if a file of one of these kinds can be put there; looked at before anything is computed."""
    if path.suffix.lower() not in suffixes:
        raise InvalidRequest(f"{path} ends in {path.suffix!r}: give it a name ending in {' or '.join(suffixes)}")
    if not path.parent.is_dir():
        raise InvalidRequest(f"the folder {path.parent} of {path.name} does not exist: make it first")
    return path


def _write_report(path: Path | None, content: dict[str, Any]) -> None:
    """The report as JSON, written aside and renamed, so that it is whole or not there."""
    if path is None:
        return
    aside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        aside.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


@contextmanager
def _progress_bar(title: str, quiet: bool) -> Iterator[Progress | None]:
    """A callback that draws a bar on standard error, or None where nobody watches."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, ProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    begun = time.monotonic()

    class LateBar(Bar):
        def get_renderables(self) -> Iterable[Any]:
            return super().get_renderables() if time.monotonic() - begun > BAR_DELAY else ()

    columns: list[ProgressColumn] = [TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()]
    with LateBar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)  # moves to and fro until something is known to be done
        yield lambda stage, done: bar.update(task, description=stage, completed=done, total=1.0 if done else None)


@contextmanager
def _reported(report: Path | None) -> Iterator[None]:
    """A result that misses the request leaves its certificate in the report, and nothing else."""
    if report is not None:
        _writable(report, (".json",))
    try:
        yield
    except NotMet as error:
        if error.certificate is not None:
            _write_report(report, error.certificate.to_dict())
        raise


def _write_model(model: Any, path: Path, progress: Progress | None, **how: Any) -> None:
    """Write the model if it meets the request."""
    certificate = model.certificate
    if not certificate.met:
        raise NotMet(f"{path} not written, it misses the request: {'; '.join(certificate.shortfalls)}", certificate)
    if progress:
        progress("write", 0.0)
    model.export_step(path, **how)


Surface = Annotated[str, typer.Argument(help="Name of the surface, see `tpmscad surfaces`.")]
Cell = Annotated[Any, typer.Option(parser=_numbers, metavar="L|X,Y,Z", help="Edge length of the cell, mm.")]
Cells = Annotated[Any, typer.Option(parser=_numbers, metavar="N|X,Y,Z", help="Number of cells along each axis.")]
Thickness = Annotated[float | None, typer.Option(metavar="MM", help="Wall thickness along the normal, mm.")]
Offset = Annotated[
    Any, typer.Option(parser=_numbers, metavar="LO,HI", help="Signed normal distances of the two sides, mm.")
]
VolumeFraction = Annotated[float | None, typer.Option(metavar="0..1", help="Solid share of the box; sets thickness.")]
Tol = Annotated[float | None, typer.Option(metavar="MM", help="Greatest deviation from the reference, mm.")]
Kind = Annotated[Literal["sheet", "skeletal"], typer.Option(help="Between two offset surfaces, or on one side of one.")]
Side = Annotated[Literal["+", "-"], typer.Option(help="Which side is solid, for --kind skeletal.")]
Reference = Annotated[
    Literal["minimal", "nodal"], typer.Option(help="The exact minimal surface, or the trigonometric one of its name.")
]
Boundary = Annotated[
    Literal["box", "natural"], typer.Option(help="Flat caps in the planes of the box, or whole patches bridged.")
]
Phase = Annotated[Any, typer.Option(parser=_numbers, metavar="X,Y,Z", help="Shift of the lattice, in cells.")]
Instanced = Annotated[bool, typer.Option("--instanced", help="Store one cell and place it, as an assembly.")]
Schema = Annotated[Literal["ap242", "ap214"], typer.Option(help="STEP application protocol.")]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="FILE.step", help="The STEP file to write.")]
Picture = Annotated[Path, typer.Option("--output", "-o", metavar="FILE.png", help="The picture to write.")]
Report = Annotated[Path | None, typer.Option(metavar="FILE.json", help="Write what was measured as JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar and no summary.")]
StepFile = Annotated[Path, typer.Argument(metavar="FILE.step", exists=True, dir_okay=False, help="A STEP file.")]


def _show_version(wanted: bool) -> None:
    if wanted:
        try:
            print("tpmscad", version("tpmscad"))
        except PackageNotFoundError:
            print("tpmscad, run from its source without being installed")
        raise typer.Exit


@app.callback()
def _options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


@app.command()
def surfaces() -> None:
    """List the catalogue: names, space group, genus, references available, patches per cell."""
    from tpmscad.surfaces import CATALOGUE

    head = ("name", "also", "space group", "genus", "references", "patches per cell", "formula")
    rows = [
        (i.name, ", ".join(i.aliases), i.space_group, i.genus, ", ".join(i.references), i.patches_per_cell, i.formula)
        for i in CATALOGUE.values()
    ]
    table = [[str(entry) for entry in row] for row in (head, *rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        print("  ".join(entry.ljust(width) for entry, width in zip(row, widths, strict=True)).rstrip())


@app.command()
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
    reference: Reference = "minimal",
    boundary: Boundary = "box",
    phase: Phase = "0,0,0",
    instanced: Instanced = False,
    schema: Schema = "ap242",
    report: Report = None,
    quiet: Quiet = False,
) -> None:
    """Make a lattice of a minimal surface, filling the box from the origin to CELLS x CELL, as a STEP file."""
    _writable(output, STEP_SUFFIXES)
    with _reported(report):
        from tpmscad import workflows

        with _progress_bar(f"{surface} lattice", quiet) as progress:
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
            _write_model(model, output, progress, instanced=instanced, schema=schema)
        _write_report(report, model.certificate.to_dict())
    if not quiet:
        print(model.certificate)


@app.command()
def check(file: StepFile, report: Report = None, quiet: Quiet = False) -> None:
    """Read a STEP file back with the kernel: solids, shells, faces, validity, closedness, volume, area, units, tolerances."""
    if report is not None:
        _writable(report, (".json",))
    from tpmscad import workflows

    with _progress_bar(f"reading {file.name}", quiet):
        found = workflows.check_step(file)
    _write_report(report, found.to_dict())
    if not quiet:
        print(found)
    if not found.ok:
        raise TpmscadError(f"{file} does not hold valid closed solids: {found}" if quiet else f"{file} fails the check")


@app.command()
def render(file: StepFile, output: Picture, report: Report = None, quiet: Quiet = False) -> None:
    """Draw a STEP file as a PNG picture. No display is needed."""
    _writable(output, (".png",))
    with _reported(report):
        from tpmscad import workflows

        with _progress_bar(f"drawing {file.name}", quiet):
            workflows.render_step(file, output)
        _write_report(report, {"file": str(file), "picture": str(output), "bytes": output.stat().st_size})
