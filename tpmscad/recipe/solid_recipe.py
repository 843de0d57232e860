"""Recipes of solids: a field, a box or a body, and a tolerance in a TOML file.

tol = 0.02
domain = [[0, 0, 0], [10, 10, 20]]      # or "part.step"

[field]
kind = "rod"
surface = "gyroid"
period = 10
level = { kind = "ramp", by = "z", span = [0, 20], values = [-0.6, 0.2] }
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpmscad.errors import InvalidRequest, LevelSetError, RecipeError
from tpmscad.fields import Field
from tpmscad.recipe.field_kind import Key, KeyTable
from tpmscad.recipe.field_reader import FIELDS_KEY, make_field_reader
from tpmscad.recipe.toml_entry import Entry, read_document
from tpmscad.recipe.value_types import FIELD, POSITIVE, RecipeBox, plain_type, read_box_corners


@dataclass(frozen=True, slots=True, eq=False)
class SolidRecipe:
    """A field to be made a solid in a box or in the body of a STEP file, and the tolerance (mm)."""

    recipe: Entry
    field: Field
    domain: RecipeBox | Path
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


def read_solid_domain(entry: Entry) -> RecipeBox | Path:
    """Two corners of a box, or the path of a STEP file."""
    return entry.sibling_file() if isinstance(entry.value, str) else read_box_corners(entry)


SOLID_KEYS = KeyTable(
    (
        Key("field", FIELD, "the solid is where this field is negative: [field]"),
        Key(
            "domain",
            plain_type("2 corners or file name", read_solid_domain),
            "the box [[x0, y0, z0], [x1, y1, z1]], or a STEP file with one solid, whose faces stay exact",
            "mm",
        ),
        Key("tol", POSITIVE, "greatest deviation of the solid from the field", "mm"),
        FIELDS_KEY,
    )
)
"""The keys of a recipe for `tpmscad solidify`."""


def read_solid_recipe(path: Path) -> SolidRecipe:
    """The recipe of a TOML file; RecipeError with the line of what is invalid."""
    recipe = read_document(path)
    values: dict[str, Any] = SOLID_KEYS.read(recipe, make_field_reader(recipe))
    return SolidRecipe(recipe, values["field"], values["domain"], values["tol"])
