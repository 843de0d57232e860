"""Critical points of a surface's distance on a patch, and a grid that can't hide what happens about them.

The topology of a level set changes at critical points only. Where the distance is nearly zero at one, grid lines are laid
through it and, in a geometric ladder, about it: a loop or a neck of any size shows. A saddle *in* the plane gets a block of
cells of its own.

Whether a surface's distance has a critical point on a patch that a grid might miss, for many surfaces at once.

As `critical.critical_points`, from the same starting points, but without the points themselves: mostly there are none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.errors import TrimmingError
from tpmscad.splines.basis import design_matrices
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.implicit_surfaces import ComposedDistance, ImplicitSurfaces, evaluate_second_jet

SADDLE_BLOCK_SPACINGS = np.array([-0.4, -0.15, 0.15, 0.4])
"""Lines about a saddle in the plane, in grid spacings: three by three cells, whose rim tells four arms at any angle apart."""

BORDER_SPACINGS = 1e-3
"""A saddle this near to the border (in grid spacings) has no room for a block of cells."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchCriticalPoint:
    """A critical point of small value: (u, v), the value, the Hessian's sign, and how far in (u, v) the value matters."""

    at: Array
    value: float
    is_saddle: bool
    scale: float


def find_critical_points(level: BSplineSurface | ComposedDistance, us: Array, vs: Array) -> list[PatchCriticalPoint]:
    """The critical points of a scalar surface within a grid spacing of the patch, where a grid might miss their effect."""
    g, gu, gv = (level.grid(us, vs, *d)[..., 0] for d in ((0, 0), (1, 0), (0, 1)))
    small = 2.0 * (np.abs(np.diff(g, 2, axis=0)).max() + np.abs(np.diff(g, 2, axis=1)).max())
    h = np.array([np.diff(us).max(), np.diff(vs).max()])
    cells = np.argwhere(_cells_with_sign_change(gu) & _cells_with_sign_change(gv) & (np.abs(g[:-1, :-1]) < 2.0 * small))
    starts = [np.array([us[i] + us[i + 1], vs[j] + vs[j + 1]]) / 2 for i, j in cells]
    i, j = np.unravel_index(np.argmin((gu * h[0]) ** 2 + (gv * h[1]) ** 2), g.shape)
    if abs(g[i, j]) < 2.0 * small:  # a critical point just outside bends the curves inside
        starts.append(np.array([us[i], vs[j]]))
    result: list[PatchCriticalPoint] = []
    for start in starts:
        found = _iterate_to_critical_point(level, start, h)
        if found is None or abs(found.value) > small:
            continue
        if not any((np.abs(found.at - other.at) < BORDER_SPACINGS * h).all() for other in result):
            result.append(found)
    return result


def refine_grid_lines(
    us: Array, vs: Array, critical: list[PatchCriticalPoint], on_corner: BoolArray, flat: float
) -> tuple[Array, Array, Array]:
    """Grid lines about the critical points, and the saddles that count as zero, with |value| <= flat, (n, 2).

    `on_corner` (4,): the patch's corners on the plane. A saddle in such a corner needs nothing: its arms start there.
    """
    low, high = np.array([us[0], vs[0]]), np.array([us[-1], vs[-1]])
    h = np.array([np.diff(us).max(), np.diff(vs).max()])
    corners = np.array([[us[0], vs[0]], [us[-1], vs[0]], [us[-1], vs[-1]], [us[0], vs[-1]]])
    lines = [us, vs]
    saddles = []
    for c in critical:
        room = np.minimum(c.at - low, high - c.at)
        if abs(c.value) > flat:
            ladder = c.scale * 2.0 ** np.arange(np.log2(h.max() / c.scale) + 1.0)
            for axis in (0, 1):
                new = c.at[axis] + np.concatenate([[0.0], ladder, -ladder])
                lines[axis] = np.union1d(lines[axis], new[(new > low[axis]) & (new < high[axis])])
        elif c.is_saddle and (room > -BORDER_SPACINGS * h).all():
            if (room < BORDER_SPACINGS * h).any():
                if not (on_corner & (np.abs(corners - c.at) < BORDER_SPACINGS * h).all(axis=1)).any():
                    raise TrimmingError(f"a saddle in the plane lies on a patch's border, at (u, v) = {c.at}")
                continue
            size = np.minimum(h, room)
            for axis in (0, 1):
                others = lines[axis][
                    np.abs(lines[axis] - c.at[axis]) > SADDLE_BLOCK_SPACINGS[-1] * size[axis] * (1 + 1e-9)
                ]
                lines[axis] = np.union1d(others, c.at[axis] + size[axis] * SADDLE_BLOCK_SPACINGS)
            saddles.append(c.at)
    return lines[0], lines[1], np.array(saddles).reshape(-1, 2)


def _cells_with_sign_change(a: Array) -> BoolArray:
    """Cells at whose corners `a` has both signs."""
    n = (a < 0).astype(np.int8)
    total = n[:-1, :-1] + n[1:, :-1] + n[:-1, 1:] + n[1:, 1:]
    return np.asarray((total > 0) & (total < 4))


