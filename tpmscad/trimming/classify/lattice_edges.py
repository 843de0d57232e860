"""In/out classification of the lattice's edges: the pieces of edges that lie inside the body.

An intersection with the body's boundary decides the pieces before and behind it. The classification propagates round the
corners of patches: it changes at a vertex only if an arc on the body's boundary ends there. A component of the lattice without an
intersection lies inside or outside as a whole, and one point of it is classified by ray casting.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tpmscad._typing import BoolArray, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.trimming.classify.point_membership import points_in_body
from tpmscad.trimming.classify.propagation import InsideVotes
from tpmscad.trimming.intersect.arrangement import Arrangement
from tpmscad.trimming.intersect.curve_surface import evaluate_segments, split_segments


def split_lattice_edges(a: Arrangement) -> Arrangement:
    """The arrangement with the lattice's edges split at the body's boundary, and the faces that contain pieces of them."""
    roots, imprints, points = a.edge_roots, a.imprints, a.body_edge_points
    r = np.flatnonzero(np.isin(a.vertex_surface_key(a.edge_root_vertex, roots.root_surface), a.keys_on_body))
    h = np.flatnonzero(imprints.edge[points.curve_index] >= 0)
    pieces = split_segments(
        a.edges,
        np.concatenate([roots.root_segment[r], imprints.edge[points.curve_index[h]]]),
        np.concatenate([roots.root_parameter[r], points.curve_parameter[h]]),
        np.concatenate([a.edge_root_vertex[r], points.curve_vertex[h]]),
    )
    face = np.full(len(pieces.segment), -1)
    of_imprint = a.imprint_pieces
    for i in np.flatnonzero((a.piece_face >= 0) & (imprints.edge[of_imprint.segment] >= 0)).tolist():
        edge, (low, high) = imprints.edge[of_imprint.segment[i]], of_imprint.span[i]
        own = np.arange(pieces.first[edge], pieces.first[edge + 1])
        middle = pieces.span[own].mean(axis=1)
        inner = own[(middle > low) & (middle < high)]
        if (face[inner] >= 0).any():
            raise TrimmingError("an edge of the lattice lies in two faces of the body")
        face[inner] = a.piece_face[i]
    return replace(a, edge_pieces=pieces, edge_piece_face=face)


def classify_lattice_edges(a: Arrangement) -> Arrangement:
    """The arrangement with its edge pieces classified; TrimmingError if intersections contradict each other."""
    pieces, face = a.edge_pieces, a.edge_piece_face
    m = len(pieces.segment)
    arc_ends = _collect_arc_end_vertices(a)
    before, after = _pieces_at_corners(a)
    linked = np.ones(before.shape, bool)
    sides = a.operands.sides
    for f, v in arc_ends:
        own = slice(sides.start[f], sides.start[f + 1])
        linked[own] &= sides.vertex[own] != v
    linked &= (face[before] < 0) & (face[after] < 0)
    votes = InsideVotes.of_links(m, np.column_stack([before[linked], after[linked]]))
    _vote_from_roots(votes, a)
    inside_on_side = _vote_from_coincident_sides(votes, a, before, after, arc_ends)

    torn = votes.find_contradiction()
    if torn is not None:
        at = evaluate_segments(a.operands.curves, a.edges, pieces.segment[[torn]], pieces.span[[torn], 0])[0]
        raise TrimmingError(f"intersections disagree on whether the lattice near {at.round(6)} is inside the body")
    undecided = np.setdiff1d(votes.undecided_components(), votes.component[face >= 0])
    if len(undecided):
        first = np.full(len(votes.count), m)
        np.minimum.at(first, votes.component, np.arange(m))
        one = first[undecided]
        points = evaluate_segments(a.operands.curves, a.edges, pieces.segment[one], pieces.span[one].mean(axis=1))
        votes.count[undecided, 1] = points_in_body(a.operands.body, a.operands.regions, points)
    return replace(a, edge_piece_inside=votes.inside(), inside_on_side=inside_on_side)


def _collect_arc_end_vertices(a: Arrangement) -> set[tuple[int, int]]:
    """(patch, vertex) for every end of an arc on the body's boundary."""
    pieces, face_of_imprint = a.imprint_pieces, a.imprints.face
    i = np.flatnonzero((a.piece_face >= 0) & (face_of_imprint[pieces.segment] >= 0))
    face = face_of_imprint[pieces.segment[i]].tolist()
    return {*zip(face, pieces.start[i].tolist(), strict=True), *zip(face, pieces.end[i].tolist(), strict=True)}


