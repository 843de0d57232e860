"""Fields to grade with: coordinates, affine functions, and ramps between two values, for thresholds that vary in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import FieldJet, Triple, as_triple
from tpmscad.fields.field import Field, FieldLike, as_field
from tpmscad.fields.primitive_regions import Direction, HalfSpaceRegion, as_unit_vector


@dataclass(frozen=True, slots=True)
class AffineFunction(Field):
    """offset + slope . p."""

    slope: Triple
    offset: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        a, b, c = self.slope
        value = np.full((1,) * x.ndim, self.offset)
        for factor, t in zip((a, b, c), (x, y, z), strict=True):
            if factor != 0:
                value = value + factor * t
        return value

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        one = np.ones((1,) * x.ndim)
        return self.at(x, y, z), self.slope[0] * one, self.slope[1] * one, self.slope[2] * one


@dataclass(frozen=True, slots=True)
class RampField(Field):
    """From `low` where by <= start to `high` where by >= end, along t in between: t itself, or 10 t^3 - 15 t^4 + 6 t^5."""

    by: Field
    start: float
    end: float
    low: float
    high: float
    smooth: bool

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self._value(self.by.at(x, y, z))[0]

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        by, bx, by_, bz = self.by.jet(x, y, z)
        value, t = self._value(by)
        steep = 30.0 * (t * t) * ((1.0 - t) * (1.0 - t)) if self.smooth else ((t > 0) & (t < 1)).astype(float)
        rate = ((self.high - self.low) / (self.end - self.start)) * steep
        return value, rate * bx, rate * by_, rate * bz

    def _value(self, by: Array) -> tuple[Array, Array]:
        t = np.minimum(np.maximum((by - self.start) / (self.end - self.start), 0.0), 1.0)
        s = t * t * t * (10.0 + t * (6.0 * t - 15.0)) if self.smooth else t
        return (1.0 - s) * self.low + s * self.high, t


def linear(slope: Sequence[float], offset: float = 0.0) -> AffineFunction:
    """The affine function offset + slope . p."""
    return AffineFunction(as_triple(slope, "slope"), _as_finite(offset, "offset"))


def coordinate(axis: Direction, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> HalfSpaceRegion:
    """The distance from `origin` along an axis ("x", "y", "z" or a vector)."""
    return HalfSpaceRegion(as_triple(origin, "origin"), as_unit_vector(axis, "axis"))


def ramp(by: FieldLike | str, span: Sequence[float], values: Sequence[float], *, smooth: bool = True) -> RampField:
    """A field that goes from values[0] to values[1] while `by` goes from span[0] to span[1], and is constant beyond.

    by: any field (a coordinate, a distance), or "x", "y", "z". smooth: with two continuous derivatives; otherwise linear.
    """
    field = coordinate(by) if isinstance(by, str) else as_field(by)
    if len(span) != 2 or len(values) != 2:
        raise InvalidRequest(f"a ramp has a span of two numbers and two values, not {span!r} and {values!r}")
    start, end = (_as_finite(t, "span") for t in span)
    low, high = (_as_finite(c, "values") for c in values)
    if start == end:
        raise InvalidRequest(f"the span of a ramp is empty: it starts and ends at {start:g}")
    return RampField(field, start, end, low, high, smooth)


def _as_finite(value: float, name: str) -> float:
    number = float(value)
    if not np.isfinite(number):
        raise InvalidRequest(f"{name} {value!r} must be finite")
    return number
