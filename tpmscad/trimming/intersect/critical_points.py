"""Critical points of the distance on a patch, and grid lines that resolve the level set about them.

The topology of a level set changes at critical points only. Where the distance is nearly zero at one, a grid line is placed
through it and a geometric sequence of lines about it, so that a loop or a neck of any size is resolved. A saddle *in* the surface
gets a block of three by three cells of its own.

`find_critical_points` treats one surface and returns the points. `detect_critical_points` treats many surfaces in one batch, from
the same starting points, and only returns which of them have one: mostly none has. The former is the reference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.splines.basis import design_matrices
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.patch_borders import grid_corners
from tpmscad.trimming.operands.quadric_table import ComposedDistance, QuadricTable, evaluate_second_jet

SADDLE_BLOCK_SPACINGS = np.array([-0.4, -0.15, 0.15, 0.4])
"""Lines about a saddle in the surface, in grid spacings: the rim of the 3 x 3 cells separates four arms at any angle."""

BORDER_SPACINGS = 1e-3
"""Distance in grid spacings below which a saddle lies on the border, and below which two critical points are one."""

CURVATURE_FACTOR = 2.0
"""Values up to this factor times the largest second differences of the grid may be changed by an unresolved extremum."""

NEWTON_STEPS = 30
"""Largest number of Newton steps to a critical point."""

STEP_TOL = 1e-13
"""Newton step in (u, v) at which a critical point has converged."""

DETECTION_STEP_TOL = 1e-9
"""Newton step in (u, v) at which the value at a critical point has converged: its error is of the order of the square."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchCriticalPoint:
    """A critical point of small value: (u, v), value, and the radius in (u, v) within which the value matters."""

    parameters: Array
    value: float
    is_saddle: bool
    radius: float


def find_critical_points(distance: BSplineSurface | ComposedDistance, us: Array, vs: Array) -> list[PatchCriticalPoint]:
    """The critical points within a grid spacing of the patch at which the grid may miss a branch of the level set."""
    g, gu, gv = (distance.grid(us, vs, *d)[None, ..., 0] for d in ((0, 0), (1, 0), (0, 1)))
    small, _, starts = place_newton_starts(g, gu, gv, us, vs)
    h = _grid_spacing(us, vs)
    return collect_critical_points(distance, starts, h, float(small[0]))


def collect_critical_points(
    distance: BSplineSurface | ComposedDistance, starts: Array, h: Array, limit: float
) -> list[PatchCriticalPoint]:
    """The distinct critical points at which Newton's method ends from starts (n, 2) on a grid of spacing h (2,).

    Those whose value exceeds `limit` are left out.
    """
    result: list[PatchCriticalPoint] = []
    for start in starts:
        found = iterate_to_critical_point(distance, start, h)
        if found is None or abs(found.value) > limit:
            continue
        if not any((np.abs(found.parameters - p.parameters) < BORDER_SPACINGS * h).all() for p in result):
            result.append(found)
    return result


def detect_critical_points(
    surface: BSplineSurface, implicit: QuadricTable, g: Array, gu: Array, gv: Array, us: Array, vs: Array
) -> BoolArray:
    """The distances with a critical point as in `find_critical_points`: (m,).

    g, gu, gv (m, nu, nv): the distances from m implicit surfaces and their derivatives on the grid of us and vs.
    """
    small, row, start = place_newton_starts(g, gu, gv, us, vs)
    value = _evaluate_critical_values(surface, implicit.take(row), start, _grid_spacing(us, vs))
    result = np.zeros(len(g), bool)
    result[row[np.abs(value) <= small[row]]] = True
    return result


