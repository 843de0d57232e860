"""What is wrong with a request, said before anything is computed: regions, blending regions, sampling."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tpmscad._typing import BoolArray
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.defects import count_defects
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.errors import InvalidRequest
from tpmscad.fields.sample_grid import FieldFunction, SampleGrid, sample_field

OVERLAP_TOL_FRACTION = 1e-9
"""Depth, in parts of the domain, to which two regions may both hold a point: faces that touch do by round-off."""

MIN_ALIASED_DEFECTS = 3
"""Isolated parts from which on an input may be called under-sampled; one or two may be slivers at the border of the domain, which
are reported as intrinsic."""

MIN_ALIASED_FRACTION = 0.02
"""Part of a phase in isolated parts that vanish so: chips at the skin of a trimmed model come and go, too, but
are a few thousandths."""

MIN_SAMPLES_PER_PERIOD, RECOMMENDED_SAMPLES_PER_PERIOD = 4, 10
"""Samples per period under which a periodic structure is refused outright, and those that do for most of them."""

MAX_SEARCH_SAMPLES = 8_000_000
"""Samples up to which a sufficient resolution is searched for."""


def check_counts(structures: int, regions: int, blending: int) -> None:
    if structures < 2:
        raise InvalidRequest(f"{structures} structure given: a blend takes two or more")
    if regions != structures:
        raise InvalidRequest(f"{regions} regions for {structures} structures: one region per structure is needed")
    if blending != structures - 1:
        raise InvalidRequest(
            f"{blending} blending regions for {structures} structures: {structures - 1} are needed, the one of number k "
            "joining structure k + 1 to those before it"
        )


def check_regions(field: BlendedField, grid: SampleGrid) -> None:
    """Regions hold samples, do not overlap, and each blending region touches what it joins."""
    values = [sample_field(region, grid, f"region {k}") for k, region in enumerate(field.regions)]
    blending = [sample_field(region, grid, f"blending region {k}") <= 0 for k, region in enumerate(field.blending)]
    slack = OVERLAP_TOL_FRACTION * float(np.max(grid.extent))
    for k, value in enumerate(values):
        if not np.any(value <= 0):
            raise InvalidRequest(
                f"region {k} is empty: it holds no sample of the domain {grid.low} to {grid.high} at {grid.shape}"
            )
        for other in range(k):
            both = (value < -slack) & (values[other] < -slack)
            if both.any():
                where = ", ".join(f"{c:g}" for c in grid.points(int(np.flatnonzero(both)[0])).ravel())
                raise InvalidRequest(
                    f"regions {other} and {k} overlap in {int(both.sum())} of {both.size} samples, first at ({where}): cut one "
                    "back to where the other starts; what they are to share is the blending region"
                )
    for k, mask in enumerate(blending):
        if not mask.any():
            raise InvalidRequest(f"blending region {k} is empty: it holds no sample of the domain at {grid.shape}")
        wide: BoolArray = ndimage.binary_dilation(mask)
        if not any(np.any(wide & (values[j] <= slack)) for j in range(k + 1)):
            raise InvalidRequest(
                f"blending region {k} does not touch any of the regions 0 to {k} that it joins to region {k + 1}"
            )
        if not np.any(wide & (values[k + 1] <= slack)):
            raise InvalidRequest(f"blending region {k} does not touch region {k + 1}, which it joins")


def check_sampling(field: BlendedField, coarse: SampledComposition, fine: SampledComposition) -> None:
    """Inputs keep their components and cavities when the samples are doubled; otherwise the resolution that would do."""
    for index, structure in enumerate(field.structures):
        _check_period(structure, index, coarse.grid)
        here, share = _count_own_defects(coarse, index)
        if here < MIN_ALIASED_DEFECTS or share < MIN_ALIASED_FRACTION:
            continue
        there, finer_share = _count_own_defects(fine, index)
        if share - finer_share >= MIN_ALIASED_FRACTION:
            raise InvalidRequest(
                f"structure {index} is under-sampled at {coarse.grid.shape}: {here} isolated components and holes there, {there} "
                f"at twice the samples; a resolution of {_find_sufficient_resolution(structure, fine.grid, there)} would do"
            )


def _check_period(structure: FieldFunction, index: int, grid: SampleGrid) -> None:
    periods = getattr(structure, "periods", lambda: None)()
    if periods is None:
        return
    per_period = [period / step for period, step in zip(periods, grid.spacing, strict=True) if period > 0]
    if per_period and min(per_period) < MIN_SAMPLES_PER_PERIOD:
        enough = tuple(
            max(n, int(np.ceil(RECOMMENDED_SAMPLES_PER_PERIOD * length / period)) + 1 if period > 0 else 0)
            for n, length, period in zip(grid.shape, grid.extent, periods, strict=True)
        )
        raise InvalidRequest(
            f"structure {index} is under-sampled at {grid.shape}: {min(per_period):.1f} samples per period, at least "
            f"{MIN_SAMPLES_PER_PERIOD} are needed; a resolution of {enough} would do"
        )


def _count_own_defects(scene: SampledComposition, index: int) -> tuple[int, float]:
    """Errors of a structure by itself, and the part of its solid and void samples where it takes part that are in them."""
    values = scene.structures[index]
    whole = count_defects(values)
    count = whole.n0 + whole.n2
    if count < MIN_ALIASED_DEFECTS:
        return count, 0.0
    phases = values <= 0, values > 0
    part = (scene.owner == index) | scene.movable()
    shares = [
        np.sum(mask & part) / max(np.sum(phase), 1)
        for mask, phase in zip(scene.own[index], phases, strict=True)
        if mask is not None
    ]
    return count, float(max(shares))


def _find_sufficient_resolution(structure: FieldFunction, grid: SampleGrid, count: int) -> str:
    """The first doubling of the grid whose census agrees with that of the next."""
    while 8 * grid.size <= MAX_SEARCH_SAMPLES:
        finer = grid.double_samples()
        seen = count_defects(sample_field(structure, finer))
        if count - seen.n0 - seen.n2 < MIN_ALIASED_DEFECTS:
            return f"{grid.shape}"
        grid, count = finer, seen.n0 + seen.n2
    return f"more than {grid.shape}"
