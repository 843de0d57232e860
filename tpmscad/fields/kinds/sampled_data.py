"""Fields of sampled data: a 3-D array on a uniform grid (CT, topology optimisation, simulation) as a smooth function.

The samples are interpolated by a cubic tensor-product spline. Samples of points end at the outermost ones: the spline has
not-a-knot ends there and reproduces cubic polynomials. Samples of cells end half a spacing further out: the data are continued by
reflection at the ends of the outermost cells. A cell that exceeds a level is then solid up to its end; an extrapolation of steps,
as of a density that is 0 or 1, would cross the level once more in the outermost cells.

Beyond the domain the spline is continued along a coordinate that saturates smoothly half a spacing further out, so that the field
stays bounded and twice continuously differentiable everywhere.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from tpmscad._typing import Array, BoxCorners
from tpmscad.api.argument_kinds import POINT
from tpmscad.api.public_calls import read_value, validate_call
from tpmscad.api.shared_kinds import ARRAY_OR_PATH, FLAG, FRACTION, INDEX, LENGTHS, NOT_NEGATIVE, NUMBER, SAMPLES, TEXT
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.grey_levels import describe_levels, fill_missing
from tpmscad.fields.data.image_files import read_image
from tpmscad.fields.data.image_frames import FRAME, FRAME_MEANING, Image
from tpmscad.fields.data.label_values import describe_whole_numbers, list_labels
from tpmscad.fields.data_box import DataBox
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.coordinate_transforms import place_samples
from tpmscad.fields.kinds.volume_fraction_thresholds import SAMPLES_PER_AXIS, threshold_for
from tpmscad.fields.periods_and_directions import as_periods
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node, clamp, root, tensor_spline

MIN_SAMPLES = 4
"""Samples along an axis: a cubic spline with not-a-knot ends needs four. Of cells one is enough."""

SATURATION_SPACINGS = 0.5
"""Spacings beyond the domain at which the continued coordinate saturates."""

CELLS_PER_SAMPLE = 2
"""Cells per sample along the longest axis, with which the volume above a level is measured."""

DataSource = Annotated[
    ArrayLike | str | os.PathLike[str],
    ARRAY_OR_PATH,
    "Sample (i, j, k) lies at origin + spacing * (i, j, k). Or the path of an image: ``.npy``, ``.npz``, ``.raw``, and with "
    "the extra ``tpmscad[images]`` NIfTI (``.nii``), ``.nrrd``, ``.mha``, ``.mhd``, DICOM, ``.tif``, ``.mrc``, ``.map``, "
    "and ``.vti``, ``.vtr``, ``.vts``, ``.vtu`` or ``.vtk``; or a folder of slices, DICOM or ``.tif``. NaN is outside the solid.",
]
DataSpacing = Annotated[
    float | Sequence[float] | None,
    LENGTHS,
    "Distance of neighbouring samples, model units. By default that of the file, or 1.",
]
DataOrigin = Annotated[
    Triple | None,
    POINT,
    "Position of the first sample, which of a cell is its centre, model units. By default that of the file, or the origin.",
]
DataFrame = Annotated[str | None, FRAME, FRAME_MEANING]
DataVolume = Annotated[
    int | None,
    INDEX,
    "Which of the volumes of a file, times or channels, or of the DICOM series of a folder, from 0 on.",
]
DataArrayName = Annotated[
    str | None,
    TEXT.described_as(example='"density"'),
    "Which of the arrays of an ``.npz`` or VTK file; by default the only one, or the active one.",
]


ROUGH_BEND = 0.3
"""Median of the mean curvature times the spacing above which a surface is rough. Measured: .34 and .39 in a scan of a head, .15
after a Gaussian of one sample; .07 in a synthetic scan with noise; .2 in a gyroid of six samples to the cell; .43 in a ball of
voxels."""

MEASURED_SIDE = 128
"""Samples along each axis on which that is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class SampledField(Field):
    """Cubic spline through samples on a uniform grid.

    `coefficients` belong to the centred cardinal B-splines of the samples and of one more on each side, of two if the samples are
    `centred` in cells. `notes` tell what was assumed of the data.
    """

    coefficients: Array
    spacing: Triple
    origin: Triple
    centred: bool = False
    notes: tuple[str, ...] = ()

    @property
    def counts(self) -> tuple[int, ...]:
        """Samples along each axis."""
        return tuple(n - 2 * (1 + self.centred) for n in self.coefficients.shape)

    @property
    def domain(self) -> BoxCorners:
        """The box of the samples or cells ((x0, y0, z0), (x1, y1, z1)), model units: the domain for `tpmscad.solidify`."""
        half = 0.5 * self.centred
        axes = list(zip(self.origin, self.spacing, self.counts, strict=True))
        x0, y0, z0 = (o - half * s for o, s, _ in axes)
        x1, y1, z1 = (o + (n - 1 + half) * s for o, s, n in axes)
        return (x0, y0, z0), (x1, y1, z1)

    def data_box(self) -> DataBox:
        """The box of the samples or cells."""
        return DataBox.of_corners(self.domain, tuple(max(1, n - 1 + self.centred) for n in self.counts))

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        half = 0.5 * self.centred
        steps = [
            _saturate((t - first) / spacing, -half, n - 1.0 + half)
            for t, n, first, spacing in zip((x, y, z), self.counts, self.origin, self.spacing, strict=True)
        ]
        first_knot = -3.0 - self.centred
        knots = [first_knot + np.arange(n + 4.0) for n in self.coefficients.shape]
        return tensor_spline(knots, (3, 3, 3), self.coefficients, (steps[0], steps[1], steps[2]))

    def __repr__(self) -> str:
        shape = "x".join(map(str, self.counts))
        digest = hashlib.sha256(self.coefficients.tobytes()).hexdigest()[:8]
        of = "cells" if self.centred else "samples"
        return f"SampledField({shape} {of} {digest}, spacing={self.spacing}, origin={self.origin})"


