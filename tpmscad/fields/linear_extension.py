"""A field as a box sees it: inside the field's own values, beyond the faces their continuation along the slope at the face.

What is fitted at a face of the box is evaluated a little beyond it, too, and there a field may be another altogether: a blended
field's blending region often ends at the very face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.evaluation import FieldJet, Triple
from tpmscad.fields.field import Field, MinMaxField

DIFFERENCE_STEP_FRACTION = 1e-4
"""Second derivatives at a face are differences over this part of the distance beyond it."""


@dataclass(frozen=True, slots=True)
class LinearExtension(Field):
    """`field` in the box from `lo` to `hi`, continued linearly beyond; its gradient is that of what it is."""

    field: Field
    lo: Triple
    hi: Triple

    def at(self, x: Array, y: Array, z: Array) -> Array:
        near = [np.clip(t, low, high) for t, low, high in zip((x, y, z), self.lo, self.hi, strict=True)]
        if all((n == t).all() for n, t in zip(near, (x, y, z), strict=True)):
            return self.field.at(x, y, z)
        value, *slope = self.field.jet(*near)
        return value + sum(s * (t - n) for s, t, n in zip(slope, (x, y, z), near, strict=True))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        near = [np.clip(t, low, high) for t, low, high in zip((x, y, z), self.lo, self.hi, strict=True)]
        value, *slope = self.field.jet(*near)
        beyond = np.broadcast_arrays(*(t - n for t, n in zip((x, y, z), near, strict=True)))
        out = (beyond[0] != 0) | (beyond[1] != 0) | (beyond[2] != 0)
        if out.any():
            b = [each[out] for each in beyond]
            at = [np.broadcast_to(n, out.shape)[out] for n in near]
            before = self.field.jet(*(n - DIFFERENCE_STEP_FRACTION * each for n, each in zip(at, b, strict=True)))[1:]
            value, slope = (
                np.broadcast_to(value, out.shape).copy(),
                [np.broadcast_to(s, out.shape).copy() for s in slope],
            )
            value[out] += sum(s[out] * each for s, each in zip(slope, b, strict=True))
            for axis in range(3):
                # along the face the slope goes on turning as it did before it, by the field's mixed second derivatives
                turned = (slope[axis][out] - before[axis]) / DIFFERENCE_STEP_FRACTION
                slope[axis][out] += np.where(b[axis] != 0, 0.0, turned)
        return value, slope[0], slope[1], slope[2]

    def periods(self) -> Triple | None:
        return self.field.periods()


def extend_linearly(field: Field, lo: Array, hi: Array) -> LinearExtension:
    """`field` as the box [lo, hi] sees it."""
    return LinearExtension(field, tuple(map(float, lo)), tuple(map(float, hi)))  # type: ignore[arg-type]


def extend_level_sets_linearly(field: Field, lo: Array, hi: Array) -> Field:
    """`field` as the box [lo, hi] sees it, each level set by itself where it is made of several; periodic ones as they are."""
    if isinstance(field, MinMaxField):
        return MinMaxField(
            extend_level_sets_linearly(field.first, lo, hi),
            extend_level_sets_linearly(field.second, lo, hi),
            field.sign,
        )
    return field if field.periods() is not None else extend_linearly(field, lo, hi)
