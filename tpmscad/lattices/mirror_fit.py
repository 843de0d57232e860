"""How far a fitted piece of a mirror surface is from the nodal surface at its offset, in both directions.

Neither direction uses the chart the piece was fitted over. From the patch: its points' distances by Newton's method on the
formula. To the patch: points of the level set on segments between two edges of the tetrahedron, offset along the gradient, and
their feet on the patch, found from the nearest of its samples. A piece that is folded is infinitely far.

The primitive patches of a mirror surface: its piece between the mirrors, offset and fitted with as few poles as will do.

All candidates meet their reflections with continuous curvature (see `mirror.joints`). The least-squares fit to the offset of the
conformal chart is where the search starts; but of a patch only the point set counts, so Gauss-Newton steps then let its points
slide along the surface and lessen the distances alone. That gains what three degrees would.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array
from tpmscad.brep.deviation import Deviation, combine_deviations, mean_square, project_to_patch, sample_around_peaks
from tpmscad.errors import NoFoot
from tpmscad.lattices.harmonic_chart import HarmonicChart, compute_harmonic_chart
from tpmscad.lattices.mirror_continuity import mirror_conditions
from tpmscad.lattices.offset_surfaces import OffsetSurfaces
from tpmscad.splines.affine_subspace import AffineSubspace, pole_metric, solve_conditions
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import bezier_knots
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis
from tpmscad.splines.surface_fit import least_squares_coordinates, surface_from_coordinates
from tpmscad.surfaces import MirrorSymmetry

PIECE_SAMPLES_PER_PARAMETER = 41
"""Samples along each parameter, and along each edge of the tetrahedron."""

FOLDED_DEVIATION = Deviation(np.inf, np.inf, np.inf, np.inf)


def measure_mirror_deviation(symmetry: MirrorSymmetry, patch: BSplineSurface, offset: float) -> Deviation:
    """The two-way distance between the patch and the level set's piece at the normal distance `offset`, in cells."""
    grid = (
        1 - np.cos(np.pi * np.linspace(0.0, 1.0, PIECE_SAMPLES_PER_PARAMETER))
    ) / 2  # errors' lobes are narrow near borders
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

    u, v = (g.ravel() for g in np.meshgrid(grid, grid, indexing="ij"))
    largest, squares = [], []
    for measure in (to_reference, from_reference):
        distances = measure(u, v).reshape(PIECE_SAMPLES_PER_PARAMETER, PIECE_SAMPLES_PER_PARAMETER)
        finer = measure(*sample_around_peaks(distances, grid, grid))
        largest.append(float(max(distances.max(), finer.max())))
        squares.append(mean_square(distances))
    return Deviation(max(largest), float(np.sqrt(np.mean(squares))), largest[0], largest[1])


PIECE_DEGREES = range(7, 17)
"""One span each. Degree 6 meets 1e-3 only with parameters that bunch so much that cuts can't be traced on it; past 16 float64
has too few digits."""

MAX_SLIDING_GAIN = 100.0
"""Sliding lessens a deviation by no more than this: degrees that start further off are left out. 8 to 90 were measured."""

MAX_SLIDING_STEPS = 12
"""Gauss-Newton steps at the most."""

INITIAL_DAMPING = 1e-2
"""Of the steps, at first; halved after every step that lessens the distances, quadrupled after one that does not."""

MIN_AREA_ELEMENT_RATIO = 0.4
"""Sliding may lessen the least |S_u x S_v| to this part of itself: past it the parameters bunch. 0.45 to 1 were measured where
cuts were traced without trouble, 0.04 where they were not."""

STALL_RATIO = 0.95
"""Steps end when the sum of squares falls by less than to this part of itself."""


@dataclass(frozen=True, slots=True, eq=False)
class MirrorPieceFit:
    """A fitted piece in cells, and its measured two-way deviation."""

    patch: BSplineSurface
    degree: int
    deviation: Deviation


def fit_mirror_pieces(
    name: str, layers: tuple[float | None, float | None], tol: float
) -> tuple[OffsetSurfaces, Deviation]:
    """Fit the lower and the upper surface at their normal distances (cells; None: no surface) to within `tol` (cells).

    Where no degree meets `tol` the best comes back: compare.
    """
    fits = {d: fit_mirror_piece(name, d, tol) for d in layers if d is not None}
    order = list(fits)
    lower, upper = (None if d is None else (order.index(d), False) for d in layers)
    sheet = OffsetSurfaces(tuple(fits[d].patch for d in order), lower, upper)
    return sheet, combine_deviations([fit.deviation for fit in fits.values()])


