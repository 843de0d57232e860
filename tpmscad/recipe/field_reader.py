"""The fields of a recipe: every kind by name, numbers, and the names of fields that the recipe defines under `fields`."""

from __future__ import annotations

from dataclasses import dataclass

from tpmscad import fields
from tpmscad.errors import InvalidRequest, RecipeError
from tpmscad.fields import Field
from tpmscad.recipe.field_kind import FieldKind
from tpmscad.recipe.field_operations import OPERATION_KINDS
from tpmscad.recipe.porous_fields import PERIODIC_KINDS, STRUCTURE_KINDS
from tpmscad.recipe.region_fields import REGION_KINDS
from tpmscad.recipe.toml_entry import Entry

FIELD_KINDS: dict[str, FieldKind] = {**PERIODIC_KINDS, **STRUCTURE_KINDS, **REGION_KINDS, **OPERATION_KINDS}


@dataclass(frozen=True, slots=True)
class FieldReader:
    """Reads fields; `named` are those the recipe defines, `open` the names that are being read (no name may need itself)."""

    definitions: dict[str, Entry]
    open: tuple[str, ...] = ()

    def __call__(self, entry: Entry) -> Field:
        if isinstance(entry.value, str):
            return self._named(entry)
        if not isinstance(entry.value, dict):
            return fields.constant(entry.number())
        kind = FIELD_KINDS[entry["kind"].text(tuple(FIELD_KINDS))]
        entry.table("kind", *kind.keys)
        try:
            return kind.make(entry, self)
        except RecipeError:
            raise
        except InvalidRequest as error:
            raise entry.error(str(error)) from error

    def _named(self, entry: Entry) -> Field:
        if not self.definitions:
            raise entry.error(f"{entry.value!r} names no field: define it as [fields.{entry.value}], or give a table")
        name = entry.text(tuple(self.definitions))
        if name in self.open:
            raise entry.error(f"the field {name!r} is made of itself: {' -> '.join((*self.open, name))}")
        return FieldReader(self.definitions, (*self.open, name))(self.definitions[name])


def make_field_reader(recipe: Entry) -> FieldReader:
    """The reader of a recipe, with the fields that it defines."""
    defined = recipe.get("fields")
    if defined is None:
        return FieldReader({})
    defined.table()
    return FieldReader({name: defined[name] for name in defined.value})