@validate_call()
def sampled(
    values: DataSource,
    spacing: DataSpacing = None,
    origin: DataOrigin = None,
    *,
    level: Annotated[
        float | None,
        NUMBER.described_as(example="0.0"),
        "If given, the field is `level` minus the data: the part whose data exceed the level is solid, as is usual "
        "for densities. Otherwise the field is the data, and negative data are solid.",
    ] = None,
    volume_fraction: Annotated[
        float | None,
        FRACTION,
        "Instead of `level`: the part of the domain's volume that is to be solid, from which the level follows.",
    ] = None,
    smoothing: Annotated[
        float,
        NOT_NEGATIVE.described_as(example="1.0"),
        "Standard deviation, in samples, of a Gaussian that takes noise away before the samples are interpolated: 1 makes "
        "a noisy scan a solid of a fifth of the faces.",
    ] = 0.0,
    centred: Annotated[
        bool | None,
        FLAG,
        "Whether the values belong to cells (voxels, elements), with the samples at their centres: the domain then "
        "reaches half a cell further on every side. By default as a ``.vti``, ``.vtk`` or ``.nrrd`` file states, else "
        "False: the values belong to points.",
    ] = None,
    frame: DataFrame = None,
    volume: DataVolume = None,
    array_name: DataArrayName = None,
) -> Field:
    """Return the smooth field through samples on a uniform grid.

    Returns
    -------
    Field
        The field, twice continuously differentiable, with exact gradient; its `domain` is the box of the samples or cells. Of an
        image whose axes are turned against x, y and z it is turned, and empty beyond its samples; the `domain` is a box around.

    Raises
    ------
    InvalidRequest
        If the array does not have three dimensions, or less than four samples of points along one, a value is infinite, a
        spacing is not positive, the values are labels, or the file cannot be read.

    Notes
    -----
    A cubic spline follows the samples exactly, noise included, unless they are smoothed. Integers of a few different values, none
    negative, are labels and refused: see `fields.labels`. If they are numbers, convert them: ``values.astype(float)``.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import fields
    >>> x, y, z = np.mgrid[0:9, 0:9, 0:9] * 0.5
    >>> field = fields.sampled(x**2 + y - z, spacing=0.5)
    >>> bool(np.isclose(field((1.3, 2.1, 0.7)), 1.3**2 + 2.1 - 0.7))
    True
    >>> fields.sampled(np.ones((24, 12, 8)), origin=(0.5, 0.5, 0.5), centred=True).domain
    ((0.0, 0.0, 0.0), (24.0, 12.0, 8.0))
    """
    name, image = read_data(values, frame, centred, volume, array_name)
    found = list_labels(image.values)
    if found is not None:
        raise InvalidRequest(
            f"{name} holds the labels {found}, which are no quantity to interpolate: fields.labels makes the surface of one or "
            "more of them; if they are numbers, save them as floating-point numbers"
        )
    notes = [*image.notes, *describe_whole_numbers(name, image.values)]
    if centred is None and image.centred is None:
        notes.append(
            f"{name}: values are taken at points, the solid ends at the outermost ones; centred=True if they belong to cells "
            "(voxels, elements)"
        )
    of_cells = image.centred if centred is None else centred
    array = np.array(image.values, dtype=float)
    if np.isnan(array).all():
        raise InvalidRequest(f"{name} holds no values but NaN")
    if smoothing:
        array = _smooth_samples(array, smoothing)
        notes.append(
            f"{name}: smoothed by a Gaussian of {smoothing:g} samples; the deviation is that from the smoothed data"
        )
    placed = place_data(image, spacing, origin)
    if volume_fraction is not None:
        if level is not None:
            raise InvalidRequest("give either `level` or `volume_fraction`, from which the level follows")
        level = _find_level(name, array, placed, bool(of_cells), volume_fraction)
        notes.append(f"{name}: level {level:.6g} for a volume fraction of {volume_fraction:g}")
    if level is not None:
        has_outside = np.nanmin(array) < level or np.isnan(array).any()
        if not (has_outside and level < np.nanmax(array)):
            raise InvalidRequest(
                f"level {level:g} lies outside the data, which reach {describe_levels(array)}: give a level between these"
            )
        array = level - array
    array, filled = fill_missing(name, array)
    notes += filled
    if level is not None and not smoothing and _is_rough(array, placed[0]):
        notes.append(
            f"{name}: its surface is as rough as the samples are far apart, which is noise, or detail at their limit: "
            "smoothing=1, one sample, makes a solid of far fewer faces in a part of the time"
        )
    return place_image_samples(array, image, *placed, centred=bool(of_cells), notes=tuple(notes))


