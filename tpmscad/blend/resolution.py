"""A working resolution from the structures themselves: their periods, and the samples their thinnest parts need.

A structure with periods is tried on a block of a period and a half with 10, 14, ... samples per period, until its components and
holes are the same as with twice as many and its volume has settled; one without periods on the whole domain, from 40 samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad.blend.census import census
from tpmscad.blend.grid import Box, Field, Grid, sample
from tpmscad.errors import InvalidRequest

PER_PERIOD = (10, 14, 20, 28, 40, 56)
ALONG_DOMAIN = (40, 60, 90, 135, 200)
BLOCK = 1.5
"""Periods tried: not a whole number, so that the block's border cuts each part of the structure somewhere."""

SETTLED = 0.02
"""Change of the volume fraction, of 1, that passes when samples are doubled."""

MAX_SAMPLES = 12_000_000
"""Samples at most: with the check at twice the resolution a blend then takes a minute and 4 GiB."""


def automatic_resolution(structures: Sequence[Field], domain: Box) -> tuple[int, int, int]:
    """Samples along x, y, z that every structure needs. Raises InvalidRequest if they are more than 12 million."""
    extent = np.array(domain[1]) - np.array(domain[0])
    spacing = np.full(3, np.inf)
    for index, structure in enumerate(structures):
        spacing = np.minimum(spacing, _needed(structure, index, domain, extent))
    counts = [max(8, int(np.ceil(e / s)) + 1) for e, s in zip(extent, spacing, strict=True)]
    if np.prod(counts) > MAX_SAMPLES:
        raise InvalidRequest(
            f"the structures need {counts[0]} x {counts[1]} x {counts[2]} samples over the domain, above the limit of "
            f"{MAX_SAMPLES:,}: give a smaller domain, or a resolution"
        )
    return counts[0], counts[1], counts[2]


def _needed(structure: Field, index: int, domain: Box, extent: np.ndarray) -> np.ndarray:
    periods = getattr(structure, "periods", lambda: None)()
    if periods is not None and any(periods):
        cell = np.where(np.array(periods) > 0, periods, extent)
        size = np.minimum(BLOCK * cell, extent)
        trials = [(cell / n, n) for n in PER_PERIOD]
        what = f"{PER_PERIOD[-1]} samples per period"
    else:
        size = extent
        trials = [(np.full(3, extent.max() / n), n) for n in ALONG_DOMAIN]
        what = f"{ALONG_DOMAIN[-1]} samples along the domain"
    low = np.array(domain[0])
    for spacing, _ in trials:
        shape = np.maximum(np.ceil(size / spacing).astype(int) + 1, 4)
        grid = Grid(tuple(low.tolist()), tuple((low + size).tolist()), (int(shape[0]), int(shape[1]), int(shape[2])))
        values = [sample(structure, g, f"structure {index}") for g in (grid, grid.twice())]
        seen = [census(v) for v in values]
        volume = [float(np.mean(v <= 0)) for v in values]
        if seen[0].n0 <= seen[1].n0 and seen[0].n2 <= seen[1].n2 and abs(volume[0] - volume[1]) <= SETTLED:
            return spacing
    raise InvalidRequest(
        f"structure {index} has parts too thin for {what}: its components still change there; give a resolution, or thicken it"
    )
