"""A blend on one grid: f = constant + slope * w, since a blended field is affine in each of its weights.

For two structures constant = f1 and slope = f2 - f1 inside the blending region, and slope = 0 outside it. For one weight of
several, constant and slope hold whatever the other weights make of the field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.blend.demands import Demands
from tpmscad.blend.grid import Array, Grid, Mask
from tpmscad.blend.weight import Weight

Window = tuple[slice, slice, slice]

SAME_LAYER = 0.25
"""Part of the spacing within which a point counts as lying on a layer of samples."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """A blend of one weight on a grid; `window` is the block of samples that is looked at."""

    grid: Grid
    constant: Array
    slope: Array
    window: Window

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """The axes of the window."""
        x, y, z = (axis[part] for axis, part in zip(self.grid.axes, self.window, strict=True))
        return x, y, z

    def values(self, weight: Weight) -> Array:
        """f on the grid."""
        values = self.constant.copy()
        values[self.window] += self.slope[self.window] * weight.on_grid(*self.axes)
        return values

    def gradient(self, weight: Weight, by_value: Array) -> Array:
        """The gradient by the free coefficients (zero for fixed ones) of what has the gradient `by_value` by f's samples."""
        full = weight.adjoint(*self.axes, (by_value * self.slope)[self.window])
        return np.where(weight.free, full, 0.0)

    def reach(self, weight: Weight) -> tuple[Array, Array]:
        """The least and the greatest weight that free coefficients within their bounds can give each sample of the window."""
        least = weight.moved(np.where(weight.free, weight.low, weight.coefficients)).on_grid(*self.axes)
        most = weight.moved(np.where(weight.free, weight.high, weight.coefficients)).on_grid(*self.axes)
        return least, most


def sampled_on(grid: Grid, constant: Array, slope: Array) -> Sampled:
    """A blend with the window of all samples where the slope is not zero, one sample wider."""
    return Sampled(grid, constant, slope, block(slope != 0, 1))


def tightened(reach: tuple[Array, Array], sampled: Sampled, weight: Weight, demands: Demands) -> tuple[Array, Array]:
    """The reach that is left to samples that share their weight with those of the demands: the layers of a line weight."""
    axis = getattr(weight, "axis", None)
    if axis is None or len(demands) == 0:
        return reach
    along = sampled.axes[axis]
    layer = np.searchsorted((along[:-1] + along[1:]) / 2, demands.points[:, axis])
    on_it = np.abs(along[layer] - demands.points[:, axis]) < SAME_LAYER * float(along[1] - along[0])
    least, most = np.full(len(along), -np.inf), np.full(len(along), np.inf)
    up, down = on_it & (demands.side > 0), on_it & (demands.side < 0)
    np.maximum.at(least, layer[up], demands.bound[up])
    np.minimum.at(most, layer[down], demands.bound[down])
    shape = [1, 1, 1]
    shape[axis] = -1
    return np.maximum(reach[0], least.reshape(shape)), np.minimum(reach[1], most.reshape(shape))


def block(mask: Mask, margin: int = 0) -> Window:
    """The slices of the smallest block that holds the mask, wider by `margin` samples; empty for an empty mask."""
    slices = []
    for axis in range(3):
        used = np.flatnonzero(mask.any(axis=tuple(k for k in range(3) if k != axis)))
        if len(used) == 0:
            return slice(0, 0), slice(0, 0), slice(0, 0)
        slices.append(slice(max(int(used[0]) - margin, 0), min(int(used[-1]) + 1 + margin, mask.shape[axis])))
    return slices[0], slices[1], slices[2]
