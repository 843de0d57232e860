"""The blended field as an affine function of one weight, f = constant + slope * w, on a grid and at points.

A blended field is affine in each of its weights (eqs 2 and 6 and Algorithm 3 of the porous-blending paper). For two structures,
constant = f1 and slope = f2 - f1 in the blending region, and slope = 0 outside it. For several structures, constant and slope
include the effect of the other weights, which are held fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from tpmscad._typing import Array, BoolArray
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.weights.constraints import WeightConstraints
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.fields.data.sample_grid import SampleGrid
from tpmscad.fields.field import ConstantField

GridWindow = tuple[slice, slice, slice]

LAYER_TOL_SPACINGS = 0.25
"""Distance, in spacings, within which a point lies on a layer of samples."""


@dataclass(frozen=True, eq=False)
class AffineBlend:
    """The affine form on a grid: constant and slope (nx, ny, nz), and the window of samples that is considered."""

    grid: SampleGrid
    constant: Array
    slope: Array
    window: GridWindow

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """The coordinates of the samples of the window along x, y and z."""
        x, y, z = (axis[part] for axis, part in zip(self.grid.axes, self.window, strict=True))
        return x, y, z

    def values(self, weight: SplineWeight) -> Array:
        """Values of f on the grid: (nx, ny, nz)."""
        values = self.constant.copy()
        values[self.window] += self.slope[self.window] * weight.on_grid(*self.axes)
        return values

    def gradient(self, weight: SplineWeight, sample_derivatives: Array) -> Array:
        """Derivatives by the coefficients (0 for fixed ones) of a function with these derivatives by f's samples (chain rule)."""
        full = weight.apply_transpose(*self.axes, (sample_derivatives * self.slope)[self.window])
        return np.where(weight.is_free, full, 0.0)

    def weight_range(self, weight: SplineWeight) -> tuple[Array, Array]:
        """Least and greatest weight of each sample of the window that free coefficients within their bounds attain."""
        lowest = weight.with_coefficients(np.where(weight.is_free, weight.lower_bounds, weight.coefficients))
        highest = weight.with_coefficients(np.where(weight.is_free, weight.upper_bounds, weight.coefficients))
        return lowest.on_grid(*self.axes), highest.on_grid(*self.axes)


def make_affine_blend(grid: SampleGrid, constant: Array, slope: Array) -> AffineBlend:
    """An affine form whose window holds all samples with a slope, and one more on each side."""
    return AffineBlend(grid, constant, slope, find_bounding_window(slope != 0, 1))


def tighten_weight_range(
    weight_range: tuple[Array, Array], affine: AffineBlend, weight: SplineWeight, constraints: WeightConstraints
) -> tuple[Array, Array]:
    """The range of weights that constraints leave to samples with the same weight: the layers of a weight along one axis."""
    axis = getattr(weight, "axis", None)
    if axis is None or len(constraints) == 0:
        return weight_range
    along = affine.axes[axis]
    layer = np.searchsorted((along[:-1] + along[1:]) / 2, constraints.points[:, axis])
    is_on_layer = np.abs(along[layer] - constraints.points[:, axis]) < LAYER_TOL_SPACINGS * float(along[1] - along[0])
    lowest, highest = np.full(len(along), -np.inf), np.full(len(along), np.inf)
    below, above = is_on_layer & (constraints.sense > 0), is_on_layer & (constraints.sense < 0)
    np.maximum.at(lowest, layer[below], constraints.bound[below])
    np.minimum.at(highest, layer[above], constraints.bound[above])
    shape = [1, 1, 1]
    shape[axis] = -1
    return np.maximum(weight_range[0], lowest.reshape(shape)), np.minimum(weight_range[1], highest.reshape(shape))


def find_bounding_window(mask: BoolArray, margin: int = 0) -> GridWindow:
    """The slices of the smallest block that holds the mask, extended by `margin` samples; empty for an empty mask."""
    found = ndimage.find_objects(mask.astype(np.int8))
    if not found:
        return slice(0, 0), slice(0, 0), slice(0, 0)
    x, y, z = (
        slice(max(part.start - margin, 0), min(part.stop + margin, n))
        for part, n in zip(found[0], mask.shape, strict=True)
    )
    return x, y, z


def evaluate_affine_form(field: BlendedField, stage: int, points: Array) -> tuple[Array, Array]:
    """Constant and slope (n,) of the field as a function of one stage's weight at points (n, 3)."""
    before, after = field.weights[:stage], field.weights[stage + 1 :]
    value_at_zero, value_at_one = (
        field.with_weights((*before, ConstantField(weight), *after))(points) for weight in (0.0, 1.0)
    )
    return value_at_zero, value_at_one - value_at_zero
