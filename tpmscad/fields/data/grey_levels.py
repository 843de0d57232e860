"""Grey values: the level that separates two materials, and values that are missing.

Source of the threshold: N. Otsu, A threshold selection method from gray-level histograms, IEEE Trans. SMC 9 (1979) 62.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from tpmscad._typing import Array

HISTOGRAM_BINS = 256

LEAST_FILL_FRACTION = 1e-2
"""Of the range of the data: least distance from the level of a value that fills a gap, so that the solid ends before it."""


def find_otsu_threshold(values: Array) -> float:
    """The level that separates the values into the two classes of least variance, between bins of a histogram."""
    counts, edges = np.histogram(values, HISTOGRAM_BINS)
    centres = (edges[:-1] + edges[1:]) / 2
    below = np.cumsum(counts)[:-1]
    above = below[-1] + counts[-1] - below
    moments = np.cumsum(counts * centres)
    difference = moments[:-1] / np.maximum(below, 1) - (moments[-1] - moments[:-1]) / np.maximum(above, 1)
    between = below * above * difference**2
    best = np.flatnonzero(between == between.max())  # bins that are empty between two classes
    return float(edges[1:-1][best].mean())


def describe_levels(values: Array) -> str:
    """The range of grey values in words, with a level to begin with: "from 0 to 255; Otsu's threshold is 97"."""
    known = values[np.isfinite(values)].astype(float)
    least, most = known.min(), known.max()
    if least == most:
        return f"from {least:g} to {most:g}"
    return f"from {least:g} to {most:g}; Otsu's threshold of their histogram is {find_otsu_threshold(known):.4g}"


def fill_missing(name: str, values: Array) -> tuple[Array, tuple[str, ...]]:
    """Values of a field (nx, ny, nz), negative is solid, without NaN, and a note on how many there were.

    A gap takes the magnitude of the nearest value: there is no solid in it, and one beside it ends halfway to the first sample of
    the gap.
    """
    missing = np.isnan(values)
    if not missing.any():
        return values, ()
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    least = LEAST_FILL_FRACTION * np.ptp(values[~missing])
    filled = np.where(missing, np.maximum(np.abs(values[tuple(nearest)]), least), values)
    return filled, (f"{name}: {missing.sum()} of {values.size} samples have no value (NaN) and are outside the solid",)
