"""Fields whose solids need no fit, moved, scaled, reversed and offset: planes, spheres, cylinders, struts and cores."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Self

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.field import ConstantField, Field, MinMaxField, ScaledField, SumField
from tpmscad.fields.kinds.beam_lattices import BeamsField
from tpmscad.fields.kinds.coordinate_transforms import AffineTransformedField
from tpmscad.fields.kinds.cores import CoreField
from tpmscad.fields.kinds.linear_extension import LinearExtension
from tpmscad.fields.kinds.primitive_regions import CylinderRegion, HalfSpaceRegion, SphereRegion
from tpmscad.fields.kinds.strut_graphs import StrutsField, change_struts
from tpmscad.fields.kinds.triangle_meshes import MeshField

SIMILARITY_RTOL = 1e-12
"""Relative difference of a matrix from a rotation times a factor, up to which it is one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ExactLeaf:
    """A solid given by a signed distance times `slope`, or its complement if `sign` is -1."""

    sign: int = 1
    slope: float = 1.0

    def offset(self, distance: float) -> Self | None:
        """The solid grown by a distance, or shrunk by a negative one; None if nothing is left of it."""
        raise NotImplementedError

    def move(self, rotation: Array, shift: Array, factor: float) -> Self:
        """The points p with factor * rotation @ p + shift in the solid."""
        raise NotImplementedError

    def scale_values(self, factor: float) -> Self:
        """The solid of the field times a factor other than zero."""
        return replace(self, sign=self.sign if factor > 0 else -self.sign, slope=self.slope * abs(factor))


@dataclass(frozen=True, slots=True, eq=False)
class QuadricLeaf(ExactLeaf):
    """The solid of a plane (in front of it is void), a sphere or an endless cylinder.

    point (3,): on the plane, the centre, or on the axis; axis (3,): the unit normal, zero, or the unit direction. radius: zero of
    a plane.
    """

    kind: str
    point: Array
    axis: Array
    radius: float

    def offset(self, distance: float) -> Self | None:
        """See `ExactLeaf`."""
        if self.kind == "plane":
            return replace(self, point=self.point + distance * self.axis)
        radius = self.radius + distance
        return replace(self, radius=radius) if radius > 0 else None

    def move(self, rotation: Array, shift: Array, factor: float) -> Self:
        """See `ExactLeaf`."""
        return replace(
            self,
            point=rotation.T @ (self.point - shift) / factor,
            axis=rotation.T @ self.axis,
            radius=self.radius / factor,
            slope=self.slope * factor,
        )


@dataclass(frozen=True, slots=True, eq=False)
class StrutLeaf(ExactLeaf):
    """The solid of struts on a graph."""

    struts: StrutsField

    def offset(self, distance: float) -> Self | None:
        """See `ExactLeaf`."""
        if float(self.struts.radii.min()) + distance <= 0:
            return None
        return replace(self, struts=change_struts(self.struts, distance=distance))

    def move(self, rotation: Array, shift: Array, factor: float) -> Self:
        """See `ExactLeaf`."""
        back = tuple(map(tuple, (rotation.T / factor).tolist()))
        moved = change_struts(self.struts, back, tuple((-rotation.T @ shift / factor).tolist()), 1.0 / factor)
        return replace(self, struts=moved, slope=self.slope * factor)


@dataclass(frozen=True, slots=True, eq=False)
class CoreLeaf(ExactLeaf):
    """The walls of a core."""

    core: CoreField

    def offset(self, distance: float) -> Self | None:
        """See `ExactLeaf`."""
        thicker = self.core.thicken(2 * distance)
        return None if thicker is None else replace(self, core=thicker)

    def move(self, rotation: Array, shift: Array, factor: float) -> Self:
        """See `ExactLeaf`."""
        return replace(self, core=self.core.move(rotation, shift, factor), slope=self.slope * factor)


NetworkLeaf = StrutLeaf | CoreLeaf
"""Exact solids of many faces that meet."""

Exact = QuadricLeaf | NetworkLeaf


def find_quadric(field: Field) -> QuadricLeaf | None:
    """The plane, sphere or cylinder of a field, None if it is something else."""
    found = find_exact(field)
    return found if isinstance(found, QuadricLeaf) else None


@singledispatch
def find_exact(field: Field) -> Exact | None:
    """The exact solid of a field, None if it is no signed distance of one times a factor."""
    return None


@find_exact.register
def _(field: HalfSpaceRegion) -> Exact | None:
    return QuadricLeaf("plane", np.array(field.point), np.array(field.normal), 0.0)


@find_exact.register
def _(field: SphereRegion) -> Exact | None:
    return QuadricLeaf("sphere", np.array(field.center), np.zeros(3), field.radius)


@find_exact.register
def _(field: CylinderRegion) -> Exact | None:
    if field.height is not None:
        return None
    return QuadricLeaf("cylinder", np.array(field.center), np.array(field.axis), field.radius)


@find_exact.register
def _(field: StrutsField) -> Exact | None:
    return StrutLeaf(field)


@find_exact.register
def _(field: BeamsField) -> Exact | None:
    return find_exact(field.field)


@find_exact.register
def _(field: CoreField) -> Exact | None:
    return CoreLeaf(field)


@find_exact.register
def _(field: ScaledField) -> Exact | None:
    found = find_exact(field.field)
    return None if found is None or field.factor == 0 else found.scale_values(field.factor)


@find_exact.register
def _(field: LinearExtension) -> Exact | None:
    return find_exact(field.field)  # the same within the box


@find_exact.register
def _(field: SumField) -> Exact | None:
    for part, other in ((field.first, field.second), (field.second, field.first)):
        found = find_exact(part)
        if found is not None and isinstance(other, ConstantField):
            return found.offset(-found.sign * other.value / found.slope)
    return None


@find_exact.register
def _(field: AffineTransformedField) -> Exact | None:
    found, matrix = find_exact(field.field), np.array(field.matrix)
    factor = float(np.cbrt(abs(np.linalg.det(matrix))))
    if found is None or factor == 0 or field.factor == 0:
        return None
    rotation = matrix / factor
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > SIMILARITY_RTOL:
        return None
    return found.move(rotation, np.array(field.shift), factor).scale_values(field.factor)


def is_of_struts(field: Field) -> bool:
    """Whether a field is of struts and triangle meshes alone, combined and complemented; struts may be moved."""
    match field:
        case MeshField():
            return True
        case MinMaxField(first, second):
            return is_of_struts(first) and is_of_struts(second)
        case BeamsField(inner):
            return is_of_struts(inner)
    return isinstance(find_exact(field), StrutLeaf) or (isinstance(field, ScaledField) and is_of_struts(field.field))
