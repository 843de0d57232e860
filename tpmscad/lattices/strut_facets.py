"""The faces of round struts on a graph, one by one: parts of cylinders between two nodes, and parts of the balls at the nodes.

Each strut is a cylinder between the borders of its cells at both nodes (`strut_ends`), which are arcs of ellipses and circles;
where balls show, each strut bounds a part of the ball between its circle and the cells of its neighbours. Faces that close
on themselves are cut in two along the strut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.carriers import Carrier, Circle, CylindricalSurface, EdgeCurve, Ellipse, SphericalSurface
from tpmscad.brep.conics import TWO_PI
from tpmscad.lattices.strut_ends import (
    IN_PLANE,
    SAME_ANGLE,
    UpperEnvelope,
    border_waves,
    find_envelope,
    find_sector,
    plane_waves,
)
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve, line_segment
from tpmscad.splines.knots import greville_abscissae, uniform_knots

SAME_POINT = 1e-7
"""In radii: distance up to which vertices are one."""

PCURVE_TOL = 1e-10
"""In radii: greatest distance of a pcurve's image from its edge."""

PCURVE_DEGREE = 7
SPAN_COUNTS = (1, 2, 4, 8, 16, 32, 64, 128)


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """A use of an edge to be: the curve on its span, run backwards if `sense` is -1, and the pcurve on the same span."""

    curve: EdgeCurve
    span: tuple[float, float]
    sense: int
    pcurve: BSplineCurve | None

    def ends(self) -> Array:
        """Start, middle and end (3, 3) of the curve on its span."""
        return self.curve(np.array([self.span[0], 0.5 * sum(self.span), self.span[1]]))


@dataclass(frozen=True, slots=True, eq=False)
class Facet:
    """A face to be, in one loop, with the normal of its carrier."""

    carrier: Carrier
    loop: list[Side]


@dataclass(frozen=True, slots=True, eq=False)
class StrutEnd:
    """One end of a strut that starts in the origin: a frame about the strut, the borders of its cell, and where they are split.

    `sign`: +1 at the start, -1 at the end of the strut; `center`: the node. others: names of the other struts, which the first
    rows of both envelopes belong to. cylinder: the envelope of the cell, planes and the ball; `ball` is its row for the ball.
    border: the same without the ball, None if nothing bounds the ball. splits: further angles.
    """

    sign: int
    center: Array
    axis: Array
    x_axis: Array
    y_axis: Array
    others: tuple[int, ...]
    cylinder: UpperEnvelope
    border: UpperEnvelope | None
    ball: int
    splits: tuple[float, ...] = ()

    @property
    def direction(self) -> Array:
        """The unit vector along the strut, away from the node."""
        return self.sign * self.axis

    def across(self, angle: float) -> Array:
        """The unit vector across the strut."""
        return np.asarray(np.cos(angle) * self.x_axis + np.sin(angle) * self.y_axis)

    def angle_of(self, arm: Array) -> float:
        """The angle about the strut at which a point lies, given from the node."""
        return float(np.arctan2(arm @ self.y_axis, arm @ self.x_axis))


Star = tuple[Array, tuple[int, ...], Array]
"""The unit vectors (k, 3) of the other struts at a node, their names, and the outward normals (j, 3) of the sides it lies in."""


def make_strut_ends(
    along: Array, stars: tuple[Star, Star], radius: float, node_radius: float
) -> tuple[StrutEnd, StrutEnd]:
    """Both ends of a strut along a vector."""
    begin = float(np.sqrt(max((node_radius / radius) ** 2 - 1.0, 0.0)))
    axis = along / np.linalg.norm(along)
    x_axis = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    x_axis /= np.linalg.norm(x_axis)
    y_axis = np.cross(axis, x_axis)
    pair = []
    for sign, center, (directions, others, normals) in zip((+1, -1), (np.zeros(3), along), stars, strict=True):
        direction = sign * axis
        leaning = normals @ direction < -IN_PLANE
        borders = np.concatenate(
            [
                border_waves(direction, x_axis, y_axis, directions),
                plane_waves(direction, x_axis, y_axis, normals[leaning]),
            ]
        )
        start, stop = find_sector(x_axis, y_axis, normals[~leaning])
        cylinder = find_envelope(np.concatenate([borders, [[0.0, 0.0, begin]]]), start, stop)
        border = find_envelope(borders, start, stop) if len(borders) else None
        pair.append(StrutEnd(sign, center, axis, x_axis, y_axis, others, cylinder, border, len(borders)))
    return pair[0], pair[1]


