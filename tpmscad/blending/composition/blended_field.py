"""Structures, regions, blending regions and weights as one field (porous blending, eqs 2, 6 and 8, Algorithm 3).

Stage k joins what there is so far with structure k + 1 in blending region k: there f = (1 - w) f_so_far + w f_next; elsewhere the
structure of the region the point is in, taken over unchanged. Where a later region is, stage k mixes too, its weight continued:
that is what the later stage starts from in its own blending region, and nothing of it is left outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.weights.volume_weight import VolumeWeight
from tpmscad.fields import Field
from tpmscad.fields.function_field import FunctionField
from tpmscad.fields.sample_grid import BoxBounds


class WeightFunction(Protocol):
    """A weight as the field needs it: w(points (..., 3)) in [0, 1] and its gradient (..., 3)."""

    def __call__(self, points: ArrayLike) -> Array: ...

    def gradient(self, points: ArrayLike) -> Array: ...

    def on_grid(self, x: Array, y: Array, z: Array) -> Array: ...


@dataclass(frozen=True, slots=True, eq=False)
class BlendedField(Field):
    """The blended field f(points (..., 3)) -> (...), solid where f < 0, and its exact gradient (..., 3).

    Outside the blending regions the values are those of the structure of that region, bit for bit: every structure is called
    with the very points given, and its values are selected, not combined. A point in no region takes the region that is nearest
    by the regions' own values; of two regions, the first. Beyond the box that was blended (`domain`) regions and weights go on
    as they are at its nearest point, so that bodies may fill it to its faces.
    """

    structures: tuple[Field, ...]
    regions: tuple[Field, ...]
    blending: tuple[Field, ...]
    weights: tuple[WeightFunction, ...]
    shifts: tuple[WeightFunction | None, ...] = ()
    """What is added to the field where a stage mixes: functions like the weights, but of any value; none if empty."""
    domain: BoxBounds | None = None

    def __call__(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        return self._joined(points, [_evaluate_structure(structure, points) for structure in self.structures])

    def at(self, x: Array, y: Array, z: Array) -> Array:
        values = [
            np.broadcast_to(s.at(x, y, z), np.broadcast_shapes(x.shape, y.shape, z.shape)) for s in self.structures
        ]
        return self._joined(np.stack(np.broadcast_arrays(x, y, z), axis=-1), values)

    def jet(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array, Array]:
        points = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
        place = self.place(points)
        moves = place == points
        owner = self._owner(place)
        value, slope = self.structures[0].value_and_gradient(points)
        for stage, (blending, weight) in enumerate(zip(self.blending, self.weights, strict=True)):
            following, rise = self.structures[stage + 1].value_and_gradient(points)
            here = is_inside(blending, place) | (owner > stage + 1)
            w, dw = _weight_value_and_gradient(weight, place[here])
            dw = np.where(moves[here], dw, 0.0)
            mixed = (1 - w)[:, None] * slope[here] + w[:, None] * rise[here] + (following - value)[here][:, None] * dw
            blended = (1 - w) * value[here] + w * following[here]
            if (shift := self._shift(stage)) is not None:
                more, rising = _weight_value_and_gradient(shift, place[here])
                blended, mixed = blended + more, mixed + np.where(moves[here], rising, 0.0)
            later = owner > stage
            value, slope = np.where(later, following, value), np.where(later[..., None], rise, slope)
            value[here], slope[here] = blended, mixed
        return value, slope[..., 0], slope[..., 1], slope[..., 2]

    def owner(self, points: Array) -> IntArray:
        """The number of the region each point is in or nearest to: (...)."""
        return self._owner(self.place(points))

    def _owner(self, place: Array) -> IntArray:
        return np.argmin(np.stack([np.asarray(region(place), float) for region in self.regions]), axis=0)

    def place(self, points: Array) -> Array:
        """Where regions and weights are looked up for points (..., 3): there, or at the nearest point of the domain."""
        return points if self.domain is None else np.clip(points, *self.domain)

    def shares(self, points: ArrayLike) -> Array:
        """The part each structure has in f: (..., n), summing to 1."""
        points = np.asarray(points, float)
        unit = np.eye(len(self.structures))
        return np.stack(
            [self._joined(points, [np.full(points.shape[:-1], c) for c in column], shifted=False) for column in unit],
            axis=-1,
        )

    def with_weights(self, weights: Sequence[WeightFunction]) -> BlendedField:
        return replace(self, weights=tuple(weights))

    def with_shifts(self, shifts: Sequence[WeightFunction | None]) -> BlendedField:
        return replace(self, shifts=tuple(shifts))

    def _shift(self, stage: int) -> WeightFunction | None:
        return self.shifts[stage] if self.shifts else None

    def _joined(self, points: Array, values: list[Array], shifted: bool = True) -> Array:
        place = self.place(points)
        owner = self._owner(place)
        joined = values[0]
        for stage, (blending, weight) in enumerate(zip(self.blending, self.weights, strict=True)):
            here = is_inside(blending, place) | (owner > stage + 1)
            w = weight(place[here])
            blended = (1 - w) * joined[here] + w * values[stage + 1][here]
            if (shift := self._shift(stage)) is not None and shifted:
                blended = blended + shift(place[here])
            joined = np.where(owner > stage, values[stage + 1], joined)
            joined[here] = blended
        return joined


@dataclass(frozen=True, slots=True, eq=False)
class StageWeight:
    """The weight of one stage over all space: its spline inside the blending region, exactly 0 or 1 outside."""

    field: BlendedField
    stage: int

    def __call__(self, points: ArrayLike) -> Array:
        place, owner, here = self._mixed(points)
        value = (owner > self.stage).astype(float)
        value[here] = self.field.weights[self.stage](place[here])
        return value

    def gradient(self, points: ArrayLike) -> Array:
        place, _, here = self._mixed(points)
        slope = np.zeros(place.shape)
        slope[here] = self.field.weights[self.stage].gradient(place[here])
        return np.where(place == np.asarray(points, float), slope, 0.0)

    def _mixed(self, points: ArrayLike) -> tuple[Array, IntArray, BoolArray]:
        """Where the weight is looked up, in which regions that is, and where the weight is that of its spline."""
        place = self.field.place(np.asarray(points, float))
        owner = self.field.owner(place)
        return place, owner, is_inside(self.field.blending[self.stage], place) | (owner > self.stage + 1)


def is_inside(region: Field, points: Array) -> BoolArray:
    return np.asarray(region(points), float) <= 0


def _weight_value_and_gradient(weight: WeightFunction, points: Array) -> tuple[Array, Array]:
    if isinstance(weight, VolumeWeight):
        return weight.value_and_gradient(points)
    return weight(points), weight.gradient(points)


def _evaluate_structure(structure: Field, points: Array) -> Array:
    """Values as the caller would get them: a foreign function is called with all the points at once, not in slabs."""
    if isinstance(structure, FunctionField) and not structure.split:
        values = np.asarray(structure.function(points), float)
        if values.shape == points.shape[:-1]:
            return values
    return structure(points)
