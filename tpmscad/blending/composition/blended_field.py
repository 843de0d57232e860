"""Structures, regions, blending regions and weights as one field (porous blending, eqs 2, 6 and 8 and Algorithm 3).

Stage k of Algorithm 3 blends the field so far with structure k + 1. In blending region k the result is
f = (1 - w_k) f_so_far + w_k f_(k+1); elsewhere it is, bit for bit, the structure of the region that holds the point.

Where blending regions overlap, a later stage starts from the field of the earlier ones also inside regions that these did not yet
know. Stage k is therefore continued into all later regions, with its weight extended as its spline defines it. The later stages
replace what it leaves there outside their own blending regions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.blending.weights.weight_protocol import WeightFunction, trace_function
from tpmscad.fields import Field
from tpmscad.fields.data.sample_grid import BoxBounds
from tpmscad.fields.field import CompositeField, ConstantField
from tpmscad.fields.tape.tape_nodes import Node, clamp, select


@dataclass(frozen=True, slots=True, eq=False)
class BlendedField(CompositeField):
    """A blend as a field: f(points (..., 3)) -> (...), solid where f < 0, with its exact gradient (..., 3).

    Outside the blending regions the values are those of the region's structure, bit for bit: every structure is evaluated at the
    points as given, and its values are selected, not combined. A point in no region belongs to the region with the least value;
    a point in two regions, to the first of these. `domain` is the box that was blended. Beyond it regions and weights take their
    values at the nearest point of the box, so that the solid can be cut exactly at the box's faces.

    `level_shifts` holds a function for each stage, or None, that is added to the field where the stage mixes; empty for none.
    """

    regions: tuple[Field, ...]
    blending_regions: tuple[Field, ...]
    weights: tuple[WeightFunction, ...]
    level_shifts: tuple[WeightFunction | None, ...] = ()
    domain: BoxBounds | None = None

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape; each structure and weight is evaluated only where the result depends on it."""
        recorder, clamped = x.recorder, [x, y, z]
        if self.domain is not None:
            clamped = [clamp(t, low, high) for t, low, high in zip(clamped, *self.domain, strict=True)]
        region = _trace_region_index(self.regions, clamped)
        blended = [each.trace(*clamped) <= 0.0 for each in self.blending_regions]
        is_later = [region > float(stage) for stage in range(len(self.weights))]
        is_mixed = [blended[stage] | (region > stage + 1.0) for stage in range(len(self.weights))]
        # where the value before each stage, and that after the last one, counts; found from the last one back
        is_needed = [recorder.constant(1.0)]
        for later, mixed in zip(reversed(is_later), reversed(is_mixed), strict=True):
            is_needed.insert(0, is_needed[0] & (mixed | (later <= 0.0)))
        with recorder.where(is_needed[0]):
            value = self.structures[0].trace(x, y, z)
        for stage, weight in enumerate(self.weights):
            needed = is_needed[stage + 1]
            with recorder.where(needed & (is_later[stage] | is_mixed[stage])):
                next_value = self.structures[stage + 1].trace(x, y, z)
            with recorder.where(needed & is_mixed[stage]):
                w = trace_function(weight, clamped)
                mixed_value = (1.0 - w) * value + w * next_value
                if (level_shift := self._level_shift(stage)) is not None:
                    mixed_value = mixed_value + trace_function(level_shift, clamped)
            value = select(is_mixed[stage], mixed_value, select(is_later[stage], next_value, value))
        return value

    def weight_of(self, structure: int) -> BlendedField:
        """The weight that a structure has in f, as a field: exactly 0 or 1 where the structures are not mixed."""
        shares = (ConstantField(float(k == structure)) for k in range(len(self.structures)))
        return replace(self, structures=tuple(shares), level_shifts=())

    def structure_weights(self, points: ArrayLike) -> Array:
        """The weight that each of the n structures has in f at points (..., 3): (..., n), with sum 1."""
        return np.stack([self.weight_of(k)(points) for k in range(len(self.structures))], axis=-1)

    def with_weights(self, weights: Sequence[WeightFunction]) -> BlendedField:
        """The field with other weights, one for each stage."""
        return replace(self, weights=tuple(weights))

    def with_level_shifts(self, level_shifts: Sequence[WeightFunction | None]) -> BlendedField:
        """The field with other level shifts, one or None for each stage."""
        return replace(self, level_shifts=tuple(level_shifts))

    def _level_shift(self, stage: int) -> WeightFunction | None:
        return self.level_shifts[stage] if self.level_shifts else None


def _trace_region_index(regions: Sequence[Field], point: Sequence[Node]) -> Node:
    """Index of the region with the least value, the first of equal ones, on the nodes of a tape."""
    values = [region.trace(*point) for region in regions]
    lowest, index = values[0], point[0].recorder.constant(0.0)
    for k, value in enumerate(values[1:], start=1):
        is_lower = value < lowest
        index = select(is_lower, index.recorder.constant(k), index)
        lowest = select(is_lower, value, lowest)
    return index
