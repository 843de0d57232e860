"""A blend on one grid: f = constant + slope * w, since a blended field is affine in each of its weights.

For two structures constant = f1 and slope = f2 - f1 inside the blending region, and slope = 0 outside it. For one weight of
several, constant and slope hold whatever the other weights make of the field.

The blended field at any points as an affine function of one stage's weight: what demands off the grid are made of.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array, BoolArray
from tpmscad.blending.composition.blended_field import BlendedField, WeightFunction
from tpmscad.blending.weights.constraints import WeightConstraints
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.fields.sample_grid import SampleGrid

GridWindow = tuple[slice, slice, slice]

LAYER_TOL_SPACINGS = 0.25
"""Part of the spacing within which a point counts as lying on a layer of samples."""


@dataclass(frozen=True, eq=False)
class AffineBlend:
    """A blend of one weight on a grid; `window` is the block of samples that is looked at."""

    grid: SampleGrid
    constant: Array
    slope: Array
    window: GridWindow

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """The axes of the window."""
        x, y, z = (axis[part] for axis, part in zip(self.grid.axes, self.window, strict=True))
        return x, y, z

    def values(self, weight: SplineWeight) -> Array:
        """f on the grid."""
        values = self.constant.copy()
        values[self.window] += self.slope[self.window] * weight.on_grid(*self.axes)
        return values

    def gradient(self, weight: SplineWeight, by_value: Array) -> Array:
        """The gradient by the free coefficients (zero for fixed ones) of what has the gradient `by_value` by f's samples."""
        full = weight.adjoint(*self.axes, (by_value * self.slope)[self.window])
        return np.where(weight.free, full, 0.0)

    def reach(self, weight: SplineWeight) -> tuple[Array, Array]:
        """The least and the greatest weight that free coefficients within their bounds can give each sample of the window."""
        least = weight.moved(np.where(weight.free, weight.low, weight.coefficients)).on_grid(*self.axes)
        most = weight.moved(np.where(weight.free, weight.high, weight.coefficients)).on_grid(*self.axes)
        return least, most


def make_affine_blend(grid: SampleGrid, constant: Array, slope: Array) -> AffineBlend:
    """A blend with the window of all samples where the slope is not zero, one sample wider."""
    return AffineBlend(grid, constant, slope, find_bounding_window(slope != 0, 1))


def tighten_weight_range(
    reach: tuple[Array, Array], sampled: AffineBlend, weight: SplineWeight, demands: WeightConstraints
) -> tuple[Array, Array]:
    """The reach that is left to samples that share their weight with those of the demands: the layers of a line weight."""
    axis = getattr(weight, "axis", None)
    if axis is None or len(demands) == 0:
        return reach
    along = sampled.axes[axis]
    layer = np.searchsorted((along[:-1] + along[1:]) / 2, demands.points[:, axis])
    on_it = np.abs(along[layer] - demands.points[:, axis]) < LAYER_TOL_SPACINGS * float(along[1] - along[0])
    least, most = np.full(len(along), -np.inf), np.full(len(along), np.inf)
    up, down = on_it & (demands.side > 0), on_it & (demands.side < 0)
    np.maximum.at(least, layer[up], demands.bound[up])
    np.minimum.at(most, layer[down], demands.bound[down])
    shape = [1, 1, 1]
    shape[axis] = -1
    return np.maximum(reach[0], least.reshape(shape)), np.minimum(reach[1], most.reshape(shape))


def find_bounding_window(mask: BoolArray, margin: int = 0) -> GridWindow:
    """The slices of the smallest block that holds the mask, wider by `margin` samples; empty for an empty mask."""
    slices = []
    for axis in range(3):
        used = np.flatnonzero(mask.any(axis=tuple(k for k in range(3) if k != axis)))
        if len(used) == 0:
            return slice(0, 0), slice(0, 0), slice(0, 0)
        slices.append(slice(max(int(used[0]) - margin, 0), min(int(used[-1]) + 1 + margin, mask.shape[axis])))
    return slices[0], slices[1], slices[2]


def evaluate_affine_form(field: BlendedField, stage: int, points: Array) -> tuple[Array, Array]:
    """f at points (n, 3) without the weight of a stage and its change with it: f = first + w * second, each (n,)."""
    none, full = (_evaluate_at_weight(field, stage, points, value) for value in (0.0, 1.0))
    return none, full - none


@dataclass(frozen=True, slots=True)
class _ConstantWeight:
    value: float

    def __call__(self, points: ArrayLike) -> Array:
        points = np.asarray(points)
        return np.full(points.shape[:-1], self.value)

    def gradient(self, points: ArrayLike) -> Array:
        return np.zeros(np.shape(points))

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        return np.full((len(x), len(y), len(z)), self.value)


def _evaluate_at_weight(field: BlendedField, stage: int, points: Array, value: float) -> Array:
    weights: list[WeightFunction] = list(field.weights)
    weights[stage] = _ConstantWeight(value)
    return field.with_weights(weights)(points)
