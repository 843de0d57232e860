"""Patches of the exact minimal surfaces in the unit cubic cell, placed on the nodal surfaces of the same names.

The Weierstrass frame has its z axis along a cubic axis and its x and y axes along face diagonals; the centre of the patch lies at
a point of site symmetry -4. All three placements are proper motions that align the normal with the gradient of the nodal
function; for the gyroid this selects one of the two Bonnet angles +-theta. The cell edges are closed forms in the complete
elliptic integrals K = K(k = 1/2) and K' = K(k = sqrt(3)/2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.special import ellipk

from tpmscad._typing import Array
from tpmscad.surfaces.weierstrass import KLEIN_HALF_SIDE, MIN_CURVATURE_RADIUS, evaluate_weierstrass

_ELLIPTIC_K, _ELLIPTIC_K_PRIME = float(ellipk(1 / 4)), float(ellipk(3 / 4))  # SciPy's argument is k^2
_HYPOT = float(np.hypot(_ELLIPTIC_K, _ELLIPTIC_K_PRIME))
_AXES = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2.0)]]) / np.sqrt(2.0)


@dataclass(frozen=True, slots=True)
class WeierstrassPlacement:
    """Bonnet factor e^(i theta), edge of the cubic cell in raw Weierstrass units, centre of the patch in the unit cell."""

    bonnet: complex
    cell: float
    centre: tuple[float, float, float]


PLACEMENTS: Mapping[str, WeierstrassPlacement] = MappingProxyType(
    {
        "gyroid": WeierstrassPlacement(
            complex(_ELLIPTIC_K_PRIME, _ELLIPTIC_K) / _HYPOT,
            2 * _ELLIPTIC_K * _ELLIPTIC_K_PRIME / _HYPOT,
            (0, 1 / 4, 3 / 8),
        ),  # theta = arccot(K'/K)
        "diamond": WeierstrassPlacement(1, 2 * _ELLIPTIC_K, (3 / 8, 3 / 8, 5 / 8)),
        "schwarz_p": WeierstrassPlacement(1j, _ELLIPTIC_K_PRIME, (0, 1 / 2, 1 / 4)),
    }
)


def mid_and_normal(name: str, u: Array, v: Array) -> tuple[Array, Array]:
    """Surface and unit normal with their derivatives by (u, v): (6, ..., 3) each, value, u, v, uu, uv, vv."""
    placed = PLACEMENTS[name]
    mid, normal = evaluate_weierstrass(KLEIN_HALF_SIDE * (2 * u - 1), KLEIN_HALF_SIDE * (2 * v - 1), placed.bonnet)
    to_cells = np.einsum("k,ij->kij", (2 * KLEIN_HALF_SIDE) ** np.array([0, 1, 1, 2, 2, 2]), _AXES)
    mid = np.einsum("kij,kj...->k...i", to_cells / placed.cell, mid)
    normal = np.einsum("kij,kj...->k...i", to_cells, normal)
    mid[0] += placed.centre
    return mid, normal


def max_offset(name: str) -> float:
    """Least radius of curvature, in cells, which bounds the offsets."""
    return MIN_CURVATURE_RADIUS / PLACEMENTS[name].cell


def patch_area(name: str) -> float:
    """Area of one patch, in cells squared: K K' / 4 in raw units, the same for all associate surfaces."""
    return _ELLIPTIC_K * _ELLIPTIC_K_PRIME / 4 / PLACEMENTS[name].cell ** 2