def choose_cuts(pair: tuple[StrutEnd, StrutEnd]) -> tuple[float, ...]:
    """The angles at which a strut begins, is cut and ends: a sector, or a turn cut in two."""
    first = pair[0].cylinder.breaks
    start, stop = first[0], first[-1]
    if stop - start < TWO_PI - SAME_ANGLE:
        return start, stop
    known = [e.breaks[:-1] for end in pair for e in (end.cylinder, end.border) if e is not None and len(e.winners) > 1]
    angles = known[0] if known else (0.0,)
    opposite = [abs((angle - angles[0]) % TWO_PI - np.pi) for angle in angles]
    nearest = int(np.argmin(opposite))
    middle = angles[nearest] if opposite[nearest] < np.pi / 3 else angles[0] + np.pi
    return angles[0], angles[0] + (middle - angles[0]) % TWO_PI, angles[0] + TWO_PI


def find_border_arm(end: StrutEnd, angle: float, radius: float, node_radius: float, *, on_ball: bool) -> Array | None:
    """The point of a strut's border at an angle, from its node; of its part of the ball, None where that does not show."""
    if not on_ball:
        return np.asarray(radius * (end.across(angle) + end.cylinder.value(angle) * end.direction))
    if end.border is None or end.cylinder.winner(angle) != end.ball:
        return None
    arm = end.across(angle) + end.border.value(angle) * end.direction
    return np.asarray(node_radius * arm / np.linalg.norm(arm))


def find_neighbour(end: StrutEnd, angle: float, *, on_ball: bool) -> int | None:
    """The name of the strut on the other side of a strut's border at an angle; None at a plane or a ball."""
    envelope = end.border if on_ball else end.cylinder
    row = len(end.others) if envelope is None else envelope.winner(angle)
    return end.others[row] if row < len(end.others) else None


def bound_cylinder(pair: tuple[StrutEnd, StrutEnd], cuts: Sequence[float], radius: float) -> Iterator[Facet]:
    """The faces of one cylinder."""
    first = pair[0]
    carrier = CylindricalSurface(first.center, first.x_axis, first.axis, radius)
    length = float((pair[1].center - first.center) @ first.axis)
    for start, stop in pairwise(cuts):
        chains = [
            [
                _border_side(end, low, high, row, radius, length)
                for low, high, row in end.cylinder.pieces(start, stop, end.splits)
            ]
            for end in pair
        ]
        heights = [
            [radius * first.cylinder.value(a), length - radius * pair[1].cylinder.value(a)] for a in (start, stop)
        ]
        lower, upper = chains[0], [reverse_side(side) for side in reversed(chains[1])]
        rulings = []
        for angle, (low, high) in zip((start, stop), heights, strict=True):
            foot = first.center + radius * first.across(angle)
            line = line_segment(foot + low * first.axis, foot + high * first.axis, (low, high))
            rulings.append(Side(line, (low, high), 1, line_segment((angle, low), (angle, high), (low, high))))
        yield Facet(carrier, [*lower, rulings[1], *upper, reverse_side(rulings[0])])


def reverse_side(side: Side) -> Side:
    """The use of the same edge by the face on its other side."""
    return Side(side.curve, side.span, -side.sense, side.pcurve)


def _border_side(end: StrutEnd, low: float, high: float, row: int, radius: float, length: float) -> Side:
    """An arc of the border of a cylinder, in the direction of growing angles: of an ellipse or a circle."""
    a, b, c = end.cylinder.waves[row]
    steep = float(np.hypot(a, b))
    base = 0.0 if end.sign > 0 else length
    if steep < SAME_ANGLE:
        center = end.center + radius * c * end.direction
        height = base + end.sign * radius * c
        curve: EdgeCurve = Circle(center, end.x_axis, end.axis, radius)
        return Side(curve, (low, high), 1, line_segment((low, height), (high, height), (low, high)))
    phase = float(np.arctan2(b, a))
    major = end.across(phase) + steep * end.direction
    minor = end.across(phase + np.pi / 2)
    size = float(np.linalg.norm(major))
    curve = Ellipse(end.center, major / size, np.cross(major / size, minor), radius * size, radius)

    def place(t: Array) -> Array:
        return np.column_stack([t + phase, base + end.sign * radius * steep * np.cos(t)])

    def measure(uv: Array, t: Array) -> float:
        return float(np.abs(uv - place(t)).max() * max(1.0, radius))

    span = low - phase, high - phase
    return Side(curve, span, 1, _interpolate(place, span, measure, PCURVE_TOL * radius))


