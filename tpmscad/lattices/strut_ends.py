"""The ends of equal round struts that meet in a node, as functions of the angle about each strut.

A node is a ball of radius R >= r in which half cylinders of radius r begin, along unit directions d_i. Seen from the node the
boundary of their union is a graph over the sphere of directions: cylinder i reaches r / sin(angle to d_i), so that the farthest
one in a direction u is that whose d_i is nearest to u, and the ball shows where no cylinder reaches R. The regions of
cylinders are cells of the Voronoi diagram of the d_i on the sphere, cut off where the ball begins. With
e(phi) a unit vector across strut i, the border of its cell towards strut j is

    cot theta = e(phi) . d_j / (1 - d_i . d_j)

where theta is the angle from d_i: a plane section of both cylinders, half an ellipse. A plane through the node with the
outward normal n, behind which all struts lie, cuts off cot theta = e(phi) . n / (-d_i . n), and the ball begins at the constant
sqrt((R / r)^2 - 1). Thus an end is the upper envelope of functions A cos phi + B sin phi + C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.conics import TWO_PI

SAME_ANGLE = 1e-7
"""Radians up to which breaks of an envelope are one: on a strut of 1 mm the kernel's tolerance, 1e-7 mm, is 2e-7."""

SAME_VALUE = 1e-9
"""Relative difference of functions that are equal: the first one counts."""

IN_PLANE = 1e-9
"""Sine of the angle between a strut and a plane up to which the strut lies in it."""


@dataclass(frozen=True, slots=True, eq=False)
class UpperEnvelope:
    """The greatest of the functions A cos phi + B sin phi + C, rows of `waves` (k, 3), on [breaks[0], breaks[-1]].

    winners[i]: the row that is greatest between breaks[i] and breaks[i + 1]. Of a full turn breaks[-1] = breaks[0] + 2 pi.
    """

    waves: Array
    breaks: tuple[float, ...]
    winners: tuple[int, ...]

    def winner(self, angle: float) -> int:
        """The row that is greatest at an angle within the breaks, or a whole number of turns off."""
        angle = self.breaks[0] + (angle - self.breaks[0]) % TWO_PI
        at = int(np.searchsorted(self.breaks, angle, side="right")) - 1
        return self.winners[min(at, len(self.winners) - 1)]

    def value(self, angle: float, row: int | None = None) -> float:
        """The value at an angle: of a row, or of the greatest."""
        return float(wave_values(self.waves[self.winner(angle) if row is None else row], angle))

    def pieces(self, start: float, stop: float, splits: Sequence[float] = ()) -> list[tuple[float, float, int]]:
        """The parts (from, to, row) of [start, stop], cut at the breaks and at further angles modulo a turn."""
        inner = []
        own = self.breaks if len(self.winners) > 1 else ()  # a turn with one winner has no break where it begins
        for angle in (*own, *splits):
            moved = start + (angle - start) % TWO_PI
            if start + SAME_ANGLE < moved < stop - SAME_ANGLE:
                inner.append(moved)
        angles = _merge_angles([start, *sorted(inner), stop])
        return [(a, b, self.winner(0.5 * (a + b))) for a, b in zip(angles, angles[1:], strict=False)]


def wave_values(wave: Array, angle: float | Array) -> Array:
    """A cos phi + B sin phi + C."""
    return np.asarray(wave[0] * np.cos(angle) + wave[1] * np.sin(angle) + wave[2])


def find_envelope(waves: Array, start: float, stop: float) -> UpperEnvelope:
    """The upper envelope of functions (k, 3), of which equal ones are won by the first, on [start, stop]."""
    angles = [start, stop]
    for i in range(len(waves)):
        a, b, c = (waves[i] - waves[i + 1 :]).T
        size = np.hypot(a, b)
        crosses = (size > SAME_VALUE) & (np.abs(c) <= size)
        half = np.arccos(np.clip(-c[crosses] / size[crosses], -1, 1))
        middle = np.arctan2(b[crosses], a[crosses])
        angles += [start + (angle - start) % TWO_PI for angle in np.concatenate([middle - half, middle + half])]
    kept = _merge_angles(sorted(angle for angle in angles if start <= angle <= stop))
    middles = 0.5 * (np.array(kept[:-1]) + np.array(kept[1:]))
    values = waves[:, 0, None] * np.cos(middles) + waves[:, 1, None] * np.sin(middles) + waves[:, 2, None]
    top = values.max(axis=0)
    winners = np.argmax(values >= top - SAME_VALUE * (1 + np.abs(top)), axis=0).tolist()
    full = stop - start > TWO_PI - SAME_ANGLE
    breaks, rows = [kept[0]], [winners[0]]
    for angle, row in zip(kept[1:-1], winners[1:], strict=True):
        if row != rows[-1]:
            breaks.append(angle)
            rows.append(row)
    if full and len(rows) > 1:
        if rows[0] == rows[-1]:  # the turn begins within a piece
            breaks, rows = breaks[1:], rows[1:]
        return UpperEnvelope(waves, (*breaks, breaks[0] + TWO_PI), tuple(rows))
    return UpperEnvelope(waves, (*breaks, stop), tuple(rows))


def _merge_angles(angles: Sequence[float]) -> list[float]:
    """Ascending angles without those that equal their predecessor; both ends stay."""
    kept = [angles[0]]
    for angle in angles[1:-1]:
        if angle - kept[-1] > SAME_ANGLE and angles[-1] - angle > SAME_ANGLE:
            kept.append(angle)
    return [*kept, angles[-1]]


def border_waves(direction: Array, x_axis: Array, y_axis: Array, others: Array) -> Array:
    """The borders (k, 3) of a strut's cell towards struts along unit vectors (k, 3); e(phi) = cos phi x_axis + sin phi y_axis."""
    scale = 1.0 - others @ direction
    return np.column_stack([others @ x_axis / scale, others @ y_axis / scale, np.zeros(len(others))])


def plane_waves(direction: Array, x_axis: Array, y_axis: Array, normals: Array) -> Array:
    """The borders (k, 3) of a strut's end at planes through the node, with outward normals (k, 3), in none of which it lies."""
    scale = -normals @ direction
    return np.column_stack([normals @ x_axis / scale, normals @ y_axis / scale, np.zeros(len(normals))])


def find_sector(x_axis: Array, y_axis: Array, normals: Array) -> tuple[float, float]:
    """The angles phi, from and to, at which e(phi) points behind planes along the strut, of orthogonal normals (k, 3).

    A full turn from 0 if there are none, half a turn of one, a quarter of two.
    """
    if not len(normals):
        return 0.0, TWO_PI
    inwards = -normals.sum(axis=0)
    middle = float(np.arctan2(inwards @ y_axis, inwards @ x_axis))
    half = np.pi / 2 / len(normals)
    return middle - half, middle + half


def greatest_sum(first: UpperEnvelope, second: UpperEnvelope) -> float:
    """The greatest sum of two envelopes of the same sector: what two ends of a strut take of its length, in radii."""
    start, stop = first.breaks[0], first.breaks[-1]
    best = -np.inf
    for low, high, row in first.pieces(start, stop, second.breaks):
        wave = first.waves[row] + second.waves[second.winner(0.5 * (low + high))]
        crest = low + (np.arctan2(wave[1], wave[0]) - low) % TWO_PI
        angles = [low, high, *([crest] if crest < high else [])]
        best = max(best, *(float(wave_values(wave, angle)) for angle in angles))
    return best
