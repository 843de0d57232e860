"""Interpolation of samples on a uniform grid by Gaussians: a function with all derivatives, near any samples.

The function is a linear one plus a sum of Gaussians at the grid points. Linear functions are kept exactly; a crease is rounded
over about a spacing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array

WIDTH = 0.8
"""Standard deviation of the Gaussians in spacings: sums of equal ones are constant to 1e-5, and the system's condition is 12."""

REACH = 6
"""Spacings within which the Gaussians count: beyond they are below 1e-12."""

PADDING = 30
"""Spacings beyond the samples by which these are continued: the end of the system is then felt nowhere among them."""


@dataclass(frozen=True, slots=True, eq=False)
class GaussianInterpolant:
    """The function trend[0] + trend[1:] . p + sum of `weights` (X, Y, Z) times Gaussians about a grid, model units.

    It is meant for points up to a spacing beyond the samples, and has the slope of the linear part farther out.
    """

    origin: Array
    spacing: float
    trend: Array
    weights: Array

    def __call__(self, points: Array) -> Array:
        """Values (n,) at points (n, 3)."""
        at = (points - self.origin) / self.spacing
        return self.trend[0] + points @ self.trend[1:] + _sum_gaussians(self.weights, np.ascontiguousarray(at))


def interpolate_samples(values: Array, origin: Array, spacing: float) -> GaussianInterpolant:
    """The interpolant of samples (X, Y, Z) at origin + spacing * (i, j, k)."""
    axes = [o + spacing * np.arange(n) for o, n in zip(origin, values.shape, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    rows = np.column_stack([np.ones(len(points)), points])
    trend = np.linalg.lstsq(rows, values.ravel(), rcond=None)[0]
    weights = np.pad(values - (rows @ trend).reshape(values.shape), PADDING, mode="reflect", reflect_type="odd")
    bell = np.exp(-0.5 * (np.arange(REACH + 1) / WIDTH) ** 2)
    for axis in range(3):
        first = np.moveaxis(weights, axis, 0)
        solved = solveh_banded(
            np.repeat(bell[:, None], len(first), axis=1), first.reshape(len(first), -1), lower=True, check_finite=False
        )
        weights = np.moveaxis(solved.reshape(first.shape), 0, axis)
    kept = (slice(PADDING - REACH, REACH - PADDING),) * 3
    return GaussianInterpolant(origin - REACH * spacing, spacing, trend, np.ascontiguousarray(weights[kept]))


@njit_cached
def _sum_gaussians(weights: Array, at: Array) -> Array:  # pragma: no cover - compiled
    """Sums (n,) of the Gaussians at points (n, 3), in spacings from the first."""
    count, scale = 2 * REACH, 0.5 / WIDTH**2
    result, bells, first = np.zeros(len(at)), np.empty((3, count)), np.empty(3, np.int64)
    bell = np.exp(-scale * np.arange(-REACH + 1, REACH + 1) ** 2.0)
    for n in range(len(at)):
        for axis in range(3):
            x = min(max(at[n, axis], REACH - 1.0), weights.shape[axis] - REACH - 1.0)
            low = int(np.floor(x))
            first[axis] = low - REACH + 1
            # exp(-scale (t - k)^2) = exp(-scale t^2) exp(2 scale t)^k exp(-scale k^2)
            t = x - low
            factor, ratio = np.exp(-scale * t * t - 2 * scale * t * (REACH - 1)), np.exp(2 * scale * t)
            for k in range(count):
                bells[axis, k] = factor * bell[k]
                factor *= ratio
        total = 0.0
        for i in range(count):
            plane = 0.0
            for j in range(count):
                line = weights[first[0] + i, first[1] + j]
                row = 0.0
                for k in range(count):
                    row += bells[2, k] * line[first[2] + k]
                plane += bells[1, j] * row
            total += bells[0, i] * plane
        result[n] = total
    return result
