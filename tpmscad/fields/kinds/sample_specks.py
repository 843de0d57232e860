"""Specks of sampled data: components of the solid so small that they are loose pieces, removed before anything is fitted.

Noise in a scan makes hundreds of specks. Each costs as many patches as a part of its own, and is then left out as a loose piece.
The samples tell them as well: components of negative samples, diagonal neighbours included, so that what the spline may join
is one component. The samples of a speck take the value of the nearest sample that belongs to none, which is positive, so that the
spline through them has no steps.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from tpmscad._typing import Array
from tpmscad.fields.kinds.sampled_data import SampledField, interpolate_samples
from tpmscad.topology.components import label_samples

SPECK_SHARE = 0.5
"""Of the volume below which a piece is loose: what the count of samples takes for larger is measured on the solid."""


def remove_specks(
    field: SampledField, lo: Array, hi: Array, loose_fraction: float
) -> tuple[SampledField, tuple[float, ...]]:
    """The field without the specks of its solid in the box [lo, hi], and their volumes by their samples, largest first.

    A speck has less than a share of `loose_fraction` of the samples of the largest component. The field itself if there are none.
    """
    axes = [o + s * np.arange(n) for o, s, n in zip(field.origin, field.spacing, field.counts, strict=True)]
    ends = [
        np.searchsorted(axis, (low - step, high + step))
        for axis, step, low, high in zip(axes, field.spacing, lo, hi, strict=True)
    ]
    window = tuple(slice(int(first), int(last)) for first, last in ends)
    values = field.on_grid(*axes)
    part = np.ascontiguousarray(values[window])
    if not part.size or part.min() >= 0:
        return field, ()
    labels, _ = label_samples(part < 0.0, 26)
    sizes = np.bincount(labels.reshape(-1))
    sizes[0] = 0  # the void
    is_speck = sizes < SPECK_SHARE * loose_fraction * sizes.max()
    is_speck[0] = False
    if not is_speck.any():
        return field, ()
    specks = is_speck[labels]
    nearest = distance_transform_edt(specks, field.spacing, return_distances=False, return_indices=True)
    values[window] = part[tuple(nearest)]
    cleaned = interpolate_samples(values, field.spacing, field.origin, centred=field.centred, notes=field.notes)
    volumes = np.sort(sizes[is_speck] * np.prod(field.spacing))[::-1]
    return cleaned, tuple(volumes.tolist())
