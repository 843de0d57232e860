"""Recipes of blends: what `tpmscad.blend` takes, from a TOML file, and the solid of the result.

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

from tpmscad.blend import Along, BlendResult, CylinderRadius, Line, SphereRadius, Volume
from tpmscad.blend.initial import NAMES, Spec
from tpmscad.blend.solve import METHODS, Progress, blend
from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field
from tpmscad.fields.regions import direction as unit
from tpmscad.recipe.entry import Entry, RecipeError, document
from tpmscad.recipe.kind import direction, triple
from tpmscad.recipe.reader import reader_of

Box = tuple[tuple[float, float, float], tuple[float, float, float]]

LISTS = ("structures", "regions", "blending_regions")

_NAMED = re.compile(r"(structure|region|blending region)s? (\d+)\b")
"""How the messages of `blend` name what they are about."""

OPTIONS: dict[str, Callable[[Entry], Any]] = {
    "method": lambda entry: entry.text(METHODS),
    "weight": lambda entry: weights(entry),
    "resolution": lambda entry: tuple(item.whole(2) for item in entry.several(3, "whole numbers")),
    "domain": lambda entry: box(entry),
    "max_iterations": Entry.whole,
    "minimum_neck": Entry.positive,
    "max_change": Entry.positive,
    "keep_fraction": Entry.flag,
    "level_margin": Entry.number,
    "drop_intrinsic": Entry.flag,
    "specks": Entry.flag,
}


@dataclass(frozen=True, slots=True, eq=False)
class Scaffold:
    """A blend to be made: its fields, the options of `blend`, the tolerance of the solid (model units)."""

    recipe: Entry
    structures: tuple[Field, ...]
    regions: tuple[Field, ...]
    blending_regions: tuple[Field, ...]
    options: dict[str, Any]
    tol: float

    def blended(self, progress: Progress | None = None) -> BlendResult:
        """The blend. Raises RecipeError, with the line of the structure or region where it is one's."""
        try:
            return blend(self.structures, self.regions, self.blending_regions, **self.options, progress=progress)
        except RecipeError:
            raise
        except InvalidRequest as error:
            raise _located(self.recipe, str(error)) from error


def read_scaffold(path: Path) -> Scaffold:
    """The blend of a TOML file. Raises RecipeError with the line of what is wrong."""
    recipe = document(path).table("fields", "tol", *LISTS, *OPTIONS)
    read = reader_of(recipe)
    structures, regions, blending = (tuple(read(item) for item in recipe[name].items()) for name in LISTS)
    options = {key: make(recipe[key]) for key, make in OPTIONS.items() if key in recipe.value}
    return Scaffold(recipe, structures, regions, blending, options, recipe["tol"].positive())


def box(entry: Entry) -> Box:
    """Two corners, each coordinate of the first below that of the second."""
    low, high = (triple(corner) for corner in entry.several(2, "corners"))
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise entry.error(f"{entry.value} is empty: each coordinate of the first corner must be below the second's")
    return low, high


def weights(entry: Entry) -> Spec | list[Spec]:
    """A weight for all blending regions, or one for each."""
    return [_weight(item) for item in entry.items()] if isinstance(entry.value, list) else _weight(entry)


def _weight(entry: Entry) -> Spec:
    if isinstance(entry.value, str):
        return entry.text(NAMES)
    name = entry.table()["kind"].text(("along", "cylinder", "sphere", "volume"))
    if name == "volume":
        entry.table("kind", "count", "degree")
        count = _three(entry.get("count"))
        return Volume(count) if "degree" not in entry.value else Volume(count, _three(entry["degree"]) or (3, 3, 3))
    count, degree = (None if (part := entry.get(key)) is None else part.whole() for key in ("count", "degree"))
    coordinate: Along | CylinderRadius | SphereRadius
    if name == "along":
        entry.table("kind", "direction", "count", "degree")
        coordinate = Along(unit(direction(entry["direction"]), "direction"))
    elif name == "cylinder":
        entry.table("kind", "center", "axis", "count", "degree")
        coordinate = CylinderRadius(triple(entry["center"]), unit(direction(entry["axis"]), "axis"))
    else:
        entry.table("kind", "center", "count", "degree")
        coordinate = SphereRadius(triple(entry["center"]))
    return Line(coordinate, count) if degree is None else Line(coordinate, count, degree)


def _three(entry: Entry | None) -> tuple[int, int, int] | None:
    if entry is None:
        return None
    x, y, z = (item.whole() for item in entry.several(3, "whole numbers"))
    return x, y, z


def _located(recipe: Entry, message: str) -> RecipeError:
    """The error with the line of the structure or region its message begins with, or of the key it begins with."""
    found = _NAMED.match(message)
    if found is None:
        first = message.split(" ", 1)[0].rstrip(":")
        return (recipe[first] if first in recipe.value else recipe).error(message)
    items = recipe[found[1].replace(" ", "_") + "s"].items()
    number = int(found[2])
    return (items[number] if number < len(items) else recipe).error(message)
