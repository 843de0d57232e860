"""Fields: functions f(points (..., 3)) -> (...) of model coordinates with their exact gradient; f < 0 is solid.

A class of fields states its formula once, in `trace(x, y, z)`, on the nodes of a tape (`tape_nodes.py`); values, exact gradients,
and their compiled evaluation on points and grids follow from it (`field_tape.py`). What no tape can hold, a function of the user
or an iteration, implements `at(x, y, z)` for values and `jet(x, y, z)` for values and the three partial derivatives, on
coordinate arrays that broadcast; it is an input of the tapes that use it. Only elementwise operations in a fixed order are used:
points and grids give the same bits, and the value of a point does not depend on the other points of the call. Foreign functions
(`FunctionField`) cannot guarantee this.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array, BoxCorners
from tpmscad.api.public_calls import call_for_array, validate_call
from tpmscad.api.shared_kinds import BOX, FIELD, FUNCTION, FUNCTION_OF_POINTS_OR_XYZ, NUMBER, POSITIVE
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data_box import DataBox
from tpmscad.fields.tape.evaluation import FieldEvaluation, FieldJet, Triple, is_grid, stack_points
from tpmscad.fields.tape.function_calls import (
    DIFFERENCE_STEP,
    PROBE_POINTS,
    DerivativeCheck,
    call_for_gradient,
    call_for_values,
    central_differences,
    check_finite,
    check_vectorised,
    describe_function,
    detect_coordinate_arguments,
)
from tpmscad.fields.tape.tape_nodes import Node, choose_extreme, power

EVERY_TRANSLATION: Triple = (0.0, 0.0, 0.0)
"""Periods of a constant field, which every translation leaves unchanged."""


class Field(FieldEvaluation):
    """Base class of all fields: f(points (..., 3)) -> (...), negative in the solid.

    `+ - *` combine fields and numbers, `field**2` is a power; `a | b`, `a & b` and `~a` are the union, intersection and
    complement of the solids.
    """

    __slots__ = ()
    __array_ufunc__ = None
    """Makes a NumPy number on the left of an operator leave the operation to the field."""

    def data_box(self) -> DataBox | None:
        """The box of the samples of a field that is made of data alone, moved or not; None of other fields."""
        return None

    @property
    def domain(self) -> BoxCorners | None:
        """A box that holds the solid of fields of data, ((x0, y0, z0), (x1, y1, z1)), model units; None of others.

        Data that are moved, or combined with other fields, are empty beyond the box of their samples, which this one holds.
        """
        box = self.data_box()
        return None if box is None else box.domain

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
            raise InvalidRequest(f"a field can be divided only by a number other than zero, not by {number!r}")
        return multiply_fields(self, 1.0 / float(number))

    def __pow__(self, exponent: Any) -> PowerField:
        if not isinstance(exponent, Integral) or int(exponent) < 1:  # others are limited to part of space
            raise InvalidRequest(
                f"a field takes whole powers from 1 on, not {exponent!r}: for others write fields.expression('f^0.5', f=field), "
                "which says where a value is not finite"
            )
        return PowerField(self, float(exponent))

    def __neg__(self) -> Field:
        return multiply_fields(self, -1.0)

    __invert__ = __neg__

    def __or__(self, other: FieldLike) -> Field:
        return MinMaxField(self, as_field(other), -1)

    def __and__(self, other: FieldLike) -> Field:
        return MinMaxField(self, as_field(other), +1)


@dataclass(frozen=True, slots=True)
class ConstantField(Field):
    """A field with one value everywhere."""

    value: float

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return x.recorder.constant(self.value)

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        return EVERY_TRANSLATION


@dataclass(frozen=True, slots=True)
class UnaryField(Field):
    """Base class of fields with the periods of another."""

    field: Field

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        return self.field.periods()


@dataclass(frozen=True, slots=True)
class BinaryField(Field):
    """Base class of fields computed from the values of two others."""

    first: Field
    second: Field

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        return common_periods(self.first, self.second)


@dataclass(frozen=True, slots=True)
class SumField(BinaryField):
    """first + second."""

    def data_box(self) -> DataBox | None:
        """The box of data to which a constant is added."""
        parts = ((self.first, self.second), (self.second, self.first))
        return next((data.data_box() for data, other in parts if isinstance(other, ConstantField)), None)

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return self.first.trace(x, y, z) + self.second.trace(x, y, z)


@dataclass(frozen=True, slots=True)
class ScaledField(UnaryField):
    """factor * field."""

    factor: float

    def data_box(self) -> DataBox | None:
        """The box of data times a positive number; the complement of data has none."""
        return self.field.data_box() if self.factor > 0 else None

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return self.factor * self.field.trace(x, y, z)


@dataclass(frozen=True, slots=True)
class ProductField(BinaryField):
    """first * second."""

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return self.first.trace(x, y, z) * self.second.trace(x, y, z)


@dataclass(frozen=True, slots=True)
class PowerField(UnaryField):
    """A field to a constant power."""

    exponent: float

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return power(self.field.trace(x, y, z), self.exponent)


@dataclass(frozen=True, slots=True)
class MinMaxField(BinaryField):
    """Maximum (sign +1) or minimum (sign -1) of two fields; the gradient is that of the first where both are equal."""

    sign: int

    @property
    def domain(self) -> BoxCorners | None:
        """The box of the data of a union, if all of it are data, or of an intersection."""
        boxes = [domain for part in (self.first, self.second) if (domain := part.domain) is not None]
        if not boxes or (self.sign < 0 and len(boxes) < 2):
            return None
        low, high = np.array(boxes, float).transpose(1, 0, 2)
        first, last = (low.max(axis=0), high.min(axis=0)) if self.sign > 0 else (low.min(axis=0), high.max(axis=0))
        return tuple(first.tolist()), tuple(np.maximum(first, last).tolist())

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return choose_extreme(self.sign, self.first.trace(x, y, z), self.second.trace(x, y, z))


@dataclass(frozen=True, slots=True, eq=False)
class CompositeField(Field):
    """Base class of fields that select and mix the values of `structures`, whose edges are then edges of the solid."""

    structures: tuple[Field, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FunctionField(Field):
    """A foreign function of points (n, 3), or of x, y, z (n,) if `takes_coordinates`, and its gradient function or None.

    The `on_grid` method of a foreign object is used if it has one. Values that are not finite raise InvalidRequest.
    """

    function: Callable[..., Any]
    gradient_function: Callable[..., Any] | None
    takes_coordinates: bool
    step: float
    check: DerivativeCheck

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        points, shape = stack_points(x, y, z)
        on_grid = getattr(self.function, "on_grid", None)
        if on_grid is not None and is_grid(x, y, z):
            values = call_for_array(describe_function(self.function), on_grid, x.ravel(), y.ravel(), z.ravel())
        else:
            values = self._values(points)
        check_finite(self.function, values, points)
        return values.reshape(shape)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        points, shape = stack_points(x, y, z)
        value = self._values(points)
        check_finite(self.function, value, points)
        if self.gradient_function is None:
            gradients = central_differences(self._values, points, self.step)
        else:
            gradients = call_for_gradient(self.function, self.gradient_function, points, self.takes_coordinates)
            self.check.run(self._values, points, gradients, self.step)
        for axis in range(3):
            check_finite(self.function, gradients[:, axis], points)
        gx, gy, gz = (gradients[:, axis].reshape(shape) for axis in range(3))
        return value.reshape(shape), gx, gy, gz

    def _values(self, points: Array) -> Array:
        return call_for_values(self.function, points, self.takes_coordinates)


FieldLike = Field | float | Callable[[Array], Array]
"""What a field argument may be: a field, a number (constant field), or any function of points (..., 3)."""


@validate_call()
def as_field(
    source: Annotated[
        Any,
        FIELD,
        "Fields are returned as they are; a number gives a constant field; functions are read by `from_function`.",
    ],
) -> Field:
    """Return a field, a number or a function of points as a field.

    Returns
    -------
    Field
        The field.

    Raises
    ------
    InvalidRequest
        If the source is none of these, or the function is not vectorised.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.as_field(2.5)((1.0, 2.0, 3.0)))
    2.5
    """
    if isinstance(source, Field):
        return source
    return from_function(source) if callable(source) else constant(source)


@validate_call()
def constant(value: Annotated[float, NUMBER, "The value, finite."]) -> ConstantField:
    """Return the field with one value everywhere.

    Returns
    -------
    ConstantField
        The field.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.constant(0.3)((1.0, 2.0, 3.0)))
    0.3
    """
    return ConstantField(value)


@validate_call()
def from_function(
    f: Annotated[
        Callable[..., Any],
        FUNCTION_OF_POINTS_OR_XYZ,
        "f(points (n, 3)) -> (n,) or f(x, y, z) -> (n,); the signature, or else a trial, decides which.",
    ],
    gradient: Annotated[
        Callable[..., Any] | None,
        FUNCTION,
        "Called like f; returns (n, 3) or a tuple of three. By default the attribute `gradient` of f, or else central "
        "differences.",
    ] = None,
    *,
    step: Annotated[
        float,
        POSITIVE.described_as(example="0.001"),
        "Step of the central differences of fourth order, in model units; they need 12 calls of f.",
    ] = DIFFERENCE_STEP,
    domain: Annotated[Sequence[Sequence[float]], BOX, "Box in which f is tried at a few points."] = (
        (0.0, 0.0, 0.0),
        (1.0, 1.0, 1.0),
    ),
) -> Field:
    """Return the field of a vectorised function.

    Returns
    -------
    Field
        The field; f itself if it is a Field and no gradient is given.

    Raises
    ------
    InvalidRequest
        If f takes single points only or mixes the points of a call; on evaluation, if a value is not finite, or the gradient is
        not that of f at most points where differences show it.

    Notes
    -----
    For a wave of amplitude 1 and length L a derivative is off by about 330 step^4 / L^5 + 2e-16 / step.

    Examples
    --------
    >>> from tpmscad import fields
    >>> fields.from_function(lambda x, y, z: x**2 + y**2 + z**2 - 1)([[1.0, 2.0, 0.0]])
    array([4.])
    """
    if isinstance(f, Field) and gradient is None:
        return f
    low, high = np.array(domain)
    probes = low + PROBE_POINTS * (high - low)
    takes_coordinates = detect_coordinate_arguments(f, probes)
    check_vectorised(f, takes_coordinates, probes)
    given = gradient if gradient is not None else getattr(f, "gradient", None)
    check = DerivativeCheck(f"the gradient of {describe_function(f)}")
    return FunctionField(f, given, takes_coordinates, step, check)


def multiply_fields(field: Field, other: FieldLike) -> Field:
    """Product of a field with a number or another field; factors of constants are combined."""
    other = as_field(other)
    if not isinstance(other, ConstantField):
        return ProductField(field, other)
    if isinstance(field, ScaledField):
        return ScaledField(field.field, other.value * field.factor)
    if isinstance(field, ConstantField):
        return ConstantField(other.value * field.value)
    return ScaledField(field, other.value)


def common_periods(*fields: Field) -> Triple | None:
    """Periods that all fields share; common multiples of different periods are not sought."""
    found = EVERY_TRANSLATION
    for field in fields:
        periods = field.periods()
        if periods is None or (EVERY_TRANSLATION != found != periods != EVERY_TRANSLATION):
            return None
        found = periods if found == EVERY_TRANSLATION else found
    return found
