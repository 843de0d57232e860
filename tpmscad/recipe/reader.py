"""The fields of a recipe: every kind by name, numbers, and the names of fields that the recipe defines under `fields`."""

from __future__ import annotations

from dataclasses import dataclass

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field
from tpmscad.recipe.combined import COMBINED
from tpmscad.recipe.entry import Entry, RecipeError
from tpmscad.recipe.kind import Kind
from tpmscad.recipe.porous import PERIODIC, STRUCTURES
from tpmscad.recipe.shapes import SHAPES

KINDS: dict[str, Kind] = {**PERIODIC, **STRUCTURES, **SHAPES, **COMBINED}


@dataclass(frozen=True, slots=True)
class Reader:
    """Reads fields; `named` are those the recipe defines, `open` the names that are being read (no name may need itself)."""

    named: dict[str, Entry]
    open: tuple[str, ...] = ()

    def __call__(self, entry: Entry) -> Field:
        if isinstance(entry.value, str):
            return self._named(entry)
        if not isinstance(entry.value, dict):
            return fields.constant(entry.number())
        kind = KINDS[entry["kind"].text(tuple(KINDS))]
        entry.table("kind", *kind.keys)
        try:
            return kind.make(entry, self)
        except RecipeError:
            raise
        except InvalidRequest as error:
            raise entry.error(str(error)) from error

    def _named(self, entry: Entry) -> Field:
        if not self.named:
            raise entry.error(f"{entry.value!r} names no field: define it as [fields.{entry.value}], or give a table")
        name = entry.text(tuple(self.named))
        if name in self.open:
            raise entry.error(f"the field {name!r} is made of itself: {' -> '.join((*self.open, name))}")
        return Reader(self.named, (*self.open, name))(self.named[name])


def reader_of(recipe: Entry) -> Reader:
    """The reader of a recipe, with the fields that it defines."""
    defined = recipe.get("fields")
    if defined is None:
        return Reader({})
    defined.table()
    return Reader({name: defined[name] for name in defined.value})
