"""Signed distance to a level set, and walls of constant or graded thickness round it.

The foot point F of a point X on the level set {phi = 0} satisfies phi(F) = 0 and (X - F) parallel to grad phi(F); the distance is
|X - F|, with the sign of phi, and its gradient is the unit normal at F. Foot points are found in two stages, of which every step
is elementwise, so that the value of a point does not depend on the other points of the call:

1. steps of Newton's method for phi = 0 along the gradient, halved while |phi| does not fall;
2. Newton's method for the foot point: one step to the level set along the normal, and one step in the tangent plane for the
   least distance, with the second fundamental form from differences of the gradient. A form with eigenvalues that are not
   positive, beyond the centres of curvature, is replaced by its absolute value, so that the distance decreases.

Near the level set this is the distance to it. Farther off than the radii of curvature it is the distance to one of the foot
points, not necessarily the nearest, and jumps where that changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FIELD, FUNCTION, POSITIVE
from tpmscad.fields.field import Field, FieldLike, UnaryField, as_field
from tpmscad.fields.kinds.foot_point_search import search_foot_points
from tpmscad.fields.kinds.thresholds import sheet
from tpmscad.fields.tape.evaluation import FieldJet, stack_points

STEPS_PER_PERIOD = 24.0
"""The longest step of a periodic field is its least period over this number."""


@dataclass(frozen=True, slots=True)
class NormalDistance(UnaryField):
    """Signed distance to {field = 0} along its normal."""

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        return self.jet(x, y, z)[0]

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        points, shape = stack_points(x, y, z)
        value, nx, ny, nz = (each.reshape(shape) for each in signed_distances(self.field, points.T))
        return value, nx, ny, nz


@validate_call()
def normal_distance(phi: Annotated[FieldLike, FIELD, "The field; its level set {phi = 0} is the reference."]) -> Field:
    """Return the signed distance to the level set of a field.

    Returns
    -------
    Field
        The distance in model units, negative where phi is negative; its gradient is the unit normal at the foot point.

    Notes
    -----
    Exact up to the radii of curvature of the level set. Beyond them it is the distance to one of the foot points.

    Examples
    --------
    >>> from tpmscad import fields
    >>> ellipsoid = fields.from_function(lambda x, y, z: x**2 + y**2 + 4 * z**2 - 1)
    >>> round(float(fields.normal_distance(ellipsoid)((0.0, 0.0, 1.0))), 12)
    0.5
    """
    return NormalDistance(as_field(phi))


@validate_call()
def wall(
    phi: Annotated[
        FieldLike, FIELD, 'The field, for example `fields.tpms("lidinoid")`; the wall is centred on {phi = 0}.'
    ],
    thickness: Annotated[
        FieldLike,
        POSITIVE.or_else(FUNCTION),
        "Thickness along the normal, model units. A field grades the wall: a point is solid if it is nearer to {phi = "
        "0} than half the thickness there.",
    ],
) -> Field:
    """Return the wall of a thickness round the level set of a field.

    Returns
    -------
    Field
        max(d - thickness / 2, -d - thickness / 2) with the signed distance d.

    Notes
    -----
    A wall is smooth as long as half its thickness stays below the radii of curvature of {phi = 0}; beyond them its sides have
    edges, at which `tpmscad.solidify` stops with the place.

    Examples
    --------
    >>> from tpmscad import fields
    >>> wall = fields.wall(fields.tpms("lidinoid", 10.0), 0.4)
    >>> bool(wall((0.0, 0.0, 0.0)) > 0)
    True
    """
    half = 0.5 * as_field(thickness)
    return sheet(NormalDistance(as_field(phi)), -half, half)


def signed_distances(field: Field, columns: Array) -> Array:
    """Signed distances to the level set and normals at the foot points, (4, n), of points given as columns (3, n)."""
    unit, longest = _length_scale(field, columns)
    return search_foot_points(field.tape.evaluator(True).at_points, columns, unit, longest)


def _length_scale(field: Field, columns: Array) -> tuple[Array, Array]:
    """The unit of length (n,) at each point and the longest step (n,): from the periods, or from the coordinates."""
    periods, shape = field.periods(), columns.shape[1:]
    if periods is not None and min(periods) > 0:
        return np.full(shape, min(periods)), np.full(shape, min(periods) / STEPS_PER_PERIOD)
    return 1.0 + np.abs(columns).max(axis=0), np.full(shape, np.inf)
