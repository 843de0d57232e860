"""The rounding of an edge with a great radius for how far the surface may move, to either side.

The greater of two fields, max(f, g), is (f + g) / 2 + |f - g| / 2, and rounded with another even function of f - g in place of
the half of its size. Here its second derivative is constant about the edge, then falls to minus half of that and goes back to
nothing: the edge moves in and what is beside it moves out, so that the volume stays what it was. The radius is 1.7 times that of
a cubic which only cuts the edge off. (An arc that is a circle at the sharpest edge has a greater radius there, but a lesser one
where one side is less steep than the other.)

Edges of a blended field's solid, rounded: walls between two levels that are blended with something else end in edges.

A wall is the greater of two fields, max(f, g), and its crease {f = g} lies inside the wall. Mixed with another structure the wall
thins out, and where it is gone the crease lies on the surface, as a sharp edge. The edge is rounded so little that the surface
moves by less than is allowed, and within that with the greatest radius.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.interpolate import PPoly
from scipy.optimize import brentq

from tpmscad._typing import Array
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.errors import NotMet
from tpmscad.fields import Field
from tpmscad.fields.booleans import RoundedMinMaxField
from tpmscad.fields.field import MinMaxField

SECOND_DERIVATIVES = (1.0, 1.0, -0.5, 0.0)
"""The second derivative at the ends of the pieces, between which it is linear."""

MIN_EXTRA_STEEPNESS, MAX_EXTRA_STEEPNESS = 1e-3, 2.0
"""How much steeper than the fields' difference the rounding may be."""


@dataclass(frozen=True, slots=True, eq=False)
class RoundingProfile:
    """What is added to the greater of two fields that differ by s (in widths): cubics `pieces` (4, 3) between `knots` (4,) from 0
    to 1, zero beyond.

    `height` at the edge itself, `depth` below the greater beside it: both above zero.
    """

    knots: Array
    pieces: Array
    height: float
    depth: float

    def __call__(self, s: Array) -> tuple[Array, Array]:
        """The values at s >= 0, and the slopes."""
        i = np.minimum(np.searchsorted(self.knots, s, side="right"), 3) - 1
        c3, c2, c1, c0 = self.pieces[:, i]
        t = s - self.knots[i]
        inside = s < 1.0
        value, slope = ((c3 * t + c2) * t + c1) * t + c0, (3 * c3 * t + 2 * c2) * t + c1
        return np.where(inside, value, 0.0), np.where(inside, slope, 0.0)


@cache
def make_volume_neutral_profile() -> RoundingProfile:
    """The profile that adds as much as it takes away: the solid's volume stays, as far as its sides are straight."""

    def added(further: float) -> float:
        made = _make_profile(further)
        return float(PPoly(made.pieces, made.knots).integrate(0.0, 1.0))

    return _make_profile(float(brentq(added, MIN_EXTRA_STEEPNESS, MAX_EXTRA_STEEPNESS)))


def _make_profile(further: float) -> RoundingProfile:
    """Steeper by `further` times the slope of half the difference, somewhere."""
    turn = 0.5 * further
    knots = np.array([0.0, 0.5, 0.5 + 3 * turn, 0.5 + 6 * turn])
    width = float(knots[-1])
    bends = np.stack([np.diff(SECOND_DERIVATIVES) / np.diff(knots), SECOND_DERIVATIVES[:-1]])
    whole = PPoly(bends, knots).antiderivative(2)
    # nothing is left where the profile ends, neither value nor slope
    value, slope = float(whole(width)), float(whole(width, 1))
    pieces = whole.c.copy()
    pieces[2] -= slope
    pieces[3] -= value + slope * (knots[:-1] - width)
    pieces *= (width ** np.arange(3, -1, -1) / width)[:, None]
    made = PPoly(pieces, knots / width)
    lowest = made(made.derivative().roots(extrapolate=False)).min()
    return RoundingProfile(knots / width, pieces, float(made(0.0)), float(-lowest))


@dataclass(frozen=True, slots=True, eq=False)
class ProfileRoundedExtreme(RoundedMinMaxField):
    """The greater or lesser of two fields, rounded by a profile: twice continuously differentiable."""

    shape: RoundingProfile

    def profile(self, apart: Array) -> tuple[Array, Array]:
        return self.shape(apart)


MIN_PROBE_LINES = 64
"""Grid lines along the box's longest edge on which creases are looked for, at least."""

NEWTON_STEPS = 12
EDGE_TOL_FRACTION = 1e-7
"""Of the box's diagonal: how near to the edge its points are found."""

MIN_STRUCTURE_SHARE = 1e-3
"""Least share of a structure in the blend whose creases matter."""

SIDE_OFFSET_FRACTION = 1e-6
"""Of the edges' extent: how far beside them the slopes of their sides are taken."""

