"""Rounding of the sharp edges of the solid of a blended field, before patches are fitted to it.

A wall between two levels is the maximum of two fields, max(f, g), whose crease {f = g} lies inside the wall. Blended with another
structure the wall thins out, and where it ends the crease lies on the surface, as a sharp edge that no smooth patch can follow.

The maximum is (f + g) / 2 + |f - g| / 2. It is rounded by another even function of f - g in place of |f - g| / 2. The second
derivative of this profile is constant about the edge, falls to minus half of that, and returns to zero: the edge moves inwards,
the surface beside it outwards, and the volume stays the same to first order. Its radius at the edge is 1.7 times that of a cubic
profile that only cuts the edge off. (A profile that is a circular arc at the sharpest edge has a greater radius there, but a
smaller one where one side is less steep than the other.)

The width of the profile is scaled until the surface moves by nearly as much as is allowed, which gives the greatest radius.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.interpolate import PPoly
from scipy.optimize import brentq

from tpmscad._typing import Array
from tpmscad.errors import NotMet, format_point
from tpmscad.fields.field import CompositeField, Field, MinMaxField
from tpmscad.fields.kinds.booleans import RoundedMinMaxField
from tpmscad.fields.tape.tape_nodes import Node, piecewise_polynomial
from tpmscad.levelset.boundary_level_sets import measure_shape_operators
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR

SECOND_DERIVATIVES = (1.0, 1.0, -0.5, 0.0)
"""Second derivative of the profile at its knots, linear in between, before it is scaled."""

MIN_EXTRA_STEEPNESS, MAX_EXTRA_STEEPNESS = 1e-3, 2.0
"""Bracket of the profile's extra steepness (see `_make_profile`)."""


@dataclass(frozen=True, slots=True, eq=False)
class RoundingProfile:
    """What is added to the maximum of two fields that differ by s widths: cubics `pieces` (4, 3) on `knots` (4,), zero beyond 1.

    `height` is the value at the edge itself, `depth` the greatest amount below the maximum beside it; both are positive.
    """

    knots: Array
    pieces: Array
    height: float
    depth: float

    def trace(self, separation: Node) -> Node:
        """The profile at a separation of at least 0, on the nodes of a tape."""
        knots, pieces = np.append(self.knots, np.inf), np.column_stack([self.pieces, np.zeros(4)])
        return piecewise_polynomial(knots, pieces, separation)


@cache
def make_volume_neutral_profile() -> RoundingProfile:
    """The profile with integral zero: it adds as much volume as it removes where the sides of the edge are plane."""

    def integral(extra_steepness: float) -> float:
        profile = _make_profile(extra_steepness)
        return float(PPoly(profile.pieces, profile.knots).integrate(0.0, 1.0))

    return _make_profile(float(brentq(integral, MIN_EXTRA_STEEPNESS, MAX_EXTRA_STEEPNESS)))


def _make_profile(extra_steepness: float) -> RoundingProfile:
    """The profile whose slope exceeds that of |s| / 2 by at most the fraction `extra_steepness`."""
    turn = 0.5 * extra_steepness
    knots = np.array([0.0, 0.5, 0.5 + 3 * turn, 0.5 + 6 * turn])
    width = float(knots[-1])
    curvature = np.stack([np.diff(SECOND_DERIVATIVES) / np.diff(knots), SECOND_DERIVATIVES[:-1]])
    integral = PPoly(curvature, knots).antiderivative(2)
    # value and slope are zero at the end of the profile
    value, slope = float(integral(width)), float(integral(width, 1))
    pieces = integral.c.copy()
    pieces[2] -= slope
    pieces[3] -= value + slope * (knots[:-1] - width)
    pieces *= (width ** np.arange(3, -1, -1) / width)[:, None]
    profile = PPoly(pieces, knots / width)
    lowest = profile(profile.derivative().roots(extrapolate=False)).min()
    return RoundingProfile(knots / width, pieces, float(profile(0.0)), float(-lowest))


