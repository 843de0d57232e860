"""Volume of a field's solid in a box by quadrature along lines: the independent reference for certified solids.

The solid's segments on each line of a grid end at roots of the field, found to round-off; across the lines the midpoint rule is
used. Lines of all three directions a contribute with the weight n_a^4 / sum_b n_b^4, n being the direction of the gradient, a
partition of unity. Lines tangential to the surface, for which the midpoint rule fails, thus have no weight, and walls of any
thickness are measured with the same accuracy. (`volume_fraction_thresholds` is faster and less accurate.)
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.field import Field, MinMaxField
from tpmscad.splines.quadrature import gauss_legendre_unit

ROOT_STEPS = 12
"""Steps of the root finder, which reach round-off from the bracket of any grid."""

GAUSS_POINTS = 2
"""Gauss-Legendre points on each segment of a line."""

MIN_LINES = 40
"""Least number of lines along the longest edge."""

REFINEMENT = 1.5
"""Ratio of the spacings of two grids."""

VOLUME_RTOL, MAX_REFINEMENTS = 3e-4, 2
"""Relative change between grids at which a volume is accepted, and the number of grids that may follow the first three."""

WHOLE_PERIODS_TOL = 1e-9
"""Deviation of the number of periods in a box from an integer, below which the box holds whole periods."""

SLOPE_FLOOR_FRACTION = 0.1
"""Fraction of the mean squared derivative added to each squared derivative: the weights stay smooth at critical points."""


def integrate_volume(field: Field, lo: Array, hi: Array, spacing: float) -> tuple[float, float]:
    """Volume of {field < 0} in [lo, hi], and the greater of its changes by the last two refinements.

    `spacing` is that of the third grid. In a box of whole periods only one period is measured.
    """
    lo, hi, copies = _crop_to_one_period(field, lo, hi)
    spacing = min(spacing, float((hi - lo).max()) / MIN_LINES)
    volumes = [_integrate_on_grid(field, lo, hi, REFINEMENT**k * spacing) for k in (2, 1, 0)]
    for _ in range(MAX_REFINEMENTS):
        if _last_changes(volumes) <= VOLUME_RTOL * abs(volumes[-1]):
            break
        spacing /= REFINEMENT
        volumes.append(_integrate_on_grid(field, lo, hi, spacing))
    return float(copies * volumes[-1]), float(copies * _last_changes(volumes))


def _last_changes(volumes: list[float]) -> float:
    """The greater one of the last two changes: one of them alone may vanish where an error changes its sign."""
    return max(abs(one - other) for one, other in pairwise(volumes[-3:]))


def _crop_to_one_period(field: Field, lo: Array, hi: Array) -> tuple[Array, Array, int]:
    """Box reduced to one period along each axis with a whole number of them, and the number of such boxes."""
    periods = field.periods()
    if periods is None or min(periods) <= 0:
        return lo, hi, 1
    count = (hi - lo) / np.array(periods)
    whole = (np.abs(count - np.round(count)) < WHOLE_PERIODS_TOL) & (np.round(count) >= 1)
    times = np.where(whole, np.round(count), 1.0)
    return lo, lo + (hi - lo) / times, int(np.prod(times))


def _integrate_on_grid(field: Field, lo: Array, hi: Array, spacing: float) -> float:
    """Volume by lines of all three directions on one grid."""
    if isinstance(field, MinMaxField) and field.sign < 0:  # a union of level sets that do not meet: disjoint solids
        return _integrate_on_grid(field.first, lo, hi, spacing) + _integrate_on_grid(field.second, lo, hi, spacing)
    walls = _split_intersection(field)
    return sum(_integrate_columns(walls, lo, hi, spacing, axis) for axis in range(3))


def _split_intersection(field: Field) -> tuple[Field, ...]:
    """Fields whose maximum the field is."""
    if isinstance(field, MinMaxField) and field.sign > 0:
        return (*_split_intersection(field.first), *_split_intersection(field.second))
    return (field,)


def _integrate_columns(walls: tuple[Field, ...], lo: Array, hi: Array, spacing: float, axis: int) -> float:
    """Contribution of the lines along one axis to the volume where all fields are negative."""
    counts = np.maximum(8, np.ceil((hi - lo) / spacing)).astype(int)
    step = (hi - lo) / counts
    lines = [low + s * (np.arange(n) + 0.5) for low, s, n in zip(lo, step, counts, strict=True)]
    lines[axis] = np.linspace(lo[axis], hi[axis], counts[axis] + 1)
    shape = tuple(n - (a == axis) for a, n in enumerate(len(line) for line in lines))
    start = np.broadcast_to(_broadcast_along(lines[axis][:-1], axis), shape).copy()
    end = np.broadcast_to(_broadcast_along(lines[axis][1:], axis), shape).copy()
    for wall in walls:
        values = wall.on_grid(*lines)
        low, high = np.delete(values, -1, axis), np.delete(values, 0, axis)
        end[(low >= 0) & (high >= 0)] = -np.inf
        at = np.nonzero((low < 0) != (high < 0))
        points = np.stack([line[i] for line, i in zip(lines, at, strict=True)], axis=1)
        root = _find_roots_on_lines(
            wall, points, axis, lines[axis][at[axis]], lines[axis][at[axis] + 1], low[at], high[at]
        )
        leaves = low[at] < 0
        end[at] = np.where(leaves, np.minimum(end[at], root), end[at])
        start[at] = np.where(leaves, start[at], np.maximum(start[at], root))
    across = float(np.prod(np.delete(step, axis)))
    at = np.nonzero(end > start)
    first, length = start[at], (end - start)[at]
    total = 0.0
    for node, weight in zip(*gauss_legendre_unit(GAUSS_POINTS), strict=True):
        points = np.stack([line[i] for line, i in zip(lines, at, strict=True)], axis=1)
        points[:, axis] = first + node * length
        square = walls[0].gradient(points) ** 2
        square += SLOPE_FLOOR_FRACTION * np.mean(square)  # equal weights of the three directions at critical points
        total += weight * float((length * square[:, axis] ** 2 / (square**2).sum(axis=1)).sum())
    return across * total


def _broadcast_along(values: Array, axis: int) -> Array:
    """Values (n,) with shape n along one of three axes, 1 along the others."""
    shape = [1, 1, 1]
    shape[axis] = -1
    return values.reshape(shape)


def _find_roots_on_lines(
    field: Field, points: Array, axis: int, low: Array, high: Array, f_low: Array, f_high: Array
) -> Array:
    """Roots of the field between coordinates of opposite signs by the Illinois variant of regula falsi."""
    points = points.copy()
    low_is_void = f_low >= 0
    kept = np.zeros(len(low), np.int64)  # end kept by the last step: +1 high, -1 low
    middle = low
    for _ in range(ROOT_STEPS):
        difference = f_high - f_low
        ratio = np.divide(-f_low, difference, out=np.full(len(low), 0.5), where=difference != 0)
        middle = low + ratio * (high - low)
        points[:, axis] = middle
        f = field(points)
        same = (f >= 0) == low_is_void
        # the value of an end that is kept twice is halved, so that both ends converge
        f_high = np.where(same, np.where(kept > 0, 0.5 * f_high, f_high), f)
        f_low = np.where(same, f, np.where(kept < 0, 0.5 * f_low, f_low))
        low, high = np.where(same, middle, low), np.where(same, high, middle)
        kept = np.where(same, 1, -1)
    return middle
