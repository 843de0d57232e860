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

The other keys are keywords of `tpmscad.blend`, with its defaults.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import signature
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
from tpmscad.blending._blend import METHODS, blend
from tpmscad.blending.initial_weights import WEIGHT_NAMES, WeightSpec
from tpmscad.errors import InvalidRequest, RecipeError
from tpmscad.fields import Field
from tpmscad.fields.periods_and_directions import as_unit_vector
from tpmscad.recipe.field_kind import Key, KeyTable
from tpmscad.recipe.field_reader import FIELDS_KEY, make_field_reader
from tpmscad.recipe.toml_entry import Entry, read_document
from tpmscad.recipe.value_types import (
    BOOLEAN,
    COUNT,
    COUNTS,
    DIRECTION,
    FIELDS,
    NUMBER,
    POINT,
    POSITIVE,
    ReadField,
    ValueType,
    choice_type,
    plain_type,
    read_box_corners,
)

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
    values = BLEND_KEYS.read(recipe, make_field_reader(recipe))
    structures, regions, blending = (tuple(values[name]) for name in FIELD_LIST_KEYS)
    options = {key.name: values[key.name] for key in OPTION_KEYS if key.name in recipe.value}
    return BlendRecipe(recipe, structures, regions, blending, options, values["tol"])


@dataclass(frozen=True, slots=True)
class WeightKind:
    """A kind of weight function: what it follows, the keys of its table, and the function that makes its specification."""

    meaning: str
    table: KeyTable
    make: Callable[..., WeightSpec]


def _make_line_weight(coordinate: Any, count: int | None, degree: int | None) -> LineWeightSpec:
    return LineWeightSpec(coordinate, count) if degree is None else LineWeightSpec(coordinate, count, degree)


def _make_volume_weight(count: Any, degree: Any) -> VolumeWeightSpec:
    return VolumeWeightSpec(count) if degree is None else VolumeWeightSpec(count, degree)


_COUNT_KEYS = (
    Key("count", COUNT, "number of coefficients", default=None, default_text="chosen by the width"),
    Key("degree", COUNT, "degree of the spline", default=None, default_text="3"),
)
_AXIS_KEY = Key("axis", DIRECTION, "direction of the axis")

WEIGHT_KINDS: dict[str, WeightKind] = {
    "along": WeightKind(
        "A spline of the coordinate along a direction.",
        KeyTable((Key("direction", DIRECTION, "from one structure to the other"), *_COUNT_KEYS)),
        lambda direction, **spline: _make_line_weight(LinearCoordinate(as_unit_vector(direction)), **spline),
    ),
    "cylinder": WeightKind(
        "A spline of the distance to an axis.",
        KeyTable((Key("center", POINT, "a point of the axis", "mm"), _AXIS_KEY, *_COUNT_KEYS)),
        lambda center, axis, **spline: _make_line_weight(CylinderRadius(center, as_unit_vector(axis)), **spline),
    ),
    "sphere": WeightKind(
        "A spline of the distance to a point.",
        KeyTable((Key("center", POINT, "the point", "mm"), *_COUNT_KEYS)),
        lambda center, **spline: _make_line_weight(SphereRadius(center), **spline),
    ),
    "volume": WeightKind(
        "A spline of all three coordinates.",
        KeyTable(
            (
                Key("count", COUNTS, "numbers of coefficients", default=None, default_text="chosen by the size"),
                Key("degree", COUNTS, "degrees of the spline", default=None, default_text="[3, 3, 3]"),
            )
        ),
        _make_volume_weight,
    ),
}


def read_weights(entry: Entry, read: ReadField) -> WeightSpec | list[WeightSpec]:
    """One weight for all blending regions, or an array with one for each."""
    if isinstance(entry.value, list):
        return [_read_weight(item, read) for item in entry.items()]
    return _read_weight(entry, read)


def _read_weight(entry: Entry, read: ReadField) -> WeightSpec:
    """The name of a weight, or a table of a kind of weight."""
    if isinstance(entry.value, str):
        return entry.string(WEIGHT_NAMES)
    kind = WEIGHT_KINDS[entry.table()["kind"].string(tuple(WEIGHT_KINDS))]
    return kind.make(**kind.table.read(entry, read, besides=("kind",)))


def _option(name: str, value_type: ValueType, meaning: str, unit: str = "", default_text: str = "") -> Key:
    """The key of a keyword of `blend`, with the default that the function has."""
    return Key(name, value_type, meaning, unit, signature(blend).parameters[name].default, default_text)


_WEIGHT = ValueType("name or table, or an array of these", read_weights)
_WEIGHT_NAMES = ", ".join(f'"{name}"' for name in WEIGHT_NAMES)

OPTION_KEYS = (
    _option("method", choice_type(*METHODS), "optimiser of the weights"),
    _option("weight", _WEIGHT, f"the weight functions: {_WEIGHT_NAMES}, or a table of a kind of weight"),
    _option(
        "resolution",
        plain_type(
            "3 whole numbers", lambda entry: tuple(i.integer(2) for i in entry.array_of_length(3, "whole numbers"))
        ),
        "samples along x, y and z on which isolated parts are counted",
        default_text="chosen by the periods",
    ),
    _option(
        "domain",
        plain_type("2 corners", read_box_corners),
        "the box of the blend",
        "mm",
        "the box of the regions",
    ),
    _option("max_iterations", COUNT, "most rounds of the optimiser"),
    _option("minimum_neck", POSITIVE, "width of solid and void at saddle points", "mm", "no limit"),
    _option("max_change", POSITIVE, "greatest change of a coefficient of a weight", "0..1"),
    _option("keep_fraction", BOOLEAN, "keep the solid fraction between those of the structures"),
    _option("level_margin", NUMBER, "shift of the level that isolates nothing, as a fraction of the field's rms"),
    _option("drop_intrinsic", BOOLEAN, "remove isolated parts and cavities of the structures themselves"),
    _option("specks", BOOLEAN, "search between the samples for isolated parts", default_text="where needed"),
)
"""The keywords of `blend` that a recipe may give."""

BLEND_KEYS = KeyTable(
    (
        Key("structures", FIELDS, "the porous structures, two or more: [[structures]]"),
        Key("regions", FIELDS, "where each structure stands alone or is joined, in the same order: [[regions]]"),
        Key("blending_regions", FIELDS, "where structure k + 1 is joined to those before it: [[blending_regions]]"),
        Key("tol", POSITIVE, "greatest deviation of the solid from the blend", "mm"),
        FIELDS_KEY,
        *OPTION_KEYS,
    )
)
"""The keys of a recipe for `tpmscad blend`."""


def _locate_error(recipe: Entry, message: str) -> RecipeError:
    """The error with the line of the operand or key that the message of `blend` begins with."""
    found = _OPERAND_PATTERN.match(message)
    if found is None:
        return recipe.locate(message)
    items = recipe[found[1].replace(" ", "_") + "s"].items()
    number = int(found[2])
    return (items[number] if number < len(items) else recipe).error(message)
