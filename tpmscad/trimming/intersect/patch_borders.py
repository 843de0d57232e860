"""The border of a patch on a marching grid: the grid lines it needs, and the signs that the shared edges prescribe.

The sign of the distance along a side is not read from the patch but from the roots of the shared edge, so that adjacent patches
agree. The grid only needs enough lines to separate the roots.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.quadric_table import ComposedDistance

CELLS_U, CELLS_V = 33, 37
"""Cells of the grid, odd and coprime: no line or diagonal of symmetry passes through a grid node."""

Scalar = TypeVar("Scalar", np.bool_, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class BorderSide:
    """What the shared edge says about one side: its roots as ascending fractions of the side, and the sign before the first.

    The sign is -1 or +1, or 0 for a side that lies in the surface.
    """

    roots: Array
    sign: int


def grid_corners(us: Array, vs: Array) -> Array:
    """The corners (4, 2) of a grid in (u, v), counter-clockwise."""
    return np.array([[us[0], vs[0]], [us[-1], vs[0]], [us[-1], vs[-1]], [us[0], vs[-1]]])


def place_grid_lines(
    surface: BSplineSurface, borders: tuple[BorderSide, ...], on_corner: BoolArray
) -> tuple[Array, Array]:
    """Uniform grid lines, with one more between any two roots of a side, and between a root and a corner on the surface."""
    lines = [np.linspace(*surface.domain[0], CELLS_U + 1), np.linspace(*surface.domain[1], CELLS_V + 1)]
    for side, border in enumerate(borders):
        axis = side % 2
        low, high = surface.domain[axis]
        ends = [np.zeros(int(on_corner[side])), border.roots, np.ones(int(on_corner[(side + 1) % 4]))]
        stops = np.concatenate(ends)
        if len(stops) > 1 and len(border.roots):
            middle = 0.5 * (stops[1:] + stops[:-1])
            middle = 1.0 - middle if side >= 2 else middle
            lines[axis] = np.union1d(lines[axis], low + (high - low) * middle)
    return lines[0], lines[1]


def view_side_nodes(array: NDArray[Scalar], side: int) -> NDArray[Scalar]:
    """A view of the border nodes of a side, in the side's direction."""
    return (array[:, 0], array[-1], array[::-1, -1], array[0, ::-1])[side]


def side_fractions(us: Array, vs: Array, side: int) -> Array:
    """The grid lines that meet a side, as fractions of the side in its direction."""
    lines = us if side % 2 == 0 else vs
    x = (lines - lines[0]) / (lines[-1] - lines[0])
    return x if side < 2 else 1.0 - x[::-1]


def impose_border_signs(
    distance: BSplineSurface | ComposedDistance,
    us: Array,
    vs: Array,
    borders: tuple[BorderSide, ...],
    on_corner: BoolArray,
    negative: BoolArray,
) -> IntArray:
    """Overwrite the border nodes of `negative` (nu, nv) by the signs of the shared edges.

    Returns the signs (4,) next to sides that lie in the surface, else 0. TrimmingError if the edges contradict each other.
    """
    on_side = np.zeros(4, np.int64)
    first, last = np.zeros(4, np.int64), np.zeros(4, np.int64)
    if all(border.sign == 0 for border in borders):
        raise TrimmingError("all four sides of a patch lie in one surface of the body")
    for side, border in enumerate(borders):
        if border.sign == 0:
            inwards = (0, 1) if side % 2 == 0 else (1, 0)
            slope = view_side_nodes(distance.grid(us, vs, *inwards)[..., 0], side)[1:-1] * (1 if side in (0, 3) else -1)
            if (slope > 0).any() and (slope < 0).any():
                raise TrimmingError("a patch touches or crosses a surface of the body along a side that lies in it")
            on_side[side] = -1 if slope[len(slope) // 2] < 0 else 1
            view_side_nodes(negative, side)[:] = on_side[side] < 0
            continue
        odd = np.searchsorted(border.roots, side_fractions(us, vs, side)) % 2 == 1
        view_side_nodes(negative, side)[1:-1] = (odd ^ (border.sign < 0))[1:-1]
        first[side] = border.sign
        last[side] = border.sign * (-1) ** len(border.roots)
    for corner in range(4):
        before, after = last[corner - 1], first[corner]
        if borders[corner - 1].sign == 0 and borders[corner].sign == 0:
            if on_side[corner - 1] != on_side[corner]:
                raise TrimmingError(
                    "two adjacent sides of a patch lie in a surface of the body, on different sides of it"
                )
            value = on_side[corner]
        elif 0 in (before, after):
            value = before or after
            if value != (on_side[corner] or on_side[corner - 1]):
                raise TrimmingError("an intersection curve starts at the end of a side that lies in the surface")
        else:
            value = before if before == after else 1
            if before != after and not on_corner[corner]:
                raise TrimmingError("two edges disagree on the side of their common vertex")
        view_side_nodes(negative, corner)[0] = value < 0
    return on_side
