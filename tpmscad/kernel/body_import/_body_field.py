"""Signed distance to a CAD body as an implicit field.

Foot points on bodies of planes, quadrics and a few splines are found in arrays, some microseconds each; on others OCCT finds
them one at a time, in a quarter of a millisecond.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.TopoDS import TopoDS_Face, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import POSITIVE, SHAPE
from tpmscad.erosion.boundary_distance import BoundaryDistance
from tpmscad.errors import InvalidRequest, TpmscadError
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.sampled_data import SampledField, interpolate_samples
from tpmscad.fields.tape.evaluation import FieldJet, stack_points
from tpmscad.kernel.body_import.body_brep import read_free_form_body
from tpmscad.kernel.body_import.cad_body import CadBody, read_body
from tpmscad.kernel.measure.mass_properties import ELEMENTARY
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.kernel.measure.skin_depth import SkinDepth
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import faces_of

TABLE_MARGIN_SPACINGS = 2.0
"""Spacings by which a table of distances reaches beyond the body's box, so that the body's surface is interpolated well."""

MAX_TABLE_SAMPLES = 1_000_000
"""Samples of a table of distances: four minutes of foot points that the kernel finds."""

MAX_FREE_FORM_FACES = 16
"""Faces besides planes and quadrics of a body that is read into arrays: 71 patches of a fitted one took over a minute."""

DIFFERENCE_STEP = 1e-4
"""Model units. Closer to the surface than this, the gradient is a central difference with this step."""


@dataclass(frozen=True, slots=True, eq=False)
class BodyDistance(Field):
    """Signed distance to some or all faces of a solid, negative inside the solid.

    Points outside the box from `low` to `high` count as outside without classification. boundary: that of the whole solid in
    arrays, if it is known.
    """

    solid: TopoDS_Solid
    low: Array
    high: Array
    faces: tuple[TopoDS_Face, ...]
    boundary: BoundaryDistance | None = None

    @classmethod
    def of(cls, body: CadBody) -> BodyDistance:
        """The distance from all faces of a body."""
        faces, boundary = tuple(faces_of(body.shape)), None
        if sum(BRepAdaptor_Surface(face, False).GetType() not in ELEMENTARY for face in faces) <= MAX_FREE_FORM_FACES:
            with suppress(TpmscadError):  # surfaces of other kinds, or gaps
                found = read_free_form_body(body.shape, accuracy=body.accuracy)
                boundary = BoundaryDistance.of(found.brep, found.free_form) if not found.notes else None
        return cls(body.shape, *body.box, faces, boundary)

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Distance at the points (x, y, z), in model units."""
        points, shape = stack_points(x, y, z)
        return self._distances(points)[0].reshape(shape)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Distance and its gradient at the points (x, y, z)."""
        points, shape = stack_points(x, y, z)
        value, feet = self._distances(points)
        near = np.abs(value) < DIFFERENCE_STEP
        slopes = np.empty_like(points)
        slopes[~near] = (points - feet)[~near] / value[~near, None]
        if near.any():
            for axis in range(3):
                step = DIFFERENCE_STEP * np.eye(3)[axis]
                ahead, behind = (self._distances(points[near] + sign * step)[0] for sign in (1, -1))
                slopes[near, axis] = (ahead - behind) / (2 * DIFFERENCE_STEP)
        gx, gy, gz = (slopes[:, axis].reshape(shape) for axis in range(3))
        return value.reshape(shape), gx, gy, gz

    def _distances(self, points: Array) -> tuple[Array, Array]:
        """Signed distances (n,) and foot points (n, 3) of points (n, 3)."""
        find_feet = SkinDepth(self.solid, self.faces).find_feet if self.boundary is None else self.boundary.feet
        value, feet = find_feet(points)
        within = np.flatnonzero(((points > self.low) & (points < self.high)).all(axis=1))
        inside = within[contains_points(self.solid, points[within], value[within])]
        value[inside] = -value[inside]
        return value, feet


@validate_call()
def body_field(
    shape: Annotated[Any, SHAPE, "One valid, closed solid, in model units."],
    *,
    spacing: Annotated[
        float | None,
        POSITIVE,
        "If given, the distance is computed once on a grid of about this spacing, model units, over the body's box "
        "and two spacings around it, and interpolated by a cubic spline: cheap to evaluate, and smooth. By default "
        "every evaluation finds the exact distance.",
    ] = None,
) -> Field:
    """Signed distance to a CAD body as a field, negative inside.

    Returns
    -------
    Field
        Distance in model units, a `SampledField` or exact: some microseconds a point for planes, quadrics and a few splines,
        else about 0.25 ms.

    Raises
    ------
    InvalidRequest
        If `shape` does not hold exactly one solid, or the solid is open, invalid or inside out; or if the table would need more
        than a million samples.

    Notes
    -----
    The interpolated distance is exact at the samples. It rounds edges of the body and the ridges of the distance inside it over
    about one spacing, and is within a fraction of spacing^2 times the curvature elsewhere: good for grading, coarse for cutting.

    Examples
    --------
    >>> import build123d as bd
    >>> import tpmscad
    >>> field = tpmscad.body_field(bd.Box(2, 2, 2))
    >>> float(field([[0.0, 0.0, 0.0]])[0])
    -1.0
    """
    body = read_body(shape)
    exact = BodyDistance.of(body)
    return exact if spacing is None else _tabulate(exact, exact.low, exact.high, spacing)


def tabulate_face_distance(body: CadBody, face: TopoDS_Face, spacing: float) -> SampledField:
    """The distance to one face of a body, without a sign, as a spline over the body's box and two spacings around it."""
    low, high = enclosing_box(body.shape)
    nowhere = np.full(3, np.inf)  # no point is classified
    return _tabulate(BodyDistance(body.shape, nowhere, nowhere, (face,)), low, high, spacing)


def _tabulate(exact: BodyDistance, box_low: Array, box_high: Array, spacing: float) -> SampledField:
    """The distance interpolated on a grid that reaches TABLE_MARGIN_SPACINGS beyond the body's box."""
    low = box_low - TABLE_MARGIN_SPACINGS * spacing
    extent = box_high + TABLE_MARGIN_SPACINGS * spacing - low
    counts = np.ceil(extent / spacing) + 1
    if counts.prod() > MAX_TABLE_SAMPLES:
        remedy = float(np.cbrt(extent.prod() / MAX_TABLE_SAMPLES))
        raise InvalidRequest(
            f"a spacing of {spacing:g} needs {counts.prod():.3g} samples, more than {MAX_TABLE_SAMPLES}, at up to 0.25 ms each: "
            f"give at least {remedy:.3g}"
        )
    steps = extent / (counts - 1)
    axes = [a + s * np.arange(int(n)) for a, s, n in zip(low, steps, counts, strict=True)]
    return interpolate_samples(exact.on_grid(*axes), tuple(steps.tolist()), tuple(low.tolist()))
