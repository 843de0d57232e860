"""Volume fractions of sheets and of the two sides, in closed form, and the offsets that make a volume fraction.

Steiner's formula: between the mid surface and its offset at d lies d A - d^2 int H + d^3/3 int K, per cubic cell. On a patch of
a minimal surface int K is minus the solid angle of the Gauss map, -2 pi / 3; int H vanishes, for the minimal surface as H does,
for its nodal namesake since the patch's rotoinversion swaps the sides; the mid surface halves the cell for the same reason. So
everything is exact, but for the area, which is K K' / 4 a patch (raw) for the minimal surface and a converged quadrature for the
nodal one. `mirror_measures` has the same for mirror surfaces, whose sides may differ.

Lengths are in cells unless said otherwise; the solid on side "-" is that where the nodal function is negative.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.optimize import brentq

from tpmscad.errors import InvalidRequest
from tpmscad.surfaces import minimal
from tpmscad.surfaces.catalogue import check_reference, find
from tpmscad.surfaces.curvature import element
from tpmscad.surfaces.measures import Measures
from tpmscad.surfaces.mirror_measures import mirror_measures
from tpmscad.surfaces.patch import patch

QUADRATURE = 32
"""Gauss-Legendre points each way: the area of the nodal surfaces is converged to round-off at 24."""


@cache
def measures(name: str, reference: str) -> Measures:
    """Area, curvature integrals and greatest offsets of a catalogued surface, per cubic cell."""
    info = find(name)
    if info.primitives == "mirrored":
        check_reference(info, reference)
        return mirror_measures(info.name)
    surface = patch(name, reference)
    limit = surface.max_offset
    return Measures(area(name, reference), 0.0, -info.patches_per_cell * 2 * np.pi / 3, 0.5, -limit, limit)


@cache
def area(name: str, reference: str = "minimal") -> float:
    """Area of the mid surface in one cubic cell, in cells squared."""
    info = find(name)
    if info.primitives == "mirrored":
        return measures(name, reference).area
    surface = patch(name, reference)
    patches = info.patches_per_cell
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
    of = measures(name, reference)
    for offset in (lower, upper):
        within_reach(name, reference, offset)
    if not lower < upper:
        raise InvalidRequest(f"lower offset {lower:g} is not below the upper {upper:g}; swap them or thicken the wall")
    return of.swept(upper) - of.swept(lower)


def skeletal_volume_fraction(name: str, reference: str, offset: float = 0.0, side: str = "-") -> float:
    """Volume on one side of the offset surface, per volume of the cell."""
    of = measures(name, reference)
    within_reach(name, reference, offset)
    below = of.below + of.swept(offset)
    return below if _sign(side) > 0 else 1 - below


def thickness_for(name: str, reference: str, volume_fraction: float) -> float:
    """The wall thickness, symmetric about the mid surface, that makes the volume fraction.

    InvalidRequest where that takes more than the greatest offset.
    """
    of = measures(name, reference)
    limit = min(of.highest, -of.lowest)
    most = of.swept(limit) - of.swept(-limit)
    if not 0 < volume_fraction < most:
        raise _out_of_reach(name, reference, "sheet", volume_fraction, 0.0, most)
    return 2 * float(brentq(lambda d: of.swept(d) - of.swept(-d) - volume_fraction, 0.0, limit, xtol=1e-17))


def skeletal_offset_for(name: str, reference: str, volume_fraction: float, side: str = "-") -> float:
    """The offset of the surface with that volume fraction on the given side."""
    of = measures(name, reference)
    below = volume_fraction if _sign(side) > 0 else 1 - volume_fraction
    least, most = of.below + of.swept(of.lowest), of.below + of.swept(of.highest)
    if not (least < below < most and 0 < volume_fraction < 1):
        least, most = max(least, 0.0), min(most, 1.0)
        ends = (least, most) if _sign(side) > 0 else (1 - most, 1 - least)
        raise _out_of_reach(name, reference, "skeletal solid", volume_fraction, *ends)
    return float(brentq(lambda d: of.below + of.swept(d) - below, of.lowest, of.highest, xtol=1e-17))


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


def within_reach(name: str, reference: str, offset: float, cell: float = 1.0) -> None:
    """InvalidRequest where the offset, in the units of `cell`, passes the surface's curvature radius."""
    of = measures(name, reference)
    lowest, highest = of.lowest * cell, of.highest * cell
    if lowest < offset < highest:
        return
    thickest = 2 * min(highest, -lowest)
    limits = f"below {highest:.6g}" if highest == -lowest else f"between {lowest:.6g} and {highest:.6g}"
    raise InvalidRequest(
        f"offset {offset:g} (thickness {2 * abs(offset):g} if symmetric) of the {reference} {find(name).name} passes its "
        f"curvature radius at cell {cell:g}: offsets stay {limits}, thickness below {thickest:.6g}; thin the wall or "
        "enlarge the cell"
    )


def _out_of_reach(name: str, reference: str, solid: str, fraction: float, low: float, high: float) -> InvalidRequest:
    of = measures(name, reference)
    limits = f"below {of.highest:.6g}" if of.highest == -of.lowest else f"between {of.lowest:.6g} and {of.highest:.6g}"
    return InvalidRequest(
        f"volume fraction {fraction:g} is out of reach of a {find(name).name} {solid}: offsets stay {limits} cells "
        f"({reference} surface), so volume fractions between {low:.6g} and {high:.6g}"
    )


def _sign(side: str) -> int:
    if side not in ("-", "+"):
        raise InvalidRequest(f"side {side!r} is unknown; choose '-' or '+'")
    return 1 if side == "-" else -1