def place_image_samples(
    samples: Array, image: Image, spacing: Triple, first: Triple, *, centred: bool, notes: tuple[str, ...]
) -> Field:
    """The spline through samples of an image, turned as its axes are."""
    if image.directions is None:
        return interpolate_samples(samples, spacing, first, centred=centred, notes=notes)
    field = interpolate_samples(samples, spacing, (0.0, 0.0, 0.0), centred=centred, notes=notes)
    return place_samples(field, image.directions, np.array(first))


def _is_rough(array: Array, spacing: Triple) -> bool:
    """Whether the zero level bends, in the median, as samples of noise do, by central differences in the middle of the array."""
    middle = array[tuple(slice(max(0, (n - MEASURED_SIDE) // 2), (n + MEASURED_SIDE) // 2) for n in array.shape)]
    crossed = np.zeros(middle.shape, bool)
    inside = middle < 0
    for axis in range(3):
        one, other = (np.moveaxis(inside, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        rows = np.moveaxis(crossed, axis, 0)
        rows[:-1] |= one != other
        rows[1:] |= one != other
    if min(middle.shape) < MIN_SAMPLES or not crossed.any():
        return False
    slopes = np.gradient(middle, *spacing)
    length = np.maximum(np.sqrt(sum(slope**2 for slope in slopes)), np.finfo(float).tiny)
    bend = sum(
        np.gradient(slope / length, step, axis=k) for k, (slope, step) in enumerate(zip(slopes, spacing, strict=True))
    )
    return bool(0.5 * np.median(np.abs(bend[crossed])) * min(spacing) > ROUGH_BEND)


def _smooth_samples(array: Array, width: float) -> Array:
    """The samples weighted by a Gaussian, those that are missing left out; data are reflected at the ends of the array."""
    known = np.isfinite(array)
    if known.all():
        return np.asarray(gaussian_filter(array, width))
    weight = gaussian_filter(known.astype(float), width)
    total = gaussian_filter(np.where(known, array, 0.0), width)
    return np.where(known, total / np.where(known, weight, 1.0), np.nan)


def _find_level(name: str, array: Array, placed: tuple[Triple, Triple], centred: bool, fraction: float) -> float:
    """The level whose excess fills a part of the domain's volume."""
    if np.isnan(array).any():
        raise InvalidRequest(f"{name} has samples without a value (NaN), which have no volume: give `level`")
    field = interpolate_samples(array, *placed, centred=centred)
    cells = max(SAMPLES_PER_AXIS, CELLS_PER_SAMPLE * max(array.shape))
    level = threshold_for(field, fraction, "pore", domain=field.domain, samples=cells)
    assert isinstance(level, float)
    return level


def read_data(
    values: ArrayLike | str | os.PathLike[str],
    frame: str | None,
    centred: bool | None,
    volume: int | None,
    array_name: str | None,
) -> tuple[str, Image]:
    """The name of a file or array for messages, and its samples in their own type; InvalidRequest if some are infinite."""
    if not isinstance(values, str | os.PathLike):
        given = {"frame": frame if frame != "file" else None, "volume": volume, "array_name": array_name}
        for name, value in given.items():
            if value is not None:
                raise InvalidRequest(f"{name} {value!r} is for image files: an array states none; leave `{name}` out")
        return "the array", Image(np.asarray(values))
    image = read_image(values, frame=frame, centred=centred, volume=volume, array_name=array_name)
    name = os.path.basename(os.path.normpath(values))
    read_value(name, SAMPLES, image.values)
    return name, image


def place_data(image: Image, spacing: float | Sequence[float] | None, origin: Triple | None) -> tuple[Triple, Triple]:
    """Spacing and origin of samples: as given, or else of the file, or 1 and 0."""
    first = image.origin if origin is None else origin
    return as_periods(spacing or image.spacing or 1.0), first or (0.0, 0.0, 0.0)


def interpolate_samples(
    samples: Array, spacing: Triple, origin: Triple, *, centred: bool = False, notes: tuple[str, ...] = ()
) -> SampledField:
    """The spline through samples (nx, ny, nz) of points, or of cells; InvalidRequest for less than four points along an axis."""
    if not centred and min(samples.shape) < MIN_SAMPLES:
        raise InvalidRequest(
            f"values of shape {samples.shape}: give an array of three dimensions with at least {MIN_SAMPLES} samples along each, "
            "or centred=True if the values belong to cells (voxels), of which one is enough"
        )
    for axis in range(3):
        samples = _reflected_coefficients(samples, axis) if centred else _spline_coefficients(samples, axis)
    return SampledField(np.ascontiguousarray(samples), spacing, origin, centred, notes)


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
    ends_apart = np.pad(samples, [(1, 1) if k == axis else (0, 0) for k in range(3)])
    return _solve_along(csc_array((entries, (i, j)), shape=(n + 2, n + 2)), ends_apart, axis)


def _reflected_coefficients(samples: Array, axis: int) -> Array:
    """Coefficients, four more than samples along the axis, of the cubic spline through data that are reflected at their ends.

    Sample i is (c[i-1] + 4 c[i] + c[i+1]) / 6 with c[-1] = c[0] and c[n] = c[n-1].
    """
    n = samples.shape[axis]
    own = np.arange(n)
    neighbours = np.concatenate([own, np.maximum(own - 1, 0), np.minimum(own + 1, n - 1)])
    weights = np.repeat([4.0, 1.0, 1.0], n) / 6
    coefficients = _solve_along(csc_array((weights, (np.tile(own, 3), neighbours)), shape=(n, n)), samples, axis)
    return np.pad(coefficients, [(2, 2) if k == axis else (0, 0) for k in range(3)], mode="symmetric")


def _solve_along(matrix: csc_array, right: Array, axis: int) -> Array:
    """The solutions of a linear system for the right-hand sides along an axis."""
    moved = np.moveaxis(right, axis, 0)
    found = splu(matrix).solve(np.ascontiguousarray(moved.reshape(len(moved), -1)))
    return np.moveaxis(found.reshape(moved.shape), 0, axis)


def _saturate(step: Node, first: float, last: float) -> Node:
    """A coordinate in spacings that saturates beyond the domain from `first` to `last`."""
    inside = clamp(step, first, last)
    beyond = (step - inside) / SATURATION_SPACINGS
    return inside + SATURATION_SPACINGS * (beyond / root(beyond * beyond + 1.0))
