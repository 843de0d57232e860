"""Where horizontal planes cross the sides of triangulated faces, on the exact faces and edges.

The triangulation decides only which sides a plane crosses, so that contours close whatever the size of the triangles. A crossing
is a root of z(t) = level along the side: the straight line between two parameters on a face, or the curve of an edge. On a curve
it is one point for the faces on either side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.brep.triangles.height_extrema import Line
from tpmscad.brep.triangles.measured_deviation import Curves, FaceTriangles, Surfaces
from tpmscad.index_ranges import expand_ranges

MAX_ROOT_STEPS = 60
"""Steps of the search for a root: Newton's, and bisection where that would leave the bracket; three or four do mostly."""

LEVEL_REL_TOL = 1e-13
"""Distance from the level, in sizes of the solid, at which a root is found."""

NODE_REL_TOL = 1e-9
"""In sizes of the solid: a node that is less below a level counts as on it, so that copies of a face that differ by round-off are
cut alike."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelSets:
    """The levels at which each face of a mesh is cut.

    heights: all levels, set after set, ascending in each, (n,). starts: where the set of each face begins, and n, (F + 1,). size:
    of the solid.
    """

    heights: Array
    starts: IntArray
    size: float

    def rank(self, z: Array, face: IntArray) -> IntArray:
        """Number of the first level of a face (n,) that is above the height z (n,): a node on a level counts as above it."""
        if len(self.heights) == 0:
            return np.zeros(len(z), np.int64)
        tol = NODE_REL_TOL * self.size
        low, high = float(self.heights.min()) - 4 * tol, float(self.heights.max()) + 4 * tol
        of_level = np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))
        bands = 2.0 * (high - low) * np.arange(len(self.starts) - 1)  # each set in a range of heights of its own
        return np.searchsorted(self.heights + bands[of_level], np.clip(z + tol, low, high) + bands[face], side="right")


@dataclass(frozen=True, slots=True, eq=False)
class Chords(ArrayTable):
    """Chords of the edges of faces: both nodes (k, 2), their parameters (k, 2), the number of the curve (k,), and a name (k,)."""

    nodes: IntArray
    parameters: Array
    curve: IntArray
    name: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class OutlinedFaces:
    """Triangles of faces, what evaluates these, the chords of their edges, and what evaluates the curves of these."""

    mesh: FaceTriangles
    surfaces: Surfaces
    chords: Chords
    curves: Curves


@dataclass(frozen=True, slots=True, eq=False)
class Crossings:
    """Crossings of sides and levels, and the segments between two of them on one triangle.

    point: (n, 2). level: number of the level of each, (n,). chord: the name of the chord that it belongs to, or -1 inside a face,
    (n,). tail, head: crossings at the ends of each segment, in the direction that has the solid on its left, (s,). face: of each
    segment, (s,). tail_uv, head_uv: parameters of its ends there, (s, 2).
    """

    point: Array
    level: IntArray
    chord: IntArray
    tail: IntArray
    head: IntArray
    face: IntArray
    tail_uv: Array
    head_uv: Array


def find_crossings(faces: OutlinedFaces, levels: LevelSets) -> Crossings:
    """Crossings of faces with horizontal planes at their levels; the heights along each side are monotone."""
    mesh, chords = faces.mesh, faces.chords
    z, face_of_node = mesh.points[:, 2], np.zeros(len(mesh.points), np.int64)
    face_of_node[mesh.triangles] = mesh.face[:, None]
    rank = levels.rank(z, face_of_node)
    every = np.arange(mesh.triangles.size).reshape(-1, 3)
    distinct, of_corner = np.unique(np.where(mesh.twin < 0, every, np.minimum(every, mesh.twin)), return_inverse=True)
    of_corner = of_corner.reshape(-1, 3)
    nodes = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1).reshape(-1, 2)[distinct]
    lowest, count = rank[nodes].min(axis=1), np.abs(np.diff(rank[nodes], axis=1)[:, 0])
    first = np.concatenate([[0], np.cumsum(count)])
    side, level = expand_ranges(lowest, lowest + count)
    fraction, point = np.empty(len(side)), np.empty((len(side), 2))
    chord = _find_chords(mesh, chords, distinct, nodes)[side]
    inside, outer = np.flatnonzero(chord < 0), np.flatnonzero(chord >= 0)
    own = chords[chord[outer]]
    against = (own.nodes[:, 0] != nodes[side[outer], 0])[:, None]
    ends = np.where(against, own.parameters[:, ::-1], own.parameters)
    for members, line in (
        (inside, lines_on_faces(faces.surfaces, mesh.face[distinct[side[inside]] // 3], mesh.uv[nodes[side[inside]]])),
        (outer, _lines_on_curves(faces.curves, own.curve, ends)),
    ):
        of_side, target = z[nodes[side[members]]], levels.heights[level[members]]
        fraction[members], point[members] = _find_roots(line, of_side, target, LEVEL_REL_TOL * levels.size)
    name = np.full(len(side), -1)
    name[outer] = own.name

    corner_rank = rank[mesh.triangles]
    triangle, at = expand_ranges(corner_rank.min(axis=1), corner_rank.max(axis=1))
    here, beyond = corner_rank[triangle], np.roll(corner_rank, -1, axis=1)[triangle]
    rising = np.argmax((here <= at[:, None]) & (at[:, None] < beyond), axis=1)
    falling = np.argmax((beyond <= at[:, None]) & (at[:, None] < here), axis=1)

    def end(corner: IntArray) -> tuple[IntArray, Array]:
        """Crossing of a corner's side, and its parameters on the face of this triangle."""
        number = of_corner[triangle, corner]
        crossing = first[number] + at - lowest[number]
        along = fraction[crossing][:, None]
        a, b = mesh.uv[nodes[number]].swapaxes(0, 1)
        return crossing, (1.0 - along) * a + along * b

    tail, tail_uv = end(falling)
    head, head_uv = end(rising)
    return Crossings(point, level, name, tail, head, mesh.face[triangle], tail_uv, head_uv)


def _find_chords(mesh: FaceTriangles, chords: Chords, side: IntArray, nodes: IntArray) -> IntArray:
    """The chord that each of some sides (n,) with nodes (n, 2) is, or -1: (n,)."""
    found, outer = np.full(len(side), -1), np.flatnonzero(mesh.twin.ravel()[side] < 0)
    keys, wanted = (np.sort(each, axis=1) @ [len(mesh.points), 1] for each in (chords.nodes, nodes[outer]))
    order = np.argsort(keys)
    at = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
    found[outer] = np.where(keys[order][at] == wanted, order[at], -1)
    return found


def lines_on_faces(surfaces: Surfaces, face: IntArray, ends: Array) -> Line:
    """The lines between parameters (n, 2, 2) on faces (n,)."""
    start, by = ends[:, 0], ends[:, 1] - ends[:, 0]

    def evaluate(t: Array, which: IntArray) -> tuple[Array, Array]:
        x, xu, xv = surfaces(face[which], start[which] + t[:, None] * by[which])
        return x, xu[:, 2] * by[which, 0] + xv[:, 2] * by[which, 1]

    return evaluate


def _lines_on_curves(curves: Curves, curve: IntArray, ends: Array) -> Line:
    """The curves (n,) between parameters (n, 2)."""

    def evaluate(t: Array, which: IntArray) -> tuple[Array, Array]:
        begin, end = ends[which].T
        x, slope = curves(curve[which], (1.0 - t) * begin + t * end)
        return x, slope[:, 2] * (end - begin)

    return evaluate


def _find_roots(line: Line, ends: Array, target: Array, tol: float) -> tuple[Array, Array]:
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
