"""Local thickness of a solid, or of the void around it, by the shrinking-ball method on oriented samples of its surface.

The largest empty ball tangent to the surface at a sample is found by shrinking: a ball that contains another sample shrinks until
it touches that sample (Ma, Bae and Choi, "3D medial axis point approximation using nearest neighbors and the normal field", The
Visual Computer, 2012). The sample nearest to the far end of the diameter lies on the opposite side if its normal is opposite. The
width is measured to the tangent plane there, with an error of second order in the spacing of the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray

MAX_OPPOSITE_NORMALS_COSINE = np.cos(np.radians(175.0))
"""Largest cosine between the outward normals of opposite sides, which taper by 5 degrees at most: balls in a corner of a wall
and a cap, or in a groove as narrow as it is curved, do not count."""

MAX_OVERLAP_FRACTION = 0.02
"""Relative to the radius: overlap of a ball with other samples. In necks of fourfold symmetry a ball touches four places."""

WEDGE_REACH_RADII = 40.0
"""Radii of a ball within which its two sides must not meet in a sharp edge: they form a wedge, which has no least width."""

MAX_SHRINKS = 60
"""Shrinking steps; about ten suffice, and a ball that still shrinks is as good as its last contact."""

MAX_FIRST_SAMPLES = 30_000
"""Samples at which widths are measured first, before all samples around the smallest; contacts are sought among all."""

REFINED_MINIMA = 100
"""Smallest widths around which all samples are measured."""

REFINED_RADIUS_SPACINGS = 2.0
"""Radius of this neighbourhood in spacings of the samples measured first."""


@dataclass(frozen=True, slots=True, eq=False)
class SharpEdgePoints:
    """Points on sharp edges (m, 3), and the numbers of the two smooth faces that meet there (m, 2), ascending."""

    points: Array
    sides: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class OppositeWidths:
    """Diameters of balls between opposite sides, smallest first (n,), their centres (n, 3), and their contacts (n, 2).

    samples_at_max_radius (m,): samples whose ball of the largest radius is empty.
    """

    width: Array
    centre: Array
    contacts: IntArray
    samples_at_max_radius: IntArray


def shrink_tangent_balls(
    points: Array, normals: Array, max_radius: float, sample_indices: IntArray, tree: cKDTree
) -> tuple[Array, IntArray]:
    """Radius of the largest empty inner ball at each of the chosen samples, and the other sample it touches: (n,), (n,).

    The contact is -1 if the ball of `max_radius` is empty. Normals point outwards; `tree` holds all points.
    """
    radius = np.full(len(sample_indices), max_radius)
    contact = np.full(len(sample_indices), -1)
    active = np.arange(len(sample_indices))
    for _ in range(MAX_SHRINKS):
        p, n = points[sample_indices[active]], normals[sample_indices[active]]
        _, nearest = tree.query(p - radius[active, None] * n)
        chord = p - points[nearest]
        height = (chord * n).sum(axis=1)
        square = (chord * chord).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            smaller = np.where(height > 1e-9 * np.sqrt(square), square / (2.0 * height), np.inf)
        shrinks = (nearest != sample_indices[active]) & (smaller < (1.0 - 1e-9) * radius[active])
        active, nearest, smaller = active[shrinks], nearest[shrinks], smaller[shrinks]
        if not len(active):
            break
        radius[active], contact[active] = smaller, nearest
    return radius, contact


def measure_opposite_widths(
    points: Array,
    normals: Array,
    smooth_face: IntArray,
    edges: SharpEdgePoints,
    max_radius: float,
    sample_indices: IntArray,
    tree: cKDTree,
    max_cosine: float = MAX_OPPOSITE_NORMALS_COSINE,
    max_overlap: float = MAX_OVERLAP_FRACTION,
) -> OppositeWidths:
    """Widths between opposite sides at the chosen samples, up to 2 max_radius.

    smooth_face (n,): number of the smooth face of each sample. max_cosine: largest cosine between the normals of opposite sides.
    max_overlap: of a ball with other samples, relative to its radius.
    """
    radius, contact = shrink_tangent_balls(points, normals, max_radius, sample_indices, tree)
    at_max_radius = sample_indices[contact < 0]
    p, radius = sample_indices[contact >= 0], radius[contact >= 0]
    _, q = tree.query(points[p] - 2.0 * radius[:, None] * normals[p])
    facing = (normals[p] * normals[q]).sum(axis=1)
    plane = ((points[q] - points[p]) * normals[q]).sum(axis=1) / (1.0 - np.minimum(facing, 0.0))
    kept = (facing < max_cosine) & (np.abs(plane / radius - 1.0) < max_overlap)
    p, q, radius = p[kept], q[kept], plane[kept]
    centre = points[p] - radius[:, None] * normals[p]
    wedge = _in_wedge(centre, radius, np.sort(smooth_face[np.stack([p, q], axis=1)], axis=1), edges)
    order = np.argsort(radius, kind="stable")
    order = order[~wedge[order]]
    return OppositeWidths(2.0 * radius[order], centre[order], np.stack([p, q], axis=1)[order], at_max_radius)


def _in_wedge(centre: Array, radius: Array, sides: IntArray, edges: SharpEdgePoints) -> NDArray[np.bool_]:
    """Whether the two smooth faces that a ball touches meet in a sharp edge nearby: (n,)."""
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
    points: Array,
    normals: Array,
    smooth_face: IntArray,
    edges: SharpEdgePoints,
    max_radius: float,
    max_diameter: float,
    spacing: float,
) -> tuple[float, Array] | None:
    """The smallest width between opposite sides and the centre (3,) of its ball, or None if there are no opposite sides.

    `max_radius` is the radius of the largest balls tried first; it doubles until a width is found or `max_diameter` is exceeded.
    `spacing` is that of the samples. Points, normals and faces as for `measure_opposite_widths`.
    """
    tree = cKDTree(points)
    stride = -(-len(points) // MAX_FIRST_SAMPLES)
    samples = np.arange(0, len(points), stride)
    while len(samples) and max_radius < 2.0 * max_diameter:
        found = measure_opposite_widths(points, normals, smooth_face, edges, max_radius, samples, tree)
        if len(found.width) and stride > 1:
            around = tree.query_ball_point(
                points[found.contacts[:REFINED_MINIMA, 0]], REFINED_RADIUS_SPACINGS * stride**0.5 * spacing
            )
            samples = np.unique(np.concatenate([found.contacts[:, 0], *around]).astype(np.int64))
            found = measure_opposite_widths(points, normals, smooth_face, edges, max_radius, samples, tree)
        if len(found.width):
            return float(found.width[0]), found.centre[0]
        samples, max_radius = found.samples_at_max_radius, 2.0 * max_radius
    return None
