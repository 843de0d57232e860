"""Which pieces of the lattice's edges lie in the body: told where they cross it, carried along over patches' corners.

Round a patch the state changes only at vertices in which an arc on the body ends. What no crossing tells about, parts of the
lattice that are in or out as a whole, is told by one point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import TrimmingError
from tpmscad.trimming.intersect.curve_surface import (
    CurveSegments,
    CurveSurfaceIntersections,
    SubSegments,
    evaluate_segments,
)
from tpmscad.trimming.intersect.patch_surface import PatchArcs
from tpmscad.trimming.operands.patch_sides import PatchSides, read_spline_curves
from tpmscad.trimming.operands.trimming_body import TrimmingBody


@dataclass(frozen=True, slots=True, eq=False)
class EdgeClassification:
    """`inside` (M,): of the pieces of the lattice's edges. `flat` (M,): the body's face that a piece lies on, or -1; such a piece
    bounds a patch as `on_patch` tells, by patch and side."""

    inside: BoolArray
    flat: IntArray
    inside_on_side: dict[tuple[int, int], bool]


def classify_lattice_edges(
    lattice: Brep,
    sides: PatchSides,
    body: TrimmingBody,
    cuts: PatchArcs,
    crossings: CurveSurfaceIntersections,
    vertex_of_root: IntArray,
    label_of: dict[tuple[int, int], int],
    hit: BoolArray,
    pieces: SubSegments,
    flat: IntArray,
    arc_ends: set[tuple[int, int]],
    strands: CurveSegments,
    inside_body: Callable[[Array], BoolArray],
) -> EdgeClassification:
    """States of all pieces. `label_of`: faces of vertices on surfaces; `hit` (V,); `arc_ends`: by patch, the vertices in which an
    arc on the body ends. TrimmingError where crossings contradict each other."""
    m = len(pieces.segment)
    before, after = _pieces_at_corners(sides, pieces)  # (F, 4) pieces that end and begin at each corner
    linked = np.ones(before.shape, bool)
    for f, v in arc_ends:
        linked[f] &= sides.corner[f] != v
    linked &= (flat[before] < 0) & (flat[after] < 0)
    joined = coo_array((np.ones(int(linked.sum()), bool), (before[linked], after[linked])), shape=(m, m))
    count, component = connected_components(joined, directed=False)

    votes = np.zeros((count, 2), np.int64)
    _vote_from_roots(votes, component, body, crossings, vertex_of_root, label_of, hit, pieces)
    on_patch = _vote_from_coincident_sides(
        votes, component, lattice, sides, body, cuts, pieces, flat, before, after, arc_ends
    )
    torn = np.flatnonzero(votes.all(axis=1))
    if len(torn):
        piece = np.flatnonzero(component == torn[0])[0]
        at = evaluate_segments(read_spline_curves(lattice), strands, pieces.segment[[piece]], pieces.span[[piece], 0])[
            0
        ]
        raise TrimmingError(f"crossings disagree on whether the lattice near {at.round(6)} is in the body")
    silent = np.setdiff1d(np.flatnonzero(~votes.any(axis=1)), component[flat >= 0])
    if len(silent):
        first = np.full(count, m)
        np.minimum.at(first, component, np.arange(m))
        one = first[silent]
        votes[silent, 1] = inside_body(
            evaluate_segments(read_spline_curves(lattice), strands, pieces.segment[one], pieces.span[one].mean(axis=1))
        )
    return EdgeClassification(votes[component, 1] > 0, flat, on_patch)


def _pieces_at_corners(sides: PatchSides, pieces: SubSegments) -> tuple[IntArray, IntArray]:
    first, last = pieces.first[sides.edge], pieces.first[sides.edge + 1] - 1
    begins, ends = np.where(sides.forward, first, last), np.where(sides.forward, last, first)
    return np.roll(ends, 1, axis=1), begins


def _vote_from_roots(
    votes: Array,
    component: IntArray,
    body: TrimmingBody,
    crossings: CurveSurfaceIntersections,
    vertex_of_root: IntArray,
    label_of: dict[tuple[int, int], int],
    hit: BoolArray,
    pieces: SubSegments,
) -> None:
    """The states before and after every root on a face of the body, where only one surface is crossed."""
    rank = np.arange(len(crossings.root)) - np.repeat(crossings.root_start[:-1], np.diff(crossings.root_start))
    sign = crossings.sign[crossings.root_segment, crossings.root_surface] * (1 - 2 * (rank % 2))
    groups: dict[tuple[int, int], list[int]] = {}
    keys = zip(vertex_of_root.tolist(), crossings.root_surface.tolist(), strict=True)
    for r, key in enumerate(keys):
        if key in label_of and not hit[key[0]]:
            groups.setdefault((int(crossings.root_segment[r]), key[0]), []).append(r)
    for (edge, vertex), members in groups.items():
        if len(members) > 1:
            continue
        r = members[0]
        inside = int(sign[r]) * int(body.sense[label_of[vertex, int(crossings.root_surface[r])]]) < 0
        own = range(int(pieces.first[edge]), int(pieces.first[edge + 1]))
        for p in own:
            if pieces.end[p] == vertex and p + 1 in own:
                votes[component[p], int(inside)] += 1
                votes[component[p + 1], int(not inside)] += 1


def _vote_from_coincident_sides(
    votes: Array,
    component: IntArray,
    lattice: Brep,
    sides: PatchSides,
    body: TrimmingBody,
    cuts: PatchArcs,
    pieces: SubSegments,
    flat: IntArray,
    before: IntArray,
    after: IntArray,
    arc_ends: set[tuple[int, int]],
) -> dict[tuple[int, int], bool]:
    """Patches with a side on a face of the body: whether they lie inside there, and so do the neighbouring sides."""
    result: dict[tuple[int, int], bool] = {}
    for (f, k), signs in cuts.sign_beside_sides.items():
        for side in np.flatnonzero(signs).tolist():
            edge = sides.edge[f, side]
            own = np.arange(pieces.first[edge], pieces.first[edge + 1])
            own = own[flat[own] >= 0]
            own = own[body.surface[flat[own]] == k]
            if len(own) == 0:
                continue
            inside = bool(signs[side] * body.sense[flat[own[0]]] < 0)
            if result.setdefault((f, side), inside) != inside:
                raise TrimmingError("a patch's side lies in two faces of the body that disagree")
            for corner, here, there in ((side, after, before), ((side + 1) % 4, before, after)):
                untouched = (f, int(sides.corner[f, corner])) not in arc_ends
                if flat[here[f, corner]] >= 0 and flat[there[f, corner]] < 0 and untouched:
                    votes[component[there[f, corner]], int(inside)] += 1
    return result


def read_edge_segments(lattice: Brep) -> CurveSegments:
    """All edges of the lattice."""
    e = lattice.edges
    return CurveSegments(e.curve, e.motion, e.span, e.start, e.end)