@dataclass(frozen=True, slots=True, eq=False)
class ProfileMinMaxField(RoundedMinMaxField):
    """The maximum or minimum of two fields, rounded by a profile: twice continuously differentiable."""

    rounding_profile: RoundingProfile

    def profile(self, separation: Node) -> Node:
        """Height of the rounding where the two fields differ by a separation, in widths."""
        return self.rounding_profile.trace(separation)


MIN_PROBE_LINES = 64
"""Grid lines along the box's longest edge with which creases are searched."""

NEWTON_STEPS = 12
SIDE_NEWTON_STEPS = 4
START_DISTANCE_STEPS, MAX_TRAVEL_STEPS = 4, 6
"""Distance, in grid steps, of a start from the surface, and of an edge point from its start, at most."""

EDGE_TOL_FRACTION = 1e-7
"""Tolerance of the points of an edge, as a fraction of the box's diagonal."""

PROBE_WIDTH_STEPS = 1e-6
"""Width of the rounding with which edge points are searched, in grid steps."""

MIN_STRUCTURE_SHARE = 1e-3
"""Weight of a structure in the blend from which its creases are edges."""

SIDE_OFFSET_FRACTION = 1e-6
"""Distance from an edge at which the gradients of its sides are taken, as a fraction of the edges' extent."""

MAX_HALF_OPENING_RAD = 1.5
"""Half opening angle from which an edge counts as flat."""

MAX_SCALINGS, MAX_SCALE_GROWTH, MIN_USED_FRACTION = 8, 4.0, 0.9
"""Scalings of the width, their greatest factor, and the fraction of the allowed displacement at which the scaling ends."""

SIDE_LEVELS_WIDTHS = (0.15, 0.3, 0.45, 0.6, 0.8)
"""Differences of a crease's two fields, in widths, at which the displacement beside an edge is measured."""

SIDE_LEVEL_TOL_WIDTHS = 0.1
"""Tolerance of these differences: points beside the edge that Newton's method misses by more are left out."""

