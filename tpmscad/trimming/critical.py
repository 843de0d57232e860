"""Critical points of a surface's distance on a patch, and a grid that can't hide what happens about them.

The topology of a level set changes at critical points only. Where the distance is nearly zero at one, grid lines are laid
through it and, in a geometric ladder, about it: a loop or a neck of any size shows. A saddle *in* the plane gets a block of
cells of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.splines.bspline import Surface
from tpmscad.trimming.composed import Composed, second_jet
from tpmscad.trimming.tool import Array, Flags, TrimmingError

BLOCK = np.array([-0.4, -0.15, 0.15, 0.4])
"""Lines about a saddle in the plane, in grid spacings: three by three cells, whose rim tells four arms at any angle apart."""

AT_BORDER = 1e-3
"""A saddle this near to the border (in grid spacings) has no room for a block of cells."""


@dataclass(frozen=True, slots=True, eq=False)
class Critical:
    """A critical point of small value: (u, v), the value, the Hessian's sign, and how far in (u, v) the value matters."""

    at: Array
    value: float
    saddle: bool
    scale: float


def critical_points(level: Surface | Composed, us: Array, vs: Array) -> list[Critical]:
    """The critical points of a scalar surface within a grid spacing of the patch, where a grid might miss their effect."""
    g, gu, gv = (level.grid(us, vs, *d)[..., 0] for d in ((0, 0), (1, 0), (0, 1)))
    small = 2.0 * (np.abs(np.diff(g, 2, axis=0)).max() + np.abs(np.diff(g, 2, axis=1)).max())
    h = np.array([np.diff(us).max(), np.diff(vs).max()])
    cells = np.argwhere(_mixed(gu) & _mixed(gv) & (np.abs(g[:-1, :-1]) < 2.0 * small))
    starts = [np.array([us[i] + us[i + 1], vs[j] + vs[j + 1]]) / 2 for i, j in cells]
    i, j = np.unravel_index(np.argmin((gu * h[0]) ** 2 + (gv * h[1]) ** 2), g.shape)
    if abs(g[i, j]) < 2.0 * small:  # a critical point just outside bends the curves inside
        starts.append(np.array([us[i], vs[j]]))
    result: list[Critical] = []
    for start in starts:
        found = _stationary(level, start, h)
        if found is None or abs(found.value) > small:
            continue
        if not any((np.abs(found.at - other.at) < AT_BORDER * h).all() for other in result):
            result.append(found)
    return result


def refine(us: Array, vs: Array, critical: list[Critical], on_corner: Flags, flat: float) -> tuple[Array, Array, Array]:
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
        elif c.saddle and (room > -AT_BORDER * h).all():
            if (room < AT_BORDER * h).any():
                if not (on_corner & (np.abs(corners - c.at) < AT_BORDER * h).all(axis=1)).any():
                    raise TrimmingError(f"a saddle in the plane lies on a patch's border, at (u, v) = {c.at}")
                continue
            size = np.minimum(h, room)
            for axis in (0, 1):
                others = lines[axis][np.abs(lines[axis] - c.at[axis]) > BLOCK[-1] * size[axis] * (1 + 1e-9)]
                lines[axis] = np.union1d(others, c.at[axis] + size[axis] * BLOCK)
            saddles.append(c.at)
    return lines[0], lines[1], np.array(saddles).reshape(-1, 2)


def _mixed(a: Array) -> Flags:
    """Cells at whose corners `a` has both signs."""
    n = (a < 0).astype(np.int8)
    total = n[:-1, :-1] + n[1:, :-1] + n[:-1, 1:] + n[1:, 1:]
    return np.asarray((total > 0) & (total < 4))


def _stationary(level: Surface | Composed, p: Array, h: Array) -> Critical | None:
    """The critical point that Newton finds from p; None if it runs more than a grid spacing out of the patch."""
    (u0, u1), (v0, v1) = level.domain
    low, high = np.array([u0, v0]) - h, np.array([u1, v1]) + h
    for _ in range(30):
        value, gradient, hessian = second_jet(level, p)
        determinant = float(np.linalg.det(hessian))
        if determinant == 0.0:
            return None
        step = np.linalg.solve(hessian, gradient)
        p = p - step
        if (p < low).any() or (p > high).any():
            return None
        if np.abs(step).max() < 1e-13:
            return Critical(p, value, determinant < 0, float(np.sqrt(abs(value)) / abs(determinant) ** 0.25))
    return None
