"""The primitive patches of a mirror surface: its piece between the mirrors, offset and fitted with the lowest degree.

All candidates meet their reflections with continuous curvature (`mirror_continuity`). Each is made in three steps.

1. CPIA (`splines.cpia`) fits the offset of the nearly conformal chart at the Gauss points of the parameters.
2. *Parameter correction.* Of a patch only the point set counts, so Gauss-Newton steps with Levenberg-Marquardt damping, in the
   same constraint space, reduce the normal distances alone; the points slide along the surface. This gains as much as
   three degrees.
3. CPIA fits the corrected data: the foot points of the corrected patch, moved to the offset. This is PIA with parameter
   correction, which TPMS2STEP leaves to future work. The distance to a foot point is never less than that to the surface, so
   this step cannot increase the sum of squared distances; at a minimum of step 2 it changes nothing.

**Deviation.** Neither direction of the measured deviation uses the chart. From the patch to the surface: distances of its points
by Newton's method on the formula. From the surface to the patch: points of the level set on segments between two edges of the
tetrahedron, offset along the gradient, and their orthogonal projections on the patch, started at the nearest of its samples. A
folded piece has an infinite deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array
from tpmscad.brep.deviation import Deviation, combine_deviations, cosine_grid, measure_both_ways
from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.errors import NoFoot
from tpmscad.lattices.harmonic_chart import HarmonicChart, compute_harmonic_chart
from tpmscad.lattices.mirror_continuity import mirror_conditions
from tpmscad.lattices.offset_surfaces import Layers, LayersFit, OffsetSurfaces
from tpmscad.splines.affine_subspace import AffineSubspace, pole_metric, solve_conditions
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.continuity_conditions import ContinuityConditions
from tpmscad.splines.cpia import (
    NetConvergence,
    axis_grid,
    solve_cpia,
    weighted_bases,
    weighted_data,
)
from tpmscad.splines.knots import bezier_knots
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis
from tpmscad.splines.surface_fit import surface_from_coordinates
from tpmscad.surfaces import MirrorSymmetry

PIECE_SAMPLES_PER_PARAMETER = 41
"""Samples along each parameter, and along each edge of the tetrahedron."""

FOLDED_DEVIATION = Deviation(np.inf, np.inf, np.inf, np.inf)

PIECE_DEGREES = range(7, 17)
"""Candidate degrees, one span each. Parameters bunch below 7; float64 has too few digits above 16."""

MAX_SLIDING_GAIN = 100.0
"""Greatest factor by which parameter correction reduces a deviation: degrees that start farther off are skipped."""

MAX_SLIDING_STEPS = 12
"""Greatest number of Gauss-Newton steps."""

INITIAL_DAMPING = 1e-2
"""Damping of the first step; halved after a step that reduces the distances, quadrupled after one that does not."""

MIN_AREA_ELEMENT_RATIO = 0.4
"""Least ratio of the minimal |S_u x S_v| after and before parameter correction: below it the parameters bunch and intersection
curves cannot be traced."""

STALL_RATIO = 0.95
"""The steps end when the sum of squares falls by less than to this fraction of itself."""


def measure_mirror_deviation(symmetry: MirrorSymmetry, patch: BSplineSurface, offset: float) -> Deviation:
    """The two-way deviation (cells) between the patch and the piece of the level set at the normal offset (cells)."""
    grid = cosine_grid(PIECE_SAMPLES_PER_PARAMETER)
    try:
        _, normal, _ = symmetry.waves.project_to_level_set(patch.grid(grid, grid))
    except NoFoot:
        return FOLDED_DEVIATION
    facing = np.einsum("ijk,ijk->ij", patch.normal(grid[:, None], grid), normal)
    if facing.min() <= 0 <= facing.max():
        return FOLDED_DEVIATION

    def to_reference(u: Array, v: Array) -> Array:
        return np.abs(symmetry.waves.project_to_level_set(patch(u, v))[0] - offset)

    samples = cKDTree(patch.grid(grid, grid).reshape(-1, 3))

    def from_reference(s: Array, t: Array) -> Array:
        points, _ = symmetry.intersect_segments(s, t)
        gradient = symmetry.waves.gradient(points)
        points = points + offset * gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)
        i, j = np.unravel_index(samples.query(points)[1], (PIECE_SAMPLES_PER_PARAMETER, PIECE_SAMPLES_PER_PARAMETER))
        return project_to_patch(patch, points, grid[i], grid[j])[0]

    return measure_both_ways(grid, grid, to_reference, from_reference)


@dataclass(frozen=True, slots=True, eq=False)
class MirrorPieceFit:
    """A fitted piece in cells, its degree, its measured two-way deviation and the convergence of its net."""

    patch: BSplineSurface
    degree: int
    deviation: Deviation
    convergence: NetConvergence


def fit_mirror_pieces(
    name: str, layers: Layers, cell: float, tol: float, reference: str = "nodal"
) -> LayersFit[OffsetSurfaces]:
    """Fit the lower and upper surface at their normal offsets (model units; None: no surface) to within `tol`.

    Where no degree meets `tol` the best one is returned: compare the deviation. There are no rigorous bounds, as the reference
    surface is implicit.
    """
    in_cells = [None if d is None else d / cell for d in layers]
    fits = {d: fit_mirror_piece(name, d, tol / cell, reference) for d in in_cells if d is not None}
    order = list(fits)
    lower, upper = (None if d is None else (order.index(d), False) for d in in_cells)
    return LayersFit(
        OffsetSurfaces(tuple(fits[d].patch for d in order), lower, upper),
        combine_deviations([fit.deviation for fit in fits.values()]).scaled(cell),
        convergence=NetConvergence.worst(fit.convergence for fit in fits.values()).scaled(cell),
    )


@lru_cache(maxsize=64)
def fit_mirror_piece(name: str, offset: float, tol: float, reference: str = "nodal") -> MirrorPieceFit:
    """The offset piece of the lowest degree whose measured deviation is at most `tol` (cells), or the best there is.

    Cached: the same lattice in another box or with another boundary reuses the fit.
    """
    chart = compute_harmonic_chart(name, reference)
    best: MirrorPieceFit | None = None
    for degree in PIECE_DEGREES:
        last = degree == PIECE_DEGREES[-1]
        space = _make_piece_space(chart, degree)
        charted = _fit_chart_samples(chart, space, offset)
        if not last and _max_offset_error(chart, charted.patch, offset) > MAX_SLIDING_GAIN * tol:
            continue
        corrected = _fit_corrected_samples(chart, space, charted, offset)
        bunched = _min_area_element(corrected.patch) < MIN_AREA_ELEMENT_RATIO * _min_area_element(charted.patch)
        net = charted if bunched else corrected
        patch = _symmetrise(net.patch, chart.symmetry)
        piece = MirrorPieceFit(patch, degree, measure_mirror_deviation(chart.symmetry, patch, offset), net.convergence)
        if best is None or piece.deviation.max < best.deviation.max:
            best = piece
        if best.deviation.max <= tol:
            break
    assert best is not None
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _PieceSpace:
    """The spline space of a piece: the axis of both parameters and the conditions at the mirrors."""

    axis: SplineAxis
    conditions: ContinuityConditions
    subspace: AffineSubspace  # the solutions, with the metric that keeps poles near the surface


@dataclass(frozen=True, slots=True, eq=False)
class _ControlNet:
    """A net by its coordinates (U V 3,), the patch of its poles, and its convergence."""

    coordinates: Array
    patch: BSplineSurface
    convergence: NetConvergence


def _make_piece_space(chart: HarmonicChart, degree: int) -> _PieceSpace:
    axis = gauss_axis(bezier_knots(degree), degree)
    mirrors = chart.symmetry
    conditions = mirror_conditions(axis, axis, chart.quadrilateral.centres, mirrors.wall_normals, mirrors.wall_offsets)
    return _PieceSpace(axis, conditions, solve_conditions(conditions, pole_metric(axis, axis)))


def _run_cpia(space: _PieceSpace, samples: Array, subspace: AffineSubspace, start: Array | None = None) -> _ControlNet:
    """The net of CPIA for samples (m, m, 3) at the Gauss points of the axis."""
    axis = space.axis
    grid = axis_grid(axis, axis)
    solution = solve_cpia(weighted_data(samples, grid), *weighted_bases(grid, axis, axis), subspace, start=start)
    patch = surface_from_coordinates(solution.coordinates, axis, axis)
    return _ControlNet(solution.coordinates.ravel(), patch, solution.convergence(axis.max_norm_factor**2))


def _fit_chart_samples(chart: HarmonicChart, space: _PieceSpace, offset: float) -> _ControlNet:
    """Step 1 of the module's text."""
    t = space.axis.points
    return _run_cpia(space, chart.offset(t[:, None], t[None, :], offset), space.subspace)


