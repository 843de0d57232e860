"""The kinds of fields of recipes: the functions of `tpmscad.fields` by their names, and the conveniences of recipes.

kind = "rod", surface = "gyroid", period = 10, level = -0.3      # or `of = FIELD` instead of surface, period and phase
kind = "sheet", surface = "schwarz_p", period = 5, levels = [-0.2, { kind = "ramp", ... }]
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from functools import cache, reduce
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import tpmscad
from tpmscad import fields
from tpmscad.api.argument_kinds import (
    POINT,
    ArgumentKind,
    InvalidValue,
    WrongType,
    choice_of,
    read_callable,
    read_field,
    read_number,
    read_part,
    read_positive,
    restrict,
    sequence_of,
    tuple_of,
)
from tpmscad.api.shared_kinds import (
    COUNTS,
    FIELD,
    FIELDS,
    FRACTION,
    INDEX,
    LENGTHS,
    NUMBER,
    PAIR_OR_TRIPLE,
    PATH,
    POSITIVE,
    TEXT,
    VALUES,
    WALL_THICKNESS,
)
from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field
from tpmscad.fields.field import MinMaxField
from tpmscad.fields.kinds.ramps import RampField
from tpmscad.recipe.image_masks import read_mask, read_numpy_array
from tpmscad.recipe.recipe_keys import makes_field

Triple = tuple[float, float, float]


def _read_axis_sizes(value: Any) -> Any:
    """The positions and the cell sizes of a table with the keys `at` and `sizes`."""
    if not isinstance(value, dict):
        raise WrongType("is no table")
    if value.keys() != AXIS_SIZES_KEYS.keys():
        raise InvalidValue(f"with the keys {', '.join(map(repr, value)) or 'none'} must have the keys 'at' and 'sizes'")
    return tuple(read_part(kind.read, value[key], key) for key, kind in AXIS_SIZES_KEYS.items())


AXIS_SIZES_KEYS = {
    "at": sequence_of(read_number, "numbers", "[0, 40]"),
    "sizes": sequence_of(read_positive, "positive numbers", "[4, 8]"),
}
SOME_FIELDS = ArgumentKind(
    "an array of fields", "", restrict(FIELDS.read, bool, "is empty: at least one field is needed")
)
TWO_FIELDS = tuple_of(read_field, 2, "two fields", "")
TWO_LEVELS = tuple_of(read_field, 2, "two levels, the lower one first", "")
AXIS_SIZES = ArgumentKind("a table { at = [...], sizes = [...] }", "", _read_axis_sizes)
FRACTION_OR_FIELD = FRACTION.or_else(ArgumentKind("a field", "", read_callable))

Base = Annotated[Field | None, FIELD, "The field that is cut, instead of surface, period and phase."]
Surface = Annotated[
    str | None,
    TEXT.described_as("the name of a surface"),
    "A surface of the catalogue, see `tpmscad surfaces`, instead of `of`.",
]
Period = Annotated[
    float | Triple | None,
    LENGTHS,
    "Edge of the cell, mm, one for all axes or one for each, with `surface`; 10 by default.",
]
Phase = Annotated[Triple | None, POINT, "Shift of the surface, in cells, with `surface`; none by default."]
Reference = Annotated[
    str | None,
    choice_of("minimal", "nodal"),
    "The minimal surface or the nodal one, with `surface`; 'nodal' by default.",
]
Level = Annotated[Field | None, FIELD, "The level, or else give volume_fraction; a ramp grades it."]
Fraction = Annotated[
    Any, FRACTION_OR_FIELD, "Solid part of the volume, from which the level follows; a ramp grades it."
]
AxisSizes = Annotated[Any, AXIS_SIZES, "Cell sizes at positions along the axis, mm; at least one axis has them."]
SomeFields = Annotated[Sequence[Field], SOME_FIELDS, "The fields."]
Width = Annotated[float | None, POSITIVE, "Width of the rounding of the edges, mm; sharp by default."]
File = Annotated[Path, PATH, "The file."]


def require_one(**given: Any) -> None:
    """InvalidRequest unless exactly one of the keys is given."""
    names = [f"'{name}'" for name, value in given.items() if value is not None]
    if len(names) != 1:
        *first, last = (f"'{name}'" for name in given)
        found = " and ".join(names) or "none of them"
        raise InvalidRequest(f"give exactly one of {', '.join(first)} and {last}, not {found}")


def _make_base(of: Field | None, surface: str | None, period: Any, phase: Any, reference: str | None) -> Field:
    """The field that is cut: `of`, or the field of a surface of the catalogue."""
    require_one(of=of, surface=surface)
    if surface is not None:
        return fields.tpms(surface, period, phase or (0.0, 0.0, 0.0), reference=reference or "nodal")
    for name, value in (("period", period), ("phase", phase), ("reference", reference)):
        if value is not None:
            raise InvalidRequest(f"{name!r} has a meaning only together with 'surface'")
    assert of is not None
    return of


def _solve_threshold(phi: Field, fraction: Any, what: str) -> Any:
    """The level, or the pair of levels of a sheet, that gives a volume fraction; fields of them if a ramp grades it."""
    if isinstance(fraction, RampField):
        return fields.graded_threshold(phi, fraction, kind=what)
    if isinstance(fraction, Field):
        raise InvalidRequest('volume_fraction must be a number, or a field of kind = "ramp"')
    try:
        return fields.threshold_for(phi, fraction, what)
    except InvalidRequest as error:
        if all(phi.periods() or (0.0,)):
            raise
        raise InvalidRequest(
            "volume_fraction is solved over one period, and the field has none: give a level instead"
        ) from error


def make_rod(
    of: Base = None,
    surface: Surface = None,
    period: Period = None,
    phase: Phase = None,
    reference: Reference = None,
    level: Level = None,
    volume_fraction: Fraction = None,
) -> Field:
    """Solid where a field lies below a level: rods on one side of a surface."""
    phi = _make_base(of, surface, period, phase, reference)
    require_one(level=level, volume_fraction=volume_fraction)
    return fields.rod(phi, _solve_threshold(phi, volume_fraction, "rod") if level is None else level)


def make_pore(
    of: Base = None,
    surface: Surface = None,
    period: Period = None,
    phase: Phase = None,
    reference: Reference = None,
    level: Level = None,
    volume_fraction: Fraction = None,
) -> Field:
    """Solid where a field lies above a level: the other side."""
    phi = _make_base(of, surface, period, phase, reference)
    require_one(level=level, volume_fraction=volume_fraction)
    return fields.pore(phi, _solve_threshold(phi, volume_fraction, "pore") if level is None else level)


def make_sheet(
    of: Base = None,
    surface: Surface = None,
    period: Period = None,
    phase: Phase = None,
    reference: Reference = None,
    levels: Annotated[Any, TWO_LEVELS, "The levels, numbers or fields, or else give volume_fraction."] = None,
    volume_fraction: Fraction = None,
) -> Field:
    """Solid where a field lies between two levels."""
    phi = _make_base(of, surface, period, phase, reference)
    require_one(levels=levels, volume_fraction=volume_fraction)
    low, high = _solve_threshold(phi, volume_fraction, "sheet") if levels is None else levels
    return fields.sheet(phi, low, high)


def make_wall(
    of: Base = None,
    surface: Surface = None,
    period: Period = None,
    phase: Phase = None,
    reference: Reference = None,
    *,
    thickness: Annotated[Any, WALL_THICKNESS, "Thickness along the normal, mm; a ramp grades it."],
) -> Field:
    """A wall of a thickness in mm along the surface {field = 0}."""
    return fields.wall(_make_base(of, surface, period, phase, reference), thickness)


def make_cell_sizes(
    of: Base = None,
    surface: Surface = None,
    period: Period = None,
    phase: Phase = None,
    reference: Reference = None,
    x: AxisSizes = None,
    y: AxisSizes = None,
    z: AxisSizes = None,
) -> Field:
    """A periodic field whose cell size changes along one or more axes."""
    sizes: dict[str, Any] = {axis: given for axis, given in (("x", x), ("y", y), ("z", z)) if given is not None}
    if not sizes:
        raise InvalidRequest("give cell sizes along at least one of the axes x, y, z")
    return fields.cell_sizes(_make_base(of, surface, period, phase, reference), **sizes)


def make_bspline(
    coefficients: Annotated[
        Any, VALUES, "Coefficients (nx, ny, nz) as nested arrays, or else give file or seed."
    ] = None,
    file: Annotated[Path | None, PATH, "Coefficients (nx, ny, nz) in a .npy file."] = None,
    seed: Annotated[int | None, INDEX, "Seed of random coefficients."] = None,
    count: Annotated[Any, COUNTS, "Numbers of random coefficients along x, y and z, with `seed`."] = None,
    period: Annotated[Any, LENGTHS, "Edge of the cell, mm, one for all axes or one for each; 10 by default."] = None,
) -> Field:
    """A periodic B-spline unit: a field of any shape, from coefficients."""
    require_one(coefficients=coefficients, file=file, seed=seed)
    if (seed is None) != (count is None):
        reason = "'count' has a meaning only together with 'seed'" if seed is None else "the key 'count' is missing"
        raise InvalidRequest(reason)
    if seed is not None:
        coefficients = np.random.default_rng(seed).normal(size=count)
    elif file is not None:
        coefficients = read_numpy_array(file)
    return fields.bspline_unit(coefficients, period)


def make_image(
    file: Annotated[Path, PATH, "A .png or .tiff picture, or a .npy array of truth values (nx, ny, nz)."],
    lo: Annotated[Any, PAIR_OR_TRIPLE, "The lower corner of the picture (2) or of the array (3), mm."],
    hi: Annotated[Any, PAIR_OR_TRIPLE, "The upper corner, mm."],
    axis: Annotated[str, choice_of("x", "y", "z"), "Direction in which a picture is extruded."] = "z",
    threshold: Annotated[float, NUMBER, "Brightness of a picture that divides dark and light, 0 to 1."] = 0.5,
    solid: Annotated[str, choice_of("dark", "light"), "Which pixels are solid."] = "dark",
) -> Field:
    """The dark or light pixels of a picture, extruded along an axis; or the true voxels of an array."""
    mask = read_mask(file, threshold, solid)
    for name, corner in (("lo", lo), ("hi", hi)):
        if len(corner) != mask.ndim:
            raise InvalidRequest(f"{name} must be {mask.ndim} numbers, not {len(corner)}")
    return fields.image_region(mask, lo, hi, axis=axis)


def make_body(file: Annotated[Path, PATH, "A STEP file with one solid."]) -> Field:
    """The solid in a STEP file, as the distance to its surface, negative inside."""
    return tpmscad.body_field(file)


def _combine(
    sharp: Callable[..., Field], smooth: Callable[..., Field], of: Sequence[Field], width: float | None
) -> Field:
    """Fields combined with sharp edges, or one after the other with edges rounded over a width."""
    return sharp(*of) if width is None else reduce(lambda f, g: smooth(f, g, width), of)


def make_union(of: SomeFields, width: Width = None) -> Field:
    """Solid where any of the fields is."""
    return _combine(fields.union, fields.smooth_union, of, width)


def make_intersection(of: SomeFields, width: Width = None) -> Field:
    """Solid where all of the fields are."""
    return _combine(fields.intersection, fields.smooth_intersection, of, width)


def make_difference(
    of: Annotated[Field, FIELD, "The field that is kept."],
    minus: Annotated[Sequence[Field], SOME_FIELDS, "The fields that are taken away."],
    width: Width = None,
) -> Field:
    """One field without others."""
    return _combine(fields.difference, fields.smooth_difference, (of, *minus), width)


def make_mixture(
    of: Annotated[Sequence[Field], TWO_FIELDS, "The fields that are mixed."],
    weight: Annotated[Field, FIELD, "0 for the first field, 1 for the second; mostly a ramp."],
) -> Field:
    """The first field turning into the second by a weight: (1 - weight) first + weight second.

    Two walls, or two intersections or unions of as many parts, are mixed part by part: the mean of two maxima has edges where
    the maximum of two means has none.
    """
    first, second = of
    if isinstance(first, MinMaxField) and isinstance(second, MinMaxField) and first.sign == second.sign:
        a = make_mixture((first.first, second.first), weight)
        b = make_mixture((first.second, second.second), weight)
        return MinMaxField(a, b, first.sign)
    return first + weight * (second - first)


def add_fields(of: SomeFields) -> Field:
    """The sum of fields and numbers."""
    return reduce(operator.add, of)


def multiply_fields(of: SomeFields) -> Field:
    """The product of fields and numbers."""
    return reduce(operator.mul, of)


CONVENIENCES: dict[str, Callable[..., Field]] = {
    "rod": make_rod,
    "pore": make_pore,
    "wall": make_wall,
    "sheet": make_sheet,
    "bspline": make_bspline,
    "cell_sizes": make_cell_sizes,
    "image": make_image,
    "body": make_body,
    "union": make_union,
    "intersection": make_intersection,
    "difference": make_difference,
    "mix": make_mixture,
    "sum": add_fields,
    "product": multiply_fields,
}
"""The kinds that only recipes have, or that take more in a recipe than in Python."""

OTHER_NAMES = {"translated": "translate", "rotated": "rotate", "scaled": "scale"}
"""Kinds that are functions of `tpmscad.fields` under another name."""

NO_KINDS = {"as_field"}
"""Functions that make what a recipe writes as it is."""


@cache
def field_kinds() -> Mapping[str, Callable[..., Field]]:
    """Every kind of field that a recipe may name, and the function that makes it, in the order of the printed reference."""
    public = (name for name in fields.__all__ if name not in NO_KINDS)  # type: ignore[attr-defined]  # set by `attach_stub`
    kinds = CONVENIENCES | {name: function for name in public if makes_field(function := getattr(fields, name))}
    return kinds | CONVENIENCES | {name: kinds[own] for name, own in OTHER_NAMES.items()}
