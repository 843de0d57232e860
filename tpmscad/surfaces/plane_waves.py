"""Trigonometric level sets as sums of plane waves, f(X) = Re sum amplitude exp(2 pi i wave . X), X in cells; f < 0 is solid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations, product
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.errors import NoFoot

GRADIENT_STEPS, MAX_FOOT_NEWTON_STEPS = 4, 12
"""Steps along the gradient, then of Newton's method; from half the reach the latter take six."""

FOOT_STEP_TOL_CELLS = 1e-13
"""Cells: feet that move less are found."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneWaves:
    """wave (W, 3) integers, amplitude (W,) complex."""

    wave_vectors: Array
    amplitudes: Array

    def value(self, points: Array) -> Array:
        """f: (...)."""
        return np.asarray((self._waves(points)).real.sum(axis=-1))

    def gradient(self, points: Array) -> Array:
        """(..., 3), per cell."""
        k = 2 * np.pi * self.wave_vectors
        return np.asarray(-self._waves(points).imag @ k)

    def jet(self, points: Array) -> tuple[Array, Array, Array]:
        """f (...), its gradient (..., 3) and its second derivatives (..., 3, 3)."""
        k = 2 * np.pi * self.wave_vectors
        wave = self._waves(points)
        dyads = (k[:, :, None] * k[:, None, :]).reshape(-1, 9)
        hessian = (-wave.real @ dyads).reshape(*points.shape[:-1], 3, 3)
        return wave.real.sum(axis=-1), -wave.imag @ k, hessian

    def shape_operator(self, points: Array) -> Array:
        """The derivative of the unit normal along the level set, (..., 3, 3); minus the curvatures on the tangent plane."""
        _, gradient, hessian = self.jet(points)
        length = np.linalg.norm(gradient, axis=-1)[..., None, None]
        n = gradient / length[..., 0]
        tangential = np.eye(3) - n[..., :, None] * n[..., None, :]
        return np.asarray(tangential @ hessian @ tangential / length)

    def project_to_level_set(self, points: Array) -> tuple[Array, Array, Array]:
        """Signed distance (...), unit normal (..., 3) and foot (..., 3) of points on f = 0, the distance along the gradient.

        Newton's method on X - foot - d n = 0, f(foot) = 0, from the point itself. NoFoot where it does not settle, which points
        nearer than the reach don't meet.
        """
        foot = np.array(points, float)
        for _ in range(GRADIENT_STEPS):
            wave = self._waves(foot)
            g = -wave.imag @ (2 * np.pi * self.wave_vectors)
            foot -= (wave.real.sum(axis=-1) / _dot(g, g))[..., None] * g
        system = np.zeros((*foot.shape[:-1], 4, 4))
        for _ in range(MAX_FOOT_NEWTON_STEPS):
            value, g, hessian = self.jet(foot)
            length = np.linalg.norm(g, axis=-1, keepdims=True)
            n = g / length
            distance = _dot(points - foot, n)
            turning = (
                (np.eye(3) - n[..., :, None] * n[..., None, :]) @ hessian / length[..., None]
            )  # of n, with the foot
            system[..., :3, :3] = np.eye(3) + distance[..., None, None] * turning
            system[..., :3, 3] = n
            system[..., 3, :3] = g
            left = np.concatenate([points - foot - distance[..., None] * n, -value[..., None]], axis=-1)
            step = np.linalg.solve(system, left[..., None])[..., :3, 0]
            foot += step
            if np.abs(step).max(initial=0.0) < FOOT_STEP_TOL_CELLS:
                break
        else:
            raise NoFoot(
                f"{np.count_nonzero(np.abs(step).max(axis=-1) > FOOT_STEP_TOL_CELLS)} points are too far from the level set"
            )
        g = self.gradient(foot)
        n = g / np.linalg.norm(g, axis=-1, keepdims=True)
        return _dot(points - foot, n), n, foot

    def _waves(self, points: Array) -> Array:
        return np.asarray(self.amplitudes * np.exp(2j * np.pi * (points @ self.wave_vectors.T)))


def _sine_waves(waves: ArrayLike, factor: float) -> PlaneWaves:
    wave = np.asarray(waves, float)
    return PlaneWaves(wave, np.full(len(wave), -1j * factor))


def _cosine_orbits(orbits: Mapping[tuple[int, int, int], float]) -> PlaneWaves:
    """The sum of factor * cos ax cos by cos cz over all distinct orders of each (a, b, c)."""
    wave, amplitude = [], []
    for orbit, factor in orbits.items():
        for frequencies in sorted(set(permutations(orbit))):
            signs = [
                s for s in product(*[(1, -1) if k else (1,) for k in frequencies]) if _leading_sign(s, frequencies) > 0
            ]
            wave += [np.multiply(s, frequencies) for s in signs]
            amplitude += [factor / len(signs)] * len(signs)
    return PlaneWaves(np.array(wave, float), np.array(amplitude, complex))


def _leading_sign(signs: tuple[int, ...], frequencies: tuple[int, ...]) -> int:
    """The sign of the first frequency that is not zero: of a wave and its opposite, one is enough."""
    return next((s for s, k in zip(signs, frequencies, strict=True) if k), 1)


NODAL_WAVES: Mapping[str, PlaneWaves] = MappingProxyType(
    {
        # sin x cos y = (sin(x + y) + sin(x - y)) / 2, and cyclically
        "gyroid": _sine_waves([[1, 1, 0], [1, -1, 0], [0, 1, 1], [0, 1, -1], [1, 0, 1], [-1, 0, 1]], 0.5),
        # sin x (sin y sin z + cos y cos z) + cos x (sin y cos z + cos y sin z)
        "diamond": _sine_waves([[1, 1, -1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], 0.5),
        "schwarz_p": PlaneWaves(np.eye(3), np.ones(3, complex)),
        "iwp": _cosine_orbits({(1, 1, 0): 2.0, (2, 0, 0): -1.0}),
        "neovius": _cosine_orbits({(1, 0, 0): 3.0, (1, 1, 1): 4.0}),
        "frd": _cosine_orbits({(1, 1, 1): 4.0, (2, 2, 0): -1.0}),
    }
)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))
