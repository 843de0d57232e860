"""Edges of solids divided once for all faces that they bound, alike where faces are congruent.

Of faces that are congruent one is triangulated, the representative. Their edges have to be divided alike, and so have the edges
that these share with other faces, and so on: the classes of edges are the connected components of edges and of the
representatives' uses of edges. An edge that is in one class with its own reverse is divided symmetrically.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, join_breps, select_faces
from tpmscad.brep.face_classes import group_congruent_faces, group_translated_faces
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.triangles.height_extrema import divide_at_extrema
from tpmscad.brep.triangles.measured_deviation import bound_chords, divide_curves
from tpmscad.index_ranges import expand_ranges
from tpmscad.kernel.build.edges import straight_edges
from tpmscad.kernel.build.solids import BrepSolids, build_faces
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, first_vertex, last_vertex, orientation_sign
from tpmscad.kernel.occt.geometry_evaluators import (
    CurveEvaluator,
    CurveTable,
    SplineCurveEvaluator,
    edge_evaluator,
    pack_curves,
)
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve

EDGE_FRACTION = 0.97
"""Part of the deviation that chords of edges take: the triangles at the edge add to it."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceOutlines:
    """Distinct faces (f,) of solids on distinct edges (e,) and vertices (v, 3), and the faces that stand for congruent ones.

    sources: OCCT faces of the representatives, which are the faces `first` (r,). of_face (f,): representative of each face;
    motion: from there, None if every face stands for itself. uses (k,): edges face by face, those of face i from use_start[i]
    on, in the order in which the explorer finds those of its representative, degenerate ones left out; turned (k,): whether the
    curve runs the other way than that of the representative. ends (e, 2): vertices of each edge along its curve. edges: those
    that representatives use, by number; curves: theirs, in ascending order. solids: faces of each group, in order, and whether
    they are seen from behind.
    """

    sources: tuple[TopoDS_Face, ...]
    first: IntArray
    of_face: IntArray
    motion: Motion | None
    use_start: IntArray
    uses: IntArray
    turned: BoolArray
    ends: IntArray
    points: Array
    edges: dict[int, TopoDS_Edge]
    curves: CurveTable
    solids: tuple[tuple[IntArray, BoolArray], ...]

    def uses_of(self, representative: int) -> IntArray:
        """The edges of a representative."""
        face = self.first[representative]
        return self.uses[self.use_start[face] : self.use_start[face + 1]]

    @property
    def own_edges(self) -> IntArray:
        """The edges that representatives use, in ascending order."""
        return np.array(sorted(self.edges), np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeDivision:
    """The nodes of edges: those of edge e are its vertices and first[e] up to first[e] + chords[e] - 1, along its curve.

    placed: parameters and points of the nodes along edges that representatives use, by the number of the edge. deviation: of the
    chords from the curves.
    """

    chords: IntArray
    first: IntArray
    placed: dict[int, tuple[Array, Array]]
    deviation: float

    def nodes(self, ends: IntArray, edge: int) -> IntArray:
        """The nodes (chords + 1,) of an edge with these ends (2,)."""
        inner = np.arange(self.first[edge], self.first[edge] + self.chords[edge] - 1)
        return np.concatenate([ends[:1], inner, ends[1:]])


def explore_faces(groups: Sequence[Sequence[TopoDS_Face]]) -> FaceOutlines:
    """The distinct ones of groups of faces, each of which stands for itself."""
    number: dict[ShapeKey, int] = {}
    edge_number: dict[ShapeKey, int] = {}
    vertex_number: dict[ShapeKey, int] = {}
    distinct: list[TopoDS_Face] = []
    edges: list[TopoDS_Edge] = []
    points: list[tuple[float, float, float]] = []
    ends, uses, use_start = [], [], [0]
    for face in (face for faces in groups for face in faces):
        if ShapeKey(face) in number:
            continue
        number[ShapeKey(face)] = len(distinct)
        distinct.append(face)
        for edge in list_proper_edges(face):
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
            uses.append(edge_number[key])
        use_start.append(len(uses))
    each = np.arange(len(distinct))
    return FaceOutlines(
        tuple(distinct),
        each,
        each,
        None,
        np.array(use_start),
        np.array(uses, np.int64),
        np.zeros(len(uses), bool),
        np.array(ends, np.int64).reshape(-1, 2),
        np.array(points, float).reshape(-1, 3),
        dict(enumerate(edges)),
        pack_curves([edge_evaluator(edge) for edge in edges]),
        tuple(
            (np.array([number[ShapeKey(face)] for face in faces], np.int64), np.array([*map(_is_turned, faces)], bool))
            for faces in groups
        ),
    )


def list_proper_edges(face: TopoDS_Face) -> list[TopoDS_Edge]:
    """The edges of a face but for degenerate ones, in the explorer's order, which is that of a Brep's uses."""
    return [edge for edge in edges_of(face) if not BRep_Tool.Degenerated_s(edge)]


def _is_turned(face: TopoDS_Face) -> bool:
    """Whether triangles that are counter-clockwise in the parameters of a face are clockwise from outside."""
    matrix = convert.matrix_from_occt(face.Location().Transformation())
    return bool((orientation_sign(face) < 0) != (np.linalg.det(matrix[:, :3]) < 0))


def outline_built_solids(built: Sequence[BrepSolids], resolution: float, *, upright: bool = False) -> FaceOutlines:
    """The faces of solids that were built from arrays; one of each class of congruent faces becomes a face of OCCT.

    upright: whether the faces of a class are translated copies only.
    """
    brep, number = _share_items([of.brep for of in built])
    faces, uses = brep.faces, brep.uses
    classes = (group_translated_faces if upright else group_congruent_faces)(brep, resolution)
    start = np.append(faces.use_start[faces.loop_start[:-1]], len(uses))
    source = classes.first[classes.label]
    face, other = expand_ranges(start[source], start[source + 1])
    place = start[face] + classes.use_order[other] - start[source[face]]
    own, turned = np.empty(len(uses), np.int64), np.empty(len(uses), bool)
    own[place] = uses.edge[classes.use_order]
    turned[place] = uses.sense[classes.use_order] != uses.sense[classes.use_order[other]]
    part = drop_unused_geometry(select_faces(brep, classes.first))
    made = build_faces(part)
    edges: dict[int, TopoDS_Edge] = {}
    for each, f in zip(made, classes.first.tolist(), strict=True):
        edges |= dict(zip(uses.edge[start[f] : start[f + 1]].tolist(), list_proper_edges(each), strict=True))
    base = faces.motion[source]
    inverse = Motion(np.swapaxes(base.rotation, 1, 2), -base.apply_inverse_to_vectors(base.translation))
    begin = np.cumsum([0, *(len(of.brep.faces) for of in built)])
    solids = [
        (number[begin[i] + of.faces_of_solid(k)], of.brep.faces.sense[of.faces_of_solid(k)] < 0)
        for i, of in enumerate(built)
        for k in range(of.n_solids)
    ]
    ends = np.column_stack([brep.edges.start, brep.edges.end])
    motion = faces.motion @ inverse
    return FaceOutlines(
        made,
        classes.first,
        classes.label,
        motion,
        start,
        own,
        turned,
        ends,
        brep.vertices,
        edges,
        _pack_edges(part, [edges[e] for e in sorted(edges)]),
        tuple(solids),
    )


def _pack_edges(brep: Brep, made: Sequence[TopoDS_Edge]) -> CurveTable:
    """The curves of edges with the parameters of those that were made of them; splines need not be read from these."""
    straight = set(straight_edges(brep).tolist())
    evaluators: list[CurveEvaluator] = []
    for e, (index, edge) in enumerate(zip(brep.edges.curve.tolist(), made, strict=True)):
        curve = brep.curves[index]
        if isinstance(curve, BSplineCurve) and e not in straight:
            moved = BSplineCurve(brep.edges.motion[e].apply(curve.poles), curve.knots, curve.degree)
            evaluators.append(SplineCurveEvaluator(moved))
        else:
            evaluators.append(edge_evaluator(edge))
    return pack_curves(evaluators)


def _share_items(breps: Sequence[Brep]) -> tuple[Brep, IntArray]:
    """The faces of boundary representations, those that they share once, and the numbers there of all faces one after another.

    Shared vertices have equal coordinates; shared edges and faces the same geometry, too.
    """
    if len(breps) == 1:
        return breps[0], np.arange(len(breps[0].faces))
    brep = join_breps(breps)
    _, first, vertex = np.unique(brep.vertices, axis=0, return_index=True, return_inverse=True)
    edges, faces = brep.edges, brep.faces
    start, end = vertex.ravel()[edges.start], vertex.ravel()[edges.end]
    curve = np.array([id(each) for each in brep.curves])[edges.curve]
    rows = np.column_stack([curve, start, end, edges.span.view(np.int64)])
    _, kept, edge = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    edge = edge.ravel()
    brep = replace(
        brep,
        vertices=brep.vertices[first],
        edges=replace(
            edges,
            curve=edges.curve[kept],
            motion=edges.motion[kept],
            span=edges.span[kept],
            start=start[kept],
            end=end[kept],
            deviation=edges.deviation[kept],
        ),
        uses=replace(brep.uses, edge=edge[brep.uses.edge]),
    )
    known: dict[tuple[int, ...], int] = {}
    begin = [*faces.use_start[faces.loop_start[:-1]].tolist(), len(brep.uses)]
    first_of: list[int] = []
    number = []
    for f, carrier in enumerate(faces.carrier.tolist()):
        key = id(brep.carriers[carrier]), *sorted(brep.uses.edge[begin[f] : begin[f + 1]].tolist())
        if known.setdefault(key, len(first_of)) == len(first_of):
            first_of.append(f)
        number.append(known[key])
    return select_faces(brep, np.array(first_of)), np.array(number)


def divide_edges(
    outlines: FaceOutlines, deviation: float, angle: float, least: IntArray, extremum_tol: float | None = None
) -> EdgeDivision:
    """The nodes of edges, divided alike where congruent faces use them; `least` (e,) chords or more.

    extremum_tol: where the height exceeds that of both neighbours by more, there is a node, too.
    """
    own, curves = outlines.own_edges, outlines.curves
    label, against = _link_edges(outlines)
    turned = label > against
    kinds, first = np.unique(np.minimum(label, against)[own], return_index=True)
    klass = np.searchsorted(kinds, np.minimum(label, against))
    needed = np.zeros(len(first), np.int64)
    np.maximum.at(needed, klass, least)
    span = np.array([BRep_Tool.Range_s(outlines.edges[e]) for e in own.tolist()]).reshape(-1, 2)
    limit = np.full(len(first), EDGE_FRACTION * deviation)
    symmetric = (label == against)[own[first]]
    distinct = curves.select(first)
    shares = divide_curves(distinct, span[first], limit, angle, needed, symmetric)
    if extremum_tol is not None:
        shares = divide_at_extrema(distinct, span[first], shares, extremum_tol)
    reverse = turned != turned[own[first]][klass]
    chords = np.array([len(each) - 1 for each in shares], np.int64)[klass]
    before = len(outlines.points) + np.cumsum(chords - 1) - (chords - 1)
    if not len(own):
        return EdgeDivision(chords, before, {}, 0.0)
    t = []
    for e, (low, high) in zip(own.tolist(), span.tolist(), strict=True):
        each = shares[klass[e]]
        t.append(low + (1.0 - each[::-1] if reverse[e] else each) * (high - low))
    which = np.repeat(np.arange(len(own)), chords[own] + 1)
    points = curves(which, np.concatenate(t))[0]
    limits = np.cumsum([0, *(chords[own] + 1).tolist()])
    points[limits[:-1]], points[limits[1:] - 1] = outlines.points[outlines.ends[own]].swapaxes(0, 1)
    placed = dict(zip(own.tolist(), zip(t, np.split(points, limits[1:-1]), strict=True), strict=True))
    begin = np.delete(np.arange(len(which)), limits[1:] - 1)
    pairs = begin[:, None] + np.arange(2)
    reached = bound_chords(curves, which[begin], np.concatenate(t)[pairs], points[pairs])
    return EdgeDivision(chords, before, placed, float(reached.max()))


def _link_edges(outlines: FaceOutlines) -> tuple[IntArray, IntArray]:
    """Labels (e,) of the classes of edges, and of the reverses of these classes: those of an edge that is in both are equal."""
    n, count = len(outlines.ends), len(outlines.ends) + len(outlines.uses)
    source, start = outlines.first[outlines.of_face], outlines.use_start
    slot = n + expand_ranges(start[source], start[source + 1])[1]
    edge, reverse = outlines.uses, np.where(outlines.turned, count, 0)
    pairs = [np.concatenate([edge, edge + count]), np.concatenate([slot + reverse, slot + count - reverse])]
    label = label_linked(2 * count, np.stack(pairs, axis=1))
    return label[:n], label[count : count + n]


def count_least_chords(outlines: FaceOutlines) -> IntArray:
    """Chords that each edge needs lest it fall together with another one between its vertices, or with itself: (e,)."""
    pair = np.sort(outlines.ends, axis=1)
    _, inverse, count = np.unique(pair, axis=0, return_inverse=True, return_counts=True)
    return np.where(pair[:, 0] == pair[:, 1], 3, np.where(count[inverse.ravel()] > 1, 2, 1))
