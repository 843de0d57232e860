"""Unions, intersections and differences of solids, sharp and smooth; free-form models.

The solid of max(f, g) is the intersection of the solids of f and g, that of min(f, g) their union, that of -f the complement
(porous blending, eq. 25, intersects a porous structure with a model so). The results are no distances any more, even where f and
g are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import FieldJet, as_positive
from tpmscad.fields.field import BinaryField, Field, FieldLike, MinMaxField, as_field


@dataclass(frozen=True, slots=True)
class RoundedMinMaxField(BinaryField):
    """The greater (sign +1) or lesser (-1) of two fields, rounded where they differ by less than `width`: elsewhere the very bits
    of the greater or lesser."""

    sign: int
    width: float

    def profile(self, apart: Array) -> tuple[Array, Array]:
        """What is added where the fields are so many widths apart, in widths, and its derivative: nothing from 1 on."""
        raise NotImplementedError

    def at(self, x: Array, y: Array, z: Array) -> Array:
        f, g = self.first.at(x, y, z), self.second.at(x, y, z)
        added, _ = self.profile(np.abs(f - g) / self.width)
        return np.where(self.sign * f >= self.sign * g, f, g) + self.sign * self.width * added

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        f, g = self.first.jet(x, y, z), self.second.jet(x, y, z)
        added, slope = self.profile(np.abs(f[0] - g[0]) / self.width)
        keep = self.sign * f[0] >= self.sign * g[0]
        own = np.where(keep, 1.0 + slope, -slope)
        fx, fy, fz = (own * a + (1.0 - own) * b for a, b in zip(f[1:], g[1:], strict=True))
        return np.where(keep, f[0], g[0]) + self.sign * self.width * added, fx, fy, fz


@dataclass(frozen=True, slots=True)
class CubicMinMaxField(RoundedMinMaxField):
    """Rounded by sign * width / 6 * (1 - |f - g| / width)^3: twice continuously differentiable across the crease."""

    def profile(self, apart: Array) -> tuple[Array, Array]:
        near = np.maximum(0.0, 1.0 - apart)
        return near * near * near / 6.0, -0.5 * (near * near)


def union(*fields: FieldLike) -> Field:
    """The solid of any of the fields: their minimum."""
    return _fold_min_max(fields, -1)


def intersection(*fields: FieldLike) -> Field:
    """The solid common to all fields: their maximum. `intersection(phi, model)` is a free-form porous model (eq. 25)."""
    return _fold_min_max(fields, +1)


def difference(field: FieldLike, *taken: FieldLike) -> Field:
    """The solid of the first field without the solids of the others."""
    return _fold_min_max((field, *(-as_field(f) for f in taken)), +1)


def complement(field: FieldLike) -> Field:
    """Solid and void exchanged: -f."""
    return -as_field(field)


def smooth_union(first: FieldLike, second: FieldLike, width: float) -> Field:
    """Their union with the crease filled where the two values differ by less than `width` (in values of the fields)."""
    return CubicMinMaxField(as_field(first), as_field(second), -1, as_positive(width, "width"))


def smooth_intersection(first: FieldLike, second: FieldLike, width: float) -> Field:
    """Their intersection with the edge rounded where the two values differ by less than `width`."""
    return CubicMinMaxField(as_field(first), as_field(second), +1, as_positive(width, "width"))


def smooth_difference(field: FieldLike, taken: FieldLike, width: float) -> Field:
    """The first without the second, edge rounded where the value of the one and minus that of the other are that close."""
    return smooth_intersection(field, -as_field(taken), width)


def _fold_min_max(fields: tuple[FieldLike, ...], sign: int) -> Field:
    if not fields:
        raise InvalidRequest("a union or intersection needs at least one field")
    return reduce(lambda f, g: MinMaxField(f, g, sign), map(as_field, fields))
