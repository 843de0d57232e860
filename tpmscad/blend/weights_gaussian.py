"""The earlier weight by Gaussian radial basis functions (Yang et al. 2014), for regions of any shape.

Data points on a regular grid carry 0 or 1, the region they are in; those in the blending region are left out. The weight is the
mean of the data with weights exp(-|x - x_i|^2 / delta), distances in parts of the domain's longest edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.blend.grid import Array, Box, Field, lattice

DELTA = 0.02
"""The blending paper's width, section 4.2."""

PER_AXIS = 20
"""The blending paper's data points along each axis."""

CHUNK = 4_000
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
        parts = [self._of(flat[i : i + CHUNK]) for i in range(0, len(flat), CHUNK)]
        return np.concatenate([above / below for above, below in parts] or [np.zeros(0)]).reshape(points.shape[:-1])

    def gradient(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        flat = points.reshape(-1, 3)
        slopes = np.zeros(flat.shape)
        for i in range(0, len(flat), CHUNK):
            part = slice(i, i + CHUNK)
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
        sums = (bells[0] @ np.moveaxis(both, 1, 0).reshape(PER_AXIS, -1)).reshape(-1, 2, PER_AXIS, PER_AXIS)
        sums = np.matmul(bells[1][:, None, None, :], sums)[:, :, 0]
        sums = np.matmul(sums, bells[2][:, :, None])[..., 0]
        return sums[:, 0], sums[:, 1]


def gaussian_weight(first: Field, second: Field, blending: Field, domain: Box, delta: float = DELTA) -> GaussianWeight:
    """The weight of data at 20 points along each axis: 0 in `first`, 1 in `second`."""
    x, y, z = (np.linspace(a, b, PER_AXIS) for a, b in zip(*domain, strict=True))
    points = lattice((x, y, z))
    outside = np.asarray(blending(points)) > 0
    one = outside & (np.asarray(second(points)) <= 0)
    zero = outside & (np.asarray(first(points)) <= 0) & ~one
    longest = max(b - a for a, b in zip(*domain, strict=True))
    return GaussianWeight((x, y, z), one.astype(float), (one | zero).astype(float), delta * longest**2)
