"""Options of commands that follow from the arguments of the functions that they call.

`take_options_of(LatticeOptions)` gives a command an option for each argument of `tpmscad.lattice`: its name, what it takes, its
help and its default are those of the declaration. Only what a command line writes differently is said here.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from inspect import Parameter
from typing import Annotated, Any, Literal, TypeAlias

import typer

from tpmscad.api.argument_kinds import POINT
from tpmscad.api.arguments import Argument, arguments_of
from tpmscad.api.shared_kinds import CELL_COUNTS, FACES, FRACTION, LENGTHS, OFFSET, POSITIVE, TEXT, WALL_THICKNESS
from tpmscad.catalogue import CATALOGUE, find_surface
from tpmscad.cli.option_language import speak_in_options
from tpmscad.cli.options import OUTPUT_PANEL, BodyArgument, KeepLooseOption, parse_numbers

CELL_PANEL = "Cell and position"
WALL_PANEL = "Wall: give one of --thickness, --offset, --volume-fraction, --porosity"
SKIN_PANEL = "Skin"
PANELS = {
    **dict.fromkeys(("cell", "cells", "pore_size", "boundary", "phase", "rotation"), CELL_PANEL),
    **dict.fromkeys(("thickness", "offset", "volume_fraction", "porosity", "kind", "side", "reference"), WALL_PANEL),
    **dict.fromkeys(("skin", "open_faces"), SKIN_PANEL),
    "tol": OUTPUT_PANEL,
}
"""Panels of the help by argument; others stand in the panel of options."""

Request: TypeAlias = dict[str, Any]
"""The arguments that were given, by name."""


def complete_surface_name(incomplete: str) -> list[str]:
    """Names of the catalogue that begin so, for the completion of the shell."""
    return [name for name in CATALOGUE if name.startswith(incomplete)]


def check_surface_name(name: str) -> str:
    """The name, before anything else is loaded; InvalidRequest if the catalogue does not know it."""
    find_surface(name)
    return name


def parse_faces(text: str) -> tuple[str | int, ...]:
    """Numbers of faces, and selectors such as >Z, between commas."""
    return tuple(int(part) if part.isdigit() else part for part in text.replace(" ", "").split(","))


SurfaceArgument = Annotated[
    str,
    typer.Argument(
        autocompletion=complete_surface_name,
        callback=check_surface_name,
        help="Name of the surface; see `tpmscad surfaces`.",
    ),
]
OPERANDS: Mapping[str, Any] = {"body": BodyArgument, "surface": SurfaceArgument}
"""What stands without an option."""

WRITTEN: Mapping[Any, tuple[Any, dict[str, Any]]] = {
    POSITIVE.read: (float | None, {"metavar": "MM"}),
    WALL_THICKNESS.read: (float | None, {"metavar": "MM"}),
    FRACTION.read: (float | None, {"metavar": "0..1"}),
    TEXT.read: (str | None, {}),
    LENGTHS.read: (Any, {"metavar": "L|X,Y,Z", "parser": parse_numbers}),
    CELL_COUNTS.read: (Any, {"metavar": "N|X,Y,Z", "parser": parse_numbers}),
    OFFSET.read: (Any, {"metavar": "LO,HI", "parser": parse_numbers}),
    POINT.read: (Any, {"metavar": "X,Y,Z", "parser": parse_numbers}),
    FACES.read: (Any, {"metavar": "FACES", "parser": parse_faces}),
}
"""How a command line writes a kind of argument: the type of the option, its placeholder, and how its text is read."""

NOT_OPTIONS = ("map", "progress")
"""Arguments that take functions only."""


def make_option(argument: Argument) -> Any:
    """The annotation of the option that stands for an argument; all are None unless they are given."""
    known = {name: f"--{name.replace('_', '-')}" for name in PANELS}
    meaning = speak_in_options(argument.meaning.replace("``", "`"), known)
    default = argument.default
    shown = ",".join(f"{x:g}" for x in default) if isinstance(default, tuple) and default else default
    static, written = WRITTEN.get(argument.kind.read, (None, {}))
    if argument.kind.choices:
        static = Literal[argument.kind.choices] | None
    return Annotated[
        static,
        typer.Option(
            help=meaning,
            rich_help_panel=PANELS.get(argument.name),
            show_default=str(shown) if shown not in (None, ()) else False,
            **written,
        ),
    ]


def take_options_of(
    options: type, *, leave_out: tuple[str, ...] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator of commands: the arguments that are given come as the dictionary `request`, before the options of its own.

    The option --keep-loose stands for the argument `loose`.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        derived = [a for a in arguments_of(options).values() if a.name not in (*NOT_OPTIONS, *leave_out)]
        names = [a.name for a in derived if a.name != "loose"]
        own = list(inspect.signature(command, eval_str=True).parameters.values())[1:]
        shown = [
            Parameter(name, Parameter.POSITIONAL_OR_KEYWORD, annotation=note)
            for name, note in OPERANDS.items()
            if name in names
        ]
        shown += [
            Parameter(a.name, Parameter.KEYWORD_ONLY, default=None, annotation=make_option(a))
            for a in derived
            if a.name in names and a.name not in OPERANDS
        ]
        keep_loose = Parameter("keep_loose", Parameter.KEYWORD_ONLY, default=False, annotation=KeepLooseOption)
        shown += [*own, keep_loose] if len(names) < len(derived) else own

        @functools.wraps(command)
        def run(**given: Any) -> None:
            request = {name: given.pop(name) for name in names}
            if given.pop("keep_loose", False):
                request["loose"] = "keep"
            command({name: value for name, value in request.items() if value is not None}, **given)

        run.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in shown}
        return run

    return decorate
