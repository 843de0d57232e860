"""The inputs' own isolated parts left out of a blended field: chips made void, closed holes made solid.

Around each such part lies a cover, half way to the rest of its phase and at most a few samples wide. In a cover the field is the
field without the cover, max(f, -cover) (of holes: min(f, cover)); everywhere else it keeps its bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt

from tpmscad._typing import Array, IntArray
from tpmscad.blending.composition.affine_form import find_bounding_window
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.defects import PhaseComponents, count_defects
from tpmscad.blending.optimise.optimiser import GridDefects
from tpmscad.blending.result import BlendResult, DefectCounts
from tpmscad.fields import Field
from tpmscad.fields.image_regions import ImageRegion
from tpmscad.fields.sample_grid import SampleGrid

MAX_COVER_SAMPLES = 3
"""Samples that a cover reaches beyond the samples of its part."""


@dataclass(frozen=True, slots=True, eq=False)
class CoveredField(Field):
    """A blended field without the parts in its covers; each cover is a field, negative inside, with the sign of its part: +1 for
    solid that is left out, -1 for void that is filled."""

    field: BlendedField
    covers: tuple[tuple[Field, int], ...]

    def __call__(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        value = self.field(points)
        for cover, sign in self.covers:
            around = cover(points)
            value = np.where(around < 0, sign * np.maximum(sign * value, -around), value)
        return value

    def at(self, x: Array, y: Array, z: Array) -> Array:
        value = self.field.at(x, y, z)
        for cover, sign in self.covers:
            around = cover.at(x, y, z)
            value = np.where(around < 0, sign * np.maximum(sign * value, -around), value)
        return value

    def jet(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array, Array]:
        value, *slopes = self.field.jet(x, y, z)
        for cover, sign in self.covers:
            around, *rates = cover.jet(x, y, z)
            replaced = (around < 0) & (-around > sign * value)
            value = np.where(replaced, -sign * around, value)
            slopes = [np.where(replaced, -sign * rate, slope) for slope, rate in zip(slopes, rates, strict=True)]
        return value, slopes[0], slopes[1], slopes[2]


def make_cover(phase: PhaseComponents, labels: IntArray, grid: SampleGrid) -> ImageRegion | None:
    """The cover of the parts of a phase with these labels; None if there are none."""
    if len(labels) == 0:
        return None
    parts = phase.of(labels)
    window = find_bounding_window(parts, MAX_COVER_SAMPLES + 2)
    parts = parts[window]
    rest = (phase.labels[window] > 0) & ~parts
    step = grid.spacing
    distance = distance_transform_edt(~parts, sampling=step)
    cover = distance - MAX_COVER_SAMPLES * float(step.min())
    if rest.any():
        apart = distance_transform_edt(~rest, sampling=step)
        cover = np.maximum(cover, np.where(parts, -apart / 2, (distance - apart) / 2))
    low = tuple(float(axis[part.start]) for axis, part in zip(grid.axes, window, strict=True))
    return ImageRegion(np.ascontiguousarray(cover), low, tuple(map(float, step)))  # type: ignore[arg-type]


def cover_components(
    field: BlendedField, grid: SampleGrid, parts: Sequence[tuple[PhaseComponents, IntArray, int]]
) -> CoveredField:
    """The field without parts of its phases: of each phase, the labels on the grid and its sign (+1 solid, -1 void)."""
    covers = [(make_cover(phase, labels, grid), sign) for phase, labels, sign in parts]
    return CoveredField(field, tuple((cover, sign) for cover, sign in covers if cover is not None))


def remove_input_defects(
    result: BlendResult, blended: BlendedField, last: GridDefects, grids: Sequence[SampleGrid]
) -> BlendResult:
    """The result with the inputs' own parts left out that the last view, of the finest of the grids, has; errors counted anew."""
    phases = (last.census.solid, last.solid, 1), (last.census.void, last.void, -1)
    own = [(phase, np.setdiff1d(phase.errors, blamed), sign) for phase, blamed, sign in phases]
    field = cover_components(blended, grids[-1], own)
    counts = [count_defects(field.on_grid(*grid.axes)) for grid in grids]

    def again(before: DefectCounts, final: tuple[int, ...]) -> DefectCounts:
        return DefectCounts(before.initial, final, tuple(f - left for f, left in zip(final, before.left, strict=True)))

    errors = replace(
        result.errors,
        n0=again(result.errors.n0, tuple(c.n0 for c in counts)),
        n2=again(result.errors.n2, tuple(c.n2 for c in counts)),
    )
    told = f"left out: {len(own[0][1])} components and {len(own[1][1])} holes of the inputs' own"
    if stay := max(*errors.n0.intrinsic, *errors.n2.intrinsic):
        told += f"; {stay} stay, which hang together with the rest at the finest resolution or lie too close to it"
    return replace(result, field=field, errors=errors, message=f"{result.message}. {told}")
