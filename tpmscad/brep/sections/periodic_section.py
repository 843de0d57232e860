"""The section of an endless lattice in a plane, from the contours of one cell: closed curves and strands, placed by translation.

The section repeats along two axes. The contours of one cell, cut by its sides, are arcs; the end of an arc on one side is the
start of another on the opposite side, one cell further. Arcs are joined by these links, not by distance: what closes after no net
translation is a closed curve, which each cell holds once; what closes after a translation is a strand, an endless curve. Over a
rectangle the strands are closed along its sides, so that the winding number is 1 in the solid and 0 outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.loops import follow_paths
from tpmscad.brep.sections.polygon_regions import Region, combine_regions, signed_areas, thin_curve, thin_polygon
from tpmscad.errors import TrimmingError
from tpmscad.memory_limit import require_memory

SIDE_REL_TOL = 1e-7
"""In cells: distance of a point from a side of the cell on which it lies. Sides and patches are cut to 5e-10."""

LINK_REL_TOL = 1e-5
"""In cells: distance of the end of an arc from the start of the next one, one cell further."""

AREA_TOL_FRACTION = 0.02
"""Of a cell: difference of the areas within polygons and exact curves; coarse chords miss less."""

BYTES_PER_POINT = 250
"""Memory taken at the peak for each point of the curves of a layer, which are clipped and joined to regions."""

MARGIN_CELLS = 0.37
"""In cells: how far the rectangle that closes the strands reaches beyond the one that is covered. Odd, as sides of cells may lie
where that one ends."""


@dataclass(frozen=True, slots=True, eq=False)
class Strand:
    """An endless curve: points (n, 2) over one repeat, and the repeat in cells (2,)."""

    points: Array
    repeat: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicSection:
    """A plane section that repeats after `cell` (2,), with the solid on the left of every curve.

    loops: closed curves (n, 2), one of each class of translations. strands: one of each class. filled: whether the plane is solid
    where no curve separates it, as between separate holes; never if there are strands.
    """

    cell: Array
    loops: tuple[Array, ...]
    strands: tuple[Strand, ...]
    filled: bool

    @property
    def area(self) -> float:
        """Area of the solid in one cell.

        A strand bounds its cell as the polygon through both ends of its repeat does, but for a constant that all strands of a
        section share up to whole cells; the sum lies between nothing and a whole cell.
        """
        cell_area = float(np.prod(self.cell))
        beside = sum(self._area_beside(strand) for strand in self.strands)
        total = signed_areas(self.loops) + beside
        return (
            total + cell_area
            if self.filled
            else total - (np.floor(total / cell_area) * cell_area if self.strands else 0.0)
        )

    def _area_beside(self, strand: Strand) -> float:
        """Area between a strand and the line through the origin along its repeat, per cell, on the strand's left."""
        curve = _close_repeat(strand, self.cell)
        along = strand.repeat * self.cell
        mean = 0.5 * (curve[1:] + curve[:-1])
        step = np.diff(curve, axis=0)
        normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        height, progress = mean @ normal, step @ along / np.linalg.norm(along)
        return -float(height @ progress)

    @property
    def length(self) -> float:
        """Length of the curves in one cell."""
        curves = [np.concatenate([loop, loop[:1]]) for loop in self.loops]
        curves += [_close_repeat(strand, self.cell) for strand in self.strands]
        return float(sum(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum() for curve in curves))

    def reverse(self) -> PeriodicSection:
        """The section of what is void: the same curves the other way."""
        strands = (Strand(_close_repeat(s, self.cell)[:0:-1], -s.repeat) for s in self.strands)
        return replace(
            self,
            loops=tuple(loop[::-1] for loop in self.loops),
            strands=tuple(strands),
            filled=not self.strands and not self.filled,
        )

    def fill(self, outline: Region) -> Region:
        """The solid within the region of an outline."""
        if not outline:
            return []
        points = np.concatenate(outline)
        low, high = points.min(axis=0), points.max(axis=0)
        return combine_regions(self.cover(low, high), outline, "intersection")

    def thin(self, error: float) -> PeriodicSection:
        """The section with fewer points, all others within `error` of its chords."""
        loops = tuple(thin_polygon(loop, error) for loop in self.loops)
        strands = []
        for strand in self.strands:
            strands.append(Strand(thin_curve(_close_repeat(strand, self.cell), error)[:-1], strand.repeat))
        return replace(self, loops=loops, strands=tuple(strands))

    def cover(self, low: Array, high: Array) -> list[Array]:
        """Closed polygons (n, 2) whose winding number in the rectangle [low, high] is 1 in the solid, and less outside it."""
        found = [piece for loop in self.loops for piece in _place_loop(loop, self.cell, low, high)]
        margin = MARGIN_CELLS * self.cell
        wide = low - margin, high + margin
        if self.filled:
            (x0, y0), (x1, y1) = wide
            return [np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]), *found]
        pieces = [piece for s in self.strands for piece in _clip_strand(s, self.cell, *wide)]
        return [*close_along_sides(pieces, *wide), *found]


