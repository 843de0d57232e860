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

from tpmscad.cli import infill_command, lattice_command, recipe_commands, step_file_commands, surfaces_command
from tpmscad.errors import InvalidRequest, TpmscadError

EXIT_STATUS_HELP = """Exit status: 0 if made and as requested; 1 if it could not be made or misses the request (nothing
is written); 2 if the request cannot be carried out as written."""

app = typer.Typer(
    name="tpmscad",
    help="Triply periodic minimal surfaces and porous fields as exact, certified NURBS solids. Lengths are in mm.",
    no_args_is_help=True,
    epilog=EXIT_STATUS_HELP,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def format_examples(*lines: str) -> str:
    """The end of a command's help; what follows \b keeps its line breaks."""
    return "\b\n" + "\n".join(["Examples:", *(f"  tpmscad {line}" for line in lines)])


for command, short, lines in (
    (surfaces_command.surfaces, "List the catalogue of surfaces.", ["surfaces"]),
    (
        lattice_command.lattice,
        "Make a lattice of a minimal surface in a box.",
        [
            "lattice gyroid --cell 10 --cells 2,2,2 --thickness 1 -o gyroid.step",
            "lattice diamond --cell 10,10,14 --offset -0.6,0.4 -o d.step",
            "lattice P --cell 8 --volume-fraction 0.3 --kind skeletal -o p.step",
        ],
    ),
    (
        infill_command.infill,
        "Fill the solid in a STEP file with a lattice.",
        ["infill bracket.step gyroid --cell 8 --thickness 0.8 --skin 1.5 -o filled.step"],
    ),
    (
        recipe_commands.blend,
        "Join porous structures as a TOML file says.",
        ["blend examples/scaffold.toml --dry-run", "blend examples/scaffold.toml -o scaffold.step"],
    ),
    (
        recipe_commands.solidify,
        "Make the solid of a field as a TOML file says.",
        ["solidify examples/graded.toml -o graded.step --report graded.json"],
    ),
    (
        step_file_commands.check,
        "Read a STEP file back and say what is in it.",
        ["check gyroid.step", "check filled.step --metrics --within bracket.step --report filled.json"],
    ),
    (step_file_commands.render, "Draw a STEP file as a PNG picture.", ["render gyroid.step -o gyroid.png"]),
):
    app.command(short_help=short, epilog=format_examples(*lines))(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line on `arguments` (default: those of the process). Always ends in SystemExit."""
    try:
        app(None if arguments is None else list(arguments), prog_name="tpmscad")
    except InvalidRequest as error:
        _exit_with_error(error, 2)
    except (TpmscadError, OSError) as error:
        _exit_with_error(error, 1)


def _exit_with_error(error: Exception, status: int) -> None:
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
def _declare_global_options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass
