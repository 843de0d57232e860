"""Necks of a field: its saddle points, and the width of the solid or void there.

Where a phase is narrowest, f has a saddle point. In the solid, f < 0, the Hessian then has positive eigenvalues across the neck:
two in a strut, one in a wall; in the void the signs are reversed. The width of the neck is twice the distance from the saddle to
the surface {f = 0}.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields import Field
from tpmscad.fields.sample_grid import SampleGrid

MAX_NEWTON_STEPS = 12
"""Steps of Newton's method for a critical point, each at most half a grid spacing."""

DIFFERENCE_STEP_SPACINGS = 1e-4
"""Step of the central differences of exact gradients for the Hessian, in grid spacings."""

NEWTON_TOL_SPACINGS = 1e-6
"""Length of the last Newton step, in grid spacings, below which a point is a critical point."""

COINCIDENCE_TOL_SPACINGS = 1e-2
"""Distance, in grid spacings, within which two critical points are the same."""

MAX_TRAVEL_SPACINGS = 1.5
"""Distance from its start along each axis, in grid spacings, at which a search is given up: the point has another start."""

MIN_DETERMINANT = 1e-9
"""Determinant, relative to the cube of the greatest entry, below which a Hessian counts as singular."""

REACH_FACTOR = 2.0
"""Safety of the estimates, from a cell's corners, of how far f changes within the cell and of its curvature there."""

RAY_DIRECTIONS = 96
"""Directions in which the surface is searched from a saddle point."""

SAMPLES_PER_RAY = 24
"""Samples of the field along a ray."""

CONE_HALF_ANGLES_RAD = (0.25, 0.08, 0.025)
"""Half angles of the cones of directions that refine the shortest ray; the distance is then accurate to 1e-3 of itself."""


@dataclass(frozen=True, slots=True)
class Neck:
    """A narrow place: the saddle's position, the narrow phase ("solid" or "void"), and its width in model units.

    The width is inf if it exceeds the search distance.
    """

    position: tuple[float, float, float]
    phase: str
    width: float


@dataclass(frozen=True, slots=True, eq=False)
class Saddles:
    """Saddle points of a field: `points` (n, 3), `values` (n,)."""

    points: Array
    values: Array

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True, slots=True, eq=False)
class CriticalPoints:
    """Points at which the derivatives of f along some axes are zero: `points` (n, 3), `values` (n,).

    `across` (n,) is the greatest curvature by which f tends to 0 away from the point: the quadratic estimate of the half width of
    what is narrow there is sqrt(2 |f| / across). `is_saddle` (n,): f rises along one direction and falls along another.
    """

    points: Array
    values: Array
    across: Array
    is_saddle: BoolArray


def find_saddles(
    field: Field, grid: SampleGrid, where: BoolArray, closest: float, samples: tuple[Array, Array] | None = None
) -> Saddles:
    """Saddle points near grid cells with a corner in the mask `where` (nx, ny, nz) whose neck may be narrower than 2 * `closest`.

    `samples`: values (nx, ny, nz) and gradients (nx, ny, nz, 3) on the grid, if they are known already.
    Newton's method starts from the center of every cell over which each component of the gradient changes sign and f comes near
    enough to 0 for such a neck. A neck is kept if |f| <= k closest^2 / 2 with the curvature k across it, the quadratic estimate
    of its half width.
    """
    samples = field.value_and_gradient_on_grid(*grid.axes) if samples is None else samples
    found = _find_on_stratum(field, grid, (None, None, None), where, closest, samples)
    return Saddles(found.points[found.is_saddle], found.values[found.is_saddle])


def find_narrow_points(field: Field, grid: SampleGrid, closest: float, samples: tuple[Array, Array]) -> Array:
    """Critical points (n, 3) at which solid or void may be narrower than 2 * `closest`, in the box and on its faces and edges.

    On a face or an edge they are those of the field's restriction: as a level passes their values, the part of the solid in the
    box changes its topology there, though the field itself has no critical point (stratified Morse theory). Besides saddles they
    include minima of the solid and maxima of the void, which are specks.
    """
    everywhere = np.ones(grid.shape, bool)
    return np.concatenate(
        [
            _find_on_stratum(field, grid, sides, everywhere, closest, samples).points
            for sides in product((None, 0, -1), repeat=3)
            if None in sides
        ]
    )


