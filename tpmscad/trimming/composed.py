"""The signed distance from one surface along one patch: a scalar function of (u, v) with the ways of a scalar B-spline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.splines.bspline import Surface
from tpmscad.trimming.levels import Levels
from tpmscad.trimming.tool import Array


@dataclass(frozen=True, slots=True, eq=False)
class Composed:
    """g(S(u, v)) for the surface S and the one row g; derivatives up to the second order."""

    surface: Surface
    level: Levels

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return self.surface.domain

    def grid(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """(len(u), len(v), 1)"""
        return self._chained(lambda i, j: self.surface.grid(u, v, i, j), du, dv)

    def __call__(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """(..., 1)"""
        return self._chained(lambda i, j: self.surface(u, v, i, j), du, dv)

    def _chained(self, s: Callable[[int, int], Array], du: int, dv: int) -> Array:
        points = s(0, 0)
        found = self.level.jet(points.reshape(1, -1, 3), du + dv)
        jet = [d.reshape((*points.shape[:-1], *(3,) * k)) for k, d in enumerate(found)]
        if du + dv == 0:
            return jet[0][..., None]
        result = np.einsum("...i,...i->...", jet[1], s(du, dv))
        if du + dv == 2:
            first = s(1, 0) if du else s(0, 1)
            second = s(0, 1) if dv else s(1, 0)
            result = result + np.einsum("...i,...ij,...j->...", first, jet[2], second)
        return result[..., None]


def level_on(surface: Surface, level: Levels) -> Surface | Composed:
    """The distance from the one row `level` along the patch; from a plane it is a B-spline itself."""
    if not level.flat[0]:
        return Composed(surface, level)
    poles = surface.poles @ level.axis[0] + level.a[0]
    return Surface(poles[..., None], surface.knots_u, surface.knots_v, surface.degree_u, surface.degree_v)