@lru_cache(maxsize=64)
def fit_mirror_piece(name: str, offset: float, tol: float) -> MirrorPieceFit:
    """The offset piece of the lowest degree whose measured deviation is at most `tol` (cells), or the best there is."""
    form = compute_harmonic_chart(name)
    best: MirrorPieceFit | None = None
    for degree in PIECE_DEGREES:
        last = degree == PIECE_DEGREES[-1]
        first, space = _fit_least_squares(form, offset, degree)
        if not last and _max_offset_error(form, first.patch(), offset) > MAX_SLIDING_GAIN * tol:
            continue
        slid = _slide_along_surface(form, first, space, offset).patch()
        bunched = _min_area_element(slid) < MIN_AREA_ELEMENT_RATIO * _min_area_element(first.patch())
        patch = _symmetrise(first.patch() if bunched else slid, form.symmetry)
        piece = MirrorPieceFit(patch, degree, measure_mirror_deviation(form.symmetry, patch, offset))
        if best is None or piece.deviation.max < best.deviation.max:
            best = piece
        if best.deviation.max <= tol:
            break
    assert best is not None
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """A patch by its coordinates (U V 3,) on the axis of both parameters."""

    axis: SplineAxis
    coordinates: Array

    def patch(self) -> BSplineSurface:
        size = self.axis.n_coordinates
        return surface_from_coordinates(self.coordinates.reshape(size, size, 3), self.axis, self.axis)


def _fit_least_squares(form: HarmonicChart, offset: float, degree: int) -> tuple[_Candidate, AffineSubspace]:
    axis = gauss_axis(bezier_knots(degree), degree)
    mirrors = form.symmetry
    conditions = mirror_conditions(axis, axis, form.quadrilateral.centres, mirrors.wall_normals, mirrors.wall_offsets)
    space = solve_conditions(conditions, pole_metric(axis, axis))
    target = form.offset(axis.points[:, None], axis.points[None, :], offset)
    return _Candidate(axis, space.project(least_squares_coordinates(target, axis, axis).ravel())), space


def _max_offset_error(form: HarmonicChart, patch: BSplineSurface, offset: float) -> float:
    t = np.linspace(0.0, 1.0, 2 * patch.degree_u)
    return float(np.abs(form.symmetry.waves.project_to_level_set(patch.grid(t, t))[0] - offset).max())


def _symmetrise(patch: BSplineSurface, mirrors: MirrorSymmetry) -> BSplineSurface:
    """The patch as symmetric as its tetrahedron, its border's poles in the mirrors, both to the last bit or two.

    Fits are so to 1e-12; where a tetrahedron is its own mirror image, that would be seen as a gap between its copies.
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


def _min_area_element(patch: BSplineSurface) -> float:
    t = np.linspace(0.0, 1.0, 2 * patch.degree_u)
    return float(np.linalg.norm(patch.normal(t[:, None], t), axis=-1).min())


def _slide_along_surface(form: HarmonicChart, start: _Candidate, space: AffineSubspace, offset: float) -> _Candidate:
    """The patch after damped Gauss-Newton steps on the distances at the axis' points."""
    axis, basis = start.axis, space.basis()
    root = np.sqrt(np.outer(axis.weights, axis.weights).ravel())
    values = np.kron(axis.design_matrix(axis.points), axis.design_matrix(axis.points))

    def residual(coordinates: Array) -> tuple[Array, Array]:
        distance, normal, _ = form.symmetry.waves.project_to_level_set(values @ coordinates.reshape(-1, 3))
        return root * (distance - offset), normal

    x, damping = start.coordinates, INITIAL_DAMPING
    r, normal = residual(x)
    for _ in range(MAX_SLIDING_STEPS):
        rows = ((root[:, None] * values)[:, :, None] * normal[:, None, :]).reshape(len(r), -1) @ basis
        left, sizes, right = np.linalg.svd(rows, full_matrices=False)
        step = basis @ (right.T @ (sizes / (sizes**2 + damping**2) * (left.T @ r)))
        moved, moved_normal = residual(x - step)
        before, after = float(r @ r), float(moved @ moved)
        if after >= before:
            damping *= 4
            continue
        x, r, normal, damping = x - step, moved, moved_normal, damping / 2
        if after > STALL_RATIO * before:
            break
    return _Candidate(axis, x)
