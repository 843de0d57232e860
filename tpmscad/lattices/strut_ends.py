"""The ends of round struts that meet in a node, as functions of the angle about each strut.

A node is a ball of radius R in which cones begin that touch a common ball, of radius r <= R, about the same centre; cylinders
are cones that do not widen. Cone i runs along the unit vector d_i, and widens by the sine s_i of its half-angle, whose cosine is
c_i. With e(phi) a unit vector across it, its points are

    r ((c_i e - s_i d_i) + T (c_i d_i + s_i e)),        T = (p . d_i + r s_i) / (r c_i),

where r T is the length along its generators from the circle in which it touches the ball. Two such cones meet in a plane, since
both touch one ball (a theorem of Monge): in that of equal T. Seen from the node the farthest cone is that of the greatest T, and
the ball shows where no T exceeds ((R / r)^2 - 1)^(1/2). On generator phi of cone i the plane N . p = c cuts

    w = T / (1 + T s_i / c_i) = (c / r - N . n(phi)) / (N . d_i / c_i + c s_i / (r c_i)),        n = c_i e - s_i d_i,

which grows with T and is a function A cos phi + B sin phi + C; towards cone j it is

    w = c_i (c_i e . d_j - s_i d_i . d_j + s_j) / (c_i c_j + s_i s_j - d_i . d_j).

A plane through the node with the outward normal n, behind which all struts lie, is the same with N = n and c = 0. Thus an end is
the upper envelope of such functions. On the ball the same planes cut circles, whose latitudes over phi have an envelope, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple, Protocol

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.conics import TWO_PI
from tpmscad.errors import TrimmingError

SAME_ANGLE = 1e-7
"""Radians up to which breaks of an envelope are one: on a strut of 1 mm the kernel's tolerance, 1e-7 mm, is 2e-7."""

SAME_VALUE = 1e-9
"""Relative difference of functions that are equal: the first one counts."""

IN_PLANE = 1e-9
"""Sine of the angle between a strut and a plane up to which the strut lies in it."""

LEAST_OPENING = 1e-6
"""How far the cosine of the angle between two struts must stay below that of the difference of their half-angles: beyond that one
cone lies within the other."""