MAX_HALF_OPENING_RAD = 1.5
"""Half openings (radians) above which there is no edge to speak of."""

MAX_SCALINGS, MAX_SCALE_GROWTH, MIN_USED_FRACTION = 8, 4.0, 0.9
"""The rounding is scaled, by so many times at most from one try to the next, until the surface moves by at least this part of
what is allowed."""

SIDE_LEVELS_WIDTHS = (0.15, 0.3, 0.45, 0.6, 0.8)
"""Differences of a crease's two fields, in widths, at which it is measured how far the surface moves beside an edge."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeRounding:
    """The field with its edges rounded, and the greatest distance `moved` by which its level set moves.

    The sharpest edge: it opens by `opening` degrees at the point `near` and is rounded with about `radius`.
    """

    field: BlendedField
    moved: float
    near: Array
    opening: float
    radius: float


def round_edges(field: Field, lo: Array, hi: Array, allowed: float) -> EdgeRounding | None:
    """The field with edges of its solid in the box rounded, its level set within `allowed` of what it was; None if it has none.

    Measured at points of the edges, to first order along the rounded field's slope: nowhere else does the surface move further.
    """
    if not isinstance(field, BlendedField):
        return None
    creases = [node for structure in field.structures for node in _iterate_extremes(structure)]
    edges = [(node, p) for node in creases if len(p := _find_edge_points(field, node, lo, hi))]
    if not edges:
        return None
    points = np.concatenate([p for _, p in edges])
    halves = np.concatenate([_half_openings(field, node, p) for node, p in edges])
    shape = make_volume_neutral_profile()
    # of each crease a width in proportion to the slope across it: then all are rounded alike
    slopes = {id(node): 1.0 for node in creases} | {id(node): _median_crease_slope(node, p) for node, p in edges}
    scale = allowed / shape.depth
    best: tuple[BlendedField, float] | None = None
    for attempt in range(2 * MAX_SCALINGS):
        eased = _round_field(field, {key: scale * slope for key, slope in slopes.items()}, shape)
        beside = [_side_displacement(field, eased, node, p, scale * slopes[id(node)]) for node, p in edges]
        most = float(max(_edge_displacement(field, eased, points).max(), *(m.max(initial=0.0) for m in beside)))
        if most <= allowed and (best is None or most > best[1]):
            best = eased, most
        if best is not None and (best[1] >= MIN_USED_FRACTION * allowed or attempt >= MAX_SCALINGS):
            break
        scale *= min(MAX_SCALE_GROWTH, 0.5 * (1 + MIN_USED_FRACTION) * allowed / max(most, 1e-300))
    if best is None:
        where = ", ".join(f"{x:.5g}" for x in points[halves.argmin()])
        raise NotMet(
            f"the edge of a blended wall near ({where}) could not be rounded within {allowed:g}; use a larger tol"
        )
    sharp = int(halves.argmin())
    radius = (
        np.inf if halves[sharp] >= MAX_HALF_OPENING_RAD else _least_curvature_radius(best[0], points[sharp], allowed)
    )
    return EdgeRounding(best[0], best[1], points[sharp], float(np.degrees(2 * halves[sharp])), radius)


def _iterate_extremes(structure: Field) -> Iterator[MinMaxField]:
    if isinstance(structure, MinMaxField):
        yield structure
        yield from _iterate_extremes(structure.first)
        yield from _iterate_extremes(structure.second)


def _round_structure(structure: Field, widths: dict[int, float], shape: RoundingProfile) -> Field:
    if not isinstance(structure, MinMaxField):
        return structure
    first, second = _round_structure(structure.first, widths, shape), _round_structure(structure.second, widths, shape)
    return ProfileRoundedExtreme(first, second, structure.sign, widths[id(structure)], shape)


def _round_field(field: BlendedField, widths: dict[int, float], shape: RoundingProfile) -> BlendedField:
    return replace(
        field, structures=tuple(_round_structure(structure, widths, shape) for structure in field.structures)
    )


def _find_edge_points(field: BlendedField, node: MinMaxField, lo: Array, hi: Array) -> Array:
    """Points in the box where the crease lies on the surface (n, 3): {first = second} and {field = 0}.

    On the crease the field's slope is that of one side; the edge is followed on that side's smooth continuation of the mean.
    """
    counts = np.maximum(8, np.ceil(MIN_PROBE_LINES * (hi - lo) / (hi - lo).max())).astype(int)
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(lo, hi, counts, strict=True)]
    crease = node.first - node.second
    step = float(((hi - lo) / counts).max())
    value, slope = crease.value_and_gradient_on_grid(*axes)
    near = np.abs(value) <= step * np.linalg.norm(slope, axis=-1)
    points = np.stack([axis[i] for axis, i in zip(axes, np.nonzero(near), strict=True)], axis=-1)
    value, slope = field.value_and_gradient(points)
    points = start = points[np.abs(value) <= 4 * step * np.linalg.norm(slope, axis=1)]
    if not len(points):
        return points
    # one width for all, small next to the box: a smooth field of the same crease points
    tiny = 1e-6 * step * float(np.median(np.linalg.norm(crease.gradient(points), axis=1)))
    shape = make_volume_neutral_profile()
    smooth = _round_field(field, {id(e): tiny for s in field.structures for e in _iterate_extremes(s)}, shape)
    for _ in range(NEWTON_STEPS):
        d, across = crease.value_and_gradient(points)
        # on the crease itself both sides share in the slope
        points = points - (d / np.maximum((across**2).sum(axis=1), 1e-300))[:, None] * across
        f, slope = smooth.value_and_gradient(points)
        across = crease.gradient(points)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        slope -= (slope * across).sum(axis=1, keepdims=True) * across
        move = -(f / np.maximum((slope**2).sum(axis=1), 1e-300))[:, None] * slope
        length = np.linalg.norm(move, axis=1)
        points = points + np.minimum(1.0, step / np.maximum(length, 1e-300))[:, None] * move
        points = np.clip(points, lo - step, hi + step)
    diagonal = float(np.linalg.norm(hi - lo))
    d, across = crease.value_and_gradient(points)
    f, slope = smooth.value_and_gradient(points)
    on = (np.abs(d) <= EDGE_TOL_FRACTION * diagonal * np.linalg.norm(across, axis=1)) & (
        length <= EDGE_TOL_FRACTION * diagonal
    )
    on &= np.abs(f) <= EDGE_TOL_FRACTION * diagonal * np.linalg.norm(slope, axis=1)
    on &= ((points >= lo) & (points <= hi)).all(axis=1) & (np.linalg.norm(points - start, axis=1) < 6 * step)
    # a structure that has no part in the blend there has no edges there
    on &= np.abs(smooth(points) - field(points)) >= MIN_STRUCTURE_SHARE * tiny * shape.height
    return points[on]


def _median_crease_slope(node: MinMaxField, points: Array) -> float:
    """The usual slope across a crease."""
    return float(np.median(np.linalg.norm((node.first - node.second).gradient(points), axis=1)))


def _edge_displacement(field: BlendedField, eased: BlendedField, points: Array) -> Array:
    """How far the level set moves at points of the edges, to first order: (n,)."""
    value, slope = eased.value_and_gradient(points)
    return np.abs(value - field(points)) / np.maximum(np.linalg.norm(slope, axis=1), 1e-300)


def _side_displacement(
    field: BlendedField, eased: BlendedField, node: MinMaxField, points: Array, width: float
) -> Array:
    """How far the level set moves beside points of a crease's edges, on both sides of it: (n,)."""
    crease = node.first - node.second
    starts = []
    for level in SIDE_LEVELS_WIDTHS:
        for way in (1, -1):
            beside = points
            for _ in range(4):
                d, across = crease.value_and_gradient(beside)
                f, slope = field.value_and_gradient(beside)
                system = np.stack([across, slope], axis=1)
                wanted = np.stack([way * level * width - d, -f], axis=1)
                beside = beside + np.einsum("nij,nj->ni", np.linalg.pinv(system), wanted)
            starts.append(beside[np.abs(crease(beside) - way * level * width) < 0.1 * width])
    return _edge_displacement(field, eased, np.concatenate(starts))


