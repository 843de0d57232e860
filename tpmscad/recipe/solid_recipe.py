"""Recipes of solids: a field, a box or a body, and a tolerance in a TOML file.

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
from tpmscad.recipe.field_kind import RecipeBox, read_box_corners
from tpmscad.recipe.field_reader import make_field_reader
from tpmscad.recipe.toml_entry import Entry, read_document

SAMPLES_PER_AXIS = 48
"""Samples for the volume fraction of a dry run: accurate to a per cent if a cell is ten samples wide."""


@dataclass(frozen=True, slots=True, eq=False)
class SolidRecipe:
    """A field to be made a solid in a box or in the body of a STEP file, and the tolerance (mm)."""

    recipe: Entry
    field: Field
    domain: RecipeBox | Path
    tol: float

    def to_dict(self) -> dict[str, Any]:
        """Domain, tolerance and, for a box, the volume fraction; RecipeError if the field is not finite in the box."""
        if isinstance(self.domain, Path):
            return {"domain": str(self.domain), "tol": self.tol}
        try:
            fraction = volume_fraction(self.field, self.domain, samples=SAMPLES_PER_AXIS)
        except InvalidRequest as error:
            raise self.recipe["field"].error(str(error)) from error
        return {"domain": [list(corner) for corner in self.domain], "tol": self.tol, "volume_fraction": fraction}

    def __str__(self) -> str:
        known = self.to_dict()
        solid = f", about {100 * known['volume_fraction']:.1f} % solid" if "volume_fraction" in known else ""
        return f"domain {known['domain']}{solid}, tolerance {self.tol:g}"


def read_solid_recipe(path: Path) -> SolidRecipe:
    """The recipe of a TOML file; RecipeError with the line of what is invalid."""
    recipe = read_document(path).table("fields", "field", "domain", "tol")
    domain = recipe["domain"]
    resolved = domain.sibling_file() if isinstance(domain.value, str) else read_box_corners(domain)
    return SolidRecipe(recipe, make_field_reader(recipe)(recipe["field"]), resolved, recipe["tol"].positive())
