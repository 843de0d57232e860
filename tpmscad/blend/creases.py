"""Edges of a blended field's solid, rounded: walls between two levels that are blended with something else end in edges.

A wall is the greater of two fields, max(f, g), and its crease {f = g} lies inside the wall. Mixed with another structure the wall
thins out, and where it is gone the crease lies on the surface, as a sharp edge. The edge is rounded so little that the surface
moves by less than is allowed, and within that with the greatest radius.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tpmscad.blend.composition import BlendedField
from tpmscad.blend.edges import Eased, Profile, neutral
from tpmscad.blend.grid import Array
from tpmscad.errors import NotMet
from tpmscad.fields import Field
from tpmscad.fields.booleans import Extreme

PROBES = 64
"""Grid lines along the box's longest edge on which creases are looked for, at least."""

NEWTON = 12
ON = 1e-7
"""Of the box's diagonal: how near to the edge its points are found."""

LEAST = 1e-3
"""Least share of a structure in the blend whose creases matter."""

ASIDE = 1e-6
"""Of the edges' extent: how far beside them the slopes of their sides are taken."""

FLAT = 1.5
"""Half openings (radians) above which there is no edge to speak of."""

TRIES, GROWTH, NEAR = 8, 4.0, 0.9
"""The rounding is scaled, by so many times at most from one try to the next, until the surface moves by at least this part of
what is allowed."""

LEVELS = (0.15, 0.3, 0.45, 0.6, 0.8)
"""Differences of a crease's two fields, in widths, at which it is measured how far the surface moves beside an edge."""


@dataclass(frozen=True, slots=True, eq=False)
class Rounded:
    """The field with its edges rounded, and the greatest distance `moved` by which its level set moves.

    The sharpest edge: it opens by `opening` degrees at the point `near` and is rounded with about `radius`.
    """

    field: BlendedField
    moved: float
    near: Array
    opening: float
    radius: float


def rounded(field: Field, lo: Array, hi: Array, allowed: float) -> Rounded | None:
    """The field with edges of its solid in the box rounded, its level set within `allowed` of what it was; None if it has none.

    Measured at points of the edges, to first order along the rounded field's slope: nowhere else does the surface move further.
    """
    if not isinstance(field, BlendedField):
        return None
    creases = [node for structure in field.structures for node in _extremes(structure)]
    edges = [(node, p) for node in creases if len(p := _edge_points(field, node, lo, hi))]
    if not edges:
        return None
    points = np.concatenate([p for _, p in edges])
    halves = np.concatenate([_half_openings(field, node, p) for node, p in edges])
    shape = neutral()
    # of each crease a width in proportion to the slope across it: then all are rounded alike
    slopes = {id(node): 1.0 for node in creases} | {id(node): _slope(node, p) for node, p in edges}
    scale = allowed / shape.depth
    best: tuple[BlendedField, float] | None = None
    for attempt in range(2 * TRIES):
        eased = _eased(field, {key: scale * slope for key, slope in slopes.items()}, shape)
        beside = [_beside(field, eased, node, p, scale * slopes[id(node)]) for node, p in edges]
        most = float(max(_moved(field, eased, points).max(), *(m.max(initial=0.0) for m in beside)))
        if most <= allowed and (best is None or most > best[1]):
            best = eased, most
        if best is not None and (best[1] >= NEAR * allowed or attempt >= TRIES):
            break
        scale *= min(GROWTH, 0.5 * (1 + NEAR) * allowed / max(most, 1e-300))
    if best is None:
        where = ", ".join(f"{x:.5g}" for x in points[halves.argmin()])
        raise NotMet(
            f"the edge of a blended wall near ({where}) could not be rounded within {allowed:g}; use a larger tol"
        )
    sharp = int(halves.argmin())
    radius = np.inf if halves[sharp] >= FLAT else _radius(best[0], points[sharp], allowed)
    return Rounded(best[0], best[1], points[sharp], float(np.degrees(2 * halves[sharp])), radius)


def _extremes(structure: Field) -> Iterator[Extreme]:
    if isinstance(structure, Extreme):
        yield structure
        yield from _extremes(structure.first)
        yield from _extremes(structure.second)


def _smooth(structure: Field, widths: dict[int, float], shape: Profile) -> Field:
    if not isinstance(structure, Extreme):
        return structure
    first, second = _smooth(structure.first, widths, shape), _smooth(structure.second, widths, shape)
    return Eased(first, second, structure.sign, widths[id(structure)], shape)


def _eased(field: BlendedField, widths: dict[int, float], shape: Profile) -> BlendedField:
    return replace(field, structures=tuple(_smooth(structure, widths, shape) for structure in field.structures))


