"""What the volumes between a surface and its offsets follow from, by Steiner's formula.

Area, curvature integrals, volume and greatest offsets of a mirror surface's nodal level set, by quadrature of its one piece.

The piece is parametrised by the segments from one edge of the tetrahedron to the other (`MirrorSymmetry.on_segments`): an
analytic map of the square, for which Gauss-Legendre quadrature converges geometrically. Of the tetrahedron, the join of its
edges, the volume up to the part r of the segments is V times the integral of 3 r^2 - 2 r^3. The integral of the Gauss curvature
is known by Gauss-Bonnet: the sides are geodesics, the angles those of the walls. Lengths in cells, integrals per cell.

Volume fractions of sheets and of the two sides, in closed form, and the offsets that make a volume fraction.

Steiner's formula: between the mid surface and its offset at d lies d A - d^2 int H + d^3/3 int K, per cubic cell. On a patch of
a minimal surface int K is minus the solid angle of the Gauss map, -2 pi / 3; int H vanishes, for the minimal surface as H does,
for its nodal namesake since the patch's rotoinversion swaps the sides; the mid surface halves the cell for the same reason. So
everything is exact, but for the area, which is K K' / 4 a patch (raw) for the minimal surface and a converged quadrature for the
nodal one. `mirror_measures` has the same for mirror surfaces, whose sides may differ.

Lengths are in cells unless said otherwise; the solid on side "-" is that where the nodal function is negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq, minimize

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.surfaces import minimal_patch
from tpmscad.surfaces.differential_geometry import area_element
from tpmscad.surfaces.reflection_group import MirrorSymmetry, mirror_symmetry
from tpmscad.surfaces.surface_patch import primitive_patch
from tpmscad.surfaces.surface_records import check_reference, find_surface


@dataclass(frozen=True, slots=True)
class CellMeasures:
    """Of one cubic cell: area, integrals of mean and Gauss curvature, the fraction where f < 0, the least and greatest offset.

    Lengths in cells. Mean curvature is positive where the surface bends towards the normal.
    """

    area: float
    mean: float
    gauss: float
    below: float
    lowest: float
    highest: float

    def swept_volume(self, offset: float) -> float:
        """Volume between the mid surface and its offset, positive along the normal."""
        return self.area * offset - self.mean * offset**2 + self.gauss * offset**3 / 3


MIRROR_GAUSS_POINTS = 64
"""Gauss-Legendre points each way: with 96 nothing changes by more than 2e-14."""

MIRROR_SEARCH_POINTS = 41
"""Points each way to start the search for the greatest curvatures from."""


@cache
def measure_mirror_surface(name: str) -> CellMeasures:
    """The measures of a catalogued surface's level set."""
    symmetry = mirror_symmetry(name)
    copies = len(symmetry.motions)
    x, w = np.polynomial.legendre.leggauss(MIRROR_GAUSS_POINTS)
    nodes, weight = (x + 1) / 2, np.outer(w, w) / 4
    points, fraction = symmetry.intersect_segments(nodes[:, None], nodes)
    (a, b), (c, d) = symmetry.edges
    s, t = nodes[:, None, None], nodes[None, :, None]
    segment = c + t * (d - c) - a - s * (b - a)
    gradient = symmetry.waves.gradient(points)
    # f = 0 all along: the part of the way follows a change of the segment.
    r = fraction[..., None]
    tangents = []
    for moved in ((1 - r) * (b - a), r * (d - c)):
        rate = -_dot(gradient, moved) / _dot(gradient, segment)
        tangents.append(moved + rate[..., None] * segment)
    element = weight * np.linalg.norm(np.cross(*tangents), axis=-1)
    mean = -np.trace(symmetry.waves.shape_operator(points), axis1=-2, axis2=-1) / 2
    positive = (weight * (3 * fraction**2 - 2 * fraction**3)).sum()  # f > 0 on the first edge's side
    lowest, highest = _offset_limits(symmetry)
    return CellMeasures(
        area=float(copies * element.sum()),
        mean=float(copies * (element * mean).sum()),
        gauss=float(copies * (2 * np.pi - (np.pi - symmetry.angles).sum())),
        below=float(1 - positive),
        lowest=lowest,
        highest=highest,
    )


def _offset_limits(symmetry: MirrorSymmetry) -> tuple[float, float]:
    """The centres of curvature nearest to the surface on either side: an offset past them has cusps."""

    def bends(s: Array, t: Array) -> tuple[Array, Array]:
        points, _ = symmetry.intersect_segments(s, t)
        values = np.asarray(np.linalg.eigvalsh(symmetry.waves.shape_operator(points)), np.float64)
        return values[..., 2], -values[..., 0]

    grid = np.linspace(0.0, 1.0, MIRROR_SEARCH_POINTS)
    limits = []
    for side in (0, 1):
        start = bends(grid[:, None], grid)[side]
        i, j = np.unravel_index(np.argmax(start), start.shape)
        first = np.array([grid[i], grid[j]])
        step = 0.5 / (MIRROR_SEARCH_POINTS - 1)
        corners = first + step * np.array([[0, 0], [1, 0], [0, 1]]) * np.where(first > 0.5, -1, 1)
        found = minimize(
            lambda p, side=side: -float(bends(p[0], p[1])[side]),
            first,
            method="Nelder-Mead",
            bounds=[(0.0, 1.0)] * 2,
            options={"xatol": 1e-9, "fatol": 1e-13, "initial_simplex": corners},
        )
        limits.append(1 / max(-float(found.fun), float(start.max())))
    return -limits[0], limits[1]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))


