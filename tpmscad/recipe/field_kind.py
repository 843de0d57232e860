"""Kinds of fields in recipes, and the values that their tables share: points, directions, cell edges and boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tpmscad.fields import Field
from tpmscad.recipe.toml_entry import Entry

ReadField = Callable[[Entry], Field]
"""Function that reads the field of an entry: a table with a kind, a number, or the name of a field that the recipe defines."""

RecipeBox = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Opposite corners of a box, the lower one first, in mm."""


@dataclass(frozen=True, slots=True)
class FieldKind:
    """The keys that a table of this kind may have in addition to `kind`, and the function that makes its field."""

    keys: tuple[str, ...]
    make: Callable[[Entry, ReadField], Field]


def make_kind(keys: str, make: Callable[[Entry, ReadField], Field]) -> FieldKind:
    """The kind with the keys of a string, separated by spaces."""
    return FieldKind(tuple(keys.split()), make)


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