def _edge_points(field: BlendedField, node: Extreme, lo: Array, hi: Array) -> Array:
    """Points in the box where the crease lies on the surface (n, 3): {first = second} and {field = 0}.

    On the crease the field's slope is that of one side; the edge is followed on that side's smooth continuation of the mean.
    """
    counts = np.maximum(8, np.ceil(PROBES * (hi - lo) / (hi - lo).max())).astype(int)
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(lo, hi, counts, strict=True)]
    crease = node.first - node.second
    step = float(((hi - lo) / counts).max())
    value, slope = crease.gradient_on_grid(*axes)
    near = np.abs(value) <= step * np.linalg.norm(slope, axis=-1)
    points = np.stack([axis[i] for axis, i in zip(axes, np.nonzero(near), strict=True)], axis=-1)
    value, slope = field.value_and_gradient(points)
    points = start = points[np.abs(value) <= 4 * step * np.linalg.norm(slope, axis=1)]
    if not len(points):
        return points
    # one width for all, small next to the box: a smooth field of the same crease points
    tiny = 1e-6 * step * float(np.median(np.linalg.norm(crease.gradient(points), axis=1)))
    shape = neutral()
    smooth = _eased(field, {id(e): tiny for s in field.structures for e in _extremes(s)}, shape)
    for _ in range(NEWTON):
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
    on = (np.abs(d) <= ON * diagonal * np.linalg.norm(across, axis=1)) & (length <= ON * diagonal)
    on &= np.abs(f) <= ON * diagonal * np.linalg.norm(slope, axis=1)
    on &= ((points >= lo) & (points <= hi)).all(axis=1) & (np.linalg.norm(points - start, axis=1) < 6 * step)
    # a structure that has no part in the blend there has no edges there
    on &= np.abs(smooth(points) - field(points)) >= LEAST * tiny * shape.height
    return points[on]


def _slope(node: Extreme, points: Array) -> float:
    """The usual slope across a crease."""
    return float(np.median(np.linalg.norm((node.first - node.second).gradient(points), axis=1)))


def _moved(field: BlendedField, eased: BlendedField, points: Array) -> Array:
    """How far the level set moves at points of the edges, to first order: (n,)."""
    value, slope = eased.value_and_gradient(points)
    return np.abs(value - field(points)) / np.maximum(np.linalg.norm(slope, axis=1), 1e-300)


def _beside(field: BlendedField, eased: BlendedField, node: Extreme, points: Array, width: float) -> Array:
    """How far the level set moves beside points of a crease's edges, on both sides of it: (n,)."""
    crease = node.first - node.second
    starts = []
    for level in LEVELS:
        for way in (1, -1):
            beside = points
            for _ in range(4):
                d, across = crease.value_and_gradient(beside)
                f, slope = field.value_and_gradient(beside)
                system = np.stack([across, slope], axis=1)
                wanted = np.stack([way * level * width - d, -f], axis=1)
                beside = beside + np.einsum("nij,nj->ni", np.linalg.pinv(system), wanted)
            starts.append(beside[np.abs(crease(beside) - way * level * width) < 0.1 * width])
    return _moved(field, eased, np.concatenate(starts))


def _radius(field: Field, point: Array, step: float) -> float:
    """The least radius of curvature of the field's level set near a point, by differences over a tenth of `step`."""
    p = point[None]
    for _ in range(NEWTON):
        f, slope = field.value_and_gradient(p)
        p = p - (f / np.maximum((slope**2).sum(axis=1), 1e-300))[:, None] * slope
    h = 0.1 * step
    slope = field.gradient(p)[0]
    length = float(np.linalg.norm(slope))
    normal = slope / length
    bend = np.stack([(field.gradient(p + h * e) - field.gradient(p - h * e))[0] / (2 * h) for e in np.eye(3)], axis=-1)
    across = np.eye(3) - np.outer(normal, normal)
    return length / max(float(np.linalg.norm(across @ bend @ across, ord=2)), 1e-300)


def _half_openings(field: BlendedField, node: Extreme, points: Array) -> Array:
    """Half the angles in which the solid's sides meet at points of its edges (n,), in radians."""
    across = (node.first - node.second).gradient(points)
    across *= ASIDE * float(np.ptp(points, axis=0).max(initial=0.0)) / np.linalg.norm(across, axis=1, keepdims=True)
    one, other = (field.gradient(points + way * across) for way in (1, -1))
    cosine = (one * other).sum(axis=1) / (np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1))
    return np.asarray(0.5 * (np.pi - np.arccos(np.clip(cosine, -1.0, 1.0))))
