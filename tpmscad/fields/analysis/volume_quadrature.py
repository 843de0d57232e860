"""Volume of a field's solid in a box by quadrature along lines: the independent reference for certified solids.

The solid's segments on each line of a grid end at roots of the field, found to round-off; across the lines the midpoint rule is
used. Lines of all three directions a contribute with the weight n_a^4 / sum_b n_b^4, n being the direction of the gradient, a
partition of unity. Lines tangential to the surface, for which the midpoint rule fails, thus have no weight, and walls of any
thickness are measured with the same accuracy. Of minima and maxima the roots of all leaves are found, between which the signs of
the leaves tell what is solid: edges at which they cross are exact along the lines. (`volume_fraction_thresholds` is faster and
less accurate.)
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.analysis.outermost_extremes import combine_solids, expose_extremes, list_leaves
from tpmscad.fields.field import Field
from tpmscad.fields.periods_and_directions import count_whole
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

SLOPE_FLOOR_FRACTION = 0.1
"""Fraction of the mean squared derivative added to each squared derivative: the weights stay smooth at critical points."""

REACH_SPACINGS, SURFACE_FLOOR, MAX_REACHES = 4.0, 0.01, 6.0
"""Distance from a surface, in spacings, at which its direction and equal weights count alike; what is added to the square of the
distance over it; and the multiple of it beyond which the direction, less than 1e-3 of the weight, does not count."""

SLOPE_SAMPLES = 2000
"""Points at which the slopes of a leaf are measured."""


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
    times = np.maximum(count_whole(lo, hi, np.array(periods)), 1)
    return lo, lo + (hi - lo) / times, int(np.prod(times))


def _integrate_on_grid(field: Field, lo: Array, hi: Array, spacing: float) -> float:
    """Volume by lines of all three directions on one grid."""
    tree = expose_extremes(field)
    return sum(_integrate_columns(tree, lo, hi, spacing, axis) for axis in range(3))


def _integrate_columns(tree: Field, lo: Array, hi: Array, spacing: float, axis: int) -> float:
    """Contribution of the lines along one axis to the volume of minima and maxima of fields."""
    counts = np.maximum(8, np.ceil((hi - lo) / spacing)).astype(int)
    step = (hi - lo) / counts
    lines = [low + s * (np.arange(n) + 0.5) for low, s, n in zip(lo, step, counts, strict=True)]
    lines[axis] = np.linspace(lo[axis], hi[axis], counts[axis] + 1)
    leaves = list_leaves(tree)
    low_solid, crossings = [], []
    for leaf in leaves:
        values = leaf.on_grid(*lines)
        low, high = np.delete(values, -1, axis), np.delete(values, 0, axis)
        low_solid.append(low < 0)
        at = np.nonzero((low < 0) != (high < 0))
        points = np.stack([line[i] for line, i in zip(lines, at, strict=True)], axis=1)
        roots = _find_roots_on_lines(
            leaf, points, axis, lines[axis][at[axis]], lines[axis][at[axis] + 1], low[at], high[at]
        )
        crossings.append((np.ravel_multi_index(at, low.shape), roots))
    shape = low_solid[0].shape
    cells = np.unique(np.concatenate([cell for cell, _ in crossings]))
    whole = combine_solids(tree, low_solid).flatten()
    whole[cells] = False
    first = np.flatnonzero(whole)
    segments = [(first, *_ends_of_cells(first, shape, lines[axis], axis))]
    segments += _split_cells(tree, low_solid, crossings, cells, *_ends_of_cells(cells, shape, lines[axis], axis))
    cell, start, end = (np.concatenate(parts) for parts in zip(*segments, strict=True))
    at = np.unravel_index(cell, shape)
    length, total = end - start, 0.0
    for node, weight in zip(*gauss_legendre_unit(GAUSS_POINTS), strict=True):
        points = np.stack([line[i] for line, i in zip(lines, at, strict=True)], axis=1)
        points[:, axis] = start + node * length
        square = _weigh_directions(leaves, points, REACH_SPACINGS * float(step.min()))
        total += weight * float((length * square[:, axis] ** 2 / (square**2).sum(axis=1)).sum())
    return float(np.prod(np.delete(step, axis))) * total


def _ends_of_cells(cells: IntArray, shape: tuple[int, ...], line: Array, axis: int) -> tuple[Array, Array]:
    """Coordinates along the lines at which cells, by their flat numbers, begin and end."""
    k = np.unravel_index(cells, shape)[axis]
    return line[k], line[k + 1]


def _split_cells(
    tree: Field,
    low_solid: Sequence[BoolArray],
    crossings: Sequence[tuple[IntArray, Array]],
    cells: IntArray,
    start: Array,
    end: Array,
) -> list[tuple[IntArray, Array, Array]]:
    """The solid segments of cells (m,) that leaves change in, in parts: their cells, starts and ends.

    Between consecutive roots of the leaves no leaf changes its sign, so that the signs of all of them tell what is solid.
    """
    roots = np.full((len(crossings), len(cells)), np.inf)
    for k, (cell, root) in enumerate(crossings):
        roots[k, np.searchsorted(cells, cell)] = root
    solid = np.array([each.ravel()[cells] for each in low_solid])
    order = np.argsort(roots, axis=0)
    segments, columns = [], np.arange(len(cells))
    low = start
    for k in range(len(crossings) + 1):
        next_root = roots[order[k], columns] if k < len(crossings) else np.full(len(cells), np.inf)
        high = np.minimum(next_root, end)
        at = np.flatnonzero((high > low) & combine_solids(tree, solid))
        segments.append((cells[at], low[at], high[at]))
        if not np.isfinite(next_root).any():
            break
        crossed = np.flatnonzero(np.isfinite(next_root))
        solid[order[k][crossed], crossed] ^= True
        low = np.maximum(low, high)
    return segments


def _weigh_directions(leaves: Sequence[Field], points: Array, reach: float) -> Array:
    """Squares (n, 3) of the components of a direction at points (n, 3): near a leaf that of its gradient, else equal ones.

    Leaves are weighted by the inverse fourth power of their distance over `reach`, so that gradients far from all surfaces do not
    count: they are singular on the axes of cylinders, for one, which took a volume off by 8e-3 at 64 lines.
    """
    total = np.full(points.shape, 1.0 / 3.0)
    if not len(points):
        return total
    for leaf in leaves:
        # together, since most points are near: 64 lines have 24 on either side of a surface
        value, gradient = leaf.value_and_gradient(points)
        square = gradient**2
        some = square[:: max(1, len(points) // SLOPE_SAMPLES)].sum(axis=1)
        floor = SLOPE_FLOOR_FRACTION * some.mean() / 3.0
        at = np.flatnonzero(np.abs(value) < MAX_REACHES * reach * np.sqrt(some.max()))
        square = square[at]
        slope = square.sum(axis=1) + 3 * floor
        near = (value[at] ** 2 / (slope * reach**2) + SURFACE_FLOOR) ** -2
        total[at] += (near / slope)[:, None] * (square + floor)
    return total


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
