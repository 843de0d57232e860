"""The trimmed complex put together: inner faces, walls on what they leave open, and only the edges and vertices in use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep import loops
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.brep.carriers import EdgeCurve, Plane
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.trimming.intersect.body_edges import BodyEdgeIntersections
from tpmscad.trimming.intersect.curve_surface import (
    CurveSegments,
    CurveSurfaceIntersections,
    SubSegments,
    evaluate_segments,
)
from tpmscad.trimming.intersect.patch_surface import IntersectionCurves, PatchArcs
from tpmscad.trimming.operands.face_regions import FaceRegion
from tpmscad.trimming.operands.trimming_body import TrimmingBody, face_use_range
from tpmscad.trimming.rebuild.body_faces import BodySubEdges, CapBoundary, select_body_edges
from tpmscad.trimming.rebuild.body_pcurves import fit_edge_pcurves
from tpmscad.trimming.rebuild.lattice_faces import EdgeUse, FaceLoops

CAP_TAG = "cap"
"""The tag of the body's faces, flat or not."""

DEVIATION_MARGIN = 1.1
"""On measured deviations: between the samples they were found up to 4 % greater."""

EDGE_SAMPLE_FRACTIONS = np.concatenate([[0.0, 1e-4], np.linspace(0.0, 1.0, 9)[1:-1], [1.0 - 1e-4, 1.0]])
"""Where along an edge of a wall it is looked at: near the ends for directions, between for areas and nesting."""


def build_edge_table(
    lattice: Brep,
    cuts: PatchArcs,
    crossings: CurveSurfaceIntersections,
    tracks: IntersectionCurves,
    edge_pieces: SubSegments,
    track_pieces: SubSegments,
    curves: Sequence[BSplineCurve],
    vertices: Array,
) -> Edges:
    """Every piece of a lattice edge, then every piece of a track, kept or not.

    Where an edge's curve ends a little off its vertex, that distance counts as deviation too.
    """
    old, strand, track = lattice.edges, edge_pieces.segment, tracks.curve_segments
    own = track_pieces.segment
    cut = np.array([0.0, *(c.deviation for c in cuts.fitted_arcs)])
    of_arc = cut[np.where(tracks.face[own] >= 0, track.curve[own] - len(lattice.curves) + 1, 0)]
    measured = np.concatenate(
        [np.maximum(old.deviation, DEVIATION_MARGIN * crossings.off)[strand], DEVIATION_MARGIN * of_arc]
    )
    edges = Edges(
        curve=np.concatenate([old.curve[strand], track.curve[own]]),
        motion=Motion.concatenate([old.motion[strand], track.motion[own]]),
        span=np.concatenate([edge_pieces.span, track_pieces.span]),
        start=np.concatenate([edge_pieces.start, track_pieces.start]),
        end=np.concatenate([edge_pieces.end, track_pieces.end]),
        deviation=measured,
    )
    split = (np.diff(edge_pieces.first) > 1)[strand]
    index = np.concatenate([np.flatnonzero(split), len(strand) + np.arange(len(own))])
    ends = _sample_edges(curves, edges, index, np.array([0.0, 1.0]))
    off = np.linalg.norm(ends - vertices[np.column_stack([edges.start[index], edges.end[index]])], axis=2).max(axis=1)
    measured[index] = np.maximum(measured[index], DEVIATION_MARGIN * off)
    return edges


def find_cap_boundary(
    faces: Sequence[FaceLoops], senses: IntArray, edges: Edges, face_of_edge: IntArray
) -> CapBoundary:
    """The edges that `faces` use once, with the face of the body that closes them. `face_of_edge`: -1 where there is none."""
    owner = np.array([f for f, face in faces for loop in face for _ in loop], np.int64)
    used = np.array([use[:2] for _, face in faces for loop in face for use in loop], np.int64).reshape(-1, 2)
    count = np.bincount(used[:, 0], minlength=len(edges))
    way = np.zeros(len(edges), np.int64)
    np.add.at(way, used[:, 0], used[:, 1] * senses[owner])
    at = np.flatnonzero(count == 1)
    face = face_of_edge[at]
    if (face < 0).any():
        raise TrimmingError("the lattice has an open border inside the body")
    sense = -way[at]
    ahead = sense > 0
    start, end = edges.start[at], edges.end[at]
    return CapBoundary(face, at, sense, np.where(ahead, start, end), np.where(ahead, end, start))


def assemble_trimmed_brep(
    lattice: Brep,
    body: TrimmingBody,
    regions: list[FaceRegion],
    cuts: PatchArcs,
    hits: BodyEdgeIntersections,
    faces: list[FaceLoops],
    edges: Edges,
    open_edges: CapBoundary,
    curves: Sequence[BSplineCurve],
    vertices: Array,
    tol: float,
    in_solid: Callable[[Array], BoolArray],
) -> Brep:
    """Close the inner faces by walls; the result holds only the edges and vertices in use."""
    pieces = select_body_edges(body, hits, open_edges, vertices, in_solid)
    first_piece, first_corner = len(edges), len(vertices)
    everywhere = np.vstack([vertices, body.brep.vertices])
    all_curves: list[EdgeCurve] = [*curves, *body.curves]
    edges = _append_body_edges(edges, body, pieces, len(curves), first_corner, everywhere)
    pcurves = [*lattice.pcurves, *(c.pcurve for c in cuts.fitted_arcs), *body.brep.pcurves]
    first_pcurve = len(lattice.pcurves) + len(cuts.fitted_arcs)

    deviation = edges.deviation.copy()
    walls: list[FaceLoops] = []
    table: dict[int, list[int]] = {}
    for i, e in enumerate(pieces.edge.tolist()):
        table.setdefault(e, []).append(first_piece + i)
    open_of: dict[int, list[int]] = {}
    for i, f in enumerate(open_edges.face.tolist()):
        open_of.setdefault(f, []).append(i)
    for f, region in enumerate(regions):
        flat = isinstance(region.carrier, Plane)
        uses: list[EdgeUse] = []
        for k in range(*face_use_range(body.brep, f)):
            pcurve = -1 if flat else first_pcurve + int(body.brep.uses.pcurve[k])
            uses += [(p, int(body.brep.uses.sense[k]), pcurve) for p in table.get(int(body.brep.uses.edge[k]), [])]
        turn = int(body.brep.faces.sense[f])
        own = np.array(open_of.get(f, []), np.int64)
        edge, made = open_edges.edge[own], np.full(len(own), -1)
        if len(own) and not flat:
            found, off = fit_edge_pcurves(curves, edges, edge, region, tol)
            deviation[edge] = np.maximum(deviation[edge], DEVIATION_MARGIN * off)
            made = len(pcurves) + np.arange(len(own))
            pcurves += found
        uses += zip(edge.tolist(), (open_edges.sense[own] * turn).tolist(), made.tolist(), strict=True)
        if uses:
            walls += [(f, face) for face in _chain_body_face(region, uses, edges, all_curves, pcurves)]
    return _compact_brep(
        lattice, body, tuple(all_curves), tuple(pcurves), faces, walls, replace(edges, deviation=deviation), everywhere
    )


def _chain_body_face(
    region: FaceRegion, uses: list[EdgeUse], edges: Edges, curves: Sequence[EdgeCurve], pcurves: Sequence[BSplineCurve]
) -> list[list[list[EdgeUse]]]:
    """The parts of one face of the body that the uses bound."""
    edge, sense = np.array([u[0] for u in uses]), np.array([u[1] for u in uses])
    if isinstance(region.carrier, Plane):
        points = region.carrier.parameters(_sample_edges(curves, edges, edge, EDGE_SAMPLE_FRACTIONS))
    else:
        low, high = edges.span[edge].T
        t = low[:, None] + (high - low)[:, None] * EDGE_SAMPLE_FRACTIONS
        points = np.stack([pcurves[u[2]](x) for u, x in zip(uses, t, strict=True)])
    back = sense < 0
    points[back] = points[back, ::-1]

    def direction(i: int, at_end: bool) -> Array:
        return np.asarray(points[i, -1] - points[i, -2] if at_end else points[i, 1] - points[i, 0])

    start, end = np.where(back, edges.end[edge], edges.start[edge]), np.where(back, edges.start[edge], edges.end[edge])
    chained = loops.chain_loops(start, end, direction)
    polygons = [np.concatenate([points[i] for i in loop]) for loop in chained]
    return [[[uses[i] for i in chained[j]] for j in face] for face in loops.nest_loops(polygons)]