def _pieces_at_corners(a: Arrangement) -> tuple[IntArray, IntArray]:
    """The pieces that end and that start where an edge use of a patch starts: (U,) each."""
    sides, pieces = a.operands.sides, a.edge_pieces
    first, last = pieces.first[sides.edge], pieces.first[sides.edge + 1] - 1
    begins, ends = np.where(sides.forward, first, last), np.where(sides.forward, last, first)
    return ends[sides.preceding], begins


def _body_vertices(a: Arrangement) -> BoolArray:
    """Vertices that are points of the body's edges: (V,)."""
    result = np.zeros(len(a.vertices), bool)
    result[[*a.body_edge_points.vertex.tolist(), *a.body_edge_points.vertex_of_body_vertex.values()]] = True
    return result


def _vote_from_roots(votes: InsideVotes, a: Arrangement) -> None:
    """Votes before and behind every root on a face of the body at which only one surface is crossed."""
    roots, pieces, body = a.edge_roots, a.edge_pieces, a.operands.body
    on_body_edge = _body_vertices(a)
    sign = roots.root_sign
    groups: dict[tuple[int, int], list[int]] = {}
    keys = zip(a.edge_root_vertex.tolist(), roots.root_surface.tolist(), strict=True)
    for r, key in enumerate(keys):
        if key in a.vertex_face and not on_body_edge[key[0]]:
            groups.setdefault((int(roots.root_segment[r]), key[0]), []).append(r)
    for (edge, vertex), members in groups.items():
        if len(members) > 1:
            continue
        r = members[0]
        inside = int(sign[r]) * int(body.sense[a.vertex_face[vertex, int(roots.root_surface[r])]]) < 0
        own = range(int(pieces.first[edge]), int(pieces.first[edge + 1]))
        for p in own:
            if pieces.end[p] == vertex and p + 1 in own:
                votes.add(p, inside)
                votes.add(p + 1, not inside)


def _vote_from_coincident_sides(
    votes: InsideVotes, a: Arrangement, before: IntArray, after: IntArray, arc_ends: set[tuple[int, int]]
) -> dict[int, bool]:
    """By edge use, for uses in a face of the body, whether the patch is inside there; adjacent uses get its vote."""
    sides, pieces, face, body = a.operands.sides, a.edge_pieces, a.edge_piece_face, a.operands.body
    result: dict[int, bool] = {}
    following = sides.following
    for (f, k), signs in a.arcs.sign_beside_sides.items():
        for use in (u for side in np.flatnonzero(signs).tolist() for u in sides.uses_on(f, side)):
            edge = sides.edge[use]
            own = np.arange(pieces.first[edge], pieces.first[edge + 1])
            own = own[face[own] >= 0]
            own = own[body.surface_of_face[face[own]] == k]
            if len(own) == 0:
                continue
            inside = bool(signs[sides.side[use]] * body.sense[face[own[0]]] < 0)
            if result.setdefault(use, inside) != inside:
                raise TrimmingError("the side of a patch lies in two faces of the body that disagree on the patch")
            for corner, here, there in ((use, after, before), (int(following[use]), before, after)):
                untouched = (f, int(sides.vertex[corner])) not in arc_ends
                if face[here[corner]] >= 0 and face[there[corner]] < 0 and untouched:
                    votes.add(int(there[corner]), inside)
    return result
