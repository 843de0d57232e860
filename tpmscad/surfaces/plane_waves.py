"""Level sets of surfaces as sums of plane waves, f(X) = Re sum_k a_k exp(2 pi i k . X), X in cells; f < 0 is solid.

The representation gives the gradient and the Hessian at the cost of two matrix products, and with them the shape operator of the
level set and the orthogonal projection of points onto it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import permutations, product
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.errors import NoFoot
from tpmscad.minimal_series import expand_series
from tpmscad.surfaces.differential_geometry import dot

GRADIENT_STEPS, MAX_FOOT_NEWTON_STEPS = 4, 12
"""Steps along the gradient, then steps of Newton's method; from half the radius of curvature the latter take six."""

FOOT_STEP_TOL_CELLS = 1e-13
"""Length of the last Newton step, in cells, below which a foot point has converged."""


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


def _sine_waves(waves: ArrayLike, factor: float) -> PlaneWaves:
    """The sum of factor * sin(2 pi k . X)."""
    wave = np.asarray(waves, float)
    return PlaneWaves(wave, np.full(len(wave), -1j * factor))


def _cosine_orbits(orbits: Mapping[tuple[int, int, int], float]) -> PlaneWaves:
    """The sum of factor * cos ax cos by cos cz over all distinct permutations of each (a, b, c)."""
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
    """Sign of the first nonzero frequency: k and -k give the same cosine, and one of the two is enough."""
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


@cache
def level_set_waves(name: str, reference: str) -> PlaneWaves:
    """The function whose zero set is a surface: the nodal formula, or the series of the minimal surface."""
    return NODAL_WAVES[name] if reference == "nodal" else PlaneWaves(*expand_series(name))
