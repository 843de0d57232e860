"""The fields of a recipe: tables with a kind, numbers, and the names of fields that the recipe defines under `[fields.NAME]`."""

from __future__ import annotations

from dataclasses import dataclass

from tpmscad import fields
from tpmscad.fields import Field
from tpmscad.recipe.data_fields import DATA_KINDS
from tpmscad.recipe.field_kind import FieldKind, Key
from tpmscad.recipe.field_operations import OPERATION_KINDS
from tpmscad.recipe.porous_fields import PERIODIC_KINDS, STRUCTURE_KINDS
from tpmscad.recipe.region_fields import REGION_KINDS
from tpmscad.recipe.toml_entry import Entry
from tpmscad.recipe.value_types import plain_type

FIELD_KINDS: dict[str, FieldKind] = {
    **STRUCTURE_KINDS,
    **PERIODIC_KINDS,
    **DATA_KINDS,
    **REGION_KINDS,
    **OPERATION_KINDS,
}
"""Every kind of field that a recipe may name, in the order of the printed reference."""

FIELDS_KEY = Key(
    "fields", plain_type("tables", lambda entry: entry.table()), "fields used by name: [fields.NAME]", default=None
)
"""The key of the fields that a recipe defines, which `make_field_reader` reads."""


@dataclass(frozen=True, slots=True)
class FieldReader:
    """Function that reads the field of an entry.

    `definitions` are the fields that the recipe defines, `active_names` those being read: no field may be defined by itself.
    """

    definitions: dict[str, Entry]
    active_names: tuple[str, ...] = ()

    def __call__(self, entry: Entry) -> Field:
        """The field of an entry; RecipeError with its line if it is invalid."""
        if isinstance(entry.value, str):
            return self._read_by_name(entry)
        if not isinstance(entry.value, dict):
            return fields.constant(entry.number())
        kind = FIELD_KINDS[entry["kind"].string(tuple(FIELD_KINDS))]
        try:
            return kind.read(entry, self)
        except RecursionError:
            raise entry.error(
                "this field is nested more deeply in others than Python can follow: join many fields in one list, "
                "as in of = ['a', 'b', 'c']"
            ) from None

    def _read_by_name(self, entry: Entry) -> Field:
        """The field of a name that the recipe defines."""
        if not self.definitions:
            raise entry.error(f"{entry.value!r} names no field: define it as [fields.{entry.value}], or give a table")
        name = entry.string(tuple(self.definitions))
        if name in self.active_names:
            raise entry.error(f"the field {name!r} is defined by itself: {' -> '.join((*self.active_names, name))}")
        return FieldReader(self.definitions, (*self.active_names, name))(self.definitions[name])


def make_field_reader(recipe: Entry) -> FieldReader:
    """The reader for the fields of a recipe."""
    defined = recipe.get("fields")
    if defined is None:
        return FieldReader({})
    defined.table()
    return FieldReader({name: defined[name] for name in defined.value})
