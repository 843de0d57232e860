"""Earlier one-dimensional weights, by fixed profiles of a coordinate: the sigmoid and beta growth.

Sigmoid: Yang, Quan, Zhang, Tian, Computer-Aided Design 56 (2014) 11-21, w = 1 / (1 + exp(-k (t - middle))). Here k makes w run
from 0.01 to 0.99 over the layer, and it is cut off at the layer's ends.
Beta growth: Yoo, Kim, Int. J. Precis. Eng. Manuf. 16 (2015), with start t_b, end t_e and steepest point t_m of the growth:
w = (1 + (t_e - t) / (t_e - t_m)) ((t - t_b) / (t_e - t_b)) ^ ((t_e - t_b) / (t_e - t_m)).

The earlier weight by Gaussian radial basis functions (Yang et al. 2014), for regions of any shape.

Data points on a regular grid carry 0 or 1, the region they are in; those in the blending region are left out. The weight is the
mean of the data with weights exp(-|x - x_i|^2 / delta), distances in parts of the domain's longest edge.

The earlier weight by discrete reconstruction (Ozdemir et al., as described in the blending paper's section 1.1).

Every unit cell of the domain takes 0 or 1, the side of its centre; each corner of a cell takes the mean of the cells around it;
within a cell the weight is trilinear.

The earlier blending methods by name, as the blending paper compares them; none looks at topology.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.blending.composition.blended_field import BlendedField, WeightFunction
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.initial_weights import WeightSpec, make_initial_weight, make_stage_regions
from tpmscad.blending.weights.coordinates import Coordinate, LinearCoordinate
from tpmscad.blending.weights.line_weight import LineWeight
from tpmscad.errors import InvalidRequest
from tpmscad.fields.sample_grid import BoxBounds, FieldFunction, grid_points

SIGMOID_END_WEIGHT = 0.01
"""Weight at the start of the layer, and what is missing from 1 at its end."""


@dataclass(frozen=True, slots=True)
class ProfileWeight:
    """A weight w(t) over the layer [start, end] of a coordinate, 0 before and 1 after it (turned round if not rising)."""

    coordinate: Coordinate
    start: float
    end: float
    rising: bool = True
    profile: Literal["sigmoid", "beta-growth"] = "sigmoid"
    middle: float = 0.5
    """Steepest point of the growth, as a part of the layer."""

    def __call__(self, points: ArrayLike) -> Array:
        s = self._part(np.asarray(points, float))
        value = np.where(s <= 0, 0.0, np.where(s >= 1, 1.0, self._value(np.clip(s, 0.0, 1.0))))
        return value if self.rising else 1.0 - value

    def gradient(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        s = self._part(points)
        slope = np.where((s <= 0) | (s >= 1), 0.0, self._slope(np.clip(s, 0.0, 1.0))) / (self.end - self.start)
        return (slope if self.rising else -slope)[..., None] * self.coordinate.gradient(points)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        return self(grid_points((x, y, z)))

    def _part(self, points: Array) -> Array:
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


_SIGMOID_STEEPNESS = 2.0 * np.log(1.0 / SIGMOID_END_WEIGHT - 1.0)


GAUSSIAN_DELTA = 0.02
"""The blending paper's width, section 4.2."""

DATA_POINTS_PER_AXIS = 20
"""The blending paper's data points along each axis."""

POINTS_PER_CHUNK = 4_000
"""Points at a time: 25 MB of intermediate sums."""


