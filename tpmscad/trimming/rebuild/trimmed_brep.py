"""The trimmed boundary representations: the lattice's faces inside the body, closed by caps on the body's faces.

Several *domains* of one arrangement can be rebuilt: each is bounded by some of the lattice's faces, with the lattice's senses or
the opposite ones. All of them use one table of edges, so that faces, edges and vertices common to two domains are stored once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep import connectivity, loops
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, select_faces
from tpmscad.brep.carriers import EdgeCurve, Plane
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.restricted_surfaces import restrict_carriers
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.trimming.intersect.arrangement import Arrangement, CurveSegments
from tpmscad.trimming.intersect.curve_surface import evaluate_segments
from tpmscad.trimming.operands.trimming_body import face_use_range
from tpmscad.trimming.rebuild.body_faces import BodySubEdges, CapBoundary, InLattice, select_body_edges
from tpmscad.trimming.rebuild.body_pcurves import fit_edge_pcurves
from tpmscad.trimming.rebuild.lattice_faces import EdgeUse, FaceLoops, build_lattice_faces

DEVIATION_MARGIN = 1.1
"""Factor on measured deviations: between samples they are up to 4 % greater."""

FREE_FORM_DEVIATION_MARGIN = 1.5
"""That factor for bodies with free-form faces, on the deviations of their own edges as well: with 1.1 the kernel rejects single
faces whose pcurves leave the tolerance of an edge between samples."""

EDGE_SAMPLE_FRACTIONS = np.concatenate([[0.0, 1e-4], np.linspace(0.0, 1.0, 9)[1:-1], [1.0 - 1e-4, 1.0]])
"""Fractions of an edge's span that are sampled: near the ends for directions, between them for areas and nesting."""


@dataclass(frozen=True, slots=True, eq=False)
class LatticeDomain:
    """A region bounded by the lattice's `faces`, with their senses times `sign` (+1 or -1)."""

    faces: IntArray
    sign: int

    def select(self, lattice: Brep) -> Brep:
        """The domain's boundary as a boundary representation of its own."""
        part = lattice if len(self.faces) == len(lattice.faces) else select_faces(lattice, self.faces)
        return replace(part, faces=replace(part.faces, sense=self.sign * part.faces.sense))


