"""The points in which the body's edges pierce the lattice's boundary: one vertex each, on the edge and on imprints of both faces.

An imprint on the surface of a face crosses an edge of this face where the edge's separating surface vanishes. The imprints of
both faces give the same point; the two roots are paired, and Newton's method on the patch and the two surfaces yields the vertex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.orthogonal_projection import project_to_curve
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.trimming.intersect.arrangement import (
    Arrangement,
    BodyEdgeIntersections,
    CurveSegments,
    CurveSurfaceIntersections,
)
from tpmscad.trimming.intersect.curve_surface import evaluate_segments, intersect_segments, split_segments
from tpmscad.trimming.operands.quadric_table import QuadricTable

MAX_MISMATCH_TOLS = 100.0
"""Largest distance, in tolerances, between one point found on two imprints: their deviations over the sine of their angle."""

ON_EDGE_SNAPS = 4.0
"""Distance from an edge, in vertex tolerances, below which a vertex on both of its surfaces lies on the edge."""

END_SNAPS = 2.0
"""Distance from a vertex of the body, in vertex tolerances, below which a patch passes through it."""

NEWTON_STEPS = 4
"""Newton steps to a point on a patch and two surfaces, from a start that is off by a few tolerances."""

ARC_PROJECTION_STEPS = 2
"""Gauss-Newton steps to the parameter of an arc's point next to a vertex."""


def intersect_body_edges(a: Arrangement) -> Arrangement:
    """The arrangement with the points of the body's edges, and its imprints split there.

    TrimmingError if the imprints of an edge's two faces disagree on their common points.
    """
    o, body, segments = a.operands, a.operands.body, a.imprints.curve_segments
    wanted = _select_separating_surfaces(a)
    roots = intersect_segments(a.curves, segments, body.surfaces, a.on_surface, wanted, o.snap, o.zero_tol)
    edge, pair, points, parameter = _locate_crossings(a, roots)
    new = len(a.vertices) + np.arange(len(edge))
    old_edge, old_vertex, at_body_vertex = _match_existing_vertices(a)

    r, end = np.nonzero(pair >= 0)
    curve_index, passed = roots.root_segment[pair[r, end]], new[r]
    curve_parameter = parameter[r, end]
    known = {*old_vertex.tolist(), *at_body_vertex.values()}
    if known and (a.imprints.edge >= 0).any():
        more = _pass_on_coincident_edges(a, known)
        curve_index = np.concatenate([curve_index, np.array([i for i, _, _ in more], np.int64)])
        curve_parameter = np.concatenate([curve_parameter, np.array([t for _, t, _ in more], float)])
        passed = np.concatenate([passed, np.array([v for _, _, v in more], np.int64)])

    vertices = np.vstack([a.vertices, points])
    edge, vertex = np.concatenate([edge, old_edge]), np.concatenate([new, old_vertex])
    edge_parameter = np.zeros(len(edge))
    for e in np.unique(edge):
        at = np.flatnonzero(edge == e)
        edge_parameter[at] = project_to_curve(body.curves[e], body.brep.edges.span[e], vertices[vertex[at]])[0]
    return replace(
        a,
        vertices=vertices,
        body_edge_points=BodyEdgeIntersections(
            edge, edge_parameter, vertex, at_body_vertex, curve_index, curve_parameter, passed
        ),
        imprint_pieces=split_segments(segments, curve_index, curve_parameter, passed),
    )


def _select_separating_surfaces(a: Arrangement) -> BoolArray:
    """The separating surfaces (T, surfaces) that each imprint may cross.

    Lattice edges in a surface have their intersections with the K surfaces of faces already.
    """
    body, imprints = a.operands.body, a.imprints
    of_surface = np.zeros((body.n_surfaces, len(body.surfaces)), bool)
    of_surface[body.surface_of_face[body.face_of_use[body.uses]], body.separating_surface] = True
    wanted = of_surface[imprints.surface]
    wanted[imprints.edge >= 0, : body.n_surfaces] = False
    return wanted


