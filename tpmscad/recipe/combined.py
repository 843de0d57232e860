"""Fields made of others, as tables of a recipe: booleans, sums and products, ramps, and fields that are moved."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

from tpmscad import fields
from tpmscad.fields import Field
from tpmscad.recipe.entry import Entry
from tpmscad.recipe.kind import Kind, Read, direction, kind, triple


def union(entry: Entry, read: Read) -> Field:
    return _folded(entry, read, fields.union, fields.smooth_union)


def intersection(entry: Entry, read: Read) -> Field:
    return _folded(entry, read, fields.intersection, fields.smooth_intersection)


def difference(entry: Entry, read: Read) -> Field:
    taken = _all(entry["minus"], read)
    width = entry.get("width")
    if width is None:
        return fields.difference(read(entry["of"]), *taken)
    smooth = width.positive()
    return reduce(lambda f, g: fields.smooth_difference(f, g, smooth), taken, read(entry["of"]))


def complement(entry: Entry, read: Read) -> Field:
    return fields.complement(read(entry["of"]))


def total(entry: Entry, read: Read) -> Field:
    return reduce(lambda f, g: f + g, _all(entry["of"], read))


def product(entry: Entry, read: Read) -> Field:
    return reduce(lambda f, g: f * g, _all(entry["of"], read))


def linear(entry: Entry, read: Read) -> Field:
    offset = entry.get("offset")
    return fields.linear(triple(entry["slope"]), 0.0 if offset is None else offset.number())


def ramp(entry: Entry, read: Read) -> Field:
    """From values[0] to values[1] while `by` (x, y, z or a field) goes from span[0] to span[1]."""
    by, smooth = entry["by"], entry.get("smooth")
    return fields.ramp(
        by.value if by.value in ("x", "y", "z") else read(by),
        entry["span"].numbers(2),
        entry["values"].numbers(2),
        smooth=True if smooth is None else smooth.flag(),
    )


def translated(entry: Entry, read: Read) -> Field:
    return fields.translated(read(entry["of"]), triple(entry["vector"]))


def rotated(entry: Entry, read: Read) -> Field:
    return fields.rotated(read(entry["of"]), direction(entry["axis"]), entry["angle"].number(), _center(entry))


def scaled(entry: Entry, read: Read) -> Field:
    return fields.scaled(read(entry["of"]), entry["factor"].positive(), _center(entry))


def _center(entry: Entry) -> tuple[float, float, float]:
    center = entry.get("center")
    return (0.0, 0.0, 0.0) if center is None else triple(center)


def _all(entry: Entry, read: Read) -> list[Field]:
    """The fields of an array, at least one."""
    found = [read(item) for item in entry.items()]
    if not found:
        raise entry.error("is empty: at least one field is needed")
    return found


def _folded(
    entry: Entry,
    read: Read,
    sharp: Callable[..., Field],
    smooth: Callable[[Field, Field, float], Field],
) -> Field:
    parts, width = _all(entry["of"], read), entry.get("width")
    if width is None:
        return sharp(*parts)
    rounded = width.positive()
    return reduce(lambda f, g: smooth(f, g, rounded), parts)


COMBINED: dict[str, Kind] = {
    "union": kind("of width", union),
    "intersection": kind("of width", intersection),
    "difference": kind("of minus width", difference),
    "complement": kind("of", complement),
    "sum": kind("of", total),
    "product": kind("of", product),
    "linear": kind("slope offset", linear),
    "ramp": kind("by span values smooth", ramp),
    "translated": kind("of vector", translated),
    "rotated": kind("of axis angle center", rotated),
    "scaled": kind("of factor center", scaled),
}
