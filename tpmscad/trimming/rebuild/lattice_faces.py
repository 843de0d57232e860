"""The lattice's faces inside the body: whole patches as they are, trimmed ones chained anew from border pieces and arcs."""

from __future__ import annotations

from itertools import starmap
from typing import NamedTuple

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep import loops
from tpmscad.brep.boundary_representation import Edges
from tpmscad.trimming.intersect.arrangement import Arrangement

SAMPLES_PER_USE = 8
"""Samples along an edge use, for the areas and the nesting of loops."""

END_SPAN_FRACTION = 1e-4
"""Fraction of an edge use's span over which its direction at an end is measured."""


class EdgeUse(NamedTuple):
    """An edge, +1 or -1 along its parameter, and a pcurve (-1 on a plane)."""

    edge: int
    sense: int
    pcurve: int


class FaceLoops(NamedTuple):
    """A face of the lattice or of the body, and trimming loops on it."""

    face: int
    loops: list[list[EdgeUse]]


def build_lattice_faces(a: Arrangement, edges: Edges) -> list[FaceLoops]:
    """The lattice's faces inside the body, on the edges of `build_edge_table`."""
    o, pieces = a.operands, a.edge_pieces
    sides, first = o.sides, pieces.first
    split = (np.diff(first) > 1) | np.add.reduceat(a.edge_piece_face >= 0, first[:-1]).astype(bool)
    arcs_of_face: dict[int, list[EdgeUse]] = {}
    on_body = (a.piece_face >= 0) & (a.imprints.face[a.imprint_pieces.segment] >= 0)
    for j in np.flatnonzero(on_body).tolist():
        arc = a.imprint_pieces.segment[j]
        sense = int(a.imprints.sense[arc]) * int(o.body.sense[a.piece_face[j]])
        use = EdgeUse(a.n_edge_pieces + j, sense, len(o.lattice.pcurves) + int(a.arcs.fitted_index[arc]))
        arcs_of_face.setdefault(int(a.imprints.face[arc]), []).append(use)
    trimmed = np.logical_or.reduceat(split[sides.edge], sides.start[:-1])
    trimmed[list(arcs_of_face)] = True
    whole = np.flatnonzero(~trimmed & a.edge_piece_inside[first[sides.edge[sides.start[:-1]]]])
    result: list[FaceLoops] = []
    of_use = zip(
        first[sides.edge].tolist(), np.where(sides.forward, 1, -1).tolist(), sides.pcurve.tolist(), strict=True
    )
    uses = list(starmap(EdgeUse, of_use))
    for f in whole.tolist():
        result.append(FaceLoops(f, [uses[sides.start[f] : sides.start[f + 1]]]))
    for f in np.flatnonzero(trimmed).tolist():
        border = _collect_kept_border(a, f)
        kept = border + arcs_of_face.get(f, [])
        if kept:
            result += [FaceLoops(f, face) for face in _chain_patch_faces(a, kept, len(border), edges)]
    return result


def _collect_kept_border(a: Arrangement, face: int) -> list[EdgeUse]:
    """The pieces of a patch's sides that lie inside the body, counter-clockwise."""
    sides, pieces = a.operands.sides, a.edge_pieces
    uses = []
    for use in sides.uses_of(face):
        edge, sense = int(sides.edge[use]), 1 if sides.forward[use] else -1
        numbers = range(int(pieces.first[edge]), int(pieces.first[edge + 1]))
        for i in numbers[::sense]:
            if a.edge_piece_inside[i] if a.edge_piece_face[i] < 0 else a.inside_on_side[use]:
                uses.append(EdgeUse(i, sense, int(sides.pcurve[use])))
    return uses


def _chain_patch_faces(a: Arrangement, uses: list[EdgeUse], n_border: int, edges: Edges) -> list[list[list[EdgeUse]]]:
    """The faces that the edge uses bound on one patch."""
    pcurves = a.operands.lattice.pcurves

    def evaluate(use: EdgeUse, x: Array) -> Array:
        i = use.pcurve - len(pcurves)
        pcurve = pcurves[use.pcurve] if i < 0 else a.arcs.fitted_arcs[i].pcurve
        low, high = edges.span[use.edge]
        return pcurve(low + (high - low) * (x if use.sense > 0 else 1.0 - x))

    def direction(i: int, at_end: bool) -> Array:
        p = evaluate(uses[i], np.array([1.0 - END_SPAN_FRACTION, 1.0] if at_end else [0.0, END_SPAN_FRACTION]))
        return p[1] - p[0]

    edge, forward = np.array([u.edge for u in uses]), np.array([u.sense > 0 for u in uses])
    first = np.where(forward, edges.start[edge], edges.end[edge])
    last = np.where(forward, edges.end[edge], edges.start[edge])
    chained = loops.chain_loops(first, last, direction)
    named = [[uses[i] for i in loop] for loop in chained]
    if len(chained) == 1 and n_border:
        return [named]
    x = np.arange(SAMPLES_PER_USE) / SAMPLES_PER_USE
    polygons = [np.concatenate([evaluate(use, x) for use in loop]) for loop in named]
    return [[named[i] for i in face] for face in loops.nest_loops(polygons)]
