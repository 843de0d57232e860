"""Periodic fields whose cells change size along the axes, without a seam.

Cells are counted along each axis by the integral of one over the cell size there, as a spline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator, PPoly

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import FieldJet, Triple
from tpmscad.fields.field import Field

CellSizeTable = tuple[Sequence[float], Sequence[float]]
"""Positions along an axis, ascending, and the cell's edge at each of them."""


@dataclass(frozen=True, slots=True, eq=False)
class CellCountSpline:
    """How many cells there are from `start` to t: `cells(t)`, constant in size beyond both ends; `rate` is one over the size."""

    start: float
    end: float
    cells: PPoly
    rate: PPoly

    def of(self, t: Array) -> Array:
        inside = np.minimum(np.maximum(t, self.start), self.end)
        return np.asarray(self.cells(inside) + (t - inside) * self.rate(inside))

    def slope(self, t: Array) -> Array:
        return np.asarray(self.rate(np.minimum(np.maximum(t, self.start), self.end)))


@dataclass(frozen=True, slots=True, eq=False)
class GradedCellField(Field):
    """The field of another in which a cell's edges differ from place to place; None leaves an axis as it is."""

    field: Field
    period: Triple
    counts: tuple[CellCountSpline | None, CellCountSpline | None, CellCountSpline | None]

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self.field.at(*self._places(x, y, z))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        value, *slopes = self.field.jet(*self._places(x, y, z))
        fx, fy, fz = (
            slope if count is None else slope * (period * count.slope(t))
            for slope, count, period, t in zip(slopes, self.counts, self.period, (x, y, z), strict=True)
        )
        return value, fx, fy, fz

    def _places(self, *coordinates: Array) -> list[Array]:
        return [
            t if count is None else period * count.of(t)
            for t, count, period in zip(coordinates, self.counts, self.period, strict=True)
        ]


def cell_sizes(
    field: Field, *, x: CellSizeTable | None = None, y: CellSizeTable | None = None, z: CellSizeTable | None = None
) -> GradedCellField:
    """A periodic field with cells of other sizes along some axes: of each, positions and the cell's edge at these.

    A cell begins at the first position. Between positions the number of cells to a length changes smoothly (the field keeps two
    continuous derivatives) and never overshoots; before the first and after the last position it stays.
    """
    periods = field.periods()
    given = (x, y, z)
    if periods is None or any(sizes is not None and not p > 0 for p, sizes in zip(periods, given, strict=True)):
        raise InvalidRequest("cell sizes are those of a periodic field, which this one is not along every axis given")
    if all(sizes is None for sizes in given):
        raise InvalidRequest("cell sizes are needed along at least one of the axes x, y, z")
    first, second, third = (
        None if sizes is None else _fit_cell_count(sizes, axis) for axis, sizes in zip("xyz", given, strict=True)
    )
    return GradedCellField(field, periods, (first, second, third))


def _fit_cell_count(sizes: CellSizeTable, axis: str) -> CellCountSpline:
    where, edges = (np.atleast_1d(np.asarray(part, float)) for part in sizes)
    if where.shape != edges.shape or where.ndim != 1 or len(where) < 2:
        raise InvalidRequest(
            f"cell sizes along {axis}: {where.size} positions and {edges.size} sizes given; as many of one as of the other "
            "are needed, at least two"
        )
    if not np.isfinite(where).all() or not (np.diff(where) > 0).all():
        raise InvalidRequest(f"cell sizes along {axis}: the positions {where.tolist()} must be ascending")
    if not np.isfinite(edges).all() or not (edges > 0).all():
        raise InvalidRequest(f"cell sizes along {axis}: the sizes {edges.tolist()} must be positive")
    rate = PchipInterpolator(where, 1.0 / edges)
    rate = PPoly(rate.c, rate.x)
    return CellCountSpline(float(where[0]), float(where[-1]), rate.antiderivative(), rate)
