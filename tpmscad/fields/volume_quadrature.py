"""The volume of a field's solid in a box by columns, without patches: the independent figure that a solid is held against.

Along each line of a grid the solid's pieces end at roots of the field, found to round-off; across the lines the midpoint rule is
taken. The lines of the three directions share the volume point by point by n_a^4 / sum_b n_b^4, n along the gradient, so that
lines that graze the surface, where the midpoint rule would fail, have no part in it: a wall of any thickness is measured alike.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.field import Field, MinMaxField
from tpmscad.splines.quadrature import gauss_legendre_unit

ROOT_STEPS = 12
"""Steps of the root finder: round-off from a bracket of any grid."""

GAUSS_POINTS = 2
"""Points on each piece of a line."""

MIN_LINES = 40
"""Lines of the grid along the longest edge, at least."""

VOLUME_RTOL, MAX_REFINEMENTS = 1e-3, 2
"""Relative change from one grid to the next at which a volume is taken, and grids half as wide again that are tried for it: long
boxes of small cells need them."""

WHOLE_PERIODS_TOL = 1e-9

SLOPE_FLOOR_FRACTION = 0.1
"""Part of the mean square slope that stands in where the field has none: with a hundredth, a rod of sixteen lines to the cell was
off by 5e-3, with a fifth a wall of a five-hundredth of the cell by 1e-3."""


def integrate_volume(field: Field, lo: Array, hi: Array, spacing: float) -> tuple[float, float]:
    """The volume of {field < 0} in [lo, hi], and how much the last refinement of the grid changed it. `spacing` is tried first.

    Of boxes of whole periods one is measured: `spacing` need not be a part of the period.
    """
    lo, hi, copies = _crop_to_one_period(field, lo, hi)
    spacing = min(spacing, float((hi - lo).max()) / MIN_LINES)
    fine, coarse = (_integrate_on_grid(field, lo, hi, s) for s in (spacing, 1.5 * spacing))
    for _ in range(MAX_REFINEMENTS):
        if abs(fine - coarse) <= VOLUME_RTOL * abs(fine):
            break
        spacing /= 1.5
        fine, coarse = _integrate_on_grid(field, lo, hi, spacing), fine
    return float(copies * fine), float(copies * abs(fine - coarse))


def _crop_to_one_period(field: Field, lo: Array, hi: Array) -> tuple[Array, Array, int]:
    """The box along each axis cut down to a period where it has a whole number of them, and how many such boxes it is."""
    periods = field.periods()
    if periods is None or min(periods) <= 0:
        return lo, hi, 1
    count = (hi - lo) / np.array(periods)
    whole = (np.abs(count - np.round(count)) < WHOLE_PERIODS_TOL) & (np.round(count) >= 1)
    times = np.where(whole, np.round(count), 1.0)
    return lo, lo + (hi - lo) / times, int(np.prod(times))


def _integrate_on_grid(field: Field, lo: Array, hi: Array, spacing: float) -> float:
    if isinstance(field, MinMaxField) and field.sign < 0:  # level sets that do not meet: the solids are apart
        return _integrate_on_grid(field.first, lo, hi, spacing) + _integrate_on_grid(field.second, lo, hi, spacing)
    walls = _split_intersection(field)
    return sum(_integrate_columns(walls, lo, hi, spacing, axis) for axis in range(3))


def _split_intersection(field: Field) -> tuple[Field, ...]:
    if isinstance(field, MinMaxField) and field.sign > 0:
        return (*_split_intersection(field.first), *_split_intersection(field.second))
    return (field,)


def _integrate_columns(walls: tuple[Field, ...], lo: Array, hi: Array, spacing: float, axis: int) -> float:
    """One direction's share of the volume where all the walls' fields are negative."""
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
        square += SLOPE_FLOOR_FRACTION * np.mean(
            square
        )  # where the field is level all directions share alike, and smoothly
        total += weight * float((length * square[:, axis] ** 2 / (square**2).sum(axis=1)).sum())
    return across * total


def _broadcast_along(values: Array, axis: int) -> Array:
    shape = [1, 1, 1]
    shape[axis] = -1
    return values.reshape(shape)


def _find_roots_on_lines(
    field: Field, points: Array, axis: int, low: Array, high: Array, f_low: Array, f_high: Array
) -> Array:
    """Where the field vanishes between coordinates of opposite signs, by the Illinois rule."""
    points = points.copy()
    begins = f_low >= 0
    kept = np.zeros(len(low), np.int64)  # the end that the last step kept: +1 high, -1 low
    middle = low
    for _ in range(ROOT_STEPS):
        difference = f_high - f_low
        ratio = np.divide(-f_low, difference, out=np.full(len(low), 0.5), where=difference != 0)
        middle = low + ratio * (high - low)
        points[:, axis] = middle
        f = field(points)
        same = (f >= 0) == begins
        # an end that stays for a second time counts half, so that both close in
        f_high = np.where(same, np.where(kept > 0, 0.5 * f_high, f_high), f)
        f_low = np.where(same, f, np.where(kept < 0, 0.5 * f_low, f_low))
        low, high = np.where(same, middle, low), np.where(same, high, middle)
        kept = np.where(same, 1, -1)
    return middle
