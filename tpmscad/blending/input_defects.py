"""Removal of the input structures' own defects from a blended field: isolated components become void, cavities solid.

Each defect gets a cover region, which reaches half way to the rest of its phase and at most a few samples. In the covers of
components the field is replaced by its Boolean difference with the cover, max(f, -cover); in those of cavities by the union,
min(f, cover). Everywhere else it keeps its bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt

from tpmscad._typing import IntArray
from tpmscad.blending.composition.affine_form import find_bounding_window
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.defects import PhaseComponents, count_defects
from tpmscad.blending.optimise.blend_state import GridDefects
from tpmscad.blending.result import BlendResult, DefectCounts
from tpmscad.fields import Field
from tpmscad.fields.data.sample_grid import SampleGrid
from tpmscad.fields.kinds.image_regions import ImageRegion
from tpmscad.fields.tape.tape_nodes import Node, select

MAX_COVER_SAMPLES = 3
"""Distance, in samples, that a cover reaches beyond the samples of its defect."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchedField(Field):
    """A blended field with covers applied: pairs of a region, negative inside, and a sign.

    The sign is that of the defect's phase: +1 for solid that becomes void, -1 for void that becomes solid.
    """

    field: BlendedField
    covers: tuple[tuple[Field, int], ...]

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        value = self.field.trace(x, y, z)
        for cover, sign in self.covers:
            depth = -cover.trace(x, y, z)
            is_replaced = (depth > 0.0) & (depth > sign * value)
            value = select(is_replaced, sign * depth, value)
        return value


def make_cover(phase: PhaseComponents, labels: IntArray, grid: SampleGrid) -> ImageRegion | None:
    """The cover of the components of a phase with these labels; None if there are none."""
    if len(labels) == 0:
        return None
    parts = phase.mask_of(labels)
    window = find_bounding_window(parts, MAX_COVER_SAMPLES + 2)
    parts = parts[window]
    rest = (phase.labels[window] > 0) & ~parts
    step = grid.spacing
    distance = distance_transform_edt(~parts, sampling=step)
    cover = distance - MAX_COVER_SAMPLES * float(step.min())
    if rest.any():
        rest_distance = distance_transform_edt(~rest, sampling=step)
        cover = np.maximum(cover, np.where(parts, -rest_distance / 2, (distance - rest_distance) / 2))
    low = tuple(float(axis[part.start]) for axis, part in zip(grid.axes, window, strict=True))
    return ImageRegion(np.ascontiguousarray(cover), low, tuple(map(float, step)))  # type: ignore[arg-type]


def cover_components(
    field: BlendedField, grid: SampleGrid, components: Sequence[tuple[PhaseComponents, IntArray]]
) -> PatchedField:
    """The field without components of its phases on a grid, given as pairs of a phase and labels."""
    covers = [(make_cover(phase, labels, grid), phase.sign) for phase, labels in components]
    return PatchedField(field, tuple((cover, sign) for cover, sign in covers if cover is not None))


def repair_input_defects(
    result: BlendResult, blended: BlendedField, finest: GridDefects, grids: Sequence[SampleGrid]
) -> BlendResult:
    """The result without the structures' own components and cavities, as counted on the finest grid, and recounted."""
    own = [(phase, np.setdiff1d(phase.defects, charged)) for phase, charged in finest.phases()]
    field = cover_components(blended, grids[-1], own)
    counts = [count_defects(field.on_grid(*grid.axes)) for grid in grids]

    def recount(before: DefectCounts, final: tuple[int, ...]) -> DefectCounts:
        intrinsic = tuple(f - charged for f, charged in zip(final, before.remaining, strict=True))
        return DefectCounts(before.initial, final, intrinsic)

    errors = replace(
        result.errors,
        n0=recount(result.errors.n0, tuple(c.n0 for c in counts)),
        n2=recount(result.errors.n2, tuple(c.n2 for c in counts)),
    )
    note = f"left out: {len(own[0][1])} components and {len(own[1][1])} holes of the inputs' own"
    if n_kept := max(*errors.n0.intrinsic, *errors.n2.intrinsic):
        note += f"; {n_kept} stay: they join the rest at the finest resolution, or lie too close to it"
    return replace(result, field=field, errors=errors, message=f"{result.message}. {note}")
