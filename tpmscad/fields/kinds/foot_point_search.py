"""Compiled search for foot points: the points of a level set nearest to given points.

The search of a point is a sequence of states, `STARTED` to `FOUND`, between which the field is evaluated for all points
that wait. Points are resumed one by one, so that the foot point of a point does not depend on the other points.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array

MAX_DESCENT_STEPS = 60
MAX_HALVINGS = 12
"""Newton steps along the gradient, and halvings of one step."""

MAX_FOOT_STEPS = 40
"""Newton steps of the foot point; six are enough from within half the radius of curvature."""

DIFFERENCE_STEP = 1e-6
"""Step of the differences of the gradient, in units of length: its error slows the convergence only."""

DESCENT_TOL = 1e-4
FOOT_TOL = 1e-14
"""Last steps, in units of length, at which the two stages end."""

MIN_CURVATURE_FACTOR = 0.02
"""Least eigenvalue of 1 - distance * curvature by which a tangential step is divided."""

MIN_GRADIENT = 1e-12
"""A gradient below this, relative to the unit of length, has no direction: the start is moved off the critical point."""

LEVEL_SET_TOL = 1e-9
"""Distance to first order, in units of length, within which a foot point lies on the level set."""

MAX_RESTARTS = 3
RESTART_SHIFT = (0.013, -0.017, 0.0071)
"""Restarts of descents that ended at a critical point, as on axes of symmetry, and the displacement of the first one, in units of
length. Points that find no foot point even then get the unit of length as their distance."""

OFF_CRITICAL_POINT = (0.011, 0.007, 0.0053)
"""Displacement, in units of length, of a start at a critical point."""

POINTS_PER_BATCH = 4096
"""Points that are searched together: their states stay in the cache, and a batch that is much smaller takes longer a point."""

STARTED, DESCENDING, STEPPING, AT_FOOT, AT_DIFFERENCES, AT_END, FOUND = range(7)
"""What the jets that a point waits for are of: the start, a trial step of the descent, its untested last halving, the foot point,
the two points beside it for the differences of the gradient, and the final foot point. A point that is found waits for none."""

_COUNTS = ("state", "steps", "halvings", "restarts", "solid")
_NUMBERS = (
    "x y z unit longest foot_x foot_y foot_z value gx gy gz factor taken length ex ey ez fx fy fz distance nx ny nz"
)
SEARCH = np.dtype([(name, np.int64) for name in _COUNTS] + [(name, np.float64) for name in _NUMBERS.split(" ")])
"""The search of one point (x, y, z): its state, the current foot point with its jet, the step that is tried, two tangents there
(ex ... fz), and the result: the signed distance and the normal."""

JetFunction = Callable[[Array], Array]
"""Jets (4, n), value and gradient, at points given as columns (3, n)."""


def search_foot_points(jets_at: JetFunction, columns: Array, unit: Array, longest: Array) -> Array:
    """Signed distances and normals (4, n) of points given as columns (3, n).

    `unit` (n,) is the unit of length of the tolerances at a point, `longest` (n,) its longest step.
    """
    found = np.empty((4, columns.shape[1]))
    for start in range(0, columns.shape[1], POINTS_PER_BATCH):
        part = slice(start, start + POINTS_PER_BATCH)
        asked = columns[:, part].copy()
        points = _start(asked, unit[part], longest[part])
        waiting = np.arange(len(points))
        while len(waiting):
            waiting, asked = _resume_all(points, waiting, jets_at(asked))
        found[:, part] = points["distance"], points["nx"], points["ny"], points["nz"]
    return found


@njit_cached
def _start(columns, unit, longest):  # type: ignore[no-untyped-def]  # pragma: no cover
    points = np.zeros(columns.shape[1], SEARCH)
    for i in range(len(points)):
        p = points[i]
        p.state = STARTED
        p.x, p.y, p.z = columns[0, i], columns[1, i], columns[2, i]
        p.foot_x, p.foot_y, p.foot_z = p.x, p.y, p.z
        p.unit, p.longest = unit[i], longest[i]
    return points


@njit_cached
def _resume_all(points, waiting, jets):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Resume the waiting points with the jets they asked for: those that wait again, and the columns they ask for."""
    asked = np.empty((3, 2 * len(waiting)))
    n_waiting = n_asked = k = 0
    for i in waiting:
        p = points[i]
        k += _resume(p, jets, k)
        if p.state == FOUND:
            continue
        waiting[n_waiting] = i
        n_waiting += 1
        if p.state == AT_DIFFERENCES:
            h = DIFFERENCE_STEP * p.unit
            asked[0, n_asked] = p.foot_x + h * p.ex
            asked[1, n_asked] = p.foot_y + h * p.ey
            asked[2, n_asked] = p.foot_z + h * p.ez
            n_asked += 1
            asked[0, n_asked] = p.foot_x + h * p.fx
            asked[1, n_asked] = p.foot_y + h * p.fy
            asked[2, n_asked] = p.foot_z + h * p.fz
        else:
            s = p.factor * p.taken if p.state in (DESCENDING, STEPPING) else 0.0
            asked[0, n_asked] = p.foot_x + s * p.gx
            asked[1, n_asked] = p.foot_y + s * p.gy
            asked[2, n_asked] = p.foot_z + s * p.gz
        n_asked += 1
    return waiting[:n_waiting].copy(), asked[:, :n_asked].copy()


