"""Bounds on the gradients of fields in a box: with |grad f| <= L there, f keeps its sign within |f(p)| / L of a point p.

Signed distances have unit slope, which their formulas do not show: the derivative by a radius has no enclosure where the radius
vanishes. The gradients of other fields are enclosed over the box (`fields.tape.tape_enclosures`).
"""

from __future__ import annotations

import math

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.field import ConstantField, Field, MinMaxField, ScaledField, SumField
from tpmscad.fields.kinds.beam_lattices import BeamsField
from tpmscad.fields.kinds.coordinate_transforms import AffineTransformedField
from tpmscad.fields.kinds.cores import CoreField
from tpmscad.fields.kinds.primitive_regions import BoxRegion, CylinderRegion, HalfSpaceRegion, SphereRegion
from tpmscad.fields.kinds.ramps import ClippedField, RampField
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.fields.tape.tape_enclosures import TapeEnclosures

SIGNED_DISTANCES = (BoxRegion, CoreField, CylinderRegion, HalfSpaceRegion, SphereRegion, StrutsField)
"""Kinds with slope one."""

SMOOTH_STEP_SLOPE = 1.875
"""The greatest slope of 10 t^3 - 15 t^4 + 6 t^5, at t = 1/2."""


def bound_slope(field: Field, lo: Array, hi: Array) -> float:
    """A bound on the length of a field's gradient in the box [lo, hi], per model unit; infinite if none is known."""
    match field:
        case ConstantField():
            return 0.0
        case ScaledField(inner, factor):
            return abs(factor) * bound_slope(inner, lo, hi)
        case SumField(first, second):
            return bound_slope(first, lo, hi) + bound_slope(second, lo, hi)
        case MinMaxField(first, second):
            return max(bound_slope(first, lo, hi), bound_slope(second, lo, hi))
        case ClippedField(inner) | BeamsField(inner):
            return bound_slope(inner, lo, hi)
        case RampField(parameter, start, end, low, high, smooth):
            steepness = abs((high - low) / (end - start)) * (SMOOTH_STEP_SLOPE if smooth else 1.0)
            return steepness * bound_slope(parameter, lo, hi)
        case AffineTransformedField(inner, rows, shift, factor):
            matrix, middle, reach = np.array(rows), 0.5 * (lo + hi), 0.5 * (hi - lo)
            centre, reach = matrix @ middle + shift, np.abs(matrix) @ reach
            stretch = abs(factor) * float(np.linalg.norm(matrix, 2))
            return stretch * bound_slope(inner, centre - reach, centre + reach)
    if isinstance(field, SIGNED_DISTANCES):
        return 1.0
    found = TapeEnclosures(field.tape).enclose(lo[None], hi[None], True)
    if found.may_jump.any():
        return math.inf
    return float(np.linalg.norm(np.maximum(*map(np.abs, found.gradient_ranges))))
