"""Recipes of solids: a field, a box or a body, and a tolerance in a TOML file.

tol = 0.02
domain = [[0, 0, 0], [10, 10, 20]]      # or "part.step", or { kind = "cylinder", ... }

[field]
kind = "rod"
surface = "gyroid"
period = 10
level = { kind = "ramp", by = "z", span = [0, 20], values = [-0.6, 0.2] }
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpmscad.errors import InvalidRequest, LevelSetError, RecipeError
from tpmscad.fields import Field
from tpmscad.recipe.field_kind import Key, KeyTable
from tpmscad.recipe.field_reader import FIELDS_KEY, make_field_reader
from tpmscad.recipe.region_fields import REGION_KINDS
from tpmscad.recipe.toml_entry import Entry, read_document
from tpmscad.recipe.value_types import FIELD, POSITIVE, ReadField, RecipeBox, ValueType, read_box_corners

BODY_KINDS = ("box", "cylinder", "sphere")
"""Kinds of regions that may be a domain, as exact bodies."""

SolidDomain = RecipeBox | Path | Field
"""What a field is made a solid in: a box, the solid of a STEP file, or a primitive region as a body."""


@dataclass(frozen=True, slots=True, eq=False)
class SolidRecipe:
    """A field to be made a solid in a box or a body, and the tolerance (mm)."""

    recipe: Entry
    field: Field
    domain: SolidDomain
    tol: float

    @contextmanager
    def locate_errors(self) -> Iterator[None]:
        """Errors of the request that pass through become a RecipeError with the line of the key that they are about."""
        try:
            yield
        except RecipeError:
            raise
        except InvalidRequest as error:
            raise self.recipe.locate(str(error)) from error
        except LevelSetError as error:
            raise LevelSetError(str(self.recipe["field"].error(str(error)))) from error


def read_solid_domain(entry: Entry, read: ReadField) -> SolidDomain:
    """Two corners of a box, the path of a STEP file, or a primitive body."""
    if isinstance(entry.value, dict):
        body = REGION_KINDS[entry["kind"].string(BODY_KINDS)].read(entry, read)
        if getattr(body, "height", 0.0) is None:
            raise entry.error("a cylinder that is filled needs ends: give its height")
        return body
    return entry.sibling_file() if isinstance(entry.value, str) else read_box_corners(entry)


SOLID_KEYS = KeyTable(
    (
        Key("field", FIELD, "the solid is where this field is negative: [field]"),
        Key(
            "domain",
            ValueType("2 corners, file name or table", read_solid_domain),
            "the box [[x0, y0, z0], [x1, y1, z1]]; or a body, whose faces stay exact: a STEP file with one solid, or a table of "
            f"kind {', '.join(BODY_KINDS)}",
            "mm",
        ),
        Key("tol", POSITIVE, "greatest deviation of the solid from the field", "mm"),
        FIELDS_KEY,
    )
)
"""The keys of a recipe for `tpmscad solidify`."""


def read_solid_recipe(path: Path, changes: Mapping[str, Any] | None = None) -> SolidRecipe:
    """The recipe of a TOML file, with other values for some keys; RecipeError with the line of what is invalid."""
    recipe = read_document(path, changes)
    if "structures" in recipe.value and "field" not in recipe.value:
        raise recipe.error("this recipe joins structures: hand it to `tpmscad blend`")
    values: dict[str, Any] = SOLID_KEYS.read(recipe, make_field_reader(recipe))
    return SolidRecipe(recipe, values["field"], values["domain"], values["tol"])
