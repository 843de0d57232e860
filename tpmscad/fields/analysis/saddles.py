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

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields import Field
from tpmscad.fields.data.sample_grid import SampleGrid
from tpmscad.fields.tape.field_tape import SharedTape

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

PROJECTION_STEPS = 6
"""Steps of the projection onto the level set by which a crossing between the corners of a cell is found."""

SURFACE_TOL_SPACINGS = 1e-3
"""Distance from the level set, in grid spacings, at which a projected point counts as on it."""

POINTS_PER_SLAB = 1 << 17
"""Points of a grid that are evaluated and searched at a time: 4 MB of values and gradients."""

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

    @property
    def half_widths(self) -> Array:
        """The quadratic estimates (n,) of the half width of what is narrow."""
        return np.asarray(np.sqrt(2 * np.abs(self.values) / np.maximum(self.across, np.finfo(float).tiny)))


@dataclass(frozen=True, slots=True, eq=False)
class NarrowPoints:
    """Points (n, 3) at which solid or void is narrow, and the field's values on the grid on which they were found.

    `half_widths` (n,) are estimates of half the width of what is narrow; 0 if it is unknown.
    """

    points: Array
    half_widths: Array
    grid_values: Array


def find_saddles(field: Field, grid: SampleGrid, where: BoolArray, closest: float) -> Saddles:
    """Saddle points near grid cells with a corner in the mask `where` (nx, ny, nz) whose neck may be narrower than 2 * `closest`.

    Newton's method starts from the center of every cell over which each component of the gradient changes sign and f comes near
    enough to 0 for such a neck. A neck is kept if |f| <= k closest^2 / 2 with the curvature k across it, the quadratic estimate
    of its half width.
    """
    cells = _find_cells(field.value_and_gradient_on_grid(*grid.axes), where, grid.spacing, closest)
    found = _find_in_cells(field, grid, (None, None, None), cells, closest)
    return Saddles(found.points[found.is_saddle], found.values[found.is_saddle])


