"""Regions as kinds of recipes: boxes, half-spaces, cylinders, spheres, pictures, bodies from STEP files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tpmscad
from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field
from tpmscad.recipe.field_kind import FieldKind, Key, field_kind
from tpmscad.recipe.image_masks import read_mask
from tpmscad.recipe.value_types import (
    CORNER,
    DIRECTION,
    FILE,
    NUMBER,
    POINT,
    POSITIVE,
    choice_type,
    plain_type,
    read_pair_or_triple,
)

PAIR_OR_TRIPLE = plain_type("2 or 3 numbers", read_pair_or_triple)


def make_image_region(*, file: Path, lo: Any, hi: Any, axis: str, threshold: Any, solid: str) -> Field:
    """Pixels of a picture that are darker or lighter than a threshold, extruded along an axis; or the voxels of a .npy array."""
    mask = read_mask(file, threshold, solid)
    for name, corner in (("lo", lo), ("hi", hi)):
        if len(corner) != mask.ndim:
            raise InvalidRequest(f"{name} must be {mask.ndim} numbers, not {len(corner)}")
    return fields.image_region(mask, lo, hi, axis=axis)


def make_body_field(*, file: Path) -> Field:
    """The signed distance to the solid of a STEP file."""
    return tpmscad.body_field(file)


REGION_KINDS: dict[str, FieldKind] = {
    "box": field_kind(
        "A box along the axes.",
        fields.box,
        Key("lo", CORNER, "the lower corner", "mm"),
        Key("hi", CORNER, "the upper corner", "mm"),
    ),
    "halfspace": field_kind(
        "Everything behind a plane.",
        fields.halfspace,
        Key("point", POINT, "a point of the plane", "mm"),
        Key("normal", DIRECTION, "points out of the solid"),
    ),
    "cylinder": field_kind(
        "A cylinder, by default without ends.",
        fields.cylinder,
        Key("center", POINT, "the center", "mm"),
        Key("radius", POSITIVE, "the radius", "mm"),
        Key("axis", DIRECTION, "direction of the axis", default="z"),
        Key("height", POSITIVE, "length along the axis", "mm", default=None, default_text="no ends"),
    ),
    "sphere": field_kind(
        "A ball.",
        fields.sphere,
        Key("center", POINT, "the center", "mm"),
        Key("radius", POSITIVE, "the radius", "mm"),
    ),
    "image": field_kind(
        "The dark or light pixels of a picture, extruded along an axis; or the true voxels of an array.",
        make_image_region,
        Key("file", FILE, "a .png or .tiff picture, or a .npy array of truth values (nx, ny, nz)"),
        Key("lo", PAIR_OR_TRIPLE, "the lower corner of the picture (2) or of the array (3)", "mm"),
        Key("hi", PAIR_OR_TRIPLE, "the upper corner", "mm"),
        Key("axis", choice_type("x", "y", "z"), "direction in which a picture is extruded", default="z"),
        Key("threshold", NUMBER, "brightness of a picture that divides dark and light", "0..1", default=0.5),
        Key("solid", choice_type("dark", "light"), "which pixels are solid", default="dark"),
    ),
    "body": field_kind(
        "The solid in a STEP file, as the distance to its surface, negative inside.",
        make_body_field,
        Key("file", FILE, "a STEP file with one solid"),
    ),
}
