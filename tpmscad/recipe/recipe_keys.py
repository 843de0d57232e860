"""Keys of recipes: the arguments of a function, with the words of recipes and of TOML.

A table of a recipe is a call. Its keys are the arguments that the function declares (`tpmscad.api.arguments`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from inspect import unwrap
from pathlib import Path
from typing import Any

from tpmscad.api.argument_kinds import ArgumentKind, InvalidValue, read_callable
from tpmscad.api.arguments import Argument, arguments_of
from tpmscad.fields import Field
from tpmscad.fields.field import ConstantField

RECIPE_WORDS = {
    "field": "of",
    "fields": "of",
    "phi": "of",
    "taken": "minus",
    "name": "surface",
    "named": "names",
    "period": "cell",
}
"""The other word of recipes for an argument, by its name; `file` is that of every argument that takes the path of a file."""

TOML_WORDS = {
    "a field, a function of points (..., 3), or a number": "a field or a number",
    "a function of points (..., 3)": "a field",
    "a sequence of fields": "an array of fields",
    "is no sequence of values": "must be an array [...]",
    "((x0, y0, z0), (x1, y1, z1))": "[[x0, y0, z0], [x1, y1, z1]]",
    "(x, y, z)": "[x, y, z]",
    "True": "true",
    "False": "false",
    "model units": "mm",
    "model unit": "mm",
    "``": "`",
}
"""Words of Python in the texts of arguments, and what they are in a recipe."""

SOME_FIELD = ConstantField(0.0)
"""A field to try whether a kind of argument takes one."""


@dataclass(frozen=True, slots=True)
class Key:
    """An argument as a key of a table, and other words for it."""

    argument: Argument
    others: tuple[str, ...] = ()

    @property
    def words(self) -> tuple[str, ...]:
        """Every word for the key, its own name first."""
        return (self.argument.name, *self.others)


KeyTable = Mapping[str, Key]
"""The keys of a table by the names of the arguments."""


def keys_of(function: Callable[..., Any]) -> KeyTable:
    """The keys of a table that is a call of a function; an argument that is only another word for one before it is none."""
    arguments = arguments_of(function)
    repeated = {RECIPE_WORDS[name] for name in arguments if name in RECIPE_WORDS}
    return {
        name: Key(argument, tuple(_other_words(argument)))
        for name, argument in arguments.items()
        if name not in repeated
    }


def make_table(arguments: Iterable[Argument]) -> KeyTable:
    """The keys of a table without other words."""
    return {argument.name: Key(argument) for argument in arguments}


def _other_words(argument: Argument) -> Iterable[str]:
    """The words of recipes for an argument besides its name."""
    if argument.name in RECIPE_WORDS:
        yield RECIPE_WORDS[argument.name]
    if argument.name != "file" and takes(argument.kind, Path("file")):
        yield "file"


def takes(kind: ArgumentKind, value: Any) -> bool:
    """Whether a value is of a kind."""
    try:
        kind.read(value)
    except InvalidValue:
        return False
    return True


def makes_field(function: Any) -> bool:
    """Whether a public function returns a field, and none of its arguments is a function, which no recipe can write."""
    if isinstance(function, type) or not hasattr(function, "__arguments__"):
        return False
    plain = unwrap(function)
    result = eval(plain.__annotations__["return"], plain.__globals__)
    is_field = isinstance(result, type) and issubclass(result, Field)
    return is_field and all(argument.kind.read is not read_callable for argument in arguments_of(function).values())


def in_toml_words(text: str) -> str:
    """A text on arguments as it reads in a recipe."""
    return reduce(lambda result, pair: result.replace(*pair), TOML_WORDS.items(), text)
