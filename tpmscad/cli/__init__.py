"""The command line: options in, one workflow called, a file and a report out.

Exit status 0: made, and as requested. 1: could not be made, or misses the request. 2: the request cannot be carried out as
written (an unknown option, surface or folder; a value out of range; options that exclude each other). Every failure is one line
on standard error.

Commands import what they call at their first use, so help does not wait for the kernel.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Annotated, NoReturn

import typer

from tpmscad import __version__
from tpmscad.cli.option_language import in_option_language
from tpmscad.errors import InvalidRequest, TpmscadError

INTERRUPTED = 130
"""Exit status after an interrupt from the keyboard."""

EXIT_STATUS_HELP = """Lengths are in mm, angles in degrees; several numbers are written with commas: 10,10,14.

Exit status: 0 if the result was made as requested; 1 if it could not be made or misses the request (nothing is written);
2 if the request cannot be carried out as written."""

MAKE, RECIPES, LOOK = "Make solids", "Solids of fields", "Look at results and at what there is"
SIMULATE = "Simulate"


@dataclass(frozen=True, slots=True)
class Command:
    """A command: the panel of the help, module and function, its help in a line, and examples."""

    panel: str
    home: str
    short_help: str
    examples: tuple[str, ...]

    @property
    def name(self) -> str:
        """The word on the command line; slice is the function slice_file, as slice is a builtin."""
        return self.home.partition(".")[2].removesuffix("_file").replace("_", "-")

    def load(self) -> Callable[..., None]:
        """The function, whose options follow from the arguments of what it calls."""
        module, _, function = self.home.partition(".")
        command: Callable[..., None] = getattr(import_module(f"tpmscad.cli.{module}"), function)
        return command


COMMANDS = (
    Command(
        MAKE,
        "lattice_command.lattice",
        "Make a lattice of a minimal surface in a box, or wrapped.",
        (
            "lattice gyroid --cell 10 --cells 2,2,2 --thickness 1 -o gyroid.step",
            "lattice diamond --cell 10,10,14 --offset -0.6,0.4 -o d.step",
            "lattice P --cell 8 --volume-fraction 0.3 --kind skeletal -o p.stl",
            "lattice gyroid --porosity 0.7 --pore-size 0.6 --cells 4,4,4 -o scaffold.3mf",
            "lattice gyroid --cell 10 --cells 12,1,1 --thickness 1 --map cylinder -o ring.step",
            "lattice gyroid --cell 10 --cells 20,20,20 --thickness 1 --slab 1 --jobs 2 -o gyroid_{:03d}.step",
        ),
    ),
    Command(
        MAKE,
        "struts_command.struts",
        "Make a lattice of round struts in a box.",
        (
            "struts octet --cell 10 --cells 2,2,2 --diameter 1 -o octet.step",
            "struts kelvin --cell 8 --cells 3,3,3 --porosity 0.9 --node-radius 0.6 -o kelvin.stl",
        ),
    ),
    Command(
        MAKE,
        "infill_command.infill",
        "Fill the solid in a STEP file with a lattice.",
        (
            "infill bracket.step gyroid --cell 8 --thickness 0.8 -o filled.step",
            'infill bracket.step P --cell 8 --thickness 1 --skin 2 --open-faces ">Z" -o filled.step',
        ),
    ),
    Command(
        MAKE,
        "infill_command.domains",
        "Divide a body into the wall and two channels of a heat exchanger.",
        ("domains body.step gyroid --cell 8 --thickness 0.8 -o exchanger.step",),
    ),
    Command(
        MAKE,
        "sweep_command.sweep",
        "Make and measure every design of a table.",
        (
            "template sweep > designs.csv",
            "sweep designs.csv -o results.csv",
            "sweep designs.csv --jobs 2 --metrics -o results.csv",
            "sweep exchangers.csv --flow flow.toml --no-solids -o coarse.csv",
        ),
    ),
    Command(
        RECIPES,
        "recipe_commands.solidify",
        "Make the solid of a field in a TOML recipe, or of an array.",
        (
            "solidify examples/graded.toml -o graded.step --report graded.json",
            "solidify density.npy --level 0.5 --spacing 0.5 -o part.step",
        ),
    ),
    Command(
        RECIPES,
        "recipe_commands.blend",
        "Join porous structures as a TOML recipe describes.",
        ("blend examples/scaffold.toml --dry-run", "blend examples/scaffold.toml -o scaffold.step"),
    ),
    Command(
        RECIPES,
        "reference_commands.template",
        "Print a commented recipe, or a table, to start from.",
        ("template solidify -o my.toml", "template sweep > designs.csv"),
    ),
    Command(
        RECIPES,
        "reference_commands.recipe_keys",
        "List what recipes may hold: kinds of fields and their keys.",
        ("recipe-keys", "recipe-keys rod"),
    ),
    Command(
        LOOK,
        "step_file_commands.check",
        "Read a CAD file or triangles and report the content.",
        ("check gyroid.step", "check filled.step --metrics --within bracket.step --report filled.json"),
    ),
    Command(
        LOOK,
        "step_file_commands.render",
        "Draw a CAD file or triangles as a PNG picture.",
        (
            "render gyroid.step -o gyroid.png",
            "render exchanger.step --section z=5 --color-by piece --size 1600x1200 -o exchanger.png",
        ),
    ),
    Command(
        LOOK,
        "step_file_commands.slice_file",
        "Slice a STEP file into layers for printing.",
        (
            "slice gyroid.step --height 0.05 -o gyroid.cli",
            "slice exchanger.step --height 0.03 --chord-error 0.005 -o exchanger.3mf",
        ),
    ),
    Command(
        SIMULATE,
        "simulation_commands.mesh",
        "Mesh a STEP file with tetrahedra.",
        (
            "mesh gyroid.step --size 0.5 --periodic -o gyroid.msh",
            "mesh bracket.step --size 1 --order 1 -o bracket.inp",
        ),
    ),
    Command(
        SIMULATE,
        "simulation_commands.homogenize",
        "Compute stiffness and conductivity of a lattice.",
        (
            "homogenize gyroid --volume-fraction 0.2",
            "homogenize gyroid --porosity 0.8 --kind skeletal",
            "homogenize P --volume-fraction 0.3 --youngs-modulus 210e3 -o p.inp",
        ),
    ),
    Command(
        SIMULATE,
        "simulation_commands.permeability",
        "Compute the permeability of a channel of a lattice.",
        (
            "permeability gyroid --porosity 0.4",
            "permeability P --cell 8 --thickness 0.8 --side + --report p.json",
        ),
    ),
    Command(
        LOOK,
        "doctor_command.doctor",
        "Show versions, kernel, cache and memory, and what is wrong.",
        ("doctor", "doctor --json"),
    ),
    Command(
        LOOK,
        "reference_commands.surfaces",
        "List the catalogue of surfaces.",
        ("surfaces", "surfaces --json", "surfaces --names"),
    ),
)
"""The commands in the order of the help."""


def format_examples(lines: Sequence[str]) -> str:
    """The examples at the end of a command's help."""
    return "\n".join(["Examples:", *(f"  tpmscad {line}" for line in lines)])