def _iterate_to_critical_point(
    level: BSplineSurface | ComposedDistance, p: Array, h: Array
) -> PatchCriticalPoint | None:
    """The critical point that Newton finds from p; None if it runs more than a grid spacing out of the patch."""
    (u0, u1), (v0, v1) = level.domain
    low, high = np.array([u0, v0]) - h, np.array([u1, v1]) + h
    for _ in range(30):
        value, gradient, hessian = evaluate_second_jet(level, p)
        determinant = float(np.linalg.det(hessian))
        if determinant == 0.0:
            return None
        step = np.linalg.solve(hessian, gradient)
        p = p - step
        if (p < low).any() or (p > high).any():
            return None
        if np.abs(step).max() < 1e-13:
            return PatchCriticalPoint(p, value, determinant < 0, float(np.sqrt(abs(value)) / abs(determinant) ** 0.25))
    return None


NEWTON_STEPS = 30
"""Newton steps to a critical point."""

NEWTON_STEP_TOL = 1e-9
"""The last one is shorter in (u, v) than this: its square is what is left."""


def detect_critical_points(
    surface: BSplineSurface, levels: ImplicitSurfaces, g: Array, gu: Array, gv: Array, us: Array, vs: Array
) -> BoolArray:
    """For m distances and their derivatives on the grid of us and vs, (m, nu, nv) each: (m,)."""
    small = 2.0 * (np.abs(np.diff(g, 2, axis=1)).max(axis=(1, 2)) + np.abs(np.diff(g, 2, axis=2)).max(axis=(1, 2)))
    near = np.abs(g) < 2.0 * small[:, None, None]
    h = np.array([np.diff(us).max(), np.diff(vs).max()])
    row, i, j = np.nonzero(
        _cells_with_sign_change_batched(gu) & _cells_with_sign_change_batched(gv) & near[:, :-1, :-1]
    )
    flat = ((gu * h[0]) ** 2 + (gv * h[1]) ** 2).reshape(len(g), -1).argmin(axis=1)
    also = np.flatnonzero(near.reshape(len(g), -1)[np.arange(len(g)), flat])
    k, n = np.divmod(flat[also], len(vs))
    start = np.concatenate(
        [np.column_stack([us[i] + us[i + 1], vs[j] + vs[j + 1]]) / 2, np.column_stack([us[k], vs[n]])]
    )
    row = np.concatenate([row, also])
    value = _evaluate_critical_values(surface, levels.of(row), start, h)
    result = np.zeros(len(g), bool)
    result[row[np.abs(value) <= small[row]]] = True
    return result


def _evaluate_critical_values(surface: BSplineSurface, levels: ImplicitSurfaces, start: Array, h: Array) -> Array:
    """The distances where Newton's method ends, started from (n, 2); infinite where it leaves the patch by more than h."""
    low, high = np.array(surface.domain).T
    low, high = low - h, high + h
    result, p, rows = np.full(len(start), np.inf), start.copy(), np.arange(len(start))
    for _ in range(NEWTON_STEPS):
        if len(rows) == 0:
            break
        value, gradient, hessian = _evaluate_second_jets(surface, levels.of(rows), p[rows])
        (a, b), d = hessian[:, 0].T, hessian[:, 1, 1]
        determinant = a * d - b * b
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = gradient.T
            step = np.column_stack([d * x - b * y, a * y - b * x]) / determinant[:, None]
        p[rows] -= step
        inside = ((p[rows] >= low) & (p[rows] <= high)).all(axis=1) & (determinant != 0.0)
        done = inside & (np.abs(step).max(axis=1) < NEWTON_STEP_TOL)
        result[rows[done]] = value[done]
        rows = rows[inside & ~done]
    return result


def _evaluate_second_jets(surface: BSplineSurface, levels: ImplicitSurfaces, at: Array) -> tuple[Array, Array, Array]:
    """Values (n,), gradients (n, 2) and second derivatives (n, 2, 2) by u and v of n distances, at a point each."""
    bu = np.stack(design_matrices(surface.knots_u, surface.degree_u, at[:, 0], (0, 1, 2)))
    bv = np.stack(design_matrices(surface.knots_v, surface.degree_v, at[:, 1], (0, 1, 2)))
    half = (bu @ surface.poles.reshape(len(surface.poles), -1)).reshape(3, len(at), -1, 3)
    s = np.einsum("knv,invd->iknd", bv, half)  # derivative (i, k)
    value, gradient, hessian = (j[:, 0] for j in levels.jet(s[0, 0][:, None], 2))
    first = np.stack([s[1, 0], s[0, 1]], axis=1)
    second = np.stack([np.stack([s[2, 0], s[1, 1]], axis=1), np.stack([s[1, 1], s[0, 2]], axis=1)], axis=1)
    bent = first @ hessian @ np.swapaxes(first, 1, 2)
    return value, np.einsum("nak,nk->na", first, gradient), np.einsum("nabk,nk->nab", second, gradient) + bent


def _cells_with_sign_change_batched(a: Array) -> BoolArray:
    """Cells at whose corners `a` has both signs."""
    n = a < 0
    some = n[:, :-1, :-1] | n[:, 1:, :-1] | n[:, :-1, 1:] | n[:, 1:, 1:]
    return some & ~(n[:, :-1, :-1] & n[:, 1:, :-1] & n[:, :-1, 1:] & n[:, 1:, 1:])
