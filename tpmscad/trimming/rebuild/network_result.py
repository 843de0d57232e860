"""The boundary representation of a boolean operation on two networks, from their pieces of edges and their common curves.

Each face keeps the pieces of its loops on the side that the operation asks for, and gets the arcs across it, directed so that
this side is on their left. The directed edges are chained into loops by their vertices alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, drop_unused_geometry
from tpmscad.brep.carriers import Plane
from tpmscad.brep.loops import LoopError, chain_faces, follow_paths
from tpmscad.errors import NothingLeft, TrimmingError, format_point
from tpmscad.index_ranges import list_following, repeat_rows
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.trimming.classify.network_edges import EdgePieces
from tpmscad.trimming.intersect.common_curves import CommonCurves
from tpmscad.trimming.intersect.contacts import EdgesInFaces
from tpmscad.trimming.operands.edge_uses import list_spline_curves, project_onto_planes
from tpmscad.trimming.operands.patch_polynomials import find_starts

SAMPLE_FRACTIONS = np.linspace(0.0, 1.0, 13)
"""Fractions of an edge at which the polygons of loops are sampled."""

VERTEX_MARGIN = 1.05
"""Factor on the distance of an edge's ends from its vertices: its tolerance must cover the distance, round-off included."""


@dataclass(frozen=True, slots=True, eq=False)
class CutNetwork:
    """One operand after the cut: the pieces of its edges, and which of them are inside the other solid.

    `in_faces`: those that lie in faces of the other operand, where each use has a side of its own.
    """

    brep: Brep
    pieces: EdgePieces
    inside: BoolArray
    in_faces: EdgesInFaces


@dataclass(frozen=True, slots=True)
class KeptPart:
    """The part of an operand, 0 or 1, inside the other solid or outside it, with its faces reversed or not."""

    operand: int
    inside: bool
    reverse: bool = False


def rebuild_networks(
    operands: tuple[CutNetwork, CutNetwork], parts: Sequence[KeptPart], arcs: CommonCurves, vertices: Array
) -> Brep:
    """The closed boundary representation of parts of both operands, their faces in the order of the parts.

    `vertices` (V, 3) are those that the pieces and arcs refer to, those of arcs in its numbering. TrimmingError if a face or the
    whole does not close.
    """
    result, _ = rebuild_parts(operands, parts, arcs, vertices)
    check_closed(result)
    return drop_unused_geometry(result)


def check_closed(brep: Brep) -> None:
    """TrimmingError if the faces do not close."""
    unmatched = connectivity.find_unmatched_edges(brep)
    if len(unmatched):
        at = format_point(brep.vertices[brep.edges.start[unmatched[0]]])
        raise TrimmingError(f"{len(unmatched)} edges of the result are not used twice, the first at {at}")


def rebuild_parts(
    operands: tuple[CutNetwork, CutNetwork], parts: Sequence[KeptPart], arcs: CommonCurves, vertices: Array
) -> tuple[Brep, IntArray]:
    """The faces of all parts on common edges, and the part that each belongs to (F,); arguments as in `rebuild_networks`."""
    edges = _join_edges(operands, arcs, vertices)
    pcurves = (*operands[0].brep.pcurves, *operands[1].brep.pcurves, *arcs.pcurves[0], *arcs.pcurves[1])
    bounded = [_bound_part(operands, part, arcs, edges, pcurves) for part in parts]
    count = np.array([len(own.face) for own in bounded])
    if not count.any():
        raise NothingLeft("nothing is left of the two solids")
    table = np.column_stack([np.repeat(np.arange(len(parts)), count), np.concatenate([own.face for own in bounded])])
    result = _assemble(operands, parts, arcs, edges, vertices, bounded, table, pcurves)
    return result, table[:, 0]


@dataclass(frozen=True, slots=True, eq=False)
class _BoundedFaces:
    """Faces of a part: the operand's face (F,) that each lies on, and its number of loops (F,).

    `loop_lengths`: the uses of each loop. Rows of `uses` (K, 3) are (edge, sense, pcurve).
    """

    face: IntArray
    loops: IntArray
    loop_lengths: IntArray
    uses: IntArray


