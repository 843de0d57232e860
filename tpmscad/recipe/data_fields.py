"""Fields of data and formulas as kinds of recipes: a voxel array, a table of points, an expression of x, y and z."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tpmscad import fields
from tpmscad.fields import Field
from tpmscad.recipe.field_kind import FieldKind, Key, field_kind
from tpmscad.recipe.toml_entry import Entry
from tpmscad.recipe.value_types import (
    CELL,
    FILE,
    NUMBER,
    POINT,
    POSITIVE,
    STRING,
    ReadField,
    ValueType,
    plain_type,
    read_box_corners,
)


def make_expression(*, formula: str, period: float | None, names: Mapping[str, Field]) -> Field:
    """The field of a formula, which is parsed and never run."""
    return fields.expression(formula, period, **names)


def make_sampled(*, file: Path, spacing: Any, origin: Any, level: float | None) -> Field:
    """The field through the voxels of a file."""
    return fields.sampled(file, spacing, origin, level=level)


def make_scattered(*, file: Path, level: float | None, smoothing: float, domain: Any) -> Field:
    """The field through the points of a CSV file."""
    return fields.scattered(file, level=level, smoothing=smoothing, domain=domain)


def _read_names(entry: Entry, read: ReadField) -> dict[str, Field]:
    """The fields of a table by their names in a formula."""
    return {name: read(entry[name]) for name in entry.table().value}


LEVEL_KEY = Key(
    "level",
    NUMBER,
    "solid where the data exceed this, as for a density",
    default=None,
    default_text="solid where the data are negative",
)

DATA_KINDS: dict[str, FieldKind] = {
    "expression": field_kind(
        "A formula of x, y and z; solid where it is negative.",
        make_expression,
        Key("formula", STRING, 'such as "sin(x)*cos(y) + 0.2*z": + - * / **, sin cos exp sqrt abs min max ..., pi'),
        Key(
            "period",
            POSITIVE,
            "if given, x, y and z are angles, 2 pi for a period, and X, Y, Z stay in mm",
            "mm",
            default=None,
            default_text="x, y, z in mm",
            also=("cell",),
        ),
        Key(
            "names",
            ValueType("{ name = field, ... }", _read_names),
            "fields that the formula uses by name",
            default={},
            default_text="none",
        ),
    ),
    "sampled": field_kind(
        "A 3-D array of numbers: a density, a CT scan, a result of a simulation.",
        make_sampled,
        Key("file", FILE, "a .npy array (nx, ny, nz); or .vti, .vtk, .nrrd, .nii"),
        Key("spacing", CELL, "distance of neighbouring samples", "mm", default=None, default_text="of the file, or 1"),
        Key("origin", POINT, "position of the first sample", "mm", default=None, default_text="of the file, or 0"),
        LEVEL_KEY,
    ),
    "scattered": field_kind(
        "Values at scattered points, interpolated.",
        make_scattered,
        Key("file", FILE, "a .csv file with the columns x, y, z, value"),
        LEVEL_KEY,
        Key("smoothing", NUMBER, "0 passes through all values, more smooths noise", default=0.0),
        Key(
            "domain",
            plain_type("2 corners", read_box_corners),
            "the box in which the field follows the data",
            "mm",
            default=None,
            default_text="the box of the points",
        ),
    ),
}