def _fit_corrected_samples(
    chart: HarmonicChart, space: _PieceSpace, charted: _ControlNet, offset: float
) -> _ControlNet:
    """Steps 2 and 3 of the module's text."""
    axis = space.axis
    coordinates = _slide_along_surface(chart, space, charted.coordinates, offset)
    slid = surface_from_coordinates(coordinates.reshape(axis.n_coordinates, axis.n_coordinates, 3), axis, axis)
    _, normal, foot = chart.symmetry.waves.project_to_level_set(slid.grid(axis.points, axis.points))
    return _run_cpia(space, foot + offset * normal, solve_conditions(space.conditions), coordinates)


def _slide_along_surface(chart: HarmonicChart, space: _PieceSpace, start: Array, offset: float) -> Array:
    """Coordinates after damped Gauss-Newton steps on the normal distances at the sample points of the axis."""
    axis, basis = space.axis, space.subspace.null_space_basis()
    roots = np.sqrt(np.outer(axis.weights, axis.weights).ravel())
    design = axis.design_matrix(axis.points)
    values = np.kron(design, design)

    def residuals(coordinates: Array) -> tuple[Array, Array]:
        distance, normal, _ = chart.symmetry.waves.project_to_level_set(values @ coordinates.reshape(-1, 3))
        return roots * (distance - offset), normal

    x, damping = start, INITIAL_DAMPING
    r, normal = residuals(x)
    for _ in range(MAX_SLIDING_STEPS):
        jacobian = ((roots[:, None] * values)[:, :, None] * normal[:, None, :]).reshape(len(r), -1) @ basis
        left, sizes, right = np.linalg.svd(jacobian, full_matrices=False)
        step = basis @ (right.T @ (sizes / (sizes**2 + damping**2) * (left.T @ r)))
        new, new_normal = residuals(x - step)
        before, after = float(r @ r), float(new @ new)
        if after >= before:
            damping *= 4
            continue
        x, r, normal, damping = x - step, new, new_normal, damping / 2
        if after > STALL_RATIO * before:
            break
    return x


