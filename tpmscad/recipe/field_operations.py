"""Operations on fields as tables of a recipe: booleans, sums and products, ramps and motions."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

from tpmscad import fields
from tpmscad.fields import Field
from tpmscad.recipe.field_kind import FieldKind, ReadField, make_kind, read_direction, read_triple
from tpmscad.recipe.toml_entry import Entry


def read_union(entry: Entry, read: ReadField) -> Field:
    """`of` (an array of fields), rounded if there is a `width`."""
    return _fold_operands(entry, read, fields.union, fields.smooth_union)


def read_intersection(entry: Entry, read: ReadField) -> Field:
    """`of` (an array of fields), rounded if there is a `width`."""
    return _fold_operands(entry, read, fields.intersection, fields.smooth_intersection)


def read_difference(entry: Entry, read: ReadField) -> Field:
    """`of` without the fields of the array `minus`, rounded if there is a `width`."""
    taken = _read_all(entry["minus"], read)
    width = entry.get("width")
    if width is None:
        return fields.difference(read(entry["of"]), *taken)
    smooth = width.positive()
    return reduce(lambda f, g: fields.smooth_difference(f, g, smooth), taken, read(entry["of"]))


def read_complement(entry: Entry, read: ReadField) -> Field:
    """The complement of `of`."""
    return fields.complement(read(entry["of"]))


def read_sum(entry: Entry, read: ReadField) -> Field:
    """The sum of the fields of the array `of`."""
    return reduce(lambda f, g: f + g, _read_all(entry["of"], read))


def read_product(entry: Entry, read: ReadField) -> Field:
    """The product of the fields of the array `of`."""
    return reduce(lambda f, g: f * g, _read_all(entry["of"], read))


def read_linear(entry: Entry, read: ReadField) -> Field:
    """The linear field `slope` . x + `offset`."""
    offset = entry.get("offset")
    return fields.linear(read_triple(entry["slope"]), 0.0 if offset is None else offset.number())


def read_ramp(entry: Entry, read: ReadField) -> Field:
    """From values[0] to values[1] while `by` (x, y, z or a field) goes from span[0] to span[1]."""
    by, smooth = entry["by"], entry.get("smooth")
    return fields.ramp(
        by.value if by.value in ("x", "y", "z") else read(by),
        entry["span"].numbers(2),
        entry["values"].numbers(2),
        smooth=True if smooth is None else smooth.boolean(),
    )


def read_translated(entry: Entry, read: ReadField) -> Field:
    """`of`, moved by `vector`."""
    return fields.translate(read(entry["of"]), read_triple(entry["vector"]))


def read_rotated(entry: Entry, read: ReadField) -> Field:
    """`of`, turned by `angle` degrees about `axis` through `center`."""
    return fields.rotate(read(entry["of"]), read_direction(entry["axis"]), entry["angle"].number(), _read_center(entry))


def read_scaled(entry: Entry, read: ReadField) -> Field:
    """`of`, enlarged by `factor` about `center`."""
    return fields.scale(read(entry["of"]), entry["factor"].positive(), _read_center(entry))


def _read_center(entry: Entry) -> tuple[float, float, float]:
    """The point `center`, by default the origin."""
    center = entry.get("center")
    return (0.0, 0.0, 0.0) if center is None else read_triple(center)


def _read_all(entry: Entry, read: ReadField) -> list[Field]:
    """The fields of an array; RecipeError if it is empty."""
    found = [read(item) for item in entry.items()]
    if not found:
        raise entry.error("is empty: at least one field is needed")
    return found


def _fold_operands(
    entry: Entry,
    read: ReadField,
    sharp: Callable[..., Field],
    smooth: Callable[[Field, Field, float], Field],
) -> Field:
    """The fields of `of` combined by `sharp`, or pairwise by `smooth` with the `width` of the table."""
    parts, width = _read_all(entry["of"], read), entry.get("width")
    if width is None:
        return sharp(*parts)
    rounded = width.positive()
    return reduce(lambda f, g: smooth(f, g, rounded), parts)


OPERATION_KINDS: dict[str, FieldKind] = {
    "union": make_kind("of width", read_union),
    "intersection": make_kind("of width", read_intersection),
    "difference": make_kind("of minus width", read_difference),
    "complement": make_kind("of", read_complement),
    "sum": make_kind("of", read_sum),
    "product": make_kind("of", read_product),
    "linear": make_kind("slope offset", read_linear),
    "ramp": make_kind("by span values smooth", read_ramp),
    "translated": make_kind("of vector", read_translated),
    "rotated": make_kind("of axis angle center", read_rotated),
    "scaled": make_kind("of factor center", read_scaled),
}