def _bound_part(
    operands: tuple[CutNetwork, CutNetwork],
    part: KeptPart,
    arcs: CommonCurves,
    edges: Edges,
    pcurves: tuple[BSplineCurve, ...],
) -> _BoundedFaces:
    """The faces of a part: those that no arc crosses with the loops that they have, others with loops chained anew."""
    side, own = part.operand, operands[part.operand]
    brep, pieces = own.brep, own.pieces
    n_first = len(operands[0].pieces.segment)
    # pieces of all edge uses, in the order of the loops
    edge, ahead = brep.uses.edge, brep.uses.sense > 0
    owner, step = repeat_rows(pieces.first[edge + 1] - pieces.first[edge])
    piece = np.where(ahead[owner], pieces.first[edge[owner]] + step, pieces.first[edge[owner] + 1] - 1 - step)
    pcurve = brep.uses.pcurve + (len(operands[0].brep.pcurves) if side else 0)
    pcurve[brep.uses.pcurve < 0] = -1
    uses = np.column_stack([piece + (n_first if side else 0), brep.uses.sense[owner], pcurve[owner]])
    loop = np.repeat(np.arange(len(brep.faces.use_start) - 1), np.diff(brep.faces.use_start))[owner]
    face = brep.face_of_use[owner]
    inside = own.inside[piece]
    n_uses, in_faces = len(brep.uses), own.in_faces
    row = np.argsort(piece * n_uses + owner)
    at = row[np.searchsorted((piece * n_uses + owner)[row], in_faces.piece * n_uses + in_faces.use)]
    inside[at] = in_faces.inside
    stays = inside == part.inside

    crossed, across_edges = np.zeros(len(brep.faces), bool), operands[1 - side].in_faces
    crossed[arcs.faces[:, side]] = True
    crossed[across_edges.arc_face] = True
    whole = stays & ~crossed[face]
    left = np.bincount(face[whole], minlength=len(brep.faces))
    if (left != np.bincount(face, minlength=len(brep.faces)))[left > 0].any():
        raise TrimmingError("a face that no common curve crosses is kept in part")
    of_loop = np.bincount(loop[whole], minlength=len(brep.faces.use_start) - 1)
    plain = np.flatnonzero(left)
    parts = [_BoundedFaces(plain, np.diff(brep.faces.loop_start)[plain], of_loop[of_loop > 0], uses[whole])]

    rows = np.flatnonzero(stays & crossed[face])
    across = np.arange(len(arcs.faces))
    of_arc = arcs.faces[:, side]
    direction = (1 if side == 0 else -1) * (1 if part.inside else -1)
    is_plane = np.array([isinstance(c, Plane) for c in brep.carriers], bool)[brep.faces.carrier[of_arc]]
    first_arc = n_first + len(operands[1].pieces.segment)
    first_pcurve = sum(len(o.brep.pcurves) for o in operands) + side * len(arcs.curves)
    new = np.column_stack(
        [first_arc + across, direction * brep.faces.sense[of_arc], np.where(is_plane, -1, first_pcurve + arcs.curve)]
    )
    # edges of the other operand that lie in planes of this one
    on, sense = across_edges.arc_face, across_edges.arc_sense
    first_piece = 0 if side else n_first
    lying = np.column_stack(
        [first_piece + across_edges.arc_piece, direction * brep.faces.sense[on] * sense, np.full(len(on), -1)]
    )
    uses, face = np.concatenate([uses[rows], new, lying]), np.concatenate([face[rows], of_arc, on])
    order = np.argsort(face, kind="stable")
    parts.append(_chain_crossed(brep, face[order], uses[order], edges, _all_curves(operands, arcs), pcurves))
    return _join_bounded(parts)


