"""The printed reference of recipes, made from the declarations that the reader uses, and the templates to start from."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path

from tpmscad.errors import InvalidRequest
from tpmscad.recipe.blend_recipe import BLEND_KEYS, WEIGHT_KINDS
from tpmscad.recipe.field_kind import REQUIRED, Key, KeyTable
from tpmscad.recipe.field_reader import FIELD_KINDS
from tpmscad.recipe.solid_recipe import SOLID_KEYS
from tpmscad.recipe.toml_entry import suggest_word
from tpmscad.recipe.value_types import words_of

TEMPLATE_FOLDER = Path(__file__).parent / "templates"

RECIPES: dict[str, tuple[str, KeyTable]] = {
    "solidify": ("The solid of one field.", SOLID_KEYS),
    "blend": ("Porous structures joined without isolated pieces or cavities.", BLEND_KEYS),
}
"""The two kinds of recipes by the names of their commands."""

INTRODUCTION = (
    "A field is a table with a `kind`, a number, or the name of a field defined as [fields.NAME]; it is solid where it is "
    "negative. Lengths are in mm, angles in degrees. Files are named relative to the folder of the recipe."
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
    found = [text for _, own, text in sections if own == name]
    if not found:
        names = [own for _, own, _ in sections]
        raise InvalidRequest(f"{name!r} is no kind of a recipe: {suggest_word(name, names)}")
    return "\n\n".join(found)


def _all_sections(width: int) -> Iterator[tuple[str, str, str]]:
    """The title of the group, the name and the text of every recipe and kind."""
    for name, (meaning, table) in RECIPES.items():
        yield "RECIPES", name, _format_table(f"tpmscad {name} FILE.toml", meaning, table, width)
    for name, kind in FIELD_KINDS.items():
        yield "FIELDS", name, _format_table(f'kind = "{name}"', kind.meaning, kind.table, width)
    for name, weight in WEIGHT_KINDS.items():
        yield "WEIGHTS OF A BLEND", name, _format_table(f'kind = "{name}"', weight.meaning, weight.table, width)


def _format_table(head: str, meaning: str, table: KeyTable, width: int) -> str:
    """A table with its keys: name, type, unit, what it means, its default."""
    one_line = f"{head}    {meaning}"
    wrapped = textwrap.fill(meaning, width, initial_indent="  ", subsequent_indent="  ")
    lines = [one_line if len(one_line) <= width else f"{head}\n{wrapped}"]
    name_width = max(len(" | ".join(key.spellings)) for key in table.keys) + 2
    for key in table.keys:
        unit = f" [{key.unit}]" if key.unit else ""
        left = f"  {' | '.join(key.spellings).ljust(name_width)}"
        body = f"{key.type.text}{unit}: {key.meaning} ({_describe_default(key, table)})"
        indent = " " * len(left)
        lines.append(textwrap.fill(body, width, initial_indent=left, subsequent_indent=indent, break_on_hyphens=False))
    return "\n".join(lines)


def _describe_default(key: Key, table: KeyTable) -> str:
    """The default of a key, or when it must be given."""
    for group in table.one_of:
        if key.name in group:
            others = words_of(group, "or")
            return f"one of {others} is required"
    context = f", with {key.only_with!r} only" if key.only_with else ""
    if key.default is REQUIRED:
        return f"required{context}" if not context else f"required with {key.only_with!r}"
    if key.default_text:
        return f"default: {key.default_text}{context}"
    if key.default is None:
        return f"optional{context}"
    return f"default: {_format_value(key.default)}{context}"


def _format_value(value: object) -> str:
    """A default as it is written in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(f'{x:g}' for x in value)}]"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)
