"""Periodic fields and the porous structures cut from them, as kinds of recipes.

kind = "rod", surface = "gyroid", period = 10, level = -0.3      # or `of = FIELD` instead of surface, period and phase
kind = "sheet", surface = "schwarz_p", period = 5, levels = [-0.2, { kind = "ramp", ... }]
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field
from tpmscad.fields.kinds.ramps import RampField
from tpmscad.recipe.field_kind import FieldKind, Key, field_kind
from tpmscad.recipe.image_masks import read_numpy_array
from tpmscad.recipe.toml_entry import Entry
from tpmscad.recipe.value_types import (
    CELL,
    COUNTS,
    FIELD,
    FILE,
    NUMBER_OR_FIELD,
    POINT,
    SEED,
    SURFACE,
    fields_type,
    plain_type,
    read_nested_array,
)

CELL_KEY = Key("period", CELL, "edge of the cell, one for all axes or one for each", "mm", also=("cell",))
SURFACE_KEYS = (
    Key("surface", SURFACE, "a surface of the catalogue, see `tpmscad surfaces`"),
    Key("period", CELL, CELL_KEY.meaning, "mm", only_with="surface", also=("cell",)),
    Key("phase", POINT, "shift of the surface", "cells", default=(0.0, 0.0, 0.0), only_with="surface"),
)
"""The keys of a periodic surface that is given in place."""

BASE_KEYS = (Key("of", FIELD, "the field that is cut, instead of surface, period and phase"), *SURFACE_KEYS)
FRACTION_KEY = Key(
    "volume_fraction",
    NUMBER_OR_FIELD,
    "solid part of the volume, from which the level follows; a ramp grades it",
    "0..1",
)


def make_base_field(of: Field | None, surface: str | None, period: Any, phase: Any) -> Field:
    """The field that is cut: `of`, or the nodal field of a surface of the catalogue."""
    return fields.tpms(str(surface), period, phase) if of is None else of


def make_rod(*, level: Any, volume_fraction: Any, **base: Any) -> Field:
    """The solid {field < level}."""
    phi = make_base_field(**base)
    return fields.rod(phi, level if level is not None else solve_threshold(phi, volume_fraction, "rod"))


def make_pore(*, level: Any, volume_fraction: Any, **base: Any) -> Field:
    """The solid {field > level}."""
    phi = make_base_field(**base)
    return fields.pore(phi, level if level is not None else solve_threshold(phi, volume_fraction, "pore"))


def make_sheet(*, levels: Any, volume_fraction: Any, **base: Any) -> Field:
    """The solid between two levels."""
    phi = make_base_field(**base)
    low, high = levels if levels is not None else solve_threshold(phi, volume_fraction, "sheet")
    return fields.sheet(phi, low, high)


def make_wall(*, thickness: Any, **base: Any) -> Field:
    """The wall of a thickness along the normal round {field = 0}."""
    return fields.wall(make_base_field(**base), thickness)


def solve_threshold(phi: Field, fraction: Any, what: str) -> Any:
    """The level, or the pair of levels of a sheet, that gives a volume fraction; fields of them if a ramp grades it."""
    if not isinstance(fraction, Field):
        if not 0 < fraction < 1:
            raise InvalidRequest(f"volume_fraction {fraction:g} must be between 0 and 1")
        try:
            return fields.threshold_for(phi, fraction, what)
        except InvalidRequest as error:
            if not all(phi.periods() or (0.0,)):
                raise InvalidRequest(
                    "volume_fraction is solved over one period, and the field has none: give a level instead"
                ) from error
            raise
    if not isinstance(fraction, RampField):
        raise InvalidRequest('volume_fraction must be a number, or a field of kind = "ramp"')
    return fields.graded_threshold(phi, fraction, kind=what)


def make_bspline_unit(*, coefficients: Any, file: Path | None, seed: int | None, count: Any, period: Any) -> Field:
    """The periodic B-spline unit of given coefficients (nested arrays or a .npy file), or of random ones from a seed."""
    if seed is not None:
        coefficients = np.random.default_rng(seed).normal(size=count)
    elif file is not None:
        coefficients = read_numpy_array(file)
    return fields.bspline_unit(coefficients, period)


def make_cell_sizes(*, x: Any, y: Any, z: Any, **base: Any) -> Field:
    """A periodic field whose cell size changes along the axes."""
    sizes: Mapping[str, Any] = {axis: given for axis, given in zip("xyz", (x, y, z), strict=True) if given is not None}
    return fields.cell_sizes(make_base_field(**base), **sizes)


def read_axis_sizes(entry: Entry) -> tuple[list[float], list[float]]:
    """The positions and the cell sizes of a table with the keys `at` and `sizes`."""
    entry.table("at", "sizes")
    return [item.number() for item in entry["at"].items()], [size.positive() for size in entry["sizes"].items()]


AXIS_SIZES = plain_type("{ at = [...], sizes = [...] }", read_axis_sizes)

PERIODIC_KINDS: dict[str, FieldKind] = {
    "tpms": field_kind(
        "The nodal field of a surface of the catalogue; by itself the solid on one side of the surface.",
        lambda surface, period, phase: fields.tpms(surface, period, phase),
        Key("surface", SURFACE, "a surface of the catalogue, see `tpmscad surfaces`"),
        CELL_KEY,
        Key("phase", POINT, "shift of the surface", "cells", default=(0.0, 0.0, 0.0)),
    ),
    "bspline": field_kind(
        "A periodic B-spline unit: a field of any shape, from coefficients.",
        make_bspline_unit,
        Key("coefficients", plain_type("nested arrays", read_nested_array), "coefficients (nx, ny, nz)"),
        Key("file", FILE, "coefficients (nx, ny, nz) in a .npy file"),
        Key("seed", SEED, "seed of random coefficients"),
        Key("count", COUNTS, "numbers of random coefficients along x, y and z", only_with="seed"),
        CELL_KEY,
        one_of=["coefficients file seed"],
    ),
    "cell_sizes": field_kind(
        "A periodic field whose cell size changes along one or more axes.",
        make_cell_sizes,
        *BASE_KEYS,
        *(Key(axis, AXIS_SIZES, f"cell sizes at positions along {axis}", "mm", default=None) for axis in "xyz"),
        one_of=["of surface"],
    ),
}
STRUCTURE_KINDS: dict[str, FieldKind] = {
    "rod": field_kind(
        "Solid where a field lies below a level: rods on one side of a surface.",
        make_rod,
        *BASE_KEYS,
        Key("level", FIELD, "the level; a ramp grades it"),
        FRACTION_KEY,
        one_of=["of surface", "level volume_fraction"],
    ),
    "pore": field_kind(
        "Solid where a field lies above a level: the other side.",
        make_pore,
        *BASE_KEYS,
        Key("level", FIELD, "the level; a ramp grades it"),
        FRACTION_KEY,
        one_of=["of surface", "level volume_fraction"],
    ),
    "wall": field_kind(
        "A wall of a thickness in mm along the surface {field = 0}.",
        make_wall,
        *BASE_KEYS,
        Key("thickness", NUMBER_OR_FIELD, "thickness along the normal; a ramp grades it", "mm"),
        one_of=["of surface"],
    ),
    "sheet": field_kind(
        "Solid where a field lies between two levels.",
        make_sheet,
        *BASE_KEYS,
        Key("levels", fields_type(2, "levels, the lower one first"), "the levels, the lower one first"),
        FRACTION_KEY,
        one_of=["of surface", "levels volume_fraction"],
    ),
}
