"""Trigonometric level sets as sums of plane waves, f(X) = Re sum amplitude exp(2 pi i wave . X), X in cells; f < 0 is solid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations, product
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.errors import TpmscadError
from tpmscad.surfaces.jet import Array

APPROACH_STEPS, FOOT_STEPS = 4, 12
"""Steps along the gradient, then of Newton's method; from half the reach the latter take six."""

FOOT = 1e-13
"""Cells: feet that move less are found."""


class NoFoot(TpmscadError):
    """A point is too far from the level set for its foot to be found from it."""


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """wave (W, 3) integers, amplitude (W,) complex."""

    wave: Array
    amplitude: Array

    def value(self, points: Array) -> Array:
        """f: (...)."""
        return np.asarray((self._waves(points)).real.sum(axis=-1))

    def gradient(self, points: Array) -> Array:
        """(..., 3), per cell."""
        k = 2 * np.pi * self.wave
        return np.asarray(-self._waves(points).imag @ k)

    def hessian(self, points: Array) -> Array:
        """(..., 3, 3)."""
        k = 2 * np.pi * self.wave
        dyads = (k[:, :, None] * k[:, None, :]).reshape(-1, 9)
        return np.asarray(-self._waves(points).real @ dyads).reshape(*points.shape[:-1], 3, 3)

    def shape_operator(self, points: Array) -> Array:
        """The derivative of the unit normal along the level set, (..., 3, 3); minus the curvatures on the tangent plane."""
        gradient = self.gradient(points)
        length = np.linalg.norm(gradient, axis=-1)[..., None, None]
        n = gradient / length[..., 0]
        tangential = np.eye(3) - n[..., :, None] * n[..., None, :]
        return np.asarray(tangential @ self.hessian(points) @ tangential / length)

    def foot(self, points: Array) -> tuple[Array, Array, Array]:
        """Signed distance (...), unit normal (..., 3) and foot (..., 3) of points on f = 0, the distance along the gradient.

        Newton's method on X - foot - d n = 0, f(foot) = 0, from the point itself. NoFoot where it does not settle, which points
        nearer than the reach don't meet.
        """
        foot = np.array(points, float)
        for _ in range(APPROACH_STEPS):
            g = self.gradient(foot)
            foot -= (self.value(foot) / _dot(g, g))[..., None] * g
        system = np.zeros((*foot.shape[:-1], 4, 4))
        for _ in range(FOOT_STEPS):
            g = self.gradient(foot)
            n = g / np.linalg.norm(g, axis=-1, keepdims=True)
            distance = _dot(points - foot, n)
            system[..., :3, :3] = np.eye(3) + distance[..., None, None] * self._turning(foot, n, g)
            system[..., :3, 3] = n
            system[..., 3, :3] = g
            left = np.concatenate([points - foot - distance[..., None] * n, -self.value(foot)[..., None]], axis=-1)
            step = np.linalg.solve(system, left[..., None])[..., :3, 0]
            foot += step
            if np.abs(step).max(initial=0.0) < FOOT:
                break
        else:
            raise NoFoot(f"{np.count_nonzero(np.abs(step).max(axis=-1) > FOOT)} points are too far from the level set")
        g = self.gradient(foot)
        n = g / np.linalg.norm(g, axis=-1, keepdims=True)
        return _dot(points - foot, n), n, foot

    def _turning(self, points: Array, n: Array, gradient: Array) -> Array:
        """The derivative of the unit gradient: (..., 3, 3)."""
        length = np.linalg.norm(gradient, axis=-1)[..., None, None]
        return np.asarray((np.eye(3) - n[..., :, None] * n[..., None, :]) @ self.hessian(points) / length)

    def _waves(self, points: Array) -> Array:
        return np.asarray(self.amplitude * np.exp(2j * np.pi * (points @ self.wave.T)))


def _sines(waves: ArrayLike, factor: float) -> Waves:
    wave = np.asarray(waves, float)
    return Waves(wave, np.full(len(wave), -1j * factor))


def _cosines(orbits: Mapping[tuple[int, int, int], float]) -> Waves:
    """The sum of factor * cos ax cos by cos cz over all distinct orders of each (a, b, c)."""
    wave, amplitude = [], []
    for orbit, factor in orbits.items():
        for frequencies in sorted(set(permutations(orbit))):
            signs = list(product(*[(1, -1) if k else (1,) for k in frequencies]))
            wave += [np.multiply(s, frequencies) for s in signs]
            amplitude += [factor / len(signs)] * len(signs)
    return Waves(np.array(wave, float), np.array(amplitude, complex))


WAVES: Mapping[str, Waves] = MappingProxyType(
    {
        # sin x cos y = (sin(x + y) + sin(x - y)) / 2, and cyclically
        "gyroid": _sines([[1, 1, 0], [1, -1, 0], [0, 1, 1], [0, 1, -1], [1, 0, 1], [-1, 0, 1]], 0.5),
        # sin x (sin y sin z + cos y cos z) + cos x (sin y cos z + cos y sin z)
        "diamond": _sines([[1, 1, -1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], 0.5),
        "schwarz_p": Waves(np.eye(3), np.ones(3, complex)),
        "iwp": _cosines({(1, 1, 0): 2.0, (2, 0, 0): -1.0}),
        "neovius": _cosines({(1, 0, 0): 3.0, (1, 1, 1): 4.0}),
        "frd": _cosines({(1, 1, 1): 4.0, (2, 2, 0): -1.0}),
    }
)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))
