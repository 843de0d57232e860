"""The lattice's faces inside the body: whole ones as they are, cut ones chained anew from border pieces and arcs."""

from __future__ import annotations

import numpy as np

from tpmscad.patches.complex import PatchComplex
from tpmscad.trimming import loops
from tpmscad.trimming.body import Body
from tpmscad.trimming.cuts import PatchCuts
from tpmscad.trimming.pieces import Pieces
from tpmscad.trimming.sides import Sides
from tpmscad.trimming.states import EdgeStates
from tpmscad.trimming.tool import Array, Ints
from tpmscad.trimming.tracks import Tracks

Use = tuple[int, int, int]
"""Edge, +1 or -1 along its parameter, parameter curve (-1 on a plane)."""

Face = tuple[int, list[list[Use]]]
"""A face of the lattice (or another carrier), and its loops."""

SAMPLES = 8
"""Points along a use where a loop's area or nesting must be known."""

NEAR_END = 1e-4
"""Directions at a use's ends are taken over this part of its span."""


def inner_faces(
    lattice: PatchComplex,
    sides: Sides,
    body: Body,
    cuts: PatchCuts,
    tracks: Tracks,
    edge_pieces: Pieces,
    states: EdgeStates,
    track_pieces: Pieces,
    label: Ints,
) -> list[Face]:
    """Faces inside the body. Edges are numbered: the pieces of lattice edges, then those of tracks."""
    first = edge_pieces.first
    split = (np.diff(first) > 1) | np.add.reduceat(states.flat >= 0, first[:-1]).astype(bool)
    n_edges = len(edge_pieces.strand)
    arcs_of: dict[int, list[Use]] = {}
    for j in np.flatnonzero((label >= 0) & (tracks.face[track_pieces.strand] >= 0)).tolist():
        arc = track_pieces.strand[j]
        sense = int(tracks.sense[arc]) * int(body.sense[label[j]])
        use = (n_edges + j, sense, len(lattice.pcurves) + int(cuts.cut[arc]))
        arcs_of.setdefault(int(tracks.face[arc]), []).append(use)
    cut = split[sides.edge].any(axis=1)
    cut[list(arcs_of)] = True
    whole = np.flatnonzero(~cut & states.inside[first[sides.edge[:, 0]]])
    result: list[Face] = []
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
        border = _inner_border(sides, edge_pieces, states, f)
        uses = border + arcs_of.get(f, [])
        if uses:
            result += [(f, face) for face in _chained(lattice, cuts, uses, len(border), start, end, span)]
    return result


def _inner_border(sides: Sides, pieces: Pieces, states: EdgeStates, face: int) -> list[Use]:
    """The pieces of a patch's sides that stay, counter-clockwise."""
    uses = []
    for side in range(4):
        edge, sense = int(sides.edge[face, side]), 1 if sides.forward[face, side] else -1
        numbers = range(int(pieces.first[edge]), int(pieces.first[edge + 1]))
        for i in numbers[::sense]:
            if states.inside[i] if states.flat[i] < 0 else states.on_patch[face, side]:
                uses.append((i, sense, int(sides.pcurve[face, side])))
    return uses


def _chained(
    lattice: PatchComplex, cuts: PatchCuts, uses: list[Use], n_border: int, start: Array, end: Array, span: Array
) -> list[list[list[Use]]]:
    """The faces that the uses bound on one patch."""
    n_pcurves = len(lattice.pcurves)

    def along(use: Use, x: Array) -> Array:
        pcurve = lattice.pcurves[use[2]] if use[2] < n_pcurves else cuts.cuts[use[2] - n_pcurves].pcurve
        low, high = span[use[0]]
        return pcurve(low + (high - low) * (x if use[1] > 0 else 1.0 - x))

    def direction(i: int, at_end: bool) -> Array:
        p = along(uses[i], np.array([1.0 - NEAR_END, 1.0] if at_end else [0.0, NEAR_END]))
        return p[1] - p[0]

    edge, forward = np.array([u[0] for u in uses]), np.array([u[1] > 0 for u in uses])
    first = np.where(forward, start[edge], end[edge])
    last = np.where(forward, end[edge], start[edge])
    chained = loops.chain(first, last, direction)
    named = [[uses[i] for i in loop] for loop in chained]
    if len(chained) == 1 and n_border:
        return [named]
    x = np.arange(SAMPLES) / SAMPLES
    polygons = [np.concatenate([along(use, x) for use in loop]) for loop in named]
    return [[named[i] for i in face] for face in loops.nest(polygons)]
