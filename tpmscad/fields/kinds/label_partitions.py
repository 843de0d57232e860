"""Several labels of a segmentation as regions that share their faces: tissues that touch, the phases of a composite.

Each label by itself has a smooth surface, and two that touch follow each other within the tolerance, not exactly. Here space is
divided by one surface after the other. The first is that of all labels together; every label but the last is cut out of what is
left by the surface between it and the labels that follow. Every voxel of the background counts as the nearest label, so that
these surfaces cross the outer one. The solids of two regions then have the same faces where they touch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.ndimage import distance_transform_edt

from tpmscad._typing import BoolArray, BoxCorners
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import LABEL
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.label_values import format_labels
from tpmscad.fields.field import Field, MinMaxField
from tpmscad.fields.kinds.sampled_data import (
    DataArrayName,
    DataFrame,
    DataOrigin,
    DataSource,
    DataSpacing,
    DataVolume,
    place_data,
    place_image_samples,
    read_data,
)
from tpmscad.fields.kinds.segmentation_labels import select_labels, separate_voxels
from tpmscad.fields.tape.evaluation import Triple


@dataclass(frozen=True, slots=True, eq=False)
class LabelPartition:
    """Fields of regions by their labels, negative inside; the box of the voxels, and their spacing, model units."""

    regions: Mapping[int, Field]
    domain: BoxCorners
    spacing: Triple


@validate_call()
def label_partition(
    array: DataSource,
    spacing: DataSpacing = None,
    origin: DataOrigin = None,
    label: Annotated[
        Sequence[int] | str,
        LABEL,
        "The labels, two or more, in the order in which they are cut out; or ``all``: all but 0.",
    ] = "all",
    *,
    frame: DataFrame = None,
    volume: DataVolume = None,
    array_name: DataArrayName = None,
) -> LabelPartition:
    """Return the regions of several labels of a segmentation, which share the faces in which they touch.

    Returns
    -------
    LabelPartition
        `regions[label]` is the field of each; `domain` the box of the voxels.

    Raises
    ------
    InvalidRequest
        As `labels` does, and for less than two labels.

    Notes
    -----
    Every point of the labels together belongs to one region: there are no gaps and no overlaps. The surfaces are those of
    `labels`, smooth within half a voxel; where more than two regions meet, the labels that come first have smooth edges.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import fields
    >>> phases = np.where(np.indices((8, 6, 6))[0] < 3, 1, 2)
    >>> parts = fields.label_partition(phases)
    >>> float(parts.regions[1]((4.0, 2.0, 2.0))) == -float(parts.regions[2]((4.0, 2.0, 2.0)))
    True
    """
    name, image = read_data(array, frame, True, volume, array_name)
    inside, told = select_labels(name, image.values, label)
    chosen = np.unique(image.values[inside]) if isinstance(label, str) else np.atleast_1d(label)
    wanted = np.array(list(dict.fromkeys(chosen.astype(int).tolist())))
    if len(wanted) < 2:
        raise InvalidRequest(
            f"label {format_labels(wanted)} is one label: a partition has two or more; fields.labels is for one"
        )
    steps, first = place_data(image, spacing, origin)
    notes = (
        *image.notes,
        f"{name}: {told.replace(' as one solid', '')}, divided by smooth surfaces within half a voxel",
    )
    nearest = distance_transform_edt(~inside, steps, return_distances=False, return_indices=True)
    owner = image.values[tuple(nearest)]

    def separate(part: BoolArray) -> Field:
        values = float(np.cbrt(np.prod(steps))) * separate_voxels(part)[0]
        return place_image_samples(values, image, steps, first, centred=True, notes=notes)

    rest: Field | None = None if inside.all() else separate(inside)
    if rest is None and image.directions is not None:  # all of a turned box, beyond which nothing is solid
        rest = place_image_samples(-np.ones(inside.shape), image, steps, first, centred=True, notes=notes)
    regions: dict[int, Field] = {}
    for number in wanted[:-1].tolist():
        own = separate(owner == number)
        regions[number] = own if rest is None else MinMaxField(rest, own, 1)
        rest = -own if rest is None else MinMaxField(rest, -own, 1)
    assert rest is not None
    regions[int(wanted[-1])] = rest
    domain = place_image_samples(np.zeros(inside.shape), image, steps, first, centred=True, notes=()).domain
    assert domain is not None
    return LabelPartition(regions, domain, steps)
