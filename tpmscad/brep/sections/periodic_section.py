"""The section of an endless lattice in a plane, from the contours of one cell: arcs from side to side, placed by translation.

The section repeats along two axes. The contours of one cell, cut by its sides, are arcs; the end of an arc on one side is the
start of another on the opposite side, one cell further. Copies of arcs in many cells are joined by these links, not by distance.
What leaves the cells is closed along their common border, so that the winding number is 1 in the solid and 0 outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.loops import follow_paths
from tpmscad.brep.sections.polygon_regions import (
    Operation,
    Region,
    combine_regions,
    signed_areas,
    thin_curve,
    thin_polygon,
)
from tpmscad.errors import TrimmingError
from tpmscad.index_ranges import expand_ranges
from tpmscad.memory_limit import require_memory

SIDE_REL_TOL = 1e-7
"""In cells: distance of a point from a side of the cell on which it lies. Sides and patches are cut to 5e-10."""

LINK_REL_TOL = 1e-5
"""In cells: distance of the end of an arc from the start of the next one, one cell further."""

AREA_TOL_FRACTION = 0.02
"""Of a cell: difference of the areas within polygons and exact curves; coarse chords miss less."""

BYTES_PER_POINT = 250
"""Memory taken at the peak for each point of the curves of a layer, which are clipped and joined to regions."""

MARGIN_CELLS = 0.01
"""In cells: how far the cells reach beyond the rectangle that they cover. Its sides may be sides of cells."""


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicSection:
    """A plane section that repeats from the cell [low, low + cell] on, (2,) each, with the solid on the left of every curve.

    loops: closed curves (n, 2) inside of a cell. arcs: curves (n, 2) from side to side; following: the arc after each, (a,), and
    step: the cells (a, 2) from the one to the other. filled: whether the cell is solid where no curve separates it, as between
    separate holes; never if there are arcs.
    """

    low: Array
    cell: Array
    loops: tuple[Array, ...]
    arcs: tuple[Array, ...]
    following: IntArray
    step: IntArray
    filled: bool

    @property
    def area(self) -> float:
        """Area of the solid in one cell."""
        return signed_areas(self._bound(self.loops, self.arcs, self.low, self.low + self.cell))

    @property
    def length(self) -> float:
        """Length of the curves in one cell."""
        curves = [np.concatenate([loop, loop[:1]]) for loop in self.loops]
        return float(sum(np.linalg.norm(np.diff(each, axis=0), axis=1).sum() for each in (*curves, *self.arcs)))

    def combine(self, outline: Region, operation: Operation) -> Region:
        """The solid within the region of an outline, or the region without it."""
        if not outline:
            return []
        points = np.concatenate(outline)
        return combine_regions(outline, self.cover(points.min(axis=0), points.max(axis=0)), operation)

    def thin(self, error: float) -> PeriodicSection:
        """The section with fewer points, all others within `error` of its chords."""
        loops = tuple(thin_polygon(loop, error) for loop in self.loops)
        return replace(self, loops=loops, arcs=tuple(thin_curve(arc, error) for arc in self.arcs))

    def cover(self, low: Array, high: Array) -> list[Array]:
        """Closed polygons (n, 2) whose winding number in the rectangle [low, high] is 1 in the solid, and less outside it."""
        margin = MARGIN_CELLS * self.cell
        first, last = (np.floor((at - self.low) / self.cell).astype(int) for at in (low - margin, high + margin))
        count = last + 1 - first
        n_points = sum(map(len, (*self.loops, *self.arcs)))
        copies = float(np.prod(count, dtype=float))
        require_memory(
            copies * n_points, BYTES_PER_POINT, f"{copies:.3g} copies of a curve in a layer", "cut the body into parts"
        )
        at = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, 2)
        moves = (first + at) * self.cell
        to = at[:, None] + self.step
        number = (to @ [count[1], 1]) * len(self.arcs) + self.following
        following = np.where(((to >= 0) & (to < count)).all(axis=2), number, -1).ravel()
        order, starts = follow_paths(following)
        is_open = following[order] < 0  # the last point of other arcs is the first of the following one
        place, arc = np.divmod(order, max(len(self.arcs), 1))
        begin = np.cumsum([0, *map(len, self.arcs)])
        row, index = expand_ranges(begin[arc], begin[arc + 1] - ~is_open)
        points = np.concatenate([np.zeros((0, 2)), *self.arcs])[index] + moves[place][row]
        curves = np.split(points, np.searchsorted(row, starts[1:-1])) if len(points) else []
        n_open = int(is_open.sum())  # these come first
        loops = [*(copy for loop in self.loops for copy in loop + moves[:, None]), *curves[n_open:]]
        return self._bound(loops, curves[:n_open], self.low + first * self.cell, self.low + (last + 1) * self.cell)

    def _bound(self, loops: Sequence[Array], curves: Sequence[Array], low: Array, high: Array) -> list[Array]:
        """The polygons of closed curves and of others that end on the sides of a rectangle."""
        rim = [np.array([low, (high[0], low[1]), high, (low[0], high[1])])] if self.filled else []
        return [*rim, *loops, *close_along_sides(curves, low, high)]


def find_periodic_section(contours: Sequence[Array], area: float, low: Array, cell: Array) -> PeriodicSection:
    """The endless section of which the cell [low, low + cell] holds the closed contours; `area` is the exact one within them.

    TrimmingError if ends on opposite sides do not match, as where a curve touches a side.
    """
    loops, arcs, filled = [], [], False
    for contour in contours:
        own = _split_at_sides(contour, low, cell)
        if own is None:
            loops.append(contour)
        else:
            arcs.extend(own)
            filled = filled or not own  # the sides themselves
    section = PeriodicSection(low, cell, tuple(loops), tuple(arcs), *_link_arcs(arcs, low, cell), filled)
    if abs(section.area - area) > AREA_TOL_FRACTION * np.prod(cell):
        raise TrimmingError(f"the joined curves bound {section.area:.6g} of a cell instead of {area:.6g}")
    return section


def _split_at_sides(contour: Array, low: Array, cell: Array) -> list[Array] | None:
    """The arcs (n, 2) of a contour within the cell, without its segments on the sides; None if it has no segment there."""
    tol = SIDE_REL_TOL * float(cell.max())
    on_side = np.concatenate([np.abs(contour - low) < tol, np.abs(contour - low - cell) < tol], axis=1)
    along = (on_side & np.roll(on_side, -1, axis=0)).any(axis=1)  # the segment from each point to the next
    if not along.any():
        return None
    first = int(np.flatnonzero(along)[0]) + 1
    points, along = np.roll(contour, -first, axis=0), np.roll(along, -first)
    starts = np.flatnonzero(~along & np.roll(along, 1))
    ends = np.flatnonzero(along & ~np.roll(along, 1))
    return [points[a : b + 1] for a, b in zip(starts.tolist(), ends.tolist(), strict=True)]


def _link_arcs(arcs: Sequence[Array], low: Array, cell: Array) -> tuple[IntArray, IntArray]:
    """The arc that follows each, and the step in cells (n, 2) from the one to the other."""
    following, step = np.full(len(arcs), -1), np.zeros((len(arcs), 2), np.int64)
    if not arcs:
        return following, step
    start, end = (np.array([arc[k] for arc in arcs]) - low for k in (0, -1))
    tol = SIDE_REL_TOL * float(cell.max())
    for axis in (0, 1):
        for leaves, enters, by in ((cell[axis], 0.0, 1), (0.0, cell[axis], -1)):
            out = np.flatnonzero(np.abs(end[:, axis] - leaves) < tol)
            into = np.flatnonzero(np.abs(start[:, axis] - enters) < tol)
            out = out[np.argsort(end[out, 1 - axis])]
            into = into[np.argsort(start[into, 1 - axis])]
            apart = np.abs(end[out, 1 - axis] - start[into, 1 - axis]) if len(out) == len(into) else np.array([np.inf])
            if (apart > LINK_REL_TOL * cell.max()).any():
                raise TrimmingError("the sections of a cell by its opposite sides do not match")
            following[out] = into
            step[out, axis] = by
    if (np.bincount(following + 1, minlength=len(arcs) + 1)[1:] != 1).any():
        raise TrimmingError("the sections of a cell by its sides do not close")
    return following, step


def close_along_sides(pieces: Sequence[Array], low: Array, high: Array) -> list[Array]:
    """Closed polygons of curves through a rectangle: from the end of each counter-clockwise along the sides to the next start."""
    if not pieces:
        return []
    begin, finish = (np.array([_position_on_sides(piece[k], low, high) for piece in pieces]) for k in (0, -1))
    order = np.argsort(begin)
    place = np.searchsorted(begin[order], finish)
    following = order[place % len(order)]
    if len(set(following.tolist())) != len(pieces):
        raise TrimmingError("curves of the section do not alternate along the sides of a rectangle")
    corners = np.array([(high[0], low[1]), high, (low[0], high[1]), low])  # at positions 1, 2, 3, 4
    polygons = []
    cycles, starts = follow_paths(following)
    for cycle in np.split(cycles, starts[1:-1]):
        parts = []
        for piece in cycle.tolist():
            to = begin[following[piece]]
            to += 4.0 * (to < finish[piece])
            turns = np.arange(int(np.floor(finish[piece])) + 1, int(np.ceil(to)))
            parts += [pieces[piece], corners[(turns - 1) % 4]]
        polygons.append(np.concatenate(parts))
    return polygons


def _position_on_sides(point: Array, low: Array, high: Array) -> float:
    """Position of a point on the nearest side of a rectangle, counter-clockwise from the lower left corner: 0 to 4."""
    x, y = ((point - low) / (high - low)).tolist()
    along = (x, 1.0 + y, 3.0 - x, 4.0 - y)
    return float(along[int(np.argmin(np.abs([y, 1.0 - x, 1.0 - y, x])))])