@njit_cached
def _resume(p, jets, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Resume a point with the jets from column k on, up to the next evaluation; the number of columns used."""
    if p.state == AT_DIFFERENCES:
        _step_to_foot(p, jets, k)
        return 2
    if p.state in (DESCENDING, STEPPING):
        if p.state == DESCENDING and np.abs(jets[0, k]) > np.abs(p.value):
            p.taken *= 0.5
            p.halvings += 1
            if p.halvings == MAX_HALVINGS:
                p.state = STEPPING
            return 1
        s = p.factor * p.taken
        p.foot_x, p.foot_y, p.foot_z = p.foot_x + s * p.gx, p.foot_y + s * p.gy, p.foot_z + s * p.gz
    p.value, p.gx, p.gy, p.gz = jets[0, k], jets[1, k], jets[2, k], jets[3, k]
    if p.state == AT_END:
        _end_search(p)
    elif p.state == STARTED:
        if p.steps == 0 and p.restarts == 0:
            p.solid = 1 if p.value < 0.0 else 0
        _plan_descent(p)
    elif p.state in (DESCENDING, STEPPING) and p.length * p.taken > DESCENT_TOL * p.unit:
        _plan_descent(p)
    else:
        _choose_tangents(p)
    return 1


@njit_cached
def _plan_descent(p):  # type: ignore[no-untyped-def]  # pragma: no cover
    """A step of Newton's method for f = 0 along the gradient, or the move of a start off a critical point."""
    if p.steps == MAX_DESCENT_STEPS:
        _choose_tangents(p)
        return
    square = p.gx * p.gx + p.gy * p.gy + p.gz * p.gz
    limit = MIN_GRADIENT * p.value
    p.steps += 1
    if p.steps == 1 and square * p.unit * p.unit <= limit * limit:
        p.foot_x += OFF_CRITICAL_POINT[0] * p.unit
        p.foot_y += OFF_CRITICAL_POINT[1] * p.unit
        p.foot_z += OFF_CRITICAL_POINT[2] * p.unit
        return
    size = np.sqrt(square) if square > 0.0 else 1.0
    p.length = min(np.abs(p.value) / size, p.longest)
    p.factor = -np.sign(p.value) * p.length / size if square > 0.0 else 0.0
    p.taken, p.halvings = 1.0, 0
    p.state = DESCENDING


@njit_cached
def _choose_tangents(p):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Two unit vectors orthogonal to the gradient and to each other (Duff et al., "Building an orthonormal basis", 2017)."""
    if p.state != AT_FOOT:
        p.steps = 0
    size = np.sqrt(p.gx * p.gx + p.gy * p.gy + p.gz * p.gz)
    size = size if size > 0.0 else 1.0
    nx, ny, nz = p.gx / size, p.gy / size, p.gz / size
    sign = -1.0 if nz < 0.0 else 1.0
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    p.ex, p.ey, p.ez = 1.0 + sign * nx * nx * a, sign * b, -sign * nx
    p.fx, p.fy, p.fz = b, sign + ny * ny * a, -ny
    p.state = AT_DIFFERENCES


@njit_cached
def _step_to_foot(p, jets, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """One step to the level set along the normal, and one in the tangent plane for the least distance.

    The second fundamental form comes from the differences of the gradient at the columns k and k + 1 of the jets.
    """
    size = np.sqrt(p.gx * p.gx + p.gy * p.gy + p.gz * p.gz)
    size = size if size > 0.0 else 1.0
    nx, ny, nz = p.gx / size, p.gy / size, p.gz / size
    rx, ry, rz = p.x - p.foot_x, p.y - p.foot_y, p.z - p.foot_z
    d = rx * nx + ry * ny + rz * nz
    h = DIFFERENCE_STEP * p.unit
    ux, uy, uz = (jets[1, k] - p.gx) / h, (jets[2, k] - p.gy) / h, (jets[3, k] - p.gz) / h
    vx, vy, vz = (jets[1, k + 1] - p.gx) / h, (jets[2, k + 1] - p.gy) / h, (jets[3, k + 1] - p.gz) / h
    ratio = d / size
    a = 1.0 + ratio * (ux * p.ex + uy * p.ey + uz * p.ez)
    c = 1.0 + ratio * (vx * p.fx + vy * p.fy + vz * p.fz)
    b = 0.5 * ratio * ((ux * p.fx + uy * p.fy + uz * p.fz) + (vx * p.ex + vy * p.ey + vz * p.ez))
    se, sf = _solve_absolute(
        a, b, c, rx * p.ex + ry * p.ey + rz * p.ez, rx * p.fx + ry * p.fy + rz * p.fz
    )  # fmt: skip
    length = np.sqrt(se * se + sf * sf)
    limit = min(p.longest, np.abs(d) + DESCENT_TOL * p.unit)
    shorten = min(1.0, limit / length) if length > 0.0 else 1.0
    se, sf = shorten * se, shorten * sf
    normal_step = min(max(-p.value / size, -p.longest), p.longest)
    p.foot_x += se * p.ex + sf * p.fx + normal_step * nx
    p.foot_y += se * p.ey + sf * p.fy + normal_step * ny
    p.foot_z += se * p.ez + sf * p.fz + normal_step * nz
    moved = shorten * length + np.abs(normal_step)
    p.steps += 1
    p.state = AT_FOOT if moved > FOOT_TOL * p.unit and p.steps < MAX_FOOT_STEPS else AT_END


@njit_cached
def _solve_absolute(a, b, c, p, q):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Solution of |M| s = (p, q) for symmetric M = [[a, b], [b, c]], eigenvalues by absolute value and bounded from below."""
    mean, half = 0.5 * (a + c), 0.5 * (a - c)
    radius = np.sqrt(half * half + b * b)
    high, low = mean + radius, mean - radius
    # unit eigenvector of the larger eigenvalue
    vx = half + radius if half >= 0.0 else b
    vy = b if half >= 0.0 else radius - half
    size = np.sqrt(vx * vx + vy * vy)
    vx, vy = (vx / size, vy / size) if size > 0.0 else (1.0, 0.0)
    high = max(np.abs(high), MIN_CURVATURE_FACTOR)
    low = max(np.abs(low), MIN_CURVATURE_FACTOR)
    s, t = (vx * p + vy * q) / high, (vx * q - vy * p) / low
    return vx * s - vy * t, vy * s + vx * t


@njit_cached
def _end_search(p):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The distance and the normal from the final foot point, or another start if it is not on the level set."""
    size = np.sqrt(p.gx * p.gx + p.gy * p.gy + p.gz * p.gz)
    is_on_level_set = np.abs(p.value) <= LEVEL_SET_TOL * p.unit * size
    if not is_on_level_set and p.restarts < MAX_RESTARTS:
        p.restarts += 1
        p.steps = 0
        p.foot_x = p.x + RESTART_SHIFT[p.restarts % 3] * p.restarts * p.unit
        p.foot_y = p.y + RESTART_SHIFT[(1 + p.restarts) % 3] * p.restarts * p.unit
        p.foot_z = p.z + RESTART_SHIFT[(2 + p.restarts) % 3] * p.restarts * p.unit
        p.state = STARTED
        return
    p.state = FOUND
    sign = -1.0 if p.solid else 1.0
    if not is_on_level_set:
        p.distance, p.nx, p.ny, p.nz = sign * p.unit, 0.0, 0.0, 0.0
        return
    size = size if size > 0.0 else 1.0
    nx, ny, nz = p.gx / size, p.gy / size, p.gz / size
    rx, ry, rz = p.x - p.foot_x, p.y - p.foot_y, p.z - p.foot_z
    along = rx * nx + ry * ny + rz * nz
    distance = np.sqrt(rx * rx + ry * ry + rz * rz)
    # on the level set the normal is exact; farther off the ray is, should the foot point have been found to few digits only
    is_regular = np.abs(along) >= (1.0 - 1e-9) * distance and (along < 0.0) == (sign < 0.0)
    if is_regular or distance <= DESCENT_TOL * p.unit:
        p.distance, p.nx, p.ny, p.nz = along, nx, ny, nz
    else:
        p.distance = sign * distance
        p.nx, p.ny, p.nz = sign * rx / distance, sign * ry / distance, sign * rz / distance
