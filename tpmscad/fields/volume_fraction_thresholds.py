"""How much of space a field makes solid, and the thresholds for a volume fraction.

A box, by default one period, is cut into cells; in each the field is taken as linear, by its value and gradient at the center,
and the volume it cuts off the cell is exact. That is accurate to second order; two grids are extrapolated. ACCURACY holds then.

Thresholds for a volume fraction that varies in space: what a uniform structure of the local fraction has, place by place.

The threshold is a spline of the fraction, through the fractions of a uniform structure at a row of thresholds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from tpmscad._typing import Array, BoxCorners
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import FieldJet
from tpmscad.fields.field import Field, FieldLike, as_field

SAMPLES_PER_AXIS = 96
"""Cells per axis of the finer grid; the other has half as many. 0.3 s."""

FRACTION_ACCURACY = 3e-5
"""Of a volume fraction, with that many samples in the period of a smooth field: the worst of the catalogue at six levels each,
where the median is 3e-6. Creases of the field, of a sheet for instance, may cost a digit."""

MIN_SLOPE_SHARE = 1e-3
"""Least share of an axis in a cell's slope: the cut volume is a difference of cubes divided by the three shares."""

THRESHOLD_RTOL = 1e-10
"""Of a threshold, relative to the range of the field: far below what the quadrature tells apart."""

BRACKET_RANGE_FRACTION = 1e-3
"""Of the range: where the threshold of both grids is looked for first, around that of the coarse one."""


@dataclass(frozen=True, slots=True, eq=False)
class _CellSamples:
    """Values at the centers of cells (n,), how much the field changes along each edge (n, 3), and its bounds in the cell (n,)."""

    values: Array
    changes: Array
    lowest: Array
    highest: Array


def volume_fraction(field: FieldLike, domain: BoxCorners | None = None, *, samples: int = SAMPLES_PER_AXIS) -> float:
    """The part of a box ((x0, y0, z0), (x1, y1, z1)), by default one period, where f <= 0."""
    fine, coarse = _sample_two_grids(as_field(field), domain, samples)
    return _richardson(_fraction_below(fine, 0.0), _fraction_below(coarse, 0.0))


def threshold_for(
    phi: FieldLike,
    volume_fraction: float,
    kind: str = "rod",
    *,
    level: float = 0.0,
    domain: BoxCorners | None = None,
    samples: int = SAMPLES_PER_AXIS,
) -> float | tuple[float, float]:
    """The threshold with which `rod` or `pore` of phi has a volume fraction in a box, by default one period.

    For kind "sheet" the two thresholds level - t, level + t.
    """
    if not 0 < volume_fraction < 1:
        raise InvalidRequest(f"volume fraction {volume_fraction!r} must be between 0 and 1")
    grids = _sample_two_grids(as_field(phi), domain, samples)
    part = _fraction_function(kind, level)

    def excess(cells: _CellSamples, t: float) -> float:
        return part(cells, t) - volume_fraction

    least = min(float(cells.lowest.min()) for cells in grids)
    most = max(float(cells.highest.max()) for cells in grids)
    if kind == "sheet":
        widest = max(most - level, level - least)
        t = _solve_threshold(excess, grids, 0.0, widest)
        return level - t, level + t
    return _solve_threshold(excess, grids, least, most)


def volume_fractions(
    phi: FieldLike,
    thresholds: Array,
    kind: str = "rod",
    *,
    level: float = 0.0,
    domain: BoxCorners | None = None,
    samples: int = SAMPLES_PER_AXIS,
) -> Array:
    """Volume fractions (n,) of `rod` or `pore` of phi with thresholds (n,), or of sheets from level - t to level + t."""
    fine, coarse = _sample_two_grids(as_field(phi), domain, samples)
    part = _fraction_function(kind, level)
    return np.array([_richardson(part(fine, t), part(coarse, t)) for t in thresholds.tolist()])


def _fraction_function(kind: str, level: float) -> Callable[[_CellSamples, float], float]:
    """part(cells, t): what a threshold makes solid."""
    if kind == "sheet":
        return lambda cells, t: _fraction_below(cells, level + t) - _fraction_below(cells, level - t)
    if kind == "rod":
        return _fraction_below
    if kind == "pore":
        return lambda cells, t: 1 - _fraction_below(cells, t)
    raise InvalidRequest(f"kind {kind!r}: choose rod, pore or sheet")


def _solve_threshold(
    excess: Callable[[_CellSamples, float], float], grids: tuple[_CellSamples, _CellSamples], low: float, high: float
) -> float:
    """Where the excess, extrapolated from the fine and the coarse grid, is zero: near where that of the coarse grid is."""
    tol, span = THRESHOLD_RTOL * max(abs(low), abs(high)), BRACKET_RANGE_FRACTION * (high - low)
    guess = brentq(partial(excess, grids[1]), low, high, xtol=tol)
    near = max(low, guess - span), min(high, guess + span)

    def both(c: float) -> float:
        return _richardson(excess(grids[0], c), excess(grids[1], c))

    if both(near[0]) * both(near[1]) > 0:
        near = low, high
    return float(brentq(both, *near, xtol=tol))


