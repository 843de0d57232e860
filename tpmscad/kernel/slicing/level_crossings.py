"""Where horizontal planes cross the sides of a triangulated solid, on its exact faces and edges.

The triangulation decides only which sides a plane crosses, so that contours close whatever the size of the triangles. A crossing
is a root of z(t) = level along the side: the straight line between two parameters on a face, or the curve of an edge. On a curve
it is one point for the faces on either side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.index_ranges import expand_ranges
from tpmscad.kernel.occt.geometry_evaluators import CurveTable, SurfaceTable
from tpmscad.kernel.slicing.surface_triangulation import SurfaceTriangulation

MAX_ROOT_STEPS = 60
"""Steps of the search for a root: Newton's, and bisection where that would leave the bracket; three or four do mostly."""

LEVEL_REL_TOL = 1e-13
"""Distance from the level, in sizes of the solid, at which a root is found."""


NODE_REL_TOL = 1e-9
"""In sizes of the solid: a node that is less below a level counts as on it, so that copies of a face that differ by round-off are
cut alike."""


SideEvaluator = Callable[[Array, IntArray], tuple[Array, Array]]
"""Fractions (n,) along lines on a face or an edge, and the numbers of the lines (n,), to points (n, 3) and the derivatives of
their heights (n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelSets:
    """The levels at which each face of a mesh is cut.

    heights: all levels, set after set, ascending in each, (n,). starts: where each set begins, and n, (s + 1,). of_face: the set
    of each face, (F,). tol: height below a level from which a node counts as on it.
    """

    heights: Array
    starts: IntArray
    of_face: IntArray
    tol: float

    @classmethod
    def of_solid(cls, heights: Array, mesh: SurfaceTriangulation) -> LevelSets:
        """The same levels (n,), ascending, for all faces of a mesh."""
        n_faces = len(mesh.surfaces.evaluators)
        return cls(heights, np.array([0, len(heights)]), np.zeros(n_faces, np.int64), NODE_REL_TOL * mesh.size)

    def rank(self, z: Array, face: IntArray) -> IntArray:
        """Number of the first level of a face (n,) that is above the height z (n,): a node on a level counts as above it."""
        if len(self.heights) == 0:
            return np.zeros(len(z), np.int64)
        low, high = float(self.heights.min()) - 4 * self.tol, float(self.heights.max()) + 4 * self.tol
        of_level = np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))
        bands = 2.0 * (high - low) * np.arange(len(self.starts) - 1)  # each set in a range of heights of its own
        own = np.clip(z + self.tol, low, high) + bands[self.of_face[face]]
        return np.searchsorted(self.heights + bands[of_level], own, side="right")


@dataclass(frozen=True, slots=True, eq=False)
class Crossings:
    """Crossings of sides and levels, and the segments between two of them on one triangle.

    point: (n, 2). level: number of the level of each, (n,). edge: on which it lies, or -1 inside a face, (n,), and parameter: of
    the edge's curve there, (n,). tail, head: crossings at the ends of each segment, in the direction that has the solid on its
    left, (s,). face: of each segment, (s,). tail_uv, head_uv: parameters of its ends there, (s, 2).
    """

    point: Array
    level: IntArray
    edge: IntArray
    parameter: Array
    tail: IntArray
    head: IntArray
    face: IntArray
    tail_uv: Array
    head_uv: Array


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """Distinct sides of a mesh.

    of_corner: their numbers, by the corner at which they start, (m, 3). nodes (k, 2), parameters of the ends, uv (k, 2, 2), and
    face (k,) are those of the triangle that was met first. segment: of an edge, or -1, (k,).
    """

    of_corner: IntArray
    nodes: IntArray
    uv: Array
    face: IntArray
    segment: IntArray


def find_crossings(mesh: SurfaceTriangulation, levels: LevelSets) -> Crossings:
    """Crossings of the faces of a mesh with horizontal planes at their levels."""
    z = mesh.points[:, 2]
    rank = levels.rank(z, mesh.face_of_node)
    sides = number_sides(mesh)
    ends = rank[sides.nodes]
    lowest, count = ends.min(axis=1), np.abs(ends[:, 1] - ends[:, 0])
    first = np.concatenate([[0], np.cumsum(count)])
    side, level = expand_ranges(lowest, lowest + count)
    fraction, point = np.empty(len(side)), np.empty((len(side), 2))
    heights, target, tol = z[sides.nodes[side]], levels.heights[level], LEVEL_REL_TOL * mesh.size
    for members, line in lines_of_sides(mesh, sides, side):
        fraction[members], point[members] = _find_roots(line, heights[members], target[members], tol)
    edge, parameter = np.full(len(side), -1), np.zeros(len(side))
    outer = np.flatnonzero(sides.segment[side] >= 0)
    at_first, at_second = _ends_on_edges(mesh, sides, side[outer])
    edge[outer] = mesh.segments.edge[sides.segment[side[outer]]]
    parameter[outer] = (1.0 - fraction[outer]) * at_first + fraction[outer] * at_second

    corner_rank = rank[mesh.triangles]
    low, high = corner_rank.min(axis=1), corner_rank.max(axis=1)
    triangle, at = expand_ranges(low, high)
    here, beyond = corner_rank[triangle], np.roll(corner_rank, -1, axis=1)[triangle]
    rising = np.argmax((here <= at[:, None]) & (at[:, None] < beyond), axis=1)
    falling = np.argmax((beyond <= at[:, None]) & (at[:, None] < here), axis=1)

    def end(corner: IntArray) -> tuple[IntArray, Array]:
        """Crossing of a corner's side, and its parameters on the face of this triangle."""
        number = sides.of_corner[triangle, corner]
        crossing = first[number] + at - lowest[number]
        same_way = mesh.triangles[triangle, corner] == sides.nodes[number, 0]
        along = np.where(same_way, fraction[crossing], 1.0 - fraction[crossing])[:, None]
        uv = (1.0 - along) * mesh.uv[triangle, corner] + along * mesh.uv[triangle, (corner + 1) % 3]
        return crossing, uv

    tail, tail_uv = end(falling)
    head, head_uv = end(rising)
    return Crossings(point, level, edge, parameter, tail, head, mesh.face[triangle], tail_uv, head_uv)


