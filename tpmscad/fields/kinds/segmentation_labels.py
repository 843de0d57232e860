"""The smooth surface of labels of a segmentation, within half a voxel.

The boundary of the voxels of a label is a staircase, and any surface that separates the centres inside from those outside
explains the voxels as well. The signed distance to the staircase, in voxels, is smoothed by a Gaussian, which takes the steps
away and shrinks what is convex. Van Cittert's iteration gives back what a smooth shape has lost: the residual, limited to a
voxel, is added before the Gaussian is applied again. The surface is then shifted until its volume is that of the voxels. In the
end each value keeps the sign of its voxel, so that the surface crosses between every centre inside and its neighbours outside,
and thin parts do not vanish.

Sources: distance field and a fit of bounded deviation, arXiv:2402.12076; P. H. van Cittert, Z. Phys. 69 (1931) 298.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Annotated

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter
from scipy.optimize import brentq

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import LABEL
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.grey_levels import describe_levels
from tpmscad.fields.data.label_values import format_labels, list_labels
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.sampled_data import (
    DataArrayName,
    DataFrame,
    DataOrigin,
    DataSource,
    DataSpacing,
    DataVolume,
    interpolate_samples,
    place_data,
    place_image_samples,
    read_data,
)
from tpmscad.fields.kinds.volume_fraction_thresholds import cube_volumes_below

SMOOTHING_VOXELS = 1.3
"""Standard deviation of the Gaussian: balls of 2 to 6 voxels' radius come out smoother than with 1, and as large."""

RESTORATIONS = 8
"""Iterations: balls of 2 to 6 voxels' radius keep their volume within 2 %; more follow the staircase again."""

MAX_DISTANCE_VOXELS = 3.0
"""Distance beyond which voxels do not matter."""

MAX_RESIDUAL_VOXELS = 1.0
"""Part of the residual that is added back: ridges of the distance inside thin parts have more."""

MAX_SHIFT_VOXELS, MAX_SHIFTS = 0.4, 4
"""Greatest shift of the smoothed surface along its normal at once, and times that one is tried, to keep the volume."""

VOLUME_RTOL, MAX_VOLUME_ERROR = 1e-3, 1e-2
"""Relative differences of the volume from that of the voxels: aimed at, and told if it is exceeded."""

EXTRAPOLATED_VOXELS = 20_000
"""Voxels at the surface, at most about as many, from which the error of the volume by linear voxels is extrapolated."""

LEAST_VALUE_VOXELS = 0.1
"""Least magnitude of the field at a voxel's centre: the surface does not pass through it."""


@validate_call()
def labels(
    array: DataSource,
    spacing: DataSpacing = None,
    origin: DataOrigin = None,
    label: Annotated[
        int | Sequence[int] | str,
        LABEL,
        "The label, or several that make one solid together, or ``all``: every one but 0, of an array of integers.",
    ] = 1,
    *,
    frame: DataFrame = None,
    volume: DataVolume = None,
    array_name: DataArrayName = None,
) -> Field:
    """Return the region of a label of a segmentation, with a smooth surface within half a voxel.

    Returns
    -------
    Field
        About the distance from the surface, model units; its `domain` is the box of the voxels, or one around turned voxels.

    Raises
    ------
    InvalidRequest
        If the values are no whole numbers, the label does not occur or fills the array, or the file cannot be read.

    Notes
    -----
    The field is negative at the centre of every voxel with the label and positive at that of every other one. Between two centres
    the surface lies up to half a voxel from the face between their voxels. The volume is that of the voxels to a per cent, unless
    parts are too thin for that, which a note tells. Voxels are cells: a label that reaches the end of the
    array is solid up to there.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import fields
    >>> x, y, z = np.mgrid[0:12, 0:12, 0:12] - 5.5
    >>> organs = np.where(x**2 + y**2 + z**2 < 16, 2, 0)
    >>> ball = fields.labels(organs, spacing=0.5, label=2)
    >>> bool(((ball(np.argwhere(organs == 2) * 0.5) < 0)).all())
    True
    """
    name, image = read_data(array, frame, True, volume, array_name)
    inside, told = select_labels(name, image.values, label)
    if inside.all():
        raise InvalidRequest(f"{told} fills all of {name}: it has no surface")
    steps, first = place_data(image, spacing, origin)
    size = float(np.cbrt(np.prod(steps)))
    reference = (
        f"{name}: {told}; the deviation is that from its smoothed surface, which separates the centres of voxels inside and "
        "outside, within half a voxel of the faces between them"
    )
    values, share = separate_voxels(inside)
    if abs(share - 1) > MAX_VOLUME_ERROR:
        reference += (
            f"; its volume is {100 * share:.1f} % of that of the voxels, some of which make parts too thin for less"
        )
    return place_image_samples(size * values, image, steps, first, centred=True, notes=(*image.notes, reference))


