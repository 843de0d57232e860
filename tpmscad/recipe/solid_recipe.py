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

from tpmscad._typing import BoxCorners
from tpmscad.api.arguments import Argument
from tpmscad.api.shared_kinds import BOX, FIELD, POSITIVE, SHAPE
from tpmscad.errors import InvalidRequest, LevelSetError, RecipeError
from tpmscad.fields import Field
from tpmscad.recipe.field_reader import FIELDS_ARGUMENT, read_field_entry, read_table, read_value
from tpmscad.recipe.recipe_keys import make_table
from tpmscad.recipe.toml_entry import Entry, read_document

BODY_KINDS = ("box", "cylinder", "sphere")
"""Kinds of regions that may be a domain, as exact bodies."""

SolidDomain = BoxCorners | Path | Field
"""What a field is made a solid in: a box, the solid of a STEP file, or a primitive region as a body."""

PART = SHAPE.described_as("the name of a file", '"part.step"')

SOLID_KEYS = make_table(
    (
        Argument("field", Field, FIELD, "The solid is where this field is negative: [field]."),
        Argument(
            "domain",
            SolidDomain,
            BOX.described_as("two corners, the name of a file, or a table"),
            "The box [[x0, y0, z0], [x1, y1, z1]], mm; or a body, whose faces stay exact: a STEP file with one solid, or a table "
            f"of kind {', '.join(BODY_KINDS)}.",
        ),
        Argument(
            "keep",
            Path,
            PART,
            "A CAD file whose solids the result contains, with their exact faces; for a domain that is a box.",
            None,
        ),
        Argument("clear", Path, PART, "A CAD file whose solids stay empty; for a domain that is a box.", None),
        Argument("tol", float, POSITIVE, "Greatest deviation of the solid from the field, mm."),
        FIELDS_ARGUMENT,
    )
)
"""The keys of a recipe for `tpmscad solidify`."""


@dataclass(frozen=True, slots=True, eq=False)
class SolidRecipe:
    """A field to be made a solid in a box or a body, the tolerance (mm), and the CAD files of `keep` and `clear`, if any."""

    recipe: Entry
    field: Field
    domain: SolidDomain
    tol: float
    passive: Mapping[str, Path]

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


def read_solid_recipe(path: Path, changes: Mapping[str, Any] | None = None) -> SolidRecipe:
    """The recipe of a TOML file, with other values for some keys; RecipeError with the line of what is invalid."""
    recipe = read_document(path, changes)
    if "structures" in recipe.value and "field" not in recipe.value:
        raise recipe.error("this recipe joins structures: hand it to `tpmscad blend`")
    values = read_table(recipe, SOLID_KEYS, {"domain": read_solid_domain})
    passive: dict[str, Path] = {name: values[name] for name in ("keep", "clear") if name in values}
    return SolidRecipe(recipe, values["field"], values["domain"], values["tol"], passive)


def read_solid_domain(entry: Entry) -> SolidDomain:
    """Two corners of a box, the path of a STEP file, or a primitive body."""
    if isinstance(entry.value, str):
        return entry.sibling_file()
    if not isinstance(entry.value, dict):
        corners: BoxCorners = read_value(BOX, entry)
        return corners
    entry["kind"].word(BODY_KINDS)
    body = read_field_entry(entry)
    if getattr(body, "height", 0.0) is None:
        raise entry.error("a cylinder that is filled needs ends: give its height")
    return body