class Curves(Protocol):
    """Functions of an angle, by number."""

    def values(self, angles: Array) -> Array:
        """Of all functions at angles (n,): (k, n)."""
        ...

    def crossings(self) -> Array:
        """Angles at which two functions may be equal: all of them, and others."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """The functions A cos phi + B sin phi + C, rows (k, 3)."""

    rows: Array

    def values(self, angles: Array) -> Array:
        """See `Curves`."""
        return np.asarray(self.rows @ np.stack([np.cos(angles), np.sin(angles), np.ones_like(angles)]))

    def crossings(self) -> Array:
        """See `Curves`."""
        i, j = np.triu_indices(len(self.rows), 1)
        a, b, c = (self.rows[i] - self.rows[j]).T
        size = np.hypot(a, b)
        crosses = (size > SAME_VALUE) & (np.abs(c) <= size)
        half = np.arccos(np.clip(-c[crosses] / size[crosses], -1, 1))
        middle = np.arctan2(b[crosses], a[crosses])
        return np.concatenate([middle - half, middle + half])


@dataclass(frozen=True, slots=True, eq=False)
class BallArcs:
    """Latitudes on the unit sphere at which planes (k, 4), A x + B y + C z = D of a frame with z along the strut, end its region.

    The region is where A x + B y + C z < D, and C < 0.
    """

    planes: Array

    def values(self, angles: Array) -> Array:
        """See `Curves`; a plane that misses a meridian is at one of its poles."""
        a, b, c, d = (column[:, None] for column in self.planes.T)
        across = a * np.cos(angles) + b * np.sin(angles)
        turn, size = np.arctan2(c, across), np.hypot(c, across)
        latitude = turn + np.arccos(np.clip(d / size, -1, 1))
        missed = np.where(d > 0, -np.pi / 2, np.pi / 2)
        return np.where(np.abs(d) > size, missed, np.clip(latitude, -np.pi / 2, np.pi / 2))

    def crossings(self) -> Array:
        """See `Curves`: the meridians of the points where two planes meet on the sphere."""
        found = []
        for first, second in combinations(self.planes, 2):
            m, n = first[:3], second[:3]
            along, mm, nn, mn = np.cross(m, n), m @ m, n @ n, m @ n
            square = along @ along
            if square <= SAME_VALUE**2 * mm * nn:
                continue
            foot = ((first[3] * nn - second[3] * mn) * m + (second[3] * mm - first[3] * mn) * n) / square
            rest = 1 - foot @ foot
            if rest < 0:
                continue
            for point in (foot + np.sqrt(rest / square) * along, foot - np.sqrt(rest / square) * along):
                found.append(float(np.arctan2(point[1], point[0])))
        return np.array(found)


@dataclass(frozen=True, slots=True, eq=False)
class UpperEnvelope:
    """The greatest of some functions of an angle on [breaks[0], breaks[-1]].

    winners[i]: the one that is greatest between breaks[i] and breaks[i + 1]. Of a full turn breaks[-1] = breaks[0] + 2 pi.
    """

    curves: Curves
    breaks: tuple[float, ...]
    winners: tuple[int, ...]

    def winner(self, angle: float) -> int:
        """The function that is greatest at an angle within the breaks, or a whole number of turns off."""
        angle = self.breaks[0] + (angle - self.breaks[0]) % TWO_PI
        at = int(np.searchsorted(self.breaks, angle, side="right")) - 1
        return self.winners[min(at, len(self.winners) - 1)]

    def value(self, angle: float, row: int | None = None) -> float:
        """The value at an angle: of a function, or of the greatest."""
        return float(self.curves.values(np.array([angle]))[self.winner(angle) if row is None else row, 0])

    def pieces(self, start: float, stop: float, splits: Sequence[float] = ()) -> list[tuple[float, float, int]]:
        """The parts (from, to, function) of [start, stop], cut at the breaks and at further angles modulo a turn."""
        inner = []
        own = self.breaks if len(self.winners) > 1 else ()  # a turn with one winner has no break where it begins
        for angle in (*own, *splits):
            moved = start + (angle - start) % TWO_PI
            if start + SAME_ANGLE < moved < stop - SAME_ANGLE:
                inner.append(moved)
        angles = _merge_angles([start, *sorted(inner), stop])
        return [(a, b, self.winner(0.5 * (a + b))) for a, b in zip(angles, angles[1:], strict=False)]


def find_envelope(curves: Curves, start: float, stop: float) -> UpperEnvelope:
    """The upper envelope of functions, of which equal ones are won by the first, on [start, stop]."""
    found = start + (curves.crossings() - start) % TWO_PI
    kept = _merge_angles([start, *np.sort(found[found <= stop]).tolist(), stop])
    middles = 0.5 * (np.array(kept[:-1]) + np.array(kept[1:]))
    values = curves.values(middles)
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
        return UpperEnvelope(curves, (*breaks, breaks[0] + TWO_PI), tuple(rows))
    return UpperEnvelope(curves, (*breaks, stop), tuple(rows))


def _merge_angles(angles: Sequence[float]) -> list[float]:
    """Ascending angles without those that equal their predecessor; both ends stay."""
    kept = [angles[0]]
    for angle in angles[1:-1]:
        if angle - kept[-1] > SAME_ANGLE and angles[-1] - angle > SAME_ANGLE:
            kept.append(angle)
    return [*kept, angles[-1]]


class Star(NamedTuple):
    """What bounds the end of a strut in its node.

    directions (k, 3) and sines (k,) of the other struts there; names: their names; normals (j, 3): outward, of the sides of the
    box that the node lies in. sine: of the strut itself. radius: of the ball that the cones touch; ball: of the ball that shows.
    """

    directions: Array
    sines: Array
    names: tuple[int, ...]
    normals: Array
    sine: float
    radius: float
    ball: float


@dataclass(frozen=True, slots=True, eq=False)
class EndFrame:
    """Unit vectors of an end: along the strut, away from the node, and two across it."""

    direction: Array
    x_axis: Array
    y_axis: Array

    def bound_by(self, star: Star, normals: Array) -> tuple[Waves, BallArcs]:
        """The borders of the cell of a strut towards the others, and towards planes of normals (j, 3): on it, and on the ball."""
        own, others, s = star.sine, star.sines, star.directions @ self.direction
        cosine, cosines = np.sqrt(1 - own**2), np.sqrt(1 - others**2)
        opening = cosine * cosines + own * others - s
        planes = star.directions / cosines[:, None] - self.direction / cosine
        if min(opening.min(initial=1.0), -(planes @ self.direction).max(initial=-1.0)) < LEAST_OPENING:
            raise TrimmingError("struts leave a node in nearly one direction, so that one of them lies in the other")
        across = np.stack([self.x_axis, self.y_axis])
        level = (cosine / opening)[:, None]
        to_struts = np.column_stack([level * cosine * (star.directions @ across.T), level[:, 0] * (others - own * s)])
        away = normals @ self.direction
        to_planes = np.column_stack(
            [-(cosine**2) * (normals @ across.T) / away[:, None], own * cosine * np.ones(len(normals))]
        )
        frame = np.stack([self.x_axis, self.y_axis, self.direction])
        offset = (own / cosine - others / cosines) * star.radius / max(star.ball, star.radius)
        arcs = np.column_stack(
            [np.concatenate([planes, normals]) @ frame.T, np.concatenate([offset, np.zeros(len(normals))])]
        )
        return Waves(np.concatenate([to_struts, to_planes])), BallArcs(arcs)


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
