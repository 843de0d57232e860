"""Area, curvature integrals and offset limits of a surface per cubic cell: the data of Steiner's formula.

Per cubic cell, the volume between the mid surface and its offset at distance d is

    V(d) = d A - d^2 int H + d^3 / 3 int K,

with the area A, the mean curvature H and the Gauss curvature K. The formula is exact as long as d is below the radius of
curvature. The integrals come from one of three sources:

- Surfaces of exact patches. int K over a patch is minus the solid angle of the Gauss map, -2 pi / 3. int H vanishes: for the
  minimal surface because H does, for its nodal counterpart because the patch's rotoinversion exchanges the sides; for the same
  reason the mid surface halves the cell. The area is K K' / 4 per patch (raw Weierstrass units, see `minimal_patch`) for the
  minimal surface and a converged quadrature for the nodal one.
- Mirror surfaces. Their one piece is parametrised by the segments between two edges of the tetrahedron
  (`MirrorSymmetry.intersect_segments`), an analytic map of the unit square for which Gauss-Legendre quadrature converges
  geometrically. The tetrahedron is the join of its two edges, so the volume up to the fraction r of the segments is V times the
  integral of 3 r^2 - 2 r^3. int K follows from Gauss-Bonnet: the sides are geodesics, the angles those of the mirror planes.
- Surfaces without primitives. The lines of a grid in all three directions a meet the surface in points that count
  n_a^4 / sum_b n_b^4 of the area there, n being the normal: lines that touch the surface have no weight, and the midpoint rule
  converges fast (`fields/analysis/volume_quadrature.py`). Finer measures are stored where they are in `LEVEL_SET_MEASURES`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import Reference, SurfaceName
from tpmscad.catalogue import check_reference, find_surface
from tpmscad.fields import tpms, volume_fraction
from tpmscad.splines.quadrature import gauss_legendre_unit, tensor_gauss_legendre
from tpmscad.surfaces import minimal_patch
from tpmscad.surfaces.differential_geometry import SEARCH_POINTS, area_element, dot, maximise_on_unit_square
from tpmscad.surfaces.plane_waves import PlaneWaves, level_set_waves
from tpmscad.surfaces.reflection_group import MirrorSymmetry, mirror_symmetry
from tpmscad.surfaces.surface_patch import primitive_patch

Offsets = TypeVar("Offsets", float, Array)

AREA_GAUSS_POINTS = 32
"""Gauss-Legendre points per parameter; the area of the nodal surfaces is converged to round-off with fewer."""

GRID_LINES, GRID_ORIGIN, ROOT_STEPS = 128, np.array((0.31, 0.17, 0.43)), 8
"""Lines along each axis across a cell, their origin in spacings, off the planes of symmetry, and steps to their roots."""

N_STARTS = 5
"""Points of greatest curvature among those on the lines, from which the greatest is searched for."""

MIRROR_GAUSS_POINTS = 64
"""Gauss-Legendre points per parameter on a mirrored piece, for which all integrals are converged to round-off."""


@dataclass(frozen=True, slots=True)
class CellMeasures:
    """Integrals of a surface over one cubic cell, lengths in cells.

    - `area`; `mean_curvature_integral`, positive where the surface bends towards the normal; `gauss_curvature_integral`.
    - `fraction_below`: volume fraction of {f < 0}.
    - `min_offset`, `max_offset`: signed distances to the nearest centres of curvature on either side.
    """

    area: float
    mean_curvature_integral: float
    gauss_curvature_integral: float
    fraction_below: float
    min_offset: float
    max_offset: float

    def swept_volume(self, offset: Offsets) -> Offsets:
        """Volume between the mid surface and its offset per cell; positive for an offset along the normal."""
        return (
            self.area * offset
            - self.mean_curvature_integral * offset**2
            + self.gauss_curvature_integral * offset**3 / 3
        )

    def swept_area(self, offset: Offsets) -> Offsets:
        """Area of the offset surface per cell: the derivative of the swept volume."""
        return self.area - 2 * self.mean_curvature_integral * offset + self.gauss_curvature_integral * offset**2

    def swept_area_rate(self, offset: float) -> float:
        """Derivative of the area of the offset surface with respect to the offset."""
        return 2 * (self.gauss_curvature_integral * offset - self.mean_curvature_integral)


LEVEL_SET_MEASURES: Mapping[tuple[str, str], CellMeasures] = MappingProxyType(
    {
        ("lidinoid", "nodal"): CellMeasures(6.2385966, -10.205779, -128 * np.pi, 0.384490, -0.0288692218, 0.0338797751),
        ("split_p", "nodal"): CellMeasures(5.11357703, 2.03011999, -64 * np.pi, 0.510311, -0.0482879448, 0.0840213970),
        ("fischer_koch_s", "nodal"): CellMeasures(5.43012464, 0.0, -80 * np.pi, 0.5, -0.0635124187, 0.0635124187),
        ("fischer_koch_s", "minimal"): CellMeasures(5.41450813, 0.0, -80 * np.pi, 0.5, -0.0841276069, 0.0841276069),
        ("octo", "nodal"): CellMeasures(3.72970962, 3.04049358, -36 * np.pi, 0.4705916, -0.0190249282, 0.0536269776),
    }
)
"""Measures of the surfaces without primitives, by Gauss quadrature over patches of degree 11 on one period. The integral of
the Gauss curvature is 2 pi times the Euler characteristic."""


@validate_call()
@cache
def cell_measures(name: SurfaceName, reference: Reference) -> CellMeasures:
    """Return area, curvature integrals and offset limits of a surface per cubic cell.

    Returns
    -------
    CellMeasures
        The measures, lengths in cells.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> round(surfaces.cell_measures("schwarz_p", "minimal").area, 6)
    2.345103
    """
    record = find_surface(name)
    if record.primitives == "mirrored":
        check_reference(record, reference)
        return measure_mirror_surface(record.name, reference)
    if record.primitives == "level set":
        check_reference(record, reference)
        stored = LEVEL_SET_MEASURES.get((record.name, reference))
        return stored or measure_level_set(record.name, reference)
    surface = primitive_patch(name, reference)
    limit = surface.max_offset
    return CellMeasures(area(name, reference), 0.0, -record.patches_per_cell * 2 * np.pi / 3, 0.5, -limit, limit)


@validate_call()
@cache
def area(name: SurfaceName, reference: Reference = "minimal") -> float:
    """Return the area of the mid surface in one cubic cell, in cells squared.

    Returns
    -------
    float
        The area.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> round(surfaces.area("schwarz_p"), 6)
    2.345103
    """
    record = find_surface(name)
    if record.primitives != "exact":
        return cell_measures(name, reference).area
    surface = primitive_patch(name, reference)
    patches = record.patches_per_cell
    if surface.reference == "minimal":
        return patches * minimal_patch.patch_area(surface.name)
    nodes, weights = gauss_legendre_unit(AREA_GAUSS_POINTS)
    u, v = np.meshgrid(nodes, nodes, indexing="ij")
    mid, _ = surface.mid_and_normal(u, v)
    return patches * float(weights @ area_element(mid) @ weights)


@cache
def measure_mirror_surface(name: str, reference: str = "nodal") -> CellMeasures:
    """Measures of a mirror surface's level set by quadrature over its one piece."""
    symmetry = mirror_symmetry(name, reference)
    copies = len(symmetry.motions)
    nodes, _, weight = tensor_gauss_legendre(MIRROR_GAUSS_POINTS, MIRROR_GAUSS_POINTS)
    points, fraction = symmetry.intersect_segments(nodes[:, None], nodes)
    (a, b), (c, d) = symmetry.edges
    s, t = nodes[:, None, None], nodes[None, :, None]
    segment = c + t * (d - c) - a - s * (b - a)
    gradient = symmetry.waves.gradient(points)
    # f = 0 on the whole piece: the fraction r follows a change of the segment's ends by the implicit function theorem
    r = fraction[..., None]
    tangents = []
    for moved in ((1 - r) * (b - a), r * (d - c)):
        rate = -dot(gradient, moved) / dot(gradient, segment)
        tangents.append(moved + rate[..., None] * segment)
    element = weight * np.linalg.norm(np.cross(*tangents), axis=-1)
    mean = -np.trace(symmetry.waves.shape_operator(points), axis1=-2, axis2=-1) / 2
    positive = (weight * (3 * fraction**2 - 2 * fraction**3)).sum()  # f > 0 on the side of the first edge
    min_offset, max_offset = _find_offset_limits(symmetry)
    return CellMeasures(
        area=float(copies * element.sum()),
        mean_curvature_integral=float(copies * (element * mean).sum()),
        gauss_curvature_integral=float(copies * (2 * np.pi - (np.pi - symmetry.angles).sum())),
        fraction_below=float(1 - positive),
        min_offset=min_offset,
        max_offset=max_offset,
    )


