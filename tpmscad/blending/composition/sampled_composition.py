"""A composition read once on a grid: the optimiser changes weights only, so structures and regions are sampled once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.composition.affine_form import AffineBlend, GridWindow, find_bounding_window, make_affine_blend
from tpmscad.blending.composition.blended_field import BlendedField, WeightFunction
from tpmscad.blending.composition.defects import PhaseComponents, label_solid, label_void
from tpmscad.fields.sample_grid import SampleGrid, sample_field


@dataclass(frozen=True, eq=False)
class SampledComposition:
    """Samples of every structure (s, nx, ny, nz), of the blending regions, and the owner of each sample."""

    grid: SampleGrid
    structures: tuple[Array, ...]
    blending: tuple[BoolArray, ...]
    owner: NDArray[np.int16]
    shifts: tuple[Array | None, ...] = ()
    """Of each stage what is added where it mixes, on its window."""

    @cached_property
    def windows(self) -> tuple[GridWindow, ...]:
        """The block of samples of each blending region."""
        return tuple(find_bounding_window(mask) for mask in self.mixing_masks)

    @cached_property
    def unmixed(self) -> Array:
        """The first stage's field without its mixing: it does not change with the weights."""
        return np.where(self.owner > 0, self.structures[1], self.structures[0])

    @cached_property
    def mixing_masks(self) -> tuple[BoolArray, ...]:
        """The samples where the weight of each stage counts: its blending region and the later regions."""
        return tuple(mask | (self.owner > k + 1) for k, mask in enumerate(self.blending))

    def sampled(self, weights: Sequence[WeightFunction], stage: int) -> AffineBlend:
        """The final field as an affine function of one stage's weight, the others held."""
        value = self.structures[0]
        slope = np.zeros(1)
        for k, mask in enumerate(self.mixing_masks):
            following, later = self.structures[k + 1], self.owner > k
            part = self.windows[k]
            here = mask[part]
            step = (following[part] - value[part])[here]
            joined = np.where(later, following, value)
            if k == stage:
                slope = np.zeros(self.grid.shape)
                slope[part][here] = step
                joined[part][here] = value[part][here] + self._shift(k, here)
            else:
                w = self._weight(weights[k], part)[here]
                joined[part][here] = value[part][here] + w * step + self._shift(k, here)
                if k > stage:
                    kept = slope[part][here] * (1 - w)
                    slope = np.where(later, 0.0, slope)
                    slope[part][here] = kept
            value = joined
        return make_affine_blend(self.grid, value, slope)

    def values(self, weights: Sequence[WeightFunction]) -> Array:
        """The final field on the grid."""
        value = self.structures[0]
        for k, mask in enumerate(self.mixing_masks):
            following, part = self.structures[k + 1], self.windows[k]
            here = mask[part]
            before = value[part][here]
            value = self.unmixed.copy() if k == 0 else np.where(self.owner > k, following, value)
            w = self._weight(weights[k], part)[here]
            value[part][here] = before + w * (following[part][here] - before) + self._shift(k, here)
        return value

    def movable(self) -> BoolArray:
        """Samples in any blending region."""
        return np.logical_or.reduce(self.blending)

    @cached_property
    def own(self) -> tuple[tuple[BoolArray | None, BoolArray | None], ...]:
        """Of each structure by itself, samples of its isolated components and of its cavities; None where it has none.

        By itself, that is over the whole domain: cut to its region a sound structure falls apart where the region does.
        """
        found = []
        for values in self.structures:
            phases = label_solid(values), label_void(values)
            solid, void = (phase.of(phase.errors) if len(phase.errors) else None for phase in phases)
            found.append((solid, void))
        return tuple(found)

    def intrinsic(self, phase: PhaseComponents, sign: int) -> IntArray:
        """The error labels of a phase that the inputs bring with them.

        Outside the blending regions these hold samples of the isolated parts of their own structure only, and do hold some; or
        anywhere they hold samples of such parts and none of the sound parts of any structure (chips at the skin of a model).
        """
        which = 0 if sign > 0 else 1
        if len(phase.errors) == 0 or all(masks[which] is None for masks in self.own):
            return phase.errors[:0]
        movable = self.movable()
        own, sound = np.zeros(self.grid.shape, bool), np.zeros(self.grid.shape, bool)
        own_outside = np.zeros(self.grid.shape, bool)
        for index, values in enumerate(self.structures):
            owned = self.owner == index
            part = ((values <= 0) == (sign > 0)) & (owned | movable)
            if (errors := self.own[index][which]) is not None:
                own |= errors & part
                own_outside |= errors & owned & ~movable
                part &= ~errors
            sound |= part
        outside, inherited, isolated, joined = (
            np.bincount(phase.labels[mask], minlength=phase.count)[phase.errors]
            for mask in (~movable, own_outside, own, sound)
        )
        return phase.errors[((outside > 0) & (outside == inherited)) | ((isolated > 0) & (joined == 0))]

    def with_shifts(self, shifts: Sequence[WeightFunction | None]) -> SampledComposition:
        """The scene with these added where the stages mix."""
        return replace(
            self, shifts=tuple(None if s is None else self._weight(s, self.windows[k]) for k, s in enumerate(shifts))
        )

    def _shift(self, stage: int, here: BoolArray) -> Array | float:
        shift = self.shifts[stage] if self.shifts else None
        return 0.0 if shift is None else shift[here]

    def _weight(self, weight: WeightFunction, part: GridWindow) -> Array:
        x, y, z = (axis[s] for axis, s in zip(self.grid.axes, part, strict=True))
        return weight.on_grid(x, y, z)


def sample_composition(field: BlendedField, grid: SampleGrid) -> SampledComposition:
    """Samples of a composition. Raises InvalidRequest for fields that are not finite or not vectorised."""
    structures = tuple(sample_field(f, grid, f"structure {k}") for k, f in enumerate(field.structures))
    blending = tuple(sample_field(f, grid, f"blending region {k}") <= 0 for k, f in enumerate(field.blending))
    least = sample_field(field.regions[0], grid, "region 0")
    owner = np.zeros(grid.shape, np.int16)
    for k, region in enumerate(field.regions[1:], 1):
        value = sample_field(region, grid, f"region {k}")
        owner[value < least] = k
        np.minimum(least, value, out=least)
    return SampledComposition(grid, structures, blending, owner)
