"""Periodic fields whose unit cells change size along the axes without a seam.

The number of cells from the start of an axis to t is the integral of one over the cell size. It is a spline, and multiplied by
the period it is the coordinate at which the uniform field is evaluated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.interpolate import PchipInterpolator, PPoly

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FIELD, SIZES
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field, FieldLike, as_field
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node, clamp, piecewise_polynomial

CellSizeTable = tuple[Sequence[float], Sequence[float]]
"""Ascending positions along an axis, and the edge of the cell at each of them, in model units."""


@dataclass(frozen=True, slots=True, eq=False)
class CellCountSpline:
    """Number of cells between `start` and t; the cell size is constant beyond both ends.

    `cells` is the spline of the count, `density` its derivative, one over the cell size.
    """

    start: float
    end: float
    cells: PPoly
    density: PPoly

    def trace(self, t: Node) -> Node:
        """The number on the nodes of a tape."""
        inside = clamp(t, self.start, self.end)
        cells = piecewise_polynomial(self.cells.x, self.cells.c, inside)
        density = piecewise_polynomial(self.density.x, self.density.c, inside)
        total = cells + (t - inside) * density
        # beyond the ends the count is linear
        return t.recorder.with_gradient(total, (t,), lambda: (density,))


@dataclass(frozen=True, slots=True, eq=False)
class GradedCellField(Field):
    """A periodic field at graded coordinates; axes whose count is None stay as they are."""

    field: Field
    period: Triple
    counts: tuple[CellCountSpline | None, CellCountSpline | None, CellCountSpline | None]

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        coordinates = (
            t if count is None else period * count.trace(t)
            for t, count, period in zip((x, y, z), self.counts, self.period, strict=True)
        )
        return self.field.trace(*coordinates)


@validate_call()
def cell_sizes(
    field: Annotated[FieldLike, FIELD, "A field that is periodic along every axis given."],
    *,
    x: Annotated[
        CellSizeTable | None,
        SIZES,
        "Ascending positions along the axis and the edge of the cell at each of them, at least two, in model units.",
    ] = None,
    y: Annotated[CellSizeTable | None, SIZES, "As `x`."] = None,
    z: Annotated[CellSizeTable | None, SIZES, "As `x`."] = None,
) -> GradedCellField:
    """Return a periodic field with unit cells of varying size along some axes.

    Returns
    -------
    GradedCellField
        The graded field, which keeps two continuous derivatives. A cell begins at the first position. The number of cells per
        length is interpolated monotonically between positions and constant beyond them.

    Raises
    ------
    InvalidRequest
        If the field is not periodic along an axis given, no axis is given, or a table is not ascending and positive.

    Notes
    -----
    The density of cells is a piecewise cubic Hermite interpolant (F. N. Fritsch, R. E. Carlson, 1980), which does not overshoot.

    Examples
    --------
    >>> from tpmscad import fields
    >>> graded = fields.cell_sizes(fields.tpms("gyroid", 10.0), x=([0.0, 40.0], [10.0, 5.0]))
    """
    field = as_field(field)
    periods = field.periods()
    given = (x, y, z)
    if periods is None or any(sizes is not None and not p > 0 for p, sizes in zip(periods, given, strict=True)):
        raise InvalidRequest(
            "cell sizes need a periodic field, and this one is not periodic along every axis given: apply cell_sizes to the "
            "periodic field before it is cut or moved"
        )
    if all(sizes is None for sizes in given):
        raise InvalidRequest("cell sizes are needed along at least one of the axes x, y, z")
    first, second, third = (
        None if sizes is None else _fit_cell_count(sizes, axis) for axis, sizes in zip("xyz", given, strict=True)
    )
    return GradedCellField(field, periods, (first, second, third))


def _fit_cell_count(sizes: CellSizeTable, axis: str) -> CellCountSpline:
    """Cell count along an axis from a checked table."""
    positions, edges = (np.asarray(part, float) for part in sizes)
    if positions.shape != edges.shape or len(positions) < 2:
        raise InvalidRequest(
            f"cell sizes along {axis}: {positions.size} positions and {edges.size} sizes given; as many of one as of the other "
            "are needed, at least two"
        )
    if not (np.diff(positions) > 0).all():
        raise InvalidRequest(f"cell sizes along {axis}: the positions {positions.tolist()} must be ascending")
    if not (edges > 0).all():
        raise InvalidRequest(f"cell sizes along {axis}: the sizes {edges.tolist()} must be positive")
    pchip = PchipInterpolator(positions, 1.0 / edges)
    density = PPoly(pchip.c, pchip.x)
    return CellCountSpline(float(positions[0]), float(positions[-1]), density.antiderivative(), density)