def _least_curvature_radius(field: Field, point: Array, step: float) -> float:
    """The least radius of curvature of the field's level set near a point, by differences over a tenth of `step`."""
    p = point[None]
    for _ in range(NEWTON_STEPS):
        f, slope = field.value_and_gradient(p)
        p = p - (f / np.maximum((slope**2).sum(axis=1), 1e-300))[:, None] * slope
    h = 0.1 * step
    slope = field.gradient(p)[0]
    length = float(np.linalg.norm(slope))
    normal = slope / length
    bend = np.stack([(field.gradient(p + h * e) - field.gradient(p - h * e))[0] / (2 * h) for e in np.eye(3)], axis=-1)
    across = np.eye(3) - np.outer(normal, normal)
    return length / max(float(np.linalg.norm(across @ bend @ across, ord=2)), 1e-300)


def _half_openings(field: BlendedField, node: MinMaxField, points: Array) -> Array:
    """Half the angles in which the solid's sides meet at points of its edges (n,), in radians."""
    across = (node.first - node.second).gradient(points)
    across *= (
        SIDE_OFFSET_FRACTION
        * float(np.ptp(points, axis=0).max(initial=0.0))
        / np.linalg.norm(across, axis=1, keepdims=True)
    )
    one, other = (field.gradient(points + way * across) for way in (1, -1))
    cosine = (one * other).sum(axis=1) / (np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1))
    return np.asarray(0.5 * (np.pi - np.arccos(np.clip(cosine, -1.0, 1.0))))
