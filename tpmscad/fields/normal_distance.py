"""Signed distance to a level set, and walls of constant or graded thickness round it.

The foot point F of a point X on the level set {phi = 0} satisfies phi(F) = 0 and (X - F) parallel to grad phi(F); the distance is
|X - F|, with the sign of phi, and its gradient is the unit normal at F. Foot points are found in two stages, of which every step
is elementwise, so that the value of a point does not depend on the other points of the call:

1. steps of Newton's method for phi = 0 along the gradient, halved while |phi| does not fall;
2. Newton's method for the foot point: one step to the level set along the normal, and one step in the tangent plane for the
   least distance, with the second fundamental form from differences of the gradient. A form with eigenvalues that are not
   positive, beyond the centres of curvature, is replaced by its absolute value, so that the distance decreases.

Near the level set this is the distance to it. Farther off than the radii of curvature it is the distance to one of the foot
points, not necessarily the nearest, and jumps where that changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.fields.evaluation import FieldJet, Triple, stack_points
from tpmscad.fields.field import Field, FieldLike, as_field
from tpmscad.fields.thresholds import sheet
from tpmscad.public_calls import public

MAX_DESCENT_STEPS = 60
MAX_HALVINGS = 12
"""Newton steps along the gradient, and halvings of one step."""

MAX_FOOT_STEPS = 40
"""Newton steps of the foot point; six are enough from within half the radius of curvature."""

STEPS_PER_PERIOD = 24.0
"""The longest step of a periodic field is its least period over this number."""

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


@dataclass(frozen=True, slots=True)
class NormalDistance(Field):
    """Signed distance to {field = 0} along its normal."""

    field: Field

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        return self.jet(x, y, z)[0]

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        points, shape = stack_points(x, y, z)
        columns = [points[:, axis].copy() for axis in range(3)]
        value, *normal = signed_distances(self.field, *columns)
        nx, ny, nz = (each.reshape(shape) for each in normal)
        return value.reshape(shape), nx, ny, nz

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        return self.field.periods()


@public()
def normal_distance(phi: FieldLike) -> Field:
    """Return the signed distance to the level set of a field.

    Parameters
    ----------
    phi : Field, float or callable
        The field; its level set {phi = 0} is the reference.

    Returns
    -------
    Field
        The distance in model units, negative where phi is negative; its gradient is the unit normal at the foot point.

    Raises
    ------
    InvalidRequest
        If phi is not a field.

    Notes
    -----
    Exact up to the radii of curvature of the level set. Beyond them it is the distance to one of the foot points.

    Examples
    --------
    >>> from tpmscad import fields
    >>> ellipsoid = fields.from_function(lambda x, y, z: x**2 + y**2 + 4 * z**2 - 1)
    >>> round(float(fields.normal_distance(ellipsoid)((0.0, 0.0, 1.0))), 12)
    0.5
    """
    return NormalDistance(as_field(phi))


@public()
def wall(phi: FieldLike, thickness: FieldLike) -> Field:
    """Return the wall of a thickness round the level set of a field.

    Parameters
    ----------
    phi : Field, float or callable
        The field, for example `fields.tpms("lidinoid")`; the wall is centred on {phi = 0}.
    thickness : Field, float or callable
        Thickness along the normal, model units. A field grades the wall: a point is solid if it is nearer to {phi = 0} than half
        the thickness there.

    Returns
    -------
    Field
        max(d - thickness / 2, -d - thickness / 2) with the signed distance d.

    Raises
    ------
    InvalidRequest
        If a constant thickness is not positive.

    Notes
    -----
    A wall is smooth as long as half its thickness stays below the radii of curvature of {phi = 0}; beyond them its sides have
    edges, at which `tpmscad.solidify` stops with the place.

    Examples
    --------
    >>> from tpmscad import fields
    >>> wall = fields.wall(fields.tpms("lidinoid", 10.0), 0.4)
    >>> bool(wall((0.0, 0.0, 0.0)) > 0)
    True
    """
    half = 0.5 * as_field(thickness)
    return sheet(NormalDistance(as_field(phi)), -half, half)


def signed_distances(field: Field, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array, Array]:
    """Signed distance (n,) of points from the level set and the normals' components (n,) at their foot points."""
    unit, longest = _length_scale(field, x, y, z)
    solid = field.at(x, y, z) < 0
    solid = np.broadcast_to(solid, x.shape)
    foot = _find_foot(field, (x, y, z), (x, y, z), unit, longest)
    for attempt in range(1, MAX_RESTARTS + 1):
        lost = np.flatnonzero(~_is_on_level_set(field, foot, unit))
        if not len(lost):
            break
        points = x[lost], y[lost], z[lost]
        shift = [RESTART_SHIFT[(axis + attempt) % 3] * attempt * unit[lost] for axis in range(3)]
        start = tuple(c + step for c, step in zip(points, shift, strict=True))
        again = _find_foot(field, points, start, unit[lost], longest[lost])  # type: ignore[arg-type]
        for c, found in zip(foot, again, strict=True):
            c[lost] = found
    found = _is_on_level_set(field, foot, unit)
    _, gx, gy, gz = _jet(field, *foot)
    size = np.sqrt(gx * gx + gy * gy + gz * gz)
    size = np.where(size > 0, size, 1.0)
    nx, ny, nz = gx / size, gy / size, gz / size
    rx, ry, rz = x - foot[0], y - foot[1], z - foot[2]
    along = rx * nx + ry * ny + rz * nz
    distance = np.sqrt(rx * rx + ry * ry + rz * rz)
    sign = np.where(solid, -1.0, 1.0)
    # on the level set the normal is exact; farther off the ray is, should the foot point have been found to few digits only
    regular = (np.abs(along) >= (1 - 1e-9) * distance) & ((along < 0) == solid)
    near = distance <= DESCENT_TOL * unit
    value = np.where(regular | near, along, sign * distance)
    ray = sign / np.where(distance > 0, distance, 1.0)
    use_normal = regular | near
    slope = [np.where(use_normal, n, ray * r) for n, r in ((nx, rx), (ny, ry), (nz, rz))]
    value = np.where(found, value, sign * unit)
    nx, ny, nz = (np.where(found, each, 0.0) for each in slope)
    return value, nx, ny, nz