def refine_grid_lines(
    us: Array, vs: Array, critical: list[PatchCriticalPoint], on_corner: BoolArray, zero_tol: float
) -> tuple[Array, Array, Array]:
    """Grid lines with more of them about the critical points, and the saddles (n, 2) whose |value| <= zero_tol.

    `on_corner` (4,): the patch's corners on the surface. A saddle in such a corner needs no lines: its arms start there.
    """
    low, high = np.array([us[0], vs[0]]), np.array([us[-1], vs[-1]])
    h = _grid_spacing(us, vs)
    corners = grid_corners(us, vs)
    lines = [us, vs]
    saddles = []
    for c in critical:
        room = np.minimum(c.parameters - low, high - c.parameters)
        if abs(c.value) > zero_tol:
            ladder = c.radius * 2.0 ** np.arange(np.log2(h.max() / c.radius) + 1.0)
            for axis in (0, 1):
                new = c.parameters[axis] + np.concatenate([[0.0], ladder, -ladder])
                lines[axis] = np.union1d(lines[axis], new[(new > low[axis]) & (new < high[axis])])
        elif c.is_saddle and (room > -BORDER_SPACINGS * h).all():
            if (room < BORDER_SPACINGS * h).any():
                if not (on_corner & (np.abs(corners - c.parameters) < BORDER_SPACINGS * h).all(axis=1)).any():
                    raise TrimmingError(
                        "a patch is tangent to a surface of the body at a saddle on the patch's border, at "
                        f"(u, v) = {c.parameters}"
                    )
                continue
            size = np.minimum(h, room)
            for axis in (0, 1):
                apart = np.abs(lines[axis] - c.parameters[axis])
                others = lines[axis][apart > SADDLE_BLOCK_SPACINGS[-1] * size[axis] * (1 + 1e-9)]
                lines[axis] = np.union1d(others, c.parameters[axis] + size[axis] * SADDLE_BLOCK_SPACINGS)
            saddles.append(c.parameters)
    return lines[0], lines[1], np.array(saddles).reshape(-1, 2)


def _grid_spacing(us: Array, vs: Array) -> Array:
    """The largest spacings of grid lines along u and v: (2,)."""
    return np.array([np.diff(us).max(), np.diff(vs).max()])


def place_newton_starts(
    g: Array, gu: Array, gv: Array, us: Array, vs: Array, ignored: BoolArray | None = None
) -> tuple[Array, IntArray, Array]:
    """Starting points for m distances on a grid, (m, nu, nv) each.

    Returns the value (m,) below which a critical point matters, and the distance (n,) and (u, v) (n, 2) of each start: the
    cells in which both derivatives change sign, and the node of least gradient, for a critical point just outside the patch.
    Nodes that are `ignored` (m, nu, nv) have no part in second differences, and no cell begins at them.
    """
    bends = np.abs(np.diff(g, 2, axis=1)), np.abs(np.diff(g, 2, axis=2))
    if ignored is not None:
        kept = ~ignored
        bends = (
            bends[0] * (kept[:, :-2] & kept[:, 1:-1] & kept[:, 2:]),
            bends[1] * (kept[..., :-2] & kept[..., 1:-1] & kept[..., 2:]),
        )
    small = CURVATURE_FACTOR * (bends[0].max(axis=(1, 2)) + bends[1].max(axis=(1, 2)))
    near = np.abs(g) < CURVATURE_FACTOR * small[:, None, None]
    if ignored is not None:
        near &= ~ignored
    h = _grid_spacing(us, vs)
    row, i, j = np.nonzero(_cells_with_sign_change(gu) & _cells_with_sign_change(gv) & near[:, :-1, :-1])
    flattest = ((gu * h[0]) ** 2 + (gv * h[1]) ** 2).reshape(len(g), -1).argmin(axis=1)
    also = np.flatnonzero(near.reshape(len(g), -1)[np.arange(len(g)), flattest])
    k, n = np.divmod(flattest[also], len(vs))
    cells = np.column_stack([us[i] + us[i + 1], vs[j] + vs[j + 1]]) / 2
    return small, np.concatenate([row, also]), np.concatenate([cells, np.column_stack([us[k], vs[n]])])


