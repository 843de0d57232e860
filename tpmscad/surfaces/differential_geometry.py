"""Differential geometry of parametrised surfaces: second-order jets, area element, curvatures, least radius of curvature."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from tpmscad._typing import Array

SEARCH_POINTS = 41
"""Grid points per parameter from which the search for the greatest curvature starts; curvature varies over a third of a patch."""

MidAndNormal = Callable[[Array, Array], tuple[Array, Array]]
"""(u, v) -> mid surface and unit normal with derivatives, each (6, ..., 3): value, u, v, uu, uv, vv."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceJet:
    """Position, first and second derivatives by (u, v), and unit normal of a surface; all (..., 3).

    The normal is that of the mid surface, which its offset surfaces share.
    """

    position: Array
    du: Array
    dv: Array
    duu: Array
    duv: Array
    dvv: Array
    normal: Array


def dot(a: Array, b: Array) -> Array:
    """Scalar product over the last axis: (...)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def area_element(mid: Array) -> Array:
    """|X_u x X_v| of a mid surface with derivatives (6, ..., 3): (...)."""
    return np.linalg.norm(np.cross(mid[1], mid[2]), axis=-1)


def mean_and_gauss_curvature(mid: Array, normal: Array) -> tuple[Array, Array]:
    """Mean and Gauss curvature, (...) each; the mean curvature is positive where the surface bends towards the normal."""
    e, f, g = (dot(mid[a], mid[b]) for a, b in ((1, 1), (1, 2), (2, 2)))
    ee, ff, gg = (-dot(mid[a], normal[b]) for a, b in ((1, 1), (1, 2), (2, 2)))
    area = e * g - f * f
    return (e * gg - 2 * f * ff + g * ee) / (2 * area), (ee * gg - ff * ff) / area


def min_curvature_radius(evaluate: MidAndNormal) -> float:
    """Least radius of curvature on the unit square; offsets below it, on either side, are regular."""

    def greatest_curvature(u: Array, v: Array) -> Array:
        mean, gauss = mean_and_gauss_curvature(*evaluate(u, v))
        return np.abs(mean) + np.sqrt(np.maximum(mean**2 - gauss, 0.0))

    u, v = np.meshgrid(*[np.linspace(0.0, 1.0, SEARCH_POINTS)] * 2, indexing="ij")
    curvature = greatest_curvature(u, v)
    start = np.unravel_index(np.argmax(curvature), curvature.shape)
    simplex = _clipped_simplex(float(u[start]), float(v[start]))
    return 1.0 / max(float(curvature.max()), maximise_on_unit_square(greatest_curvature, simplex, fatol=1e-15))


def maximise_on_unit_square(function: Callable[[Array, Array], Array], simplex: Array, *, fatol: float) -> float:
    """Local maximum of function(u, v) on the unit square by the Nelder-Mead method from a simplex (3, 2).

    The method needs no derivatives: the greatest of two principal curvatures has a kink where they are equal.
    """
    found = minimize(
        lambda p: -float(function(p[0], p[1])),
        simplex[0],
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * 2,
        options={"xatol": 1e-9, "fatol": fatol, "initial_simplex": simplex},
    )
    return -float(found.fun)


def _clipped_simplex(u: float, v: float) -> Array:
    """Simplex of half a grid step at (u, v), clipped to the unit square: (3, 2)."""
    step = 0.5 / (SEARCH_POINTS - 1)
    return np.clip([[u, v], [u + step, v], [u, v + step]], 0.0, 1.0)
