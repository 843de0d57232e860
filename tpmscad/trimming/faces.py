"""The lattice's faces inside the tool: whole ones as they are, cut ones chained anew from border pieces and arcs."""

from __future__ import annotations

import numpy as np

from tpmscad.patches.complex import PatchComplex
from tpmscad.trimming import loops
from tpmscad.trimming.cuts import PatchCuts
from tpmscad.trimming.pieces import Pieces
from tpmscad.trimming.sides import Sides
from tpmscad.trimming.tool import Array, TrimmingError

Use = tuple[int, int, int]
"""Edge, +1 or -1 along its parameter, parameter curve (-1 on a plane)."""

Face = tuple[int, list[list[Use]]]
"""A face of the lattice (or another carrier), and its loops."""

SAMPLES = 8
"""Points along a use where a loop's area or nesting must be known."""

NEAR_END = 1e-4
"""Directions at a use's ends are taken over this part of its span."""


def inner_faces(
    lattice: PatchComplex, sides: Sides, cuts: PatchCuts, edge_pieces: Pieces, arc_pieces: Pieces
) -> list[Face]:
    """Faces on the inside of every plane. Edges are numbered: the pieces of lattice edges, then those of arcs."""
    gone = (cuts.state > 0).any(axis=1)
    whole = np.flatnonzero(~gone & (cuts.state < 0).all(axis=1))
    cut = np.flatnonzero(~gone & (cuts.state == 0).any(axis=1))
    first = edge_pieces.first
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
    split = np.diff(first) > 1
    for i in np.flatnonzero(split[sides.edge[whole]].any(axis=1)):
        raise TrimmingError(f"an edge of patch {whole[i]} is cut where the patch is not")

    arcs_of: dict[int, list[Use]] = {}
    n_edges = len(edge_pieces.strand)
    for j in np.flatnonzero((arc_pieces.sign <= 0).all(axis=1)).tolist():
        arc = arc_pieces.strand[j]
        use = (n_edges + j, int(cuts.sense[arc]), len(lattice.pcurves) + int(cuts.cut[arc]))
        arcs_of.setdefault(int(cuts.face[arc]), []).append(use)
    start = np.concatenate([edge_pieces.start, arc_pieces.start])
    end = np.concatenate([edge_pieces.end, arc_pieces.end])
    span = np.concatenate([edge_pieces.span, arc_pieces.span])
    for f in cut.tolist():
        border = _inner_border(sides, edge_pieces, cuts, f)
        uses = border + arcs_of.get(f, [])
        if uses:
            result += [(f, face) for face in _chained(lattice, cuts, uses, len(border), start, end, span)]
    return result


def _inner_border(sides: Sides, pieces: Pieces, cuts: PatchCuts, face: int) -> list[Use]:
    """The pieces of a patch's sides that stay, counter-clockwise."""
    uses = []
    for side in range(4):
        edge, sense = int(sides.edge[face, side]), 1 if sides.forward[face, side] else -1
        numbers = range(int(pieces.first[edge]), int(pieces.first[edge + 1]))
        for i in numbers[::sense]:
            sign = np.where(pieces.sign[i] == 0, cuts.side_sign[face, :, side], pieces.sign[i])
            if (sign < 0).all():
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