def find_periodic_section(contours: Sequence[Array], area: float, low: Array, cell: Array) -> PeriodicSection:
    """The endless section of which the cell [low, low + cell] holds the closed contours; `area` is the exact one within them.

    TrimmingError if ends on opposite sides do not match, as where a curve touches a side.
    """
    loops, arcs = [], []
    for contour in contours:
        own = _split_at_sides(contour, low, cell)
        if own is None:
            loops.append(contour)
        else:
            arcs.extend(own)
    following, step = _link_arcs(arcs, low, cell)
    strands: list[Strand] = []
    for cycle in _list_cycles(following):
        at, points = np.zeros(2, np.int64), []
        for arc in cycle:
            points.append(arcs[arc][:-1] + at * cell)
            at = at + step[arc]
        if at.any():
            strands.append(Strand(np.concatenate(points), at))
        else:
            loops.append(np.concatenate(points))
    filled = not strands and bool(area - signed_areas(loops) > 0.5 * np.prod(cell))
    section = PeriodicSection(cell, tuple(loops), tuple(strands), filled)
    if abs(section.area - area) > AREA_TOL_FRACTION * np.prod(cell):
        raise TrimmingError(f"the joined curves bound {section.area:.6g} of a cell instead of {area:.6g}")
    return section


def _close_repeat(strand: Strand, cell: Array) -> Array:
    """The points of a strand over one repeat, with both ends."""
    return np.concatenate([strand.points, strand.points[:1] + strand.repeat * cell])


def _split_at_sides(contour: Array, low: Array, cell: Array) -> list[Array] | None:
    """The arcs (n, 2) of a contour within the cell, without its segments on the sides; None if it has none there."""
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


def _list_cycles(following: IntArray) -> list[list[int]]:
    """The cycles of a permutation (n,)."""
    order, starts = follow_paths(following)
    return [cycle.tolist() for cycle in np.split(order, starts[1:-1])] if len(order) else []


def _place_loop(loop: Array, cell: Array, low: Array, high: Array) -> list[Array]:
    """The copies of a closed curve whose boxes meet the rectangle."""
    first = np.ceil((low - loop.max(axis=0)) / cell).astype(int)
    last = np.floor((high - loop.min(axis=0)) / cell).astype(int)
    if (last < first).any():
        return []
    copies = float(np.prod(last - first + 1, dtype=float))
    _require_memory(copies, loop)
    i, j = (np.arange(a, b + 1) for a, b in zip(first, last, strict=True))
    shifts = np.stack(np.meshgrid(i, j, indexing="ij"), axis=-1).reshape(-1, 1, 2) * cell
    return list(loop + shifts)


def _require_memory(copies: float, points: Array) -> None:
    require_memory(
        copies * len(points), BYTES_PER_POINT, f"{copies:.3g} copies of a curve in a layer", "cut the body into parts"
    )


