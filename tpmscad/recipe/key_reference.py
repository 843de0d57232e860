"""The printed reference of recipes, made from the declarations that the reader uses, and the templates to start from."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from inspect import Parameter, getdoc
from pathlib import Path
from typing import Any

from tpmscad.api.arguments import Argument
from tpmscad.errors import InvalidRequest
from tpmscad.recipe.blend_recipe import BLEND_KEYS, WEIGHT_KINDS
from tpmscad.recipe.field_kinds import field_kinds
from tpmscad.recipe.recipe_keys import KeyTable, in_toml_words, keys_of
from tpmscad.recipe.solid_recipe import SOLID_KEYS
from tpmscad.recipe.toml_entry import suggest_word

TEMPLATE_FOLDER = Path(__file__).parent / "templates"

RECIPES: dict[str, tuple[str, KeyTable]] = {
    "solidify": ("The solid of one field.", SOLID_KEYS),
    "blend": ("Porous structures joined without isolated pieces or cavities.", BLEND_KEYS),
}
"""The two kinds of recipes by the names of their commands."""

INTRODUCTION = (
    "A field is a table with a `kind`, a number, or the name of a field defined as [fields.NAME]; it is solid where it is "
    "negative. Its kind is a function of `tpmscad.fields`, or one of recipes alone; its keys are the arguments. Lengths are in "
    "mm, angles in degrees. Files are named relative to the folder of the recipe."
)


def read_template(name: str) -> str:
    """The text of the template for a command: the recipe of "blend" or "solidify", the table of "sweep"."""
    return next(TEMPLATE_FOLDER.glob(f"{name}.*")).read_text("utf-8")


def format_reference(name: str | None = None, *, width: int = 100) -> str:
    """The keys of one kind or recipe, or of all; InvalidRequest if there is none of this name."""
    sections = list(_all_sections(width))
    if name is None:
        titles = dict.fromkeys(title for title, _, _ in sections)
        grouped = (f"{title}\n\n" + "\n\n".join(text for t, _, text in sections if t == title) for title in titles)
        return "\n\n".join((textwrap.fill(INTRODUCTION, width), *grouped))
    found = [text for _, names, text in sections if name in names]
    if not found:
        known = [own for _, names, _ in sections for own in names]
        raise InvalidRequest(f"{name!r} is no kind of a recipe: {suggest_word(name, known)}")
    return "\n\n".join(found)


def _all_sections(width: int) -> Iterator[tuple[str, list[str], str]]:
    """The title of the group, the names and the text of every recipe and kind."""
    for name, (meaning, keys) in RECIPES.items():
        yield "RECIPES", [name], _format_table(f"tpmscad {name} FILE.toml", meaning, keys, width)
    for title, kinds in (("FIELDS", field_kinds()), ("WEIGHTS OF A BLEND", WEIGHT_KINDS)):
        for function in dict.fromkeys(kinds.values()):
            names = [name for name, other in kinds.items() if other is function]
            head = f"kind = {' | '.join(map(_format_value, names))}"
            yield title, names, _format_table(head, _find_meaning(function), keys_of(function), width)


def _find_meaning(function: Any) -> str:
    """What a function makes: the first line of its docstring."""
    words = (getdoc(function) or "").partition("\n")[0].removeprefix("Return ")
    return in_toml_words(words[:1].upper() + words[1:])


def _format_table(head: str, meaning: str, keys: KeyTable, width: int) -> str:
    """A table with its keys: name, what it takes, what it means, its default."""
    one_line = f"{head}    {meaning}"
    wrapped = textwrap.fill(meaning, width, initial_indent="  ", subsequent_indent="  ")
    lines = [one_line if len(one_line) <= width else f"{head}\n{wrapped}"]
    name_width = max(len(" | ".join(key.words)) for key in keys.values()) + 2
    for key in keys.values():
        left = f"  {' | '.join(key.words).ljust(name_width)}"
        body = f"{describe_kind(key.argument)}. {in_toml_words(key.argument.meaning)}{_format_default(key.argument)}"
        indent = " " * len(left)
        lines.append(textwrap.fill(body, width, initial_indent=left, subsequent_indent=indent, break_on_hyphens=False))
    return "\n".join(lines)


def describe_kind(argument: Argument) -> str:
    """What an argument takes, as it is written in a recipe."""
    text = in_toml_words(argument.kind.text)
    if argument.passed is Parameter.VAR_POSITIONAL:
        return f"an array, each entry {text}"
    return f"a table {{ name = ... }}, each value {text}" if argument.passed is Parameter.VAR_KEYWORD else text


def _format_default(argument: Argument) -> str:
    """The default of an argument, or that it must be given."""
    if argument.is_required:
        return " (required)"
    return "" if argument.default in (None, Parameter.empty) else f" (default: {_format_value(argument.default)})"


def _format_value(value: object) -> str:
    """A default as it is written in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(f'{x:g}' for x in value)}]"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)