def _locate_crossings(a: Arrangement, roots: CurveSurfaceIntersections) -> tuple[IntArray, IntArray, Array, Array]:
    """New points inside the body's edges.

    Returns the edge of each (n,), the pair of roots (n, 2), with -1 for none, the points (n, 3) and the parameters (n, 2) on the
    two imprints.
    """
    body, imprints = a.operands.body, a.imprints
    places = evaluate_segments(a.curves, imprints.curve_segments, roots.root_segment, roots.root_parameter)
    pairs = [_pair_roots(a, roots, places, e) for e in range(len(body.curves))]
    edge = np.concatenate([np.zeros(0, np.int64), *(np.full(len(p), e) for e, p in enumerate(pairs))])
    pair = np.concatenate([np.zeros((0, 2), np.int64), *pairs])
    if len(pair) == 0:
        return edge, pair, np.zeros((0, 3)), np.zeros((0, 2))
    imprint = roots.root_segment[pair[:, 0]]
    own, other = body.surfaces.take(imprints.surface[imprint]), roots.root_surface[pair[:, 0]]
    start = _evaluate_patch_parameters(a, roots, pair[:, 0])
    on_patch = imprints.face[imprint] >= 0
    points = places[pair[:, 0]].copy()
    points[on_patch] = _project_to_two_surfaces(
        a,
        imprints.face[imprint[on_patch]],
        start[on_patch],
        own.take(np.flatnonzero(on_patch)),
        body.surfaces.take(other[on_patch]),
    )
    return edge, pair, points, _project_to_imprints(a, roots, pair, points)


def _pair_roots(a: Arrangement, roots: CurveSurfaceIntersections, places: Array, edge: int) -> IntArray:
    """Pairs (n, 2) of roots that are one point of a body edge, on imprints of its two faces; -1 if there is one imprint only."""
    body, imprints, tol = a.operands.body, a.imprints, a.operands.tol
    edges = body.brep.edges
    surface = body.surface_of_face[body.face_of_use[body.uses[edge]]]
    sides = []
    for s in (0, 1):
        separating = body.separating_surface[edge, s]
        rows = np.flatnonzero((roots.root_surface == separating) & (imprints.surface[roots.root_segment] == surface[s]))
        if len(rows):
            span = edges.span[edge]
            t, apart = project_to_curve(body.curves[edge], span, places[rows])
            rows = rows[(apart < MAX_MISMATCH_TOLS * tol + 2 * edges.deviation[edge]) & (t >= span[0]) & (t <= span[1])]
        sides.append(rows)
    ends = body.brep.vertices[[edges.start[edge], edges.end[edge]]]
    for row in np.concatenate(sides):
        if np.linalg.norm(places[row] - ends, axis=1).min() < END_SNAPS * a.operands.snap:
            raise TrimmingError(
                f"a patch passes through, or nearly through, the body's vertex at {places[row].round(6)}"
            )
    if surface[0] == surface[1]:
        return np.column_stack([sides[0], np.full(len(sides[0]), -1)])
    face_of_root = imprints.face[roots.root_segment]
    result = [(int(row), -1) for side in sides for row in side[face_of_root[side] < 0]]  # lattice edges: no partner
    first, second = (side[face_of_root[side] >= 0] for side in sides)
    for face in np.unique(face_of_root[np.concatenate([first, second])]):
        one, other = (side[face_of_root[side] == face] for side in (first, second))
        if len(one) != len(other):
            raise TrimmingError(
                f"the two faces of a body's edge find {len(one)} and {len(other)} points of it on one patch, "
                f"near {places[np.concatenate([one, other])[0]].round(6)}"
            )
        left = set(other.tolist())
        for i in one.tolist():
            j = min(left, key=lambda j: float(np.linalg.norm(places[i] - places[j])))
            if np.linalg.norm(places[i] - places[j]) > MAX_MISMATCH_TOLS * tol:
                raise TrimmingError(f"two intersection curves on one patch miss each other near {places[i].round(6)}")
            left.remove(j)
            result.append((i, j))
    return np.array(result, np.int64).reshape(-1, 2)


def _evaluate_patch_parameters(a: Arrangement, roots: CurveSurfaceIntersections, rows: IntArray) -> Array:
    """(u, v) of roots on arcs, and zeros for roots on lattice edges: (n, 2)."""
    result = np.zeros((len(rows), 2))
    for i, row in enumerate(rows.tolist()):
        imprint = roots.root_segment[row]
        if a.imprints.face[imprint] >= 0:
            arc = a.arcs.fitted_arcs[a.arcs.fitted_index[imprint]]
            result[i] = arc.pcurve(roots.root_parameter[row])
    return result


def _project_to_two_surfaces(
    a: Arrangement, face: IntArray, uv: Array, own: QuadricTable, other: QuadricTable
) -> Array:
    """Points (m, 3) on patches `face` and on two surfaces each, by Newton's method from (u, v) (m, 2)."""
    faces = a.operands.lattice.faces
    motion = faces.motion[face]
    first, second = own.in_frames(motion), other.in_frames(motion)
    local = np.empty((len(face), 3))
    for carrier in np.unique(faces.carrier[face]).tolist():
        at = np.flatnonzero(faces.carrier[face] == carrier)
        patch, pair = a.operands.patches[carrier], (first.take(at), second.take(at))
        p = uv[at]
        for _ in range(NEWTON_STEPS):
            point = patch(p[:, 0], p[:, 1])
            jets = [surface.jet(point[:, None], 1) for surface in pair]
            g = np.stack([j[0][:, 0] for j in jets], axis=1)
            gradient = np.stack([j[1][:, 0] for j in jets], axis=1)
            slope = np.stack([patch(p[:, 0], p[:, 1], *d) for d in ((1, 0), (0, 1))], axis=2)
            p = p - np.linalg.solve(gradient @ slope, g[..., None])[..., 0]
        local[at] = patch(p[:, 0], p[:, 1])
    return motion.apply(local)


