"""The signed distance from one surface along one patch: a function of (u, v), as a scalar B-spline is one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tpmscad.splines.bspline import Surface
from tpmscad.trimming.bases import bases
from tpmscad.trimming.levels import Levels
from tpmscad.trimming.tool import Array


@dataclass(frozen=True, slots=True, eq=False)
class Composed:
    """g(S(u, v)) for the surface S and the one row g."""

    surface: Surface
    level: Levels

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return self.surface.domain

    def grid(self, u: Array, v: Array, du: int = 0, dv: int = 0) -> Array:
        """Values or first derivatives on the grid of all u with all v: (len(u), len(v), 1)."""
        points = _sampled(self.surface, u.tobytes(), v.tobytes(), 0, 0)
        found = self.level.jet(points.reshape(1, -1, 3), du + dv)
        if du + dv == 0:
            return found[0].reshape((*points.shape[:-1], 1))
        along = _sampled(self.surface, u.tobytes(), v.tobytes(), du, dv)
        return np.einsum("nk,nk->n", found[1][0], along.reshape(-1, 3)).reshape((*points.shape[:-1], 1))


@lru_cache(maxsize=64)
def _sampled(surface: Surface, u: bytes, v: bytes, du: int, dv: int) -> Array:
    """A patch's points or derivatives on a grid: mostly the same grid for every surface that cuts the patch."""
    return surface.grid(np.frombuffer(u), np.frombuffer(v), du, dv)


def level_on(surface: Surface, level: Levels) -> Surface | Composed:
    """The distance from the one row `level` along the patch; from a plane it is a B-spline itself."""
    if not level.flat[0]:
        return Composed(surface, level)
    poles = surface.poles @ level.axis[0] + level.a[0]
    return Surface(poles[..., None], surface.knots_u, surface.knots_v, surface.degree_u, surface.degree_v)


def second_jet(level: Surface | Composed, at: Array) -> tuple[float, Array, Array]:
    """Value, gradient (2,) and second derivatives (2, 2) by u and v at one point."""
    surface = level if isinstance(level, Surface) else level.surface
    bu = [b[0] for b in bases(surface.knots_u, surface.degree_u, at[:1], 2)]
    bv = [b[0] for b in bases(surface.knots_v, surface.degree_v, at[1:], 2)]
    half = np.tensordot(np.stack(bu), surface.poles, 1)  # (3, V, D)
    s = np.einsum("kv,ivd->ikd", np.stack(bv), half)  # derivative (i, k)
    if isinstance(level, Surface):
        s = s[..., 0]
        return float(s[0, 0]), np.array([s[1, 0], s[0, 1]]), np.array([[s[2, 0], s[1, 1]], [s[1, 1], s[0, 2]]])
    value, gradient, hessian = (j[0, 0] for j in level.level.jet(s[0, 0][None, None], 2))
    first = np.stack([s[1, 0], s[0, 1]])
    second = np.array([[s[2, 0], s[1, 1]], [s[1, 1], s[0, 2]]]) @ gradient + first @ hessian @ first.T
    return float(value), first @ gradient, second