CURVATURE_STEP_FRACTION = 0.1
"""Step of the difference quotients of the gradient, as a fraction of the allowed displacement."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeRounding:
    """A field with rounded edges, and the greatest displacement of its level set (model units).

    The sharpest edge opens by `opening_deg` at `sharpest_point` (3,) and is rounded with about `radius`.
    """

    field: CompositeField
    max_displacement: float
    sharpest_point: Array
    opening_deg: float
    radius: float


def round_edges(field: Field, lo: Array, hi: Array, allowed: float) -> EdgeRounding | None:
    """The field with the edges of its solid in a box rounded such that its level set moves by at most `allowed`.

    None if it has no edges. The displacement is measured at points of the edges and beside them, to first order along the
    gradient of the rounded field; nowhere else is it greater. Raises NotMet if no width keeps it within `allowed`.
    """
    if not isinstance(field, CompositeField):
        return None
    creases = [node for structure in field.structures for node in _iterate_extremes(structure)]
    edges = [(node, p) for node in creases if len(p := _find_edge_points(field, node, lo, hi))]
    if not edges:
        return None
    points = np.concatenate([p for _, p in edges])
    half_openings = np.concatenate([_half_openings(field, node, p) for node, p in edges])
    sharpest = int(half_openings.argmin())
    profile = make_volume_neutral_profile()
    # the width of each crease is proportional to the slope across it: then all are rounded alike
    slopes = {id(node): 1.0 for node in creases} | {id(node): _median_crease_slope(node, p) for node, p in edges}
    scale = allowed / profile.depth
    best: tuple[CompositeField, float] | None = None
    for attempt in range(2 * MAX_SCALINGS):
        rounded = _round_field(field, {key: scale * slope for key, slope in slopes.items()}, profile)
        beside = [_side_displacement(field, rounded, node, p, scale * slopes[id(node)]) for node, p in edges]
        displacement = float(
            max(_edge_displacement(field, rounded, points).max(), *(m.max(initial=0.0) for m in beside))
        )
        if displacement <= allowed and (best is None or displacement > best[1]):
            best = rounded, displacement
        if best is not None and (best[1] >= MIN_USED_FRACTION * allowed or attempt >= MAX_SCALINGS):
            break
        scale *= min(MAX_SCALE_GROWTH, 0.5 * (1 + MIN_USED_FRACTION) * allowed / max(displacement, MIN_DIVISOR))
    if best is None:
        where = format_point(points[sharpest], 5)
        raise NotMet(
            f"the edge of a blended wall near {where} could not be rounded within {allowed:g}; use a larger tol"
        )
    is_flat = half_openings[sharpest] >= MAX_HALF_OPENING_RAD
    radius = np.inf if is_flat else _least_curvature_radius(best[0], points[sharpest], allowed)
    opening_deg = float(np.degrees(2 * half_openings[sharpest]))
    return EdgeRounding(best[0], best[1], points[sharpest], opening_deg, radius)


def _iterate_extremes(structure: Field) -> Iterator[MinMaxField]:
    if isinstance(structure, MinMaxField):
        yield structure
        yield from _iterate_extremes(structure.first)
        yield from _iterate_extremes(structure.second)


def _round_structure(structure: Field, widths: dict[int, float], profile: RoundingProfile) -> Field:
    """The structure with its extremes rounded; `widths` are by the identity of the extreme."""
    if not isinstance(structure, MinMaxField):
        return structure
    first, second = (_round_structure(part, widths, profile) for part in (structure.first, structure.second))
    return ProfileMinMaxField(first, second, structure.sign, widths[id(structure)], profile)


def _round_field(field: CompositeField, widths: dict[int, float], profile: RoundingProfile) -> CompositeField:
    return replace(
        field, structures=tuple(_round_structure(structure, widths, profile) for structure in field.structures)
    )


def _find_edge_points(field: CompositeField, node: MinMaxField, lo: Array, hi: Array) -> Array:
    """Points (n, 3) in the box where a crease lies on the surface: {first = second} and {field = 0}.

    Starts are the grid points near the crease and the surface. Newton's method then alternates between both. On the crease the
    gradient of the field is that of one side; the field is rounded by a very small width, which makes it the mean of both.
    """
    crease = node.first - node.second
    start, step = _find_edge_starts(field, crease, lo, hi)
    points = start
    if not len(points):
        return points
    width = PROBE_WIDTH_STEPS * step * float(np.median(np.linalg.norm(crease.gradient(points), axis=1)))
    profile = make_volume_neutral_profile()
    widths = {id(extreme): width for structure in field.structures for extreme in _iterate_extremes(structure)}
    smooth = _round_field(field, widths, profile)
    for _ in range(NEWTON_STEPS):
        difference, across = crease.value_and_gradient(points)
        points = points - (difference / np.maximum((across**2).sum(axis=1), MIN_DIVISOR))[:, None] * across
        value, slope = smooth.value_and_gradient(points)
        across = crease.gradient(points)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), MIN_DIVISOR)
        slope -= (slope * across).sum(axis=1, keepdims=True) * across
        move = -(value / np.maximum((slope**2).sum(axis=1), MIN_DIVISOR))[:, None] * slope
        length = np.linalg.norm(move, axis=1)
        points = points + np.minimum(1.0, step / np.maximum(length, MIN_DIVISOR))[:, None] * move
        points = np.clip(points, lo - step, hi + step)
    tol = EDGE_TOL_FRACTION * float(np.linalg.norm(hi - lo))
    difference, across = crease.value_and_gradient(points)
    value, slope = smooth.value_and_gradient(points)
    accepted = (np.abs(difference) <= tol * np.linalg.norm(across, axis=1)) & (length <= tol)
    accepted &= np.abs(value) <= tol * np.linalg.norm(slope, axis=1)
    accepted &= ((points >= lo) & (points <= hi)).all(axis=1)
    accepted &= np.linalg.norm(points - start, axis=1) < MAX_TRAVEL_STEPS * step
    # a structure without weight in the blend has no edges there
    accepted &= np.abs(smooth(points) - field(points)) >= MIN_STRUCTURE_SHARE * width * profile.height
    return points[accepted]


def _find_edge_starts(field: CompositeField, crease: Field, lo: Array, hi: Array) -> tuple[Array, float]:
    """Grid points (n, 3) near the crease {crease = 0} and the surface {field = 0}, and the step of the grid."""
    counts = np.maximum(8, np.ceil(MIN_PROBE_LINES * (hi - lo) / (hi - lo).max())).astype(int)
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(lo, hi, counts, strict=True)]
    step = float(((hi - lo) / counts).max())
    value, slope = crease.value_and_gradient_on_grid(*axes)
    near = np.abs(value) <= step * np.linalg.norm(slope, axis=-1)
    points = np.stack([axis[i] for axis, i in zip(axes, np.nonzero(near), strict=True)], axis=-1)
    value, slope = field.value_and_gradient(points)
    return points[np.abs(value) <= START_DISTANCE_STEPS * step * np.linalg.norm(slope, axis=1)], step


def _median_crease_slope(node: MinMaxField, points: Array) -> float:
    """Median slope of the difference of a crease's two fields at points (n, 3)."""
    return float(np.median(np.linalg.norm((node.first - node.second).gradient(points), axis=1)))


