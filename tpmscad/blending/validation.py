"""Checks of a request before anything is optimised: options, numbers of operands, regions and sampling."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tpmscad._typing import Array, BoolArray
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.defects import count_defects
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.sample_grid import SampleGrid, sample_field
from tpmscad.fields.field import Field

OVERLAP_TOL_FRACTION = 1e-9
"""Depth of an overlap of two regions that is taken for round-off, as a fraction of the domain's longest edge."""

MIN_ALIASED_DEFECTS = 3
"""Number of defects from which an input may be under-sampled; fewer may be slivers at the border of the domain."""

MIN_ALIASED_FRACTION = 0.02
"""Fraction of a phase in defects that vanish on the doubled grid from which an input is under-sampled: more than the chips at the
skin of a trimmed model make up."""

MIN_SAMPLES_PER_PERIOD, RECOMMENDED_SAMPLES_PER_PERIOD = 4, 10
"""Samples per period below which a periodic structure is refused, and the number that suffices for most."""

MAX_SEARCH_SAMPLES = 8_000_000
"""Number of samples up to which a sufficient resolution is searched for."""


def check_options(method: str, methods: tuple[str, ...], max_change: float) -> None:
    """Raise InvalidRequest if an option is out of range."""
    if method not in methods:
        raise InvalidRequest(f"method {method!r}: must be one of {', '.join(methods)}")
    if not 0 < max_change <= 1:
        raise InvalidRequest(f"max_change {max_change:g}: must be above 0 and at most 1, the whole range of a weight")


def check_counts(n_structures: int, n_regions: int, n_blending: int) -> None:
    """Raise InvalidRequest if the numbers of structures, regions and blending regions do not fit."""
    if n_structures < 2:
        raise InvalidRequest(f"{n_structures} structure given: a blend takes two or more")
    if n_regions != n_structures:
        raise InvalidRequest(f"{n_regions} regions for {n_structures} structures: one region per structure is needed")
    if n_blending != n_structures - 1:
        raise InvalidRequest(
            f"{n_blending} blending regions for {n_structures} structures: {n_structures - 1} are needed; blending region k "
            "joins structure k + 1 to those before it"
        )


def check_regions(field: BlendedField, grid: SampleGrid) -> None:
    """Raise InvalidRequest if a region is empty, two regions overlap, or a blending region does not touch what it joins."""
    values = [sample_field(region, grid, f"region {k}") for k, region in enumerate(field.regions)]
    masks = [sample_field(region, grid, f"blending region {k}") <= 0 for k, region in enumerate(field.blending_regions)]
    slack = OVERLAP_TOL_FRACTION * float(np.max(grid.extent))
    for k, value in enumerate(values):
        if not np.any(value <= 0):
            raise InvalidRequest(
                f"region {k} is empty: it holds no sample of the domain {grid.low} to {grid.high} at {grid.shape}"
            )
        for other in range(k):
            overlap = (value < -slack) & (values[other] < -slack)
            if overlap.any():
                where = ", ".join(f"{c:g}" for c in grid.points(int(np.flatnonzero(overlap)[0])).ravel())
                raise InvalidRequest(
                    f"regions {other} and {k} overlap in {int(overlap.sum())} of {overlap.size} samples, first at ({where}): cut "
                    "one back to where the other starts; what they are to share is the blending region"
                )
    for k, mask in enumerate(masks):
        if not mask.any():
            raise InvalidRequest(f"blending region {k} is empty: it holds no sample of the domain at {grid.shape}")
        dilated: BoolArray = ndimage.binary_dilation(mask)
        if not any(_touches(dilated, values[j], slack) for j in range(k + 1)):
            raise InvalidRequest(
                f"blending region {k} does not touch any of the regions 0 to {k} that it joins to region {k + 1}"
            )
        if not _touches(dilated, values[k + 1], slack):
            raise InvalidRequest(f"blending region {k} does not touch region {k + 1}, which it joins")


def _touches(dilated: BoolArray, region_values: Array, slack: float) -> bool:
    return bool(np.any(dilated & (region_values <= slack)))


def check_sampling(field: BlendedField, coarse: SampledComposition, fine: SampledComposition) -> None:
    """Raise InvalidRequest, with a sufficient resolution, if a structure loses many of its defects on the doubled grid."""
    for index, structure in enumerate(field.structures):
        _check_period(structure, index, coarse.grid)
        coarse_count, coarse_fraction = _count_structure_defects(coarse, index)
        if coarse_count < MIN_ALIASED_DEFECTS or coarse_fraction < MIN_ALIASED_FRACTION:
            continue
        fine_count, fine_fraction = _count_structure_defects(fine, index)
        if coarse_fraction - fine_fraction >= MIN_ALIASED_FRACTION:
            enough = _find_sufficient_resolution(structure, fine.grid, fine_count)
            raise InvalidRequest(
                f"structure {index} is under-sampled at {coarse.grid.shape}: {coarse_count} isolated components and holes there, "
                f"{fine_count} at twice the samples; a resolution of {enough} would do"
            )


def _check_period(structure: Field, index: int, grid: SampleGrid) -> None:
    periods = structure.periods()
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


def _count_structure_defects(composition: SampledComposition, index: int) -> tuple[int, float]:
    """The number of a structure's own defects, and the greater fraction of a phase that they make up where it is used."""
    values = composition.structures[index]
    census = count_defects(values)
    n_defects = census.n0 + census.n2
    if n_defects < MIN_ALIASED_DEFECTS:
        return n_defects, 0.0
    is_used = (composition.region_index == index) | composition.blending_mask
    fractions = [
        np.sum(mask & is_used) / max(np.sum(values <= 0 if sign > 0 else values > 0), 1)
        for sign, mask in composition.structure_defects[index].items()
    ]
    return n_defects, float(max(fractions))


def _find_sufficient_resolution(structure: Field, grid: SampleGrid, n_defects: int) -> str:
    """The first doubling of the grid at which the number of defects no longer falls."""
    while 8 * grid.size <= MAX_SEARCH_SAMPLES:
        finer = grid.double_samples()
        census = count_defects(sample_field(structure, finer))
        if n_defects - census.n0 - census.n2 < MIN_ALIASED_DEFECTS:
            return f"{grid.shape}"
        grid, n_defects = finer, census.n0 + census.n2
    return f"more than {grid.shape}"
