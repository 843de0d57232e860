"""Unions, intersections and differences of solids, sharp and smooth; free-form models.

The solid of max(f, g) is the intersection of the solids of f and g, that of min(f, g) their union, that of -f the complement
(porous blending, eq. 25, intersects a porous structure with a model so). The results are no distances any more, even where f and
g are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Extreme as Extreme
from tpmscad.fields.field import Field, FieldLike, as_field, common_periods
from tpmscad.fields.points import Array, Jet, Triple, positive


@dataclass(frozen=True, slots=True)
class SmoothExtreme(Field):
    """The greater or lesser of two fields, rounded where |f - g| < width by sign * width / 6 * (1 - |f - g| / width)^3: twice
    continuously differentiable across the crease, and elsewhere the very bits of the greater or lesser."""

    first: Field
    second: Field
    sign: int
    width: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self._value(self.first.at(x, y, z), self.second.at(x, y, z))[0]

    def jet(self, x: Array, y: Array, z: Array) -> Jet:
        f, g = self.first.jet(x, y, z), self.second.jet(x, y, z)
        value, keep, near = self._value(f[0], g[0])
        # d value / d loser = near^2 / 2, and the winner has the rest
        share = 0.5 * (near * near)
        own = np.where(keep, 1.0 - share, share)
        fx, fy, fz = (own * a + (1.0 - own) * b for a, b in zip(f[1:], g[1:], strict=True))
        return value, fx, fy, fz

    def _value(self, f: Array, g: Array) -> tuple[Array, NDArray[np.bool_], Array]:
        keep = self.sign * f >= self.sign * g
        near = np.maximum(0.0, 1.0 - np.abs(f - g) / self.width)
        return np.where(keep, f, g) + (self.sign * self.width / 6.0) * (near * near * near), keep, near

    def periods(self) -> Triple | None:
        return common_periods(self.first, self.second)


def union(*fields: FieldLike) -> Field:
    """The solid of any of the fields: their minimum."""
    return _folded(fields, -1)


def intersection(*fields: FieldLike) -> Field:
    """The solid common to all fields: their maximum. `intersection(phi, model)` is a free-form porous model (eq. 25)."""
    return _folded(fields, +1)


def difference(field: FieldLike, *taken: FieldLike) -> Field:
    """The solid of the first field without the solids of the others."""
    return _folded((field, *(-as_field(f) for f in taken)), +1)


def complement(field: FieldLike) -> Field:
    """Solid and void exchanged: -f."""
    return -as_field(field)


def smooth_union(first: FieldLike, second: FieldLike, width: float) -> Field:
    """Their union with the crease filled where the two values differ by less than `width` (in values of the fields)."""
    return SmoothExtreme(as_field(first), as_field(second), -1, positive(width, "width"))


def smooth_intersection(first: FieldLike, second: FieldLike, width: float) -> Field:
    """Their intersection with the edge rounded where the two values differ by less than `width`."""
    return SmoothExtreme(as_field(first), as_field(second), +1, positive(width, "width"))


def smooth_difference(field: FieldLike, taken: FieldLike, width: float) -> Field:
    """The first without the second, edge rounded where the value of the one and minus that of the other are that close."""
    return smooth_intersection(field, -as_field(taken), width)


def _folded(fields: tuple[FieldLike, ...], sign: int) -> Field:
    if not fields:
        raise InvalidRequest("a union or intersection needs at least one field")
    return reduce(lambda f, g: Extreme(f, g, sign), map(as_field, fields))
