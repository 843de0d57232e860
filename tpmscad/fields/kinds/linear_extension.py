"""A field inside a box, extended linearly beyond the faces of the box.

A fit at a face of the box also evaluates the field slightly outside. There the field may differ entirely, for example where the
blending region of a blended field ends at the face. The extension continues the values along the gradient at the face.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from functools import reduce

from tpmscad._typing import Array
from tpmscad.fields.field import Field, MinMaxField, UnaryField
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_derivatives import differentiate
from tpmscad.fields.tape.tape_nodes import Node, clamp, select, sum_nodes

DIFFERENCE_STEP_FRACTION = 1e-4
"""Step of the differences for second derivatives at a face, as a fraction of the distance beyond the face."""


@dataclass(frozen=True, slots=True)
class LinearExtension(UnaryField):
    """`field` inside [lo, hi], extended linearly outside, with the gradient of the extended field."""

    lo: Triple
    hi: Triple

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        if isinstance(self.field, LinearExtension) and self._holds_box_of(self.field):
            # it is linear beyond this box already; derived from it, the extension would take nine times as many operations
            return self.field.trace(x, y, z)
        recorder, zero, point = x.recorder, x.recorder.constant(0.0), (x, y, z)
        clamped = [clamp(t, low, high) for t, low, high in zip(point, self.lo, self.hi, strict=True)]
        beyond = [t - n for t, n in zip(point, clamped, strict=True)]
        is_beyond = [(b > 0.0) | (b < 0.0) for b in beyond]
        is_outside = reduce(operator.or_, is_beyond)
        # inside the box, where it is used, the clamped point moves with the point
        inside = self.field.trace(
            *(recorder.with_gradient(n, (t,), lambda: (1.0,)) for n, t in zip(clamped, point, strict=True))
        )
        with recorder.where(is_outside):
            value, gradient = self._jet(clamped)
            value = sum_nodes([value, *(g * b for g, b in zip(gradient, beyond, strict=True))])

            def differentiate() -> list[Node]:
                step = DIFFERENCE_STEP_FRACTION
                before = self._jet([n - step * b for n, b in zip(clamped, beyond, strict=True)])[1]
                # the tangential derivatives of the extension change by the field's mixed second derivatives
                return [
                    g + select(is_off, zero, (g - h) / step)
                    for g, h, is_off in zip(gradient, before, is_beyond, strict=True)
                ]

            outside = recorder.with_gradient(value, point, differentiate)
        return select(is_outside, outside, inside)

    def _holds_box_of(self, other: LinearExtension) -> bool:
        """Whether the box of another extension lies in this one's."""
        return all(map(operator.le, self.lo, other.lo)) and all(map(operator.ge, self.hi, other.hi))

    def _jet(self, point: list[Node]) -> tuple[Node, list[Node]]:
        """Value and derivatives of the field at a point, by its coordinates."""
        recorder = point[0].recorder
        seeds = [recorder.with_gradient(t, (), tuple) for t in point]
        value = self.field.trace(*seeds)
        zero = recorder.constant(0.0)
        return value, [zero if p is None else p for p in differentiate(value, seeds)]


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