def _sample_edges(curves: Sequence[EdgeCurve], edges: Edges, edge: IntArray, x: Array) -> Array:
    """Points at the parts x (s,) of the edges' spans: (n, s, 3)."""
    strands = CurveSegments(edges.curve, edges.motion, edges.span, edges.start, edges.end)
    low, high = edges.span[edge].T
    t = low[:, None] + (high - low)[:, None] * x
    return evaluate_segments(curves, strands, np.repeat(edge, len(x)), t.ravel()).reshape(len(edge), len(x), 3)


def _append_body_edges(
    edges: Edges, body: TrimmingBody, pieces: BodySubEdges, first_curve: int, first_corner: int, points: Array
) -> Edges:
    """The pieces of the body's edges appended; their vertices may lie a little off them."""
    n = len(pieces.edge)
    start, end = (np.where(v < 0, first_corner - 1 - v, v) for v in (pieces.start, pieces.end))
    places = np.array([body.curves[e](span) for e, span in zip(pieces.edge, pieces.span, strict=True)]).reshape(
        -1, 2, 3
    )
    off = np.linalg.norm(places - points[np.column_stack([start, end])], axis=2).max(axis=1, initial=0.0)
    return Edges(
        curve=np.concatenate([edges.curve, first_curve + pieces.edge]),
        motion=Motion.concatenate([edges.motion, Motion.identity(n)]),
        span=np.concatenate([edges.span, pieces.span]),
        start=np.concatenate([edges.start, start]),
        end=np.concatenate([edges.end, end]),
        deviation=np.concatenate(
            [edges.deviation, np.maximum(body.brep.edges.deviation[pieces.edge], DEVIATION_MARGIN * off)]
        ),
    )


def _compact_brep(
    lattice: Brep,
    body: TrimmingBody,
    curves: tuple[EdgeCurve, ...],
    pcurves: tuple[BSplineCurve, ...],
    faces: list[FaceLoops],
    walls: list[FaceLoops],
    edges: Edges,
    vertices: Array,
) -> Brep:
    old = lattice.faces
    tags = lattice.tags if CAP_TAG in lattice.tags else (*lattice.tags, CAP_TAG)
    kept, own = np.array([f for f, _ in faces], np.int64), np.array([f for f, _ in walls], np.int64)
    n = len(own)
    uses, loop_start, use_start = _flatten_loops([face for _, face in faces + walls])
    used, edge = np.unique(uses[:, 0], return_inverse=True)
    ends = np.concatenate([edges.start[used], edges.end[used]])
    used_vertices, ends = np.unique(ends, return_inverse=True)
    return Brep(
        carriers=(*lattice.carriers, *body.carriers),
        curves=curves,
        pcurves=pcurves,
        vertices=vertices[used_vertices],
        edges=Edges(
            curve=edges.curve[used],
            motion=edges.motion[used],
            span=edges.span[used],
            start=ends[: len(used)],
            end=ends[len(used) :],
            deviation=edges.deviation[used],
        ),
        uses=EdgeUses(edge.ravel(), uses[:, 1], uses[:, 2]),
        faces=Faces(
            carrier=np.concatenate([old.carrier[kept], len(lattice.carriers) + own]),
            motion=Motion.concatenate([old.motion[kept], Motion.identity(n)]),
            sense=np.concatenate([old.sense[kept], body.brep.faces.sense[own]]),
            tag=np.concatenate([old.tag[kept], np.full(n, tags.index(CAP_TAG))]),
            loop_start=loop_start,
            use_start=use_start,
        ),
        tags=tags,
    )


def _flatten_loops(faces: list[list[list[EdgeUse]]]) -> tuple[IntArray, IntArray, IntArray]:
    """Uses (K, 3), and where loops and uses begin."""
    uses = np.array([use for face in faces for loop in face for use in loop], np.int64).reshape(-1, 3)
    loop_start = np.concatenate([[0], np.cumsum([len(face) for face in faces])]).astype(np.int64)
    use_start = np.concatenate([[0], np.cumsum([len(loop) for face in faces for loop in face])]).astype(np.int64)
    return uses, loop_start, use_start