def number_sides(mesh: SurfaceTriangulation) -> Sides:
    """Number the sides: an edge segment is one side, and a chord inside a face is one of that face."""
    triangles, n = mesh.triangles, int(mesh.nodes.max()) + 1
    own = np.stack([mesh.nodes, np.roll(mesh.nodes, -1, axis=1)], axis=-1).reshape(-1, 2)
    nodes = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    uv = np.stack([mesh.uv, np.roll(mesh.uv, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    face, segment = np.repeat(mesh.face, 3), mesh.segment.ravel()
    chord = (face * n + own.min(axis=1)) * n + own.max(axis=1)
    _, first, number = np.unique(np.where(segment >= 0, -1 - segment, chord), return_index=True, return_inverse=True)
    return Sides(number.reshape(-1, 3), nodes[first], uv[first], face[first], segment[first])


def lines_of_sides(
    mesh: SurfaceTriangulation, sides: Sides, which: IntArray
) -> Iterator[tuple[IntArray, SideEvaluator]]:
    """Positions in `which` (n,) of the sides on faces and on edges, and the lines from their first nodes to their second ones."""
    segment = sides.segment[which]
    inside, outer = np.flatnonzero(segment < 0), np.flatnonzero(segment >= 0)
    if len(inside):
        uv = sides.uv[which[inside]]
        yield inside, _lines_on_faces(mesh.surfaces, sides.face[which[inside]], uv[:, 0], uv[:, 1] - uv[:, 0])
    if len(outer):
        begin, end = _ends_on_edges(mesh, sides, which[outer])
        yield outer, _lines_on_edges(mesh.curves, mesh.segments.edge[segment[outer]], begin, end)


def _ends_on_edges(mesh: SurfaceTriangulation, sides: Sides, which: IntArray) -> tuple[Array, Array]:
    """Parameters on the curves of edges at the first and the second node of sides (n,) that lie on edges: (n,), (n,)."""
    own, table = sides.segment[which], mesh.segments
    against = table.nodes[own, 0] != sides.nodes[which, 0]
    begin, end = (table.parameters[own, np.where(against, 1 - k, k)] for k in (0, 1))
    return begin, end


def _lines_on_faces(surfaces: SurfaceTable, face: IntArray, start: Array, by: Array) -> SideEvaluator:
    def evaluate(t: Array, which: IntArray) -> tuple[Array, Array]:
        x, xu, xv = surfaces(face[which], start[which] + t[:, None] * by[which])
        return x, xu[:, 2] * by[which, 0] + xv[:, 2] * by[which, 1]

    return evaluate


def _lines_on_edges(curves: CurveTable, edge: IntArray, begin: Array, end: Array) -> SideEvaluator:
    def evaluate(t: Array, which: IntArray) -> tuple[Array, Array]:
        x, slope = curves(edge[which], (1.0 - t) * begin[which] + t * end[which])
        return x, slope[:, 2] * (end - begin)[which]

    return evaluate


def _find_roots(line: SideEvaluator, ends: Array, target: Array, tol: float) -> tuple[Array, Array]:
    """Fractions in [0, 1] where z is the target, and the points there; ends (n, 2) are the heights at 0 and 1.

    Newton's method from the chord, safeguarded by bisection.
    """
    rising = ends[:, 1] > ends[:, 0]
    low, high = np.zeros(len(target)), np.ones(len(target))
    t = np.clip((target - ends[:, 0]) / (ends[:, 1] - ends[:, 0]), 0.0, 1.0)
    point = np.empty((len(target), 2))
    active = np.arange(len(target))
    for _ in range(MAX_ROOT_STEPS):
        x, slope = line(t[active], active)
        point[active] = x[:, :2]
        off = x[:, 2] - target[active]
        short = (off < 0) == rising[active]
        low[active] = np.where(short, t[active], low[active])
        high[active] = np.where(short, high[active], t[active])
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = t[active] - off / slope
        outside = ~((newton >= low[active]) & (newton <= high[active]))
        step = np.where(outside, 0.5 * (low[active] + high[active]), newton)
        done = (np.abs(off) <= tol) | (high[active] - low[active] <= np.finfo(float).eps)
        t[active] = np.where(done, t[active], step)
        active = active[~done]
        if len(active) == 0:
            break
    return t, point