def select_labels(name: str, values: Array, label: int | Sequence[int] | str) -> tuple[BoolArray, str]:
    """The voxels (nx, ny, nz) of some labels, and which these are, in words."""
    missing = np.isnan(values)
    values = np.where(missing, 0, values) if missing.any() else values
    known = list_labels(values)
    if label == "all" and known is None:
        kind = "integers of too many values, or below zero," if values.dtype.kind in "iu" else "floating-point numbers,"
        raise InvalidRequest(
            f"{name} holds {kind} which are grey values: it needs `level`, solid is where the values exceed it (they reach "
            f"{describe_levels(values)}); of a segmentation give `label`"
        )
    if known is None and not (values == np.rint(values)).all():
        odd = values[values != np.rint(values)].flat[0]
        raise InvalidRequest(f"{name} holds {odd:g}: labels are whole numbers; `level` is for grey values")
    found = np.unique(values)
    wanted = np.array(found[found != 0] if label == "all" else np.atleast_1d(label))
    absent = np.setdiff1d(wanted, found)
    if absent.size or not wanted.size:
        raise InvalidRequest(
            f"{name} holds no label {format_labels(absent) or 'but 0'}: its values are {format_labels(found)}"
        )
    inside = np.isin(values, wanted)
    several = len(wanted) > 1
    told = f"label{'s' if several else ''} {format_labels(wanted)} of {format_labels(found)}"
    if several:
        told += " as one solid" + ("; `label` takes one of them" if label == "all" else "")
    if missing.any():
        told += f"; {missing.sum()} voxels without a value (NaN) are taken as 0"
    return inside, told


def separate_voxels(inside: BoolArray) -> tuple[Array, float]:
    """Values at the centres of voxels (nx, ny, nz), about distances in voxels, of a smooth field that is negative inside.

    The second result is the volume of that field's solid as a multiple of that of the voxels.
    """
    sign = np.where(inside, -1.0, 1.0)
    distance = np.where(inside, distance_transform_edt(inside), distance_transform_edt(~inside)) - 0.5
    target = sign * np.minimum(distance, MAX_DISTANCE_VOXELS)
    source = target
    for _ in range(RESTORATIONS):
        residual = _limit(target) - _limit(_smooth(source))
        source = source + residual
    smooth, count, shift = _smooth(source), float(inside.sum()), 0.0
    for _ in range(MAX_SHIFTS):
        values = sign * np.maximum(sign * (smooth + shift), LEAST_VALUE_VOXELS)
        excess = _measure_excess(values, inside)
        if abs(excess(0.0)) <= VOLUME_RTOL * count:
            break
        ends = sorted((MAX_SHIFT_VOXELS * np.sign(excess(0.0)), 0.0))
        step = brentq(excess, *ends, xtol=1e-4) if excess(ends[0]) * excess(ends[1]) < 0 else sum(ends)
        shift += step
    return values, 1.0 + excess(0.0) / count


def _measure_excess(values: Array, inside: BoolArray) -> Callable[[float], float]:
    """The volume in voxels, more than that of the voxels inside, of the solid whose surface is moved inwards by c voxels.

    The field is linear in the voxels with neighbours of both kinds, and in eighths of some of them; the volume is extrapolated
    from both.
    """
    field = interpolate_samples(values, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), centred=True)
    neighbours = np.ones((3, 3, 3), bool)
    near = np.argwhere(binary_dilation(inside, neighbours) & binary_dilation(~inside, neighbours))
    counted = float(inside[tuple(near.T)].sum())
    stride = len(near) // EXTRAPOLATED_VOXELS + 1

    def linearise(voxels: IntArray, n: int) -> Callable[[float], Array]:
        centres = np.array(list(product((np.arange(n) + 0.5) / n - 0.5, repeat=3)))
        height, slope = field.value_and_gradient((voxels[:, None] + centres).reshape(-1, 3))
        return lambda c: cube_volumes_below(-c - height, np.abs(slope) / n)

    coarse, fine = linearise(near, 1), linearise(near[::stride], 2)

    def excess(c: float) -> float:
        parts = coarse(c)
        return float(parts.mean() + (fine(c).mean() - parts[::stride].mean()) * 4 / 3) * len(near) - counted

    return excess


def _smooth(values: Array) -> Array:
    """A Gaussian of data that are reflected at the ends of the array."""
    return np.asarray(gaussian_filter(values, SMOOTHING_VOXELS, mode="reflect"))


def _limit(values: Array) -> Array:
    return np.clip(values, -MAX_RESIDUAL_VOXELS, MAX_RESIDUAL_VOXELS)