@cache
def measure_level_set(name: str, reference: str) -> CellMeasures:
    """Measures of a level set by the midpoint rule on lines of a grid, the area to about 1e-5 of it."""
    waves, field = level_set_waves(name, reference), tpms(name, 1.0, reference=reference)
    axes = (np.arange(GRID_LINES) + GRID_ORIGIN[:, None]) / GRID_LINES
    values = field.on_grid(*axes)
    total, most = np.zeros(3), list[list[Array]]()
    for axis in range(3):
        after = np.roll(values, -1, axis)
        at = np.argwhere((values < 0) != (after < 0))
        start, end = values[tuple(at.T)], after[tuple(at.T)]
        low, high, root = np.zeros(len(at)), np.ones(len(at)), start / (start - end)
        points = (at + GRID_ORIGIN) / GRID_LINES
        begin = points[:, axis].copy()
        for _ in range(ROOT_STEPS):
            points[:, axis] = begin + root / GRID_LINES
            value, slope = field.value_and_gradient(points)
            before = (value < 0) == (start < 0)
            low, high = np.where(before, root, low), np.where(before, high, root)
            rate = slope[:, axis] / GRID_LINES
            step = root - value / np.where(rate == 0, np.inf, rate)
            root = np.where((step > low) & (step < high), step, (low + high) / 2)
        share = np.abs(slope[:, axis]) ** 3 * np.linalg.norm(slope, axis=1) / (slope**4).sum(axis=1) / GRID_LINES**2
        curved = waves.shape_operator(points)
        mean = -np.trace(curved, axis1=1, axis2=2) / 2
        half_range = np.sqrt(np.maximum((curved**2).sum(axis=(1, 2)) / 2 - mean**2, 0.0))
        total += share @ np.stack([np.ones(len(at)), mean, mean**2 - half_range**2], axis=1)
        most.append([points[np.argsort(half_range - sign * mean)[-N_STARTS:]] for sign in (1, -1)])
    limits = [
        _maximise_curvature(waves, np.concatenate(starts), sign) for sign, *starts in zip((1, -1), *most, strict=True)
    ]
    area, mean_integral, gauss = map(float, total)
    whole = 2 * np.pi * round(gauss / (2 * np.pi))  # Gauss-Bonnet: times Euler's characteristic
    return CellMeasures(area, mean_integral, whole, volume_fraction(field), -1 / limits[0], 1 / limits[1])