@dataclass(frozen=True, slots=True, eq=False)
class TrimmedDomains:
    """Closed boundary representations of domains, and one with all of their faces.

    `shared`: common faces are stored once, with the sense of the first domain. `members`: for each domain, the faces of `shared`
    that are its own, in the order of its own boundary representation.
    """

    breps: tuple[Brep, ...]
    shared: Brep
    members: tuple[IntArray, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Tables:
    """The edges, curves, pcurves and vertices that faces refer to; `cap_pcurve` (E,): an edge's pcurve on its body face."""

    edges: Edges
    curves: tuple[EdgeCurve, ...]
    pcurves: tuple[BSplineCurve, ...]
    vertices: Array
    cap_pcurve: IntArray


def rebuild_domains(
    a: Arrangement, domains: Sequence[LatticeDomain], in_lattice: Sequence[InLattice]
) -> TrimmedDomains:
    """The domains of a classified arrangement inside the body; TrimmingError if one of them does not close."""
    o = a.operands
    edges = build_edge_table(a)
    faces = build_lattice_faces(a, edges)
    owner = np.array([face.face for face in faces], np.int64)
    tables = _Tables(
        edges,
        (*a.curves, *o.body.curves),
        (*o.lattice.pcurves, *(arc.pcurve for arc in a.arcs.fitted_arcs), *o.body.brep.pcurves),
        np.vstack([a.vertices, o.body.brep.vertices]),
        np.full(len(edges), -1),
    )
    kept: list[list[int]] = []
    caps: list[list[FaceLoops]] = []
    for domain, inside in zip(domains, in_lattice, strict=True):
        kept.append(np.flatnonzero(np.isin(owner, domain.faces)).tolist())
        boundary = find_cap_boundary(
            [faces[i] for i in kept[-1]], domain.sign * o.lattice.faces.sense, edges, a.face_of_edge
        )
        tables, own = _build_caps(a, boundary, inside, tables)
        caps.append(own)

    breps = tuple(
        _compact_brep(a, [([faces[i] for i in own], cap, domain.sign * o.lattice.faces.sense)], tables)
        for domain, own, cap in zip(domains, kept, caps, strict=True)
    )
    for brep in breps:
        _check_closed(brep)
    if len(domains) == 1:
        return TrimmedDomains(breps, breps[0], (np.arange(len(breps[0].faces)),))
    return TrimmedDomains(breps, *_share_faces(a, domains, faces, kept, caps, tables))


def restrict_domains(result: TrimmedDomains) -> TrimmedDomains:
    """The same domains, with the carriers of faces restricted where their poles leave the box of a domain that they bound."""
    shared = result.shared
    low, high = np.full((len(shared.faces), 3), -np.inf), np.full((len(shared.faces), 3), np.inf)
    for brep, own in zip(result.breps, result.members, strict=True):
        if len(own):
            low[own] = np.maximum(low[own], brep.vertices.min(axis=0))
            high[own] = np.minimum(high[own], brep.vertices.max(axis=0))
    shared = restrict_carriers(shared, low, high)
    breps = tuple(
        replace(brep, carriers=shared.carriers, faces=replace(brep.faces, carrier=shared.faces.carrier[own]))
        for brep, own in zip(result.breps, result.members, strict=True)
    )
    return TrimmedDomains(breps, breps[0] if len(breps) == 1 else shared, result.members)


def _share_faces(
    a: Arrangement,
    domains: Sequence[LatticeDomain],
    faces: list[FaceLoops],
    kept: list[list[int]],
    caps: list[list[FaceLoops]],
    tables: _Tables,
) -> tuple[Brep, tuple[IntArray, ...]]:
    """One boundary representation with the faces of all domains, domain by domain, and the faces of each domain."""
    number: dict[int, int] = {}
    members, parts, count = [], [], 0
    for domain, own, cap in zip(domains, kept, caps, strict=True):
        new = [i for i in own if i not in number]
        number |= {i: count + n for n, i in enumerate(new)}
        faces_of_caps = range(count + len(new), count + len(new) + len(cap))
        members.append(np.array([*(number[i] for i in own), *faces_of_caps], np.int64))
        parts.append(([faces[i] for i in new], cap, domain.sign))
        count += len(new) + len(cap)
    sense = a.operands.lattice.faces.sense
    return _compact_brep(a, [(own, cap, sign * sense) for own, cap, sign in parts], tables), tuple(members)


def build_edge_table(a: Arrangement) -> Edges:
    """All edges of the result, used or not: the pieces of the lattice's edges, then those of the imprints.

    The deviation of an edge includes the distance of its curve's ends from its vertices.
    """
    o, pieces, imprint_pieces = a.operands, a.edge_pieces, a.imprint_pieces
    old, segment, imprint = o.lattice.edges, pieces.segment, a.imprints.curve_segments
    own = imprint_pieces.segment
    fitted = np.array([0.0, *(arc.deviation for arc in a.arcs.fitted_arcs)])
    of_arc = fitted[np.where(a.imprints.face[own] >= 0, imprint.curve[own] - len(o.curves) + 1, 0)]
    margin = _deviation_margin(a)
    coincident = margin * a.edge_roots.coincident_deviation
    measured = np.concatenate([np.maximum(old.deviation, coincident)[segment], margin * of_arc])
    edges = Edges(
        curve=np.concatenate([old.curve[segment], imprint.curve[own]]),
        motion=Motion.concatenate([old.motion[segment], imprint.motion[own]]),
        span=np.concatenate([pieces.span, imprint_pieces.span]),
        start=np.concatenate([pieces.start, imprint_pieces.start]),
        end=np.concatenate([pieces.end, imprint_pieces.end]),
        deviation=measured,
    )
    split = (np.diff(pieces.first) > 1)[segment]
    index = np.concatenate([np.flatnonzero(split), len(segment) + np.arange(len(own))])
    ends = _sample_edges(a.curves, edges, index, np.array([0.0, 1.0]))
    vertices = a.vertices[np.column_stack([edges.start[index], edges.end[index]])]
    gap = np.linalg.norm(ends - vertices, axis=2).max(axis=1)
    measured[index] = np.maximum(measured[index], margin * gap)
    return edges


def _deviation_margin(a: Arrangement) -> float:
    """The factor on measured deviations."""
    return FREE_FORM_DEVIATION_MARGIN if a.operands.body.surfaces.is_free_form.any() else DEVIATION_MARGIN


def find_cap_boundary(
    faces: Sequence[FaceLoops], senses: IntArray, edges: Edges, face_of_edge: IntArray
) -> CapBoundary:
    """The edges that the lattice's `faces` use once, with the face of the body that closes each (`face_of_edge`, -1: none)."""
    owner = np.array([f for f, face in faces for loop in face for _ in loop], np.int64)
    used = np.array([use[:2] for _, face in faces for loop in face for use in loop], np.int64).reshape(-1, 2)
    count = np.bincount(used[:, 0], minlength=len(edges))
    direction = np.zeros(len(edges), np.int64)
    np.add.at(direction, used[:, 0], used[:, 1] * senses[owner])
    at = np.flatnonzero(count == 1)
    face = face_of_edge[at]
    if (face < 0).any():
        raise TrimmingError("the lattice has an open border inside the body")
    sense = -direction[at]
    ahead = sense > 0
    start, end = edges.start[at], edges.end[at]
    return CapBoundary(face, at, sense, np.where(ahead, start, end), np.where(ahead, end, start))


def _build_caps(
    a: Arrangement, boundary: CapBoundary, in_lattice: InLattice, tables: _Tables
) -> tuple[_Tables, list[FaceLoops]]:
    """The parts of the body's faces that close a domain, and the tables with the edges and pcurves that they add."""
    o, uses_of_body = a.operands, a.operands.body.brep.uses
    pieces = select_body_edges(a, boundary, in_lattice)
    first_piece = len(tables.edges)
    edges = _append_body_edges(a, tables, pieces)
    deviation = edges.deviation.copy()
    cap_pcurve = np.concatenate([tables.cap_pcurve, np.full(len(pieces.edge), -1)])
    pcurves = list(tables.pcurves)
    first_pcurve = len(o.lattice.pcurves) + len(a.arcs.fitted_arcs)

    caps: list[FaceLoops] = []
    pieces_of_edge: dict[int, list[int]] = {}
    for i, e in enumerate(pieces.edge.tolist()):
        pieces_of_edge.setdefault(e, []).append(first_piece + i)
    boundary_of_face: dict[int, list[int]] = {}
    for i, f in enumerate(boundary.face.tolist()):
        boundary_of_face.setdefault(f, []).append(i)
    for f, region in enumerate(o.regions):
        is_planar = isinstance(region.carrier, Plane)
        uses: list[EdgeUse] = []
        for k in range(*face_use_range(o.body.brep, f)):
            sense, pcurve = int(uses_of_body.sense[k]), -1 if is_planar else first_pcurve + int(uses_of_body.pcurve[k])
            uses += [EdgeUse(p, sense, pcurve) for p in pieces_of_edge.get(int(uses_of_body.edge[k]), [])]
        own = np.array(boundary_of_face.get(f, []), np.int64)
        edge = boundary.edge[own]
        new = edge[cap_pcurve[edge] < 0]
        if len(new) and not is_planar:
            found, off = fit_edge_pcurves(a.curves, edges, new, region, o.fit_tol)
            deviation[new] = np.maximum(deviation[new], _deviation_margin(a) * off)
            cap_pcurve[new] = len(pcurves) + np.arange(len(new))
            pcurves += found
        senses = (boundary.sense[own] * int(o.body.brep.faces.sense[f])).tolist()
        uses += [EdgeUse(*use) for use in zip(edge.tolist(), senses, cap_pcurve[edge].tolist(), strict=True)]
        if uses:
            caps += [FaceLoops(f, face) for face in _chain_body_face(a, f, uses, edges, tables.curves, pcurves)]
    edges = replace(edges, deviation=deviation)
    return replace(tables, edges=edges, pcurves=tuple(pcurves), cap_pcurve=cap_pcurve), caps


def _chain_body_face(
    a: Arrangement,
    face: int,
    uses: list[EdgeUse],
    edges: Edges,
    curves: Sequence[EdgeCurve],
    pcurves: Sequence[BSplineCurve],
) -> list[list[list[EdgeUse]]]:
    """The faces that the edge uses bound on one face of the body."""
    carrier = a.operands.regions[face].carrier
    edge, sense = np.array([u.edge for u in uses]), np.array([u.sense for u in uses])
    if isinstance(carrier, Plane):
        points = carrier.parameters(_sample_edges(curves, edges, edge, EDGE_SAMPLE_FRACTIONS))
    else:
        low, high = edges.span[edge].T
        t = low[:, None] + (high - low)[:, None] * EDGE_SAMPLE_FRACTIONS
        points = np.stack([pcurves[u.pcurve](x) for u, x in zip(uses, t, strict=True)])
    back = sense < 0
    points[back] = points[back, ::-1]

    def direction(i: int, at_end: bool) -> Array:
        return np.asarray(points[i, -1] - points[i, -2] if at_end else points[i, 1] - points[i, 0])

    start, end = np.where(back, edges.end[edge], edges.start[edge]), np.where(back, edges.start[edge], edges.end[edge])
    chained = loops.chain_loops(start, end, direction)
    polygons = [np.concatenate([points[i] for i in loop]) for loop in chained]
    return [[[uses[i] for i in chained[j]] for j in nested] for nested in loops.nest_loops(polygons)]


def _sample_edges(curves: Sequence[EdgeCurve], edges: Edges, edge: IntArray, x: Array) -> Array:
    """Points at fractions x (s,) of the edges' spans: (n, s, 3)."""
    segments = CurveSegments(edges.curve, edges.motion, edges.span, edges.start, edges.end)
    low, high = edges.span[edge].T
    t = low[:, None] + (high - low)[:, None] * x
    return evaluate_segments(curves, segments, np.repeat(edge, len(x)), t.ravel()).reshape(len(edge), len(x), 3)


def _append_body_edges(a: Arrangement, tables: _Tables, pieces: BodySubEdges) -> Edges:
    """The edges with pieces of the body's edges appended; their deviation includes the gaps at their vertices."""
    edges, body, n = tables.edges, a.operands.body, len(pieces.edge)
    ends = [body.curves[e](span) for e, span in zip(pieces.edge, pieces.span, strict=True)]
    vertices = tables.vertices[np.column_stack([pieces.start, pieces.end])]
    gap = np.linalg.norm(np.array(ends).reshape(-1, 2, 3) - vertices, axis=2).max(axis=1, initial=0.0)
    own = body.brep.edges.deviation[pieces.edge]
    if body.surfaces.is_free_form.any():
        own = FREE_FORM_DEVIATION_MARGIN * own
    deviation = np.maximum(own, _deviation_margin(a) * gap)
    return Edges(
        curve=np.concatenate([edges.curve, len(a.curves) + pieces.edge]),
        motion=Motion.concatenate([edges.motion, Motion.identity(n)]),
        span=np.concatenate([edges.span, pieces.span]),
        start=np.concatenate([edges.start, pieces.start]),
        end=np.concatenate([edges.end, pieces.end]),
        deviation=np.concatenate([edges.deviation, deviation]),
    )


def _compact_brep(
    a: Arrangement, parts: list[tuple[list[FaceLoops], list[FaceLoops], IntArray]], tables: _Tables
) -> Brep:
    """The boundary representation of parts (lattice faces, caps, senses of the lattice's faces), without unused edges."""
    lattice, body = a.operands.lattice, a.operands.body
    old, edges = lattice.faces, tables.edges
    kept = [
        (np.array([f.face for f in faces], np.int64), np.array([f.face for f in caps], np.int64))
        for faces, caps, _ in parts
    ]
    uses, loop_start, use_start = _flatten_loops([f.loops for faces, caps, _ in parts for f in (*faces, *caps)])
    used, edge = np.unique(uses[:, 0], return_inverse=True)
    ends = np.concatenate([edges.start[used], edges.end[used]])
    used_vertices, ends = np.unique(ends, return_inverse=True)
    return Brep(
        carriers=(*lattice.carriers, *(c.spline if isinstance(c, FreeFormSurface) else c for c in body.carriers)),
        curves=tables.curves,
        pcurves=tables.pcurves,
        vertices=tables.vertices[used_vertices],
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
            carrier=np.concatenate([c for k, own in kept for c in (old.carrier[k], len(lattice.carriers) + own)]),
            motion=Motion.concatenate([m for k, own in kept for m in (old.motion[k], Motion.identity(len(own)))]),
            sense=np.concatenate(
                [
                    s
                    for (k, own), part in zip(kept, parts, strict=True)
                    for s in (part[2][k], body.brep.faces.sense[own])
                ]
            ),
            tag=np.concatenate(
                [t for k, own in kept for t in (old.tag[k], len(lattice.tags) + body.brep.faces.tag[own])]
            ),
            loop_start=loop_start,
            use_start=use_start,
        ),
        tags=(*lattice.tags, *body.brep.tags),
    )


def _flatten_loops(faces: list[list[list[EdgeUse]]]) -> tuple[IntArray, IntArray, IntArray]:
    """Edge uses (n, 3), the first loop of each face, and the first use of each loop."""
    uses = np.array([use for face in faces for loop in face for use in loop], np.int64).reshape(-1, 3)
    loop_start = np.concatenate([[0], np.cumsum([len(face) for face in faces])]).astype(np.int64)
    use_start = np.concatenate([[0], np.cumsum([len(loop) for face in faces for loop in face])]).astype(np.int64)
    return uses, loop_start, use_start


def _check_closed(brep: Brep) -> None:
    unmatched = connectivity.find_unmatched_edges(brep)
    if len(unmatched):
        at = brep.vertices[brep.edges.start[unmatched[0]]]
        raise TrimmingError(
            f"{len(unmatched)} edges of the trimmed lattice are not used twice, the first at {at.round(6)}"
        )