AREA_GAUSS_POINTS = 32
"""Gauss-Legendre points each way: the area of the nodal surfaces is converged to round-off at 24."""


@cache
def cell_measures(name: str, reference: str) -> CellMeasures:
    """Area, curvature integrals and greatest offsets of a catalogued surface, per cubic cell."""
    info = find_surface(name)
    if info.primitives == "mirrored":
        check_reference(info, reference)
        return measure_mirror_surface(info.name)
    surface = primitive_patch(name, reference)
    limit = surface.max_offset
    return CellMeasures(area(name, reference), 0.0, -info.patches_per_cell * 2 * np.pi / 3, 0.5, -limit, limit)


@cache
def area(name: str, reference: str = "minimal") -> float:
    """Area of the mid surface in one cubic cell, in cells squared."""
    info = find_surface(name)
    if info.primitives == "mirrored":
        return cell_measures(name, reference).area
    surface = primitive_patch(name, reference)
    patches = info.patches_per_cell
    if surface.reference == "minimal":
        return patches * minimal_patch.patch_area(surface.name)
    x, w = np.polynomial.legendre.leggauss(AREA_GAUSS_POINTS)
    u, v = np.meshgrid((x + 1) / 2, (x + 1) / 2, indexing="ij")
    mid, _ = surface.mid_and_normal(u, v)
    return patches * float(w @ area_element(mid) @ w) / 4


def volume_fraction(name: str, reference: str, lower: float, upper: float) -> float:
    """Volume between the offsets lower < upper, per volume of the cell.

    InvalidRequest where they are out of order or past the greatest offset.
    """
    of = cell_measures(name, reference)
    for offset in (lower, upper):
        check_offset(name, reference, offset)
    if not lower < upper:
        raise InvalidRequest(f"lower offset {lower:g} is not below the upper {upper:g}; swap them or thicken the wall")
    return of.swept_volume(upper) - of.swept_volume(lower)


def skeletal_volume_fraction(name: str, reference: str, offset: float = 0.0, side: str = "-") -> float:
    """Volume on one side of the offset surface, per volume of the cell."""
    of = cell_measures(name, reference)
    check_offset(name, reference, offset)
    below = of.below + of.swept_volume(offset)
    return below if _side_sign(side) > 0 else 1 - below


def thickness_for(name: str, reference: str, volume_fraction: float) -> float:
    """The wall thickness, symmetric about the mid surface, that makes the volume fraction.

    InvalidRequest where that takes more than the greatest offset.
    """
    of = cell_measures(name, reference)
    limit = min(of.highest, -of.lowest)
    most = of.swept_volume(limit) - of.swept_volume(-limit)
    if not 0 < volume_fraction < most:
        raise _unreachable_fraction(name, reference, "sheet", volume_fraction, 0.0, most)
    return 2 * float(
        brentq(lambda d: of.swept_volume(d) - of.swept_volume(-d) - volume_fraction, 0.0, limit, xtol=1e-17)
    )


def skeletal_offset_for(name: str, reference: str, volume_fraction: float, side: str = "-") -> float:
    """The offset of the surface with that volume fraction on the given side."""
    of = cell_measures(name, reference)
    below = volume_fraction if _side_sign(side) > 0 else 1 - volume_fraction
    least, most = of.below + of.swept_volume(of.lowest), of.below + of.swept_volume(of.highest)
    if not (least < below < most and 0 < volume_fraction < 1):
        least, most = max(least, 0.0), min(most, 1.0)
        ends = (least, most) if _side_sign(side) > 0 else (1 - most, 1 - least)
        raise _unreachable_fraction(name, reference, "skeletal solid", volume_fraction, *ends)
    return float(brentq(lambda d: of.below + of.swept_volume(d) - below, of.lowest, of.highest, xtol=1e-17))


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


def check_offset(name: str, reference: str, offset: float, cell: float = 1.0) -> None:
    """InvalidRequest where the offset, in the units of `cell`, passes the surface's curvature radius."""
    of = cell_measures(name, reference)
    lowest, highest = of.lowest * cell, of.highest * cell
    if lowest < offset < highest:
        return
    thickest = 2 * min(highest, -lowest)
    limits = f"below {highest:.6g}" if highest == -lowest else f"between {lowest:.6g} and {highest:.6g}"
    raise InvalidRequest(
        f"offset {offset:g} (thickness {2 * abs(offset):g} if symmetric) of the {reference} {find_surface(name).name} passes its "
        f"curvature radius at cell {cell:g}: offsets stay {limits}, thickness below {thickest:.6g}; thin the wall or "
        "enlarge the cell"
    )


def _unreachable_fraction(
    name: str, reference: str, solid: str, fraction: float, low: float, high: float
) -> InvalidRequest:
    of = cell_measures(name, reference)
    limits = f"below {of.highest:.6g}" if of.highest == -of.lowest else f"between {of.lowest:.6g} and {of.highest:.6g}"
    return InvalidRequest(
        f"volume fraction {fraction:g} is out of reach of a {find_surface(name).name} {solid}: offsets stay {limits} cells "
        f"({reference} surface), so volume fractions between {low:.6g} and {high:.6g}"
    )


def _side_sign(side: str) -> int:
    if side not in ("-", "+"):
        raise InvalidRequest(f"side {side!r} is unknown; choose '-' or '+'")
    return 1 if side == "-" else -1