def bound_ball(end: StrutEnd, cuts: Sequence[float], radius: float, node_radius: float) -> Iterator[Facet]:
    """The faces of the part of a ball between a strut's circle and its neighbours, where the ball shows."""
    sphere = SphericalSurface(end.center, end.x_axis, end.axis, node_radius)
    begin = end.cylinder.waves[end.ball, 2]
    top = float(np.arctan2(begin, 1.0))  # latitude of the circle, towards the strut
    for start, stop in pairwise(cuts):
        shown = [(low, high) for low, high, row in end.cylinder.pieces(start, stop) if row == end.ball]
        for low, high in shown:
            circle = Circle(end.center + radius * begin * end.direction, end.x_axis, end.axis, radius)
            inner = end.cylinder.pieces(low, high, end.splits)
            upper = [
                Side(circle, (a, b), 1, line_segment((a, end.sign * top), (b, end.sign * top), (a, b)))
                for a, b, _ in inner
            ]
            if end.border is None:
                border = []
            else:
                border = [
                    _great_arc(end, sphere, a, b, row, node_radius)
                    for a, b, row in end.border.pieces(low, high, end.splits)
                ]
            meridians = [_meridian(end, sphere, angle, top, node_radius) for angle in (low, high)]
            # seen from outside, latitudes grow along the strut at its start, against it at its end
            if end.sign > 0:
                loop = [*border, *meridians[1], *map(reverse_side, reversed(upper)), *map(reverse_side, meridians[0])]
            else:
                loop = [*upper, *map(reverse_side, meridians[1]), *map(reverse_side, reversed(border)), *meridians[0]]
            yield Facet(sphere, loop)


def _meridian(end: StrutEnd, sphere: SphericalSurface, angle: float, top: float, node_radius: float) -> list[Side]:
    """The arc from the border of the ball to the strut's circle at an angle; none where they meet."""
    low = -np.pi / 2 if end.border is None else float(np.arctan2(end.border.value(angle), 1.0))
    if top - low < SAME_ANGLE:
        return []
    # the parameter is the latitude towards the strut
    across = end.across(angle)
    curve = Circle(end.center, across, np.cross(across, end.direction), node_radius)
    return [Side(curve, (low, top), 1, line_segment((angle, end.sign * low), (angle, end.sign * top), (low, top)))]


def _great_arc(end: StrutEnd, sphere: SphericalSurface, low: float, high: float, row: int, node_radius: float) -> Side:
    """An arc of a great circle that bounds a strut's part of a ball, in the direction of growing angles."""
    assert end.border is not None
    wave = end.border.waves[row]

    def direction(angle: float) -> Array:
        arm = end.across(angle) + (wave[0] * np.cos(angle) + wave[1] * np.sin(angle)) * end.direction
        return np.asarray(arm / np.linalg.norm(arm))

    first = direction(low)
    normal = np.cross(first, direction(0.5 * (low + high)))
    normal /= np.linalg.norm(normal)
    last = direction(high)
    turn = float(np.arctan2(last @ np.cross(normal, first), last @ first)) % TWO_PI
    curve = Circle(end.center, first, normal, node_radius)

    def place(t: Array) -> Array:
        uv = sphere.parameters(curve(t))
        guess = low + (high - low) * t / turn
        uv[:, 0] += TWO_PI * np.round((guess - uv[:, 0]) / TWO_PI)
        return uv

    def measure(uv: Array, t: Array) -> float:
        return float(np.linalg.norm(sphere(*uv.T) - curve(t), axis=1).max())

    return Side(curve, (0.0, turn), 1, _interpolate(place, (0.0, turn), measure, PCURVE_TOL * node_radius))


def _interpolate(
    place: Callable[[Array], Array], span: tuple[float, float], measure: Callable[[Array, Array], float], tol: float
) -> BSplineCurve:
    """The pcurve through points `place(t)` (n, 2), with as many spans as `measure(uv, t)` needs to be within tol."""
    low, length = span[0], span[1] - span[0]
    for count in SPAN_COUNTS:
        unit = _unit_interpolation(count)
        poles = unit.to_poles @ place(low + length * unit.sites)
        if measure(unit.to_checks @ poles, low + length * unit.checks) <= tol:
            break
    return BSplineCurve(poles, low + length * unit.knots, PCURVE_DEGREE)


class _UnitInterpolation(NamedTuple):
    """Splines on [0, 1]: knots, sites of interpolation, matrices from values there to poles, and from poles to checks."""

    knots: Array
    sites: Array
    to_poles: Array
    checks: Array
    to_checks: Array


@cache
def _unit_interpolation(count: int) -> _UnitInterpolation:
    """Interpolation by so many spans. To set it up for each pcurve took a quarter of the time of a foam of 941 struts."""
    knots = uniform_knots(count, PCURVE_DEGREE, domain=(0.0, 1.0))
    sites = greville_abscissae(knots, PCURVE_DEGREE)
    checks = np.linspace(0.0, 1.0, 5 * count + 8)
    to_poles = np.asarray(np.linalg.inv(design_matrix(knots, PCURVE_DEGREE, sites)), float)
    return _UnitInterpolation(knots, sites, to_poles, checks, design_matrix(knots, PCURVE_DEGREE, checks))