def _maximise_curvature(waves: PlaneWaves, starts: Array, sign: int) -> float:
    """The greatest principal curvature of f = 0 that bends against (+1) or along (-1) the normal, searched from points (n, 3)."""

    def curvature(point: Array) -> float:
        for _ in range(ROOT_STEPS):
            slope = waves.gradient(point)
            point = point - waves.value(point) / (slope @ slope) * slope
        return float(np.linalg.eigvalsh(sign * waves.shape_operator(point))[2])

    return max(-float(minimize(lambda p: -curvature(p), each, method="Nelder-Mead").fun) for each in starts)


def _find_offset_limits(symmetry: MirrorSymmetry) -> tuple[float, float]:
    """Signed distances to the centres of curvature nearest to the surface on either side; beyond them offsets have cusps."""

    def principal_curvatures(s: Array, t: Array) -> tuple[Array, Array]:
        points, _ = symmetry.intersect_segments(s, t)
        values = np.asarray(np.linalg.eigvalsh(symmetry.waves.shape_operator(points)), np.float64)
        return values[..., 2], -values[..., 0]

    grid = np.linspace(0.0, 1.0, SEARCH_POINTS)
    limits = []
    for side in (0, 1):
        samples = principal_curvatures(grid[:, None], grid)[side]
        i, j = np.unravel_index(np.argmax(samples), samples.shape)
        start = np.array([grid[i], grid[j]])
        step = 0.5 / (SEARCH_POINTS - 1)
        simplex = start + step * np.array([[0, 0], [1, 0], [0, 1]]) * np.where(start > 0.5, -1, 1)
        greatest = maximise_on_unit_square(
            lambda s, t, side=side: principal_curvatures(s, t)[side],  # type: ignore[misc]
            simplex,
            fatol=1e-13,
        )
        limits.append(1 / max(greatest, float(samples.max())))
    return -limits[0], limits[1]
