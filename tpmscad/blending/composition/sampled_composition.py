"""A composition sampled on one grid: the optimiser changes weights only, so structures and regions are sampled once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.composition.affine_form import AffineBlend, GridWindow, find_bounding_window, make_affine_blend
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.defects import PhaseComponents, label_solid, label_void
from tpmscad.blending.weights.volume_weight_fit import StageMasks
from tpmscad.blending.weights.weight_protocol import WeightFunction
from tpmscad.fields.data.sample_grid import SampleGrid, sample_field


@dataclass(frozen=True, eq=False)
class SampledComposition:
    """Samples (nx, ny, nz) of the structures, masks of the blending regions, and the index of each sample's region.

    `level_shifts` are the samples of each stage's level shift on its window, or None; empty for none.
    """

    grid: SampleGrid
    structures: tuple[Array, ...]
    blending_masks: tuple[BoolArray, ...]
    region_index: NDArray[np.int16]
    level_shifts: tuple[Array | None, ...] = ()

    @cached_property
    def mixing_masks(self) -> tuple[BoolArray, ...]:
        """The samples that each stage mixes: those of its blending region and of all later regions."""
        return tuple(mask | (self.region_index > k + 1) for k, mask in enumerate(self.blending_masks))

    @cached_property
    def windows(self) -> tuple[GridWindow, ...]:
        """The smallest block of samples that holds each stage's mixing samples."""
        return tuple(find_bounding_window(mask) for mask in self.mixing_masks)

    @cached_property
    def blending_mask(self) -> BoolArray:
        """The samples in any blending region."""
        return np.logical_or.reduce(self.blending_masks)

    @cached_property
    def unmixed_first_stage(self) -> Array:
        """The field of the first stage outside its mixing samples, which no weight changes."""
        return np.where(self.region_index > 0, self.structures[1], self.structures[0])

    def stage_masks(self, stage: int) -> StageMasks:
        """The samples of a stage's two regions and those that it mixes."""
        mixing = self.mixing_masks[stage]
        first, second = self.region_index <= stage, self.region_index == stage + 1
        return StageMasks(self.grid, first & ~mixing, second & ~mixing, mixing)

    def affine_form(self, weights: Sequence[WeightFunction], stage: int) -> AffineBlend:
        """The field as an affine function of one stage's weight; the other weights are held."""
        value = self.structures[0]
        slope = np.zeros(1)
        for k, mask in enumerate(self.mixing_masks):
            next_value, is_later = self.structures[k + 1], self.region_index > k
            window = self.windows[k]
            mixed = mask[window]
            step = (next_value[window] - value[window])[mixed]
            blended = np.where(is_later, next_value, value)
            if k == stage:
                slope = np.zeros(self.grid.shape)
                slope[window][mixed] = step
                blended[window][mixed] = value[window][mixed] + self._level_shift(k, mixed)
            else:
                w = self._sample_on_window(weights[k], window)[mixed]
                blended[window][mixed] = value[window][mixed] + w * step + self._level_shift(k, mixed)
                if k > stage:
                    kept = slope[window][mixed] * (1 - w)
                    slope = np.where(is_later, 0.0, slope)
                    slope[window][mixed] = kept
            value = blended
        return make_affine_blend(self.grid, value, slope)

    def values(self, weights: Sequence[WeightFunction]) -> Array:
        """Values of the blended field on the grid: (nx, ny, nz)."""
        value = self.structures[0]
        for k, mask in enumerate(self.mixing_masks):
            next_value, window = self.structures[k + 1], self.windows[k]
            mixed = mask[window]
            before = value[window][mixed]
            value = self.unmixed_first_stage.copy() if k == 0 else np.where(self.region_index > k, next_value, value)
            w = self._sample_on_window(weights[k], window)[mixed]
            value[window][mixed] = before + w * (next_value[window][mixed] - before) + self._level_shift(k, mixed)
        return value

    def rms_in_blending_regions(self, values: Array) -> float:
        """Root mean square of values (nx, ny, nz) over the blending regions: the unit of margins of the level."""
        return root_mean_square(values[self.blending_mask])

    @cached_property
    def structure_defects(self) -> tuple[dict[int, BoolArray], ...]:
        """For each structure, the masks of its own defects by the sign of the phase (+1 solid, -1 void), if there are any.

        The defects are those over the whole domain: a sound structure falls apart where its region does.
        """
        return tuple(
            {
                phase.sign: phase.mask_of(phase.defects)
                for phase in (label_solid(values), label_void(values))
                if len(phase.defects)
            }
            for values in self.structures
        )

    def input_defect_labels(self, phase: PhaseComponents) -> IntArray:
        """The defects of a phase that the structures bring with them; the blend is not charged with these.

        A defect is an input defect in two cases: its samples outside the blending regions, of which there are some, all belong to
        defects of the structure there; or it has samples of structures' defects and none of their sound parts (such as the chips
        at the skin of a trimmed model).
        """
        if len(phase.defects) == 0 or not any(phase.sign in masks for masks in self.structure_defects):
            return phase.defects[:0]
        movable = self.blending_mask
        isolated, sound = np.zeros(self.grid.shape, bool), np.zeros(self.grid.shape, bool)
        isolated_outside = np.zeros(self.grid.shape, bool)
        for index, values in enumerate(self.structures):
            in_region = self.region_index == index
            part = ((values <= 0) == (phase.sign > 0)) & (in_region | movable)
            if (defects := self.structure_defects[index].get(phase.sign)) is not None:
                isolated |= defects & part
                isolated_outside |= defects & in_region & ~movable
                part &= ~defects
            sound |= part
        n_outside, n_inherited, n_isolated, n_sound = (
            np.bincount(phase.labels[mask], minlength=phase.n_labels)[phase.defects]
            for mask in (~movable, isolated_outside, isolated, sound)
        )
        return phase.defects[((n_outside > 0) & (n_outside == n_inherited)) | ((n_isolated > 0) & (n_sound == 0))]

    def with_level_shifts(self, level_shifts: Sequence[WeightFunction | None]) -> SampledComposition:
        """The composition with these level shifts, one or None for each stage."""
        return replace(
            self,
            level_shifts=tuple(
                None if shift is None else self._sample_on_window(shift, self.windows[k])
                for k, shift in enumerate(level_shifts)
            ),
        )

    def _level_shift(self, stage: int, mixed: BoolArray) -> Array | float:
        shift = self.level_shifts[stage] if self.level_shifts else None
        return 0.0 if shift is None else shift[mixed]

    def _sample_on_window(self, weight: WeightFunction, window: GridWindow) -> Array:
        x, y, z = (axis[part] for axis, part in zip(self.grid.axes, window, strict=True))
        return weight.on_grid(x, y, z)


def root_mean_square(values: Array) -> float:
    """The root mean square of values of any shape."""
    return float(np.sqrt(np.mean(values**2)))


def sample_composition(field: BlendedField, grid: SampleGrid) -> SampledComposition:
    """Samples of a blended field's structures and regions. Raises InvalidRequest if any are not finite or not vectorised."""
    structures = tuple(sample_field(f, grid, f"structure {k}") for k, f in enumerate(field.structures))
    blending_masks = tuple(
        sample_field(f, grid, f"blending region {k}") <= 0 for k, f in enumerate(field.blending_regions)
    )
    lowest_value = sample_field(field.regions[0], grid, "region 0")
    region_index = np.zeros(grid.shape, np.int16)
    for k, region in enumerate(field.regions[1:], 1):
        value = sample_field(region, grid, f"region {k}")
        region_index[value < lowest_value] = k
        np.minimum(lowest_value, value, out=lowest_value)
    return SampledComposition(grid, structures, blending_masks, region_index)
