"""Local width of a solid, or of the void around it, by balls that touch its surface from within at two opposite places.

Each sample's largest empty tangent ball is found by shrinking: a ball that holds another sample shrinks until it just touches it
(Ma, Bae and Choi, "3D medial axis point approximation using nearest neighbors and the normal field", 2012). The sample next to
the far end of its diameter is the opposite side, if its normal is opposite; the width is taken to its tangent plane, which leaves
an error of the second order in the samples' distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray

MAX_OPPOSITE_NORMALS_COSINE = np.cos(np.radians(175.0))
"""Sides are opposite where the outward normals are at least this far apart: they taper by 5 degrees at most. Balls in the corner
between a wall and a cap, or as narrow as a groove is curved, touch at smaller angles and are not asked. On a gyroid's pores this
gives 0.4 % less than the least width between exactly opposite sides."""

MAX_OVERLAP_FRACTION = 0.02
"""Of the radius: how far the ball may overlap other samples. Necks of fourfold symmetry touch their ball at four places."""

WEDGE_REACH_RADII = 40.0
"""Two sides that meet in a sharp edge within so many radii of the ball are a wedge of 3 degrees or more, which runs out to
nothing and has no least width."""

MAX_SHRINKS = 60
"""Shrinking ends after about ten; a ball still shrinking then is as good as its last contact."""


MAX_FIRST_SAMPLES = 30_000
"""Samples at which a width is measured, before all those around the smallest; contacts are sought among all."""

REFINED_MINIMA = 100
"""Widths looked at more closely, by all samples nearby."""

REFINED_RADIUS_SPACINGS = 2.0
"""Spacings of the samples asked first: how far "nearby" reaches."""


@dataclass(frozen=True, slots=True, eq=False)
class SharpEdgePoints:
    """Points on sharp edges (m, 3), and the two smooth sides that meet there (m, 2), sorted."""

    points: Array
    sides: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class OppositeWidths:
    """Diameters of balls between opposite sides, smallest first (n,), their centres (n, 3), and the samples touched (n, 2).

    wider (m,): samples asked that a ball as large as `reach` touches.
    """

    width: Array
    centre: Array
    touched: IntArray
    wider: IntArray


def shrink_tangent_balls(
    points: Array, normals: Array, reach: float, start: IntArray, tree: cKDTree
) -> tuple[Array, IntArray]:
    """Radius of the largest ball inside that touches each sample asked, at most `reach`, and the other sample it touches, or -1.

    Normals point outwards; `start` are the samples asked, `tree` holds the points.
    """
    radius = np.full(len(start), reach)
    contact = np.full(len(start), -1)
    active = np.arange(len(start))
    for _ in range(MAX_SHRINKS):
        p, n = points[start[active]], normals[start[active]]
        _, near = tree.query(p - radius[active, None] * n)
        away = p - points[near]
        height = (away * n).sum(axis=1)
        square = (away * away).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            smaller = np.where(height > 1e-9 * np.sqrt(square), square / (2.0 * height), np.inf)
        shrinks = (near != start[active]) & (smaller < (1.0 - 1e-9) * radius[active])
        active, near, smaller = active[shrinks], near[shrinks], smaller[shrinks]
        if not len(active):
            break
        radius[active], contact[active] = smaller, near
    return radius, contact


def measure_opposite_widths(
    points: Array,
    normals: Array,
    side: IntArray,
    edges: SharpEdgePoints,
    reach: float,
    start: IntArray,
    tree: cKDTree,
) -> OppositeWidths:
    """Widths between opposite sides, up to twice `reach`, where `tangent_balls` asks.

    side (n,): the smooth side each sample is on.
    """
    radius, contact = shrink_tangent_balls(points, normals, reach, start, tree)
    wider = start[contact < 0]
    p, radius = start[contact >= 0], radius[contact >= 0]
    _, q = tree.query(points[p] - 2.0 * radius[:, None] * normals[p])
    facing = (normals[p] * normals[q]).sum(axis=1)
    plane = ((points[q] - points[p]) * normals[q]).sum(axis=1) / (1.0 - np.minimum(facing, 0.0))
    kept = (facing < MAX_OPPOSITE_NORMALS_COSINE) & (np.abs(plane / radius - 1.0) < MAX_OVERLAP_FRACTION)
    p, q, radius = p[kept], q[kept], plane[kept]
    centre = points[p] - radius[:, None] * normals[p]
    wedge = _in_wedge(centre, radius, np.sort(side[np.stack([p, q], axis=1)], axis=1), edges)
    order = np.argsort(radius, kind="stable")
    order = order[~wedge[order]]
    return OppositeWidths(2.0 * radius[order], centre[order], np.stack([p, q], axis=1)[order], wider)


def _in_wedge(centre: Array, radius: Array, sides: IntArray, edges: SharpEdgePoints) -> NDArray[np.bool_]:
    """Whether the two sides a ball touches meet in a sharp edge nearby."""
    result = np.zeros(len(centre), bool)
    if not len(edges.points) or not len(centre):
        return result
    count = 1 + max(int(edges.sides.max()), int(sides.max()))
    key, edge_key = sides @ [count, 1], edges.sides @ [count, 1]
    for pair in np.intersect1d(key, edge_key):
        asked = np.flatnonzero(key == pair)
        away, _ = cKDTree(edges.points[edge_key == pair]).query(centre[asked])
        result[asked] = away < WEDGE_REACH_RADII * radius[asked]
    return result


def find_smallest_width(
    points: Array, normals: Array, side: IntArray, edges: SharpEdgePoints, reach: float, size: float, spacing: float
) -> tuple[float, Array] | None:
    """The least width between opposite sides and the centre of its ball (3,), or None where there are none.

    reach: the radius of the balls tried first; size: the diameter of the largest. spacing: of the samples. Others as for
    `opposite_widths`.
    """
    tree = cKDTree(points)
    stride = -(-len(points) // MAX_FIRST_SAMPLES)
    asked = np.arange(0, len(points), stride)
    while len(asked) and reach < 2.0 * size:
        found = measure_opposite_widths(points, normals, side, edges, reach, asked, tree)
        if len(found.width) and stride > 1:
            around = tree.query_ball_point(
                points[found.touched[:REFINED_MINIMA, 0]], REFINED_RADIUS_SPACINGS * stride**0.5 * spacing
            )
            asked = np.unique(np.concatenate([found.touched[:, 0], *around]).astype(np.int64))
            found = measure_opposite_widths(points, normals, side, edges, reach, asked, tree)
        if len(found.width):
            return float(found.width[0]), found.centre[0]
        asked, reach = found.wider, 2.0 * reach
    return None
