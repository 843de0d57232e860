"""The box to blend in, from the regions: boxes, spheres, finite cylinders and what is made of them have one.

A working resolution from the structures themselves: their periods, and the samples their thinnest parts need.

A structure with periods is tried on a block of a period and a half with 10, 14, ... samples per period, until its components and
holes are no more than with 80, there and with twice as many, and its volume has settled; one without periods on the whole domain,
from 40 samples along it to 200.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import Array
from tpmscad.blending.composition.defects import count_defects
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import MinMaxField
from tpmscad.fields.primitive_regions import BoxRegion as BoxField
from tpmscad.fields.primitive_regions import CylinderRegion, SphereRegion
from tpmscad.fields.sample_grid import BoxBounds, FieldFunction, SampleGrid, sample_field


def resolve_domain(regions: Sequence[FieldFunction], domain: BoxBounds | None) -> BoxBounds:
    """The box given, or the least that holds all regions. Raises InvalidRequest if a region is unbounded."""
    if domain is not None:
        box = np.array(domain, float)
        if box.shape != (2, 3) or not np.isfinite(box).all():
            raise InvalidRequest(f"domain {domain}: must be ((x0, y0, z0), (x1, y1, z1)) with finite numbers")
    else:
        boxes = [find_region_bounds(region) for region in regions]
        for number, found in enumerate(boxes):
            if not np.isfinite(found).all():
                raise InvalidRequest(
                    f"region {number} has no bounds: give domain=((x0, y0, z0), (x1, y1, z1)), the box to blend in"
                )
        both = np.array(boxes)
        box = np.stack([both[:, 0].min(axis=0), both[:, 1].max(axis=0)])
    (x0, y0, z0), (x1, y1, z1) = box.tolist()
    return (x0, y0, z0), (x1, y1, z1)


def find_region_bounds(region: FieldFunction) -> Array:
    """Least and greatest x, y, z of a region: (2, 3), infinite where it has none or they are not known."""
    everything = np.array([[-np.inf] * 3, [np.inf] * 3])
    if isinstance(region, BoxField):
        return np.array([region.lo, region.hi], float)
    if isinstance(region, SphereRegion):
        return np.array(region.center) + np.array([[-region.radius], [region.radius]])
    if isinstance(region, CylinderRegion) and region.height is not None:
        axis = np.array(region.axis)
        reach = abs(axis) * region.height / 2 + region.radius * np.sqrt(np.maximum(1 - axis**2, 0))
        return np.array(region.center) + np.array([-reach, reach])
    if isinstance(region, MinMaxField):
        first, second = find_region_bounds(region.first), find_region_bounds(region.second)
        inner = np.stack([np.maximum(first[0], second[0]), np.minimum(first[1], second[1])])
        outer = np.stack([np.minimum(first[0], second[0]), np.maximum(first[1], second[1])])
        return inner if region.sign > 0 else outer
    own = getattr(region, "bounds", None)
    return everything if own is None else np.array(own, float)


SAMPLES_PER_PERIOD_TRIALS = (10, 14, 20, 28, 40, 56, 80)
SAMPLES_ALONG_DOMAIN_TRIALS = (40, 60, 90, 135, 200)
TRIAL_BLOCK_PERIODS = 1.5
"""Periods tried: not a whole number, so that the block's border cuts each part of the structure somewhere."""

VOLUME_TOL_FRACTION = 0.1
"""Error of the smaller phase's volume that passes, of itself: thin walls need their thickness sampled."""

MAX_SAMPLES = 12_000_000
"""Samples at most: with the check at twice the resolution a blend then takes a minute and 4 GiB."""


def choose_resolution(structures: Sequence[FieldFunction], domain: BoxBounds) -> tuple[int, int, int]:
    """Samples along x, y, z that every structure needs. Raises InvalidRequest if they are more than 12 million."""
    extent = np.array(domain[1]) - np.array(domain[0])
    spacing = np.full(3, np.inf)
    for index, structure in enumerate(structures):
        spacing = np.minimum(spacing, _find_needed_spacing(structure, index, domain, extent))
    counts = [max(8, int(np.ceil(e / s)) + 1) for e, s in zip(extent, spacing, strict=True)]
    if np.prod(counts) > MAX_SAMPLES:
        raise InvalidRequest(
            f"the structures need {counts[0]} x {counts[1]} x {counts[2]} samples over the domain, above the limit of "
            f"{MAX_SAMPLES:,}: give a smaller domain, or a resolution"
        )
    return counts[0], counts[1], counts[2]


def _find_needed_spacing(structure: FieldFunction, index: int, domain: BoxBounds, extent: Array) -> Array:
    periods = getattr(structure, "periods", lambda: None)()
    if periods is not None and any(periods):
        cell = np.where(np.array(periods) > 0, periods, extent)
        size = np.minimum(TRIAL_BLOCK_PERIODS * cell, extent)
        trials = [cell / n for n in SAMPLES_PER_PERIOD_TRIALS]
        what = f"{SAMPLES_PER_PERIOD_TRIALS[-1]} samples per period"
    else:
        size = extent
        trials = [np.full(3, extent.max() / n) for n in SAMPLES_ALONG_DOMAIN_TRIALS]
        what = f"{SAMPLES_ALONG_DOMAIN_TRIALS[-1]} samples along the domain"
    low = np.array(domain[0])

    def read(spacing: Array) -> tuple[int, int, float]:
        x, y, z = (max(4, int(n)) for n in np.ceil(size / spacing) + 1)
        values = sample_field(
            structure, SampleGrid(_as_triple(low), _as_triple(low + size), (x, y, z)), f"structure {index}"
        )
        seen = count_defects(values)
        return seen.n0, seen.n2, float(np.mean(values <= 0))

    n0, n2, solid = read(trials[-1])
    least = VOLUME_TOL_FRACTION * min(solid, 1 - solid)
    for spacing in trials[:-1]:
        seen = [read(spacing), read(np.maximum(spacing / 2, trials[-1]))]
        if all(a <= n0 and b <= n2 and abs(c - solid) <= least for a, b, c in seen):
            return spacing
    raise InvalidRequest(
        f"structure {index} has parts too thin for {what}: its components still change there; give a resolution, or thicken it"
    )


def _as_triple(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
