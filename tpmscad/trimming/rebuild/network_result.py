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
from tpmscad.brep.loops import LoopError, chain_faces
from tpmscad.errors import NothingLeft, TrimmingError, format_point
from tpmscad.index_ranges import repeat_rows
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.trimming.intersect.arrangement import SubSegments
from tpmscad.trimming.intersect.common_curves import CommonCurves
from tpmscad.trimming.intersect.network_hits import Network
from tpmscad.trimming.operands.network_tables import list_spline_curves

SAMPLE_FRACTIONS = np.linspace(0.0, 1.0, 13)
"""Fractions of an edge at which the polygons of loops are sampled."""

VERTEX_MARGIN = 1.05
"""Factor on the distance of an edge's ends from its vertices: its tolerance must cover the distance, round-off included."""


@dataclass(frozen=True, slots=True, eq=False)
class CutNetwork:
    """One operand after the cut: the pieces of its edges, and which of them are inside the other solid."""

    network: Network
    pieces: SubSegments
    inside: BoolArray


@dataclass(frozen=True, slots=True)
class KeptPart:
    """The part of an operand, 0 or 1, inside the other solid or outside it, with its faces reversed or not."""

    operand: int
    inside: bool
    reverse: bool = False


def rebuild_networks(
    operands: tuple[CutNetwork, CutNetwork], parts: Sequence[KeptPart], arcs: CommonCurves, vertices: Array
) -> Brep:
    """The closed boundary representation of parts of both operands, given in the order of the operands.

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
    breps = tuple(o.network.brep for o in operands)
    first_pcurve = (0, len(breps[0].pcurves))
    first_arc_pcurve = sum(len(b.pcurves) for b in breps)
    pcurves = (*breps[0].pcurves, *breps[1].pcurves, *arcs.first_pcurves, *arcs.second_pcurves)
    n_arcs, first_arc = len(arcs.curves), sum(len(o.pieces.segment) for o in operands)
    rows: list[IntArray] = []
    loop_counts, use_counts, face_rows = [], [], []
    first_pieces = (0, len(operands[0].pieces.segment))
    for number, part in enumerate(parts):
        side = part.operand
        own, first_piece = operands[side], first_pieces[side]
        brep, offset = own.network.brep, first_pcurve[side]
        arcs_of_face: dict[int, list[int]] = {}
        for i, f in enumerate(arcs.faces[:, side].tolist()):
            arcs_of_face.setdefault(f, []).append(i)
        direction = (1 if side == 0 else -1) * (1 if part.inside else -1)
        kept = own.inside == part.inside
        for f in range(len(brep.faces)):
            uses = _collect_uses(own, kept, f, first_piece, offset)
            across = np.array(arcs_of_face.get(f, []), np.int64)
            if len(across):
                sense = np.full(len(across), direction * int(brep.faces.sense[f]))
                is_plane = isinstance(brep.carriers[brep.faces.carrier[f]], Plane)
                pcurve = np.full(len(across), -1) if is_plane else first_arc_pcurve + side * n_arcs + across
                uses = np.concatenate([uses, np.column_stack([first_arc + across, sense, pcurve])])
            if not len(uses):
                continue
            if len(across):
                made = _chain_face(own.network, f, uses, edges, operands, arcs, pcurves)
            else:
                made = [_original_loops(brep, f, uses)]
            for loops in made:
                face_rows.append((number, f))
                loop_counts.append(len(loops))
                for loop in loops:
                    use_counts.append(len(loop))
                    rows.append(loop)
    if not face_rows:
        raise NothingLeft("nothing is left of the two solids")
    table = np.array(face_rows, np.int64)
    uses = np.concatenate(rows)
    result = _assemble(operands, parts, arcs, edges, vertices, uses, table, loop_counts, use_counts, pcurves)
    return result, table[:, 0]


def _collect_uses(own: CutNetwork, kept: BoolArray, face: int, first_piece: int, first_pcurve: int) -> IntArray:
    """The kept pieces of a face's loops as rows (edge, sense, pcurve)."""
    brep, pieces = own.network.brep, own.pieces
    faces, uses = brep.faces, brep.uses
    k = np.arange(faces.use_start[faces.loop_start[face]], faces.use_start[faces.loop_start[face + 1]])
    edge = uses.edge[k]
    row, step = repeat_rows(pieces.first[edge + 1] - pieces.first[edge])
    owner = k[row]
    ahead = uses.sense[owner] > 0
    piece = np.where(ahead, pieces.first[uses.edge[owner]] + step, pieces.first[uses.edge[owner] + 1] - 1 - step)
    owner, piece = owner[kept[piece]], piece[kept[piece]]
    pcurve = np.where(uses.pcurve[owner] >= 0, uses.pcurve[owner] + first_pcurve, -1)
    return np.column_stack([first_piece + piece, uses.sense[owner], pcurve])


