"""The faces of round struts on a graph, one by one: parts of cones between two nodes, and parts of the balls at the nodes.

Each strut is a cylinder or a cone between the borders of its cells at both nodes (`strut_ends`), which are arcs of ellipses and
circles; where balls show, each strut bounds a part of the ball between its circle and the cells of its neighbours. Faces that
close on themselves are cut in two along the strut.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.carriers import (
    Carrier,
    Circle,
    ConicalSurface,
    CylindricalSurface,
    EdgeCurve,
    Ellipse,
    Plane,
    SphericalSurface,
)
from tpmscad.brep.conics import TWO_PI
from tpmscad.errors import TrimmingError
from tpmscad.lattices.strut_ends import (
    IN_PLANE,
    SAME_ANGLE,
    BallArcs,
    EndFrame,
    Star,
    UpperEnvelope,
    Waves,
    find_envelope,
    find_sector,
)
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve, line_segment
from tpmscad.splines.knots import greville_abscissae, uniform_knots

SAME_POINT = 1e-7
"""In the least radii: distance up to which vertices are one."""

PCURVE_TOL = 1e-10
"""In radii: greatest distance of a pcurve's image from its edge."""

SAMPLES_PER_PIECE = 17
"""Angles in each piece at which the ends of a cone are compared."""

