"""Keys of recipes, each declared once: the reader, its errors and the printed reference all follow from the declaration.

A `KeyTable` reads a table of a recipe into plain values and fields; a `FieldKind` makes a field of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from tpmscad.errors import InvalidRequest, RecipeError
from tpmscad.fields import Field
from tpmscad.recipe.toml_entry import Entry
from tpmscad.recipe.value_types import ReadField, ValueType, words_of

REQUIRED = object()
"""The default of a key that has none."""


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a table: its type, its meaning, its unit, its default, and other names that are understood.

    `only_with` names a key without which this one has no meaning. `default_text` describes a default that is no plain value.
    """

    name: str
    type: ValueType
    meaning: str
    unit: str = ""
    default: Any = REQUIRED
    default_text: str = ""
    only_with: str = ""
    also: tuple[str, ...] = ()

    @property
    def spellings(self) -> tuple[str, ...]:
        """The name and the other names that are understood."""
        return (self.name, *self.also)

    def find(self, table: Entry) -> Entry | None:
        """The entry of this key in a table, or None; RecipeError if it is given under two names."""
        given = [found for name in self.spellings if (found := table.get(name)) is not None]
        if len(given) > 1:
            raise given[1].error(f"is another name of {given[0].path[-1]!r}: give one of them")
        return given[0] if given else None


@dataclass(frozen=True, slots=True)
class KeyTable:
    """The keys of a table; of each group in `one_of` exactly one key is given."""

    keys: tuple[Key, ...]
    one_of: tuple[tuple[str, ...], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Every accepted spelling of every key."""
        return tuple(name for key in self.keys for name in key.spellings)

    def read(self, table: Entry, read_field: ReadField, *, besides: Iterable[str] = ()) -> dict[str, Any]:
        """The values of a table by the names of the keys; keys in `besides` are allowed and not read."""
        table.table(*besides, *self.names)
        alternatives = {name for group in self.one_of for name in group}
        found = {key.name: key.find(table) for key in self.keys}
        for group in self.one_of:
            _check_one_of(table, group, [name for name in group if found[name] is not None])
        values = {}
        for key in self.keys:
            entry = found[key.name]
            has_context = not key.only_with or found[key.only_with] is not None
            if entry is not None:
                if not has_context:
                    raise entry.error(f"has a meaning only together with {key.only_with!r}")
                values[key.name] = key.type.read(entry, read_field)
            elif key.default is not REQUIRED:
                values[key.name] = key.default
            elif has_context and key.name not in alternatives:
                raise table.error(f"the key {key.name!r} is missing")
            else:
                values[key.name] = None
        return values


def _check_one_of(table: Entry, group: tuple[str, ...], given: list[str]) -> None:
    """RecipeError unless exactly one key of the group is given."""
    if len(given) == 1:
        return
    where = table[given[-1]] if given else table
    raise where.error(f"give exactly one of {words_of(group)}, not {words_of(given) if given else 'none of them'}")


@dataclass(frozen=True, slots=True)
class FieldKind:
    """A kind of field: what it is, the keys of its table, and the function that makes the field of their values."""

    meaning: str
    table: KeyTable
    make: Callable[..., Field]

    def read(self, entry: Entry, read_field: ReadField) -> Field:
        """The field of a table of this kind; RecipeError with the line of the key that is invalid."""
        values = self.table.read(entry, read_field, besides=("kind",))
        try:
            return self.make(**values)
        except RecipeError:
            raise
        except InvalidRequest as error:
            raise entry.locate(str(error)) from error


def field_kind(meaning: str, make: Callable[..., Field], *keys: Key, one_of: Iterable[str] = ()) -> FieldKind:
    """The kind with these keys; each string of `one_of` holds the names of a group, separated by spaces."""
    return FieldKind(meaning, KeyTable(keys, tuple(tuple(group.split()) for group in one_of)), make)