def find_narrow_points(fields: Sequence[Field], grid: SampleGrid, closest: float) -> list[NarrowPoints]:
    """Critical points at which solid or void may be narrower than 2 * `closest`, and values on the grid, of each field.

    The points lie in the box and on its faces and edges. On a face or an edge they are those of the field's restriction: as a
    level passes their values, the part of the solid in the box changes its topology there, though the field itself has no
    critical point (stratified Morse theory). Besides saddles they include minima of the solid and maxima of the void, which are
    specks. Where f has a kink in place of a minimum, as a distance has, which Newton's method does not find, a point of the
    level set stands for it. The fields are sampled together, so that what their formulas have in common is evaluated once.
    """
    tape = SharedTape(fields)
    x, y, z = grid.axes
    values = np.empty((len(fields), *grid.shape))
    cells: list[list[IntArray]] = [[] for _ in fields]
    planes = max(1, POINTS_PER_SLAB // (len(y) * len(z)))
    for first in range(0, len(x) - 1, planes):
        slab = slice(first, first + planes + 1)
        for k, samples in enumerate(tape.jets_on_grid(x[slab], y, z)):
            values[k, slab] = samples[0]
            found = _find_cells(samples, np.ones(samples[0].shape, bool), grid.spacing, closest)
            cells[k].append(found + np.array([first, 0, 0]))
    inside = (None, None, None)
    critical = [
        [_find_in_cells(f, grid, inside, np.concatenate(c), closest)] for f, c in zip(fields, cells, strict=True)
    ]
    for sides in product((None, 0, -1), repeat=3):
        if None in sides and sides != inside:
            axes = [axis if side is None else axis[[side]] for axis, side in zip(grid.axes, sides, strict=True)]
            for k, samples in enumerate(tape.jets_on_grid(*axes)):
                found = _find_cells(samples, np.ones(samples[0].shape, bool), grid.spacing, closest)
                critical[k].append(_find_in_cells(fields[k], grid, sides, found, closest))
    return [
        NarrowPoints(
            np.concatenate([each.points for each in parts]), np.concatenate([each.half_widths for each in parts]), v
        )
        for parts, v in zip(critical, values, strict=True)
    ]


def _find_in_cells(
    field: Field, grid: SampleGrid, sides: Sequence[int | None], cells: IntArray, closest: float
) -> CriticalPoints:
    """Critical points in grid cells (n, 3) of the field's restriction to the box, a face or an edge, where it may be that narrow.

    `sides` are the grid planes 0 or -1 of the axes that are fixed, None for those that are free.
    """
    free = [axis for axis, side in enumerate(sides) if side is None]
    low, high, spacing = np.array(grid.low, float), np.array(grid.high, float), grid.spacing
    start = np.tile([low[axis] if side == 0 else high[axis] for axis, side in enumerate(sides)], (len(cells), 1))
    start[:, free] = low[free] + (cells[:, free] + 0.5) * spacing[free]
    points = _find_critical_points(field, start, spacing, free)
    hidden = _find_hidden_crossings(field, start, spacing, free)
    points = points[np.all((points >= low - 1e-9 * spacing) & (points <= high + 1e-9 * spacing), axis=1)]
    points = np.clip(points, low, high)
    _, first = np.unique(np.round((points - low) / (spacing * COINCIDENCE_TOL_SPACINGS)), axis=0, return_index=True)
    points = points[np.sort(first)]
    values = field(points)
    eigenvalues = np.linalg.eigvalsh(_difference_hessian(field, points, spacing, free)[:, free][:, :, free])
    across = np.where(values < 0, eigenvalues[:, -1], -eigenvalues[:, 0])
    narrow = np.abs(values) <= across * closest**2 / 2
    is_saddle = (eigenvalues[:, 0] < 0) & (eigenvalues[:, -1] > 0)
    return CriticalPoints(
        np.concatenate([points[narrow], hidden]),
        np.concatenate([values[narrow], np.zeros(len(hidden))]),
        np.concatenate([across[narrow], np.full(len(hidden), np.inf)]),
        np.concatenate([is_saddle[narrow], np.zeros(len(hidden), bool)]),
    )


def _find_cells(samples: tuple[Array, Array], where: BoolArray, spacing: Array, closest: float) -> IntArray:
    """Cells (n, 3) with a corner in the mask in which each derivative changes sign and a neck may be narrower than 2 * `closest`.

    An axis with one plane is fixed: its derivative does not count.
    """
    value, gradient = samples
    free = np.array(value.shape) > 1
    found = np.zeros(np.maximum(1, np.array(value.shape) - 1), bool)
    diagonal, least = float(np.linalg.norm(spacing[free])), float(spacing[free].min())
    # one layout in memory, that of the samples, so that one function is compiled
    derivatives = np.ascontiguousarray(np.moveaxis(gradient, -1, 0))
    _mark_cells(value, derivatives, np.ascontiguousarray(where), free, diagonal, least, closest, found)
    return np.argwhere(found)


@njit_cached
def _mark_cells(
    value: Array,
    derivatives: Array,
    where: BoolArray,
    free: BoolArray,
    diagonal: float,
    least_spacing: float,
    closest: float,
    found: BoolArray,
) -> None:  # pragma: no cover
    """Mark cells where each free derivative changes sign and |f| at a neck can be as small as k closest^2 / 2.

    The second test spares the creases of distance fields, where the gradient jumps far from {f = 0} and Newton's method does not
    converge. Cells in which f is constant are not marked.
    """
    di, dj, dk = int(free[0]), int(free[1]), int(free[2])
    for i in range(found.shape[0]):
        for j in range(found.shape[1]):
            for k in range(found.shape[2]):
                is_candidate = True
                curvature = 0.0
                for axis in range(3):
                    if free[axis] and is_candidate:
                        low, high = np.inf, -np.inf
                        for a in range(di + 1):
                            for b in range(dj + 1):
                                for c in range(dk + 1):
                                    slope = derivatives[axis, i + a, j + b, k + c]
                                    low, high = min(low, slope), max(high, slope)
                        is_candidate = low <= 0.0 <= high
                        curvature = max(curvature, (high - low) / least_spacing)
                if not is_candidate:
                    continue
                is_inside, least, steepest = False, np.inf, 0.0
                for a in range(di + 1):
                    for b in range(dj + 1):
                        for c in range(dk + 1):
                            at = (i + a, j + b, k + c)
                            is_inside |= where[at]
                            least = min(least, abs(value[at]))
                            square = 0.0
                            for axis in range(3):
                                if free[axis]:
                                    square += derivatives[axis, i + a, j + b, k + c] ** 2
                            steepest = max(steepest, square)
                reach = np.sqrt(steepest) * diagonal + curvature * closest**2 / 2
                found[i, j, k] = is_inside and steepest > 0.0 and least <= REACH_FACTOR * reach


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


def _find_hidden_crossings(field: Field, centres: Array, spacing: Array, free: Sequence[int]) -> Array:
    """Points of the level set (m, 3) in cells (n, 3) all of whose corners are on one side of it, at most one for each."""
    corners = np.zeros((2 ** len(free), 1, 3))
    corners[:, 0, free] = 0.5 * np.array(list(product((-1.0, 1.0), repeat=len(free)))) * spacing[free]
    solid = field(centres + corners) < 0
    centres = centres[solid.all(axis=0) | ~solid.any(axis=0)]
    points, slope = centres.copy(), np.zeros(centres.shape)
    for _ in range(PROJECTION_STEPS):
        value, gradient = field.value_and_gradient(points)
        slope[:, free] = gradient[:, free]
        square = np.maximum((slope**2).sum(axis=1), np.finfo(float).tiny)
        points -= np.clip(value[:, None] * slope / square[:, None], -0.5 * spacing, 0.5 * spacing)
    distance = np.abs(field(points)) / np.sqrt(square)
    is_within = np.all(np.abs(points - centres) <= 0.5 * spacing, axis=1)
    return points[is_within & (distance <= SURFACE_TOL_SPACINGS * spacing.min())]


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