def _original_loops(brep: Brep, face: int, uses: IntArray) -> list[IntArray]:
    """The loops of a face that no arc crosses; TrimmingError if some of its edges are kept and others are not."""
    faces = brep.faces
    own = np.diff(faces.use_start[faces.loop_start[face] : faces.loop_start[face + 1] + 1])
    if own.sum() != len(uses):
        raise TrimmingError("a face that no common curve crosses is kept in part")
    return np.split(uses, np.cumsum(own)[:-1])


def _chain_face(
    network: Network,
    face: int,
    uses: IntArray,
    edges: Edges,
    operands: tuple[CutNetwork, CutNetwork],
    arcs: CommonCurves,
    pcurves: tuple[BSplineCurve, ...],
) -> list[list[IntArray]]:
    """The faces that edge uses bound on one face, as lists of loops of uses."""
    edge, back = uses[:, 0], uses[:, 1] < 0
    points = _sample_uses(network, face, uses, edges, operands, arcs, pcurves)
    points[back] = points[back, ::-1]

    start, end = np.where(back, edges.end[edge], edges.start[edge]), np.where(back, edges.start[edge], edges.end[edge])
    try:
        faces = chain_faces(start, end, list(points))
    except LoopError as error:
        brep = network.brep
        e = brep.uses.edge[brep.faces.use_start[brep.faces.loop_start[face]]]
        at = format_point(brep.vertices[brep.edges.start[e]])
        raise TrimmingError(f"{error}, of the face at {at}") from error
    return [[uses[loop] for loop in loops] for loops in faces]


def _sample_uses(
    network: Network,
    face: int,
    uses: IntArray,
    edges: Edges,
    operands: tuple[CutNetwork, CutNetwork],
    arcs: CommonCurves,
    pcurves: tuple[BSplineCurve, ...],
) -> Array:
    """(u, v) (n, m, 2) along edge uses, in the direction of their edges."""
    m = len(SAMPLE_FRACTIONS)
    low, high = edges.span[uses[:, 0]].T
    t = (low[:, None] + (high - low)[:, None] * SAMPLE_FRACTIONS).ravel()
    brep = network.brep
    carrier = brep.carriers[brep.faces.carrier[face]]
    if not isinstance(carrier, Plane):
        return evaluate_curves(pcurves, np.repeat(uses[:, 2], m), t)[0].reshape(-1, m, 2)
    edge = np.repeat(uses[:, 0], m)
    curves = _all_curves(operands, arcs)
    points = edges.motion[edge].apply(evaluate_curves(curves, edges.curve[edge], t)[0])
    return carrier.parameters(brep.faces.motion[face].apply_inverse(points)).reshape(-1, m, 2)


def _all_curves(operands: tuple[CutNetwork, CutNetwork], arcs: CommonCurves) -> tuple[BSplineCurve, ...]:
    """The curves of both operands, then those of the arcs."""
    one, other = (list_spline_curves(o.network.brep) for o in operands)
    return (*one, *other, *arcs.curves)


def _join_edges(operands: tuple[CutNetwork, CutNetwork], arcs: CommonCurves, vertices: Array) -> Edges:
    """All pieces of the first network's edges, of the second's, and the arcs, with what their ends miss their vertices by."""
    breps = [o.network.brep for o in operands]
    n = len(arcs.curves)
    first_curve = [0, len(breps[0].curves)]
    parts = [(b.edges, o.pieces, c) for b, o, c in zip(breps, operands, first_curve, strict=True)]
    edges = Edges(
        curve=np.concatenate(
            [*(e.curve[p.segment] + c for e, p, c in parts), sum(len(b.curves) for b in breps) + np.arange(n)]
        ),
        motion=Motion.concatenate([*(e.motion[p.segment] for e, p, _ in parts), Motion.identity(n)]),
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
    uses: IntArray,
    face_rows: IntArray,
    loop_counts: list[int],
    use_counts: list[int],
    pcurves: tuple[BSplineCurve, ...],
) -> Brep:
    """The boundary representation of all faces, rows (part, face), on the edges and vertices that they use."""
    breps = [o.network.brep for o in operands]
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
                faces.carrier[of] + (len(breps[0].carriers) if s else 0),
                faces.motion[of],
                faces.sense[of] * (-1 if part.reverse else 1),
                faces.tag[of] + (len(breps[0].tags) if s else 0),
            )
        )
    carrier, motion, sense, tag = zip(*columns, strict=True)
    return Brep(
        carriers=(*breps[0].carriers, *breps[1].carriers),
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
            loop_start=np.concatenate([[0], np.cumsum(loop_counts)]).astype(np.int64),
            use_start=np.concatenate([[0], np.cumsum(use_counts)]).astype(np.int64),
        ),
        tags=(*breps[0].tags, *breps[1].tags),
    )