def _find_foot(
    field: Field,
    points: tuple[Array, Array, Array],
    start: tuple[Array, Array, Array],
    unit: Array,
    longest: Array,
) -> tuple[Array, Array, Array]:
    """Foot points of points by both stages, the first of which begins at `start`."""
    return _improve_foot(field, points, _descend(field, start, unit, longest), unit, longest)


def _is_on_level_set(field: Field, foot: tuple[Array, Array, Array], unit: Array) -> BoolArray:
    """Whether foot points (n,) lie on the level set, and not where a descent ended between two of its parts."""
    value, gx, gy, gz = _jet(field, *foot)
    return np.asarray(np.abs(value) <= LEVEL_SET_TOL * unit * np.sqrt(gx * gx + gy * gy + gz * gz))


def _length_scale(field: Field, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """The unit of length (n,) at each point and the longest step (n,): from the periods, or from the coordinates."""
    periods = field.periods()
    if periods is not None and min(periods) > 0:
        return np.full(x.shape, min(periods)), np.full(x.shape, min(periods) / STEPS_PER_PERIOD)
    return 1.0 + np.maximum(np.maximum(np.abs(x), np.abs(y)), np.abs(z)), np.full(x.shape, np.inf)


def _jet(field: Field, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array, Array]:
    """Value and derivatives as arrays of the points' shape."""
    value, gx, gy, gz = field.jet(x, y, z)
    return tuple(np.broadcast_to(each, x.shape) for each in (value, gx, gy, gz))  # type: ignore[return-value]


def _descend(
    field: Field, points: tuple[Array, Array, Array], unit: Array, longest: Array
) -> tuple[Array, Array, Array]:
    """Points near the level set, reached along the gradient."""
    foot = [c.copy() for c in points]
    active = np.arange(len(foot[0]))
    for step_number in range(MAX_DESCENT_STEPS):
        if not len(active):
            break
        x, y, z = (c[active] for c in foot)
        u = unit[active]
        value, gx, gy, gz = _jet(field, x, y, z)
        square = gx * gx + gy * gy + gz * gz
        critical = square * u * u <= (MIN_GRADIENT * value) ** 2
        if critical.any() and step_number == 0:
            moved = active[critical]
            for axis in range(3):
                foot[axis][moved] += OFF_CRITICAL_POINT[axis] * unit[moved]
            continue
        size = np.sqrt(np.where(square > 0, square, 1.0))
        length = np.minimum(np.abs(value) / size, longest[active])
        factor = np.where(square > 0, -np.sign(value) * length / size, 0.0)
        taken = np.ones(len(active))
        waiting = np.arange(len(active))
        for _ in range(MAX_HALVINGS):
            s = factor[waiting] * taken[waiting]
            trial = field.at(x[waiting] + s * gx[waiting], y[waiting] + s * gy[waiting], z[waiting] + s * gz[waiting])
            worse = np.abs(trial) > np.abs(value[waiting])
            waiting = waiting[worse]
            if not len(waiting):
                break
            taken[waiting] *= 0.5
        for axis, g in enumerate((gx, gy, gz)):
            foot[axis][active] += factor * taken * g
        active = active[length * taken > DESCENT_TOL * u]
    return foot[0], foot[1], foot[2]


def _improve_foot(
    field: Field,
    points: tuple[Array, Array, Array],
    foot: tuple[Array, Array, Array],
    unit: Array,
    longest: Array,
) -> tuple[Array, Array, Array]:
    """Foot points of the points, from starts near the level set."""
    result = [c.copy() for c in foot]
    active = np.arange(len(result[0]))
    for _ in range(MAX_FOOT_STEPS):
        if not len(active):
            break
        x, y, z = (c[active] for c in result)
        u = unit[active]
        value, gx, gy, gz = _jet(field, x, y, z)
        size = np.sqrt(gx * gx + gy * gy + gz * gz)
        size = np.where(size > 0, size, 1.0)
        nx, ny, nz = gx / size, gy / size, gz / size
        rx, ry, rz = points[0][active] - x, points[1][active] - y, points[2][active] - z
        d = rx * nx + ry * ny + rz * nz
        e, f = _tangent_basis(nx, ny, nz)
        h = DIFFERENCE_STEP * u
        columns = []
        for t in (e, f):
            _, hx, hy, hz = _jet(field, x + h * t[0], y + h * t[1], z + h * t[2])
            columns.append(((hx - gx) / h, (hy - gy) / h, (hz - gz) / h))
        ratio = d / size
        a = 1 + ratio * (columns[0][0] * e[0] + columns[0][1] * e[1] + columns[0][2] * e[2])
        c = 1 + ratio * (columns[1][0] * f[0] + columns[1][1] * f[1] + columns[1][2] * f[2])
        b = 0.5 * ratio * (
            (columns[0][0] * f[0] + columns[0][1] * f[1] + columns[0][2] * f[2])
            + (columns[1][0] * e[0] + columns[1][1] * e[1] + columns[1][2] * e[2])
        )  # fmt: skip
        te, tf = rx * e[0] + ry * e[1] + rz * e[2], rx * f[0] + ry * f[1] + rz * f[2]
        se, sf = _solve_absolute(a, b, c, te, tf)
        length = np.sqrt(se * se + sf * sf)
        limit = np.minimum(longest[active], np.abs(d) + DESCENT_TOL * u)
        shorten = np.minimum(1.0, limit / np.where(length > 0, length, 1.0))
        se, sf = shorten * se, shorten * sf
        normal_step = -value / size
        normal_step = np.clip(normal_step, -longest[active], longest[active])
        for axis, (te_, tf_, n_) in enumerate(zip(e, f, (nx, ny, nz), strict=True)):
            result[axis][active] += se * te_ + sf * tf_ + normal_step * n_
        moved = shorten * length + np.abs(normal_step)
        active = active[moved > FOOT_TOL * u]
    return result[0], result[1], result[2]


def _tangent_basis(nx: Array, ny: Array, nz: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Two unit vectors orthogonal to unit normals and to each other (Duff et al., "Building an orthonormal basis", 2017)."""
    sign = np.where(nz < 0, -1.0, 1.0)
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    return (1.0 + sign * nx * nx * a, sign * b, -sign * nx), (b, sign + ny * ny * a, -ny)


def _solve_absolute(a: Array, b: Array, c: Array, p: Array, q: Array) -> tuple[Array, Array]:
    """Solutions of |M| s = (p, q) for symmetric M = [[a, b], [b, c]], eigenvalues by absolute value and bounded from below."""
    mean, half = 0.5 * (a + c), 0.5 * (a - c)
    radius = np.sqrt(half * half + b * b)
    high, low = mean + radius, mean - radius
    # unit eigenvector of the larger eigenvalue
    vx = np.where(half >= 0, half + radius, b)
    vy = np.where(half >= 0, b, radius - half)
    size = np.sqrt(vx * vx + vy * vy)
    vx, vy = np.where(size > 0, vx, 1.0), np.where(size > 0, vy, 0.0)
    size = np.where(size > 0, size, 1.0)
    vx, vy = vx / size, vy / size
    high = np.maximum(np.abs(high), MIN_CURVATURE_FACTOR)
    low = np.maximum(np.abs(low), MIN_CURVATURE_FACTOR)
    s, t = (vx * p + vy * q) / high, (vx * q - vy * p) / low
    return vx * s - vy * t, vy * s + vx * t
