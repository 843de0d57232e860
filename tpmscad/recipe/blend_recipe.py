"""Recipes of blends: the arguments of `tpmscad.blend` in a TOML file, and the tolerance of the solid.

    tol = 0.02

    [[structures]]
    kind = "rod"
    surface = "gyroid"
    period = 5
    level = -0.3

    [[regions]]
    kind = "box"
    lo = [0, 0, 0]
    hi = [10, 10, 10]

    [[blending_regions]]
    ...

The other keys are the keywords of `tpmscad.blend`: method, weight, resolution, domain, max_iterations, minimum_neck, max_change,
keep_fraction, level_margin, drop_intrinsic, specks.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpmscad._typing import Progress
from tpmscad.blending import (
    BlendResult,
    CylinderRadius,
    LinearCoordinate,
    LineWeightSpec,
    SphereRadius,
    VolumeWeightSpec,
)
from tpmscad.blending.initial_weights import WEIGHT_NAMES, WeightSpec
from tpmscad.blending.porous_blending import METHODS, blend
from tpmscad.errors import InvalidRequest, RecipeError
from tpmscad.fields import Field
from tpmscad.fields.argument_checks import as_unit_vector
from tpmscad.recipe.field_kind import read_box_corners, read_direction, read_triple
from tpmscad.recipe.field_reader import make_field_reader
from tpmscad.recipe.toml_entry import Entry, read_document

FIELD_LIST_KEYS = ("structures", "regions", "blending_regions")
"""The arrays of fields that a recipe must give."""

_OPERAND_PATTERN = re.compile(r"(structure|region|blending region)s? (\d+)\b")
"""The beginning of a message of `blend` about one of its operands."""

OPTION_READERS: dict[str, Callable[[Entry], Any]] = {
    "method": lambda entry: entry.string(METHODS),
    "weight": lambda entry: read_weights(entry),
    "resolution": lambda entry: tuple(item.integer(2) for item in entry.array_of_length(3, "whole numbers")),
    "domain": lambda entry: read_box_corners(entry),
    "max_iterations": Entry.integer,
    "minimum_neck": Entry.positive,
    "max_change": Entry.positive,
    "keep_fraction": Entry.boolean,
    "level_margin": Entry.number,
    "drop_intrinsic": Entry.boolean,
    "specks": Entry.boolean,
}
"""The keywords of `blend` that a recipe may give, and how each is read."""


@dataclass(frozen=True, slots=True, eq=False)
class BlendRecipe:
    """A blend to be computed: its fields, the options of `blend`, and the tolerance of the solid (mm)."""

    recipe: Entry
    structures: tuple[Field, ...]
    regions: tuple[Field, ...]
    blending_regions: tuple[Field, ...]
    options: dict[str, Any]
    tol: float

    def run(self, progress: Progress | None = None) -> BlendResult:
        """The blend; RecipeError with the line of the structure or region that is invalid."""
        try:
            return blend(self.structures, self.regions, self.blending_regions, **self.options, progress=progress)
        except RecipeError:
            raise
        except InvalidRequest as error:
            raise _locate_error(self.recipe, str(error)) from error


def read_blend_recipe(path: Path) -> BlendRecipe:
    """The recipe of a TOML file; RecipeError with the line of what is invalid."""
    recipe = read_document(path).table("fields", "tol", *FIELD_LIST_KEYS, *OPTION_READERS)
    read = make_field_reader(recipe)
    structures, regions, blending = (tuple(read(item) for item in recipe[name].items()) for name in FIELD_LIST_KEYS)
    options = {key: make(recipe[key]) for key, make in OPTION_READERS.items() if key in recipe.value}
    return BlendRecipe(recipe, structures, regions, blending, options, recipe["tol"].positive())


def read_weights(entry: Entry) -> WeightSpec | list[WeightSpec]:
    """One weight for all blending regions, or an array with one for each."""
    return [_read_weight(item) for item in entry.items()] if isinstance(entry.value, list) else _read_weight(entry)


def _read_weight(entry: Entry) -> WeightSpec:
    """The name of a weight, or a table of a kind of weight."""
    if isinstance(entry.value, str):
        return entry.string(WEIGHT_NAMES)
    name = entry.table()["kind"].string(("along", "cylinder", "sphere", "volume"))
    if name == "volume":
        entry.table("kind", "count", "degree")
        count = _read_three_counts(entry.get("count"))
        return (
            VolumeWeightSpec(count)
            if "degree" not in entry.value
            else VolumeWeightSpec(count, _read_three_counts(entry["degree"]) or (3, 3, 3))
        )
    count, degree = (None if (part := entry.get(key)) is None else part.integer() for key in ("count", "degree"))
    coordinate: LinearCoordinate | CylinderRadius | SphereRadius
    if name == "along":
        entry.table("kind", "direction", "count", "degree")
        coordinate = LinearCoordinate(as_unit_vector(read_direction(entry["direction"]), "direction"))
    elif name == "cylinder":
        entry.table("kind", "center", "axis", "count", "degree")
        coordinate = CylinderRadius(read_triple(entry["center"]), as_unit_vector(read_direction(entry["axis"]), "axis"))
    else:
        entry.table("kind", "center", "count", "degree")
        coordinate = SphereRadius(read_triple(entry["center"]))
    return LineWeightSpec(coordinate, count) if degree is None else LineWeightSpec(coordinate, count, degree)


def _read_three_counts(entry: Entry | None) -> tuple[int, int, int] | None:
    """Three positive integers, or None for no entry."""
    if entry is None:
        return None
    x, y, z = (item.integer() for item in entry.array_of_length(3, "whole numbers"))
    return x, y, z


def _locate_error(recipe: Entry, message: str) -> RecipeError:
    """The error with the line of the operand or key that the message of `blend` begins with."""
    found = _OPERAND_PATTERN.match(message)
    if found is None:
        first = message.split(" ", 1)[0].rstrip(":")
        return (recipe[first] if first in recipe.value else recipe).error(message)
    items = recipe[found[1].replace(" ", "_") + "s"].items()
    number = int(found[2])
    return (items[number] if number < len(items) else recipe).error(message)
