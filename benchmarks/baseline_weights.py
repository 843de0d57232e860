"""Baseline weights of earlier blending methods, with which the porous-blending paper compares; none controls the topology.

They serve the comparison in `benchmarks.blending`; `tpmscad.blend` does not offer them.

* Sigmoid (Yang, Quan, Zhang, Tian, Computer-Aided Design 56 (2014) 11-21): w = 1 / (1 + exp(-k (s - middle))) of the position s
  in the layer. Here k makes w run from 0.01 to 0.99, and w is cut off at the ends of the layer.
* Beta growth (Yoo, Kim, Int. J. Precis. Eng. Manuf. 16 (2015)), with start t_b, end t_e and steepest point t_m of the growth:
  w = (1 + (t_e - t) / (t_e - t_m)) ((t - t_b) / (t_e - t_b)) ^ ((t_e - t_b) / (t_e - t_m)).
* Gaussian radial basis functions (Yang et al. 2014), for regions of any shape: data points on a regular grid have the value 0 or
  1 of their region, and those in the blending region are left out. The weight is their mean with weights
  exp(-|x - x_i|^2 / delta), with distances as fractions of the domain's longest edge.
* Discrete reconstruction (Ozdemir et al., as described in section 1.1 of the porous-blending paper): each unit cell has the value
  0 or 1 of the region at its centre, each corner the mean of the cells around it, and the weight is trilinear in a cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array, IntArray
from tpmscad.blending._blend import sample_problem
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.initial_weights import WeightSpec, make_initial_weight
from tpmscad.blending.optimise.blend_state import (
    BlendProblem,
    OptimisationOutcome,
    evaluate_all_grids,
    evaluate_weights,
)
from tpmscad.blending.result import BlendResult, assemble_result
from tpmscad.blending.weights.coordinates import Coordinate, LinearCoordinate
from tpmscad.blending.weights.line_weight import LineWeight
from tpmscad.blending.weights.weight_protocol import WeightFunction
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.sample_grid import BoxBounds, FieldFunction, grid_points
from tpmscad.fields.field import Field

SIGMOID_END_WEIGHT = 0.01
"""Weight at the start of the layer; at its end the weight is one minus this."""

_SIGMOID_STEEPNESS = 2.0 * np.log(1.0 / SIGMOID_END_WEIGHT - 1.0)

GAUSSIAN_DELTA = 0.02
"""Width of the Gaussians in section 4.2 of the porous-blending paper."""

DATA_POINTS_PER_AXIS = 20
"""Data points of the Gaussian weight along each axis, as in the porous-blending paper."""

POINTS_PER_CHUNK = 4_000
"""Points of a Gaussian weight evaluated at a time, with 25 MB of intermediate sums."""


@dataclass(frozen=True, slots=True)
class ProfileWeight:
    """A fixed profile over the layer [start, end] of a coordinate: 0 before it, 1 after it (reversed if not `rising`).

    `middle` is the steepest point of the profile, as a fraction of the layer.
    """

    coordinate: Coordinate
    start: float
    end: float
    rising: bool = True
    profile: Literal["sigmoid", "beta-growth"] = "sigmoid"
    middle: float = 0.5

    def __call__(self, points: ArrayLike) -> Array:
        """Weights (...) at points (..., 3)."""
        s = self._position(np.asarray(points, float))
        value = np.where(s <= 0, 0.0, np.where(s >= 1, 1.0, self._value(np.clip(s, 0.0, 1.0))))
        return value if self.rising else 1.0 - value

    def gradient(self, points: ArrayLike) -> Array:
        """Exact gradients (..., 3) at points (..., 3)."""
        points = np.asarray(points, float)
        s = self._position(points)
        slope = np.where((s <= 0) | (s >= 1), 0.0, self._slope(np.clip(s, 0.0, 1.0))) / (self.end - self.start)
        return (slope if self.rising else -slope)[..., None] * self.coordinate.gradient(points)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        """Values on the tensor-product grid of three axes: (nx, ny, nz)."""
        return self(grid_points((x, y, z)))

    def _position(self, points: Array) -> Array:
        return (self.coordinate(points) - self.start) / (self.end - self.start)

    def _value(self, s: Array) -> Array:
        if self.profile == "sigmoid":
            return 1.0 / (1.0 + np.exp(-_SIGMOID_STEEPNESS * (s - self.middle)))
        rest = 1.0 - self.middle
        return np.asarray((1.0 + (1.0 - s) / rest) * s ** (1.0 / rest))

    def _slope(self, s: Array) -> Array:
        if self.profile == "sigmoid":
            value = self._value(s)
            return np.asarray(_SIGMOID_STEEPNESS * value * (1.0 - value))
        rest = 1.0 - self.middle
        power = 1.0 / rest
        return np.asarray(-power * s**power + (1.0 + (1.0 - s) / rest) * power * s ** (power - 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class GaussianWeight:
    """The mean of the values (a, b, c) of data points on the axes, weighted by Gaussians of the distance; `present` masks them.

    `scale` is the square of the Gaussians' width, in model units.
    """

    axes: tuple[Array, Array, Array]
    values: Array
    present: Array
    scale: float

    def __call__(self, points: ArrayLike) -> Array:
        """Weights (...) at points (..., 3)."""
        points = np.asarray(points, float)
        flat = points.reshape(-1, 3)
        sums = [self._sums(flat[i : i + POINTS_PER_CHUNK]) for i in range(0, len(flat), POINTS_PER_CHUNK)]
        means = [numerator / denominator for numerator, denominator in sums]
        return np.concatenate(means or [np.zeros(0)]).reshape(points.shape[:-1])

    def gradient(self, points: ArrayLike) -> Array:
        """Exact gradients (..., 3) at points (..., 3)."""
        points = np.asarray(points, float)
        flat = points.reshape(-1, 3)
        slopes = np.zeros(flat.shape)
        for i in range(0, len(flat), POINTS_PER_CHUNK):
            chunk = slice(i, i + POINTS_PER_CHUNK)
            top, bottom = self._sums(flat[chunk])
            for axis in range(3):
                top_slope, bottom_slope = self._sums(flat[chunk], axis)
                slopes[chunk, axis] = (top_slope * bottom - top * bottom_slope) / bottom**2
        return slopes.reshape(points.shape)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        """Values on the tensor-product grid of three axes: (nx, ny, nz)."""
        both = np.stack([self.values * self.present, self.present])
        gx, gy, gz = (self._gaussians(axis, t)[0] for axis, t in enumerate((x, y, z)))
        numerator, denominator = np.einsum("xa,kabc,yb,zc->kxyz", gx, both, gy, gz, optimize=True)
        return np.asarray(numerator / denominator)

    def _gaussians(self, axis: int, t: Array) -> tuple[Array, Array]:
        """exp(-(t - x_i)^2 / scale) for all data of an axis, each row divided by its maximum, and t - x_i."""
        offset = t[:, None] - self.axes[axis]
        exponent = -(offset**2) / self.scale
        return np.exp(exponent - exponent.max(axis=1, keepdims=True)), offset

    def _sums(self, points: Array, derivative_axis: int | None = None) -> tuple[Array, Array]:
        """Sums of v_i g_i and of g_i, or their derivatives by one axis, both with the common scale of `_gaussians`."""
        gaussians = []
        for axis in range(3):
            values, offset = self._gaussians(axis, points[:, axis])
            gaussians.append(values * (-2 * offset / self.scale) if axis == derivative_axis else values)
        both = np.stack([self.values * self.present, self.present])
        sums = (gaussians[0] @ np.moveaxis(both, 1, 0).reshape(DATA_POINTS_PER_AXIS, -1)).reshape(
            -1, 2, DATA_POINTS_PER_AXIS, DATA_POINTS_PER_AXIS
        )
        sums = np.matmul(gaussians[1][:, None, None, :], sums)[:, :, 0]
        sums = np.matmul(sums, gaussians[2][:, :, None])[..., 0]
        return sums[:, 0], sums[:, 1]


def make_gaussian_weight(
    first: FieldFunction,
    second: FieldFunction,
    blending: FieldFunction,
    domain: BoxBounds,
    delta: float = GAUSSIAN_DELTA,
) -> GaussianWeight:
    """The Gaussian weight of data points with the value 0 in `first` and 1 in `second`."""
    x, y, z = (np.linspace(a, b, DATA_POINTS_PER_AXIS) for a, b in zip(*domain, strict=True))
    points = grid_points((x, y, z))
    outside = np.asarray(blending(points)) > 0
    one = outside & (np.asarray(second(points)) <= 0)
    zero = outside & (np.asarray(first(points)) <= 0) & ~one
    longest = max(b - a for a, b in zip(*domain, strict=True))
    return GaussianWeight((x, y, z), one.astype(float), (one | zero).astype(float), delta * longest**2)


@dataclass(frozen=True, slots=True, eq=False)
class CellWeight:
    """The trilinear interpolant of values (a, b, c) at the corners of cells of edges `edge` (3,) from the point `low` (3,)."""

    low: Array
    edge: Array
    corners: Array

    def __call__(self, points: ArrayLike) -> Array:
        """Weights (...) at points (..., 3)."""
        return np.clip(self._interpolate(np.asarray(points, float), None), 0.0, 1.0)

    def gradient(self, points: ArrayLike) -> Array:
        """The gradient (..., 3) within the cells; it is discontinuous between cells."""
        points = np.asarray(points, float)
        return np.stack([self._interpolate(points, axis) for axis in range(3)], axis=-1)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        """Values on the tensor-product grid of three axes: (nx, ny, nz)."""
        return self(grid_points((x, y, z)))

    def _interpolate(self, points: Array, derivative_axis: int | None) -> Array:
        """The interpolant at points (..., 3), or its derivative by one axis."""
        last = np.array(self.corners.shape) - 2
        position = np.clip((points - self.low) / self.edge, 0.0, last + 1.0)
        cell = np.minimum(position.astype(np.int64), last)
        local = position - cell
        total = np.zeros(points.shape[:-1])
        for corner in np.ndindex(2, 2, 2):
            basis = np.ones(points.shape[:-1])
            for axis, side in enumerate(corner):
                if axis == derivative_axis:
                    basis = basis * ((1.0 if side else -1.0) / self.edge[axis])
                else:
                    basis = basis * (local[..., axis] if side else 1.0 - local[..., axis])
            total += basis * self.corners[tuple(np.moveaxis(cell + np.array(corner), -1, 0))]
        return total


def make_stage_regions(field: BlendedField, stage: int) -> tuple[FieldFunction, FieldFunction, FieldFunction]:
    """The regions of a stage as functions: that of the field so far, that of structure stage + 1, and where the stage mixes."""

    def first(points: Array) -> Array:
        return np.where(_region_index(field, points) <= stage, -1.0, 1.0)

    def second(points: Array) -> Array:
        return np.where(_region_index(field, points) == stage + 1, -1.0, 1.0)

    def mixing(points: Array) -> Array:
        return np.where(
            _region_index(field, points) > stage + 1, -1.0, np.asarray(field.blending_regions[stage](points))
        )

    return first, second, mixing


def _region_index(field: BlendedField, points: Array) -> IntArray:
    """Index of the region with the least value at points (..., 3) of the domain: (...)."""
    clamped = points if field.domain is None else np.clip(points, *field.domain)
    return np.argmin(np.stack([region(clamped) for region in field.regions]), axis=0)


def make_cell_weight(first: FieldFunction, domain: BoxBounds, cell: float) -> CellWeight:
    """The discrete reconstruction with cells of about the given edge, which fill the domain exactly: 0 in `first`, else 1."""
    low, high = np.array(domain[0]), np.array(domain[1])
    count = np.maximum(np.rint((high - low) / cell).astype(int), 1)
    edge = (high - low) / count
    x, y, z = (a + e * (np.arange(n) + 0.5) for a, e, n in zip(low, edge, count, strict=True))
    corners = (np.asarray(first(grid_points((x, y, z)))) > 0).astype(float)
    for axis in range(3):
        width = [(1, 1) if k == axis else (0, 0) for k in range(3)]
        padded = np.pad(corners, width, mode="edge")
        corners = (
            np.take(padded, range(padded.shape[axis] - 1), axis) + np.take(padded, range(1, padded.shape[axis]), axis)
        ) / 2
    return CellWeight(low, edge, corners)


BASELINE_METHODS = ("sigmoid", "beta-growth", "discrete-reconstruction", "gaussian-rbf")


def blend_by_baseline(
    structures: Sequence[FieldFunction],
    regions: Sequence[FieldFunction],
    blending_regions: Sequence[FieldFunction],
    method: str,
    resolution: tuple[int, int, int],
    *,
    weight: WeightSpec = "auto",
    domain: BoxBounds | None = None,
) -> BlendResult:
    """The blend by a baseline method, with its defects counted as those of `tpmscad.blend` are; nothing is optimised."""
    problem = sample_problem(structures, regions, blending_regions, resolution, domain, max_rounds=0)
    weights = [make_baseline_weight(method, weight, problem, stage) for stage in range(len(blending_regions))]
    state = evaluate_weights(problem.compositions, weights)
    defects = evaluate_all_grids(problem.compositions, state)
    grids = [composition.grid for composition in problem.compositions]
    blended = problem.field.with_weights(weights)
    return assemble_result(blended, method, grids, defects, defects, OptimisationOutcome(state), {})


def make_baseline_weight(method: str, spec: WeightSpec, problem: BlendProblem, stage: int) -> WeightFunction:
    """The weight of one stage by a baseline method.

    Raises InvalidRequest if "sigmoid" or "beta-growth" is requested for a blending region that is no layer of a coordinate.
    """
    first, second, mixing = make_stage_regions(problem.field, stage)
    box = problem.coarse.grid.low, problem.coarse.grid.high
    if method == "gaussian-rbf":
        return make_gaussian_weight(first, second, mixing, box)
    if method == "discrete-reconstruction":
        return make_cell_weight(first, box, _choose_cell_edge(problem, stage))
    line = make_initial_weight(spec, problem.field, problem.compositions, stage)
    if not isinstance(line, LineWeight):
        raise InvalidRequest(
            f"method {method!r} needs a blending region that is a layer: blending region {stage} is none"
        )
    profile: Literal["sigmoid", "beta-growth"] = "sigmoid" if method == "sigmoid" else "beta-growth"
    rising = bool(line.coefficients[-1] == 1.0)
    return ProfileWeight(line.coordinate, line.start, line.end, rising, profile)


def _choose_cell_edge(problem: BlendProblem, stage: int) -> float:
    """The longest period of the two structures of a stage, or half the thickness of the layer if they have none."""
    structures = problem.field.structures
    periods = [_longest_period(structure) for structure in (structures[stage], structures[stage + 1])]
    if all(periods):
        return max(periods)
    line = make_initial_weight("auto", problem.field, problem.compositions, stage)
    if isinstance(line, LineWeight) and isinstance(line.coordinate, LinearCoordinate):
        return (line.end - line.start) / 2
    raise InvalidRequest(
        "method 'discrete-reconstruction' needs structures with periods, or a blending region that is a flat layer, for the "
        "edge of its cells: choose another method"
    )


def _longest_period(structure: Field) -> float:
    periods = structure.periods()
    return max(periods) if periods is not None else 0.0
