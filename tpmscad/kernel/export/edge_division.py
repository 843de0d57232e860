"""Edges of solids divided once for all faces that they bound, alike where faces are congruent.

Of faces that are congruent one is triangulated, the representative. Their edges have to be divided alike, and so have the edges
that these share with other faces, and so on: the classes of edges are the connected components of edges and of the
representatives' uses of edges. An edge that is in one class with its own reverse is divided symmetrically.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.face_classes import group_congruent_faces
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.triangles.measured_deviation import bound_chords, divide_curves
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, first_vertex, last_vertex
from tpmscad.kernel.occt.geometry_evaluators import CurveTable
from tpmscad.rigid_motion import Motion

EDGE_FRACTION = 0.97
"""Part of the deviation that chords of edges take: the triangles at the edge add to it."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceCopy:
    """A face as a copy: its class of congruent faces, motion, uses of edges in the order of the class, and their senses."""

    label: tuple[int, int]
    motion: Motion
    order: IntArray
    sense: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class FaceOutlines:
    """Distinct faces with their distinct edges, degenerate ones left out, and vertices (v, 3).

    ends (e, 2): vertices of each edge along its curve. uses: of each face the edges by number, in the explorer's order.
    """

    faces: tuple[TopoDS_Face, ...]
    number: dict[ShapeKey, int]
    edges: tuple[TopoDS_Edge, ...]
    ends: IntArray
    points: Array
    uses: list[IntArray]


@dataclass(frozen=True, slots=True, eq=False)
class FaceGrouping:
    """Faces by representatives: of each face its representative, its motion from there, its edges by the representative's uses.

    sources: the representatives as faces. motion: None if every face stands for itself. edges: of each face one for each use of
    the representative; turned: whether its curve runs the other way.
    """

    sources: IntArray
    of_face: IntArray
    motion: Motion | None
    edges: list[IntArray]
    turned: list[BoolArray]

    def own_edges(self, outlines: FaceOutlines) -> IntArray:
        """The edges that representatives use, in ascending order."""
        return np.unique(np.concatenate([np.zeros(0, np.int64), *(outlines.uses[f] for f in self.sources.tolist())]))


@dataclass(frozen=True, slots=True, eq=False)
class EdgeDivision:
    """The nodes of edges: those of edge e are its vertices and first[e] up to first[e] + chords[e] - 1, along its curve.

    shares: of the span of each edge, in ascending order. placed: parameters and points of the nodes along edges that
    representatives use, by the number of the edge. deviation: of the chords from the curves.
    """

    shares: list[Array]
    chords: IntArray
    first: IntArray
    placed: dict[int, tuple[Array, Array]]
    deviation: float

    def nodes(self, ends: IntArray, edge: int) -> IntArray:
        """The nodes (chords + 1,) of an edge with these ends (2,)."""
        inner = np.arange(self.first[edge], self.first[edge] + self.chords[edge] - 1)
        return np.concatenate([ends[:1], inner, ends[1:]])


def find_copies(built: Sequence[BrepSolids], resolution: float) -> dict[ShapeKey, FaceCopy]:
    """The faces of solids that were built from arrays as copies of each other, those of each among themselves."""
    found: dict[ShapeKey, FaceCopy] = {}
    for number, solids in enumerate(built):
        brep = solids.brep
        classes = group_congruent_faces(brep, resolution)
        first_use = brep.faces.use_start[brep.faces.loop_start]
        order = np.split(classes.use_order - first_use[brep.face_of_use[classes.use_order]], first_use[1:-1])
        senses = np.split(brep.uses.sense[classes.use_order], first_use[1:-1])
        for face, label, motion, own, sense in zip(
            solids.faces, classes.label.tolist(), brep.faces.motion, order, senses, strict=True
        ):
            found.setdefault(ShapeKey(face), FaceCopy((number, label), motion, own, sense))
    return found


def explore_faces(faces: Sequence[TopoDS_Face]) -> FaceOutlines:
    """The distinct ones of faces, with their edges and vertices."""
    number: dict[ShapeKey, int] = {}
    edge_number: dict[ShapeKey, int] = {}
    vertex_number: dict[ShapeKey, int] = {}
    distinct: list[TopoDS_Face] = []
    edges: list[TopoDS_Edge] = []
    points: list[tuple[float, float, float]] = []
    ends, uses = [], []
    for face in faces:
        if ShapeKey(face) in number:
            continue
        number[ShapeKey(face)] = len(distinct)
        distinct.append(face)
        own = []
        for edge in edges_of(face):
            if BRep_Tool.Degenerated_s(edge):
                continue
            key = ShapeKey(edge)
            if key not in edge_number:
                edge_number[key] = len(edges)
                edges.append(edge)
                pair = []
                for vertex in (first_vertex(edge), last_vertex(edge)):
                    if vertex_number.setdefault(ShapeKey(vertex), len(points)) == len(points):
                        points.append(BRep_Tool.Pnt_s(vertex).Coord())
                    pair.append(vertex_number[ShapeKey(vertex)])
                ends.append(pair)
            own.append(edge_number[key])
        uses.append(np.array(own, np.int64))
    return FaceOutlines(
        tuple(distinct),
        number,
        tuple(edges),
        np.array(ends, np.int64).reshape(-1, 2),
        np.array(points, float).reshape(-1, 3),
        uses,
    )


