"""Unions, intersections and differences of solids, sharp and smooth.

The solid of max(f, g) is the intersection of the solids of f and g, that of min(f, g) their union, and that of -f the complement.
Porous blending, eq. 25, intersects a porous structure with a free-form model in this way. The results are no signed distances,
even if f and g are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FIELD, POSITIVE
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import BinaryField, Field, FieldLike, MinMaxField, as_field
from tpmscad.fields.tape.tape_nodes import Node, choose_extreme, clamp


@dataclass(frozen=True, slots=True)
class RoundedMinMaxField(BinaryField):
    """Maximum (sign +1) or minimum (sign -1) of two fields, rounded where they differ by less than `width`.

    Elsewhere the values have the same bits as the maximum or minimum.
    """

    sign: int
    width: float

    def profile(self, separation: Node) -> Node:
        """Height added where the fields differ by `separation` widths, in widths; zero from 1 on."""
        raise NotImplementedError

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        f, g = self.first.trace(x, y, z), self.second.trace(x, y, z)
        difference = self.sign * (f - g)
        # |f - g| with a slope on the crease, too, which then has the mean of both gradients
        separation = choose_extreme(+1, difference, -difference) / self.width
        return choose_extreme(self.sign, f, g) + (self.sign * self.width) * self.profile(separation)


@dataclass(frozen=True, slots=True)
class CubicMinMaxField(RoundedMinMaxField):
    """Rounded by sign * width / 6 * (1 - |f - g| / width)^3: twice continuously differentiable across the crease."""

    def profile(self, separation: Node) -> Node:
        """Cubic height."""
        overlap = clamp(
            1.0 - separation, 0.0, 2.0
        )  # at most 1; the limit bounds it over boxes where f and g are not told apart
        return overlap * overlap * overlap / 6.0


@validate_call()
def union(*fields: Annotated[FieldLike, FIELD, "At least one field."]) -> Field:
    """Return the union of solids, the minimum of their fields.

    Returns
    -------
    Field
        The minimum.

    Raises
    ------
    InvalidRequest
        If no field is given.

    Examples
    --------
    >>> from tpmscad import fields
    >>> pair = fields.union(fields.sphere((0, 0, 0), 1.0), fields.sphere((4, 0, 0), 2.0))
    >>> float(pair((4.0, 0.0, 0.0)))
    -2.0
    """
    return _fold_min_max(fields, -1)


@validate_call()
def intersection(*fields: Annotated[FieldLike, FIELD, "At least one field."]) -> Field:
    """Return the intersection of solids, the maximum of their fields.

    Returns
    -------
    Field
        The maximum. `intersection(phi, model)` is a free-form porous model (porous blending, eq. 25).

    Raises
    ------
    InvalidRequest
        If no field is given.

    Examples
    --------
    >>> from tpmscad import fields
    >>> slab = fields.intersection(fields.halfspace((0, 0, 1), "z"), fields.halfspace((0, 0, -1), "-z"))
    >>> float(slab((0.0, 0.0, 0.25)))
    -0.75
    """
    return _fold_min_max(fields, +1)


@validate_call()
def difference(
    field: Annotated[FieldLike, FIELD, "The solid to cut."],
    *taken: Annotated[FieldLike, FIELD, "The solids that are removed."],
) -> Field:
    """Return a solid without other solids.

    Returns
    -------
    Field
        The maximum of `field` and the negatives of the others.

    Examples
    --------
    >>> from tpmscad import fields
    >>> shell = fields.difference(fields.sphere((0, 0, 0), 3.0), fields.sphere((0, 0, 0), 2.0))
    >>> float(shell((1.0, 0.0, 0.0))), float(shell((2.5, 0.0, 0.0)))
    (1.0, -0.5)
    """
    return _fold_min_max((field, *(-as_field(f) for f in taken)), +1)


@validate_call()
def complement(field: Annotated[FieldLike, FIELD, "The field."]) -> Field:
    """Return the field with solid and void exchanged.

    Returns
    -------
    Field
        -field.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.complement(fields.sphere((0, 0, 0), 2.0))((0.0, 0.0, 0.0)))
    2.0
    """
    return -as_field(field)


@validate_call()
def smooth_union(
    first: Annotated[FieldLike, FIELD, "The solids."],
    second: Annotated[FieldLike, FIELD, "The solids."],
    width: Annotated[
        float,
        POSITIVE,
        "Difference of the two field values below which the crease is filled; for signed distances a length in model "
        "units.",
    ],
) -> Field:
    """Return the union of two solids with a filled crease.

    Returns
    -------
    Field
        The minimum minus ``width / 6 * (1 - abs(f - g) / width) ** 3`` in the crease; elsewhere exactly the minimum.

    Examples
    --------
    >>> from tpmscad import fields
    >>> pair = fields.smooth_union(fields.sphere((-1, 0, 0), 1.0), fields.sphere((1, 0, 0), 1.0), 0.6)
    >>> round(float(pair((0.0, 0.0, 0.0))), 6)
    -0.1
    """
    return CubicMinMaxField(as_field(first), as_field(second), -1, width)


@validate_call()
def smooth_intersection(
    first: Annotated[FieldLike, FIELD, "The solids."],
    second: Annotated[FieldLike, FIELD, "The solids."],
    width: Annotated[
        float,
        POSITIVE,
        "Difference of the two field values below which the edge is rounded; for signed distances a length in model "
        "units.",
    ],
) -> Field:
    """Return the intersection of two solids with a rounded edge.

    Returns
    -------
    Field
        The maximum plus ``width / 6 * (1 - abs(f - g) / width) ** 3`` at the edge; elsewhere exactly the maximum.

    Examples
    --------
    >>> from tpmscad import fields
    >>> wedge = fields.smooth_intersection(fields.halfspace((0, 0, 0), "x"), fields.halfspace((0, 0, 0), "y"), 0.6)
    >>> round(float(wedge((0.0, 0.0, 0.0))), 6)
    0.1
    """
    return CubicMinMaxField(as_field(first), as_field(second), +1, width)


@validate_call()
def smooth_difference(
    field: Annotated[FieldLike, FIELD, "The solid to cut."],
    taken: Annotated[FieldLike, FIELD, "The solid that is removed."],
    width: Annotated[float, POSITIVE, "Difference between `field` and -`taken` below which the edge is rounded."],
) -> Field:
    """Return a solid without another one, with a rounded edge.

    Returns
    -------
    Field
        `smooth_intersection(field, -taken, width)`.

    Examples
    --------
    >>> from tpmscad import fields
    >>> bowl = fields.smooth_difference(fields.halfspace((0, 0, 0), "z"), fields.sphere((0, 0, 0), 1.0), 0.6)
    >>> round(float(bowl((1.0, 0.0, 0.0))), 6)
    0.1
    """
    return smooth_intersection(field, -as_field(taken), width)


def _fold_min_max(fields: tuple[FieldLike, ...], sign: int) -> Field:
    if not fields:
        raise InvalidRequest("a union or intersection needs at least one field")
    return join_extremes(sign, [as_field(field) for field in fields])


def join_extremes(sign: int, fields: Sequence[Field]) -> Field:
    """The maximum (sign +1) or minimum (-1) of fields, in pairs of neighbours: the depth is the logarithm of their number."""
    parts = list(fields)
    while len(parts) > 1:
        pairs = [MinMaxField(f, g, sign) for f, g in zip(parts[::2], parts[1::2], strict=False)]
        parts = [*pairs, *parts[len(parts) - len(parts) % 2 :]]
    return parts[0]
