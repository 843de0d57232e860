"""Level sets of surfaces as sums of plane waves, f(X) = Re sum_k a_k exp(2 pi i k . X), X in cells; f < 0 is solid.

The representation gives the gradient and the Hessian at the cost of two matrix products, and with them the shape operator of the
level set and the orthogonal projection of points onto it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import NoFoot
from tpmscad.fields.kinds.nodal_field import tpms
from tpmscad.minimal_series import expand_series
from tpmscad.surfaces.differential_geometry import dot

GRADIENT_STEPS, MAX_FOOT_NEWTON_STEPS = 4, 12
"""Steps along the gradient, then steps of Newton's method; from half the radius of curvature the latter take six."""

FOOT_STEP_TOL_CELLS = 1e-13
"""Length of the last Newton step, in cells, below which a foot point has converged."""

FORMULA_SAMPLES, ROUND_OFF = 32, 1e-12
"""Samples along a cell, of which a formula's waves are the discrete Fourier transform, and the amplitude that is none."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneWaves:
    """`wave_vectors` k (W, 3), integers; `amplitudes` a (W,), complex."""

    wave_vectors: Array
    amplitudes: Array

    def value(self, points: Array) -> Array:
        """Values f at points (..., 3): (...)."""
        return np.asarray((self._waves(points)).real.sum(axis=-1))

    def gradient(self, points: Array) -> Array:
        """Gradient of f per cell: (..., 3)."""
        k = 2 * np.pi * self.wave_vectors
        return np.asarray(-self._waves(points).imag @ k)

    def jet(self, points: Array) -> tuple[Array, Array, Array]:
        """Values (...), gradients (..., 3) and Hessians (..., 3, 3) of f."""
        k = 2 * np.pi * self.wave_vectors
        wave = self._waves(points)
        dyads = (k[:, :, None] * k[:, None, :]).reshape(-1, 9)
        hessian = (-wave.real @ dyads).reshape(*points.shape[:-1], 3, 3)
        return wave.real.sum(axis=-1), -wave.imag @ k, hessian

    def shape_operator(self, points: Array) -> Array:
        """Derivative of the unit normal along the level set, (..., 3, 3): minus the curvatures on the tangent plane."""
        _, gradient, hessian = self.jet(points)
        length = np.linalg.norm(gradient, axis=-1)[..., None, None]
        n = gradient / length[..., 0]
        tangential = np.eye(3) - n[..., :, None] * n[..., None, :]
        return np.asarray(tangential @ hessian @ tangential / length)

    def project_to_level_set(self, points: Array) -> tuple[Array, Array, Array]:
        """Orthogonal projection onto f = 0: signed distance (...), unit normal (..., 3) and foot point (..., 3).

        The distance is positive along the gradient. Newton's method solves X - F - d n(F) = 0, f(F) = 0 for the foot point F and
        the distance d, after a few steps along the gradient. It converges for points closer to the level set than its radius of
        curvature; for others it may raise NoFoot.
        """
        foot = np.array(points, float)
        for _ in range(GRADIENT_STEPS):
            wave = self._waves(foot)
            g = -wave.imag @ (2 * np.pi * self.wave_vectors)
            steepness = dot(g, g)
            if not steepness.all():
                raise NoFoot(f"{np.count_nonzero(steepness == 0)} points are critical points of the level-set function")
            foot -= (wave.real.sum(axis=-1) / steepness)[..., None] * g
        system = np.zeros((*foot.shape[:-1], 4, 4))
        for _ in range(MAX_FOOT_NEWTON_STEPS):
            value, g, hessian = self.jet(foot)
            length = np.linalg.norm(g, axis=-1, keepdims=True)
            n = g / length
            distance = dot(points - foot, n)
            normal_jacobian = (np.eye(3) - n[..., :, None] * n[..., None, :]) @ hessian / length[..., None]
            system[..., :3, :3] = np.eye(3) + distance[..., None, None] * normal_jacobian
            system[..., :3, 3] = n
            system[..., 3, :3] = g
            residual = np.concatenate([points - foot - distance[..., None] * n, -value[..., None]], axis=-1)
            step = np.linalg.solve(system, residual[..., None])[..., :3, 0]
            foot += step
            if np.abs(step).max(initial=0.0) < FOOT_STEP_TOL_CELLS:
                break
        else:
            raise NoFoot(
                f"{np.count_nonzero(np.abs(step).max(axis=-1) > FOOT_STEP_TOL_CELLS)} points are too far from the level set"
            )
        g = self.gradient(foot)
        n = g / np.linalg.norm(g, axis=-1, keepdims=True)
        return dot(points - foot, n), n, foot

    def _waves(self, points: Array) -> Array:
        """a_k exp(2 pi i k . X): (..., W)."""
        k = self.wave_vectors.astype(int)
        top = int(np.abs(k).max())
        # a series has hundreds of waves, but few frequencies along each axis: their products take a third of the time
        along = np.exp(2j * np.pi * np.arange(-top, top + 1) * points[..., None])
        x, y, z = (along[..., axis, k[:, axis] + top] for axis in range(3))
        return np.asarray(self.amplitudes * x * y * z)


@cache
def level_set_waves(name: str, reference: str) -> PlaneWaves:
    """The function whose zero set is a surface: the nodal formula, or the series of the minimal surface."""
    if reference == "minimal":
        return PlaneWaves(*expand_series(name))
    t = np.arange(FORMULA_SAMPLES) / FORMULA_SAMPLES
    spectrum = np.fft.fftn(tpms(name, 1.0).on_grid(t, t, t), norm="forward")
    index = np.argwhere(np.abs(spectrum) > ROUND_OFF)
    k = np.where(2 * index > FORMULA_SAMPLES, index - FORMULA_SAMPLES, index)
    leading = k[np.arange(len(k)), (k != 0).argmax(axis=1)]  # of k and -k, which give one real wave, the first is kept
    twice = np.where(leading > 0, 2.0, 1.0)
    amplitudes = np.round(twice * spectrum[tuple(index.T)], 14)
    return PlaneWaves(k[leading >= 0].astype(float), amplitudes[leading >= 0])