LEAST_REST = 1e-3
"""Share of the distance from its apex at which a generator of a widening cone still ends: beyond, borders are far away."""

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

    `sign`: +1 at the start, -1 at the end of the strut; `center`: the node; star: what is there. cone: the envelope of the cell,
    of planes and the ball, in `Waves`; `ball` is its row for the ball; the first rows belong to the other struts. border: the
    latitudes on the ball at which the cell ends, None if nothing bounds it. splits: further angles.
    """

    sign: int
    center: Array
    axis: Array
    x_axis: Array
    y_axis: Array
    star: Star
    cone: UpperEnvelope
    border: UpperEnvelope | None
    ball: int
    splits: tuple[float, ...] = ()

    @property
    def direction(self) -> Array:
        """The unit vector along the strut, away from the node."""
        return self.sign * self.axis

    @property
    def cosine(self) -> float:
        """Of the half-angle of the cone."""
        return math.sqrt(1 - self.star.sine**2)

    def across(self, angle: float) -> Array:
        """The unit vector across the strut."""
        return np.asarray(np.cos(angle) * self.x_axis + np.sin(angle) * self.y_axis)

    def angle_of(self, arm: Array) -> float:
        """The angle about the strut at which a point lies, given from the node."""
        return float(np.arctan2(arm @ self.y_axis, arm @ self.x_axis))

    def length_of(self, wave: Array) -> Array:
        """The length along generators, from the circle where the cone touches its ball, at values of waves."""
        rest = 1 - wave * (self.star.sine / self.cosine)
        if (rest <= LEAST_REST).any():
            raise TrimmingError("struts that widen leave a node so nearly side by side that their cones do not part")
        return np.asarray(self.star.radius * wave / rest)

    def place(self, angle: float, length: float) -> Array:
        """The arm from the node to the point of the cone at a length along a generator."""
        sine, cosine, radius = self.star.sine, self.cosine, self.star.radius
        aside, ahead = cosine * radius + sine * length, cosine * length - sine * radius
        return np.asarray(aside * self.across(angle) + ahead * self.direction)

    def reach(self, angle: float, row: int | None = None) -> float:
        """The length along the generator at an angle at which the cell ends, or at which it meets one of its bounds."""
        return float(self.length_of(np.array(self.cone.value(angle, row))))

    def reaches(self, angles: Array) -> Array:
        """The same at many angles (n,) within the breaks."""
        return self.length_of(self.cone.curves.values(angles).max(axis=0))


def make_strut_ends(along: Array, stars: tuple[Star, Star]) -> tuple[StrutEnd, StrutEnd]:
    """Both ends of a strut along a vector."""
    axis = along / np.linalg.norm(along)
    x_axis = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis).round(6)))])  # the same for parts of a strut
    x_axis /= np.linalg.norm(x_axis)
    y_axis = np.cross(axis, x_axis)
    pair = []
    for sign, center, star in zip((+1, -1), (np.zeros(3), along), stars, strict=True):
        frame = EndFrame(sign * axis, x_axis, y_axis)
        leaning = star.normals @ frame.direction < -IN_PLANE
        waves, arcs = frame.bound_by(star, star.normals[leaning])
        start, stop = find_sector(x_axis, y_axis, star.normals[~leaning])
        begin = math.sqrt(max((star.ball / star.radius) ** 2 - 1.0, 0.0))  # of the ball, along generators, in radii
        begin /= 1 + begin * star.sine / math.sqrt(1 - star.sine**2)
        cone = find_envelope(Waves(np.concatenate([waves.rows, [[0.0, 0.0, begin]]])), start, stop)
        border = find_envelope(arcs, start, stop) if len(arcs.planes) else None
        pair.append(StrutEnd(sign, center, axis, x_axis, y_axis, star, cone, border, len(waves.rows)))
    return pair[0], pair[1]


def measure_overlap(first: StrutEnd, second: StrutEnd, length: float) -> float:
    """The greatest part of its generators that both ends of a strut of a length between its nodes take."""
    start, stop = first.cone.breaks[0], first.cone.breaks[-1]
    best = -np.inf
    for low, high, _ in first.cone.pieces(start, stop, second.cone.breaks):
        angles = np.linspace(low, high, SAMPLES_PER_PIECE)
        if first.star.sine == 0:
            rows = [end.cone.winner(0.5 * (low + high)) for end in (first, second)]
            assert isinstance(first.cone.curves, Waves)
            assert isinstance(second.cone.curves, Waves)
            wave = first.cone.curves.rows[rows[0]] + second.cone.curves.rows[rows[1]]
            crest = low + (np.arctan2(wave[1], wave[0]) - low) % TWO_PI
            angles = np.array([low, high, *([crest] if crest < high else [])])
        best = max(best, float((first.reaches(angles) + second.reaches(angles)).max()))
    return best / (length * first.cosine)


def choose_cuts(pair: tuple[StrutEnd, StrutEnd]) -> tuple[float, ...]:
    """The angles at which a strut begins, is cut and ends: a sector, or a turn cut in two."""
    first = pair[0].cone.breaks
    start, stop = first[0], first[-1]
    if stop - start < TWO_PI - SAME_ANGLE:
        return start, stop
    if not min(end.star.ball for end in pair):  # where a part ends in a disc, others of the strut are cut alike
        return 0.0, np.pi, TWO_PI
    known = [e.breaks[:-1] for end in pair for e in (end.cone, end.border) if e is not None and len(e.winners) > 1]
    angles = known[0] if known else (0.0,)
    opposite = [abs((angle - angles[0]) % TWO_PI - np.pi) for angle in angles]
    nearest = int(np.argmin(opposite))
    middle = angles[nearest] if opposite[nearest] < np.pi / 3 else angles[0] + np.pi
    return angles[0], angles[0] + (middle - angles[0]) % TWO_PI, angles[0] + TWO_PI


def find_border_arm(end: StrutEnd, angle: float, *, on_ball: bool) -> Array | None:
    """The point of a strut's border at an angle, from its node; of its part of the ball, None where that does not show."""
    if not on_ball:
        return end.place(angle, end.reach(angle))
    if end.border is None or end.cone.winner(angle) != end.ball:
        return None
    return end.star.ball * _aim(end, angle, end.border.value(angle))


def _aim(end: StrutEnd, angle: float, latitude: float) -> Array:
    """The unit vector from a node at a latitude towards the strut."""
    return np.asarray(math.cos(latitude) * end.across(angle) + math.sin(latitude) * end.direction)


def find_neighbour(end: StrutEnd, angle: float, *, on_ball: bool) -> int | None:
    """The name of the strut on the other side of a strut's border at an angle; None at a plane or a ball."""
    envelope = end.border if on_ball else end.cone
    row = len(end.star.names) if envelope is None else envelope.winner(angle)
    return end.star.names[row] if row < len(end.star.names) else None


