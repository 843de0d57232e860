"""The fields of a recipe: tables with a kind, numbers, and the names of fields that the recipe defines under `[fields.NAME]`.

A table is read as a call: every key by the kind of its argument. What takes a field is a table with a kind, a name or a number;
what takes the path of a file is the name of one that exists, relative to the folder of the recipe.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from inspect import BoundArguments, Parameter, signature
from pathlib import Path
from typing import Any, TypeVar

from tpmscad import fields
from tpmscad.api.argument_kinds import ArgumentKind, InvalidValue, WrongType, instance_of, read_field
from tpmscad.api.arguments import Argument
from tpmscad.errors import InvalidRequest, RecipeError
from tpmscad.fields import Field
from tpmscad.recipe.field_kinds import field_kinds
from tpmscad.recipe.recipe_keys import SOME_FIELD, KeyTable, in_toml_words, keys_of, takes
from tpmscad.recipe.toml_entry import Entry

R = TypeVar("R")

FIELD_OF_RECIPE = ArgumentKind("a table with a kind, the name of a field, or a number", "", read_field)

FIELDS_ARGUMENT = Argument(
    "fields",
    dict,
    instance_of("a table of fields", "", dict),
    "Fields that are used by name: [fields.NAME].",
    default=None,
)
"""The argument of a whole recipe that holds the fields it defines."""


def find_entries(table: Entry, keys: KeyTable, *besides: str) -> dict[str, Entry]:
    """The entries of a table by the names of their arguments; RecipeError for a key that is unknown, missing or given twice.

    The keys `besides` are allowed, and not among the entries.
    """
    table.table(*besides, *(word for key in keys.values() for word in key.words))
    found = {}
    for name, key in keys.items():
        given = [word for word in key.words if word in table.value]
        if len(given) > 1:
            raise table.part(given[1]).error(f"is another name of {given[0]!r}: give one of them")
        if given:
            found[name] = table.part(given[0])
        elif key.argument.is_required:
            raise table.error(f"the key {(*key.others, name)[0]!r} is missing")
    return found


def read_call(function: Callable[..., R], table: Entry) -> R:
    """What a function returns for the arguments in a table; RecipeError with the line of the key that is invalid."""
    keys = keys_of(function)
    entries = find_entries(table, keys, "kind")
    values = {name: read_argument(keys[name].argument, entry) for name, entry in entries.items()}
    bound = BoundArguments(signature(function), values)
    try:
        return function(*bound.args, **bound.kwargs)
    except RecipeError:
        raise
    except InvalidRequest as error:
        files = {word: entry for name, entry in entries.items() for word in keys[name].others if word == "file"}
        raise table.locate(str(error), entries | files) from error


def read_table(
    table: Entry, keys: KeyTable, readers: Mapping[str, Callable[[Entry], Any]] | None = None
) -> dict[str, Any]:
    """The values of a table by the names of their arguments, some of them with readers of their own."""
    special = readers or {}
    return {
        name: special[name](entry) if name in special else read_argument(keys[name].argument, entry)
        for name, entry in find_entries(table, keys).items()
    }


def read_argument(argument: Argument, entry: Entry) -> Any:
    """The value of an argument: an array holds those of `*args`, a table those of `**kwargs`."""
    if argument.passed is Parameter.VAR_POSITIONAL:
        return tuple(read_value(argument.kind, item) for item in entry.items())
    if argument.passed is Parameter.VAR_KEYWORD:
        return {name: read_value(argument.kind, entry.part(name)) for name in entry.table().value}
    return read_value(argument.kind, entry)


def read_value(kind: ArgumentKind, entry: Entry) -> Any:
    """The value of an entry in its final form; RecipeError names the value and what the kind takes."""
    if kind.read is read_field:
        return read_field_entry(entry)
    if kind.choices:
        return entry.word(kind.choices)
    try:
        return kind.read(_read_fields_and_paths(kind, entry))
    except InvalidValue as reason:
        raise _refuse(entry, kind, reason) from None


def _read_fields_and_paths(kind: ArgumentKind, entry: Entry) -> Any:
    """The value of an entry, with the fields and the path that a kind takes in place of tables and names."""
    value = entry.value
    if isinstance(value, list) and takes(kind, [SOME_FIELD] * len(value)):
        return [read_field_entry(item) for item in entry.items()]
    if isinstance(value, str) and takes(kind, Path("file")):
        return entry.sibling_file()
    if isinstance(value, dict | str) and not takes(kind, value) and takes(kind, SOME_FIELD):
        return read_field_entry(entry)
    return value


def _refuse(entry: Entry, kind: ArgumentKind, reason: InvalidValue) -> RecipeError:
    """The error of a value that is not of a kind, at the innermost entry that the reason is about."""
    text, words = in_toml_words(kind.text), in_toml_words(str(reason))
    wanted = f"; it takes {text}" if isinstance(reason, WrongType) and not reason.place and text not in words else ""
    part = entry.part(*reason.place)
    return part.error(f"{part.value_text} {words}{wanted}")


def read_field_entry(entry: Entry) -> Field:
    """The field of an entry; RecipeError with its line if it is invalid."""
    if isinstance(entry.value, str):
        return read_field_entry(_find_definition(entry))
    if not isinstance(entry.value, dict):
        try:
            return fields.as_field(read_field(entry.value))
        except InvalidValue as reason:
            raise _refuse(entry, FIELD_OF_RECIPE, reason) from None
    kinds: Mapping[str, Callable[..., Field]] = field_kinds()
    try:
        return read_call(kinds[entry["kind"].word(tuple(kinds))], entry)
    except RecursionError:
        raise entry.error(
            "this field is nested more deeply in others than Python can follow: join many fields in one list, "
            "as in of = ['a', 'b', 'c']"
        ) from None


def _find_definition(entry: Entry) -> Entry:
    """The field of a name that the recipe defines; no field may be defined by itself."""
    top, name = entry.document.top, entry.value
    if not top.value.get("fields"):
        raise entry.error(f"{name!r} names no field: define it as [fields.{name}], or give a table")
    defined = top["fields"].table()
    entry.word(tuple(defined.value))
    if name in entry.active_names:
        raise entry.error(f"the field {name!r} is defined by itself: {' -> '.join((*entry.active_names, name))}")
    return replace(defined[name], active_names=(*entry.active_names, name))
