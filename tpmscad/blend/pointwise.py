"""The blended field at any points as an affine function of one stage's weight: what demands off the grid are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.blend.composition import BlendedField, Weighting
from tpmscad.blend.grid import Array


def affine(field: BlendedField, stage: int, points: Array) -> tuple[Array, Array]:
    """f at points (n, 3) without the weight of a stage and its change with it: f = first + w * second, each (n,)."""
    none, full = (_at(field, stage, points, value) for value in (0.0, 1.0))
    return none, full - none


@dataclass(frozen=True, slots=True)
class _Constant:
    value: float

    def __call__(self, points: ArrayLike) -> Array:
        points = np.asarray(points)
        return np.full(points.shape[:-1], self.value)

    def gradient(self, points: ArrayLike) -> Array:
        return np.zeros(np.shape(points))

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        return np.full((len(x), len(y), len(z)), self.value)


def _at(field: BlendedField, stage: int, points: Array, value: float) -> Array:
    weights: list[Weighting] = list(field.weights)
    weights[stage] = _Constant(value)
    return field.with_weights(weights)(points)