def _find_on_stratum(
    field: Field,
    grid: SampleGrid,
    sides: Sequence[int | None],
    where: BoolArray,
    closest: float,
    samples: tuple[Array, Array],
) -> CriticalPoints:
    """Critical points of the field's restriction to the box, a face or an edge, at which something may be that narrow.

    `sides` are the grid planes 0 or -1 of the axes that are fixed, None for those that are free.
    """
    plane = tuple(slice(None) if side is None else side for side in sides)
    free = [axis for axis, side in enumerate(sides) if side is None]
    value, gradient = samples[0][plane], samples[1][plane][..., free]
    low, high, spacing = np.array(grid.low), np.array(grid.high), grid.spacing
    cells = _any_corner(where[plane])
    for k in range(len(free)):
        cells &= _any_corner(gradient[..., k] >= 0) & _any_corner(gradient[..., k] <= 0)
    chosen = np.argwhere(cells)
    chosen = chosen[_may_hold_neck(value, gradient, chosen, spacing[free], closest)]
    start = np.tile([low[axis] if side == 0 else high[axis] for axis, side in enumerate(sides)], (len(chosen), 1))
    start[:, free] = low[free] + (chosen + 0.5) * spacing[free]
    points = _find_critical_points(field, start, spacing, free)
    points = points[np.all((points >= low - 1e-9 * spacing) & (points <= high + 1e-9 * spacing), axis=1)]
    points = np.clip(points, low, high)
    _, first = np.unique(np.round((points - low) / (spacing * COINCIDENCE_TOL_SPACINGS)), axis=0, return_index=True)
    points = points[np.sort(first)]
    if len(points) == 0:
        return CriticalPoints(points, np.zeros(0), np.zeros(0), np.zeros(0, bool))
    values = field(points)
    eigenvalues = np.linalg.eigvalsh(_difference_hessian(field, points, spacing, free)[:, free][:, :, free])
    across = np.where(values < 0, eigenvalues[:, -1], -eigenvalues[:, 0])
    narrow = np.abs(values) <= across * closest**2 / 2
    is_saddle = (eigenvalues[:, 0] < 0) & (eigenvalues[:, -1] > 0)
    return CriticalPoints(points[narrow], values[narrow], across[narrow], is_saddle[narrow])


def _may_hold_neck(value: Array, gradient: Array, cells: IntArray, spacing: Array, closest: float) -> BoolArray:
    """Whether |f| at a neck in a cell (n, d) can be as small as k closest^2 / 2, from values and gradients at its corners.

    This spares the creases of distance fields, where the gradient jumps far from {f = 0} and Newton's method does not converge.
    """
    corners = cells[:, None] + np.argwhere(np.ones((2,) * cells.shape[1]))
    at = tuple(np.moveaxis(corners, -1, 0))
    least, slopes = np.abs(value[at]).min(axis=1), gradient[at]
    change = np.linalg.norm(slopes, axis=2).max(axis=1) * np.linalg.norm(spacing)
    curvature = np.ptp(slopes, axis=1).max(axis=1) / spacing.min()
    return np.asarray(least <= REACH_FACTOR * (change + curvature * closest**2 / 2))


def _find_critical_points(field: Field, start: Array, spacing: Array, free: Sequence[int] = (0, 1, 2)) -> Array:
    """Critical points along the free axes by Newton's method with clipped steps from points (n, 3): those that it finds near."""
    found = np.zeros(len(start), bool)
    active = np.arange(len(start))
    points = start.copy()
    for _ in range(MAX_NEWTON_STEPS):
        if len(active) == 0:
            break
        at = points[active]
        gradient = np.zeros(at.shape)
        gradient[:, free] = field.gradient(at)[:, free]
        step = -_solve_symmetric(_difference_hessian(field, at, spacing, free), gradient)
        step = np.clip(step, -0.5 * spacing, 0.5 * spacing)
        points[active] = at + step
        is_at_rest = np.all(np.abs(step) <= NEWTON_TOL_SPACINGS * spacing, axis=1)
        is_near = np.all(np.abs(points[active] - start[active]) <= MAX_TRAVEL_SPACINGS * spacing, axis=1)
        found[active[is_at_rest & is_near]] = True
        active = active[~is_at_rest & is_near]
    return points[found]


