"""Types of the values in recipes: how each is described to a reader, and how it is read and checked.

A type reads an entry and returns a plain value or a field; RecipeError names the file, the line and the key of what is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field, find_surface
from tpmscad.recipe.toml_entry import Entry

ReadField = Callable[[Entry], Field]
"""Function that reads the field of an entry: a table with a kind, a number, or the name of a field that the recipe defines."""

RecipeBox = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Opposite corners of a box, the lower one first, in mm."""


@dataclass(frozen=True, slots=True)
class ValueType:
    """What a key takes, in words, and the function that reads it."""

    text: str
    read: Callable[[Entry, ReadField], Any]


def plain_type(text: str, read: Callable[[Entry], Any]) -> ValueType:
    """A type whose values hold no field."""
    return ValueType(text, lambda entry, _: read(entry))


def choice_type(*words: str) -> ValueType:
    """One of the words."""
    return plain_type(" | ".join(f'"{word}"' for word in words), lambda entry: entry.string(words))


def numbers_type(count: int) -> ValueType:
    """An array of `count` numbers."""
    return plain_type(f"{count} numbers", lambda entry: entry.numbers(count))


def read_triple(entry: Entry) -> tuple[float, float, float]:
    """Three finite numbers, one for each axis."""
    x, y, z = entry.numbers(3)
    return x, y, z


def read_cell_edges(entry: Entry) -> float | tuple[float, float, float]:
    """A positive number, or one for each axis."""
    if not isinstance(entry.value, list):
        return entry.positive()
    x, y, z = (item.positive() for item in entry.array_of_length(3, "numbers, one for each axis"))
    return x, y, z


def read_direction(entry: Entry) -> str | tuple[float, float, float]:
    """A signed axis such as "x" or "-y", or a vector that is not zero."""
    if isinstance(entry.value, str):
        return entry.string([sign + axis for sign in ("", "-") for axis in "xyz"])
    vector = read_triple(entry)
    if not any(vector):
        raise entry.error("the vector has length zero")
    return vector


def read_box_corners(entry: Entry) -> RecipeBox:
    """Two corners; RecipeError unless each coordinate of the first lies below that of the second."""
    low, high = (read_triple(corner) for corner in entry.array_of_length(2, "corners"))
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise entry.error(f"{entry.value} is empty: each coordinate of the first corner must be below the second's")
    return low, high


def read_unbounded_corner(entry: Entry) -> tuple[float, ...]:
    """Three numbers, which may be infinite."""
    return tuple(
        item.value if isinstance(item.value, float) and abs(item.value) == float("inf") else item.number()
        for item in entry.array_of_length(3, "numbers")
    )


def read_counts(entry: Entry) -> tuple[int, int, int]:
    """Three positive integers, one for each axis."""
    x, y, z = (item.integer() for item in entry.array_of_length(3, "whole numbers"))
    return x, y, z


def read_surface_name(entry: Entry) -> str:
    """The name of a surface of the catalogue."""
    try:
        return find_surface(entry.string()).name
    except InvalidRequest as error:
        raise entry.error(str(error)) from error


def read_nested_array(entry: Entry) -> np.ndarray:
    """The array (nx, ny, nz) of an entry of nested arrays."""
    planes = [[[number.number() for number in row.items()] for row in plane.items()] for plane in entry.items()]
    try:
        return np.array(planes, float)
    except ValueError:
        raise entry.error("must be an array of arrays of arrays of one length each") from None


def read_file_path(entry: Entry) -> Path:
    """The path of an existing file, relative to the folder of the recipe."""
    return entry.sibling_file()


def read_pair_or_triple(entry: Entry) -> tuple[float, ...]:
    """Two or three numbers."""
    items = entry.items()
    if len(items) not in (2, 3):
        raise entry.error(f"must be 2 numbers for a picture or 3 for an array, not {len(items)}")
    return tuple(item.number() for item in items)


def _read_fields(entry: Entry, read: ReadField) -> list[Field]:
    """The fields of an array; RecipeError if it is empty."""
    found = [read(item) for item in entry.items()]
    if not found:
        raise entry.error("is empty: at least one field is needed")
    return found


def _read_number_or_field(entry: Entry, read: ReadField) -> float | Field:
    """A number as such, anything else as a field."""
    return read(entry) if isinstance(entry.value, str | dict) else entry.number()


def _read_axis_or_field(entry: Entry, read: ReadField) -> str | Field:
    """One of the letters x, y and z, or a field."""
    return str(entry.value) if entry.value in ("x", "y", "z") else read(entry)


def fields_type(count: int, what: str) -> ValueType:
    """An array of `count` fields; `what` names them in errors."""
    return ValueType(f"{count} fields", lambda entry, read: [read(item) for item in entry.array_of_length(count, what)])


NUMBER = plain_type("number", Entry.number)
POSITIVE = plain_type("number above 0", Entry.positive)
COUNT = plain_type("whole number", Entry.integer)
COUNTS = plain_type("3 whole numbers", read_counts)
SEED = plain_type("whole number", lambda entry: entry.integer(0))
BOOLEAN = plain_type("true | false", Entry.boolean)
STRING = plain_type("text", Entry.string)
POINT = plain_type("3 numbers", read_triple)
CORNER = plain_type("3 numbers or inf", read_unbounded_corner)
CELL = plain_type("number or 3", read_cell_edges)
DIRECTION = plain_type('"x", "-y", ... or 3 numbers', read_direction)
FILE = plain_type("file name", read_file_path)
SURFACE = plain_type("surface name", read_surface_name)
FIELD = ValueType("field", lambda entry, read: read(entry))
FIELDS = ValueType("array of fields", _read_fields)
NUMBER_OR_FIELD = ValueType("number or field", _read_number_or_field)
AXIS_OR_FIELD = ValueType('"x" | "y" | "z" or field', _read_axis_or_field)


def words_of(names: Sequence[str], last: str = "and") -> str:
    """The names in quotes with commas between, and the word `last` before the last one."""
    quoted = [f"'{name}'" for name in names]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} {last} {quoted[-1]}"
