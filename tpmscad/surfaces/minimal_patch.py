"""The exact minimal surfaces in the unit cubic cell, each placed on the nodal surface of its name.

The Weierstrass frame has its z axis along one cubic axis and the other two on its xy diagonals; the centre of the patch goes to
a point of symmetry -4. All three placements are proper and bring the normal along the gradient of the nodal function (of the two
Bonnet angles +-theta of the gyroid, one does). The cell edges are closed forms with K = K(k = 1/2) and K' = K(k = sqrt(3)/2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.special import ellipk

from tpmscad._typing import Array
from tpmscad.surfaces.weierstrass import KLEIN_HALF_SIDE, MIN_CURVATURE_RADIUS, evaluate_weierstrass

_K, _K1 = float(ellipk(1 / 4)), float(ellipk(3 / 4))  # SciPy's argument is k^2
_HYPOT = float(np.hypot(_K, _K1))
_AXES = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2.0)]]) / np.sqrt(2.0)


@dataclass(frozen=True, slots=True)
class WeierstrassPlacement:
    """e^(i theta), the cubic cell's edge in raw Weierstrass units, the patch's centre in the unit cell."""

    bonnet: complex
    cell: float
    centre: tuple[float, float, float]


PLACEMENTS: Mapping[str, WeierstrassPlacement] = MappingProxyType(
    {
        "gyroid": WeierstrassPlacement(
            complex(_K1, _K) / _HYPOT, 2 * _K * _K1 / _HYPOT, (0, 1 / 4, 3 / 8)
        ),  # theta = arccot(K'/K)
        "diamond": WeierstrassPlacement(1, 2 * _K, (3 / 8, 3 / 8, 5 / 8)),
        "schwarz_p": WeierstrassPlacement(1j, _K1, (0, 1 / 2, 1 / 4)),
    }
)


def mid_and_normal(name: str, u: Array, v: Array) -> tuple[Array, Array]:
    """The surface and its unit normal, each with its derivatives by (u, v): (6, ..., 3), value, u, v, uu, uv, vv."""
    placed = PLACEMENTS[name]
    mid, normal = evaluate_weierstrass(KLEIN_HALF_SIDE * (2 * u - 1), KLEIN_HALF_SIDE * (2 * v - 1), placed.bonnet)
    to_cells = np.einsum("k,ij->kij", (2 * KLEIN_HALF_SIDE) ** np.array([0, 1, 1, 2, 2, 2]), _AXES)
    mid = np.einsum("kij,kj...->k...i", to_cells / placed.cell, mid)
    normal = np.einsum("kij,kj...->k...i", to_cells, normal)
    mid[0] += placed.centre
    return mid, normal


def max_offset(name: str) -> float:
    """The least radius of curvature, in cells: offsets stay below it."""
    return MIN_CURVATURE_RADIUS / PLACEMENTS[name].cell


def patch_area(name: str) -> float:
    """Area of one patch, in cells squared: K K' / 4 in raw units, for all associates alike."""
    return _K * _K1 / 4 / PLACEMENTS[name].cell ** 2