def _edge_displacement(field: CompositeField, rounded: CompositeField, points: Array) -> Array:
    """Displacement of the level set at points (n, 3) of the original surface, to first order: (n,)."""
    value, slope = rounded.value_and_gradient(points)
    return np.abs(value - field(points)) / np.maximum(np.linalg.norm(slope, axis=1), MIN_DIVISOR)


def _side_displacement(
    field: CompositeField, rounded: CompositeField, node: MinMaxField, points: Array, width: float
) -> Array:
    """Displacement of the level set on both sides of the points (n, 3) of a crease's edges, at SIDE_LEVELS_WIDTHS: (m,)."""
    crease = node.first - node.second
    samples = []
    for level in SIDE_LEVELS_WIDTHS:
        for side in (1, -1):
            beside = points
            for _ in range(SIDE_NEWTON_STEPS):
                difference, across = crease.value_and_gradient(beside)
                value, slope = field.value_and_gradient(beside)
                system = np.stack([across, slope], axis=1)
                residual = np.stack([side * level * width - difference, -value], axis=1)
                beside = beside + np.einsum("nij,nj->ni", np.linalg.pinv(system), residual)
            samples.append(beside[np.abs(crease(beside) - side * level * width) < SIDE_LEVEL_TOL_WIDTHS * width])
    return _edge_displacement(field, rounded, np.concatenate(samples))


def _least_curvature_radius(field: Field, point: Array, allowed: float) -> float:
    """The least radius of curvature of the level set near a point (3,), from difference quotients of the gradient."""
    p = point[None]
    for _ in range(NEWTON_STEPS):
        value, slope = field.value_and_gradient(p)
        p = p - (value / np.maximum((slope**2).sum(axis=1), MIN_DIVISOR))[:, None] * slope
    operator = measure_shape_operators(field, p, CURVATURE_STEP_FRACTION * allowed)[0]
    return 1.0 / max(float(np.linalg.norm(operator, ord=2)), MIN_DIVISOR)


def _half_openings(field: CompositeField, node: MinMaxField, points: Array) -> Array:
    """Half the angles between the solid's sides at points (n, 3) of its edges: (n,), in radians."""
    across = (node.first - node.second).gradient(points)
    extent = float(np.ptp(points, axis=0).max(initial=0.0))
    across *= SIDE_OFFSET_FRACTION * extent / np.linalg.norm(across, axis=1, keepdims=True)
    first_slope, second_slope = (field.gradient(points + side * across) for side in (1, -1))
    cosine = (first_slope * second_slope).sum(axis=1) / (
        np.linalg.norm(first_slope, axis=1) * np.linalg.norm(second_slope, axis=1)
    )
    return np.asarray(0.5 * (np.pi - np.arccos(np.clip(cosine, -1.0, 1.0))))
