"""Bounds on the gradients of fields: with |grad f| <= L everywhere, f keeps its sign within |f(p)| / L of a point p.

They follow from the structure of a formula by the rules of differentiation, with bounds on the values of its parts: signed
distances have unit slope, and a trigonometric polynomial is bounded by the sum of its terms, which for the nodal surfaces of the
catalogue is 1.5 to 4 times the greatest slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.field import ConstantField, Field, MinMaxField, PowerField, ProductField, ScaledField, SumField
from tpmscad.fields.kinds.coordinate_transforms import AffineTransformedField
from tpmscad.fields.kinds.expressions import ExpressionField, FunctionOfField
from tpmscad.fields.kinds.nodal_field import FORMULAS, NodalField
from tpmscad.fields.kinds.primitive_regions import BoxRegion, CylinderRegion, HalfSpaceRegion, SphereRegion
from tpmscad.fields.kinds.ramps import AffineFunction, ClippedField, RampField
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.minimal_series import expand_series

SMOOTH_STEP_SLOPE = 1.875
"""Greatest derivative of 10 t^3 - 15 t^4 + 6 t^5 in [0, 1], at t = 1/2."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldBounds:
    """Bounds in all of space on |f|, on |grad f|, and on the partial derivatives of f (3,); infinite where none is known."""

    size: float
    slope: float
    rates: Array


UNKNOWN = FieldBounds(math.inf, math.inf, np.full(3, math.inf))


def bound_slope(field: Field) -> float:
    """A bound on the length of a field's gradient in all of space, per model unit; infinite if none is known."""
    found = bound_field(field)
    return min(found.slope, float(np.linalg.norm(found.rates)))


@singledispatch
def bound_field(field: Field) -> FieldBounds:
    """The bounds of a field, by its structure."""
    return UNKNOWN


@bound_field.register(BoxRegion)
@bound_field.register(CylinderRegion)
@bound_field.register(HalfSpaceRegion)
@bound_field.register(SphereRegion)
@bound_field.register(StrutsField)
def _(field: Field) -> FieldBounds:
    return FieldBounds(math.inf, 1.0, np.ones(3))  # signed distances


@bound_field.register
def _(field: ConstantField) -> FieldBounds:
    return FieldBounds(abs(field.value), 0.0, np.zeros(3))


@bound_field.register
def _(field: AffineFunction) -> FieldBounds:
    return FieldBounds(math.inf, float(np.linalg.norm(field.slope)), np.abs(field.slope))


@bound_field.register
def _(field: FunctionOfField) -> FieldBounds:
    inner = bound_field(field.argument)
    return FieldBounds(1.0, inner.slope, inner.rates) if field.name in ("sin", "cos") else UNKNOWN


@bound_field.register
def _(field: ExpressionField) -> FieldBounds:
    return bound_field(field.tree)


@bound_field.register
def _(field: NodalField) -> FieldBounds:
    inner = bound_field(FORMULAS[field.name]) if field.reference == "nodal" else _bound_series(field.name)
    scale = 2 * math.pi / np.array(field.period)
    return FieldBounds(inner.size, inner.slope * float(scale.max()), inner.rates * scale)


def _bound_series(name: str) -> FieldBounds:
    """The bounds of a minimal surface's series as a function of the angles: sums over its waves."""
    vectors, amplitudes = expand_series(name)
    sizes = np.abs(amplitudes)
    return FieldBounds(float(sizes.sum()), float(sizes @ np.linalg.norm(vectors, axis=1)), sizes @ np.abs(vectors))


@bound_field.register
def _(field: RampField) -> FieldBounds:
    inner = bound_field(field.parameter)
    rise = abs(field.high - field.low) / abs(field.end - field.start) * (SMOOTH_STEP_SLOPE if field.smooth else 1.0)
    return FieldBounds(max(abs(field.low), abs(field.high)), *_scale(inner, rise))


@bound_field.register
def _(field: ClippedField) -> FieldBounds:
    inner = bound_field(field.field)
    return FieldBounds(max(abs(field.low), abs(field.high)), inner.slope, inner.rates)


@bound_field.register
def _(field: ScaledField) -> FieldBounds:
    inner = bound_field(field.field)
    return FieldBounds(_multiply(abs(field.factor), inner.size), *_scale(inner, abs(field.factor)))


@bound_field.register
def _(field: SumField) -> FieldBounds:
    f, g = bound_field(field.first), bound_field(field.second)
    return FieldBounds(f.size + g.size, f.slope + g.slope, f.rates + g.rates)


@bound_field.register
def _(field: ProductField) -> FieldBounds:
    f, g = bound_field(field.first), bound_field(field.second)
    (slope, rates), (other_slope, other_rates) = _scale(f, g.size), _scale(g, f.size)
    return FieldBounds(_multiply(f.size, g.size), slope + other_slope, rates + other_rates)


@bound_field.register
def _(field: PowerField) -> FieldBounds:
    inner = bound_field(field.field)
    return FieldBounds(inner.size**field.exponent, *_scale(inner, field.exponent * inner.size ** (field.exponent - 1)))


@bound_field.register
def _(field: MinMaxField) -> FieldBounds:
    f, g = bound_field(field.first), bound_field(field.second)
    return FieldBounds(max(f.size, g.size), max(f.slope, g.slope), np.maximum(f.rates, g.rates))


@bound_field.register
def _(field: AffineTransformedField) -> FieldBounds:
    inner, matrix, factor = bound_field(field.field), np.array(field.matrix), abs(field.factor)
    if not np.isfinite(inner.slope):
        return UNKNOWN
    stretch = factor * float(np.linalg.norm(matrix, 2))
    return FieldBounds(_multiply(factor, inner.size), stretch * inner.slope, factor * np.abs(matrix).T @ inner.rates)


def _multiply(first: float, second: float) -> float:
    """The product of two bounds; zero times infinity is zero."""
    return first * second if first and second else 0.0


def _scale(bounds: FieldBounds, factor: float) -> tuple[float, Array]:
    """The slope and the rates times a factor."""
    return _multiply(bounds.slope, factor), np.array([_multiply(float(rate), factor) for rate in bounds.rates])
