"""Planar caps of a box: what layouts leave open in its faces, closed along its edges.

Open edges run with the solid on their left as seen from outside the box. On every edge of the box solid and void alternate at the
layouts' vertices, starting from what holds at its corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep import loops
from tpmscad.brep.carriers import Plane
from tpmscad.errors import LevelSetError
from tpmscad.levelset.quadmesh.dual_mesh import FACE_AXES

LOOP_PARAMETERS = np.linspace(0.0, 1.0, 9)
"""Where along its parameter an open edge is looked at to see which loop lies in which."""


@dataclass(frozen=True, slots=True, eq=False)
class CapEdges:
    """Edges to be capped: plane (2 * axis + upper), number, +1 or -1 for the cap's use, first and last vertex that way."""

    plane: IntArray
    edge: IntArray
    sense: IntArray
    start: IntArray
    end: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class BoxEdgeSegments:
    """Pieces of the box's edges in the solid: vertices (n, 2) along the axis, and the two planes each piece lies in (n, 2)."""

    ends: IntArray
    plane: IntArray
    sense: IntArray


def make_box_plane(plane: int, lo: Array, hi: Array) -> Plane:
    """A face of the box, its normal outwards."""
    axis, upper = divmod(plane, 2)
    normal, x_axis = np.zeros(3), np.zeros(3)
    normal[axis] = 1.0 if upper else -1.0
    x_axis[FACE_AXES[axis][0]] = 1.0
    return Plane((hi if upper else lo).astype(float), x_axis, normal)


def find_solid_box_edges(
    vertices: Array, fixed: BoolArray, corner_solid: BoolArray, lo: Array, hi: Array
) -> tuple[BoxEdgeSegments, Array]:
    """The pieces of the box's edges in the solid, and the corners (n, 3) of the box that they need as further vertices.

    `corner_solid` (2, 2, 2): which corners are solid. LayoutError where solid and void do not alternate along an edge.
    """
    extra: dict[tuple[int, ...], int] = {}
    ends, planes, senses = [], [], []
    on_edge = np.flatnonzero(fixed.sum(axis=1) == 2)
    for axis, (b, c) in enumerate(FACE_AXES):
        for upper_b in (0, 1):
            for upper_c in (0, 1):
                box = np.stack([lo, hi])
                at = on_edge[~fixed[on_edge, axis]]
                at = at[(vertices[at, b] == box[upper_b, b]) & (vertices[at, c] == box[upper_c, c])]
                at = at[np.argsort(vertices[at, axis])]
                corner = [0, 0, 0]
                corner[b], corner[c] = upper_b, upper_c
                stops: list[int] = []
                states = []
                for end in (0, 1):
                    corner[axis] = end
                    states.append(bool(corner_solid[tuple(corner)]))
                    if states[-1]:
                        stops.append(extra.setdefault(tuple(corner), len(vertices) + len(extra)))
                    if end == 0:
                        stops += at.tolist()
                if (len(at) % 2 == 1) == (states[0] == states[1]):
                    where = ", ".join(f"{x:.6g}" for x in np.where(np.array(corner), hi, lo))
                    raise LevelSetError(
                        f"solid and void do not alternate along the edge of the box at ({where}) along {'xyz'[axis]}: "
                        "walls touch there; use a finer layout or move the box"
                    )
                for first, last in zip(stops[0::2], stops[1::2], strict=True):
                    ends.append((first, last))
                    planes.append((2 * b + upper_b, 2 * c + upper_c))
                    senses.append(
                        [_edge_direction(axis, b, upper_b, c, upper_c), _edge_direction(axis, c, upper_c, b, upper_b)]
                    )
    corners = np.array([np.where(np.array(key), hi, lo) for key in extra]).reshape(-1, 3)
    rim = BoxEdgeSegments(
        np.array(ends, np.int64).reshape(-1, 2),
        np.array(planes, np.int64).reshape(-1, 2),
        np.array(senses, np.int64).reshape(-1, 2),
    )
    return rim, corners


def _edge_direction(axis: int, normal_axis: int, normal_upper: int, other: int, other_upper: int) -> int:
    """Whether a face's border runs up (+1) or down the axis along one of its edges, counter-clockwise seen from outside."""
    normal, inward, along = np.zeros(3), np.zeros(3), np.zeros(3)
    normal[normal_axis] = 1 if normal_upper else -1
    inward[other] = -1 if other_upper else 1
    along[axis] = 1
    return int(np.cross(inward, normal) @ along)


def chain_cap_loops(
    plane: Plane, open_edges: CapEdges, at: IntArray, polylines: Array
) -> list[list[list[tuple[int, int]]]]:
    """Faces of one plane, each a list of loops of (edge, sense), an outer loop first. polylines (len(at), m, 3), in use order."""
    flat = plane.parameters(polylines)

    def direction(i: int, at_end: bool) -> Array:
        return np.asarray(flat[i, -1] - flat[i, -2] if at_end else flat[i, 1] - flat[i, 0])

    def where(point: Array) -> str:
        return ", ".join(f"{x:.6g}" for x in point)

    try:
        chained = loops.chain_loops(open_edges.start[at], open_edges.end[at], direction)
    except loops.LoopError as error:
        end = where(polylines[error.index][-1])
        raise LevelSetError(f"the cap's border does not close at ({end}): a finer layout is needed there") from error
    try:
        faces = loops.nest_loops([flat[loop][:, :-1].reshape(-1, 2) for loop in chained])
    except loops.LoopError as error:
        start = where(polylines[chained[error.index][0]][0])
        raise LevelSetError(f"{error} near ({start}): a finer layout is needed there") from error
    return [
        [[(int(open_edges.edge[at[k]]), int(open_edges.sense[at[k]])) for k in chained[i]] for i in face]
        for face in faces
    ]
