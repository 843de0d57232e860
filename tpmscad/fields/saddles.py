"""Necks of a field: its saddles, and the width of the solid or void there.

Where a phase is narrowest, f has a saddle: of the solid, f < 0, with a positive second derivative across (a strut has two, a wall
one); of the void the same with signs turned. The width is twice the distance from the saddle to the surface {f = 0}.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.fields import Field
from tpmscad.fields.sample_grid import SampleGrid

MAX_NEWTON_STEPS = 12
DIFFERENCE_STEP_SPACINGS = 1e-4
"""Step of the differences of exact gradients that make the Hessian, in parts of the grid's spacing times ten thousandth."""

NEWTON_TOL_SPACINGS = 1e-6
"""Movement of the last Newton step, in spacings, by which a point counts as critical."""

COINCIDENCE_TOL_SPACINGS = 1e-2
"""Distance, in spacings, within which two points are one."""

RAY_DIRECTIONS = 96
SAMPLES_PER_RAY = 24
CONE_HALF_ANGLES_RAD = (0.25, 0.08, 0.025)
"""Half angles (rad) of the rounds of directions around the nearest one found: the distance is then good to 1e-3 of itself."""


@dataclass(frozen=True, slots=True)
class Neck:
    """A saddle: its position, the phase that is narrow there, its width in model units (inf: wider than was looked for)."""

    position: tuple[float, float, float]
    phase: str
    width: float


@dataclass(frozen=True, slots=True, eq=False)
class Saddles:
    """Saddles of a field: points (n, 3), values (n,)."""

    points: Array
    values: Array

    def __len__(self) -> int:
        return len(self.values)


def find_saddles(field: Field, grid: SampleGrid, where: BoolArray, closest: float) -> Saddles:
    """Saddles near the cells of the grid that have a corner in the mask, if the phase may be narrower than `closest` there.

    By Newton's method from every cell over which each component of the gradient changes sign.
    """
    _, slope = field.value_and_gradient_on_grid(*grid.axes)
    cells = _any_corner(where)
    for axis in range(3):
        cells &= _any_corner(slope[..., axis] >= 0) & _any_corner(slope[..., axis] <= 0)
    start = np.argwhere(cells) + 0.5
    low, spacing = np.array(grid.low), grid.spacing
    points, settled = _find_critical_points(field, low + start * spacing, spacing)
    inside = np.all((points >= low - 1e-9 * spacing) & (points <= np.array(grid.high) + 1e-9 * spacing), axis=1)
    near = np.all(np.abs(points - (low + start * spacing)) <= 1.5 * spacing, axis=1)
    points = np.clip(points[settled & inside & near], low, np.array(grid.high))
    _, once = np.unique(np.round((points - low) / (spacing * COINCIDENCE_TOL_SPACINGS)), axis=0, return_index=True)
    points = points[np.sort(once)]
    if len(points) == 0:
        return Saddles(points, np.zeros(0))
    values, bend = field(points), np.linalg.eigvalsh(_difference_hessian(field, points, spacing))
    saddle = (bend[:, 0] < 0) & (bend[:, 2] > 0)
    across = np.where(values < 0, bend[:, 2], -bend[:, 0])
    narrow = np.abs(values) <= across * closest**2 / 2
    return Saddles(points[saddle & narrow], values[saddle & narrow])


def _find_critical_points(field: Field, points: Array, spacing: Array) -> tuple[Array, BoolArray]:
    settled = np.zeros(len(points), bool)
    for _ in range(MAX_NEWTON_STEPS):
        if len(points) == 0:
            break
        gradient, hessian = field.gradient(points), _difference_hessian(field, points, spacing)
        step = -np.einsum("nij,nj->ni", np.linalg.pinv(hessian, hermitian=True), gradient)
        step = np.clip(step, -0.5 * spacing, 0.5 * spacing)
        points = points + step
        settled = np.all(np.abs(step) <= NEWTON_TOL_SPACINGS * spacing, axis=1)
    return points, settled


def _difference_hessian(field: Field, points: Array, spacing: Array) -> Array:
    """Second derivatives (n, 3, 3) by central differences of the exact gradient."""
    rows = []
    for axis in range(3):
        move = np.zeros(3)
        move[axis] = DIFFERENCE_STEP_SPACINGS * spacing[axis]
        rows.append((field.gradient(points + move) - field.gradient(points - move)) / (2 * move[axis]))
    full = np.stack(rows, axis=1)
    return (full + np.swapaxes(full, 1, 2)) / 2


def _any_corner(mask: BoolArray) -> BoolArray:
    for axis in range(3):
        mask = np.take(mask, range(mask.shape[axis] - 1), axis) | np.take(mask, range(1, mask.shape[axis]), axis)
    return mask


def measure_neck_widths(field: Field, found: Saddles, grid: SampleGrid, farthest: float) -> tuple[Array, Array]:
    """Twice the distance of saddles to the surface in the domain (n,), inf beyond `farthest`, and the way there (n, 3)."""
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
    """The first change of sign along any of the directions (n, d, 3), by linear interpolation between radii."""
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
    """Unit vectors spread over the sphere (a Fibonacci spiral): (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=-1)
