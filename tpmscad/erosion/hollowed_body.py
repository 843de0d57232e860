"""A body without the voids that a lattice leaves in it: their boundary reversed, and open faces bounded anew.

The voids lie deeper than the skin below every closed face, so that they touch the body in open faces only, all of them planar.
An open face is bounded by its own edges, and by those of the voids' faces that lie in it. Where two open faces meet, what remains
of their common edge are the parts between the voids that open there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import (
    Brep,
    Edges,
    EdgeUses,
    drop_unused_geometry,
    join_breps,
    reverse_faces,
    sample_edges,
    select_faces,
)
from tpmscad.brep.carriers import Plane
from tpmscad.brep.loops import LoopError, chain_faces, points_in_polygons
from tpmscad.errors import TrimmingError, format_point
from tpmscad.rigid_motion import Motion

OPENING_TOL = 1e-6
"""Model units: largest distance of a void from the open face, or from the edge of two, through which it opens."""

CHORDS_PER_EDGE, MAX_CHORDS = 16, 512
"""Chords per edge when loops are nested, and how many there may be for chords to be accurate."""

CHORD_REL_TOL = 1e-4
"""In sizes of what edges bound: how far chords may be off the edges. The wall between a void and the edge of an open face is
thicker, or it could be taken for one beyond that edge."""

VERTEX_MARGIN = 1.05
"""Factor on the distance of an edge's ends from its vertices: its tolerance must cover the distance, round-off included."""


@dataclass(frozen=True, slots=True, eq=False)
class HollowedBody:
    """A body divided into voids and what is left of it, on common faces.

    `left`: the faces of `shared` that bound what is left, with the sense that they have for it. `voids`: those that bound each
    void, in common with what is left, whose sense they have, or in an open face, with its sense and tag.
    """

    shared: Brep
    left: IntArray
    voids: tuple[IntArray, ...]


def hollow_body(body: Brep, voids: Sequence[Brep], is_open: BoolArray) -> Brep:
    """The body without disjoint voids inside it, which reach the outside through the open ones of its faces (F,).

    TrimmingError if a void meets an open face in a way that leaves no face.
    """
    divided = divide_by_voids(body, voids, is_open)
    return drop_unused_geometry(select_faces(divided.shared, divided.left))


def divide_by_voids(body: Brep, voids: Sequence[Brep], is_open: BoolArray) -> HollowedBody:
    """The body divided into such voids and what they leave of it; arguments and errors as of `hollow_body`."""
    joined = join_breps([body, *map(reverse_faces, voids)])
    owner = np.repeat(np.arange(len(voids) + 1), [len(body.faces), *(len(void.faces) for void in voids)])
    is_left = np.ones(len(joined.faces), bool)
    openings = np.flatnonzero(is_open)
    if len(openings):
        opened = _OpenedFaces(joined, openings, len(body.faces))
        is_left = opened.opening_of_face < 0
        whole = opened.bound_anew()
        n_added = len(whole.faces) - len(joined.faces)
        holes = opened.holes
        whole.faces.sense[holes] *= -1
        whole.faces.tag[holes] = whole.faces.tag[openings[opened.opening_of_face[holes]]]
        kept = np.append(~np.isin(np.arange(len(joined.faces)), openings), np.ones(n_added, bool))
        joined = select_faces(whole, np.flatnonzero(kept))
        owner, is_left = (np.append(each, np.full(n_added, of))[kept] for each, of in ((owner, 0), (is_left, True)))
    faces = tuple(np.flatnonzero(owner == k) for k in range(1, len(voids) + 1))
    return HollowedBody(joined, np.flatnonzero(is_left), faces)


def find_faces_in_openings(brep: Brep, planes: Sequence[Plane], outlines: Sequence[Array]) -> IntArray:
    """The opening in which each face lies, -1 if in none: (F,).

    planes, outlines: of each opening, its plane and the polygons (n, 2, 2) of its loops, as chords from start to end.
    """
    faces, uses = brep.faces, brep.uses
    found = np.full(len(faces), -1)
    for f in range(len(faces)):
        if not isinstance(brep.carriers[faces.carrier[f]], Plane):
            continue
        edge = uses.edge[faces.use_start[faces.loop_start[f]] : faces.use_start[faces.loop_start[f + 1]]]
        points = sample_edges(brep, 3, edge).reshape(-1, 3)
        for i, (plane, outline) in enumerate(zip(planes, outlines, strict=True)):
            flat = plane.parameters(points)
            in_plane = np.abs(plane.distance(points)).max() < OPENING_TOL
            if in_plane and points_in_polygons(outline[:, 0], outline[:, 1], flat).any():
                found[f] = i
    return found


