"""Whether a surface's distance has a critical point on a patch that a grid might miss, for many surfaces at once.

As `critical.critical_points`, from the same starting points, but without the points themselves: mostly there are none.
"""

from __future__ import annotations

import numpy as np

from tpmscad.splines.bspline import Surface
from tpmscad.trimming.bases import bases
from tpmscad.trimming.levels import Levels
from tpmscad.trimming.tool import Array, Flags

STEPS = 30
"""Newton steps to a critical point."""

STEP = 1e-9
"""The last one is shorter in (u, v) than this: its square is what is left."""


def hidden(surface: Surface, levels: Levels, g: Array, gu: Array, gv: Array, us: Array, vs: Array) -> Flags:
    """For m distances and their derivatives on the grid of us and vs, (m, nu, nv) each: (m,)."""
    small = 2.0 * (np.abs(np.diff(g, 2, axis=1)).max(axis=(1, 2)) + np.abs(np.diff(g, 2, axis=2)).max(axis=(1, 2)))
    near = np.abs(g) < 2.0 * small[:, None, None]
    h = np.array([np.diff(us).max(), np.diff(vs).max()])
    row, i, j = np.nonzero(_mixed(gu) & _mixed(gv) & near[:, :-1, :-1])
    flat = ((gu * h[0]) ** 2 + (gv * h[1]) ** 2).reshape(len(g), -1).argmin(axis=1)
    also = np.flatnonzero(near.reshape(len(g), -1)[np.arange(len(g)), flat])
    k, n = np.divmod(flat[also], len(vs))
    start = np.concatenate(
        [np.column_stack([us[i] + us[i + 1], vs[j] + vs[j + 1]]) / 2, np.column_stack([us[k], vs[n]])]
    )
    row = np.concatenate([row, also])
    value = _values_at_critical_points(surface, levels.of(row), start, h)
    result = np.zeros(len(g), bool)
    result[row[np.abs(value) <= small[row]]] = True
    return result


def _values_at_critical_points(surface: Surface, levels: Levels, start: Array, h: Array) -> Array:
    """The distances where Newton's method ends, started from (n, 2); infinite where it leaves the patch by more than h."""
    low, high = np.array(surface.domain).T
    low, high = low - h, high + h
    result, p, rows = np.full(len(start), np.inf), start.copy(), np.arange(len(start))
    for _ in range(STEPS):
        if len(rows) == 0:
            break
        value, gradient, hessian = _second_jets(surface, levels.of(rows), p[rows])
        (a, b), d = hessian[:, 0].T, hessian[:, 1, 1]
        determinant = a * d - b * b
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = gradient.T
            step = np.column_stack([d * x - b * y, a * y - b * x]) / determinant[:, None]
        p[rows] -= step
        inside = ((p[rows] >= low) & (p[rows] <= high)).all(axis=1) & (determinant != 0.0)
        done = inside & (np.abs(step).max(axis=1) < STEP)
        result[rows[done]] = value[done]
        rows = rows[inside & ~done]
    return result


def _second_jets(surface: Surface, levels: Levels, at: Array) -> tuple[Array, Array, Array]:
    """Values (n,), gradients (n, 2) and second derivatives (n, 2, 2) by u and v of n distances, at a point each."""
    bu = np.stack(bases(surface.knots_u, surface.degree_u, at[:, 0], 2))
    bv = np.stack(bases(surface.knots_v, surface.degree_v, at[:, 1], 2))
    half = (bu @ surface.poles.reshape(len(surface.poles), -1)).reshape(3, len(at), -1, 3)
    s = np.einsum("knv,invd->iknd", bv, half)  # derivative (i, k)
    value, gradient, hessian = (j[:, 0] for j in levels.jet(s[0, 0][:, None], 2))
    first = np.stack([s[1, 0], s[0, 1]], axis=1)
    second = np.stack([np.stack([s[2, 0], s[1, 1]], axis=1), np.stack([s[1, 1], s[0, 2]], axis=1)], axis=1)
    bent = first @ hessian @ np.swapaxes(first, 1, 2)
    return value, np.einsum("nak,nk->na", first, gradient), np.einsum("nabk,nk->nab", second, gradient) + bent


def _mixed(a: Array) -> Flags:
    """Cells at whose corners `a` has both signs."""
    n = a < 0
    some = n[:, :-1, :-1] | n[:, 1:, :-1] | n[:, :-1, 1:] | n[:, 1:, 1:]
    return some & ~(n[:, :-1, :-1] & n[:, 1:, :-1] & n[:, :-1, 1:] & n[:, 1:, 1:])
