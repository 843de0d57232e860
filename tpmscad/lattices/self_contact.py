"""A global test that a mapped lattice does not meet itself: no point lies in two of its walls.

A Jacobian of one sign makes a map one-to-one near every point, not as a whole: a lattice longer than the turn of a cylinder lies
on itself. The walls themselves are tested, not the box around them, because they are what a solid is made of: a natural boundary
reaches beyond the box, and walls keep their thickness where the map squeezes the space between them. Walls that interleave
without touching are two parts of a valid solid.

Points of the wall are sampled on its two surfaces and in its middle. A sample lies in another part of the wall if it has a second
foot on the mid surface, far from its own in the lattice (modulo the periods of a closed one), at a signed distance between those
of the two surfaces. Feet are predicted from the nearest samples, found by Newton's method where the prediction is close, and the
deepest of them are sought between the samples, so that contacts much smaller than the spacing are seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.brep.orthogonal_projection import project_to_surface
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.lattices.mapped_surface import MappedSurface, repeats_after

SAMPLES_PER_PARAMETER = 7
"""Samples of each patch along u and v."""

MIN_LATTICE_DISTANCE_CELLS = 0.2
"""Feet farther apart than this in the lattice are two: nearer ones are kept apart by the bound on the offsets, which stay below
the radius of curvature."""

FOOT_RANGE_SPACINGS = 0.8
"""A sample predicts the feet within this multiple of the spacing: the nearest one does, half a diagonal away at most."""

MARGIN_SPACINGS = 0.3
"""Predicted gaps up to this multiple of the spacing are looked at closely."""

PREDICTED_PAIRS = 3000
"""Predicted pairs, the deepest, whose feet are found: more only say the same again."""

PAIRS_PER_PATCHES = 8
"""Predicted pairs of any two patches."""

CLOSE_PAIRS = 24
"""Pairs of patches, those with the deepest feet, in which samples are refined."""

MAX_REFINEMENTS = 7
"""Most rounds of refinement; each divides the spacing by four, until an eighth of the wall is resolved."""

FOOT_STEPS = 8
"""Newton steps to the point that the map takes to the same place."""

AXIS_RTOL = 1e-6
"""Relative deviation from an axis up to which a step between two points of one image is a period of the map along it."""

UNIT_SQUARE = (0.0, 1.0), (0.0, 1.0)
"""The parameters of every patch."""

TOUCH_FRACTION = 1e-6
"""Walls that go into each other by less than this fraction of the cell touch by round-off."""


@dataclass(frozen=True, slots=True, eq=False)
class WallPairs(ArrayTable):
    """n points of the wall that may lie in another part of it, and their second feet.

    The point is that at parameters `own` (n, 2) of placement `patch` (n,), at signed distance `height` (n,) from the mid surface,
    in units of the surface; the foot has the parameters `foot` (n, 2) on placement `other` (n,). `depth` (n,) says how deep the
    point lies in that wall, negative outside.
    """

    patch: IntArray
    own: Array
    height: Array
    other: IntArray
    foot: Array
    depth: Array


def require_no_self_contact(mapped: MappedSurface, offsets: tuple[float, float]) -> None:
    """InvalidRequest, with place and amount, if two parts of the wall between the two offsets overlap where both count."""
    pairs = _predict_pairs(mapped, offsets)
    for columns in (("patch", "own"), ("other", "foot")):
        if len(pairs.patch):
            index, sides = (getattr(pairs, name) for name in columns)
            at = mapped.points_at(index, *sides.T)
            pairs = pairs[mapped.lie_within(at.lattice) & (mapped.in_body is None or mapped.in_body(at.position))]
    pairs = _deepest(pairs, PAIRS_PER_PATCHES, PREDICTED_PAIRS)
    wall = (offsets[1] - offsets[0]) * float(mapped.checked[1].min())
    for refinement in range(MAX_REFINEMENTS + 1):
        pairs = _deepest(_find_feet(mapped, pairs, offsets), 1, CLOSE_PAIRS)
        if len(pairs.patch) == 0:
            return
        window = 0.25**refinement / (SAMPLES_PER_PARAMETER - 1)
        resolved = window * float(_patch_size(mapped, pairs.patch).max()) < wall / 8
        if refinement == MAX_REFINEMENTS or resolved or (pairs.depth[0] > 0 and refinement > 1):
            break
        pairs = _refine(pairs, window, offsets)
    if pairs.depth[0] > TOUCH_FRACTION * mapped.cell:
        raise InvalidRequest(_describe(mapped, pairs[np.array([0])]))


def _deepest(pairs: WallPairs, each: int, count: int) -> WallPairs:
    """The `count` deepest pairs in order of depth, at most `each` of any two patches."""
    pairs = pairs[np.argsort(-pairs.depth, kind="stable")]
    patches = np.stack([pairs.patch, pairs.other], axis=1)
    _, label = np.unique(patches, axis=0, return_inverse=True)
    by_patches = np.argsort(label.ravel(), kind="stable")
    sorted_label = label.ravel()[by_patches]
    rank = np.empty(len(label.ravel()), np.int64)
    rank[by_patches] = np.arange(len(rank)) - np.searchsorted(sorted_label, sorted_label)
    return pairs[np.flatnonzero(rank < each)[:count]]


def _patch_size(mapped: MappedSurface, patch: IntArray) -> Array:
    """The longer of the two tangents at the middle of patches (n,): their size, (n,)."""
    middle = mapped.points_at(patch, np.full(len(patch), 0.5), np.full(len(patch), 0.5))
    return np.maximum(np.linalg.norm(middle.du, axis=1), np.linalg.norm(middle.dv, axis=1))


def _heights(offsets: tuple[float, float]) -> Array:
    low, high = offsets
    return np.array([low, (low + high) / 2, high])


def _predict_pairs(mapped: MappedSurface, offsets: tuple[float, float]) -> WallPairs:
    """Samples of the wall with a second foot in or near another part of the wall, by first-order prediction from samples."""
    t = np.linspace(0.0, 1.0, SAMPLES_PER_PARAMETER)
    u, v = (g.ravel() for g in np.meshgrid(t, t, indexing="ij"))
    surface = mapped.points(u, v)
    shape = surface.position.shape[:2]
    spacing = np.maximum(np.linalg.norm(surface.du, axis=-1), np.linalg.norm(surface.dv, axis=-1)).max(axis=1) * t[1]
    position, normal = surface.position.reshape(-1, 3), surface.normal.reshape(-1, 3)
    lattice = surface.lattice.reshape(-1, 3)
    tree, step = cKDTree(position), np.repeat(spacing, shape[1])
    unit, centre = mapped.grading(position)
    low, high = (centre + d * unit for d in offsets)
    # a predicted foot is at most MARGIN_SPACINGS beyond the wall and FOOT_RANGE_SPACINGS aside
    wall, greatest = float(np.abs([low, high]).max()), float(spacing.max())
    reach = float(np.hypot(wall + MARGIN_SPACINGS * greatest, FOOT_RANGE_SPACINGS * greatest))
    jacobian = mapped.map.jacobian(lattice, mapped.cell)
    # a foot is at most this far from the sample that predicts it, in the lattice
    foot_range = FOOT_RANGE_SPACINGS * step / np.linalg.svd(jacobian, compute_uv=False)[:, -1]
    found = []
    for height in _heights(offsets):
        points = position + (centre + height * unit)[:, None] * normal
        pairs = cKDTree(points).sparse_distance_matrix(tree, reach, output_type="ndarray")
        a, b = pairs["i"], pairs["j"]
        apart_in_lattice = _lattice_distance(mapped, lattice[a] - lattice[b])
        may_be_far = apart_in_lattice + foot_range[b] > MIN_LATTICE_DISTANCE_CELLS * mapped.cell
        a, b = a[may_be_far], b[may_be_far]
        apart = points[a] - position[b]
        distance = np.einsum("ni,ni->n", apart, normal[b])
        tangential = apart - distance[:, None] * normal[b]
        depth = np.minimum(distance - low[b], high[b] - distance)
        near = (np.linalg.norm(tangential, axis=1) < FOOT_RANGE_SPACINGS * step[b]) & (
            depth > -MARGIN_SPACINGS * step[b]
        )
        a, b, tangential, depth = a[near], b[near], tangential[near], depth[near]
        foot = lattice[b] + np.linalg.solve(jacobian[b], tangential[..., None])[..., 0]
        far = _lattice_distance(mapped, foot - lattice[a]) > MIN_LATTICE_DISTANCE_CELLS * mapped.cell
        a, b, depth = a[far], b[far], depth[far]
        sides = np.stack([u, v], axis=1)
        n = shape[1]
        found.append(WallPairs(a // n, sides[a % n], np.full(len(a), height), b // n, sides[b % n], depth))
    return WallPairs.concatenate(found)


def _lattice_distance(mapped: MappedSurface, difference: Array) -> Array:
    """Length of differences (n, 3) of lattice points, the shortest modulo the periods of a closed lattice."""
    difference = difference.copy()
    for axis, period in enumerate(mapped.periods):
        if period:
            length = period * mapped.cell
            difference[:, axis] -= length * np.rint(difference[:, axis] / length)
    return np.asarray(np.linalg.norm(difference, axis=1))


def _find_feet(mapped: MappedSurface, pairs: WallPairs, offsets: tuple[float, float]) -> WallPairs:
    """The pairs with exact feet and depths; those without a foot on the other patch, or whose foot is their own, are left out."""
    own = mapped.points_at(pairs.patch, *pairs.own.T)
    unit, centre = mapped.grading(own.position)
    points = own.position + (centre + pairs.height * unit)[:, None] * own.normal

    def jet(u: Array, v: Array, rows: IntArray) -> Sequence[Array]:
        at = mapped.points_at(pairs.other[rows], u, v)
        return at.position, at.du, at.dv

    sides = np.stack(project_to_surface(jet, points, pairs.foot[:, 0], pairs.foot[:, 1], UNIT_SQUARE), axis=1)
    at = mapped.points_at(pairs.other, *sides.T)
    apart = points - at.position
    distance = np.einsum("ni,ni->n", apart, at.normal)
    sideways = np.linalg.norm(apart - distance[:, None] * at.normal, axis=1)
    unit, centre = mapped.grading(at.position)
    height = distance - centre
    depth = np.minimum(height - offsets[0] * unit, offsets[1] * unit - height) - sideways
    far = _lattice_distance(mapped, at.lattice - own.lattice) > MIN_LATTICE_DISTANCE_CELLS * mapped.cell
    return replace(pairs, foot=sides, depth=depth)[far]


def _refine(pairs: WallPairs, spacing: float, offsets: tuple[float, float]) -> WallPairs:
    """Every pair with its neighbours at a quarter of `spacing` along both parameters, at all three heights."""
    step = spacing * np.linspace(-1.0, 1.0, 9)
    du, dv, height = (g.ravel() for g in np.meshgrid(step, step, _heights(offsets), indexing="ij"))
    n, m = len(pairs.patch), len(du)
    own = np.clip(pairs.own[:, None] + np.stack([du, dv], axis=1), 0.0, 1.0)
    return WallPairs(
        np.repeat(pairs.patch, m),
        own.reshape(-1, 2),
        np.tile(height, n),
        np.repeat(pairs.other, m),
        np.repeat(pairs.foot, m, axis=0),
        np.repeat(pairs.depth, m),
    )


def _describe(mapped: MappedSurface, pair: WallPairs) -> str:
    own, other = mapped.points_at(pair.patch, *pair.own.T), mapped.points_at(pair.other, *pair.foot.T)
    unit, centre = mapped.grading(own.position)
    place = (own.position + (centre + pair.height * unit)[:, None] * own.normal)[0]
    p, q = own.lattice[0], other.lattice[0]
    here, there = format_point(p / mapped.cell), format_point(q / mapped.cell)
    message = (
        f"under {mapped.map.name} the lattice overlaps itself: near {format_point(place)} its wall at {here} cells and its wall "
        f"at {there} cells lie {pair.depth[0]:.3g} deep in each other. "
    )
    repeat = _find_repeat(mapped, p, q)
    if repeat is not None:
        axis, length = repeat
        return message + (
            f"The map repeats after {length / mapped.cell:.9g} cells along {'xyz'[axis]}; a lattice of just that length closes, "
            "and one a cell shorter stays open: change the number of cells, the cell edge along this axis, or the size of the map"
        )
    return message + "Give the walls room: fewer cells, a thinner wall, or a map that is one-to-one over the lattice"


def _find_repeat(mapped: MappedSurface, p: Array, q: Array) -> tuple[int, float] | None:
    """The axis and the length after which the map repeats, if q has the image of a point near p for this reason."""
    target, at = mapped.map(p), q
    for _ in range(FOOT_STEPS):
        at = at + np.linalg.solve(mapped.map.jacobian(at, mapped.cell), target - mapped.map(at))
    step = at - p
    axis = int(np.argmax(np.abs(step)))
    length = float(abs(step[axis]))
    along = length * np.eye(3)[axis]
    if np.abs(np.abs(step) - along).max() > AXIS_RTOL * length:
        return None
    points = mapped.cell * np.random.default_rng(0).random((20, 3)) + p - (along if step[axis] < 0 else 0.0)
    return (axis, length) if repeats_after(mapped.map, along, points) else None
