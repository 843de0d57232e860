"""A field with its minima and maxima outermost: a tree of unions and intersections over smooth leaves.

Minima and maxima pass through every function that is monotone in their values: with a decreasing one a minimum becomes a maximum.
So the complement of a union is the intersection of the complements, a box is the intersection of half-spaces, and the leaves of a
translated union are translated. The level set is that of the field, and so are the values but outside boxes and finite cylinders,
where distances from edges become the greatest of those from planes; where values matter, as in a sum, these stay leaves. On a
crease, where two leaves are equal, the gradient may be that of the other one. A leaf is everything else; it is taken to be
smooth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import singledispatch
from typing import TypeVar

import numpy as np

from tpmscad._typing import BoolArray
from tpmscad.fields.field import Field, MinMaxField, ScaledField, SumField, multiply_fields
from tpmscad.fields.kinds.beam_lattices import BeamsField
from tpmscad.fields.kinds.booleans import RoundedMinMaxField, join_extremes
from tpmscad.fields.kinds.coordinate_transforms import AffineTransformedField
from tpmscad.fields.kinds.linear_extension import LinearExtension
from tpmscad.fields.kinds.primitive_regions import BoxRegion, CylinderRegion, HalfSpaceRegion

T = TypeVar("T")


@singledispatch
def expose_extremes(field: Field, values: bool = False) -> Field:
    """The field as minima and maxima (`MinMaxField`) of smooth fields; the field itself if it is one of these.

    If `values` is set, all values stay the same, not the level set only.
    """
    return field


def list_leaves(field: Field) -> tuple[Field, ...]:
    """The fields, in order, of which `field` is the minimum or maximum."""
    if isinstance(field, MinMaxField):
        return (*list_leaves(field.first), *list_leaves(field.second))
    return (field,)


def replace_leaves(field: Field, leaves: Sequence[Field]) -> Field:
    """`field` with the fields of `list_leaves` replaced by others."""
    if isinstance(field, MinMaxField):
        n = len(list_leaves(field.first))
        return MinMaxField(
            replace_leaves(field.first, leaves[:n]), replace_leaves(field.second, leaves[n:]), field.sign
        )
    return leaves[0]


def list_operands(field: MinMaxField) -> tuple[Field, ...]:
    """The fields of which the whole minimum or maximum is taken: no operand is one of the same kind."""
    return tuple(
        operand
        for part in (field.first, field.second)
        for operand in (list_operands(part) if isinstance(part, MinMaxField) and part.sign == field.sign else (part,))
    )


def combine_solids(field: Field, is_solid: Sequence[BoolArray] | BoolArray) -> BoolArray:
    """Where the tree is solid, from where each of its leaves is, in the order of `list_leaves`: arrays of one shape."""
    if not isinstance(field, MinMaxField):
        return np.asarray(is_solid[0])
    n = len(list_leaves(field.first))
    first, second = combine_solids(field.first, is_solid[:n]), combine_solids(field.second, is_solid[n:])
    return first & second if field.sign > 0 else first | second


def combine_complements(
    sign: int,
    sets: Sequence[tuple[T, bool]],
    unite: Callable[[Sequence[T]], T],
    intersect: Callable[[Sequence[T]], T],
    subtract: Callable[[T, Sequence[T]], T],
) -> tuple[T, bool]:
    """The intersection (sign +1) or union (-1) of solids and of complements, which are flagged, by operations on solids.

    By De Morgan's laws the result is again a solid or the complement of one. `subtract` takes several solids from one.
    """
    if sign < 0:
        found, complement = combine_complements(+1, [(s, not flag) for s, flag in sets], unite, intersect, subtract)
        return found, not complement
    solid = [s for s, flag in sets if not flag]
    taken = [s for s, flag in sets if flag]
    if not solid:
        return unite(taken), True
    return subtract(intersect(solid), taken), False


def _map_leaves(field: Field, function: Callable[[Field], Field], increasing: bool = True) -> Field:
    """A monotone function of a tree: of its leaves."""
    if not isinstance(field, MinMaxField):
        return function(field)
    first, second = (_map_leaves(part, function, increasing) for part in (field.first, field.second))
    return MinMaxField(first, second, field.sign if increasing else -field.sign)


def _map_pairs(first: Field, second: Field, function: Callable[[Field, Field], Field]) -> Field:
    """An increasing function of two trees: of their pairs of leaves."""
    return _map_leaves(first, lambda f: _map_leaves(second, lambda g: function(f, g)))


@expose_extremes.register
def _(field: MinMaxField, values: bool = False) -> Field:
    return MinMaxField(expose_extremes(field.first, values), expose_extremes(field.second, values), field.sign)


@expose_extremes.register
def _(field: BeamsField, values: bool = False) -> Field:
    return expose_extremes(field.field, values)


@expose_extremes.register
def _(field: ScaledField, values: bool = False) -> Field:
    inner = expose_extremes(field.field, values)
    return _map_leaves(inner, lambda leaf: multiply_fields(leaf, field.factor), field.factor > 0)


@expose_extremes.register
def _(field: SumField, values: bool = False) -> Field:
    first, second = expose_extremes(field.first, True), expose_extremes(field.second, True)
    return _map_pairs(first, second, lambda f, g: f + g)


@expose_extremes.register
def _(field: RoundedMinMaxField, values: bool = False) -> Field:
    first, second = expose_extremes(field.first, True), expose_extremes(field.second, True)
    return _map_pairs(first, second, lambda f, g: replace(field, first=f, second=g))


@expose_extremes.register
def _(field: AffineTransformedField, values: bool = False) -> Field:
    inner = expose_extremes(field.field, values)
    return _map_leaves(inner, lambda leaf: replace(field, field=leaf), field.factor > 0)


@expose_extremes.register
def _(field: LinearExtension, values: bool = False) -> Field:
    return _map_leaves(expose_extremes(field.field, values), lambda leaf: replace(field, field=leaf))


@expose_extremes.register
def _(field: BoxRegion, values: bool = False) -> Field:
    if values:
        return field
    sides = []
    for axis, direction in enumerate(np.eye(3)):
        for corner, sign in ((field.hi, 1.0), (field.lo, -1.0)):
            if math.isfinite(corner[axis]):
                x, y, z = (corner[axis] * direction).tolist()
                a, b, c = (sign * direction).tolist()
                sides.append(HalfSpaceRegion((x, y, z), (a, b, c)))
    return join_extremes(+1, sides)


@expose_extremes.register
def _(field: CylinderRegion, values: bool = False) -> Field:
    if field.height is None or values:
        return field
    axis, center = np.array(field.axis), np.array(field.center)
    ends: list[Field] = []
    for sign in (1.0, -1.0):
        x, y, z = (center + sign * field.height / 2 * axis).tolist()
        a, b, c = (sign * axis).tolist()
        ends.append(HalfSpaceRegion((x, y, z), (a, b, c)))
    return join_extremes(+1, [replace(field, height=None), *ends])
