"""What a field is: a function f(points (..., 3)) -> (...) of model coordinates, f < 0 solid, with its exact gradient.

A kind of field says how it is computed once, on three coordinate arrays that broadcast: `at(x, y, z)` for values, `jet(x, y, z)`
for values and the three partial derivatives. On points the three arrays are columns; on a grid they have shapes (nx, 1, 1),
(1, ny, 1) and (1, 1, nz), so that what depends on one coordinate is computed once per plane. Only elementwise operations are
used, in one order, so the two routes give the same bits, and a point the same bits in whatever company it is evaluated.
(Foreign functions, see `function.py`, can't promise that.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import (
    FieldJet,
    Triple,
    as_grid_axes,
    copy_columns,
    flatten_points,
    grid_slabs,
    point_batches,
)

EVERY_TRANSLATION: Triple = (0.0, 0.0, 0.0)
"""Of a constant: unchanged by every translation."""


class Field:
    """Base of all fields. Call it with points (..., 3) for values (...); `gradient` gives (..., 3), outward from the solid.

    `+ - *` combine fields and numbers; `a | b`, `a & b` and `~a` are union, intersection and complement of the solids.
    """

    __slots__ = ()
    __array_ufunc__ = None
    """A NumPy number on the left of an operator leaves the operation to the field."""

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast against each other; the result may still have to be broadcast."""
        raise NotImplementedError

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value, df/dx, df/dy, df/dz at coordinates that broadcast; the value has the bits of `at`."""
        raise NotImplementedError

    def periods(self) -> Triple | None:
        """The translations (px, py, pz) along the axes that leave the field unchanged, where it has them."""
        return None

    def __call__(self, points: ArrayLike) -> Array:
        flat, shape = flatten_points(points)
        values = np.empty(len(flat))
        for part in point_batches(len(flat)):
            values[part] = self.at(*copy_columns(flat[part]))
        return values.reshape(shape)

    def gradient(self, points: ArrayLike) -> Array:
        """The exact gradient (..., 3); where two solids meet in an edge, that of one of them."""
        return self.value_and_gradient(points)[1]

    def value_and_gradient(self, points: ArrayLike) -> tuple[Array, Array]:
        """Values (...) and gradient (..., 3) in one pass."""
        flat, shape = flatten_points(points)
        values, slopes = np.empty(len(flat)), np.empty((len(flat), 3))
        for part in point_batches(len(flat)):
            values[part], slopes[part, 0], slopes[part, 1], slopes[part, 2] = self.jet(*copy_columns(flat[part]))
        return values.reshape(shape), slopes.reshape(*shape, 3)

    def on_grid(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
        """Values on the grid of all x with all y with all z: (nx, ny, nz), the same bits as on the grid's points."""
        axes = as_grid_axes(x, y, z)
        values = np.empty(tuple(len(axis) for axis in axes))
        for part, coordinates in grid_slabs(axes):
            values[part] = self.at(*coordinates)
        return values

    def value_and_gradient_on_grid(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
        """Values (nx, ny, nz) and gradient (nx, ny, nz, 3) on that grid."""
        axes = as_grid_axes(x, y, z)
        values = np.empty(tuple(len(axis) for axis in axes))
        slopes = np.empty((*values.shape, 3))
        for part, coordinates in grid_slabs(axes):
            values[part], slopes[part, ..., 0], slopes[part, ..., 1], slopes[part, ..., 2] = self.jet(*coordinates)
        return values, slopes

    def __add__(self, other: FieldLike) -> SumField:
        return SumField(self, as_field(other))

    def __radd__(self, other: FieldLike) -> SumField:
        return SumField(as_field(other), self)

    def __sub__(self, other: FieldLike) -> SumField:
        return SumField(self, -as_field(other))

    def __rsub__(self, other: FieldLike) -> SumField:
        return SumField(as_field(other), -self)

    def __mul__(self, other: FieldLike) -> Field:
        return multiply_fields(self, other)

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> Field:
        divisor = as_field(number)
        if getattr(divisor, "value", 0.0) == 0:
            raise InvalidRequest(f"a field can be divided by a number other than zero, not by {number!r}")
        return multiply_fields(self, 1.0 / float(number))

    def __neg__(self) -> Field:
        return multiply_fields(self, -1.0)

    __invert__ = __neg__

    def __or__(self, other: FieldLike) -> Field:
        return MinMaxField(self, as_field(other), -1)

    def __and__(self, other: FieldLike) -> Field:
        return MinMaxField(self, as_field(other), +1)


@dataclass(frozen=True, slots=True)
class ConstantField(Field):
    """The same value everywhere."""

    value: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return np.full((1,) * x.ndim, self.value)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        zero = np.zeros((1,) * x.ndim)
        return np.full((1,) * x.ndim, self.value), zero, zero, zero

    def periods(self) -> Triple | None:
        return EVERY_TRANSLATION


@dataclass(frozen=True, slots=True)
class BinaryField(Field):
    """A field of two others' values."""

    first: Field
    second: Field

    def periods(self) -> Triple | None:
        return common_periods(self.first, self.second)


@dataclass(frozen=True, slots=True)
class SumField(BinaryField):
    """first + second."""

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self.first.at(x, y, z) + self.second.at(x, y, z)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        f, fx, fy, fz = self.first.jet(x, y, z)
        g, gx, gy, gz = self.second.jet(x, y, z)
        return f + g, fx + gx, fy + gy, fz + gz


@dataclass(frozen=True, slots=True)
class ScaledField(Field):
    """factor times a field."""

    factor: float
    field: Field

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self.factor * self.field.at(x, y, z)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        f, fx, fy, fz = self.field.jet(x, y, z)
        c = self.factor
        return c * f, c * fx, c * fy, c * fz

    def periods(self) -> Triple | None:
        return self.field.periods()


@dataclass(frozen=True, slots=True)
class ProductField(BinaryField):
    """first times second."""

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self.first.at(x, y, z) * self.second.at(x, y, z)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        f, fx, fy, fz = self.first.jet(x, y, z)
        g, gx, gy, gz = self.second.jet(x, y, z)
        return f * g, fx * g + f * gx, fy * g + f * gy, fz * g + f * gz


@dataclass(frozen=True, slots=True)
class MinMaxField(BinaryField):
    """The greater (sign +1) or the lesser (sign -1) of two fields; gradient of the first where they are equal."""

    sign: int

    def at(self, x: Array, y: Array, z: Array) -> Array:
        f, g = self.first.at(x, y, z), self.second.at(x, y, z)
        return np.where(self.sign * f >= self.sign * g, f, g)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        f, g = self.first.jet(x, y, z), self.second.jet(x, y, z)
        keep = self.sign * f[0] >= self.sign * g[0]
        value, fx, fy, fz = (np.where(keep, a, b) for a, b in zip(f, g, strict=True))
        return value, fx, fy, fz


FieldLike = Field | float | Callable[[Array], Array]
"""What a field argument may be: a field, a number (constant field), or any function of points (..., 3)."""


def as_field(source: Any) -> Field:
    """A field from a field, a number or a function of points; see `from_function` for how functions are read."""
    if isinstance(source, Field):
        return source
    if callable(source):
        # a function is a kind of field, and so needs this module first
        from tpmscad.fields.function_field import from_function

        return from_function(source)
    return constant(source)


def constant(value: Any) -> ConstantField:
    """The field with one value everywhere."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InvalidRequest(
            f"{value!r} is no field: give a field, a number or a function of points (..., 3)"
        ) from None
    if not np.isfinite(number):
        raise InvalidRequest(f"a constant field needs a finite value, not {number}")
    return ConstantField(number)


def multiply_fields(field: Field, other: FieldLike) -> Field:
    """A field times a number or another field."""
    other = as_field(other)
    if not isinstance(other, ConstantField):
        return ProductField(field, other)
    if isinstance(field, ScaledField):
        return ScaledField(other.value * field.factor, field.field)
    if isinstance(field, ConstantField):
        return ConstantField(other.value * field.value)
    return ScaledField(other.value, field)


def common_periods(*fields: Field) -> Triple | None:
    """The periods that all the fields share, as they are stated (no common multiples are sought)."""
    found = EVERY_TRANSLATION
    for field in fields:
        periods = field.periods()
        if periods is None or (EVERY_TRANSLATION != found != periods != EVERY_TRANSLATION):
            return None
        found = periods if found == EVERY_TRANSLATION else found
    return found
