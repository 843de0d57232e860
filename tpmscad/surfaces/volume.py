"""Volume fractions of sheets and of the two sides, in closed form, and the offsets that make a volume fraction.

Steiner's formula: between the mid surface and its offset at d lies d A - d^2 int H + d^3/3 int K, per cubic cell. int K is
minus the solid angle of the Gauss map, -2 pi / 3 a patch, and int H vanishes: for the minimal surface as H does, for the nodal
one since its rotoinversion swaps the sides. The mid surface halves the cell for the same reason. So everything is exact, but
for the area, which is K K' / 4 a patch (raw) for the minimal surface and a converged quadrature for the nodal one.

Lengths are in cells unless said otherwise; the solid on side "-" is that where the nodal function is negative.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.optimize import brentq

from tpmscad.errors import InvalidRequest
from tpmscad.surfaces import minimal
from tpmscad.surfaces.catalogue import find
from tpmscad.surfaces.curvature import element
from tpmscad.surfaces.patch import SurfacePatch, patch

QUADRATURE = 32
"""Gauss-Legendre points each way: the area of the nodal surfaces is converged to round-off at 24."""


@cache
def area(name: str, reference: str = "minimal") -> float:
    """Area of the mid surface in one cubic cell, in cells squared."""
    surface = patch(name, reference)
    patches = find(name).patches_per_cell
    if surface.reference == "minimal":
        return patches * minimal.area(surface.name)
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    u, v = np.meshgrid((x + 1) / 2, (x + 1) / 2, indexing="ij")
    mid, _ = surface.mid_and_normal(u, v)
    return patches * float(w @ element(mid) @ w) / 4


def volume_fraction(name: str, reference: str, lower: float, upper: float) -> float:
    """Volume between the offsets lower < upper, per volume of the cell.

    InvalidRequest where they are out of order or past the greatest offset.
    """
    surface = patch(name, reference)
    for offset in (lower, upper):
        _check(surface, offset)
    if not lower < upper:
        raise InvalidRequest(f"lower offset {lower:g} is not below the upper {upper:g}; swap them or thicken the wall")
    return _swept(surface, upper) - _swept(surface, lower)


def skeletal_volume_fraction(name: str, reference: str, offset: float = 0.0, side: str = "-") -> float:
    """Volume on one side of the offset surface, per volume of the cell."""
    surface = patch(name, reference)
    _check(surface, offset)
    return 0.5 + _sign(side) * _swept(surface, offset)


def thickness_for(name: str, reference: str, volume_fraction: float) -> float:
    """The wall thickness, symmetric about the mid surface, that makes the volume fraction.

    InvalidRequest where that takes more than the greatest offset.
    """
    return 2 * _offset_for(patch(name, reference), volume_fraction, volume_fraction / 2, "sheet")


def skeletal_offset_for(name: str, reference: str, volume_fraction: float, side: str = "-") -> float:
    """The offset of the surface with that volume fraction on the given side."""
    return _offset_for(patch(name, reference), volume_fraction, _sign(side) * (volume_fraction - 0.5), "skeletal solid")


def offsets_for(
    name: str, reference: str, volume_fraction: float, kind: str, cell: float, side: str = "-"
) -> tuple[float, float]:
    """The offsets (lower, upper) that make the volume fraction, in the units of `cell`, the cubic cell's edge.

    `kind` is "sheet", or "skeletal" with one surface: both are its offset, and the solid is on `side` of it.
    """
    if kind == "sheet":
        half = thickness_for(name, reference, volume_fraction) / 2 * cell
        return -half, half
    if kind == "skeletal":
        offset = skeletal_offset_for(name, reference, volume_fraction, side) * cell
        return offset, offset
    raise InvalidRequest(f"kind {kind!r} is unknown; choose 'sheet' or 'skeletal'")


def _swept(surface: SurfacePatch, offset: float) -> float:
    """Volume between the mid surface and its offset, positive along the normal."""
    patches = find(surface.name).patches_per_cell
    return area(surface.name, surface.reference) * offset - patches * 2 * np.pi / 9 * offset**3


def _offset_for(surface: SurfacePatch, volume_fraction: float, swept: float, solid: str) -> float:
    """The offset that sweeps the volume: it grows with the offset up to the greatest one."""
    limit = surface.max_offset
    most = _swept(surface, limit)
    if not abs(swept) < most or not 0 < volume_fraction < 1:
        low, high = (0.0, 2 * most) if solid == "sheet" else (0.5 - most, 0.5 + most)
        raise InvalidRequest(
            f"volume fraction {volume_fraction:g} is out of reach of a {surface.name} {solid}: offsets stay below "
            f"{limit:.6g} cells ({surface.reference} surface), so volume fractions between {low:.6g} and {high:.6g}"
        )
    return float(brentq(lambda d: _swept(surface, d) - swept, -limit, limit, xtol=1e-17))


def _check(surface: SurfacePatch, offset: float) -> None:
    surface.jet(0.5, 0.5, offset)  # says what is wrong with an offset that is too great


def _sign(side: str) -> int:
    if side not in ("-", "+"):
        raise InvalidRequest(f"side {side!r} is unknown; choose '-' or '+'")
    return 1 if side == "-" else -1
