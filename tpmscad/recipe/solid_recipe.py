"""Recipes of solids: any field in a box, from a TOML file.

tol = 0.02
domain = [[0, 0, 0], [10, 10, 20]]

[field]
kind = "rod"
surface = "gyroid"
period = 10
level = { kind = "ramp", by = "z", span = [0, 20], values = [-0.6, 0.2] }
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field, volume_fraction
from tpmscad.recipe.blend_recipe import RecipeBox, read_box_corners
from tpmscad.recipe.field_reader import make_field_reader
from tpmscad.recipe.toml_entry import Entry, read_document

SAMPLES_PER_AXIS = 48
"""Per axis, for a first look at the volume fraction: good to a per cent where cells are ten samples wide."""


@dataclass(frozen=True, slots=True, eq=False)
class SolidRecipe:
    """A field to be made a solid in a box or in the body of a STEP file, and the tolerance (model units)."""

    recipe: Entry
    field: Field
    domain: RecipeBox | Path
    tol: float

    def to_dict(self) -> dict[str, Any]:
        """What can be said before anything is made. Raises RecipeError if the field is not finite in the box."""
        if isinstance(self.domain, Path):
            return {"domain": str(self.domain), "tol": self.tol}
        try:
            share = volume_fraction(self.field, self.domain, samples=SAMPLES_PER_AXIS)
        except InvalidRequest as error:
            raise self.recipe["field"].error(str(error)) from error
        return {"domain": [list(corner) for corner in self.domain], "tol": self.tol, "volume_fraction": share}

    def __str__(self) -> str:
        known = self.to_dict()
        solid = f", about {100 * known['volume_fraction']:.1f} % solid" if "volume_fraction" in known else ""
        return f"domain {known['domain']}{solid}, to be held within {self.tol:g}"


def read_solid_recipe(path: Path) -> SolidRecipe:
    """The field of a TOML file. Raises RecipeError with the line of what is wrong."""
    recipe = read_document(path).table("fields", "field", "domain", "tol")
    domain = recipe["domain"]
    where = domain.beside() if isinstance(domain.value, str) else read_box_corners(domain)
    return SolidRecipe(recipe, make_field_reader(recipe)(recipe["field"]), where, recipe["tol"].positive())
