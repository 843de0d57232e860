"""Earlier one-dimensional weights, by fixed profiles of a coordinate: the sigmoid and beta growth.

Sigmoid: Yang, Quan, Zhang, Tian, Computer-Aided Design 56 (2014) 11-21, w = 1 / (1 + exp(-k (t - middle))). Here k makes w run
from 0.01 to 0.99 over the layer, and it is cut off at the layer's ends.
Beta growth: Yoo, Kim, Int. J. Precis. Eng. Manuf. 16 (2015), with start t_b, end t_e and steepest point t_m of the growth:
w = (1 + (t_e - t) / (t_e - t_m)) ((t - t_b) / (t_e - t_b)) ^ ((t_e - t_b) / (t_e - t_m)).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.blend.coordinates import Coordinate
from tpmscad.blend.grid import Array, lattice

SIGMOID_ENDS = 0.01
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
        return self(lattice((x, y, z)))

    def _part(self, points: Array) -> Array:
        return (self.coordinate(points) - self.start) / (self.end - self.start)

    def _value(self, s: Array) -> Array:
        if self.profile == "sigmoid":
            return 1.0 / (1.0 + np.exp(-_STEEPNESS * (s - self.middle)))
        rest = 1.0 - self.middle
        return np.asarray((1.0 + (1.0 - s) / rest) * s ** (1.0 / rest))

    def _slope(self, s: Array) -> Array:
        if self.profile == "sigmoid":
            value = self._value(s)
            return np.asarray(_STEEPNESS * value * (1.0 - value))
        rest = 1.0 - self.middle
        power = 1.0 / rest
        return np.asarray(-power * s**power + (1.0 + (1.0 - s) / rest) * power * s ** (power - 1.0))


_STEEPNESS = 2.0 * np.log(1.0 / SIGMOID_ENDS - 1.0)