def bound_cone(pair: tuple[StrutEnd, StrutEnd], cuts: Sequence[float]) -> Iterator[Facet]:
    """The faces of one cylinder or cone, whose v is the length along generators from where it touches the ball at its start."""
    first, last = pair
    radius, sine = first.star.radius, first.star.sine
    origin = first.center - radius * sine * first.axis
    carrier: CylindricalSurface | ConicalSurface = CylindricalSurface(origin, first.x_axis, first.axis, radius)
    if sine:
        carrier = ConicalSurface(origin, first.x_axis, first.axis, radius * first.cosine, math.asin(sine))
    length = float((last.center - first.center) @ first.axis) * first.cosine
    for start, stop in pairwise(cuts):
        chains = [
            [_border_side(end, low, high, row, length) for low, high, row in end.cone.pieces(start, stop, end.splits)]
            for end in pair
        ]
        lower, upper = chains[0], [reverse_side(side) for side in reversed(chains[1])]
        rulings = []
        for angle in (start, stop):
            low, high = first.reach(angle), length - last.reach(angle)
            line = line_segment(carrier(angle, low), carrier(angle, high), (low, high))
            rulings.append(Side(line, (low, high), 1, line_segment((angle, low), (angle, high), (low, high))))
        yield Facet(carrier, [*lower, rulings[1], *upper, reverse_side(rulings[0])])


def reverse_side(side: Side) -> Side:
    """The use of the same edge by the face on its other side."""
    return Side(side.curve, side.span, -side.sense, side.pcurve)


def _border_side(end: StrutEnd, low: float, high: float, row: int, length: float) -> Side:
    """An arc of the border of a cone, in the direction of growing angles: of an ellipse or a circle."""
    curves = end.cone.curves
    assert isinstance(curves, Waves)
    a, b, _ = curves.rows[row].tolist()
    base, radius = (0.0 if end.sign > 0 else length), end.star.radius
    if math.hypot(a, b) < SAME_ANGLE:
        reach = end.reach(low, row)
        arm = end.place(0.0, reach)
        ahead = float(arm @ end.direction)
        circle = Circle(end.center + ahead * end.direction, end.x_axis, end.axis, float(arm @ end.across(0.0)))
        height = base + end.sign * reach
        return Side(circle, (low, high), 1, line_segment((low, height), (high, height), (low, high)))
    phase = math.atan2(b, a)
    # the section is symmetric about the plane of the axis and the phase, where its vertices lie
    near, far = (end.place(angle, end.reach(angle, row)) for angle in (phase, phase + math.pi))
    center, major = 0.5 * (near + far), 0.5 * float(np.linalg.norm(near - far))
    x_axis, y_axis = (near - far) / (2 * major), end.across(phase + math.pi / 2)
    side = end.place(phase + math.pi / 2, end.reach(phase + math.pi / 2, row)) - center
    minor = float(side @ y_axis) / math.sqrt(1 - (float(side @ x_axis) / major) ** 2)
    curve = Ellipse(end.center + center, x_axis, np.cross(x_axis, y_axis), major, minor)

    def parameter(angle: float) -> float:
        arm = end.place(angle, end.reach(angle, row)) - center
        t = math.atan2(float(arm @ y_axis) / minor, float(arm @ x_axis) / major)
        return t + TWO_PI * round((angle - phase - t) / TWO_PI)

    def place(t: Array) -> Array:
        arms = curve(t) - end.center
        angles = np.arctan2(arms @ end.y_axis, arms @ end.x_axis)
        angles += TWO_PI * np.round((t + phase - angles) / TWO_PI)
        return np.column_stack([angles, base + end.sign * end.length_of(curves.values(angles)[row])])

    def measure(uv: Array, t: Array) -> float:
        return float(np.abs(uv - place(t)).max() * max(1.0, radius))

    span = parameter(low), parameter(high)
    return Side(curve, span, 1, _interpolate(place, span, measure, PCURVE_TOL * radius))