def group_faces_by_copies(outlines: FaceOutlines, copies: dict[ShapeKey, FaceCopy]) -> FaceGrouping:
    """The faces grouped by what they are copies of."""
    if not copies:
        each = np.arange(len(outlines.faces))
        return FaceGrouping(each, each, None, outlines.uses, [np.zeros(len(own), bool) for own in outlines.uses])
    number: dict[Any, int] = {}
    sources: list[int] = []
    motions: list[Motion | None] = []
    of_face, edges, turned = [], [], []
    known: dict[int, FaceCopy | None] = {}
    for f, (face, uses) in enumerate(zip(outlines.faces, outlines.uses, strict=True)):
        copy = copies.get(ShapeKey(face))
        key = f if copy is None else copy.label
        r = number.setdefault(key, len(sources))
        if r == len(sources):
            sources.append(f)
            known[r] = copy
        of_face.append(r)
        first = known[r]
        if copy is None or first is None:
            edges.append(uses)
            turned.append(np.zeros(len(uses), bool))
            motions.append(None)
            continue
        own = np.empty(len(uses), np.int64)  # by the uses of the representative as the explorer finds them
        own[first.order] = uses[copy.order]
        differs = np.empty(len(uses), bool)
        differs[first.order] = copy.sense != first.sense
        edges.append(own)
        turned.append(differs)
        motions.append(copy.motion)
    rest = Motion.identity(1)[0]
    base = Motion.stack([each.motion if each is not None else rest for each in known.values()])[np.array(of_face)]
    placed = Motion.stack([each if each is not None else rest for each in motions])
    inverse = Motion(np.swapaxes(base.rotation, 1, 2), -base.apply_inverse_to_vectors(base.translation))
    return FaceGrouping(np.array(sources), np.array(of_face), placed @ inverse, edges, turned)


def divide_edges(
    outlines: FaceOutlines, grouping: FaceGrouping, curves: CurveTable, deviation: float, angle: float, least: IntArray
) -> EdgeDivision:
    """The nodes of edges, divided alike where congruent faces use them; `least` (e,) chords or more.

    curves: of the edges that representatives use, in ascending order.
    """
    n, own = len(outlines.edges), grouping.own_edges(outlines)
    label, against = _link_edges(outlines, grouping)
    turned = label > against
    _, first, klass = np.unique(np.minimum(label, against)[own], return_index=True, return_inverse=True)
    of_label = dict(zip(np.minimum(label, against)[own].tolist(), klass.tolist(), strict=True))
    klass = np.array([of_label[each] for each in np.minimum(label, against).tolist()], np.int64)
    needed = np.zeros(len(first), np.int64)
    np.maximum.at(needed, klass, least)
    span = np.array([BRep_Tool.Range_s(outlines.edges[e]) for e in own.tolist()]).reshape(-1, 2)
    limit = np.full(len(first), EDGE_FRACTION * deviation)
    symmetric = (label == against)[own[first]]
    of_class = divide_curves(curves.select(first), span[first], limit, angle, needed, symmetric)
    shares = [
        of_class[k] if same else 1.0 - of_class[k][::-1]
        for k, same in zip(klass.tolist(), (turned == turned[own[first]][klass]).tolist(), strict=True)
    ]
    chords = np.array([len(each) - 1 for each in shares], np.int64)
    before = len(outlines.points) + np.cumsum(chords - 1) - (chords - 1)
    if not n:
        return EdgeDivision(shares, chords, before, {}, 0.0)
    t = [low + shares[e] * (high - low) for e, (low, high) in zip(own.tolist(), span.tolist(), strict=True)]
    which = np.repeat(np.arange(len(own)), chords[own] + 1)
    points = curves(which, np.concatenate(t))[0]
    limits = np.cumsum([0, *(chords[own] + 1).tolist()])
    points[limits[:-1]], points[limits[1:] - 1] = outlines.points[outlines.ends[own]].swapaxes(0, 1)
    placed = dict(zip(own.tolist(), zip(t, np.split(points, limits[1:-1]), strict=True), strict=True))
    begin = np.delete(np.arange(len(which)), limits[1:] - 1)
    pairs = begin[:, None] + np.arange(2)
    reached = bound_chords(curves, which[begin], np.concatenate(t)[pairs], points[pairs])
    return EdgeDivision(shares, chords, before, placed, float(reached.max()))


def _link_edges(outlines: FaceOutlines, grouping: FaceGrouping) -> tuple[IntArray, IntArray]:
    """Labels (e,) of the classes of edges, and of the reverses of these classes: those of an edge that is in both are equal."""
    n, owners = len(outlines.edges), grouping.sources[grouping.of_face]
    first_slot = np.cumsum([0, *(len(own) for own in outlines.uses)])
    count = n + int(first_slot[-1])
    edge = np.concatenate([np.zeros(0, np.int64), *grouping.edges])
    slots = [first_slot[f] + np.arange(len(own)) for f, own in zip(owners.tolist(), grouping.edges, strict=True)]
    slot = n + np.concatenate([np.zeros(0, np.int64), *slots])
    reverse = np.where(np.concatenate([np.zeros(0, bool), *grouping.turned]), count, 0)
    pairs = [np.concatenate([edge, edge + count]), np.concatenate([slot + reverse, slot + count - reverse])]
    label = label_linked(2 * count, np.stack(pairs, axis=1))
    return label[:n], label[count : count + n]


def count_least_chords(outlines: FaceOutlines) -> IntArray:
    """Chords that each edge needs lest it fall together with another one between its vertices, or with itself: (e,)."""
    pair = np.sort(outlines.ends, axis=1)
    _, inverse, count = np.unique(pair, axis=0, return_inverse=True, return_counts=True)
    return np.where(pair[:, 0] == pair[:, 1], 3, np.where(count[inverse.ravel()] > 1, 2, 1))
