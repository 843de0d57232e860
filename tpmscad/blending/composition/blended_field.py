"""Structures, regions, blending regions and weights as one field (porous blending, eqs 2, 6 and 8 and Algorithm 3).

Stage k of Algorithm 3 blends the field so far with structure k + 1. In blending region k the result is
f = (1 - w_k) f_so_far + w_k f_(k+1); elsewhere it is, bit for bit, the structure of the region that holds the point.

Where blending regions overlap, a later stage starts from the field of the earlier ones also inside regions that these did not yet
know. Stage k is therefore continued into all later regions, with its weight extended as its spline defines it. The later stages
replace what it leaves there outside their own blending regions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.weights.volume_weight import VolumeWeight
from tpmscad.blending.weights.weight_protocol import WeightFunction
from tpmscad.fields import Field
from tpmscad.fields.field import FunctionField
from tpmscad.fields.sample_grid import BoxBounds


@dataclass(frozen=True, slots=True, eq=False)
class BlendedField(Field):
    """A blend as a field: f(points (..., 3)) -> (...), solid where f < 0, with its exact gradient (..., 3).

    Outside the blending regions the values are those of the region's structure, bit for bit: every structure is evaluated at the
    points as given, and its values are selected, not combined. A point in no region belongs to the region with the least value;
    a point in two regions, to the first of these. `domain` is the box that was blended. Beyond it regions and weights take their
    values at the nearest point of the box, so that the solid can be cut exactly at the box's faces.

    `level_shifts` holds a function for each stage, or None, that is added to the field where the stage mixes; empty for none.
    """

    structures: tuple[Field, ...]
    regions: tuple[Field, ...]
    blending_regions: tuple[Field, ...]
    weights: tuple[WeightFunction, ...]
    level_shifts: tuple[WeightFunction | None, ...] = ()
    domain: BoxBounds | None = None

    def __call__(self, points: ArrayLike) -> Array:
        """Values (...) at points (..., 3)."""
        points = np.asarray(points, float)
        return self._blend(points, [_evaluate_structure(structure, points) for structure in self.structures])

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at broadcast coordinates x, y, z."""
        shape = np.broadcast_shapes(x.shape, y.shape, z.shape)
        values = [np.broadcast_to(structure.at(x, y, z), shape) for structure in self.structures]
        return self._blend(np.stack(np.broadcast_arrays(x, y, z), axis=-1), values)

    def jet(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array, Array]:
        """Values and the derivatives by x, y and z at broadcast coordinates."""
        points = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
        clamped = self.clamp_to_domain(points)
        is_inside_domain = clamped == points
        value, slope = self.structures[0].value_and_gradient(points)
        for stage, mixed, is_later in self._stages(clamped):
            next_value, next_slope = self.structures[stage + 1].value_and_gradient(points)
            w, dw = _weight_value_and_gradient(self.weights[stage], clamped[mixed])
            dw = np.where(is_inside_domain[mixed], dw, 0.0)
            mixed_slope = (
                (1 - w)[:, None] * slope[mixed]
                + w[:, None] * next_slope[mixed]
                + (next_value - value)[mixed][:, None] * dw
            )
            mixed_value = (1 - w) * value[mixed] + w * next_value[mixed]
            if (level_shift := self._level_shift(stage)) is not None:
                shift, shift_slope = _weight_value_and_gradient(level_shift, clamped[mixed])
                mixed_value = mixed_value + shift
                mixed_slope = mixed_slope + np.where(is_inside_domain[mixed], shift_slope, 0.0)
            value = np.where(is_later, next_value, value)
            slope = np.where(is_later[..., None], next_slope, slope)
            value[mixed], slope[mixed] = mixed_value, mixed_slope
        return value, slope[..., 0], slope[..., 1], slope[..., 2]

    def region_index(self, points: Array) -> IntArray:
        """Index of the region that holds each point (..., 3), or else of that with the least value: (...)."""
        return self._region_index(self.clamp_to_domain(points))

    def clamp_to_domain(self, points: Array) -> Array:
        """The points (..., 3) at which regions and weights are evaluated: the nearest ones of the domain."""
        return points if self.domain is None else np.clip(points, *self.domain)

    def structure_weights(self, points: ArrayLike) -> Array:
        """The weight that each of the n structures has in f at points (..., 3): (..., n), with sum 1."""
        points = np.asarray(points, float)
        unit = np.eye(len(self.structures))
        return np.stack(
            [self._blend(points, [np.full(points.shape[:-1], c) for c in column], shifted=False) for column in unit],
            axis=-1,
        )

    def with_weights(self, weights: Sequence[WeightFunction]) -> BlendedField:
        """The field with other weights, one for each stage."""
        return replace(self, weights=tuple(weights))

    def with_level_shifts(self, level_shifts: Sequence[WeightFunction | None]) -> BlendedField:
        """The field with other level shifts, one or None for each stage."""
        return replace(self, level_shifts=tuple(level_shifts))

    def _region_index(self, clamped: Array) -> IntArray:
        return np.argmin(np.stack([np.asarray(region(clamped), float) for region in self.regions]), axis=0)

    def _level_shift(self, stage: int) -> WeightFunction | None:
        return self.level_shifts[stage] if self.level_shifts else None

    def _stages(self, clamped: Array) -> Iterator[tuple[int, BoolArray, BoolArray]]:
        """Each stage with the masks of the points that it mixes and of those in later regions than its first."""
        region = self._region_index(clamped)
        for stage, (blending_region, _) in enumerate(zip(self.blending_regions, self.weights, strict=True)):
            yield stage, is_inside(blending_region, clamped) | (region > stage + 1), region > stage

    def _blend(self, points: Array, values: list[Array], shifted: bool = True) -> Array:
        """The values (...) of all structures blended at points (..., 3)."""
        clamped = self.clamp_to_domain(points)
        value = values[0]
        for stage, mixed, is_later in self._stages(clamped):
            w = self.weights[stage](clamped[mixed])
            mixed_value = (1 - w) * value[mixed] + w * values[stage + 1][mixed]
            if shifted and (level_shift := self._level_shift(stage)) is not None:
                mixed_value = mixed_value + level_shift(clamped[mixed])
            value = np.where(is_later, values[stage + 1], value)
            value[mixed] = mixed_value
        return value


