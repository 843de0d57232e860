"""The primitive patches of a mirror surface: its piece between the mirrors, offset and fitted with as few poles as will do.

All candidates meet their reflections with continuous curvature (see `mirror.joints`). The least-squares fit to the offset of the
conformal chart is where the search starts; but of a patch only the point set counts, so Gauss-Newton steps then let its points
slide along the surface and lessen the distances alone. That gains what three degrees would.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tpmscad.patches.deviation import Deviation, worst
from tpmscad.patches.mirror.deviation import mirror_deviation
from tpmscad.patches.mirror.harmonic import Chart, chart
from tpmscad.patches.mirror.joints import mirror_conditions
from tpmscad.patches.sheet import Sheet
from tpmscad.splines.axis import Axis, bezier_knots, gauss_axis
from tpmscad.splines.bspline import Array, Surface
from tpmscad.splines.fitting import free_coordinates, surface
from tpmscad.splines.subspace import Subspace, pole_metric, solve_conditions
from tpmscad.surfaces import MirrorSymmetry

DEGREES = range(7, 17)
"""One span each. Degree 6 meets 1e-3 only with parameters that bunch so much that cuts can't be traced on it; past 16 float64
has too few digits."""

GAIN = 100.0
"""Sliding lessens a deviation by no more than this: degrees that start further off are left out. 8 to 90 were measured."""

SLIDES = 12
"""Gauss-Newton steps at the most."""

DAMPING = 1e-2
"""Of the steps, at first; halved after every step that lessens the distances, quadrupled after one that does not."""

BUNCHED = 0.4
"""Sliding may lessen the least |S_u x S_v| to this part of itself: past it the parameters bunch. 0.45 to 1 were measured where
cuts were traced without trouble, 0.04 where they were not."""

STALLED = 0.95
"""Steps end when the sum of squares falls by less than to this part of itself."""


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A fitted piece in cells, and its measured two-way deviation."""

    patch: Surface
    degree: int
    deviation: Deviation


def fit_pieces(name: str, layers: tuple[float | None, float | None], tol: float) -> tuple[Sheet, Deviation]:
    """Fit the lower and the upper surface at their normal distances (cells; None: no surface) to within `tol` (cells).

    Where no degree meets `tol` the best comes back: compare.
    """
    fits = {d: fit_piece(name, d, tol) for d in layers if d is not None}
    order = list(fits)
    lower, upper = (None if d is None else (order.index(d), False) for d in layers)
    sheet = Sheet(tuple(fits[d].patch for d in order), lower, upper)
    return sheet, worst([fit.deviation for fit in fits.values()])


@lru_cache(maxsize=64)
def fit_piece(name: str, offset: float, tol: float) -> Piece:
    """The offset piece of the lowest degree whose measured deviation is at most `tol` (cells), or the best there is."""
    form = chart(name)
    best: Piece | None = None
    for degree in DEGREES:
        last = degree == DEGREES[-1]
        first, space = _least_squares(form, offset, degree)
        if not last and _distances(form, first.patch(), offset) > GAIN * tol:
            continue
        slid = _slid(form, first, space, offset).patch()
        bunched = _least_element(slid) < BUNCHED * _least_element(first.patch())
        patch = _flush(first.patch() if bunched else slid, form.symmetry)
        piece = Piece(patch, degree, mirror_deviation(form.symmetry, patch, offset))
        if best is None or piece.deviation.max < best.deviation.max:
            best = piece
        if best.deviation.max <= tol:
            break
    assert best is not None
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """A patch by its coordinates (U V 3,) on the axis of both parameters."""

    axis: Axis
    coordinates: Array

    def patch(self) -> Surface:
        size = self.axis.size
        return surface(self.coordinates.reshape(size, size, 3), self.axis, self.axis)


def _least_squares(form: Chart, offset: float, degree: int) -> tuple[_Candidate, Subspace]:
    axis = gauss_axis(bezier_knots(degree), degree)
    mirrors = form.symmetry
    conditions = mirror_conditions(axis, axis, form.quadrilateral.centres, mirrors.wall_normals, mirrors.wall_offsets)
    space = solve_conditions(conditions, pole_metric(axis, axis))
    target = form.offset(axis.points[:, None], axis.points[None, :], offset)
    return _Candidate(axis, space.project(free_coordinates(target, axis, axis).ravel())), space


def _distances(form: Chart, patch: Surface, offset: float) -> float:
    t = np.linspace(0.0, 1.0, 2 * patch.degree_u)
    return float(np.abs(form.symmetry.waves.foot(patch.grid(t, t))[0] - offset).max())


def _flush(patch: Surface, mirrors: MirrorSymmetry) -> Surface:
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
    return Surface(poles, patch.knots_u, patch.knots_v, patch.degree_u, patch.degree_v)


def _least_element(patch: Surface) -> float:
    t = np.linspace(0.0, 1.0, 2 * patch.degree_u)
    return float(np.linalg.norm(patch.normal(t[:, None], t), axis=-1).min())


def _slid(form: Chart, start: _Candidate, space: Subspace, offset: float) -> _Candidate:
    """The patch after damped Gauss-Newton steps on the distances at the axis' points."""
    axis, basis = start.axis, space.basis()
    root = np.sqrt(np.outer(axis.weights, axis.weights).ravel())
    values = np.kron(axis.design(axis.points), axis.design(axis.points))

    def residual(coordinates: Array) -> tuple[Array, Array]:
        distance, normal, _ = form.symmetry.waves.foot(values @ coordinates.reshape(-1, 3))
        return root * (distance - offset), normal

    x, damping = start.coordinates, DAMPING
    r, normal = residual(x)
    for _ in range(SLIDES):
        rows = ((root[:, None] * values)[:, :, None] * normal[:, None, :]).reshape(len(r), -1) @ basis
        left, sizes, right = np.linalg.svd(rows, full_matrices=False)
        step = basis @ (right.T @ (sizes / (sizes**2 + damping**2) * (left.T @ r)))
        moved, moved_normal = residual(x - step)
        before, after = float(r @ r), float(moved @ moved)
        if after >= before:
            damping *= 4
            continue
        x, r, normal, damping = x - step, moved, moved_normal, damping / 2
        if after > STALLED * before:
            break
    return _Candidate(axis, x)
