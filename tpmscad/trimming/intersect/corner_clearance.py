"""Shifts of a lattice that keep its corners clear of the faces of a body, and its edges clear of those of the body.

Where a corner of a patch just crosses a face of the body, or a side of a patch passes close by an edge of the body, a trimmed
patch gets an edge as short as that, and a mesh its worst elements. These distances follow from points and segments, without any
intersection: hundreds of shifts within the tolerance are compared before the first is carried out.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.near_balls import find_near_balls
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.trimming.intersect.arrangement import Operands

N_DIRECTIONS = 60
"""Directions of the shifts that are compared, spread evenly over the sphere."""

SHIFT_FRACTIONS = (0.2, 0.4, 0.7, 1.0)
"""Lengths of the shifts that are compared, in parts of the largest one allowed."""

SEGMENTS_PER_SIDE = 48
SEGMENTS_PER_BODY_EDGE = 256
"""Straight segments by which sides of patches and edges of the body are replaced, for their distances."""

MIN_CROSSING_SINE = 0.05
"""Sine of the angle below which a side and an edge run along each other and have no single nearest points."""

MAX_SHIFT_CLEARANCES = 10.0
"""Longest shift, in clearances, however large the tolerance: two or three suffice, and far pairs need no comparison."""

MIN_GAIN = 2.0
"""Factor by which the best shift must improve the clearance if none reaches the one asked for."""


def find_clear_shift(operands: Operands, clearance: float, max_shift: float) -> tuple[Array, float, float]:
    """The shortest of the shifts that gives the clearance, else the best one; the clearances without and with it.

    Zeros (3,) if the lattice is clear as it stands, or if no shift gains `MIN_GAIN`. Corners that lie in a face of the body
    within the vertex tolerance are no slivers as long as they stay there.
    """
    if not operands.candidates.any():  # no patch meets the body
        return np.zeros(3), np.inf, np.inf
    max_shift = min(max_shift, MAX_SHIFT_CLEARANCES * clearance)
    points, surface = _corners_near_surfaces(operands)
    surfaces = operands.body.surfaces.take(surface)
    if surfaces.is_free_form.any():  # foot points cost too much for corners that no shift brings near
        reach = clearance + max_shift
        kept = np.flatnonzero(~surfaces.is_free_form | (np.abs(surfaces.value(points[:, None])[:, 0]) < reach))
        points, surfaces = points[kept], surfaces.take(kept)
    passes, normals = _edges_near_body_edges(operands, clearance + max_shift)

    def distances(shift: Array) -> Array:
        corners = surfaces.value((points + shift)[:, None])[:, 0]
        return np.abs(np.concatenate([corners, passes + normals @ shift]))

    standing = distances(np.zeros(3))
    before = float(standing[standing >= operands.snap].min(initial=np.inf))
    best, after = np.zeros(3), before
    if before >= clearance or max_shift <= 0:
        return best, before, after
    for length in max_shift * np.array(SHIFT_FRACTIONS):
        for direction in _spread_directions(N_DIRECTIONS):
            reached = float(distances(length * direction).min())
            if reached > after:
                best, after = length * direction, reached
        if after >= clearance:
            break
    return (best, before, after) if after >= min(clearance, MIN_GAIN * before) else (np.zeros(3), before, before)


def _corners_near_surfaces(o: Operands) -> tuple[Array, IntArray]:
    """Corners of patches (n, 3) and surfaces of the body (n,) that these patches may intersect, each pair once."""
    edges = o.lattice.edges
    use, surface = np.nonzero(o.candidates[o.sides.face])
    count = o.candidates.shape[1]
    pairs = [ends[o.sides.edge[use]] * count + surface for ends in (edges.start, edges.end)]
    vertex, surface = np.divmod(np.unique(np.concatenate(pairs)), count)
    return o.lattice.vertices[vertex], surface


def _edges_near_body_edges(o: Operands, reach: float) -> tuple[Array, Array]:
    """Signed distances (n,) within `reach` between sides of patches and edges of the body, and their directions (n, 3)."""
    near = np.flatnonzero(o.candidates.any(axis=1))
    e, edges = np.unique(o.sides.edge[np.isin(o.sides.face, near)]), o.lattice.edges
    x = np.linspace(0.0, 1.0, SEGMENTS_PER_SIDE + 1)
    t = edges.span[e, :1] + np.diff(edges.span[e], axis=1) * x
    rows = np.repeat(e, len(x))
    (local,) = evaluate_curves(o.curves, edges.curve[rows], t.ravel())
    sides = edges.motion[rows].apply(local).reshape(len(e), len(x), 3)
    spans = zip(o.body.curves, o.body.brep.edges.span.tolist(), strict=True)
    body = np.stack([c(np.linspace(low, high, SEGMENTS_PER_BODY_EDGE + 1)) for c, (low, high) in spans])
    (a, along), (b, beside) = (
        (0.5 * (p[:, 1:] + p[:, :-1]).reshape(-1, 3), np.diff(p, axis=1).reshape(-1, 3)) for p in (sides, body)
    )
    half_a, half_b = (0.5 * np.linalg.norm(v, axis=1) for v in (along, beside))
    i, j = find_near_balls(a, half_a, reach, "sides of patches and edges of the body", "use larger cells", (b, half_b))
    normal = np.cross(along[i], beside[j])
    length = np.linalg.norm(normal, axis=1)
    crossed = length > MIN_CROSSING_SINE * 4.0 * half_a[i] * half_b[j]
    i, j, normal = i[crossed], j[crossed], normal[crossed] / length[crossed, None]
    apart = a[i] - b[j]
    ahead = np.cross(beside[j], normal)
    across = np.cross(along[i], normal)
    s = -(apart * ahead).sum(axis=1) / (along[i] * ahead).sum(axis=1)  # the nearest points, in parts of the segments
    t_body = (apart * across).sum(axis=1) / (beside[j] * across).sum(axis=1)
    distance = (apart * normal).sum(axis=1)
    met = (np.abs(s) < 0.6) & (np.abs(t_body) < 0.6) & (np.abs(distance) < reach)
    return distance[met], normal[met]


def _spread_directions(count: int) -> Array:
    """Unit vectors (count, 3) on a spiral from pole to pole (a Fibonacci lattice)."""
    i = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * i / count, np.pi * (1.0 + 5.0**0.5) * i
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