def _chain_crossed(
    brep: Brep,
    face: IntArray,
    uses: IntArray,
    edges: Edges,
    curves: tuple[BSplineCurve, ...],
    pcurves: tuple[BSplineCurve, ...],
) -> _BoundedFaces:
    """The faces that edge uses (n, 3), of the faces (n,) in ascending order, bound on them."""
    points = _sample_uses(brep, face, uses, edges, curves, pcurves)
    edge, back = uses[:, 0], uses[:, 1] < 0
    points[back] = points[back, ::-1]
    start, end = np.where(back, edges.end[edge], edges.start[edge]), np.where(back, edges.start[edge], edges.end[edge])
    simple, order, lengths = _follow_single_loops(face, start, end, points)
    parts = [_BoundedFaces(simple, np.ones(len(simple), np.int64), lengths, uses[order])]
    rest = np.flatnonzero(~np.isin(face, simple))
    on, count = np.unique(face[rest], return_counts=True)
    bounds = find_starts(count)
    for f, low, high in zip(on.tolist(), bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        own = rest[low:high]
        try:
            found = chain_faces(start[own], end[own], list(points[own]))
        except LoopError as error:
            e = brep.uses.edge[brep.faces.use_start[brep.faces.loop_start[f]]]
            at = format_point(brep.vertices[brep.edges.start[e]])
            raise TrimmingError(f"{error}, of the face at {at}") from error
        loops = [own[loop] for loops in found for loop in loops]
        counts = np.array([len(loops) for loops in found]), np.array([len(loop) for loop in loops])
        parts.append(_BoundedFaces(np.full(len(found), f), *counts, uses[np.concatenate(loops)]))
    return _join_bounded(parts)


def _follow_single_loops(
    face: IntArray, start: IntArray, end: IntArray, points: Array
) -> tuple[IntArray, IntArray, IntArray]:
    """The faces (n,) whose directed edges (m,) make one loop about an area, the edges loop by loop, and the loops' lengths (n,).

    points (m, k, 2): along each edge.
    """
    by_start, by_end = np.lexsort((start, face)), np.lexsort((end, face))
    following = np.empty(len(face), np.int64)
    following[by_end] = by_start
    bad = (face[by_start] != face[by_end]) | (start[by_start] != end[by_end])
    repeated = (np.diff(face[by_start]) == 0) & (np.diff(start[by_start]) == 0)
    other = np.concatenate([face[by_end][bad], face[by_start][bad], face[by_start][1:][repeated]])
    rows = np.flatnonzero(~np.isin(face, other))
    number = np.full(len(face), -1)
    number[rows] = np.arange(len(rows))
    order, first = follow_paths(number[following[rows]])
    order = rows[order]
    on, lengths = face[order[first[:-1]]], np.diff(first)
    x, y = (points[order] - points[np.repeat(order[first[:-1]], lengths), :1]).transpose(2, 0, 1)
    x_next, y_next = (np.concatenate([c[:, 1:], c[list_following(first), :1]], axis=1) for c in (x, y))
    twice_areas = np.add.reduceat((x * y_next - y * x_next).sum(axis=1), first[:-1]) if len(on) else np.zeros(0)
    single = np.bincount(on, minlength=1)[on] == 1
    kept = single & (twice_areas > 0)
    return on[kept], order[np.repeat(kept, lengths)], lengths[kept]


def _join_bounded(parts: Sequence[_BoundedFaces]) -> _BoundedFaces:
    """Bounded faces one after another."""
    return _BoundedFaces(*(np.concatenate([getattr(own, name) for own in parts]) for name in _BoundedFaces.__slots__))


def _sample_uses(
    brep: Brep,
    face: IntArray,
    uses: IntArray,
    edges: Edges,
    curves: tuple[BSplineCurve, ...],
    pcurves: tuple[BSplineCurve, ...],
) -> Array:
    """(u, v) (n, m, 2) along edge uses (n, 3) of the faces (n,), in the direction of their edges."""
    m = len(SAMPLE_FRACTIONS)
    low, high = edges.span[uses[:, 0]].T
    t = low[:, None] + (high - low)[:, None] * SAMPLE_FRACTIONS
    result = np.empty((len(uses), m, 2))
    curved = np.flatnonzero(uses[:, 2] >= 0)
    if len(curved):
        found = evaluate_curves(pcurves, np.repeat(uses[curved, 2], m), t[curved].ravel())[0]
        result[curved] = found.reshape(-1, m, 2)
    flat = np.flatnonzero(uses[:, 2] < 0)
    if len(flat):
        edge = np.repeat(uses[flat, 0], m)
        points = edges.motion[edge].apply(evaluate_curves(curves, edges.curve[edge], t[flat].ravel())[0])
        result[flat] = project_onto_planes(brep, np.repeat(face[flat], m), points).reshape(-1, m, 2)
    return result


def _all_curves(operands: tuple[CutNetwork, CutNetwork], arcs: CommonCurves) -> tuple[BSplineCurve, ...]:
    """The curves of both operands, then those of the arcs."""
    one, other = (list_spline_curves(o.brep) for o in operands)
    return (*one, *other, *arcs.curves)


def _join_edges(operands: tuple[CutNetwork, CutNetwork], arcs: CommonCurves, vertices: Array) -> Edges:
    """All pieces of the first network's edges, of the second's, and the arcs, with what their ends miss their vertices by."""
    breps = [o.brep for o in operands]
    n = len(arcs.faces)
    first_curve = [0, len(breps[0].curves)]
    parts = [(b.edges, o.pieces, c) for b, o, c in zip(breps, operands, first_curve, strict=True)]
    edges = Edges(
        curve=np.concatenate(
            [*(e.curve[p.segment] + c for e, p, c in parts), sum(len(b.curves) for b in breps) + arcs.curve]
        ),
        motion=Motion.concatenate([*(e.motion[p.segment] for e, p, _ in parts), arcs.motion]),
        span=np.concatenate([*(p.span for _, p, _ in parts), np.tile([0.0, 1.0], (n, 1))]),
        start=np.concatenate([*(p.start for _, p, _ in parts), arcs.start]),
        end=np.concatenate([*(p.end for _, p, _ in parts), arcs.end]),
        deviation=np.concatenate([*(e.deviation[p.segment] for e, p, _ in parts), arcs.deviation]),
    )
    cut = np.concatenate([*((np.diff(p.first) > 1)[p.segment] for _, p, _ in parts), np.ones(n, bool)])
    at = np.flatnonzero(cut)
    curves = _all_curves(operands, arcs)
    for column, of in ((0, edges.start), (1, edges.end)):
        if len(at):
            ends = edges.motion[at].apply(evaluate_curves(curves, edges.curve[at], edges.span[at, column])[0])
            gap = VERTEX_MARGIN * np.linalg.norm(ends - vertices[of[at]], axis=1)
            edges.deviation[at] = np.maximum(edges.deviation[at], gap)
    return edges


def _assemble(
    operands: tuple[CutNetwork, CutNetwork],
    parts: Sequence[KeptPart],
    arcs: CommonCurves,
    edges: Edges,
    vertices: Array,
    bounded: list[_BoundedFaces],
    face_rows: IntArray,
    pcurves: tuple[BSplineCurve, ...],
) -> Brep:
    """The boundary representation of all faces, rows (part, face), on the edges and vertices that they use."""
    breps = [o.brep for o in operands]
    uses = np.concatenate([own.uses for own in bounded])
    used, edge = np.unique(uses[:, 0], return_inverse=True)
    kept, ends = np.unique(np.concatenate([edges.start[used], edges.end[used]]), return_inverse=True)
    start, end = np.split(ends.ravel(), 2)
    part_of, face = face_rows.T
    columns = []
    for number, part in enumerate(parts):
        s, of = part.operand, face[part_of == number]
        faces = breps[s].faces
        columns.append(
            (
                faces.carrier[of] + (0 if s else len(breps[1].carriers)),
                faces.motion[of],
                faces.sense[of] * (-1 if part.reverse else 1),
                faces.tag[of] + (len(breps[0].tags) if s else 0),
            )
        )
    carrier, motion, sense, tag = zip(*columns, strict=True)
    return Brep(
        carriers=(*breps[1].carriers, *breps[0].carriers),
        curves=(*breps[0].curves, *breps[1].curves, *arcs.curves),
        pcurves=pcurves,
        vertices=vertices[kept],
        edges=Edges(edges.curve[used], edges.motion[used], edges.span[used], start, end, edges.deviation[used]),
        uses=EdgeUses(edge.ravel(), uses[:, 1], uses[:, 2]),
        faces=Faces(
            carrier=np.concatenate(carrier),
            motion=Motion.concatenate(motion),
            sense=np.concatenate(sense),
            tag=np.concatenate(tag),
            loop_start=find_starts(np.concatenate([own.loops for own in bounded])),
            use_start=find_starts(np.concatenate([own.loop_lengths for own in bounded])),
        ),
        tags=(*breps[0].tags, *breps[1].tags),
    )
