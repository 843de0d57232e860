"""Options of commands that follow from the arguments of the functions that they call.

`take_options_of(LatticeOptions)` gives a command an option for each argument of `tpmscad.lattice`: its name, what it takes, its
help and its default are those of the declaration. Only what a command line writes differently is said here.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import typer

from tpmscad.api.argument_kinds import POINT
from tpmscad.api.arguments import Argument, arguments_of
from tpmscad.api.shared_kinds import (
    ANGLE,
    ANYTHING,
    CELL_COUNTS,
    COUNT,
    DIRECTION,
    FACES,
    FLAG,
    FRACTION,
    GRADED_FRACTION,
    GRADED_OFFSET,
    GRADED_THICKNESS,
    LENGTHS,
    NAME_OR_FIELD,
    NOT_NEGATIVE,
    OFFSET,
    ONE_SOLID,
    OPENINGS,
    OVERHANG,
    PICTURE_SIZE,
    POSITIVE,
    SHAPE,
    SOLID,
    TEXT,
    TEXTS,
    VIEW,
    names_coordinate,
)
from tpmscad.catalogue import CATALOGUE, CORES, check_matter_name, find_surface
from tpmscad.cli.option_language import speak_in_options
from tpmscad.cli.options import (
    OUTPUT_PANEL,
    BodyArgument,
    DeviationOption,
    KeepLooseOption,
    OptionalOutputOption,
    OutputOption,
    ProgressOption,
    QuietOption,
    ReportOption,
    SchemaOption,
    VerboseOption,
    VerifyOption,
    parse_numbers,
    parse_solid,
    remedy_for_number,
)
from tpmscad.cli.output import OutputRequest
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import MODEL_SUFFIXES

CELL_PANEL = "Cell and position"
WALL_PANEL = "Wall: give one of --thickness, --offset, --volume-fraction, --porosity"
SKIN_PANEL = "Skin"
OPENINGS_PANEL = "Openings of the channels"
PANELS = {
    **dict.fromkeys(("cell", "cells", "pore_size", "boundary", "phase", "rotation"), CELL_PANEL),
    **dict.fromkeys(("thickness", "offset", "volume_fraction", "porosity", "kind", "side", "reference"), WALL_PANEL),
    **dict.fromkeys(("skin", "open_faces"), SKIN_PANEL),
    **dict.fromkeys(("openings", "transition"), OPENINGS_PANEL),
    "tol": OUTPUT_PANEL,
}
"""Panels of the help by argument; others stand in the panel of options."""

Request: TypeAlias = dict[str, Any]
"""The arguments that were given, by name."""


def complete_surface_name(incomplete: str) -> list[str]:
    """Names of the catalogue that begin so, for the completion of the shell."""
    return [name for name in CATALOGUE if name.startswith(incomplete)]


def complete_matter_name(incomplete: str) -> list[str]:
    """Names of surfaces and cores that begin so."""
    return [name for name in (*CATALOGUE, *CORES) if name.startswith(incomplete)]


def check_surface_name(name: str) -> str:
    """The name, before anything else is loaded; InvalidRequest if the catalogue does not know it."""
    find_surface(name)
    return name


def accept_matter_name(name: str) -> str:
    """The name of a surface or a core, or the path of a file of beams or of a recipe; InvalidRequest if it is none."""
    check_matter_name(name)
    if name.lower().endswith(".toml") and not Path(name).is_file():
        raise InvalidRequest(f"{name} is no file: give the path of a recipe, as `tpmscad template solidify` prints one")
    return name


def parse_size(text: str) -> tuple[int, int]:
    """Width and height in pixels of a text such as 1600x1200."""
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        raise typer.BadParameter(f"{text!r} is no size in pixels: write 1600x1200")
    return int(width), int(height)


def parse_graded(text: str) -> float | str:
    """A number, or the formula of a graded wall as it is, known by a coordinate."""
    try:
        return float(text)
    except ValueError:
        if not names_coordinate(text):
            raise typer.BadParameter(f"{text!r} is not a number{remedy_for_number(text)}") from None
        return text


def parse_graded_pair(text: str) -> float | str | tuple[float | str, ...]:
    """One of these, or two with a comma between them."""
    parts = tuple(map(parse_graded, text.split(",")))
    return parts if len(parts) > 1 else parts[0]


def parse_direction(text: str) -> str | tuple[float, ...]:
    """An axis such as -x, or the numbers of a vector."""
    if "," not in text:
        return text
    vector = parse_numbers(text)
    return vector if isinstance(vector, tuple) else text


def parse_part(text: str) -> Path | tuple[str | float, ...] | list[Any]:
    """The path of a CAD file, the surroundings of holes as in bosses,3, or both with a comma between."""
    file, comma, numbers = text.rpartition("bosses,")
    if not comma or (file and not file.endswith(",")):
        return Path(text)
    holes: tuple[str | float, ...] = ("bosses", *map(float, numbers.split(",")))
    return [Path(file[:-1]), holes] if file else holes


SurfaceArgument = Annotated[
    str,
    typer.Argument(
        autocompletion=complete_surface_name,
        callback=check_surface_name,
        help="Name of the surface; see `tpmscad surfaces`.",
    ),
]
MatterArgument = Annotated[
    str,
    typer.Argument(
        autocompletion=complete_matter_name,
        callback=accept_matter_name,
        help=f"Name of the surface, see `tpmscad surfaces`; or a core, {', '.join(CORES)}; a .3mf file of beams; or a "
        ".toml recipe of `tpmscad solidify`, whose field fills the body in place of its domain.",
    ),
]
OPERANDS: Mapping[str, Any] = {"body": BodyArgument, "surface": SurfaceArgument}
"""What stands without an option."""

WRITTEN: Mapping[Any, tuple[Any, dict[str, Any]]] = {
    POSITIVE.read: (float | None, {"metavar": "MM"}),
    GRADED_THICKNESS.read: (Any, {"metavar": "MM|FORMULA", "parser": parse_graded}),
    GRADED_FRACTION.read: (Any, {"metavar": "0..1|FORMULA", "parser": parse_graded}),
    FRACTION.read: (float | None, {"metavar": "0..1"}),
    TEXT.read: (str | None, {}),
    LENGTHS.read: (Any, {"metavar": "L|X,Y,Z", "parser": parse_numbers}),
    CELL_COUNTS.read: (Any, {"metavar": "N|X,Y,Z", "parser": parse_numbers}),
    ANGLE.read: (float | None, {"metavar": "DEGREES"}),
    OFFSET.read: (Any, {"metavar": "LO,HI", "parser": parse_numbers}),
    GRADED_OFFSET.read: (Any, {"metavar": "LO,HI", "parser": parse_graded_pair}),
    POINT.read: (Any, {"metavar": "X,Y,Z", "parser": parse_numbers}),
    FACES.read: (str, {"metavar": "FACES"}),
    SHAPE.read: (Any, {"metavar": "[PART.step][,][bosses,W]", "parser": parse_part}),
    FLAG.read: (bool, {}),
    COUNT.read: (int | None, {"metavar": "N"}),
    NOT_NEGATIVE.read: (float | None, {"metavar": "NUMBER"}),
    OVERHANG.read: (float | None, {"metavar": "DEGREES"}),
    DIRECTION.read: (Any, {"metavar": "AXIS|X,Y,Z", "parser": parse_direction}),
    VIEW.read: (str | None, {"metavar": "NAME|X,Y,Z"}),
    ANYTHING.read: (str | None, {}),
    PICTURE_SIZE.read: (Any, {"metavar": "WxH", "parser": parse_size}),
    ONE_SOLID.read: (Any, {"metavar": "N|largest", "parser": parse_solid}),
    SOLID.read: (Any, {"metavar": "N|largest|all", "parser": parse_solid}),
    OPENINGS.read: (list[str] | None, {"metavar": "CHANNEL=FACES"}),
    TEXTS.read: (list[str] | None, {"metavar": "NAME"}),
}
"""How a command line writes a kind of argument: the type of the option, its placeholder, and how its text is read."""

RENAMED_OPTIONS = {"openings": "open"}
"""Options that are given once for each part of the argument, and named for one."""

NOT_OPTIONS = ("map", "box", "progress", "executor", "path", "picture", "source")
"""Arguments that take functions only or belong to fields, and those that commands declare as operands of their own."""


def make_option(argument: Argument, panel: str | None) -> Parameter:
    """The option that stands for an argument; one that may be left out is None, or False, unless it is given."""
    known = {name: f"--{name.replace('_', '-')}" for name in PANELS}
    option_name = RENAMED_OPTIONS.get(argument.name, argument.name)
    default = argument.default
    shown = default
    if isinstance(default, tuple):
        shown = ("x" if argument.kind.read is PICTURE_SIZE.read else ",").join(f"{x:g}" for x in default)
    static, written = WRITTEN.get(argument.kind.read, (None, {}))
    if argument.kind.choices:
        static = Literal[argument.kind.choices] | None
    option = typer.Option(
        f"--{option_name.replace('_', '-')}",
        help=speak_in_options(argument.meaning.replace("``", "`"), known),
        rich_help_panel=panel or PANELS.get(argument.name),
        show_default=str(shown) if shown not in (None, "", False, Parameter.empty) else False,
        **written,
    )
    absent = Parameter.empty if argument.is_required else False if static is bool else None
    return Parameter(argument.name, Parameter.KEYWORD_ONLY, default=absent, annotation=Annotated[static, option])


OUTPUT_OPTIONS: Mapping[str, tuple[Any, Any]] = {
    "output": (OutputOption, Parameter.empty),
    "deviation": (DeviationOption, None),
    "schema": (SchemaOption, "ap242"),
    "verify": (VerifyOption, None),
    "report": (ReportOption, None),
    "verbose": (VerboseOption, False),
    "quiet": (QuietOption, False),
    "progress": (ProgressOption, "bar"),
}
"""The options of every command that writes a model: annotation and default."""


def take_output(
    output: Any = OutputOption, *, suffixes: tuple[str, ...] = MODEL_SUFFIXES, leave_out: tuple[str, ...] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator of commands: where the result goes and how comes as the last argument, `writing`, an `OutputRequest`."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        *own, _ = inspect.signature(command, eval_str=True).parameters.values()
        options = {name: option for name, option in OUTPUT_OPTIONS.items() if name not in leave_out}
        options["output"] = (output, Parameter.empty if output is not OptionalOutputOption else None)

        @functools.wraps(command)
        def run(*operands: Any, **given: Any) -> None:
            writing = OutputRequest(**{name: given.pop(name) for name in options}, suffixes=suffixes)
            command(*operands, **given, writing=writing)

        shown = [
            *own,
            *(Parameter(n, Parameter.KEYWORD_ONLY, default=d, annotation=a) for n, (a, d) in options.items()),
        ]
        run.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in shown}
        return run

    return decorate


def take_options_of(
    options: type, *, panel: str | None = None, leave_out: tuple[str, ...] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator of commands: the arguments that are given come as the dictionary `request`, before the options of its own.

    The option --keep-loose stands for the argument `loose`. leave_out: arguments that the command declares itself.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        derived = [a for a in arguments_of(options).values() if a.name not in (*NOT_OPTIONS, *leave_out)]
        names = [a.name for a in derived if a.name != "loose"]
        own = list(inspect.signature(command, eval_str=True).parameters.values())[1:]
        own = [p.replace(kind=Parameter.KEYWORD_ONLY) for p in own]
        matter = {a.name: MatterArgument for a in derived if a.kind.read is NAME_OR_FIELD.read}
        shown = [
            Parameter(name, Parameter.KEYWORD_ONLY, annotation=note)
            for name, note in {**OPERANDS, **matter}.items()
            if name in names
        ]
        operands = [p for p in own if type(p.annotation.__metadata__[0]).__name__ == "ArgumentInfo"]
        shown += [
            *operands,
            *(make_option(a, panel) for a in derived if a.name in names and a.name not in OPERANDS),
            *(p for p in own if p not in operands),
        ]
        if len(names) < len(derived):
            shown.append(Parameter("keep_loose", Parameter.KEYWORD_ONLY, default=False, annotation=KeepLooseOption))

        @functools.wraps(command)
        def run(**given: Any) -> None:
            request = {name: given.pop(name) for name in names}
            if given.pop("keep_loose", False):
                request["loose"] = "keep"
            command({name: v for name, v in request.items() if v is not None and v is not False and v != []}, **given)

        run.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in shown}
        return run

    return decorate
