"""What a kind of field is to a recipe: the keys its table may have, and the field made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tpmscad.fields import Field
from tpmscad.recipe.toml_entry import Entry

ReadField = Callable[[Entry], Field]
"""The field of an entry: of a table with a kind, a number, or the name of a field that the recipe defines."""


@dataclass(frozen=True, slots=True)
class FieldKind:
    """The keys of a table of this kind, `kind` itself left out, and the field it makes with a way to read those within."""

    keys: tuple[str, ...]
    make: Callable[[Entry, ReadField], Field]


def make_kind(keys: str, make: Callable[[Entry, ReadField], Field]) -> FieldKind:
    return FieldKind(tuple(keys.split()), make)


def read_triple(entry: Entry) -> tuple[float, float, float]:
    x, y, z = entry.numbers(3)
    return x, y, z


def read_cell_edges(entry: Entry) -> float | tuple[float, float, float]:
    """A positive number, or one for each axis."""
    if not isinstance(entry.value, list):
        return entry.positive()
    x, y, z = (item.positive() for item in entry.array_of_length(3, "numbers, one for each axis"))
    return x, y, z


def read_direction(entry: Entry) -> str | tuple[float, float, float]:
    """ "x", "-y", ... or a vector."""
    if isinstance(entry.value, str):
        return entry.text([sign + axis for sign in ("", "-") for axis in "xyz"])
    vector = read_triple(entry)
    if not any(vector):
        raise entry.error("the vector has no length")
    return vector
