"""Control of the volume fraction along a transition: a shift of the field, zero with two derivatives at both ends.

A mixture of two structures can be much more or much less solid than either. The transition coordinate runs from 0 to 1 across the
blending region: it is the position in the layer of a univariate weight, or else the initial weight. A spline of this coordinate
is added to the field, so that at each position the solid fraction is the interpolated one of the two structures there. Outside
the blending regions nothing changes. The paper has no counterpart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from tpmscad._typing import Array
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.blend_state import BlendProblem, OptimisationOutcome
from tpmscad.blending.weights.line_weight import LineWeight
from tpmscad.blending.weights.weight_protocol import SplineWeight, WeightFunction
from tpmscad.fields.data.sample_grid import grid_points
from tpmscad.splines.knots import uniform_knots

SHIFT_DEGREE, SHIFT_SPANS = 3, 20
SHIFT_KNOTS = uniform_knots(SHIFT_SPANS, SHIFT_DEGREE)

FREE_SHIFT_COEFFICIENTS = slice(SHIFT_DEGREE, SHIFT_SPANS)
"""The coefficients of a shift that are fitted: all but the first and the last three, which stay zero."""

FIT_BINS = 40
"""Number of intervals of the transition coordinate in which the solid fraction is measured for the fit."""

REPORT_BINS = 20
"""Number of intervals in which it is measured for the result's message."""

SHIFT_FIT_PASSES = 3
"""Passes of the fit: the spline smooths the shift that each interval needs, and the next pass corrects the remainder."""


@dataclass(frozen=True, slots=True, eq=False)
class LayerCoordinate:
    """The position in the layer of a univariate weight: 0 where the weight is 0, 1 where it is 1, linear in between."""

    line: LineWeight

    def __call__(self, points: ArrayLike) -> Array:
        """Transition coordinates (...) of points (..., 3)."""
        t = (self.line.coordinate(np.asarray(points, float)) - self.line.start) / (self.line.end - self.line.start)
        return np.clip(t if self._is_rising else 1.0 - t, 0.0, 1.0)

    def gradient(self, points: ArrayLike) -> Array:
        """Exact gradients (..., 3) at points (..., 3)."""
        slope = self.line.coordinate.gradient(np.asarray(points, float)) / (self.line.end - self.line.start)
        return slope if self._is_rising else -slope

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        """Values on the tensor-product grid of three axes: (nx, ny, nz)."""
        return self(grid_points((x, y, z)))

    @property
    def _is_rising(self) -> bool:
        return bool(self.line.coefficients[-1] > self.line.coefficients[0])


@dataclass(frozen=True, slots=True, eq=False)
class LevelShift:
    """A spline of the transition coordinate, in units of the field, with coefficients (n,) on SHIFT_KNOTS."""

    coordinate: WeightFunction
    coefficients: Array

    def __call__(self, points: ArrayLike) -> Array:
        """Shifts (...) at points (..., 3)."""
        return self.evaluate(self.coordinate(points))

    def gradient(self, points: ArrayLike) -> Array:
        """Exact gradients (..., 3) at points (..., 3)."""
        return self.evaluate(self.coordinate(points), 1)[..., None] * self.coordinate.gradient(points)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        """Values on the tensor-product grid of three axes: (nx, ny, nz)."""
        return self.evaluate(self.coordinate.on_grid(x, y, z))

    def evaluate(self, position: Array, order: int = 0) -> Array:
        """The shift, or its derivative of some order, at transition coordinates of any shape."""
        return np.asarray(BSpline(SHIFT_KNOTS, self.coefficients, SHIFT_DEGREE)(position, order))


def transition_coordinate(start: SplineWeight) -> WeightFunction:
    """The transition coordinate of a stage, from its initial weight."""
    return LayerCoordinate(start) if isinstance(start, LineWeight) else start


def fit_level_shift(composition: SampledComposition, weights: Sequence[SplineWeight], stage: int) -> LevelShift:
    """The level shift of one stage, fitted to the samples of the blend with its initial weights and without shifts."""
    coordinate = transition_coordinate(weights[stage])
    unshifted = composition.with_level_shifts([None] * len(weights))
    position, values, expected_solid = _sample_transition(unshifted, weights, coordinate, stage)
    bin_index = np.minimum((position * FIT_BINS).astype(int), FIT_BINS - 1)
    order = np.argsort(bin_index, kind="stable")
    bins = np.split(order, np.flatnonzero(np.diff(bin_index[order])) + 1)
    bin_position, bin_fraction = (
        np.array([samples[members].mean() for members in bins]) for samples in (position, expected_solid)
    )
    basis = BSpline.design_matrix(bin_position, SHIFT_KNOTS, SHIFT_DEGREE).toarray()[:, FREE_SHIFT_COEFFICIENTS]
    shift = LevelShift(coordinate, np.zeros(len(SHIFT_KNOTS) - SHIFT_DEGREE - 1))
    for _ in range(SHIFT_FIT_PASSES):
        shifted = values + shift.evaluate(position)
        missing = [
            -np.quantile(shifted[members], fraction) for members, fraction in zip(bins, bin_fraction, strict=True)
        ]
        coefficients = shift.coefficients.copy()
        coefficients[FREE_SHIFT_COEFFICIENTS] += np.linalg.lstsq(basis, np.array(missing), rcond=None)[0]
        shift = LevelShift(coordinate, coefficients)
    return shift


def measure_fraction_error(
    composition: SampledComposition, weights: Sequence[WeightFunction], coordinate: WeightFunction, stage: int
) -> float:
    """Mean difference, over intervals of the transition coordinate, of the solid fraction from the interpolated one."""
    position, values, expected_solid = _sample_transition(composition, weights, coordinate, stage)
    bin_index = np.minimum((position * REPORT_BINS).astype(int), REPORT_BINS - 1)
    solid = np.bincount(bin_index, values <= 0, REPORT_BINS)
    expected = np.bincount(bin_index, expected_solid, REPORT_BINS)
    count = np.bincount(bin_index, minlength=REPORT_BINS)
    occupied = count > 0
    return float(np.mean(np.abs(solid - expected)[occupied] / count[occupied]))


def report_fractions(
    problem: BlendProblem, outcome: OptimisationOutcome, start: Sequence[SplineWeight]
) -> OptimisationOutcome:
    """The outcome with a log line for each stage on its solid fraction, with the shift and without it."""
    unshifted = problem.coarse.with_level_shifts([None] * len(start))
    lines = []
    for stage, weight in enumerate(start):
        coordinate = transition_coordinate(weight)
        uncorrected = measure_fraction_error(unshifted, start, coordinate, stage)
        corrected = measure_fraction_error(problem.coarse, outcome.state.weights, coordinate, stage)
        lines.append(
            f"solid fraction {corrected:.3f} from the interpolated one in the mean, {uncorrected:.3f} without the shift"
        )
    return replace(outcome, log=(*outcome.log, *lines))


def _sample_transition(
    composition: SampledComposition, weights: Sequence[WeightFunction], coordinate: WeightFunction, stage: int
) -> tuple[Array, Array, Array]:
    """Of each sample that a stage mixes: the transition coordinate, f, and the interpolated solidity of its structures."""
    mixed = composition.blending_masks[stage] & (composition.region_index <= stage + 1)
    position = coordinate(composition.grid.points(np.flatnonzero(mixed)))
    first, second = (composition.structures[k][mixed] <= 0 for k in (stage, stage + 1))
    return position, composition.values(weights)[mixed], (1 - position) * first + position * second
