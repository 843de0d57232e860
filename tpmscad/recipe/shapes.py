"""Regions of space as tables of a recipe: boxes, half-spaces, cylinders, spheres, pictures, bodies from STEP files."""

from __future__ import annotations

from tpmscad import fields
from tpmscad.fields import Field
from tpmscad.recipe.entry import Entry
from tpmscad.recipe.kind import Kind, Read, direction, kind, triple
from tpmscad.recipe.pictures import mask


def box(entry: Entry, read: Read) -> Field:
    return fields.box(_corner(entry["lo"]), _corner(entry["hi"]))


def halfspace(entry: Entry, read: Read) -> Field:
    return fields.halfspace(triple(entry["point"]), direction(entry["normal"]))


def sphere(entry: Entry, read: Read) -> Field:
    return fields.sphere(triple(entry["center"]), entry["radius"].positive())


def cylinder(entry: Entry, read: Read) -> Field:
    axis, height = entry.get("axis"), entry.get("height")
    return fields.cylinder(
        triple(entry["center"]),
        entry["radius"].positive(),
        "z" if axis is None else direction(axis),
        None if height is None else height.positive(),
    )


def image(entry: Entry, read: Read) -> Field:
    """The pixels of a picture darker or lighter than a threshold (0 to 1), extruded along an axis; or a .npy stack."""
    solid = mask(entry)
    count = solid.ndim
    axis = entry.get("axis")
    return fields.image_region(
        solid, entry["lo"].numbers(count), entry["hi"].numbers(count), axis="z" if axis is None else axis.text("xyz")
    )


def body(entry: Entry, read: Read) -> Field:
    """The signed distance to the solid of a STEP file, relative to the recipe's folder."""
    from tpmscad.parts import body_field

    return body_field(entry["file"].beside())


def _corner(entry: Entry) -> tuple[float, ...]:
    """Three numbers, which may be infinite."""
    return tuple(
        item.value if isinstance(item.value, float) and abs(item.value) == float("inf") else item.number()
        for item in entry.several(3, "numbers")
    )


SHAPES: dict[str, Kind] = {
    "box": kind("lo hi", box),
    "halfspace": kind("point normal", halfspace),
    "cylinder": kind("center radius axis height", cylinder),
    "sphere": kind("center radius", sphere),
    "image": kind("file lo hi axis threshold solid", image),
    "body": kind("file", body),
}
