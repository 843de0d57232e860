"""Keeping the volume fraction along a transition: a shift of the field, zero with two derivatives at both its ends.

A mixture of two structures can be much more or much less solid than either. How far a point is on its way from one to the
other is its place in the layer of a line weight, or else the initial weight there. A spline of that is added to the blended
field, so that all along the way the solid fraction is what interpolates those of the two structures there. Outside nothing
changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from tpmscad._typing import Array
from tpmscad.blending.composition.blended_field import WeightFunction
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.weights.line_weight import LineWeight
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.fields.sample_grid import grid_points

SHIFT_DEGREE, SHIFT_SPANS = 3, 20
SHIFT_KNOTS = np.concatenate([np.zeros(SHIFT_DEGREE), np.linspace(0.0, 1.0, SHIFT_SPANS + 1), np.ones(SHIFT_DEGREE)])
FREE_SHIFT_COEFFICIENTS = slice(SHIFT_DEGREE, SHIFT_SPANS)
"""All coefficients of the shift but the first and the last three, which stay zero."""

FIT_BINS = 40
"""Parts of the way in which the solid fraction is measured for the shift."""

REPORT_BINS = 20
"""Parts in which it is measured for what the result says."""

SHIFT_FIT_PASSES = 3
"""Refinements of the shift: the spline smooths what each part asks for, and the next pass mends what is left."""


@dataclass(frozen=True, slots=True, eq=False)
class LayerCoordinate:
    """The way through the layer of a line weight: 0 where the weight is 0, 1 where it is 1, straight in between."""

    line: LineWeight

    def __call__(self, points: ArrayLike) -> Array:
        t = (self.line.coordinate(np.asarray(points, float)) - self.line.start) / (self.line.end - self.line.start)
        return np.clip(t if self._rising else 1.0 - t, 0.0, 1.0)

    def gradient(self, points: ArrayLike) -> Array:
        slope = self.line.coordinate.gradient(np.asarray(points, float)) / (self.line.end - self.line.start)
        return slope if self._rising else -slope

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        return self(grid_points((x, y, z)))

    @property
    def _rising(self) -> bool:
        return bool(self.line.coefficients[-1] > self.line.coefficients[0])


@dataclass(frozen=True, slots=True, eq=False)
class LevelShift:
    """A spline, in units of the field, of the way: coefficients (n,) on KNOTS."""

    way: WeightFunction
    coefficients: Array

    def __call__(self, points: ArrayLike) -> Array:
        return self.of(self.way(points))

    def gradient(self, points: ArrayLike) -> Array:
        return self.of(self.way(points), 1)[..., None] * self.way.gradient(points)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        return self.of(self.way.on_grid(x, y, z))

    def of(self, share: Array, order: int = 0) -> Array:
        return np.asarray(BSpline(SHIFT_KNOTS, self.coefficients, SHIFT_DEGREE)(share, order))


def transition_coordinate(start: SplineWeight) -> WeightFunction:
    """How far a point is on its way, 0 to 1, by the weight that a stage starts from."""
    return LayerCoordinate(start) if isinstance(start, LineWeight) else start


def fit_level_shift(scene: SampledComposition, weights: Sequence[SplineWeight], stage: int) -> LevelShift:
    """The shift of one stage, from the samples of the scene with the weights it starts from (shifts left out)."""
    way = transition_coordinate(weights[stage])
    share, values, wanted = _sample_transition(scene.with_shifts([None] * len(weights)), weights, way, stage)
    part = np.minimum((share * FIT_BINS).astype(int), FIT_BINS - 1)
    order = np.argsort(part, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(part[order])) + 1)
    where, target = (np.array([values[group].mean() for group in groups]) for values in (share, wanted))
    basis = BSpline.design_matrix(where, SHIFT_KNOTS, SHIFT_DEGREE).toarray()[:, FREE_SHIFT_COEFFICIENTS]
    shift = LevelShift(way, np.zeros(len(SHIFT_KNOTS) - SHIFT_DEGREE - 1))
    for _ in range(SHIFT_FIT_PASSES):
        shifted = values + shift.of(share)
        missing = [-np.quantile(shifted[group], t) for group, t in zip(groups, target, strict=True)]
        coefficients = shift.coefficients.copy()
        coefficients[FREE_SHIFT_COEFFICIENTS] += np.linalg.lstsq(basis, np.array(missing), rcond=None)[0]
        shift = LevelShift(way, coefficients)
    return shift


def measure_fraction_error(
    scene: SampledComposition, weights: Sequence[WeightFunction], way: WeightFunction, stage: int
) -> float:
    """Mean distance, over parts of the way, of the solid fraction from the interpolated one."""
    share, values, wanted = _sample_transition(scene, weights, way, stage)
    part = np.minimum((share * REPORT_BINS).astype(int), REPORT_BINS - 1)
    solid, count = np.bincount(part, values <= 0, REPORT_BINS), np.bincount(part, minlength=REPORT_BINS)
    used = count > 0
    return float(np.mean(np.abs(solid - np.bincount(part, wanted, REPORT_BINS))[used] / count[used]))


def _sample_transition(
    scene: SampledComposition, weights: Sequence[WeightFunction], way: WeightFunction, stage: int
) -> tuple[Array, Array, Array]:
    """Of every sample that a stage mixes: the way, f, and the interpolated solidity of the two structures there."""
    inside = scene.blending[stage] & (scene.owner <= stage + 1)
    share = way(scene.grid.points(np.flatnonzero(inside)))
    first, second = (scene.structures[k][inside] <= 0 for k in (stage, stage + 1))
    return share, scene.values(weights)[inside], (1 - share) * first + share * second
