"""Fields of scattered data: values at any points, interpolated by radial basis functions and tabulated once.

The interpolant is the thin plate spline of three dimensions, phi(r) = r, or r^3 for smooth data, with a linear or constant
polynomial (scipy.interpolate.RBFInterpolator). Evaluating it costs all data for every point, so that it is sampled on a uniform
grid once and becomes a cubic spline (`sampled_data`).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RBFInterpolator
from scipy.spatial import KDTree

from tpmscad._typing import Array, BoxCorners
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import BOX, CELL_COUNTS, NOT_NEGATIVE, NUMBER, POINT_TABLE, POINT_VALUES
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.point_tables import read_point_table
from tpmscad.fields.kinds.sampled_data import MIN_SAMPLES, SampledField, interpolate_samples
from tpmscad.memory_limit import require_memory

MIN_POINTS = 4
"""Points that determine a linear function of space."""

MAX_GLOBAL_POINTS = 3000
"""Points up to which one system of equations takes all of them: 3000 take a second and 72 MB. Above, each sample of the table is
interpolated from its nearest points."""

NEIGHBOURS = 80
"""Nearest points for a sample of the table where there are more than MAX_GLOBAL_POINTS."""

SAMPLES_PER_SPACING = 2.0
"""Samples of the table for each distance of neighbouring points, along each axis."""

MIN_TABLE, MAX_TABLE = 16, 80
"""Fewest and most samples along the longest axis of a table whose resolution is not given."""

SAMPLES_PER_BATCH = 4096
"""Samples interpolated at a time: 3000 points need 100 MB."""


@validate_call()
def scattered(
    points: Annotated[
        ArrayLike | str | os.PathLike[str],
        POINT_TABLE,
        "Positions, model units; at least four, not in one plane. Or the path of a CSV file with the columns x, y, z "
        "and value.",
    ],
    values: Annotated[ArrayLike | None, POINT_VALUES, "Value at each point; a file holds them."] = None,
    *,
    level: Annotated[
        float | None,
        NUMBER.described_as(example="0.0"),
        "If given, the field is `level` minus the data: the part whose data exceed the level is solid.",
    ] = None,
    smoothing: Annotated[
        float, NOT_NEGATIVE, "0 interpolates; larger values smooth noise (see scipy.interpolate.RBFInterpolator)."
    ] = 0.0,
    resolution: Annotated[
        int | Sequence[int] | None,
        CELL_COUNTS.described_as(example="40"),
        "Samples of the table along the longest axis, or along each. By default two for each distance of neighbouring "
        "points.",
    ] = None,
    domain: Annotated[
        BoxCorners | None,
        BOX,
        "Box of the table, model units; by default the bounding box of the points. Beyond it the field is continued "
        "by half a sample's spacing, and then constant along each axis.",
    ] = None,
) -> SampledField:
    """Return the smooth field through values at scattered points.

    Returns
    -------
    SampledField
        The field; evaluation costs no more than for any sampled field.

    Raises
    ------
    InvalidRequest
        If shapes do not fit, a number is not finite, points coincide or lie in one plane, or a file cannot be read.

    Notes
    -----
    Interpolation by radial basis functions r^3 with a linear polynomial. The table is a cubic spline: between its samples the
    field differs from the interpolant by the fourth power of the spacing.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import fields
    >>> points = np.random.default_rng(0).uniform(0, 10, (200, 3))
    >>> field = fields.scattered(points, points[:, 0] - 5.0)
    >>> bool(abs(field((7.0, 5.0, 5.0)) - 2.0) < 1e-6)
    True
    """
    if isinstance(points, str | os.PathLike):
        if values is not None:
            raise InvalidRequest("the file of the points holds their values, too: leave values out")
        points, values = read_point_table(points)
    elif values is None:
        raise InvalidRequest("there is no value for the points: give the values after them, an array (n,)")
    positions, data = _check_points(points, values)
    if level is not None:
        data = level - data
    if domain is None:
        low, high = positions.min(axis=0), positions.max(axis=0)
    else:
        low, high = np.array(domain)
    counts = _table_shape(positions, high - low, resolution)
    try:
        interpolant = RBFInterpolator(
            positions,
            data,
            kernel="cubic",
            smoothing=smoothing,
            neighbors=None if len(positions) <= MAX_GLOBAL_POINTS else NEIGHBOURS,
        )
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
        samples = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        table = np.concatenate(
            [interpolant(samples[i : i + SAMPLES_PER_BATCH]) for i in range(0, len(samples), SAMPLES_PER_BATCH)]
        )
    except (np.linalg.LinAlgError, ValueError) as error:
        near = "they" if len(positions) <= MAX_GLOBAL_POINTS else f"the {NEIGHBOURS} points next to a place"
        raise InvalidRequest(
            f"the points cannot be interpolated ({error}): if {near} lie in one plane, give values off it, too, or more even ones"
        ) from None
    steps = (high - low) / (np.array(counts) - 1)
    return interpolate_samples(table.reshape(counts), tuple(steps.tolist()), tuple(low.tolist()))


BYTES_PER_SAMPLE = 80
"""Of the table: its points, its values, and the coefficients of its spline."""


def _check_points(points: ArrayLike, values: ArrayLike) -> tuple[Array, Array]:
    """Points (n, 3) and values (n,), finite, distinct and not in one plane."""
    positions, data = np.asarray(points, float), np.asarray(values, float)
    if positions.ndim != 2 or positions.shape[1:] != (3,) or data.shape != positions.shape[:1]:
        raise InvalidRequest(
            f"points of shape {positions.shape} and values of shape {data.shape}: give (n, 3) and (n,)"
        )
    if len(positions) < MIN_POINTS:
        raise InvalidRequest(f"{len(positions)} points are fewer than {MIN_POINTS}, the least that span space")
    distance, _ = KDTree(positions).query(positions, k=2)
    if distance[:, 1].min() == 0:
        row = int(distance[:, 1].argmin())
        raise InvalidRequest(f"point {positions[row].tolist()} occurs twice: give one value for it")
    if np.linalg.matrix_rank(positions - positions.mean(axis=0)) < 3:
        raise InvalidRequest("all points lie in one plane: give values off it, too, or a field of two coordinates")
    return positions, data


def _table_shape(positions: Array, extent: Array, resolution: int | Sequence[int] | None) -> tuple[int, int, int]:
    """Samples of the table along each axis."""
    if resolution is None:
        spacing = float(np.cbrt(np.prod(np.ptp(positions, axis=0)) / len(positions)))
        wanted = SAMPLES_PER_SPACING * float(extent.max()) / spacing
        resolution = int(np.clip(np.ceil(wanted), MIN_TABLE, MAX_TABLE))
    numbers = np.asarray(resolution, float)
    if numbers.shape not in ((), (3,)) or not (numbers >= MIN_SAMPLES).all() or (numbers != np.rint(numbers)).any():
        raise InvalidRequest(f"resolution {resolution!r}: give a whole number of at least {MIN_SAMPLES}, or three")
    if numbers.ndim == 0:  # along the longest edge
        numbers = np.maximum(np.rint((numbers - 1) * extent / extent.max()) + 1, MIN_SAMPLES)
    require_memory(
        float(numbers.prod()), BYTES_PER_SAMPLE, f"a table of {numbers.tolist()} samples", "use a coarser resolution"
    )
    return int(numbers[0]), int(numbers[1]), int(numbers[2])
