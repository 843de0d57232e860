"""The command line: options in, one workflow called, a file and a report out. No mathematics, no kernel calls.

Exit status 0: made and met. 1: could not be made, or does not meet the request. 2: the request itself can't be carried out
as written (an unknown option, surface or folder; a value out of bounds; options that exclude each other).

The workflows are imported inside the commands: they bring the kernel, which takes seconds to load, and help should not wait.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated

import typer

from tpmscad.cli import files, infill, lattice, recipe, surfaces
from tpmscad.errors import InvalidRequest, TpmscadError

app = typer.Typer(
    name="tpmscad",
    help="Triply periodic minimal surfaces and porous fields as exact, certified NURBS solids. Lengths are in mm.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command()(surfaces.surfaces)
app.command()(lattice.lattice)
app.command()(infill.infill)
app.command()(recipe.blend)
app.command()(recipe.solidify)
app.command()(files.check)
app.command()(files.render)


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
