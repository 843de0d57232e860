"""The command line: options in, one workflow called, a file and a report out.

Exit status 0: made, and as requested. 1: could not be made, or misses the request. 2: the request cannot be carried out as
written (an unknown option, surface or folder; a value out of range; options that exclude each other).

The packages `tpmscad.workflows` and `tpmscad.recipe` load their modules at their first use, so help does not wait for the kernel.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from tpmscad import __version__
from tpmscad.cli import infill_command, lattice_command, recipe_commands, step_file_commands, surfaces_command
from tpmscad.errors import InvalidRequest, TpmscadError

EXIT_STATUS_HELP = """Exit status: 0 if the result was made as requested; 1 if it could not be made or misses the request
(nothing is written); 2 if the request cannot be carried out as written."""

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
    """The examples at the end of a command's help; \b keeps their line breaks."""
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
        "Join porous structures as a TOML file describes.",
        ["blend examples/scaffold.toml --dry-run", "blend examples/scaffold.toml -o scaffold.step"],
    ),
    (
        recipe_commands.solidify,
        "Make the solid of a field that a TOML file describes.",
        ["solidify examples/graded.toml -o graded.step --report graded.json"],
    ),
    (
        step_file_commands.check,
        "Read a STEP file and report its content.",
        ["check gyroid.step", "check filled.step --metrics --within bracket.step --report filled.json"],
    ),
    (step_file_commands.render, "Draw a STEP file as a PNG picture.", ["render gyroid.step -o gyroid.png"]),
):
    app.command(short_help=short, epilog=format_examples(*lines))(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line on `arguments` (default: those of the process); it ends in SystemExit."""
    try:
        app(None if arguments is None else list(arguments), prog_name="tpmscad")
    except InvalidRequest as error:
        _exit_with_error(error, 2)
    except (TpmscadError, OSError) as error:
        _exit_with_error(error, 1)


def _exit_with_error(error: Exception, status: int) -> None:
    print("tpmscad:", " ".join(str(error).split()), file=sys.stderr)
    sys.exit(status)


def _show_version(show: bool) -> None:
    if show:
        print("tpmscad", __version__)
        raise typer.Exit


@app.callback()
def _declare_global_options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass
