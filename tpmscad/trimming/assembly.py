"""The trimmed complex put together: inner faces, caps on what they leave open, and only the edges and vertices in use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tpmscad.patches.complex import Edges, Faces, PatchComplex, Uses
from tpmscad.splines.bspline import Curve, line
from tpmscad.trimming import caps, loops
from tpmscad.trimming.cuts import PatchCuts
from tpmscad.trimming.faces import Face, Use
from tpmscad.trimming.pieces import Pieces
from tpmscad.trimming.strands import Crossings, Strands, points_on
from tpmscad.trimming.tool import Array, Flags, Ints, Tool, TrimmingError

CAP = "cap"

MARGIN = 1.1
"""On measured deviations: between the samples they were found up to 4 % greater."""

SAMPLES = np.concatenate([[0.0, 1e-4], np.linspace(0.0, 1.0, 9)[1:-1], [1.0 - 1e-4, 1.0]])
"""Where along an edge of a cap it is looked at: near the ends for directions, between for areas and nesting."""


def all_edges(
    lattice: PatchComplex,
    cuts: PatchCuts,
    crossings: Crossings,
    edge_pieces: Pieces,
    arc_pieces: Pieces,
    vertices: Array,
) -> Edges:
    """Every piece of a lattice edge, then every piece of an arc, kept or not.

    Where an edge's curve ends a little off its vertex, that distance counts as deviation too.
    """
    old, strand, arc = lattice.edges, edge_pieces.strand, arc_pieces.strand
    face = cuts.face[arc]
    deviation = np.array([c.deviation for c in cuts.cuts])
    edges = Edges(
        curve=np.concatenate([old.curve[strand], len(lattice.curves) + cuts.cut[arc]]),
        rotation=np.concatenate([old.rotation[strand], lattice.faces.rotation[face]]),
        translation=np.concatenate([old.translation[strand], lattice.faces.translation[face]]),
        span=np.concatenate([edge_pieces.span, arc_pieces.span]),
        start=np.concatenate([edge_pieces.start, arc_pieces.start]),
        end=np.concatenate([edge_pieces.end, arc_pieces.end]),
        deviation=np.concatenate([np.maximum(old.deviation, MARGIN * crossings.off)[strand], deviation[cuts.cut[arc]]]),
    )
    cut = (np.diff(edge_pieces.first) > 1)[strand]
    index = np.concatenate([np.flatnonzero(cut), len(strand) + np.arange(len(arc))])
    ends = _at(tuple(c.curve for c in cuts.cuts), lattice.curves, edges, index)
    off = np.linalg.norm(ends - vertices[np.column_stack([edges.start[index], edges.end[index]])], axis=2).max(axis=1)
    widest = edges.deviation.copy()
    measured = np.concatenate([old.deviation[strand], deviation[cuts.cut[arc]]])
    widest[index] = np.maximum(widest[index], MARGIN * np.maximum(off, measured[index]))
    return replace(edges, deviation=widest)


def _at(cut_curves: tuple[Curve, ...], curves: tuple[Curve, ...], edges: Edges, index: Ints) -> Array:
    """Both ends of edges: (n, 2, 3)."""
    strands = Strands(edges.curve, edges.rotation, edges.translation, edges.span, edges.start, edges.end)
    t = edges.span[index].ravel()
    return points_on(curves + cut_curves, strands, np.repeat(index, 2), t).reshape(-1, 2, 3)


def open_planes(faces: Sequence[Face], senses: Ints, edges: Edges, plane_of_edge: Ints) -> caps.OpenEdges:
    """The edges that `faces` use once, with the plane that caps them. `plane_of_edge`: -1 where there is none."""
    owner = np.array([f for f, face in faces for loop in face for _ in loop], np.int64)
    used = np.array([use[:2] for _, face in faces for loop in face for use in loop], np.int64).reshape(-1, 2)
    count = np.bincount(used[:, 0], minlength=len(edges))
    way = np.zeros(len(edges), np.int64)
    np.add.at(way, used[:, 0], used[:, 1] * senses[owner])
    at = np.flatnonzero(count == 1)
    plane = plane_of_edge[at]
    if (plane < 0).any():
        raise TrimmingError("the lattice has an open border, or edges along two planes, inside the tool")
    sense = -way[at]
    ahead = sense > 0
    return caps.OpenEdges(
        plane,
        at,
        sense,
        np.where(ahead, edges.start[at], edges.end[at]),
        np.where(ahead, edges.end[at], edges.start[at]),
    )


def plane_of_edges(cuts: PatchCuts, edge_pieces: Pieces, arc_pieces: Pieces) -> Ints:
    """The one plane each edge lies in, -1 for none or several."""
    flat = edge_pieces.sign == 0
    of_edge = np.where(flat.sum(axis=1) == 1, flat.argmax(axis=1), -1)
    return np.concatenate([of_edge, cuts.plane[arc_pieces.strand]])


def assemble(
    lattice: PatchComplex,
    tool: Tool,
    cuts: PatchCuts,
    faces: list[Face],
    edges: Edges,
    open_edges: caps.OpenEdges,
    vertices: Array,
    on: Flags,
    inside: Callable[[Array], Array] | None,
) -> PatchComplex:
    """Close the inner faces by caps; the result holds only the edges and vertices in use."""
    lines = [
        line(tool.corners[a], tool.corners[b], (0.0, tool.length(e))) for e, (a, b) in enumerate(tool.edge_corners)
    ]
    first_line = len(lattice.curves) + len(cuts.cuts)
    curves = (*lattice.curves, *(c.curve for c in cuts.cuts), *lines)

    def polylines(edge: Ints) -> Array:
        return _polylines(curves, edges, edge)

    pieces = caps.tool_pieces(tool, open_edges, vertices, on, polylines, inside)
    first_piece, first_corner = len(edges), len(vertices)
    start, end = (np.where(v < 0, first_corner - 1 - v, v) for v in (pieces.start, pieces.end))
    everywhere = np.vstack([vertices, tool.corners])
    a, b = tool.corners[tool.edge_corners[pieces.tool_edge]].swapaxes(0, 1)
    way = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    places = a[:, None] + pieces.span[..., None] * way[:, None]
    off = np.linalg.norm(places - everywhere[np.column_stack([start, end])], axis=2).max(axis=1)  # of snapped vertices
    edges = _with_lines(edges, first_line + pieces.tool_edge, pieces.span, start, end, MARGIN * off)
    number = first_piece + np.arange(len(start))
    left, right = tool.edge_planes[pieces.tool_edge].T
    one = np.ones(len(start), np.int64)
    round_caps = caps.OpenEdges(
        np.concatenate([open_edges.plane, left, right]),
        np.concatenate([open_edges.edge, number, number]),
        np.concatenate([open_edges.sense, one, -one]),
        np.concatenate([open_edges.start, start, end]),
        np.concatenate([open_edges.end, end, start]),
    )
    cap_faces: list[Face] = []
    for plane in range(len(tool.planes)):
        at = np.flatnonzero(round_caps.plane == plane)
        chained, polygons = caps.cap_loops(tool, plane, round_caps, at, polylines)
        named = [[(int(round_caps.edge[at[i]]), int(round_caps.sense[at[i]]), -1) for i in loop] for loop in chained]
        cap_faces += [(plane, [named[i] for i in face]) for face in (loops.nest(polygons) if polygons else [])]
    return _complex(lattice, tool, cuts, curves, faces, cap_faces, edges, everywhere)


def _polylines(curves: Sequence[Curve], edges: Edges, edge: Ints) -> Array:
    strands = Strands(edges.curve, edges.rotation, edges.translation, edges.span, edges.start, edges.end)
    low, high = edges.span[edge].T
    t = low[:, None] + (high - low)[:, None] * SAMPLES
    return points_on(curves, strands, np.repeat(edge, len(SAMPLES)), t.ravel()).reshape(len(edge), len(SAMPLES), 3)


def _with_lines(edges: Edges, curve: Ints, span: Array, start: Ints, end: Ints, deviation: Array) -> Edges:
    n = len(curve)
    return Edges(
        curve=np.concatenate([edges.curve, curve]),
        rotation=np.concatenate([edges.rotation, np.tile(np.eye(3), (n, 1, 1))]),
        translation=np.concatenate([edges.translation, np.zeros((n, 3))]),
        span=np.concatenate([edges.span, span]),
        start=np.concatenate([edges.start, start]),
        end=np.concatenate([edges.end, end]),
        deviation=np.concatenate([edges.deviation, deviation]),
    )


def _complex(
    lattice: PatchComplex,
    tool: Tool,
    cuts: PatchCuts,
    curves: tuple[Curve, ...],
    faces: list[Face],
    cap_faces: list[Face],
    edges: Edges,
    vertices: Array,
) -> PatchComplex:
    old = lattice.faces
    tags = lattice.tags if CAP in lattice.tags else (*lattice.tags, CAP)
    kept, planes = np.array([f for f, _ in faces], np.int64), np.array([p for p, _ in cap_faces], np.int64)
    n = len(planes)
    uses, loop_start, use_start = _flat([face for _, face in faces + cap_faces])
    used, edge = np.unique(uses[:, 0], return_inverse=True)
    ends = np.concatenate([edges.start[used], edges.end[used]])
    used_vertices, ends = np.unique(ends, return_inverse=True)
    return PatchComplex(
        carriers=(*lattice.carriers, *tool.planes),
        curves=curves,
        pcurves=(*lattice.pcurves, *(c.pcurve for c in cuts.cuts)),
        vertices=vertices[used_vertices],
        edges=Edges(
            curve=edges.curve[used],
            rotation=edges.rotation[used],
            translation=edges.translation[used],
            span=edges.span[used],
            start=ends[: len(used)],
            end=ends[len(used) :],
            deviation=edges.deviation[used],
        ),
        uses=Uses(edge.ravel(), uses[:, 1], uses[:, 2]),
        faces=Faces(
            carrier=np.concatenate([old.carrier[kept], len(lattice.carriers) + planes]),
            rotation=np.concatenate([old.rotation[kept], np.tile(np.eye(3), (n, 1, 1))]),
            translation=np.concatenate([old.translation[kept], np.zeros((n, 3))]),
            sense=np.concatenate([old.sense[kept], np.ones(n, np.int64)]),
            tag=np.concatenate([old.tag[kept], np.full(n, tags.index(CAP))]),
            loop_start=loop_start,
            use_start=use_start,
        ),
        tags=tags,
    )


def _flat(faces: list[list[list[Use]]]) -> tuple[Ints, Ints, Ints]:
    """Uses (K, 3), and where loops and uses begin."""
    uses = np.array([use for face in faces for loop in face for use in loop], np.int64).reshape(-1, 3)
    loop_start = np.concatenate([[0], np.cumsum([len(face) for face in faces])]).astype(np.int64)
    use_start = np.concatenate([[0], np.cumsum([len(loop) for face in faces for loop in face])]).astype(np.int64)
    return uses, loop_start, use_start
