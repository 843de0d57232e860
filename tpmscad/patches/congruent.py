"""Sampled patches that are translates of one another: fitted, measured and stored once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.patches.complex import Array, Ints
from tpmscad.patches.weld import cluster

SAME = 1e-11
"""Of the patches' extent: samples this near after a translation are the same patch. Maps are evaluated to 1e-14 or so, the
differences that give a user's map its normals to 1e-12."""


@dataclass(frozen=True, slots=True, eq=False)
class Classes:
    """`first` (n,) indexes the first patch of each class; patch i is that of `label[i]` moved by `translation[i]`."""

    first: Ints
    label: Ints
    translation: Array


def translation_classes(samples: Array) -> Classes:
    """Classes of patches sampled on one grid (P, m, n, 3)."""
    flat = samples.reshape(len(samples), -1, 3)
    shape = flat - flat[:, :1]
    radius = SAME * np.ptp(flat[0], axis=0).max()
    # A handful of samples tells nearly all classes apart; those that agree there are compared whole.
    signature = shape[:, np.linspace(1, shape.shape[1] - 1, 7).astype(int)].reshape(len(samples), -1)
    label, first = cluster(signature, 10 * radius)
    differs = np.abs(shape - shape[first[label]]).max(axis=(1, 2)) > 10 * radius
    label[differs] = len(first) + np.arange(np.count_nonzero(differs))
    first = np.concatenate([first, np.flatnonzero(differs)])
    return Classes(first, label, flat[:, 0] - flat[first[label], 0])
