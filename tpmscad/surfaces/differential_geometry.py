"""The second-order jet of a surface at its parameters: what a fit, a joint or a Newton step needs to know of it.

Curvatures of a patch from the derivatives of its mid surface and normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from tpmscad._typing import Array


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceJet:
    """Position, first and second derivatives with respect to (u, v), and the unit normal; all (..., 3).

    The normal is that of the mid surface, which its offset surfaces share.
    """

    position: Array
    du: Array
    dv: Array
    duu: Array
    duv: Array
    dvv: Array
    normal: Array


SEARCH_POINTS = 41
"""Points each way to start the search for the greatest curvature from; curvature varies over about a third of a patch."""

MidAndNormal = Callable[[Array, Array], tuple[Array, Array]]
"""(u, v) -> mid surface and unit normal with derivatives, each (6, ..., 3)."""


def area_element(mid: Array) -> Array:
    """|X_u x X_v|: (...)."""
    return np.linalg.norm(np.cross(mid[1], mid[2]), axis=-1)


def mean_and_gauss_curvature(mid: Array, normal: Array) -> tuple[Array, Array]:
    """Mean and Gauss curvature, (...) each; mean curvature is positive where the surface bends towards the normal."""
    e, f, g = (_dot(mid[a], mid[b]) for a, b in ((1, 1), (1, 2), (2, 2)))
    ee, ff, gg = (-_dot(mid[a], normal[b]) for a, b in ((1, 1), (1, 2), (2, 2)))
    area = e * g - f * f
    return (e * gg - 2 * f * ff + g * ee) / (2 * area), (ee * gg - ff * ff) / area


def min_curvature_radius(evaluate: MidAndNormal) -> float:
    """The least radius of curvature on the unit square: offsets below it, on either side, have no cusps.

    A grid, then a local search without derivatives: the greatest curvature can be at a kink of the maximum of two.
    """

    def greatest(u: Array, v: Array) -> Array:
        mean, gauss = mean_and_gauss_curvature(*evaluate(u, v))
        return np.abs(mean) + np.sqrt(np.maximum(mean**2 - gauss, 0.0))

    u, v = np.meshgrid(*[np.linspace(0.0, 1.0, SEARCH_POINTS)] * 2, indexing="ij")
    curvature = greatest(u, v)
    start = np.unravel_index(np.argmax(curvature), curvature.shape)
    found = minimize(
        lambda p: -float(greatest(p[0], p[1])),
        [u[start], v[start]],
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * 2,
        options={"xatol": 1e-9, "fatol": 1e-15, "initial_simplex": _start_simplex(float(u[start]), float(v[start]))},
    )
    return 1.0 / max(float(curvature.max()), -float(found.fun))


def _start_simplex(u: float, v: float) -> Array:
    step = 0.5 / (SEARCH_POINTS - 1)
    return np.clip([[u, v], [u + step, v], [u, v + step]], 0.0, 1.0)


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)
