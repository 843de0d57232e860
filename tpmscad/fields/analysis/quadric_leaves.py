"""Fields whose level set is a plane, a sphere or a cylinder, whatever they were scaled, moved or shifted by."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import singledispatch

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.field import ConstantField, Field, ScaledField, SumField
from tpmscad.fields.kinds.coordinate_transforms import AffineTransformedField
from tpmscad.fields.kinds.linear_extension import LinearExtension
from tpmscad.fields.kinds.primitive_regions import CylinderRegion, HalfSpaceRegion, SphereRegion

SIMILARITY_RTOL = 1e-12
"""Relative difference of a matrix from a rotation times a factor, up to which it is one."""


@dataclass(frozen=True, slots=True, eq=False)
class QuadricLeaf:
    """The solid of a plane (in front of it is void), a sphere or an endless cylinder, or its complement if `sign` is -1.

    point (3,): on the plane, the centre, or on the axis; axis (3,): the unit normal, zero, or the unit direction. radius: zero of
    a plane. slope: of the field, per model unit, from which the radius follows when a constant is added.
    """

    kind: str
    point: Array
    axis: Array
    radius: float
    sign: int
    slope: float


@singledispatch
def find_quadric(field: Field) -> QuadricLeaf | None:
    """The quadric of a field, None if it is no signed distance of one times a factor."""
    return None


@find_quadric.register
def _(field: HalfSpaceRegion) -> QuadricLeaf | None:
    return QuadricLeaf("plane", np.array(field.point), np.array(field.normal), 0.0, 1, 1.0)


@find_quadric.register
def _(field: SphereRegion) -> QuadricLeaf | None:
    return QuadricLeaf("sphere", np.array(field.center), np.zeros(3), field.radius, 1, 1.0)


@find_quadric.register
def _(field: CylinderRegion) -> QuadricLeaf | None:
    if field.height is not None:
        return None
    return QuadricLeaf("cylinder", np.array(field.center), np.array(field.axis), field.radius, 1, 1.0)


@find_quadric.register
def _(field: ScaledField) -> QuadricLeaf | None:
    found = find_quadric(field.field)
    return None if found is None or field.factor == 0 else _scale(found, field.factor)


@find_quadric.register
def _(field: LinearExtension) -> QuadricLeaf | None:
    return find_quadric(field.field)  # the same within the box


@find_quadric.register
def _(field: SumField) -> QuadricLeaf | None:
    for part, other in ((field.first, field.second), (field.second, field.first)):
        found = find_quadric(part)
        if found is None or not isinstance(other, ConstantField):
            continue
        outwards = found.sign * other.value / found.slope
        if found.kind == "plane":
            return replace(found, point=found.point - outwards * found.axis)
        radius = found.radius - outwards
        return replace(found, radius=radius) if radius > 0 else None
    return None


@find_quadric.register
def _(field: AffineTransformedField) -> QuadricLeaf | None:
    found, matrix = find_quadric(field.field), np.array(field.matrix)
    factor = float(np.cbrt(abs(np.linalg.det(matrix))))
    if found is None or factor == 0 or field.factor == 0:
        return None
    rotation = matrix / factor
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > SIMILARITY_RTOL:
        return None
    moved = replace(
        found,
        point=rotation.T @ (found.point - np.array(field.shift)) / factor,
        axis=rotation.T @ found.axis,
        radius=found.radius / factor,
        slope=found.slope * factor,
    )
    return _scale(moved, field.factor)


def _scale(found: QuadricLeaf, factor: float) -> QuadricLeaf:
    """The quadric of a field times a factor."""
    return replace(found, sign=found.sign if factor > 0 else -found.sign, slope=found.slope * abs(factor))