def make_app(only: str | None = None) -> typer.Typer:
    """The program with all commands; with the options of one only, so that the others need not be loaded."""
    app = typer.Typer(
        name="tpmscad",
        help="Triply periodic minimal surfaces and porous fields as exact, certified NURBS solids.",
        no_args_is_help=True,
        epilog=EXIT_STATUS_HELP,
        rich_markup_mode="rich",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_declare_global_options)
    for command in COMMANDS:
        add = app.command(
            command.name,
            short_help=command.short_help,
            epilog=format_examples(command.examples),
            rich_help_panel=command.panel,
        )
        add(in_option_language(command.load()) if only in (None, command.name) else _stand_in)
    return app


def _stand_in() -> None:
    """A command that is listed only."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line on `arguments` (default: those of the process); it ends in SystemExit."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    completing = any(name.startswith("_TPMSCAD") for name in os.environ)
    app = make_app(None if completing else next((word for word in words if not word.startswith("-")), ""))
    try:
        status = app(words, prog_name="tpmscad", standalone_mode=False)
    except InvalidRequest as error:
        _exit_with_error(str(error), 2)
    except (TpmscadError, OSError) as error:
        _exit_with_error(str(error), 1)
    except typer.TyperException as error:
        _exit_with_usage_error(error, words)
    except typer.Abort:
        _exit_with_error("interrupted", INTERRUPTED)
    sys.exit(status or 0)


def _exit_with_usage_error(error: typer.TyperException, words: Sequence[str]) -> NoReturn:
    """Exit with status 2 and the line of an error of usage; without arguments at all the help was asked for."""
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError" and context is not None:
        print(context.get_help())
        sys.exit(error.exit_code)
    message = error.format_message().rstrip(".").replace("Value error, ", "")
    # loads NumPy, for which help does not wait
    from tpmscad.cli.usage_hints import describe_bad_number, hint_at_meaning

    if described := describe_bad_number(error):
        message = f"{message.split(': ')[0]}: {described}"
    meant = hint_at_meaning(error, words)
    if meant:  # better than the options that are spelled alike
        message = f"{re.split(r' .Possible options|. Did you mean', message)[0]}: {meant}"
    where = f" (see {context.command_path} --help)" if context is not None else ""
    _exit_with_error(f"{message}{where}", error.exit_code)


def _exit_with_error(message: str, status: int) -> NoReturn:
    print("tpmscad:", " ".join(message.split()), file=sys.stderr)
    sys.exit(status)


def _show_version(show: bool) -> None:
    if show:
        print("tpmscad", __version__)
        raise typer.Exit


def _declare_global_options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass
