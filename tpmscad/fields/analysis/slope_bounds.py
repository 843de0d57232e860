"""Bounds on the gradients of fields: with |grad f| <= L everywhere, f keeps its sign within |f(p)| / L of a point p."""

from __future__ import annotations

import math
from functools import singledispatch

import numpy as np

from tpmscad.fields.field import ConstantField, Field, MinMaxField, ScaledField, SumField
from tpmscad.fields.kinds.coordinate_transforms import AffineTransformedField
from tpmscad.fields.kinds.primitive_regions import BoxRegion, CylinderRegion, HalfSpaceRegion, SphereRegion


@singledispatch
def bound_slope(field: Field) -> float:
    """A bound on the length of a field's gradient in all of space, per model unit; infinite if none is known."""
    return math.inf


@bound_slope.register(BoxRegion)
@bound_slope.register(CylinderRegion)
@bound_slope.register(HalfSpaceRegion)
@bound_slope.register(SphereRegion)
def _(field: Field) -> float:
    return 1.0  # signed distances


@bound_slope.register
def _(field: ConstantField) -> float:
    return 0.0


@bound_slope.register
def _(field: ScaledField) -> float:
    return abs(field.factor) * bound_slope(field.field) if field.factor else 0.0


@bound_slope.register
def _(field: SumField) -> float:
    return bound_slope(field.first) + bound_slope(field.second)


@bound_slope.register
def _(field: MinMaxField) -> float:
    return max(bound_slope(field.first), bound_slope(field.second))


@bound_slope.register
def _(field: AffineTransformedField) -> float:
    return abs(field.factor) * float(np.linalg.norm(np.array(field.matrix), 2)) * bound_slope(field.field)
