"""Segments of contours split at points of the exact contour until their chords keep the error.

The point of the contour near the middle of a segment is found on the face by Newton's method along the gradient of the height.
Its offset from the chord and the slopes at the ends also give the area between chord and contour, as that of a quartic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.triangles.measured_deviation import Surfaces
from tpmscad.kernel.slicing.level_crossings import Crossings
from tpmscad.memory_limit import require_memory

MAX_SPLITS = 12
"""Times that a segment is halved at most."""

BYTES_PER_POINT = 800
"""Memory taken at the peak for each point of a contour, as measured."""

NEWTON_STEPS = 5
"""Steps towards the level from the middle of a segment; two or three reach round-off where the face is not horizontal."""

MAX_SLOPE = 1.0
"""Slope of a contour against its chord up to which slopes at the ends are taken for its area."""

MIN_MIDDLE_FRACTION = 0.05
"""Fraction of the chord from either end within which a point is of no use as the middle of a segment."""


@dataclass(frozen=True, slots=True, eq=False)
class Arcs:
    """Segments after splitting: points (n, 2) with their level (n,), ends (s,), area beyond each chord (s,), length (s,).

    unresolved: number of the points at which chords begin that are longer than the error allows.
    """

    point: Array
    level: IntArray
    tail: IntArray
    head: IntArray
    beyond: Array
    length: Array
    unresolved: IntArray


def split_chords(crossings: Crossings, surfaces: Surfaces, levels: Array, chord_error: float, tol: float) -> Arcs:
    """Split all segments on their faces until their sagitta is within the chord error."""
    points, marks = [crossings.point], [crossings.level]
    tails, heads, beyonds, lengths = [], [], [], []
    count, unresolved = len(crossings.point), np.zeros(0, np.int64)
    face, tail, head = crossings.face, crossings.tail, crossings.head
    level = crossings.level[tail]
    a, b = crossings.point[tail], crossings.point[head]
    uv_a, uv_b = crossings.tail_uv, crossings.head_uv
    for split in range(MAX_SPLITS + 1):
        middle_uv, middle, found = _find_middles(surfaces, face, uv_a, uv_b, levels[level], tol)
        chord = b - a
        length = np.linalg.norm(chord, axis=1)
        safe = np.where(length > tol, length, 1.0)
        at = ((middle - a) * chord).sum(axis=1) / safe**2
        offset = np.linalg.norm(middle - a - np.clip(at, 0.0, 1.0)[:, None] * chord, axis=1)
        between = found & (np.minimum(at, 1.0 - at) > MIN_MIDDLE_FRACTION) & (length > tol)
        at = np.where(between, at, 0.5)
        sagitta = np.where(between, -cross(chord, middle - a) / safe / (4.0 * at * (1.0 - at)), 0.0)
        long = (np.abs(sagitta) > chord_error) | (found & (offset > chord_error))
        if split == MAX_SPLITS:
            unresolved = tail[long]
            long[:] = False
        kept = np.flatnonzero(~long)
        tails.append(tail[kept])
        heads.append(head[kept])
        slopes = [np.full(len(kept), np.inf), np.full(len(kept), np.inf)]
        smooth = np.flatnonzero(between[kept])
        for slope, uv in zip(slopes, (uv_a, uv_b), strict=True):
            own = kept[smooth]
            slope[smooth] = _slopes(surfaces, face[own], uv[own], chord[own])
        beyonds.append(_areas_beyond(at[kept], sagitta[kept], length[kept], *slopes))
        lengths.append((length + 8.0 / 3.0 * sagitta**2 / safe)[kept])
        if not long.any():
            break
        require_memory(
            count + float(long.sum()), BYTES_PER_POINT, "the points of contours", f"raise chord_error = {chord_error:g}"
        )
        new = count + np.arange(int(long.sum()))
        count += len(new)
        points.append(middle[long])
        marks.append(level[long])
        tail, head = np.concatenate([tail[long], new]), np.concatenate([new, head[long]])
        a, b = np.concatenate([a[long], middle[long]]), np.concatenate([middle[long], b[long]])
        uv_a, uv_b = (
            np.concatenate([uv_a[long], middle_uv[long]]),
            np.concatenate([middle_uv[long], uv_b[long]]),
        )
        level, face = np.tile(level[long], 2), np.tile(face[long], 2)
    return Arcs(
        np.concatenate(points),
        np.concatenate(marks),
        np.concatenate(tails),
        np.concatenate(heads),
        np.concatenate(beyonds),
        np.concatenate(lengths),
        unresolved,
    )


def _slopes(surfaces: Surfaces, face: IntArray, uv: Array, chord: Array) -> Array:
    """Slopes against chords (n, 2), to their left, of contours at parameters (n, 2); infinite where the face is horizontal."""
    _, xu, xv = surfaces(face, uv)
    tangent = xv[:, 2, None] * xu[:, :2] - xu[:, 2, None] * xv[:, :2]
    along = (tangent * chord).sum(axis=1)
    return np.divide(cross(chord, tangent), along, out=np.full(len(uv), np.inf), where=along != 0.0)


def _areas_beyond(at: Array, sagitta: Array, length: Array, slope_a: Array, slope_b: Array) -> Array:
    """Areas (n,) between chords and contours to their right, from slopes at both ends and the point above the fraction `at`.

    The contour is x (1 - x) (p + q x + r x^2), in lengths of the chord, and its area p/6 + q/12 + r/20. Where its slope exceeds
    MAX_SLOPE, as where the face is horizontal, it is the parabola of the sagitta.
    """
    bump = 4.0 * sagitta / np.where(length > 0.0, length, 1.0)  # y / (x (1 - x)) at the point
    steep = np.maximum(np.abs(slope_a), np.abs(slope_b)) > MAX_SLOPE
    p = np.where(steep, bump, -slope_a)
    rise = np.where(steep, 0.0, slope_b - p)
    r = (bump - p - rise * at) / (at * (at - 1.0))
    return np.asarray(length**2 * (p / 6.0 + (rise - r) / 12.0 + r / 20.0))


def _find_middles(
    surfaces: Surfaces, face: IntArray, uv_a: Array, uv_b: Array, height: Array, tol: float
) -> tuple[Array, Array, BoolArray]:
    """Parameters (n, 2) and point (n, 2) of the contour near the middle of segments, and whether it was found (n,)."""
    uv = 0.5 * (uv_a + uv_b)
    reach = np.linalg.norm(uv_b - uv_a, axis=1)
    for _ in range(NEWTON_STEPS):
        x, xu, xv = surfaces(face, uv)
        off = x[:, 2] - height
        if (np.abs(off) <= tol).all():
            break
        gradient = np.stack([xu[:, 2], xv[:, 2]], axis=1)
        steepness = np.linalg.norm(gradient, axis=1)
        far = np.abs(off) > reach * steepness  # a step over the length of the segment is cut off; it may be infinite
        step = np.where(far, np.copysign(reach, off), off / np.where(far, 1.0, steepness))
        uv = uv - step[:, None] * gradient / np.where(steepness > 0.0, steepness, 1.0)[:, None]
    return uv, x[:, :2], np.abs(off) <= tol


def cross(a: Array, b: Array) -> Array:
    """z-component of the cross products of vectors (n, 2): (n,)."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
