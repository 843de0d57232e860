"""A working resolution from the structures themselves: their periods, and the samples their thinnest parts need.

A structure with periods is tried on a block of a period and a half with 10, 14, ... samples per period, until its components and
holes are no more than with 80, there and with twice as many, and its volume has settled; one without periods on the whole domain,
from 40 samples along it to 200.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad.blend.census import census
from tpmscad.blend.grid import Array, Box, Field, Grid, sample
from tpmscad.errors import InvalidRequest

PER_PERIOD = (10, 14, 20, 28, 40, 56, 80)
ALONG_DOMAIN = (40, 60, 90, 135, 200)
BLOCK = 1.5
"""Periods tried: not a whole number, so that the block's border cuts each part of the structure somewhere."""

SETTLED = 0.1
"""Error of the smaller phase's volume that passes, of itself: thin walls need their thickness sampled."""

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


def _needed(structure: Field, index: int, domain: Box, extent: Array) -> Array:
    periods = getattr(structure, "periods", lambda: None)()
    if periods is not None and any(periods):
        cell = np.where(np.array(periods) > 0, periods, extent)
        size = np.minimum(BLOCK * cell, extent)
        trials = [cell / n for n in PER_PERIOD]
        what = f"{PER_PERIOD[-1]} samples per period"
    else:
        size = extent
        trials = [np.full(3, extent.max() / n) for n in ALONG_DOMAIN]
        what = f"{ALONG_DOMAIN[-1]} samples along the domain"
    low = np.array(domain[0])

    def read(spacing: Array) -> tuple[int, int, float]:
        x, y, z = (max(4, int(n)) for n in np.ceil(size / spacing) + 1)
        values = sample(structure, Grid(_triple(low), _triple(low + size), (x, y, z)), f"structure {index}")
        seen = census(values)
        return seen.n0, seen.n2, float(np.mean(values <= 0))

    n0, n2, solid = read(trials[-1])
    least = SETTLED * min(solid, 1 - solid)
    for spacing in trials[:-1]:
        seen = [read(spacing), read(np.maximum(spacing / 2, trials[-1]))]
        if all(a <= n0 and b <= n2 and abs(c - solid) <= least for a, b, c in seen):
            return spacing
    raise InvalidRequest(
        f"structure {index} has parts too thin for {what}: its components still change there; give a resolution, or thicken it"
    )


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
