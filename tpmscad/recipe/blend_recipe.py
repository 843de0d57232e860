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

The other keys are the arguments of `tpmscad.blend`, with its defaults.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from tpmscad._typing import Progress
from tpmscad.api.argument_kinds import POINT, choice_of
from tpmscad.api.arguments import Argument, arguments_of
from tpmscad.api.shared_kinds import COUNT, DIRECTION, POSITIVE
from tpmscad.blending import (
    BlendResult,
    CylinderRadius,
    LinearCoordinate,
    LineWeightSpec,
    SphereRadius,
    VolumeWeightSpec,
)
from tpmscad.blending._blend import METHODS, blend
from tpmscad.blending.initial_weights import WEIGHT_NAMES, WEIGHTS, WeightSpec
from tpmscad.errors import InvalidRequest, RecipeError
from tpmscad.fields import Field
from tpmscad.fields.periods_and_directions import Direction, as_unit_vector
from tpmscad.recipe.field_reader import FIELDS_ARGUMENT, read_call, read_table
from tpmscad.recipe.recipe_keys import KeyTable, make_table
from tpmscad.recipe.toml_entry import Entry, read_document

FIELD_LIST_KEYS = ("structures", "regions", "blending_regions")
"""The arrays of fields that a recipe must give."""

_OPERAND_PATTERN = re.compile(r"(structure|region|blending region)s? (\d+)\b")
"""The beginning of a message of `blend` about one of its operands."""


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


def read_blend_recipe(path: Path, changes: Mapping[str, Any] | None = None) -> BlendRecipe:
    """The recipe of a TOML file, with other values for some keys; RecipeError with the line of what is invalid."""
    recipe = read_document(path, changes)
    if "field" in recipe.value and "structures" not in recipe.value:
        raise recipe.error("this recipe has one field and no structures to join: hand it to `tpmscad solidify`")
    options = read_table(recipe, BLEND_KEYS, {"weight": read_weights})
    structures, regions, blending = (tuple(options.pop(name)) for name in FIELD_LIST_KEYS)
    tol, _ = options.pop("tol"), options.pop("fields", None)
    return BlendRecipe(recipe, structures, regions, blending, options, tol)


Count = Annotated[int | None, COUNT, "Number of coefficients; chosen by the width by default."]
Degree = Annotated[int, COUNT, "Degree of the spline."]


def make_linear_weight(
    direction: Annotated[Direction, DIRECTION, "From one structure to the other."],
    count: Count = None,
    degree: Degree = 3,
) -> LineWeightSpec:
    """A spline of the coordinate along a direction."""
    return LineWeightSpec(LinearCoordinate(as_unit_vector(direction)), count, degree)


def make_cylinder_weight(
    center: Annotated[tuple[float, float, float], POINT, "A point of the axis, mm."],
    axis: Annotated[Direction, DIRECTION, "Direction of the axis."],
    count: Count = None,
    degree: Degree = 3,
) -> LineWeightSpec:
    """A spline of the distance to an axis."""
    return LineWeightSpec(CylinderRadius(center, as_unit_vector(axis)), count, degree)


def make_sphere_weight(
    center: Annotated[tuple[float, float, float], POINT, "The point, mm."], count: Count = None, degree: Degree = 3
) -> LineWeightSpec:
    """A spline of the distance to a point."""
    return LineWeightSpec(SphereRadius(center), count, degree)


WEIGHT_KINDS: dict[str, Callable[..., WeightSpec]] = {
    "along": make_linear_weight,
    "cylinder": make_cylinder_weight,
    "sphere": make_sphere_weight,
    "volume": VolumeWeightSpec,
}
"""The kinds of weight functions."""


def read_weights(entry: Entry) -> WeightSpec | list[WeightSpec]:
    """One weight for all blending regions, or an array with one for each."""
    if isinstance(entry.value, list):
        return [_read_weight(item) for item in entry.items()]
    return _read_weight(entry)


def _read_weight(entry: Entry) -> WeightSpec:
    """The name of a weight, or a table of a kind of weight."""
    if isinstance(entry.value, str):
        return entry.word(WEIGHT_NAMES)
    return read_call(WEIGHT_KINDS[entry.table()["kind"].word(tuple(WEIGHT_KINDS))], entry)


def _make_blend_keys() -> KeyTable:
    """The arguments of `blend` but its progress, and the tolerance of the solid."""
    arguments = dict(arguments_of(blend))
    del arguments["progress"]
    weight = arguments["weight"]
    words = WEIGHTS.described_as(f"a table, or one of {', '.join(map(repr, WEIGHT_NAMES))}, or an array of these")
    arguments["weight"] = replace(weight, kind=words)
    arguments["method"] = replace(arguments["method"], kind=choice_of(*METHODS))
    tol = Argument("tol", float, POSITIVE, "Greatest deviation of the solid from the blend, mm.")
    return make_table((*arguments.values(), tol, FIELDS_ARGUMENT))


BLEND_KEYS = _make_blend_keys()
"""The keys of a recipe for `tpmscad blend`."""


def _locate_error(recipe: Entry, message: str) -> RecipeError:
    """The error with the line of the operand or key that the message of `blend` begins with."""
    found = _OPERAND_PATTERN.match(message)
    if found is None:
        return recipe.locate(message)
    items = recipe[found[1].replace(" ", "_") + "s"].items()
    number = int(found[2])
    return (items[number] if number < len(items) else recipe).error(message)