def _cells_with_sign_change(a: Array) -> BoolArray:
    """Cells of grids (m, nu, nv) at whose corners `a` has both signs: (m, nu - 1, nv - 1)."""
    n = a < 0
    some = n[:, :-1, :-1] | n[:, 1:, :-1] | n[:, :-1, 1:] | n[:, 1:, 1:]
    return some & ~(n[:, :-1, :-1] & n[:, 1:, :-1] & n[:, :-1, 1:] & n[:, 1:, 1:])


def iterate_to_critical_point(
    distance: BSplineSurface | ComposedDistance, p: Array, h: Array
) -> PatchCriticalPoint | None:
    """The critical point that Newton's method finds from p; None if it leaves the patch by more than a grid spacing."""
    (u0, u1), (v0, v1) = distance.domain
    low, high = np.array([u0, v0]) - h, np.array([u1, v1]) + h
    for _ in range(NEWTON_STEPS):
        value, gradient, hessian = evaluate_second_jet(distance, p)
        determinant = float(np.linalg.det(hessian))
        if determinant == 0.0:
            return None
        step = np.linalg.solve(hessian, gradient)
        p = p - step
        if (p < low).any() or (p > high).any():
            return None
        if np.abs(step).max() < STEP_TOL:
            radius = float(np.sqrt(abs(value)) / abs(determinant) ** 0.25)
            return PatchCriticalPoint(p, value, determinant < 0, radius)
    return None


def _evaluate_critical_values(surface: BSplineSurface, implicit: QuadricTable, start: Array, h: Array) -> Array:
    """The distances at which Newton's method ends from `start` (n, 2); infinite if it leaves the patch by more than h."""
    low, high = np.array(surface.domain).T
    low, high = low - h, high + h
    result, p, rows = np.full(len(start), np.inf), start.copy(), np.arange(len(start))
    for _ in range(NEWTON_STEPS):
        if len(rows) == 0:
            break
        value, gradient, hessian = _evaluate_second_jets(surface, implicit.take(rows), p[rows])
        (a, b), d = hessian[:, 0].T, hessian[:, 1, 1]
        determinant = a * d - b * b
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = gradient.T
            step = np.column_stack([d * x - b * y, a * y - b * x]) / determinant[:, None]
        p[rows] -= step
        inside = ((p[rows] >= low) & (p[rows] <= high)).all(axis=1) & (determinant != 0.0)
        done = inside & (np.abs(step).max(axis=1) < DETECTION_STEP_TOL)
        result[rows[done]] = value[done]
        rows = rows[inside & ~done]
    return result


def _evaluate_second_jets(surface: BSplineSurface, implicit: QuadricTable, at: Array) -> tuple[Array, Array, Array]:
    """Values (n,), gradients (n, 2) and Hessians (n, 2, 2) by u and v of n distances, at one point each."""
    bu = np.stack(design_matrices(surface.knots_u, surface.degree_u, at[:, 0], (0, 1, 2)))
    bv = np.stack(design_matrices(surface.knots_v, surface.degree_v, at[:, 1], (0, 1, 2)))
    half = (bu @ surface.poles.reshape(len(surface.poles), -1)).reshape(3, len(at), -1, 3)
    s = np.einsum("knv,invd->iknd", bv, half)  # derivative (i, k)
    value, gradient, hessian = (j[:, 0] for j in implicit.jet(s[0, 0][:, None], 2))
    first = np.stack([s[1, 0], s[0, 1]], axis=1)
    second = np.stack([np.stack([s[2, 0], s[1, 1]], axis=1), np.stack([s[1, 1], s[0, 2]], axis=1)], axis=1)
    bent = first @ hessian @ np.swapaxes(first, 1, 2)
    return value, np.einsum("nak,nk->na", first, gradient), np.einsum("nabk,nk->nab", second, gradient) + bent
