"""Points that two faces have in common: Newton's method, the tangent of their common curve, and whether a curve passes a place.

A point is (u, v, s, r) with S(u, v) = Q(s, r) on the first and the second face.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_inner
from tpmscad._typing import Array
from tpmscad.trimming.operands.patch_polynomials import BREAK_U, SENSE, SPANS_U, PatchPolynomials, evaluate_face

NEWTON_STEPS = 15
"""Largest number of Newton steps of a correction."""

STEP_TOL = 1e-14
"""Step, relative to the parameter ranges, at which a correction has converged."""

STALLED = 0.9
"""Ratio of steps from which on only round-off is left: beside a sphere's pole equal steps creep on, each a little smaller."""

ROUND_OFF = 1e-14
"""Distance of the points on both faces, relative to the largest coordinate, that round-off leaves: at a sine of 1e-3 it moves the
parameters by a thousand times as much in each step."""

MIN_SINE = 1e-5
"""Sine of the angle between two faces below which a curve is not traced."""

NEAR_PATH = 0.1
"""Distance from a step's chord, in steps, up to which a point may lie on the curve: it bulges by a 60th part."""


class Work(NamedTuple):
    """Arrays that loops write to: both jets (3, 3), a system (4, 5), tangent (3,), rates (4,), a point (4,), and a plane."""

    jet_f: Array
    jet_g: Array
    system: Array
    tangent: Array
    rate: Array
    point: Array
    place: Array
    normal: Array


def make_work() -> Work:
    """Arrays to write to."""
    return Work(
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((4, 5)),
        np.empty(3),
        np.empty(4),
        np.empty(4),
        np.empty(3),
        np.empty(3),
    )


@njit_inner
def range_of(patches: PatchPolynomials, f: int, axis: int) -> float:  # pragma: no cover - compiled
    """The length of the range of u (axis 0) or v of a face."""
    begin = patches.layout[f, BREAK_U + axis]
    return patches.breaks[begin + patches.layout[f, SPANS_U + axis]] - patches.breaks[begin]


@njit_inner
def correct_point(
    patches: PatchPolynomials,
    f: int,
    g: int,
    at: Array,
    origin: Array,
    normal: Array,
    work: Work,
) -> bool:  # pragma: no cover - compiled
    """Move (u, v, s, r) `at` onto both faces in the plane through `origin` with `normal`; whether it has converged.

    The jets of both faces there are left in `work`.
    """
    a = work.system
    moved = np.inf
    for _ in range(NEWTON_STEPS):
        evaluate_face(patches, f, at[0], at[1], work.jet_f)
        evaluate_face(patches, g, at[2], at[3], work.jet_g)
        a[3, 4] = 0.0
        gap, size = 0.0, 0.0
        for c in range(4):
            a[3, c] = 0.0
        for d in range(3):
            for c in range(2):
                a[d, c], a[d, 2 + c] = work.jet_f[1 + c, d], -work.jet_g[1 + c, d]
                a[3, c] += 0.5 * work.jet_f[1 + c, d] * normal[d]
                a[3, 2 + c] += 0.5 * work.jet_g[1 + c, d] * normal[d]
            a[d, 4] = work.jet_g[0, d] - work.jet_f[0, d]
            gap, size = max(gap, abs(a[d, 4])), max(size, abs(work.jet_f[0, d]))
            a[3, 4] -= (0.5 * (work.jet_f[0, d] + work.jet_g[0, d]) - origin[d]) * normal[d]
        if not solve_four(a):
            return False
        step = 0.0
        for c in range(4):
            at[c] += a[c, 4]
            face = f if c < 2 else g
            step = max(step, abs(a[c, 4]) / range_of(patches, face, c % 2))
        if not step < 10.0:
            return False
        if step < STEP_TOL or (step >= STALLED * moved and (step < 1e-11 or gap < ROUND_OFF * size)):
            return True
        moved = step
    return False


@njit_inner
def solve_four(a: Array) -> bool:  # pragma: no cover - compiled
    """Solve the 4 x 4 system a[:, :4] x = a[:, 4] in place, x in the last column; False if it is singular."""
    for k in range(4):
        best = k
        for i in range(k + 1, 4):
            if abs(a[i, k]) > abs(a[best, k]):
                best = i
        if not abs(a[best, k]) > 0.0:
            return False
        if best != k:
            for c in range(k, 5):
                a[k, c], a[best, c] = a[best, c], a[k, c]
        for i in range(k + 1, 4):
            m = a[i, k] / a[k, k]
            for c in range(k + 1, 5):
                a[i, c] -= m * a[k, c]
    for k in range(3, -1, -1):
        for c in range(k + 1, 4):
            a[k, 4] -= a[k, c] * a[c, 4]
        a[k, 4] /= a[k, k]
    return True


