"""Operations on fields as kinds of recipes: booleans, sums, mixtures, ramps and motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

from tpmscad import fields
from tpmscad.fields import Field
from tpmscad.fields.field import MinMaxField
from tpmscad.recipe.field_kind import FieldKind, Key, field_kind
from tpmscad.recipe.value_types import (
    AXIS_OR_FIELD,
    BOOLEAN,
    DIRECTION,
    FIELD,
    FIELDS,
    NUMBER,
    POINT,
    POSITIVE,
    fields_type,
    numbers_type,
)


def make_union(*, of: Sequence[Field], width: float | None) -> Field:
    """The union, rounded if there is a width."""
    return _fold(of, width, fields.union, fields.smooth_union)


def make_intersection(*, of: Sequence[Field], width: float | None) -> Field:
    """The intersection, rounded if there is a width."""
    return _fold(of, width, fields.intersection, fields.smooth_intersection)


def make_difference(*, of: Field, minus: Sequence[Field], width: float | None) -> Field:
    """A field without others, rounded if there is a width."""
    if width is None:
        return fields.difference(of, *minus)
    return reduce(lambda f, g: fields.smooth_difference(f, g, width), minus, of)


def make_mixture(*, of: Sequence[Field], weight: Field) -> Field:
    """The first field where the weight is 0, the second where it is 1, and their weighted mean between.

    Two walls, or two intersections or unions of as many parts, are mixed part by part: the mean of two maxima has edges where
    the maximum of two means has none.
    """
    first, second = of
    if isinstance(first, MinMaxField) and isinstance(second, MinMaxField) and first.sign == second.sign:
        a = make_mixture(of=(first.first, second.first), weight=weight)
        b = make_mixture(of=(first.second, second.second), weight=weight)
        return MinMaxField(a, b, first.sign)
    return first + weight * (second - first)


def make_ramp(*, by: Any, span: Any, values: Any, smooth: bool) -> Field:
    """From values[0] to values[1] while `by` goes from span[0] to span[1]."""
    return fields.ramp(by, span, values, smooth=smooth)


def _fold(
    parts: Sequence[Field],
    width: float | None,
    sharp: Callable[..., Field],
    smooth: Callable[[Field, Field, float], Field],
) -> Field:
    """The fields combined by `sharp`, or pairwise by `smooth` with a width."""
    return sharp(*parts) if width is None else reduce(lambda f, g: smooth(f, g, width), parts)


WIDTH_KEY = Key("width", POSITIVE, "width of the rounding of the edges", "mm", default=None, default_text="sharp")
OF_KEY = Key("of", FIELD, "the field")
CENTER_KEY = Key("center", POINT, "the fixed point", "mm", default=(0.0, 0.0, 0.0))

OPERATION_KINDS: dict[str, FieldKind] = {
    "union": field_kind(
        "Solid where any of the fields is.", make_union, Key("of", FIELDS, "the fields that are united"), WIDTH_KEY
    ),
    "intersection": field_kind(
        "Solid where all of the fields are.", make_intersection, Key("of", FIELDS, "the fields that are cut"), WIDTH_KEY
    ),
    "difference": field_kind(
        "One field without others.",
        make_difference,
        Key("of", FIELD, "the field that is kept"),
        Key("minus", FIELDS, "the fields that are taken away"),
        WIDTH_KEY,
    ),
    "complement": field_kind("Solid where the field is void.", lambda of: fields.complement(of), OF_KEY),
    "mix": field_kind(
        "The first field turning into the second by a weight: (1 - weight) first + weight second.",
        make_mixture,
        Key("of", fields_type(2, "fields"), "the fields that are mixed"),
        Key("weight", FIELD, "0 for the first field, 1 for the second; mostly a ramp"),
    ),
    "sum": field_kind(
        "The sum of fields and numbers.",
        lambda of: reduce(lambda f, g: f + g, of),
        Key("of", FIELDS, "the fields that are added"),
    ),
    "product": field_kind(
        "The product of fields and numbers.",
        lambda of: reduce(lambda f, g: f * g, of),
        Key("of", FIELDS, "the fields that are multiplied"),
    ),
    "linear": field_kind(
        "The field slope . (x, y, z) + offset.",
        fields.linear,
        Key("slope", POINT, "the gradient", "1/mm"),
        Key("offset", NUMBER, "the value at the origin", default=0.0),
    ),
    "ramp": field_kind(
        "A value that goes from one number to another along an axis or with another field.",
        make_ramp,
        Key("by", AXIS_OR_FIELD, "what the value follows"),
        Key("span", numbers_type(2), "where the ramp starts and ends", "mm along an axis"),
        Key("values", numbers_type(2), "the values at start and end, kept beyond them"),
        Key("smooth", BOOLEAN, "a smooth transition instead of a straight line with two kinks", default=True),
    ),
    "translated": field_kind(
        "A field that is moved.",
        lambda of, vector: fields.translate(of, vector),
        OF_KEY,
        Key("vector", POINT, "the way it is moved", "mm"),
    ),
    "rotated": field_kind(
        "A field that is turned about an axis.",
        lambda of, axis, angle, center: fields.rotate(of, axis, angle, center),
        OF_KEY,
        Key("axis", DIRECTION, "direction of the axis"),
        Key("angle", NUMBER, "the angle", "degrees"),
        CENTER_KEY,
    ),
    "scaled": field_kind(
        "A field that is enlarged or made smaller.",
        lambda of, factor, center: fields.scale(of, factor, center),
        OF_KEY,
        Key("factor", POSITIVE, "enlargement"),
        CENTER_KEY,
    ),
}