def _solve_symmetric(matrices: Array, right: Array) -> Array:
    """Solutions (n, 3) of symmetric systems (n, 3, 3): by the adjugate, and of least norm where a matrix is nearly singular."""
    a, b, c = matrices[:, 0], matrices[:, 1], matrices[:, 2]
    adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    determinant = np.einsum("ni,ni->n", a, adjugate[:, 0])
    scale = np.abs(matrices).max(axis=(1, 2)) ** 3
    is_regular = np.abs(determinant) > MIN_DETERMINANT * scale
    solution = np.einsum("nij,nj->ni", adjugate, right) / np.where(is_regular, determinant, 1.0)[:, None]
    others = np.flatnonzero(~is_regular)
    if len(others):
        solution[others] = np.einsum("nij,nj->ni", np.linalg.pinv(matrices[others], hermitian=True), right[others])
    return solution


def _difference_hessian(field: Field, points: Array, spacing: Array, free: Sequence[int] = (0, 1, 2)) -> Array:
    """Symmetric Hessians (n, 3, 3) by central differences of the exact gradient, with the unit matrix for axes that are fixed."""
    moves = np.zeros((2 * len(free), 1, 3))
    for k, axis in enumerate(free):
        moves[2 * k, 0, axis] = DIFFERENCE_STEP_SPACINGS * spacing[axis]
        moves[2 * k + 1, 0, axis] = -moves[2 * k, 0, axis]
    slopes = field.gradient(points + moves)
    hessian = np.tile(np.eye(3), (len(points), 1, 1))
    for k, axis in enumerate(free):
        row = (slopes[2 * k] - slopes[2 * k + 1]) / (2 * moves[2 * k, 0, axis])
        hessian[:, axis, free] = row[:, free]
    return (hessian + np.swapaxes(hessian, 1, 2)) / 2


def _any_corner(mask: BoolArray) -> BoolArray:
    """Cells of which any corner is in a mask, one fewer along each axis."""
    for axis in range(mask.ndim):
        mask = np.take(mask, range(mask.shape[axis] - 1), axis) | np.take(mask, range(1, mask.shape[axis]), axis)
    return mask


def measure_neck_widths(field: Field, found: Saddles, grid: SampleGrid, farthest: float) -> tuple[Array, Array]:
    """Twice the distance of saddles to the surface inside the grid (n,), inf beyond `farthest`, and its direction (n, 3)."""
    sign = np.where(found.values < 0, 1.0, -1.0)
    everywhere = np.broadcast_to(spread_directions(RAY_DIRECTIONS), (len(found), RAY_DIRECTIONS, 3))
    distance, direction = _cast_rays(field, found.points, sign, everywhere, grid, farthest)
    for angle in CONE_HALF_ANGLES_RAD:
        around = direction[:, None] + angle * spread_directions(RAY_DIRECTIONS // 3)
        around = np.concatenate([direction[:, None], around], axis=1)
        around /= np.linalg.norm(around, axis=2, keepdims=True)
        closer, turned = _cast_rays(field, found.points, sign, around, grid, farthest)
        better = closer < distance
        distance = np.where(better, closer, distance)
        direction = np.where(better[:, None], turned, direction)
    return 2 * distance, direction


def _cast_rays(
    field: Field, points: Array, sign: Array, directions: Array, grid: SampleGrid, farthest: float
) -> tuple[Array, Array]:
    """Shortest ray to a sign change over directions (n, d, 3), interpolated linearly between radii: distance and direction."""
    radii = np.linspace(0.0, farthest, SAMPLES_PER_RAY)
    rays = points[:, None, None] + directions[:, :, None] * radii[:, None]
    inside = np.all((rays >= np.array(grid.low)) & (rays <= np.array(grid.high)), axis=-1)
    value = np.where(inside, sign[:, None, None] * field(rays), -1.0)
    crossed = value[..., 1:] > 0
    first = np.argmax(crossed, axis=-1)
    before = np.take_along_axis(value, first[..., None], -1)[..., 0]
    after = np.take_along_axis(value, first[..., None] + 1, -1)[..., 0]
    part = before / np.where(after > before, before - after, -1.0)
    at = radii[first] + (radii[1] - radii[0]) * part
    distance = np.where(crossed.any(axis=-1), at, np.inf)
    best = np.argmin(distance, axis=1)
    rows = np.arange(len(points))
    return distance[rows, best], directions[rows, best]


def spread_directions(count: int) -> Array:
    """Unit vectors distributed over the sphere on a Fibonacci spiral: (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=-1)