def _sample_two_grids(field: Field, domain: BoxCorners | None, samples: int) -> tuple[_CellSamples, _CellSamples]:
    if samples < 4:
        raise InvalidRequest(f"{samples} samples per axis are too few: at least 4, or 96 for five digits")
    low, high = _resolve_box(field, domain)
    make = partial(_sample_cells, field, low, high)
    return make(samples), make(samples // 2)


def _resolve_box(field: Field, domain: BoxCorners | None) -> tuple[Array, Array]:
    if domain is None:
        periods = field.periods()
        if periods is None or 0 in periods:
            raise InvalidRequest(
                "the field is not periodic: give the box of the volume as domain=((x0, y0, z0), (x1, y1, z1))"
            )
        return np.zeros(3), np.array(periods)
    box = np.asarray(domain, float)
    if box.shape != (2, 3) or not np.isfinite(box).all() or not (box[0] < box[1]).all():
        raise InvalidRequest(
            f"domain {domain!r} must be two corners (x, y, z), each coordinate of the first below the second's"
        )
    return box[0], box[1]


def _sample_cells(field: Field, low: Array, high: Array, samples: int) -> _CellSamples:
    size = (high - low) / samples
    axes = (low[axis] + size[axis] * (np.arange(samples) + 0.5) for axis in range(3))
    values, slopes = field.value_and_gradient_on_grid(*axes)
    changes = np.abs(slopes.reshape(-1, 3)) * size
    flat, reach = values.reshape(-1), (changes[:, 0] + changes[:, 1] + changes[:, 2]) / 2
    return _CellSamples(flat, changes, flat - reach, flat + reach)


def _richardson(fine: float, coarse: float) -> float:
    return fine + (fine - coarse) / 3


def _fraction_below(cells: _CellSamples, c: float) -> float:
    under = cells.highest <= c
    partly = np.flatnonzero((cells.lowest < c) ^ under)
    return float(
        (np.count_nonzero(under) + _cube_volumes_below(c - cells.values[partly], cells.changes[partly]).sum())
        / under.size
    )


def _cube_volumes_below(height: Array, changes: Array) -> Array:
    """The volume of {changes . u <= height} in the unit cube |u| <= 1/2, by inclusion and exclusion of its corners."""
    total = np.maximum(changes.sum(axis=1), np.finfo(float).tiny)
    a, b, c = np.maximum(changes / total[:, None], MIN_SLOPE_SHARE).T
    depth = np.clip(height / total, -0.5, 0.5)
    # the smaller of the two parts: the formula then has fewer terms that cancel
    t = (0.5 - np.abs(depth)) * (a + b + c)
    corners = t**3
    for edge in (a, b, c):
        corners -= np.maximum(t - edge, 0) ** 3
    for pair in (a + b, a + c, b + c):
        corners += np.maximum(t - pair, 0) ** 3
    part = corners / (6 * a * b * c)
    return np.where(depth > 0, 1 - part, part)


THRESHOLD_NODES = 17
"""Thresholds whose fractions are sampled; for gyroid rods of 0.2 to 0.5 the spline is off by 2e-5 at most."""


@dataclass(frozen=True, slots=True, eq=False)
class GradedThreshold(Field):
    """The threshold of the fraction `by`, which stays within the spline's range; `sign` -1 for the lower one of a sheet."""

    by: Field
    table: CubicSpline
    level: float
    sign: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self.level + self.sign * np.asarray(self.table(self._within(self.by.at(x, y, z))))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        by, bx, by_, bz = self.by.jet(x, y, z)
        by = self._within(by)
        value, rate = self.level + self.sign * np.asarray(self.table(by)), self.sign * np.asarray(self.table(by, 1))
        return value, rate * bx, rate * by_, rate * bz

    def _within(self, fraction: Array) -> Array:
        low, high = self.table.x[[0, -1]]
        least, most = fraction.min(initial=high), fraction.max(initial=low)
        if least < low - FRACTION_ACCURACY or most > high + FRACTION_ACCURACY:
            raise InvalidRequest(
                f"a volume fraction of {least if least < low else most:.4g} is asked for, the span is {low:g} to {high:g}: "
                "widen the span, or end the fraction's ramp within it"
            )
        return fraction


def graded_threshold(
    phi: FieldLike,
    fraction: FieldLike,
    span: Sequence[float],
    kind: str = "rod",
    *,
    level: float = 0.0,
    domain: BoxCorners | None = None,
) -> Field | tuple[Field, Field]:
    """The threshold field with which `rod` or `pore` of phi has the volume fraction `fraction` where it changes slowly.

    fraction: a field with values within span = (least, greatest). phi: periodic, or with a `domain` to sample, as for
    `threshold_for`. For kind "sheet" the two threshold fields about `level`.
    """
    by = as_field(fraction)
    try:
        low, high = (float(f) for f in span)
    except (TypeError, ValueError):
        raise InvalidRequest(f"span {span!r} must be two volume fractions, the least and the greatest") from None
    if not 0 < low < high < 1:
        raise InvalidRequest(f"span {span!r} must be two volume fractions between 0 and 1, the least first")
    ends = [threshold_for(phi, f, kind, level=level, domain=domain) for f in (low, high)]
    first, last = (e[1] - level if isinstance(e, tuple) else e for e in ends)
    rows = np.linspace(first, last, THRESHOLD_NODES)
    found = volume_fractions(phi, rows, kind, level=level, domain=domain)
    found[0], found[-1] = low, high
    if not (np.diff(found) > 0).all():
        raise InvalidRequest(f"volume fractions from {low:g} to {high:g} do not tell thresholds apart: narrow the span")
    table = CubicSpline(found, rows)
    if kind == "sheet":
        return GradedThreshold(by, table, level, -1.0), GradedThreshold(by, table, level, 1.0)
    return GradedThreshold(by, table, 0.0, 1.0)
