"""A field inside a box, extended linearly beyond the faces of the box.

A fit at a face of the box also evaluates the field slightly outside. There the field may differ entirely, for example where the
blending region of a blended field ends at the face. The extension continues the values along the gradient at the face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.evaluation import FieldJet, Triple
from tpmscad.fields.field import Field, MinMaxField

DIFFERENCE_STEP_FRACTION = 1e-4
"""Step of the differences for second derivatives at a face, as a fraction of the distance beyond the face."""


@dataclass(frozen=True, slots=True)
class LinearExtension(Field):
    """`field` inside [lo, hi], extended linearly outside; `jet` gives the gradient of the extended field."""

    field: Field
    lo: Triple
    hi: Triple

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        clamped = self._clamp(x, y, z)
        if all((n == t).all() for n, t in zip(clamped, (x, y, z), strict=True)):
            return self.field.at(x, y, z)
        value, *gradient = self.field.jet(*clamped)
        return value + sum(s * (t - n) for s, t, n in zip(gradient, (x, y, z), clamped, strict=True))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        clamped = self._clamp(x, y, z)
        value, *gradient = self.field.jet(*clamped)
        beyond = np.broadcast_arrays(*(t - n for t, n in zip((x, y, z), clamped, strict=True)))
        outside = (beyond[0] != 0) | (beyond[1] != 0) | (beyond[2] != 0)
        if outside.any():
            b = [each[outside] for each in beyond]
            foot = [np.broadcast_to(n, outside.shape)[outside] for n in clamped]
            before = self.field.jet(*(n - DIFFERENCE_STEP_FRACTION * each for n, each in zip(foot, b, strict=True)))[1:]
            value, gradient = (
                np.broadcast_to(value, outside.shape).copy(),
                [np.broadcast_to(s, outside.shape).copy() for s in gradient],
            )
            value[outside] += sum(s[outside] * each for s, each in zip(gradient, b, strict=True))
            for axis in range(3):
                # the tangential derivatives of the extension change by the field's mixed second derivatives
                change = (gradient[axis][outside] - before[axis]) / DIFFERENCE_STEP_FRACTION
                gradient[axis][outside] += np.where(b[axis] != 0, 0.0, change)
        return value, gradient[0], gradient[1], gradient[2]

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        return self.field.periods()

    def _clamp(self, *coordinates: Array) -> list[Array]:
        """Coordinates clamped to the box."""
        return [np.clip(t, low, high) for t, low, high in zip(coordinates, self.lo, self.hi, strict=True)]


def extend_linearly(field: Field, lo: Array, hi: Array) -> LinearExtension:
    """`field` inside the box [lo, hi], extended linearly outside."""
    return LinearExtension(field, tuple(map(float, lo)), tuple(map(float, hi)))  # type: ignore[arg-type]


def extend_level_sets_linearly(field: Field, lo: Array, hi: Array) -> Field:
    """Each level set of a minimum or maximum extended linearly by itself; periodic fields are returned as they are."""
    if isinstance(field, MinMaxField):
        return MinMaxField(
            extend_level_sets_linearly(field.first, lo, hi),
            extend_level_sets_linearly(field.second, lo, hi),
            field.sign,
        )
    return field if field.periods() is not None else extend_linearly(field, lo, hi)