def _clip_strand(strand: Strand, cell: Array, low: Array, high: Array) -> list[Array]:
    """The pieces (n, 2) of all copies of a strand within the rectangle, with both ends on its sides."""
    p, q = (int(v) for v in strand.repeat)
    aside = np.array(_complete_basis(p, q)) * cell
    along = strand.repeat * cell
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    spread, reach = strand.points @ normal, corners @ normal
    per_copy = float(aside @ normal)
    bounds = sorted(((reach.min() - spread.max()) / per_copy, (reach.max() - spread.min()) / per_copy))
    pieces = []
    unit = along / (along @ along)
    _require_memory((bounds[1] - bounds[0]) * float(np.ptp(corners @ unit)), strand.points)
    for copy in range(int(np.ceil(bounds[0])), int(np.floor(bounds[1])) + 1):
        base = strand.points + copy * aside
        progress, wanted = base @ unit, corners @ unit
        first, last = int(np.floor(wanted.min() - progress.max())), int(np.ceil(wanted.max() - progress.min()))
        repeats = np.arange(first, last + 1)
        pieces.extend(_clip_curve((base + repeats[:, None, None] * along).reshape(-1, 2), low, high))
    return pieces


def _complete_basis(p: int, q: int) -> tuple[int, int]:
    """Integers (r, s) with p s - q r = 1, for coprime p and q (Euclid's extended algorithm)."""
    a, b, u, v = p, q, (1, 0), (0, 1)
    while b:
        k = a // b
        a, b, u, v = b, a - k * b, v, (u[0] - k * v[0], u[1] - k * v[1])
    if abs(a) != 1:
        raise TrimmingError(f"a curve of the section repeats after {p} x {q} cells, which no plain curve does")
    return -u[1] * a, u[0] * a


def _clip_curve(points: Array, low: Array, high: Array) -> list[Array]:
    """The pieces of an open curve (n, 2) inside a rectangle, with their ends on its sides; the curve begins and ends outside."""
    inside = np.all((points > low) & (points < high), axis=1)
    change = np.flatnonzero(inside[1:] != inside[:-1])
    pieces = []
    for enter, leave in zip(change[::2].tolist(), change[1::2].tolist(), strict=True):
        begin = _cross_side(points[enter + 1], points[enter], low, high)
        finish = _cross_side(points[leave], points[leave + 1], low, high)
        pieces.append(np.concatenate([begin[None], points[enter + 1 : leave + 1], finish[None]]))
    return pieces


def _cross_side(inner: Array, outer: Array, low: Array, high: Array) -> Array:
    """The point at which the segment from a point inside a rectangle to one outside it crosses a side."""
    way = outer - inner
    with np.errstate(divide="ignore", invalid="ignore"):
        fractions = np.where(way > 0, (high - inner) / way, np.where(way < 0, (low - inner) / way, np.inf))
    axis = int(np.argmin(fractions))
    point = inner + fractions[axis] * way
    point[axis] = (high if way[axis] > 0 else low)[axis]
    return np.asarray(point)


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
    for cycle in _list_cycles(following):
        parts = []
        for piece in cycle:
            to = begin[following[piece]]
            to += 4.0 * (to < finish[piece])
            turns = np.arange(int(np.floor(finish[piece])) + 1, int(np.ceil(to)))
            parts += [pieces[piece], corners[(turns - 1) % 4]]
        polygons.append(np.concatenate(parts))
    return polygons


def _position_on_sides(point: Array, low: Array, high: Array) -> float:
    """Position of a point on the sides of a rectangle, counter-clockwise from the lower left corner: 0 to 4."""
    x, y = (point - low) / (high - low)
    if point[1] == low[1]:
        return float(x)
    if point[0] == high[0]:
        return 1.0 + float(y)
    if point[1] == high[1]:
        return 3.0 - float(x)
    return 4.0 - float(y)
