"""Curves that bound a solid in a plane, clipped by the outline of a region: crossings are found, and pieces chained along both.

Curves have the solid on their left, outlines the region. Where a curve leaves the region, the solid's boundary goes on along the
outline, up to the next crossing, where a curve must enter. Only crossings are computed; curves inside stay as they are. If
crossings do not alternate along a curve or an outline, as where both touch, the caller takes a general boolean operation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.index_ranges import repeat_rows

REACH = 2
"""Squares around a sample of the outline in which curves may cross it: samples lie half a square apart, and no segment of a curve
is longer than a square."""

PAIRS_PER_BATCH = 4_000_000
"""Pairs of segments that are compared at once: 32 MB for each array."""


@dataclass(frozen=True, slots=True, eq=False)
class _Segments:
    """Segments of several polygons or curves: end points (n, 2) each, and the curve that each belongs to (n,)."""

    tail: Array
    head: Array
    curve: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _OutlineCrossings:
    """Where curves cross outlines: segments of both, fractions along them, the place (n, 2), whether the curve enters."""

    on_curve: IntArray
    on_outline: IntArray
    along: Array
    beside: Array
    point: Array
    enters: BoolArray


def clip_curves(
    closed: Sequence[Array], through: Sequence[Array], outline: Sequence[Array], is_solid: Callable[[Array], bool]
) -> list[Array]:
    """The polygons (n, 2) that bound the solid within the region of the outline.

    closed: closed curves. through: open ones with both ends outside the outline. is_solid: whether a point (2,) lies in the
    solid, asked where no curve crosses a polygon of the outline. TrimmingError if crossings do not alternate.
    """
    segments = _list_segments(closed, through)
    border = _list_segments(outline, [])
    found = _find_crossings(segments, border)
    n_closed = len(closed)
    crossed = np.unique(segments.curve[found.on_curve])
    whole = np.setdiff1d(np.arange(n_closed), crossed)
    held = winding_number(np.array([closed[k][0] for k in whole]).reshape(-1, 2), outline) > 0
    result = [closed[k] for k in whole[held].tolist()]
    outlines_crossed = np.unique(border.curve[found.on_outline])
    result += [p for k, p in enumerate(outline) if k not in outlines_crossed and is_solid(p[0])]
    if len(found.on_curve):
        result += _chain(segments, border, found, n_closed)
    return result


def winding_number(points: Array, region: Sequence[Array]) -> IntArray:
    """How often the polygons of a region wind round points (n, 2): (n,)."""
    if not len(region) or not len(points):
        return np.zeros(len(points), np.int64)
    border = _list_segments(region, [])
    above_tail = border.tail[:, 1] > points[:, None, 1]
    above_head = border.head[:, 1] > points[:, None, 1]
    way = border.head - border.tail
    left = (
        way[:, 0] * (points[:, None, 1] - border.tail[:, 1]) - way[:, 1] * (points[:, None, 0] - border.tail[:, 0]) > 0
    )
    upward, downward = ~above_tail & above_head & left, above_tail & ~above_head & ~left
    return np.asarray(upward.sum(axis=1) - downward.sum(axis=1))


def _list_segments(closed: Sequence[Array], through: Sequence[Array]) -> _Segments:
    """The segments of closed curves and of open ones, curve by curve; the last one of an open curve has no length."""
    tails = [*closed, *through]
    heads = [np.roll(c, -1, axis=0) for c in closed] + [np.concatenate([c[1:], c[-1:]]) for c in through]
    curve = np.repeat(np.arange(len(tails)), [len(c) for c in tails])
    none = np.zeros((0, 2))
    return _Segments(np.concatenate([none, *tails]), np.concatenate([none, *heads]), curve)


def _find_crossings(segments: _Segments, border: _Segments) -> _OutlineCrossings:
    """All crossings of curves and outlines, ordered along the curves."""
    near = _find_near(segments, border)
    pairs = []
    batch = max(1, PAIRS_PER_BATCH // max(1, len(border.tail)))
    for first in range(0, len(near), batch):
        own = near[first : first + batch]
        p, q = segments.tail[own, None], segments.head[own, None]
        a, b = border.tail[None], border.head[None]
        apart = (np.maximum(p, q) < np.minimum(a, b)) | (np.minimum(p, q) > np.maximum(a, b))
        i, k = np.nonzero(~apart.any(axis=2))
        pairs.append(np.stack([own[i], k], axis=1))
    i, k = np.concatenate([np.zeros((0, 2), np.int64), *pairs]).T
    p, q, a, b = segments.tail[i], segments.head[i], border.tail[k], border.head[k]
    side_p, side_q, side_a, side_b = (
        _cross(b - a, p - a),
        _cross(b - a, q - a),
        _cross(q - p, a - p),
        _cross(q - p, b - p),
    )
    meets = ((side_p > 0) != (side_q > 0)) & ((side_a > 0) != (side_b > 0))
    i, k, p, q = i[meets], k[meets], p[meets], q[meets]
    side_p, side_q, side_a, side_b = side_p[meets], side_q[meets], side_a[meets], side_b[meets]
    along = side_p / (side_p - side_q)
    order = np.lexsort((along, i))
    found = _OutlineCrossings(i, k, along, side_a / (side_a - side_b), p + along[:, None] * (q - p), side_q > 0)
    return _OutlineCrossings(*(getattr(found, name)[order] for name in _OutlineCrossings.__slots__))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _find_near(segments: _Segments, border: _Segments) -> IntArray:
    """Segments of curves (k,) that the outline may cross, by squares around samples of the outline."""
    if not len(segments.tail) or not len(border.tail):
        return np.zeros(0, np.int64)
    size = float(np.linalg.norm(segments.head - segments.tail, axis=1).max())
    low = border.tail.min(axis=0) - 2 * REACH * size
    shape = np.ceil((border.tail.max(axis=0) - low) / size).astype(int) + 3 * REACH
    length = np.linalg.norm(border.head - border.tail, axis=1)
    count = np.ceil(2 * length / size).astype(int) + 1
    of, step = repeat_rows(count)
    fraction = step / count[of]
    samples = border.tail[of] + fraction[:, None] * (border.head - border.tail)[of]
    marked = np.zeros(shape, bool)
    at = ((samples - low) / size).astype(int)
    for dx in range(-REACH, REACH + 1):
        for dy in range(-REACH, REACH + 1):
            marked[at[:, 0] + dx, at[:, 1] + dy] = True
    own = np.floor((segments.tail - low) / size).astype(int)
    within = ((own >= 0) & (own < shape)).all(axis=1)
    own = np.where(within[:, None], own, 0)
    return np.flatnonzero(within & marked[own[:, 0], own[:, 1]])


def _pair_up(found: _OutlineCrossings, segments: _Segments, n_closed: int) -> dict[int, int]:
    """For each crossing at which a curve enters, that at which it leaves next; TrimmingError if they do not alternate."""
    curve = segments.curve[found.on_curve]
    pairs: dict[int, int] = {}
    for own in np.split(np.arange(len(curve)), np.flatnonzero(np.diff(curve)) + 1):
        enters = found.enters[own]
        if (enters == np.roll(enters, -1)).any() or (curve[own[0]] >= n_closed and not enters[0]):
            raise TrimmingError("crossings do not alternate along a curve")
        pairs.update(zip(own[enters].tolist(), np.roll(own, -1)[enters].tolist(), strict=True))
    return pairs


def _chain(segments: _Segments, border: _Segments, found: _OutlineCrossings, n_closed: int) -> list[Array]:
    """The polygons of pieces of curves within the outline, and of the outline from where one leaves to where the next enters."""
    leave_of, curve = _pair_up(found, segments, n_closed), segments.curve
    first = np.searchsorted(curve, np.arange(curve[-1] + 2))
    along_outline = np.lexsort((found.beside, found.on_outline))
    rank = np.empty(len(along_outline), np.int64)
    rank[along_outline] = np.arange(len(along_outline))
    outline_of = border.curve[found.on_outline]
    begin = np.searchsorted(outline_of[along_outline], np.arange(len(np.unique(border.curve)) + 1))
    start_of_outline = np.searchsorted(border.curve, np.arange(border.curve[-1] + 2))

    def follow_outline(crossing: int) -> tuple[Array, int]:
        """The vertices of the outline from a crossing to the next one, and that."""
        number = int(outline_of[crossing])
        low, high = begin[number], begin[number + 1]
        after = int(along_outline[low + (rank[crossing] + 1 - low) % (high - low)])
        a, b = int(found.on_outline[crossing]), int(found.on_outline[after])
        lo, hi = start_of_outline[number], start_of_outline[number + 1]
        ahead = b > a or (b == a and after != crossing and found.beside[after] > found.beside[crossing])
        index = np.arange(a + 1, b + 1) if ahead else np.concatenate([np.arange(a + 1, hi), np.arange(lo, b + 1)])
        return border.tail[index], after

    polygons, unused = [], set(leave_of)
    while unused:
        enter = next(iter(unused))
        parts = []
        while enter in unused:
            unused.remove(enter)
            leave = leave_of[enter]
            a, b = int(found.on_curve[enter]), int(found.on_curve[leave])
            number = int(curve[a])
            ahead = b > a or (b == a and found.along[leave] > found.along[enter])
            index = (
                np.arange(a + 1, b + 1)
                if ahead
                else np.concatenate([np.arange(a + 1, first[number + 1]), np.arange(first[number], b + 1)])
            )
            outline, enter = follow_outline(leave)
            if not found.enters[enter]:
                raise TrimmingError("curves do not alternate along the outline")
            parts += [segments.tail[index], found.point[leave][None], outline, found.point[enter][None]]
        polygons.append(np.concatenate(parts))
    return polygons