@dataclass(frozen=True, slots=True, eq=False)
class StageWeight:
    """The weight of one stage at any point: its spline where the stage mixes, exactly 0 or 1 elsewhere."""

    field: BlendedField
    stage: int

    def __call__(self, points: ArrayLike) -> Array:
        """Weights (...) at points (..., 3)."""
        clamped, region, mixed = self._locate(points)
        value = (region > self.stage).astype(float)
        value[mixed] = self.field.weights[self.stage](clamped[mixed])
        return value

    def gradient(self, points: ArrayLike) -> Array:
        """The exact gradient (..., 3) at points (..., 3); zero outside the blending region and beyond the domain."""
        clamped, _, mixed = self._locate(points)
        slope = np.zeros(clamped.shape)
        slope[mixed] = self.field.weights[self.stage].gradient(clamped[mixed])
        return np.where(clamped == np.asarray(points, float), slope, 0.0)

    def _locate(self, points: ArrayLike) -> tuple[Array, IntArray, BoolArray]:
        """The points clamped to the domain, the indices of their regions, and the mask of those that the stage mixes."""
        clamped = self.field.clamp_to_domain(np.asarray(points, float))
        region = self.field.region_index(clamped)
        return clamped, region, is_inside(self.field.blending_regions[self.stage], clamped) | (region > self.stage + 1)


def is_inside(region: Field, points: Array) -> BoolArray:
    """Mask (...) of the points (..., 3) in a region, that is with values of at most 0."""
    return np.asarray(region(points), float) <= 0


def _weight_value_and_gradient(weight: WeightFunction, points: Array) -> tuple[Array, Array]:
    if isinstance(weight, VolumeWeight):
        return weight.value_and_gradient(points)
    return weight(points), weight.gradient(points)


def _evaluate_structure(structure: Field, points: Array) -> Array:
    """Values as the caller would get them: a foreign function is called with all points at once, so that its bits are kept."""
    if isinstance(structure, FunctionField) and not structure.takes_coordinates:
        values = np.asarray(structure.function(points), float)
        if values.shape == points.shape[:-1]:
            return values
    return structure(points)