def _sample_closely(brep: Brep, edges: IntArray) -> Array:
    """Points along edges, as of `sample_edges`, with so many chords for each that they are accurate."""
    chords = CHORDS_PER_EDGE
    while True:
        points = sample_edges(brep, 2 * chords + 1, edges)
        ends, middles = points[:, ::2], points[:, 1::2]
        off = np.linalg.norm(middles - 0.5 * (ends[:, 1:] + ends[:, :-1]), axis=2).max(initial=0.0)
        if chords >= MAX_CHORDS or off <= CHORD_REL_TOL * float(np.ptp(points, axis=(0, 1)).max(initial=0.0)):
            return ends
        chords *= 2


@dataclass(frozen=True, slots=True, eq=False)
class _Gap:
    """Where a void opens along an edge: from a vertex to a later one, at their parameters."""

    low: float
    high: float
    start: int
    end: int


class _OpenedFaces:
    """The open faces of a body that is joined with its reversed voids, and what of their edges remains.

    opening_of_face (F,): the opening that is or holds a face, -1 for all others.
    """

    def __init__(self, joined: Brep, openings: IntArray, n_body_faces: int) -> None:
        self.joined, self.openings = joined, openings
        faces, uses = joined.faces, joined.uses
        self.planes = [_place_plane(joined, f) for f in openings.tolist()]
        self.use_ends = faces.use_start[faces.loop_start]
        outlines = []
        for f, plane in zip(openings.tolist(), self.planes, strict=True):
            flat = plane.parameters(_sample_closely(joined, uses.edge[self._uses_of(f)]))
            outlines.append(np.stack([flat[:, :-1], flat[:, 1:]], axis=2).reshape(-1, 2, 2))
        void_faces = select_faces(joined, np.arange(n_body_faces, len(faces)))
        self.opening_of_face = np.full(len(faces), -1)
        self.opening_of_face[n_body_faces:] = find_faces_in_openings(void_faces, self.planes, outlines)
        self.holes = np.flatnonzero(self.opening_of_face >= 0)
        self.opening_of_face[openings] = np.arange(len(openings))

    def _uses_of(self, face: int) -> IntArray:
        return np.arange(self.use_ends[face], self.use_ends[face + 1])

    def _edges_used_twice(self, faces: IntArray) -> IntArray:
        """Edges that join two of the faces."""
        none = np.zeros(0, np.int64)
        edge, count = np.unique(
            np.concatenate([none, *(self.joined.uses.edge[self._uses_of(f)] for f in faces.tolist())]),
            return_counts=True,
        )
        return np.asarray(edge[count == 2])

    def bound_anew(self) -> Brep:
        """All faces, and what remains of the open ones as further faces, at the end."""
        joined = self.joined
        inner = self._edges_used_twice(self.holes)
        edges, parts = self._split_common_edges(self._edges_used_twice(self.openings), inner)
        opened = set(inner.tolist())
        whole = replace(joined, edges=edges)
        uses, loop_counts, use_counts, owners = [joined.uses.edge], [], [], []
        senses = [joined.uses.sense]
        for i, f in enumerate(self.openings.tolist()):
            rows = [
                (part, int(joined.uses.sense[k]))
                for k in self._uses_of(f).tolist()
                for part in parts.get(int(joined.uses.edge[k]), [int(joined.uses.edge[k])])
            ]
            for hole in self.holes[self.opening_of_face[self.holes] == i].tolist():
                turn = int(joined.faces.sense[hole] * joined.faces.sense[f])
                rows += [
                    (int(joined.uses.edge[k]), turn * int(joined.uses.sense[k]))
                    for k in self._uses_of(hole).tolist()
                    if int(joined.uses.edge[k]) not in opened
                ]
            for loops in self._chain(whole, f, np.array(rows, np.int64).reshape(-1, 2), self.planes[i]):
                owners.append(f)
                loop_counts.append(len(loops))
                for loop in loops:
                    use_counts.append(len(loop))
                    uses.append(loop[:, 0])
                    senses.append(loop[:, 1])
        own, faces, n = np.array(owners, np.int64), joined.faces, len(joined.uses)
        edge = np.concatenate(uses)
        return replace(
            whole,
            uses=EdgeUses(
                edge, np.concatenate(senses), np.concatenate([joined.uses.pcurve, np.full(len(edge) - n, -1)])
            ),
            faces=replace(
                faces,
                carrier=np.append(faces.carrier, faces.carrier[own]),
                motion=Motion.concatenate([faces.motion, faces.motion[own]]),
                sense=np.append(faces.sense, faces.sense[own]),
                tag=np.append(faces.tag, faces.tag[own]),
                loop_start=np.append(faces.loop_start, faces.loop_start[-1] + np.cumsum(loop_counts, dtype=np.int64)),
                use_start=np.append(faces.use_start, faces.use_start[-1] + np.cumsum(use_counts, dtype=np.int64)),
            ),
        )

    def _split_common_edges(self, common: IntArray, opened: IntArray) -> tuple[Edges, dict[int, list[int]]]:
        """All edges, and the parts of each straight edge between two open faces on which no void lies."""
        joined, edges = self.joined, self.joined.edges
        gaps: dict[int, list[_Gap]] = {e: [] for e in common.tolist()}
        lines = joined.vertices[np.stack([edges.start[common], edges.end[common]], axis=1)]
        for e in opened.tolist():
            ends = np.array([edges.start[e], edges.end[e]])
            points = joined.vertices[ends]
            on = next((i for i, line in enumerate(lines) if _distance_from_line(points, line) < OPENING_TOL), None)
            if on is None:
                raise TrimmingError(f"a void meets two open faces off their common edge near {format_point(points[0])}")
            along = lines[on][1] - lines[on][0]
            fractions = (points - lines[on][0]) @ along / (along @ along)
            first, last = np.argsort(fractions)
            low, high = edges.span[common[on]]
            at = low + (high - low) * fractions
            gaps[int(common[on])].append(_Gap(float(at[first]), float(at[last]), int(ends[first]), int(ends[last])))
        rows: list[tuple[int, float, float, int, int]] = []
        parts: dict[int, list[int]] = {}
        for e, own in gaps.items():
            if own:
                pieces = list(self._parts_between(e, own))
                parts[e] = list(range(len(edges) + len(rows), len(edges) + len(rows) + len(pieces)))
                rows += pieces
        if not rows:
            return edges, parts
        of, low, high, start, end = (np.array(column) for column in zip(*rows, strict=True))
        made = Edges(
            edges.curve[of], edges.motion[of], np.column_stack([low, high]), start, end, edges.deviation[of].copy()
        )
        ends = sample_edges(replace(joined, edges=made), 2)
        misses = np.linalg.norm(ends - joined.vertices[np.stack([start, end], axis=1)], axis=2).max(axis=1)
        np.maximum(made.deviation, VERTEX_MARGIN * misses, out=made.deviation)
        return _append_edges(edges, made), parts

    def _parts_between(self, edge: int, gaps: Sequence[_Gap]) -> Iterator[tuple[int, float, float, int, int]]:
        """Edge, parameters and vertices of the parts of an edge between gaps; none between vertices that coincide."""
        edges, vertices = self.joined.edges, self.joined.vertices
        ordered = sorted(gaps, key=lambda gap: gap.low)
        starts = [(float(edges.span[edge, 0]), int(edges.start[edge])), *((g.high, g.end) for g in ordered)]
        ends = [*((g.low, g.start) for g in ordered), (float(edges.span[edge, 1]), int(edges.end[edge]))]
        for (low, start), (high, end) in zip(starts, ends, strict=True):
            if start != end and np.linalg.norm(vertices[end] - vertices[start]) > OPENING_TOL:
                yield edge, low, high, start, end

    def _chain(self, whole: Brep, face: int, uses: IntArray, plane: Plane) -> list[list[IntArray]]:
        """The faces that directed edges (n, 2) bound in the plane of an open face, as lists of loops of them."""
        if not len(uses):
            return []
        edge, back = uses[:, 0], uses[:, 1] < 0
        points = plane.parameters(_sample_closely(whole, edge))
        points[back] = points[back, ::-1]
        edges = whole.edges
        start = np.where(back, edges.end[edge], edges.start[edge])
        end = np.where(back, edges.start[edge], edges.end[edge])
        try:
            faces = chain_faces(start, end, list(points))
        except LoopError as error:
            raise TrimmingError(f"{error}, of the open face at {format_point(whole.vertices[start[0]])}") from error
        return [[uses[loop] for loop in loops] for loops in faces]


def _place_plane(brep: Brep, face: int) -> Plane:
    """The placed plane of a face, with the (u, v) of its loops; TrimmingError if it lies on another surface."""
    carrier, motion = brep.carriers[brep.faces.carrier[face]], brep.faces.motion[face]
    if not isinstance(carrier, Plane):
        raise TrimmingError("an open face is not planar")
    x_axis, y_axis = motion.apply_to_vectors(carrier.x_axis), motion.apply_to_vectors(carrier.y_axis)
    return Plane(motion.apply(carrier.origin), x_axis, np.cross(x_axis, y_axis))


def _append_edges(one: Edges, other: Edges) -> Edges:
    """Edges of the same boundary representation, one after the other."""
    return Edges(
        np.append(one.curve, other.curve),
        Motion.concatenate([one.motion, other.motion]),
        np.concatenate([one.span, other.span]),
        np.append(one.start, other.start),
        np.append(one.end, other.end),
        np.append(one.deviation, other.deviation),
    )


def _distance_from_line(points: Array, line: Array) -> float:
    """The largest distance of points (n, 3) from the line through two points (2, 3)."""
    direction = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    return float(np.linalg.norm(np.cross(points - line[0], direction), axis=1).max())