@njit_inner
def find_tangent(patches: PatchPolynomials, f: int, g: int, work: Work) -> float:  # pragma: no cover - compiled
    """Fill in the unit tangent n_f x n_g and the rates of (u, v, s, r) along it from the jets; returns the sine of the angle.

    The normals lead out of the solids: on the first face the second solid is on the left of the tangent, seen from outside.
    """
    p, q = work.jet_f, work.jet_g
    nx, ny, nz = (
        p[1, 1] * p[2, 2] - p[1, 2] * p[2, 1],
        p[1, 2] * p[2, 0] - p[1, 0] * p[2, 2],
        p[1, 0] * p[2, 1] - p[1, 1] * p[2, 0],
    )
    mx, my, mz = (
        q[1, 1] * q[2, 2] - q[1, 2] * q[2, 1],
        q[1, 2] * q[2, 0] - q[1, 0] * q[2, 2],
        q[1, 0] * q[2, 1] - q[1, 1] * q[2, 0],
    )
    n = np.sqrt(nx * nx + ny * ny + nz * nz)
    m = np.sqrt(mx * mx + my * my + mz * mz)
    tx, ty, tz = ny * mz - nz * my, nz * mx - nx * mz, nx * my - ny * mx
    t = np.sqrt(tx * tx + ty * ty + tz * tz)
    sine = t / (n * m)
    if not sine > 0.0:
        return 0.0
    t *= patches.layout[f, SENSE] * patches.layout[g, SENSE]
    tangent = work.tangent
    tangent[0], tangent[1], tangent[2] = tx / t, ty / t, tz / t
    for side in range(2):
        jet = p if side == 0 else q
        uu, uv, vv, tu, tv = 0.0, 0.0, 0.0, 0.0, 0.0
        for d in range(3):
            uu += jet[1, d] * jet[1, d]
            uv += jet[1, d] * jet[2, d]
            vv += jet[2, d] * jet[2, d]
            tu += jet[1, d] * tangent[d]
            tv += jet[2, d] * tangent[d]
        det = uu * vv - uv * uv
        work.rate[2 * side] = (tu * vv - tv * uv) / det
        work.rate[2 * side + 1] = (tv * uu - tu * uv) / det
    return sine


@njit_inner
def pass_fraction(path: Array, row: int, places: Array, k: int) -> float:  # pragma: no cover - compiled
    """The fraction of the step from `row` at which it passes a place that is near its chord; -1 if it does not."""
    square, along, apart = 0.0, 0.0, 0.0
    for d in range(3):
        chord, arm = path[row + 1, d] - path[row, d], places[k, d] - path[row, d]
        square += chord * chord
        along += chord * arm
        apart += arm * arm
    ahead = along / square
    if not -1e-9 < ahead < 1.0 + 1e-9 or apart - ahead * along > NEAR_PATH**2 * square:
        return -1.0
    return max(ahead, 1e-300)


@njit_inner
def meets(
    patches: PatchPolynomials,
    f: int,
    g: int,
    path: Array,
    row: int,
    ahead: float,
    places: Array,
    k: int,
    match_tol: float,
    work: Work,
) -> bool:  # pragma: no cover - compiled
    """Whether the curve passes a place, at about a fraction of the step from `row`; its parameters go to `work.point`."""
    for d in range(3):
        work.normal[d] = path[row, 7 + d] * (1.0 - ahead) + path[row + 1, 7 + d] * ahead
        work.place[d] = places[k, d]
    for c in range(4):
        work.point[c] = path[row, 3 + c] * (1.0 - ahead) + path[row + 1, 3 + c] * ahead
    if not correct_point(patches, f, g, work.point, work.place, work.normal, work):
        return False
    apart = 0.0
    for d in range(3):
        apart = max(apart, abs(work.jet_f[0, d] - places[k, d]))
    return apart <= match_tol


@njit_inner
def copy_point(jet: Array, places: Array, row: int) -> None:  # pragma: no cover - compiled
    """Write the point of a jet to a row of places."""
    for d in range(3):
        places[row, d] = jet[0, d]
