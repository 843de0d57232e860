"""The lattice's faces inside the body: whole ones as they are, cut ones chained anew from border pieces and arcs."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep import loops
from tpmscad.brep.boundary_representation import Brep
from tpmscad.trimming.classify.lattice_edges import EdgeClassification
from tpmscad.trimming.intersect.curve_surface import SubSegments
from tpmscad.trimming.intersect.patch_surface import IntersectionCurves, PatchArcs
from tpmscad.trimming.operands.patch_sides import PatchSides
from tpmscad.trimming.operands.trimming_body import TrimmingBody

EdgeUse = tuple[int, int, int]
"""Edge, +1 or -1 along its parameter, parameter curve (-1 on a plane)."""

FaceLoops = tuple[int, list[list[EdgeUse]]]
"""A face of the lattice (or another carrier), and its loops."""

SAMPLES_PER_USE = 8
"""Points along a use where a loop's area or nesting must be known."""

END_SPAN_FRACTION = 1e-4
"""Directions at a use's ends are taken over this part of its span."""


def build_lattice_faces(
    lattice: Brep,
    sides: PatchSides,
    body: TrimmingBody,
    cuts: PatchArcs,
    tracks: IntersectionCurves,
    edge_pieces: SubSegments,
    states: EdgeClassification,
    track_pieces: SubSegments,
    label: IntArray,
) -> list[FaceLoops]:
    """Faces inside the body. Edges are numbered: the pieces of lattice edges, then those of tracks."""
    first = edge_pieces.first
    split = (np.diff(first) > 1) | np.add.reduceat(states.flat >= 0, first[:-1]).astype(bool)
    n_edges = len(edge_pieces.segment)
    arcs_of: dict[int, list[EdgeUse]] = {}
    for j in np.flatnonzero((label >= 0) & (tracks.face[track_pieces.segment] >= 0)).tolist():
        arc = track_pieces.segment[j]
        sense = int(tracks.sense[arc]) * int(body.sense[label[j]])
        use = (n_edges + j, sense, len(lattice.pcurves) + int(cuts.cut[arc]))
        arcs_of.setdefault(int(tracks.face[arc]), []).append(use)
    cut = split[sides.edge].any(axis=1)
    cut[list(arcs_of)] = True
    whole = np.flatnonzero(~cut & states.inside[first[sides.edge[:, 0]]])
    result: list[FaceLoops] = []
    senses = np.where(sides.forward, 1, -1)
    for f, e, s, p in zip(
        whole.tolist(),
        first[sides.edge[whole]].tolist(),
        senses[whole].tolist(),
        sides.pcurve[whole].tolist(),
        strict=True,
    ):
        result.append((f, [list(zip(e, s, p, strict=True))]))
    start = np.concatenate([edge_pieces.start, track_pieces.start])
    end = np.concatenate([edge_pieces.end, track_pieces.end])
    span = np.concatenate([edge_pieces.span, track_pieces.span])
    for f in np.flatnonzero(cut).tolist():
        border = _collect_kept_border(sides, edge_pieces, states, f)
        uses = border + arcs_of.get(f, [])
        if uses:
            result += [(f, face) for face in _chain_patch_faces(lattice, cuts, uses, len(border), start, end, span)]
    return result


def _collect_kept_border(
    sides: PatchSides, pieces: SubSegments, states: EdgeClassification, face: int
) -> list[EdgeUse]:
    """The pieces of a patch's sides that stay, counter-clockwise."""
    uses = []
    for side in range(4):
        edge, sense = int(sides.edge[face, side]), 1 if sides.forward[face, side] else -1
        numbers = range(int(pieces.first[edge]), int(pieces.first[edge + 1]))
        for i in numbers[::sense]:
            if states.inside[i] if states.flat[i] < 0 else states.inside_on_side[face, side]:
                uses.append((i, sense, int(sides.pcurve[face, side])))
    return uses


def _chain_patch_faces(
    lattice: Brep, cuts: PatchArcs, uses: list[EdgeUse], n_border: int, start: Array, end: Array, span: Array
) -> list[list[list[EdgeUse]]]:
    """The faces that the uses bound on one patch."""
    n_pcurves = len(lattice.pcurves)

    def along(use: EdgeUse, x: Array) -> Array:
        pcurve = lattice.pcurves[use[2]] if use[2] < n_pcurves else cuts.fitted_arcs[use[2] - n_pcurves].pcurve
        low, high = span[use[0]]
        return pcurve(low + (high - low) * (x if use[1] > 0 else 1.0 - x))

    def direction(i: int, at_end: bool) -> Array:
        p = along(uses[i], np.array([1.0 - END_SPAN_FRACTION, 1.0] if at_end else [0.0, END_SPAN_FRACTION]))
        return p[1] - p[0]

    edge, forward = np.array([u[0] for u in uses]), np.array([u[1] > 0 for u in uses])
    first = np.where(forward, start[edge], end[edge])
    last = np.where(forward, end[edge], start[edge])
    chained = loops.chain_loops(first, last, direction)
    named = [[uses[i] for i in loop] for loop in chained]
    if len(chained) == 1 and n_border:
        return [named]
    x = np.arange(SAMPLES_PER_USE) / SAMPLES_PER_USE
    polygons = [np.concatenate([along(use, x) for use in loop]) for loop in named]
    return [[named[i] for i in face] for face in loops.nest_loops(polygons)]