def bound_ball(end: StrutEnd, cuts: Sequence[float]) -> Iterator[Facet]:
    """The faces of a ball between a strut's circle and its neighbours, where the ball shows; without a ball, a disc."""
    radius = end.star.ball
    arm = end.place(0.0, end.reach(0.0, end.ball))
    ahead, aside = float(arm @ end.direction), float(arm @ end.across(0.0))
    top = math.atan2(ahead, aside)  # latitude of the circle, towards the strut
    circle = Circle(end.center + ahead * end.direction, end.x_axis, end.axis, aside)
    if not radius:
        arcs = [Side(circle, (a, b), 1, None) for a, b, _ in end.cone.pieces(cuts[0], cuts[-1], (*cuts, *end.splits))]
        disc = Plane(end.center + ahead * end.direction, end.x_axis, -end.direction)
        yield Facet(disc, arcs if end.sign < 0 else [reverse_side(arc) for arc in reversed(arcs)])
        return
    sphere = SphericalSurface(end.center, end.x_axis, end.axis, radius)
    for start, stop in pairwise(cuts):
        shown = [(low, high) for low, high, row in end.cone.pieces(start, stop) if row == end.ball]
        for low, high in shown:
            inner = end.cone.pieces(low, high, end.splits)
            upper = [
                Side(circle, (a, b), 1, line_segment((a, end.sign * top), (b, end.sign * top), (a, b)))
                for a, b, _ in inner
            ]
            if end.border is None:
                border = []
            else:
                border = [_ball_arc(end, sphere, a, b, row) for a, b, row in end.border.pieces(low, high, end.splits)]
            meridians = [_meridian(end, angle, top) for angle in (low, high)]
            # seen from outside, latitudes grow along the strut at its start, against it at its end
            if end.sign > 0:
                loop = [*border, *meridians[1], *map(reverse_side, reversed(upper)), *map(reverse_side, meridians[0])]
            else:
                loop = [*upper, *map(reverse_side, meridians[1]), *map(reverse_side, reversed(border)), *meridians[0]]
            yield Facet(sphere, loop)


def _meridian(end: StrutEnd, angle: float, top: float) -> list[Side]:
    """The arc from the border of the ball to the strut's circle at an angle; none where they meet."""
    low = -math.pi / 2 if end.border is None else end.border.value(angle)
    if top - low < SAME_ANGLE:
        return []
    # the parameter is the latitude towards the strut
    across = end.across(angle)
    curve = Circle(end.center, across, np.cross(across, end.direction), end.star.ball)
    return [Side(curve, (low, top), 1, line_segment((angle, end.sign * low), (angle, end.sign * top), (low, top)))]


def _ball_arc(end: StrutEnd, sphere: SphericalSurface, low: float, high: float, row: int) -> Side:
    """An arc of a circle that bounds a strut's part of a ball, in the direction of growing angles."""
    assert end.border is not None
    border, radius = end.border, end.star.ball
    assert isinstance(border.curves, BallArcs)
    *plane, offset = border.curves.planes[row].tolist()
    normal = np.array(plane) @ np.stack([end.x_axis, end.y_axis, end.direction])
    center = radius * offset * normal / (normal @ normal)

    def arm(angle: float) -> Array:
        return np.asarray(radius * _aim(end, angle, border.value(angle, row)) - center)

    first, last = arm(low), arm(high)
    size = float(np.linalg.norm(first))
    first = first / size
    axis = np.cross(first, arm(0.5 * (low + high)))
    axis /= np.linalg.norm(axis)
    turn = float(np.arctan2(last @ np.cross(axis, first), last @ first)) % TWO_PI
    curve = Circle(end.center + center, first, axis, size)

    def place(t: Array) -> Array:
        uv = sphere.parameters(curve(t))
        guess = low + (high - low) * t / turn
        uv[:, 0] += TWO_PI * np.round((guess - uv[:, 0]) / TWO_PI)
        return uv

    def measure(uv: Array, t: Array) -> float:
        return float(np.linalg.norm(sphere(*uv.T) - curve(t), axis=1).max())

    return Side(curve, (0.0, turn), 1, _interpolate(place, (0.0, turn), measure, PCURVE_TOL * radius))


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
