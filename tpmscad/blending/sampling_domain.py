"""The box to blend in, from the regions, and a working resolution, from the structures.

Boxes, spheres, finite cylinders and their Boolean combinations have bounds. The resolution is found by trials. A periodic
structure is sampled on a block of one and a half periods with 10, 14, ... samples per period, until its numbers of components and
cavities do not exceed those at 80 samples per period, on the trial grid and with half its spacing, and the volume of its smaller
phase has settled. A structure without periods is sampled on the whole domain, from 40 samples along its longest edge to 200.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import Array, triple
from tpmscad.blending.composition.defects import count_defects
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.sample_grid import BoxBounds, FieldFunction, SampleGrid, sample_field
from tpmscad.fields.field import Field, MinMaxField
from tpmscad.fields.kinds.primitive_regions import BoxRegion, CylinderRegion, SphereRegion

SAMPLES_PER_PERIOD_TRIALS = (10, 14, 20, 28, 40, 56, 80)
SAMPLES_ALONG_DOMAIN_TRIALS = (40, 60, 90, 135, 200)

TRIAL_BLOCK_PERIODS = 1.5
"""Edge of the trial block in periods; not an integer, so that the faces of the block cut the structure at different phases."""

VOLUME_TOL_FRACTION = 0.1
"""Relative error of the smaller phase's volume that is accepted: thin walls must be sampled across their thickness."""

MAX_SAMPLES = 12_000_000
"""Number of samples at most; with the check on the doubled grid a blend then takes a minute and 4 GiB."""

MIN_SAMPLES_PER_EDGE, MIN_TRIAL_SAMPLES = 8, 4
"""Samples along an edge of the domain, and of a trial block, at least."""


def resolve_domain(regions: Sequence[FieldFunction], domain: BoxBounds | None) -> BoxBounds:
    """The given box, or the smallest one that holds all regions. Raises InvalidRequest if a region has no bounds."""
    if domain is not None:
        return domain
    boxes = [find_region_bounds(region) for region in regions]
    for index, bounds in enumerate(boxes):
        if not np.isfinite(bounds).all():
            raise InvalidRequest(
                f"region {index} has no bounds: give domain=((x0, y0, z0), (x1, y1, z1)), the box to blend in"
            )
    corners = np.array(boxes)
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    return triple(low.tolist()), triple(high.tolist())


def find_region_bounds(region: FieldFunction) -> Array:
    """Lower and upper bounds of a region along x, y, z: (2, 3); infinite where there are none or they are unknown."""
    if isinstance(region, BoxRegion):
        return np.array([region.lo, region.hi], float)
    if isinstance(region, SphereRegion):
        return np.array(region.center) + np.array([[-region.radius], [region.radius]])
    if isinstance(region, CylinderRegion) and region.height is not None:
        axis = np.array(region.axis)
        half_extent = abs(axis) * region.height / 2 + region.radius * np.sqrt(np.maximum(1 - axis**2, 0))
        return np.array(region.center) + np.array([-half_extent, half_extent])
    if isinstance(region, MinMaxField):
        first, second = find_region_bounds(region.first), find_region_bounds(region.second)
        if region.sign > 0:  # an intersection
            return np.stack([np.maximum(first[0], second[0]), np.minimum(first[1], second[1])])
        return np.stack([np.minimum(first[0], second[0]), np.maximum(first[1], second[1])])
    bounds = getattr(region, "bounds", None)
    return np.array([[-np.inf] * 3, [np.inf] * 3]) if bounds is None else np.array(bounds, float)


def choose_resolution(structures: Sequence[Field], domain: BoxBounds) -> tuple[int, int, int]:
    """Samples along x, y, z that suffice for every structure. Raises InvalidRequest if they exceed MAX_SAMPLES."""
    extent = np.array(domain[1]) - np.array(domain[0])
    spacing = np.full(3, np.inf)
    for index, structure in enumerate(structures):
        spacing = np.minimum(spacing, _find_needed_spacing(structure, index, domain, extent))
    nx, ny, nz = (max(MIN_SAMPLES_PER_EDGE, int(np.ceil(e / s)) + 1) for e, s in zip(extent, spacing, strict=True))
    if nx * ny * nz > MAX_SAMPLES:
        raise InvalidRequest(
            f"the structures need {nx} x {ny} x {nz} samples over the domain, above the limit of {MAX_SAMPLES:,}: give a smaller "
            "domain, or a resolution"
        )
    return nx, ny, nz


def _find_needed_spacing(structure: Field, index: int, domain: BoxBounds, extent: Array) -> Array:
    """The widest trial spacing (3,) that resolves a structure."""
    periods = structure.periods()
    if periods is not None and any(periods):
        cell = np.where(np.array(periods) > 0, periods, extent)
        size = np.minimum(TRIAL_BLOCK_PERIODS * cell, extent)
        trials = [cell / n for n in SAMPLES_PER_PERIOD_TRIALS]
        finest = f"{SAMPLES_PER_PERIOD_TRIALS[-1]} samples per period"
    else:
        size = extent
        trials = [np.full(3, extent.max() / n) for n in SAMPLES_ALONG_DOMAIN_TRIALS]
        finest = f"{SAMPLES_ALONG_DOMAIN_TRIALS[-1]} samples along the domain"
    low = np.array(domain[0])

    def measure(spacing: Array) -> tuple[int, int, float]:
        x, y, z = (max(MIN_TRIAL_SAMPLES, int(n)) for n in np.ceil(size / spacing) + 1)
        grid = SampleGrid(triple(low.tolist()), triple((low + size).tolist()), (x, y, z))
        values = sample_field(structure, grid, f"structure {index}")
        census = count_defects(values)
        return census.n0, census.n2, float(np.mean(values <= 0))

    n0, n2, solid = measure(trials[-1])
    volume_tol = VOLUME_TOL_FRACTION * min(solid, 1 - solid)
    for spacing in trials[:-1]:
        measured = [measure(spacing), measure(np.maximum(spacing / 2, trials[-1]))]
        if all(a <= n0 and b <= n2 and abs(c - solid) <= volume_tol for a, b, c in measured):
            return spacing
    raise InvalidRequest(
        f"structure {index} has parts too thin for {finest}: its components still change there; give a resolution, or thicken it"
    )