@dataclass(frozen=True, slots=True, eq=False)
class GaussianWeight:
    """The mean of values (a, b, c) of data points on the axes, `present` where there is one, weighted by Gaussians of x."""

    axes: tuple[Array, Array, Array]
    values: Array
    present: Array
    scale: float

    def __call__(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        flat = points.reshape(-1, 3)
        parts = [self._of(flat[i : i + POINTS_PER_CHUNK]) for i in range(0, len(flat), POINTS_PER_CHUNK)]
        return np.concatenate([above / below for above, below in parts] or [np.zeros(0)]).reshape(points.shape[:-1])

    def gradient(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        flat = points.reshape(-1, 3)
        slopes = np.zeros(flat.shape)
        for i in range(0, len(flat), POINTS_PER_CHUNK):
            part = slice(i, i + POINTS_PER_CHUNK)
            above, below = self._of(flat[part])
            for axis in range(3):
                up, low = self._of(flat[part], axis)
                slopes[part, axis] = (up * below - above * low) / below**2
        return slopes.reshape(points.shape)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        both = np.stack([self.values * self.present, self.present])
        bells = [self._bells(axis, t)[0] for axis, t in enumerate((x, y, z))]
        above, below = np.einsum("xa,kabc,yb,zc->kxyz", bells[0], both, bells[1], bells[2], optimize=True)
        return np.asarray(above / below)

    def _bells(self, axis: int, t: Array) -> tuple[Array, Array]:
        """exp(-(t - x_i)^2 / scale) for all data of an axis, each row divided by its greatest, and t - x_i."""
        away = t[:, None] - self.axes[axis]
        power = -(away**2) / self.scale
        return np.exp(power - power.max(axis=1, keepdims=True)), away

    def _of(self, points: Array, by: int | None = None) -> tuple[Array, Array]:
        """sum v_i g_i and sum g_i, or their derivatives by one axis; both scaled alike by the nearest data of each axis."""
        bells = []
        for axis in range(3):
            bell, away = self._bells(axis, points[:, axis])
            bells.append(bell * (-2 * away / self.scale) if axis == by else bell)
        both = np.stack([self.values * self.present, self.present])
        sums = (bells[0] @ np.moveaxis(both, 1, 0).reshape(DATA_POINTS_PER_AXIS, -1)).reshape(
            -1, 2, DATA_POINTS_PER_AXIS, DATA_POINTS_PER_AXIS
        )
        sums = np.matmul(bells[1][:, None, None, :], sums)[:, :, 0]
        sums = np.matmul(sums, bells[2][:, :, None])[..., 0]
        return sums[:, 0], sums[:, 1]


def make_gaussian_weight(
    first: FieldFunction,
    second: FieldFunction,
    blending: FieldFunction,
    domain: BoxBounds,
    delta: float = GAUSSIAN_DELTA,
) -> GaussianWeight:
    """The weight of data at 20 points along each axis: 0 in `first`, 1 in `second`."""
    x, y, z = (np.linspace(a, b, DATA_POINTS_PER_AXIS) for a, b in zip(*domain, strict=True))
    points = grid_points((x, y, z))
    outside = np.asarray(blending(points)) > 0
    one = outside & (np.asarray(second(points)) <= 0)
    zero = outside & (np.asarray(first(points)) <= 0) & ~one
    longest = max(b - a for a, b in zip(*domain, strict=True))
    return GaussianWeight((x, y, z), one.astype(float), (one | zero).astype(float), delta * longest**2)


@dataclass(frozen=True, slots=True, eq=False)
class CellWeight:
    """The trilinear interpolant of values (a, b, c) at the corners of cells that start at `low` and have edges `edge`."""

    low: Array
    edge: Array
    corners: Array

    def __call__(self, points: ArrayLike) -> Array:
        return np.clip(self._combined(np.asarray(points, float), None), 0.0, 1.0)

    def gradient(self, points: ArrayLike) -> Array:
        """The gradient within the cells; it jumps from cell to cell."""
        points = np.asarray(points, float)
        return np.stack([self._combined(points, axis) for axis in range(3)], axis=-1)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        return self(grid_points((x, y, z)))

    def _combined(self, points: Array, by: int | None) -> Array:
        last = np.array(self.corners.shape) - 2
        place = np.clip((points - self.low) / self.edge, 0.0, last + 1.0)
        cell = np.minimum(place.astype(np.int64), last)
        part = place - cell
        total = np.zeros(points.shape[:-1])
        for corner in np.ndindex(2, 2, 2):
            share = np.ones(points.shape[:-1])
            for axis, side in enumerate(corner):
                if axis == by:
                    share = share * ((1.0 if side else -1.0) / self.edge[axis])
                else:
                    share = share * (part[..., axis] if side else 1.0 - part[..., axis])
            total += share * self.corners[tuple(np.moveaxis(cell + np.array(corner), -1, 0))]
        return total


def make_cell_weight(first: FieldFunction, domain: BoxBounds, cell: float) -> CellWeight:
    """The weight of cells of about the given edge (a whole number of them fills the domain): 0 in `first`, else 1."""
    low, high = np.array(domain[0]), np.array(domain[1])
    if not cell > 0:
        raise InvalidRequest(f"cell {cell:g}: the edge of the cells of discrete reconstruction must be positive")
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


def make_baseline_weight(
    method: str, spec: WeightSpec, field: BlendedField, scenes: Sequence[SampledComposition], stage: int
) -> WeightFunction:
    """The weight of one stage by an earlier method. Sigmoid and beta growth need a layer of a coordinate, else InvalidRequest."""
    first, second, mixing = make_stage_regions(field, stage)
    box = scenes[0].grid.low, scenes[0].grid.high
    if method == "gaussian-rbf":
        return make_gaussian_weight(first, second, mixing, box)
    if method == "discrete-reconstruction":
        return make_cell_weight(first, box, _choose_cell_edge(field, scenes, stage))
    line = make_initial_weight(spec, field, scenes, stage)
    if not isinstance(line, LineWeight):
        raise InvalidRequest(
            f"method {method!r} needs a blending region that is a layer: blending region {stage} is none"
        )
    profile: Literal["sigmoid", "beta-growth"] = "sigmoid" if method == "sigmoid" else "beta-growth"
    rising = bool(line.coefficients[-1] == 1.0)
    return ProfileWeight(line.coordinate, line.start, line.end, rising, profile)


def _choose_cell_edge(field: BlendedField, scenes: Sequence[SampledComposition], stage: int) -> float:
    """The greatest period of the two structures that meet, or half the layer's thickness where they have none."""
    periods = [_longest_period(structure) for structure in (field.structures[stage], field.structures[stage + 1])]
    if all(periods):
        return max(periods)
    line = make_initial_weight("auto", field, scenes, stage)
    if isinstance(line, LineWeight) and isinstance(line.coordinate, LinearCoordinate):
        return (line.end - line.start) / 2
    raise InvalidRequest("discrete reconstruction needs structures with periods, for the edge of its cells")


def _longest_period(structure: FieldFunction) -> float:
    periods = getattr(structure, "periods", None)
    found = periods() if callable(periods) else None
    return max(found) if found is not None else 0.0
