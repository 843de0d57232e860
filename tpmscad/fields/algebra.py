"""Constants, sums and products of fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Array, Field, FieldLike, Jet, Triple, as_field

ANY_PERIOD: Triple = (0.0, 0.0, 0.0)
"""Of a constant: unchanged by every translation."""


@dataclass(frozen=True, slots=True)
class Constant(Field):
    """The same value everywhere."""

    value: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return np.full((1,) * x.ndim, self.value)

    def jet(self, x: Array, y: Array, z: Array) -> Jet:
        zero = np.zeros((1,) * x.ndim)
        return np.full((1,) * x.ndim, self.value), zero, zero, zero

    def periods(self) -> Triple | None:
        return ANY_PERIOD


@dataclass(frozen=True, slots=True)
class Sum(Field):
    """first + second."""

    first: Field
    second: Field

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self.first.at(x, y, z) + self.second.at(x, y, z)

    def jet(self, x: Array, y: Array, z: Array) -> Jet:
        f, fx, fy, fz = self.first.jet(x, y, z)
        g, gx, gy, gz = self.second.jet(x, y, z)
        return f + g, fx + gx, fy + gy, fz + gz

    def periods(self) -> Triple | None:
        return common_periods(self.first, self.second)


@dataclass(frozen=True, slots=True)
class Scaled(Field):
    """factor times a field."""

    factor: float
    field: Field

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self.factor * self.field.at(x, y, z)

    def jet(self, x: Array, y: Array, z: Array) -> Jet:
        f, fx, fy, fz = self.field.jet(x, y, z)
        c = self.factor
        return c * f, c * fx, c * fy, c * fz

    def periods(self) -> Triple | None:
        return self.field.periods()


@dataclass(frozen=True, slots=True)
class Product(Field):
    """first times second."""

    first: Field
    second: Field

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self.first.at(x, y, z) * self.second.at(x, y, z)

    def jet(self, x: Array, y: Array, z: Array) -> Jet:
        f, fx, fy, fz = self.first.jet(x, y, z)
        g, gx, gy, gz = self.second.jet(x, y, z)
        return f * g, fx * g + f * gx, fy * g + f * gy, fz * g + f * gz

    def periods(self) -> Triple | None:
        return common_periods(self.first, self.second)


def constant(value: Any) -> Constant:
    """The field with one value everywhere."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InvalidRequest(
            f"{value!r} is no field: give a field, a number or a function of points (..., 3)"
        ) from None
    if not np.isfinite(number):
        raise InvalidRequest(f"a constant field needs a finite value, not {number}")
    return Constant(number)


def product(field: Field, other: FieldLike) -> Field:
    """A field times a number or another field."""
    other = as_field(other)
    if not isinstance(other, Constant):
        return Product(field, other)
    if isinstance(field, Scaled):
        return Scaled(other.value * field.factor, field.field)
    if isinstance(field, Constant):
        return Constant(other.value * field.value)
    return Scaled(other.value, field)


def common_periods(*fields: Field) -> Triple | None:
    """The periods that all the fields share, as they are stated (no common multiples are sought)."""
    found = ANY_PERIOD
    for field in fields:
        periods = field.periods()
        if periods is None or (ANY_PERIOD != found != periods != ANY_PERIOD):
            return None
        found = periods if found == ANY_PERIOD else found
    return found
