"""Regions as tables of a recipe: boxes, half-spaces, cylinders, spheres, pictures, bodies from STEP files."""

from __future__ import annotations

from tpmscad import fields, workflows
from tpmscad.fields import Field
from tpmscad.recipe.field_kind import FieldKind, ReadField, make_kind, read_direction, read_triple
from tpmscad.recipe.image_masks import read_mask
from tpmscad.recipe.toml_entry import Entry


def read_box(entry: Entry, read: ReadField) -> Field:
    """The box with the corners `lo` and `hi`, whose coordinates may be infinite."""
    return fields.box(_read_corner(entry["lo"]), _read_corner(entry["hi"]))


def read_halfspace(entry: Entry, read: ReadField) -> Field:
    """The half-space behind `point`, away from `normal`."""
    return fields.halfspace(read_triple(entry["point"]), read_direction(entry["normal"]))


def read_sphere(entry: Entry, read: ReadField) -> Field:
    """The sphere with `center` and `radius`."""
    return fields.sphere(read_triple(entry["center"]), entry["radius"].positive())


def read_cylinder(entry: Entry, read: ReadField) -> Field:
    """The cylinder with `center`, `radius`, `axis` (by default z) and `height` (by default infinite)."""
    axis, height = entry.get("axis"), entry.get("height")
    return fields.cylinder(
        read_triple(entry["center"]),
        entry["radius"].positive(),
        "z" if axis is None else read_direction(axis),
        None if height is None else height.positive(),
    )


def read_image_region(entry: Entry, read: ReadField) -> Field:
    """Pixels of a picture that are darker or lighter than a threshold, extruded along an axis; or the voxels of a .npy array."""
    solid = read_mask(entry)
    count = solid.ndim
    axis = entry.get("axis")
    return fields.image_region(
        solid, entry["lo"].numbers(count), entry["hi"].numbers(count), axis="z" if axis is None else axis.string("xyz")
    )


def read_body_field(entry: Entry, read: ReadField) -> Field:
    """The signed distance to the solid of a STEP file, whose path is relative to the folder of the recipe."""
    return workflows.body_field(entry["file"].sibling_file())


def _read_corner(entry: Entry) -> tuple[float, ...]:
    """Three numbers, which may be infinite."""
    return tuple(
        item.value if isinstance(item.value, float) and abs(item.value) == float("inf") else item.number()
        for item in entry.array_of_length(3, "numbers")
    )


REGION_KINDS: dict[str, FieldKind] = {
    "box": make_kind("lo hi", read_box),
    "halfspace": make_kind("point normal", read_halfspace),
    "cylinder": make_kind("center radius axis height", read_cylinder),
    "sphere": make_kind("center radius", read_sphere),
    "image": make_kind("file lo hi axis threshold solid", read_image_region),
    "body": make_kind("file", read_body_field),
}
