"""Fields of sampled data: a 3-D array on a uniform grid (CT, topology optimisation, simulation) as a smooth function.

The samples are interpolated by the cubic tensor-product spline with not-a-knot ends, which reproduces cubic polynomials. Beyond
the outermost samples the end polynomial is continued along a coordinate that saturates smoothly half a spacing further out, so
that the field stays bounded and twice continuously differentiable everywhere.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from tpmscad._typing import Array, BoxCorners
from tpmscad.api.argument_kinds import POINT
from tpmscad.api.public_calls import read_value, validate_call
from tpmscad.api.shared_kinds import ARRAY_OR_PATH, LENGTHS, NUMBER, VALUES
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.image_files import read_image
from tpmscad.fields.field import Field
from tpmscad.fields.periods_and_directions import as_periods
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node, clamp, root, tensor_spline

MIN_SAMPLES = 4
"""Samples along an axis: a cubic spline with not-a-knot ends needs four."""

SATURATION_SPACINGS = 0.5
"""Spacings beyond the outermost samples at which the continued coordinate saturates."""


@dataclass(frozen=True, slots=True, eq=False)
class SampledField(Field):
    """Cubic spline through samples on a uniform grid.

    `coefficients` (nx + 2, ny + 2, nz + 2) belong to the centred cardinal B-splines of the samples and of one more on each side.
    """

    coefficients: Array
    spacing: Triple
    origin: Triple

    @property
    def domain(self) -> BoxCorners:
        """The box of the samples ((x0, y0, z0), (x1, y1, z1)), model units: the domain for `tpmscad.solidify`."""
        last = [o + s * (n - 3) for o, s, n in zip(self.origin, self.spacing, self.coefficients.shape, strict=True)]
        return self.origin, (last[0], last[1], last[2])

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        counts = self.coefficients.shape
        steps = [
            _saturate((t - first) / spacing, n - 3.0)
            for t, n, first, spacing in zip((x, y, z), counts, self.origin, self.spacing, strict=True)
        ]
        knots = [np.arange(-3.0, n + 1.0) for n in counts]
        return tensor_spline(knots, (3, 3, 3), self.coefficients, (steps[0], steps[1], steps[2]))

    def __repr__(self) -> str:
        shape = "x".join(str(n - 2) for n in self.coefficients.shape)
        digest = hashlib.sha256(self.coefficients.tobytes()).hexdigest()[:8]
        return f"SampledField({shape} samples {digest}, spacing={self.spacing}, origin={self.origin})"


@validate_call()
def sampled(
    values: Annotated[
        ArrayLike | str | os.PathLike[str],
        ARRAY_OR_PATH,
        "Sample (i, j, k) lies at origin + spacing * (i, j, k). At least four samples along each axis. Or the path of "
        "an image: ``.npy``, ``.vti``, ``.vtk``, ``.nrrd``, ``.nii`` or ``.nii.gz``; all but the first need the extra "
        "``tpmscad[images]``.",
    ],
    spacing: Annotated[
        float | Sequence[float] | None,
        LENGTHS,
        "Distance of neighbouring samples, model units. By default that of the file, or 1.",
    ] = None,
    origin: Annotated[
        Triple | None, POINT, "Position of the first sample, model units. By default that of the file, or the origin."
    ] = None,
    *,
    level: Annotated[
        float | None,
        NUMBER.described_as(example="0.0"),
        "If given, the field is `level` minus the data: the part whose data exceed the level is solid, as is usual "
        "for densities. Otherwise the field is the data, and negative data are solid.",
    ] = None,
) -> SampledField:
    """Return the smooth field through samples on a uniform grid.

    Returns
    -------
    SampledField
        The field, twice continuously differentiable, with exact gradient; its `domain` is the box of the samples.

    Raises
    ------
    InvalidRequest
        If the array does not have three dimensions of at least four samples each, a value is not finite, a spacing is not
        positive, or the file cannot be read.

    Notes
    -----
    A cubic spline follows the samples exactly, noise included. Smooth measured data first, for example with
    ``scipy.ndimage.gaussian_filter(values, 1)``.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import fields
    >>> x, y, z = np.mgrid[0:9, 0:9, 0:9] * 0.5
    >>> field = fields.sampled(x**2 + y - z, spacing=0.5)
    >>> bool(np.isclose(field((1.3, 2.1, 0.7)), 1.3**2 + 2.1 - 0.7))
    True
    """
    if isinstance(values, str | os.PathLike):
        image = read_image(values)
        values = read_value("values", VALUES, image.values)
        spacing = image.spacing if spacing is None else spacing
        origin = image.origin if origin is None else origin
    array = np.array(values, dtype=float)
    if min(array.shape) < MIN_SAMPLES:
        raise InvalidRequest(
            f"values of shape {array.shape}: give an array of three dimensions with at least {MIN_SAMPLES} samples along each"
        )
    if level is not None:
        least, most = array.min(), array.max()
        if not least < level < most:
            raise InvalidRequest(
                f"level {level:g} lies outside the data, which reach from {least:g} to {most:g}: give a level between these"
            )
        array = level - array
    steps = as_periods(1.0 if spacing is None else spacing)
    for axis in range(3):
        array = _spline_coefficients(array, axis)
    return SampledField(np.ascontiguousarray(array), steps, (0.0, 0.0, 0.0) if origin is None else origin)


def _spline_coefficients(samples: Array, axis: int) -> Array:
    """Coefficients, two more than samples along the axis, of the interpolating cubic spline with not-a-knot ends.

    Sample i is (c[i] + 4 c[i+1] + c[i+2]) / 6, with c[0] the coefficient before the first sample. The third derivative does not
    jump at the second sample and at the last but one: the fourth differences of the first and of the last five c vanish.
    """
    n = samples.shape[axis]
    rows = np.arange(n)
    interior = (
        np.repeat(rows + 1, 3),
        np.concatenate([rows[:, None], rows[:, None] + 1, rows[:, None] + 2], axis=1).ravel(),
        np.tile([1.0, 4.0, 1.0], n) / 6,
    )
    ends = np.arange(5)
    fourth = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    i = np.concatenate([np.zeros(5, int), interior[0], np.full(5, n + 1)])
    j = np.concatenate([ends, interior[1], n - 3 + ends])
    entries = np.concatenate([fourth, interior[2], fourth])
    solver = splu(csc_array((entries, (i, j)), shape=(n + 2, n + 2)))
    moved = np.moveaxis(samples, axis, 0)
    right = np.zeros((n + 2, moved[0].size))
    right[1:-1] = moved.reshape(n, -1)
    return np.moveaxis(solver.solve(right).reshape(n + 2, *moved.shape[1:]), 0, axis)


def _saturate(step: Node, last: float) -> Node:
    """A coordinate in spacings that saturates beyond the outermost samples, at 0 and `last`."""
    inside = clamp(step, 0.0, last)
    beyond = (step - inside) / SATURATION_SPACINGS
    return inside + SATURATION_SPACINGS * (beyond / root(beyond * beyond + 1.0))
