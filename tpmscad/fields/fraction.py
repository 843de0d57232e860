"""How much of space a field makes solid, and the thresholds for a volume fraction.

A box, by default one period, is cut into cells; in each the field is taken as linear, by its value and gradient at the center,
and the volume it cuts off the cell is exact. That is accurate to second order; two grids are extrapolated. ACCURACY holds then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import brentq

from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field, FieldLike, as_field
from tpmscad.fields.points import Array

SAMPLES = 96
"""Cells per axis of the finer grid; the other has half as many. 0.3 s."""

ACCURACY = 3e-5
"""Of a volume fraction, with that many samples in the period of a smooth field: the worst of the catalogue at six levels each,
where the median is 3e-6. Creases of the field, of a sheet for instance, may cost a digit."""

FLAT = 1e-3
"""Least share of an axis in a cell's slope: the cut volume is a difference of cubes divided by the three shares."""

LEVEL_TOL = 1e-10
"""Of a threshold, relative to the range of the field: far below what the quadrature tells apart."""

BRACKET = 1e-3
"""Of the range: where the threshold of both grids is looked for first, around that of the coarse one."""

Domain = Sequence[Sequence[float]]


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Values at the centers of cells (n,), how much the field changes along each edge (n, 3), and its bounds in the cell (n,)."""

    values: Array
    changes: Array
    lowest: Array
    highest: Array


def volume_fraction(field: FieldLike, domain: Domain | None = None, *, samples: int = SAMPLES) -> float:
    """The part of a box ((x0, y0, z0), (x1, y1, z1)), by default one period, where f <= 0."""
    fine, coarse = _cells(as_field(field), domain, samples)
    return _extrapolated(_cut(fine, 0.0), _cut(coarse, 0.0))


def threshold_for(
    phi: FieldLike,
    volume_fraction: float,
    kind: str = "rod",
    *,
    level: float = 0.0,
    domain: Domain | None = None,
    samples: int = SAMPLES,
) -> float | tuple[float, float]:
    """The threshold with which `rod` or `pore` of phi has a volume fraction in a box, by default one period.

    For kind "sheet" the two thresholds level - t, level + t.
    """
    if not 0 < volume_fraction < 1:
        raise InvalidRequest(f"volume fraction {volume_fraction!r} must be between 0 and 1")
    grids = _cells(as_field(phi), domain, samples)
    part = _part_of(kind, level)

    def excess(cells: _Cells, t: float) -> float:
        return part(cells, t) - volume_fraction

    least = min(float(cells.lowest.min()) for cells in grids)
    most = max(float(cells.highest.max()) for cells in grids)
    if kind == "sheet":
        widest = max(most - level, level - least)
        t = _root(excess, grids, 0.0, widest)
        return level - t, level + t
    return _root(excess, grids, least, most)


def fractions_of(
    phi: FieldLike,
    thresholds: Array,
    kind: str = "rod",
    *,
    level: float = 0.0,
    domain: Domain | None = None,
    samples: int = SAMPLES,
) -> Array:
    """Volume fractions (n,) of `rod` or `pore` of phi with thresholds (n,), or of sheets from level - t to level + t."""
    fine, coarse = _cells(as_field(phi), domain, samples)
    part = _part_of(kind, level)
    return np.array([_extrapolated(part(fine, t), part(coarse, t)) for t in thresholds.tolist()])


def _part_of(kind: str, level: float) -> Callable[[_Cells, float], float]:
    """part(cells, t): what a threshold makes solid."""
    if kind == "sheet":
        return lambda cells, t: _cut(cells, level + t) - _cut(cells, level - t)
    if kind == "rod":
        return _cut
    if kind == "pore":
        return lambda cells, t: 1 - _cut(cells, t)
    raise InvalidRequest(f"kind {kind!r}: choose rod, pore or sheet")


def _root(excess: Callable[[_Cells, float], float], grids: tuple[_Cells, _Cells], low: float, high: float) -> float:
    """Where the excess, extrapolated from the fine and the coarse grid, is zero: near where that of the coarse grid is."""
    tol, span = LEVEL_TOL * max(abs(low), abs(high)), BRACKET * (high - low)
    guess = brentq(partial(excess, grids[1]), low, high, xtol=tol)
    near = max(low, guess - span), min(high, guess + span)

    def both(c: float) -> float:
        return _extrapolated(excess(grids[0], c), excess(grids[1], c))

    if both(near[0]) * both(near[1]) > 0:
        near = low, high
    return float(brentq(both, *near, xtol=tol))


def _cells(field: Field, domain: Domain | None, samples: int) -> tuple[_Cells, _Cells]:
    if samples < 4:
        raise InvalidRequest(f"{samples} samples per axis are too few: at least 4, or 96 for five digits")
    low, high = _box(field, domain)
    make = partial(_sampled, field, low, high)
    return make(samples), make(samples // 2)


def _box(field: Field, domain: Domain | None) -> tuple[Array, Array]:
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


def _sampled(field: Field, low: Array, high: Array, samples: int) -> _Cells:
    size = (high - low) / samples
    axes = (low[axis] + size[axis] * (np.arange(samples) + 0.5) for axis in range(3))
    values, slopes = field.gradient_on_grid(*axes)
    changes = np.abs(slopes.reshape(-1, 3)) * size
    flat, reach = values.reshape(-1), (changes[:, 0] + changes[:, 1] + changes[:, 2]) / 2
    return _Cells(flat, changes, flat - reach, flat + reach)


def _extrapolated(fine: float, coarse: float) -> float:
    return fine + (fine - coarse) / 3


def _cut(cells: _Cells, c: float) -> float:
    under = cells.highest <= c
    partly = np.flatnonzero((cells.lowest < c) ^ under)
    return float(
        (np.count_nonzero(under) + _cut_cubes(c - cells.values[partly], cells.changes[partly]).sum()) / under.size
    )


def _cut_cubes(height: Array, changes: Array) -> Array:
    """The volume of {changes . u <= height} in the unit cube |u| <= 1/2, by inclusion and exclusion of its corners."""
    total = np.maximum(changes.sum(axis=1), np.finfo(float).tiny)
    a, b, c = np.maximum(changes / total[:, None], FLAT).T
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
