"""Necks of a field: its saddle points, and the width of the solid or void there.

Where a phase is narrowest, f has a saddle point. In the solid, f < 0, the Hessian then has positive eigenvalues across the neck:
two in a strut, one in a wall; in the void the signs are reversed. The width of the neck is twice the distance from the saddle to
the surface {f = 0}.
"""

from __future__ import annotations

from dataclasses import dataclass

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


def find_saddles(
    field: Field, grid: SampleGrid, where: BoolArray, closest: float, samples: tuple[Array, Array] | None = None
) -> Saddles:
    """Saddle points near grid cells with a corner in the mask `where` (nx, ny, nz) whose neck may be narrower than 2 * `closest`.

    `samples`: values (nx, ny, nz) and gradients (nx, ny, nz, 3) on the grid, if they are known already.
    Newton's method starts from the center of every cell over which each component of the gradient changes sign and f comes near
    enough to 0 for such a neck. A neck is kept if |f| <= k closest^2 / 2 with the curvature k across it, the quadratic estimate
    of its half width.
    """
    value, gradient = field.value_and_gradient_on_grid(*grid.axes) if samples is None else samples
    cells = _any_corner(where)
    for axis in range(3):
        cells &= _any_corner(gradient[..., axis] >= 0) & _any_corner(gradient[..., axis] <= 0)
    chosen = np.argwhere(cells)
    chosen = chosen[_may_hold_neck(value, gradient, chosen, grid.spacing, closest)]
    start = chosen + 0.5
    low, spacing = np.array(grid.low), grid.spacing
    points, converged = _find_critical_points(field, low + start * spacing, spacing)
    inside = np.all((points >= low - 1e-9 * spacing) & (points <= np.array(grid.high) + 1e-9 * spacing), axis=1)
    near = np.all(np.abs(points - (low + start * spacing)) <= 1.5 * spacing, axis=1)
    points = np.clip(points[converged & inside & near], low, np.array(grid.high))
    _, first = np.unique(np.round((points - low) / (spacing * COINCIDENCE_TOL_SPACINGS)), axis=0, return_index=True)
    points = points[np.sort(first)]
    if len(points) == 0:
        return Saddles(points, np.zeros(0))
    values, eigenvalues = field(points), np.linalg.eigvalsh(_difference_hessian(field, points, spacing))
    saddle = (eigenvalues[:, 0] < 0) & (eigenvalues[:, 2] > 0)
    across = np.where(values < 0, eigenvalues[:, 2], -eigenvalues[:, 0])
    narrow = np.abs(values) <= across * closest**2 / 2
    return Saddles(points[saddle & narrow], values[saddle & narrow])


def _may_hold_neck(value: Array, gradient: Array, cells: IntArray, spacing: Array, closest: float) -> BoolArray:
    """Whether |f| at a neck in a cell (n, 3) can be as small as k closest^2 / 2, from values and gradients at its corners.

    This spares the creases of distance fields, where the gradient jumps far from {f = 0} and Newton's method does not converge.
    """
    corners = cells[:, None] + np.argwhere(np.ones((2, 2, 2)))
    at = tuple(np.moveaxis(corners, -1, 0))
    least, slopes = np.abs(value[at]).min(axis=1), gradient[at]
    change = np.linalg.norm(slopes, axis=2).max(axis=1) * np.linalg.norm(spacing)
    curvature = np.ptp(slopes, axis=1).max(axis=1) / spacing.min()
    return np.asarray(least <= REACH_FACTOR * (change + curvature * closest**2 / 2))


def _find_critical_points(field: Field, points: Array, spacing: Array) -> tuple[Array, BoolArray]:
    """Critical points by Newton's method with clipped steps from points (n, 3), and whether each has converged (n,)."""
    converged = np.zeros(len(points), bool)
    for _ in range(MAX_NEWTON_STEPS):
        if len(points) == 0:
            break
        gradient, hessian = field.gradient(points), _difference_hessian(field, points, spacing)
        step = -np.einsum("nij,nj->ni", np.linalg.pinv(hessian, hermitian=True), gradient)
        step = np.clip(step, -0.5 * spacing, 0.5 * spacing)
        points = points + step
        converged = np.all(np.abs(step) <= NEWTON_TOL_SPACINGS * spacing, axis=1)
    return points, converged


def _difference_hessian(field: Field, points: Array, spacing: Array) -> Array:
    """Symmetric Hessians (n, 3, 3) by central differences of the exact gradient."""
    rows = []
    for axis in range(3):
        move = np.zeros(3)
        move[axis] = DIFFERENCE_STEP_SPACINGS * spacing[axis]
        rows.append((field.gradient(points + move) - field.gradient(points - move)) / (2 * move[axis]))
    full = np.stack(rows, axis=1)
    return (full + np.swapaxes(full, 1, 2)) / 2


def _any_corner(mask: BoolArray) -> BoolArray:
    """Cells (nx - 1, ny - 1, nz - 1) of which any corner is in a mask (nx, ny, nz)."""
    for axis in range(3):
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