def _project_to_imprints(a: Arrangement, roots: CurveSurfaceIntersections, pair: IntArray, points: Array) -> Array:
    """Parameters (n, 2) of the imprints' points nearest to `points`; the roots themselves are less accurate."""
    segments = a.imprints.curve_segments
    result = np.zeros(pair.shape)
    for side in (0, 1):
        there = np.flatnonzero(pair[:, side] >= 0)
        segment, t = roots.root_segment[pair[there, side]], roots.root_parameter[pair[there, side]]
        for _ in range(ARC_PROJECTION_STEPS):
            tangent = _evaluate_tangents(a.curves, segments, segment, t)
            gap = points[there] - evaluate_segments(a.curves, segments, segment, t)
            t = t + np.einsum("ni,ni->n", gap, tangent) / np.einsum("ni,ni->n", tangent, tangent)
        result[there, side] = t
    return result


def _evaluate_tangents(curves: Sequence[BSplineCurve], segments: CurveSegments, index: IntArray, t: Array) -> Array:
    """Derivatives (n, 3) at parameters t (n,) of the segments `index` (n,)."""
    local = np.array([curves[segments.curve[i]](x, 1) for i, x in zip(index, t, strict=True)]).reshape(-1, 3)
    return segments.motion[index].apply_to_vectors(local)


def _match_existing_vertices(a: Arrangement) -> tuple[IntArray, IntArray, dict[int, int]]:
    """Existing vertices of imprints that lie inside the body's edges, (n,) and (n,), and those at the body's vertices."""
    body, imprints, snap = a.operands.body, a.imprints, a.operands.snap
    coincident = np.unique(imprints.edge[imprints.edge >= 0])
    on_coincident = a.edge_root_vertex[np.isin(a.edge_roots.root_segment, coincident)]
    segments = imprints.curve_segments
    candidates = np.unique(np.concatenate([segments.start, segments.end, on_coincident]))
    edges = body.brep.edges
    found: set[tuple[int, int]] = set()
    at_body_vertex: dict[int, int] = {}
    for e in range(len(body.curves)):
        surface = body.surface_of_face[body.face_of_use[body.uses[e]]]
        on_both = np.zeros(len(candidates), bool)
        for s in (0, 1):
            on_both |= a.on_surface[candidates, surface[s]] & a.on_surface[candidates, body.separating_surface[e, s]]
        v = candidates[on_both]
        if len(v) == 0:
            continue
        span = edges.span[e]
        t, apart = project_to_curve(body.curves[e], span, a.vertices[v])
        ends = (int(edges.start[e]), int(edges.end[e]))
        to_end = np.stack([np.linalg.norm(a.vertices[v] - body.brep.vertices[w], axis=1) for w in ends])
        for i in np.flatnonzero((to_end < ON_EDGE_SNAPS * snap).any(axis=0)):
            w = ends[int(to_end[:, i].argmin())]
            if at_body_vertex.setdefault(w, int(v[i])) != v[i]:
                raise TrimmingError(f"several vertices lie at the body's vertex {body.brep.vertices[w]}")
        near = (apart < ON_EDGE_SNAPS * snap + 2 * edges.deviation[e]) & (t > span[0]) & (t < span[1])
        near &= (to_end >= ON_EDGE_SNAPS * snap).all(axis=0)
        found |= {(e, int(x)) for x in v[near]}
    edge, vertex = np.array(sorted(found), np.int64).reshape(-1, 2).T
    return edge, vertex, at_body_vertex


def _pass_on_coincident_edges(a: Arrangement, known: set[int]) -> list[tuple[int, float, int]]:
    """Imprint, parameter and vertex wherever a lattice edge that lies in a surface passes one of the `known` vertices."""
    result = []
    rows: dict[int, list[int]] = {}
    for r in np.flatnonzero(np.isin(a.edge_root_vertex, list(known))).tolist():
        rows.setdefault(int(a.edge_roots.root_segment[r]), []).append(r)
    for i in np.flatnonzero(a.imprints.edge >= 0).tolist():
        seen = set()
        for r in rows.get(int(a.imprints.edge[i]), []):
            vertex = int(a.edge_root_vertex[r])
            if vertex not in seen:
                seen.add(vertex)
                result.append((i, float(a.edge_roots.root_parameter[r]), vertex))
    return result
