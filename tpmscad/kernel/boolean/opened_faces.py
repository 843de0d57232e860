"""What remains of the open faces of a body where voids reach the outside through them.

Each open face is planar and is bounded anew: by its own edges, by those of the voids in it, and, where two open faces meet, by
the parts of their common edge between the voids that open at the edge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
from OCP.TopAbs import TopAbs_FORWARD
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Vertex, TopoDS_Wire

from tpmscad._typing import Array
from tpmscad.brep.carriers import Plane
from tpmscad.brep.loops import LoopError, chain_loops, nest_loops
from tpmscad.errors import KernelError, format_point
from tpmscad.kernel.measure.shape_sampling import sample_edge
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, first_vertex, last_vertex, orientation_sign

OPERATION = "opening of the skin"

OPENING_TOL = 1e-6
"""Model units: largest distance of a void from the open face, or from the edge of two, through which it opens."""

CHORDS_PER_EDGE = 16
"""Chords per edge when loops are nested."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenFace:
    """An open face of a body, its plane with the outward normal, and the faces of voids that lie in it."""

    face: TopoDS_Face
    plane: Plane
    holes: list[TopoDS_Face]


def find_remaining_faces(open_faces: Sequence[OpenFace]) -> Iterator[TopoDS_Face]:
    """The open faces without their holes, as faces that share the edges of the holes and of the other faces of the body."""
    common = [key for key, uses in _count_uses(own.face for own in open_faces).items() if uses == 2]
    opened = {key for key, uses in _count_uses(hole for own in open_faces for hole in own.holes).items() if uses == 2}
    remaining = _subtract_segments(common, opened)
    for own in open_faces:
        edges = [part for edge in edges_of(own.face) for part in _oriented_parts(edge, remaining)]
        for hole in own.holes:
            edges += [convert.as_edge(edge.Reversed()) for edge in edges_of(hole) if ShapeKey(edge) not in opened]
        if edges:
            yield from _bound_faces(own, edges)


def _count_uses(faces: Iterator[TopoDS_Face]) -> Counter[ShapeKey]:
    """How many of the faces use each edge."""
    return Counter(ShapeKey(edge) for face in faces for edge in edges_of(face))


def _subtract_segments(common: Sequence[ShapeKey], opened: Iterable[ShapeKey]) -> dict[ShapeKey, list[TopoDS_Edge]]:
    """The parts of each straight edge between two open faces on which no edge of a void lies, as forward edges."""
    lines = [np.array([_position(first_vertex(key.shape)), _position(last_vertex(key.shape))]) for key in common]
    gaps: list[list[_Gap]] = [[] for _ in common]
    for key in opened:
        ends = first_vertex(key.shape), last_vertex(key.shape)
        points = np.array([_position(vertex) for vertex in ends])
        on = next((i for i, line in enumerate(lines) if _distance_from_line(points, line) < OPENING_TOL), None)
        if on is None:
            raise KernelError(
                OPERATION, f"a void meets two open faces off their common edge near {format_point(points[0])}"
            )
        along = (points - lines[on][0]) @ (lines[on][1] - lines[on][0])
        first, last = np.argsort(along)
        gaps[on].append(_Gap(float(along[first]), ends[first], ends[last]))
    return {key: list(_parts_between(key.shape, own)) for key, own in zip(common, gaps, strict=True)}


@dataclass(frozen=True, slots=True, eq=False)
class _Gap:
    """Where a void opens along an edge: from a vertex to a later one; `at` grows along the edge."""

    at: float
    start: TopoDS_Vertex
    end: TopoDS_Vertex


def _position(vertex: TopoDS_Vertex) -> Array:
    """The point (3,) of a vertex."""
    return np.array(BRep_Tool.Pnt_s(vertex).Coord())


def _distance_from_line(points: Array, line: Array) -> float:
    """The largest distance of points (n, 3) from the line through two points (2, 3)."""
    direction = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    return float(np.linalg.norm(np.cross(points - line[0], direction), axis=1).max())


def _parts_between(edge: TopoDS_Edge, gaps: Sequence[_Gap]) -> Iterator[TopoDS_Edge]:
    """The parts of a straight edge between gaps, which share their vertices; the edge itself if it has none."""
    if not gaps:
        yield convert.as_edge(edge.Oriented(TopAbs_FORWARD))
        return
    at = first_vertex(edge)
    for gap in sorted(gaps, key=lambda gap: gap.at):
        yield from _segment(at, gap.start)
        at = gap.end
    yield from _segment(at, last_vertex(edge))


def _segment(start: TopoDS_Vertex, end: TopoDS_Vertex) -> Iterator[TopoDS_Edge]:
    """The straight edge between two vertices; none between those that coincide."""
    if start.IsSame(end) or np.linalg.norm(_position(end) - _position(start)) <= OPENING_TOL:
        return
    made = BRepBuilderAPI_MakeEdge(start, end)
    if not made.IsDone():
        raise KernelError(OPERATION, f"the kernel makes no edge from {format_point(_position(start))}")
    yield made.Edge()


def _oriented_parts(edge: TopoDS_Edge, remaining: dict[ShapeKey, list[TopoDS_Edge]]) -> list[TopoDS_Edge]:
    """What remains of an edge of an open face, oriented as the face uses it."""
    parts = remaining.get(ShapeKey(edge))
    return [edge] if parts is None else [convert.as_edge(part.Oriented(edge.Orientation())) for part in parts]


def _bound_faces(own: OpenFace, edges: Sequence[TopoDS_Edge]) -> Iterator[TopoDS_Face]:
    """The faces in the plane of an open face that directed edges bound, with the faces on the left of the edges."""
    number: dict[ShapeKey, int] = {}
    ends = [(first_vertex(edge), last_vertex(edge))[:: orientation_sign(edge)] for edge in edges]
    start, end = np.array([[number.setdefault(ShapeKey(v), len(number)) for v in pair] for pair in ends]).T
    chords = [own.plane.parameters(sample_edge(edge, CHORDS_PER_EDGE)) for edge in edges]

    def direction(edge: int, at_end: bool) -> Array:
        step = np.diff(chords[edge][-2:] if at_end else chords[edge][:2], axis=0)[0]
        return step / np.linalg.norm(step)

    try:
        loops = chain_loops(start, end, direction)
        nested = nest_loops([np.concatenate([chords[i][:-1] for i in loop]) for loop in loops])
    except LoopError as error:
        raise KernelError(OPERATION, str(error), own.face) from error
    builder, surface = BRep_Builder(), convert.plane(own.plane.origin, own.plane.x_axis, own.plane.y_axis)
    for members in nested:
        part = TopoDS_Face()
        builder.MakeFace(part, surface, CONFUSION_TOLERANCE)
        for loop in members:
            wire = TopoDS_Wire()
            builder.MakeWire(wire)
            for i in loops[loop]:
                builder.Add(wire, edges[i])
            wire.Closed(True)
            builder.Add(part, wire)
        yield part