def _max_offset_error(chart: HarmonicChart, patch: BSplineSurface, offset: float) -> float:
    """Greatest difference between the offset and the distance of sample points of the patch from the level set."""
    t = np.linspace(0.0, 1.0, 2 * patch.degree_u)
    return float(np.abs(chart.symmetry.waves.project_to_level_set(patch.grid(t, t))[0] - offset).max())


def _min_area_element(patch: BSplineSurface) -> float:
    """Least |S_u x S_v| at sample points."""
    t = np.linspace(0.0, 1.0, 2 * patch.degree_u)
    return float(np.linalg.norm(patch.normal(t[:, None], t), axis=-1).min())


def _symmetrise(patch: BSplineSurface, mirrors: MirrorSymmetry) -> BSplineSurface:
    """The patch with the symmetry of its tetrahedron, and its border poles in the mirrors, both to the last bit or two.

    Fits have both to 1e-12; where a tetrahedron is its own mirror image, this would appear as a gap between copies.
    """
    poles = patch.poles.copy()
    if mirrors.middle is not None:
        normal, offset = mirrors.middle
        image = poles[::-1] - 2 * (poles[::-1] @ normal - offset)[..., None] * normal
        poles = (poles + image) / 2
    sides = poles[:, 0], poles[-1], poles[:, -1], poles[0]
    for side, normal, offset in zip(sides, mirrors.wall_normals, mirrors.wall_offsets, strict=True):
        side -= (side @ normal - offset)[:, None] * normal
    for i, (row, column) in enumerate([(0, 0), (-1, 0), (-1, -1), (0, -1)]):
        normals, offsets = mirrors.wall_normals[[i - 1, i]], mirrors.wall_offsets[[i - 1, i]]
        poles[row, column] -= np.linalg.pinv(normals) @ (normals @ poles[row, column] - offsets)
    return BSplineSurface(poles, patch.knots_u, patch.knots_v, patch.degree_u, patch.degree_v)
