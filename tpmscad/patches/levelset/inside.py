"""A field as a box sees it: inside the field's own values, beyond the faces their continuation along the slope at the face.

What is fitted at a face of the box is evaluated a little beyond it, too, and there a field may be another altogether: a blended
field's blending region often ends at the very face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.fields.field import Extreme, Field
from tpmscad.fields.points import Array, Jet, Triple


@dataclass(frozen=True, slots=True)
class Inside(Field):
    """`field` in the box from `lo` to `hi`, continued linearly beyond."""

    field: Field
    lo: Triple
    hi: Triple

    def at(self, x: Array, y: Array, z: Array) -> Array:
        near = [np.clip(t, low, high) for t, low, high in zip((x, y, z), self.lo, self.hi, strict=True)]
        if all((n == t).all() for n, t in zip(near, (x, y, z), strict=True)):
            return self.field.at(x, y, z)
        return self.jet(x, y, z)[0]

    def jet(self, x: Array, y: Array, z: Array) -> Jet:
        near = [np.clip(t, low, high) for t, low, high in zip((x, y, z), self.lo, self.hi, strict=True)]
        value, fx, fy, fz = self.field.jet(*near)
        beyond = [t - n for t, n in zip((x, y, z), near, strict=True)]
        if any(b.any() for b in beyond):
            value = value + fx * beyond[0] + fy * beyond[1] + fz * beyond[2]
        return value, fx, fy, fz

    def periods(self) -> Triple | None:
        return self.field.periods()


def inside(field: Field, lo: Array, hi: Array) -> Inside:
    """`field` as the box [lo, hi] sees it."""
    return Inside(field, tuple(map(float, lo)), tuple(map(float, hi)))  # type: ignore[arg-type]


def continued(field: Field, lo: Array, hi: Array) -> Field:
    """`field` as the box [lo, hi] sees it, each level set by itself where it is made of several; periodic ones as they are."""
    if isinstance(field, Extreme):
        return Extreme(continued(field.first, lo, hi), continued(field.second, lo, hi), field.sign)
    return field if field.periods() is not None else inside(field, lo, hi)
