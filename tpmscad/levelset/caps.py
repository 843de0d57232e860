"""Planar caps of a box: the faces that close what the level sets leave open, bounded by open edges and by edges of the box.

Open edges have the solid on their left as seen from outside the box. Along every edge of the box solid and void alternate at the
vertices of the level sets, starting from the phase at the edge's first corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.brep import loops
from tpmscad.brep.carriers import Plane
from tpmscad.errors import LevelSetError, format_point
from tpmscad.levelset.quadmesh.octree_faces import FACE_AXES

LOOP_PARAMETERS = np.linspace(0.0, 1.0, 9)
"""Parameters at which an open edge is sampled to find out which loop contains which."""


@dataclass(frozen=True, slots=True, eq=False)
class CapEdges(ArrayTable):
    """Open edges (n,): plane (2 * axis + upper), number, sense (+1 or -1) in the cap, first and last vertex in that sense."""

    plane: IntArray
    edge: IntArray
    sense: IntArray
    start: IntArray
    end: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class BoxEdgeSegments:
    """Segments of the box's edges in the solid: `ends` (n, 2), vertices in the direction of the axis.

    `plane`, `sense` (n, 2): the two faces of the box that each segment lies in, and its sense in their caps.
    """

    ends: IntArray
    plane: IntArray
    sense: IntArray


def make_box_plane(plane: int, lo: Array, hi: Array) -> Plane:
    """The plane of a face of the box, 2 * axis + upper, with its normal outwards."""
    axis, upper = divmod(plane, 2)
    normal, x_axis = np.zeros(3), np.zeros(3)
    normal[axis] = 1.0 if upper else -1.0
    x_axis[FACE_AXES[axis][0]] = 1.0
    return Plane((hi if upper else lo).astype(float), x_axis, normal)


def find_solid_box_edges(
    vertices: Array, fixed: BoolArray, corner_solid: BoolArray, lo: Array, hi: Array
) -> tuple[BoxEdgeSegments, Array]:
    """The segments of the box's edges in the solid, and the corners (n, 3) of the box that they need as further vertices.

    `fixed`: coordinates of vertices (V, 3) on the box. `corner_solid` (2, 2, 2): corners of the box in the solid. LevelSetError
    if solid and void do not alternate along an edge.
    """
    box = np.stack([lo, hi])
    corner_vertex: dict[tuple[int, ...], int] = {}
    ends, planes, senses = [], [], []
    on_edge = np.flatnonzero(fixed.sum(axis=1) == 2)
    for (axis, (b, c)), (upper_b, upper_c) in product(enumerate(FACE_AXES), product((0, 1), repeat=2)):
        between = on_edge[~fixed[on_edge, axis]]
        between = between[(vertices[between, b] == box[upper_b, b]) & (vertices[between, c] == box[upper_c, c])]
        between = between[np.argsort(vertices[between, axis])]
        corners = [tuple({axis: end, b: upper_b, c: upper_c}[k] for k in range(3)) for end in (0, 1)]
        first, last = (bool(corner_solid[corner]) for corner in corners)
        if (len(between) % 2 == 1) == (first == last):
            where = format_point(np.where(np.array(corners[1]), hi, lo), 6)
            raise LevelSetError(
                f"solid and void do not alternate along the edge of the box at {where} along {'xyz'[axis]}: "
                "walls touch there; use a finer `tol` or move the box"
            )
        stops = between.tolist()
        if first:
            stops = [corner_vertex.setdefault(corners[0], len(vertices) + len(corner_vertex)), *stops]
        if last:
            stops = [*stops, corner_vertex.setdefault(corners[1], len(vertices) + len(corner_vertex))]
        for pair in zip(stops[0::2], stops[1::2], strict=True):
            ends.append(pair)
            planes.append((2 * b + upper_b, 2 * c + upper_c))
            senses.append([_edge_sense(axis, b, upper_b, c, upper_c), _edge_sense(axis, c, upper_c, b, upper_b)])
    points = np.array([np.where(np.array(key), hi, lo) for key in corner_vertex]).reshape(-1, 3)
    segments = BoxEdgeSegments(*(np.array(column, np.int64).reshape(-1, 2) for column in (ends, planes, senses)))
    return segments, points


def _edge_sense(axis: int, normal_axis: int, normal_upper: int, other: int, other_upper: int) -> int:
    """+1 if the boundary of a face of the box, counter-clockwise from outside, runs up the axis at an edge; -1 if down."""
    normal, inward, along = np.zeros(3), np.zeros(3), np.zeros(3)
    normal[normal_axis] = 1 if normal_upper else -1
    inward[other] = -1 if other_upper else 1
    along[axis] = 1
    return int(np.cross(inward, normal) @ along)


def chain_cap_loops(
    plane: Plane, open_edges: CapEdges, rows: IntArray, polylines: Array
) -> list[list[list[tuple[int, int]]]]:
    """Faces of one plane, each a list of loops of (edge, sense), the outer loop first.

    `rows` are the open edges in the plane; `polylines` (len(rows), m, 3) are points along them in the sense of the cap.
    """
    flat = plane.parameters(polylines)

    def direction(i: int, at_end: bool) -> Array:
        return np.asarray(flat[i, -1] - flat[i, -2] if at_end else flat[i, 1] - flat[i, 0])

    try:
        chained = loops.chain_loops(open_edges.start[rows], open_edges.end[rows], direction)
    except loops.LoopError as error:
        end = format_point(polylines[error.index][-1], 6)
        raise LevelSetError(
            f"the cap's boundary does not close at {end}: a finer mesh is needed there, so use a finer `tol`"
        ) from error
    try:
        faces = loops.nest_loops([flat[loop][:, :-1].reshape(-1, 2) for loop in chained])
    except loops.LoopError as error:
        start = format_point(polylines[chained[error.index][0]][0], 6)
        raise LevelSetError(f"{error} near {start}: a finer mesh is needed there, so use a finer `tol`") from error
    return [
        [[(int(open_edges.edge[rows[k]]), int(open_edges.sense[rows[k]])) for k in chained[i]] for i in face]
        for face in faces
    ]
