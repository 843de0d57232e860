"""The boundary of a field of struts, exactly: node by node, and struts that end or touch elsewhere as operands of their own.

A strut *bounds* a node if no other there is thicker. All that do touch one ball, and their boundary follows from the nodes
(`strut_brep`). A thinner strut ends within that ball, and crosses the others there in curves that are no conics; so do struts
that touch outside their nodes. Such a strut is a *piece* by itself. Where it bounds its other node, whose ball it touches, it is
divided at a place that is clear of all others: a *stub* stays at the node, and between two discs, in which stub and piece end,
there is a gap. Where no place is clear, the whole strut is the piece, and thinner there by a part of the tolerance, so that it
crosses the ball. The pieces are united with what bounds the nodes, set by set, and the gaps are bridged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.gap_bridges import bridge_gaps
from tpmscad.brep.near_balls import find_near_balls
from tpmscad.errors import InvalidRequest, TrimmingError, format_point
from tpmscad.fields.data.edge_radii import greatest_radii
from tpmscad.fields.kinds.strut_distances import measure_struts
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.lattices.strut_brep import build_strut_brep
from tpmscad.lattices.strut_contacts import AXES_MEET, DIAMETER_DIGITS, FEWER_STRUTS, find_contact, find_touching
from tpmscad.trimming.network_boolean import DEFAULT_TOL, combine_networks

OUTSIDE_RTOL = 1e-9
"""In sizes of the box: how far vertices of struts that its sides have cut may lie outside it."""

PLACES = 256
"""Places along a strut at which its distance from the others is asked, to divide it."""

GAP_RADII, GAP_LENGTHS = 0.25, 0.05
"""Least length of a gap, in radii there and in lengths of the strut: faces are cut beyond their ends by a fiftieth of it."""

THINNER_TOLS, THINNER_RADII = 0.5, 0.02
"""In tolerances and in the least radii: by how much struts without a gap are thinner where they would touch a ball."""

WITHIN_BALL = 0.5
"""Where a thinner strut ends in a ball, of the way to where its rim leaves it: at the node struts of one radius touch the rim."""

DISC_RTOL = 1e-2
"""In the least radii: distance of a disc from its place, which a boolean may have moved by a few tolerances."""

DIVIDED_FIELDS = 8
"""Divided fields that are kept: each is asked for by the check and by the cut."""

EVERYWHERE = np.full(3, np.inf), np.ones(3), np.zeros(3, np.int64), np.zeros(1, np.int64), np.zeros(1, np.int64)
"""A grid for `measure_struts` that no point lies in, so that all struts are asked."""


class StrutGraph(NamedTuple):
    """Points (n, 3), struts (m, 2), radii (n,) of the ends of all struts at each point, and balls (n,) there, 0 for discs."""

    points: Array
    struts: IntArray
    radii: Array
    balls: Array


@dataclass(frozen=True, slots=True, eq=False)
class DividedStruts:
    """What bounds the nodes, sets of pieces that do not touch each other, and the centres (g, 2, 3) of the discs of gaps.

    thinned: the number of ends at which struts are thinner, and `deviation` by how much of their radius.
    """

    nodes: StrutGraph
    pieces: tuple[StrutGraph, ...]
    gaps: Array
    thinned: int
    deviation: float


def require_struts_apart(graph: StrutGraph) -> None:
    """InvalidRequest if struts touch outside their common nodes; it names the place, and a diameter at which they do not."""
    contact = find_contact(*graph)
    if contact is None or contact.ratio > 1:
        return
    place = format_point(contact.place, 5)
    if contact.distance <= AXES_MEET * contact.needed:
        raise InvalidRequest(f"{contact.what} near {place}: their axes meet, so join them by a node there")
    ratio, radius = contact.ratio * (1 - DIAMETER_DIGITS), float(graph.radii.max())
    is_even = bool(graph.radii.min() == radius and graph.balls.min() == graph.balls.max())
    if not is_even:
        remedy = f"diameters {1 / ratio:.4g} times smaller"
    elif graph.balls.max() > radius:
        remedy = f"a node_radius below {graph.balls.max():g}, or both {1 / contact.ratio:.4g} times smaller"
    else:
        remedy = f"a diameter of at most {2 * radius * ratio:.4g}"
    raise InvalidRequest(
        f"{contact.what} near {place}: there is {contact.distance:.4g} for {contact.needed:.4g} that "
        f"{'a diameter of ' if is_even else 'diameters up to '}{2 * radius:g} needs. Give {remedy}, leave short "
        "struts out of the graph, or make triangles or layers, for which struts may overlap: infill_triangles, infill_layers"
    )


def as_graph(field: StrutsField) -> StrutGraph:
    """The graph of struts that have one radius in each node; TrimmingError if there are two somewhere."""
    radii = greatest_radii(len(field.points), field.edges, field.radii)
    if (field.radii < radii[field.edges]).any():
        raise TrimmingError("struts of two radii meet in a node")
    return StrutGraph(field.points, field.edges, radii, field.balls)


@lru_cache(maxsize=DIVIDED_FIELDS)
def divide_struts(field: StrutsField, tol: float) -> DividedStruts:
    """The struts as operands within a tolerance; InvalidRequest where axes meet without a node, or all struts touch others."""
    radii = greatest_radii(len(field.points), field.edges, field.radii)
    m, widths = len(field.edges), field.radii.sum(axis=1)
    divided, without_stub = np.asarray((field.radii < radii[field.edges]).any(axis=1)), np.zeros((m, 2), bool)
    clear: dict[int, BoolArray] = {}
    while True:
        if divided.all():  # nothing is left that bounds the nodes
            require_struts_apart(StrutGraph(field.points, field.edges, radii, field.balls))
        clear |= _find_clear_places(field, [s for s in np.flatnonzero(divided).tolist() if s not in clear])
        found, part = _divide_at(field, radii, divided, without_stub, clear, tol)
        met = part[find_touching(found.nodes)]
        chosen = _cover_pairs(np.where(met < m, met, -1)[(met < m).any(axis=1)], widths)
        divided[chosen] = True
        if not chosen:
            stubs = np.array(_cover_pairs(met, np.append(widths, np.repeat(widths, 2))), np.int64) - m
            if not len(stubs):
                break
            without_stub.ravel()[stubs] = True
    for graph in (found.nodes, *found.pieces):
        require_struts_apart(graph)
    return found


def _find_clear_places(field: StrutsField, struts: Sequence[int]) -> dict[int, BoolArray]:
    """Of each strut whether the balls at places along it, and between these, are clear of all others: (PLACES + 1,)."""
    start, along, radii = field.parts
    middle, half = start + 0.5 * along, 0.5 * np.linalg.norm(along, axis=1)
    reach = 4 * float(radii.max())
    row, other = find_near_balls(middle[[*struts]], half[[*struts]], reach, "struts", FEWER_STRUTS, (middle, half))
    found, t = {}, np.linspace(0.0, 1.0, PLACES + 1)
    for k, s in enumerate(struts):
        others = other[(row == k) & (other != s)]
        distance = np.full(len(t), np.inf)
        if len(others):
            at = start[s] + t[:, None] * along[s]
            distance = measure_struts(at, start[others], along[others], radii[others], *EVERYWHERE)[0]
        # both the distance and the radius change by less than the place
        found[s] = distance > (1 - t) * radii[s, 0] + t * radii[s, 1] + 2 * half[s] / PLACES
    return found


def _divide_at(
    field: StrutsField,
    radii: Array,
    divided: BoolArray,
    without_stub: BoolArray,
    clear: Mapping[int, BoolArray],
    tol: float,
) -> tuple[DividedStruts, IntArray]:
    """The struts with those flagged (m,) divided, at their ends (m, 2) without a stub or with one, and what their parts are of.

    That is, of each part of what bounds the nodes, the number of the strut, or m and twice that and the end of a stub.
    """
    bounds = field.radii == radii[field.edges]
    count, bounding = np.bincount(field.edges.ravel()), np.bincount(field.edges[bounds], minlength=len(radii))
    points, at_points, balls = list(field.points), radii.tolist(), field.balls.tolist()
    edges, part = field.edges[~divided].tolist(), np.flatnonzero(~divided).tolist()
    gaps: list[Array] = []
    thinned: list[int] = []
    pieces: list[tuple[Array, Array, Array]] = []
    step = min(THINNER_TOLS * tol, THINNER_RADII * float(field.radii.min()))
    for s in np.flatnonzero(divided).tolist():
        pair, start, width = field.edges[s].tolist(), field.points[field.edges[s, 0]], field.radii[s].copy()
        along = field.points[pair[1]] - start
        length = float(np.linalg.norm(along))
        has_stub = bounds[s] & (count[pair] > 1) & ~without_stub[s]
        found = [_find_gap(clear[s][::way], length / r) for way, r in zip((1, -1), width.tolist(), strict=True)]
        if has_stub.all() and found[0] and found[1] and found[0][1] + found[1][1] >= 1:
            has_stub[1] = False
        stubs = [gap if own else None for gap, own in zip(found, has_stub.tolist(), strict=True)]
        ends, shown = np.array([0.0, 1.0]), np.zeros(2)
        for end, node in enumerate(pair):
            if stubs[end] is not None:
                continue
            if bounds[s, end] and bounding[node] == 1:
                shown[end] = field.balls[node]
                continue
            if bounds[s, end]:  # by various amounts, as struts of one radius would touch
                width[end] -= step / (1 + 0.5 * thinned.count(node))
                thinned.append(node)
                bounding[node] -= 1
            room = np.sqrt(max(radii[node] ** 2 - width[end] ** 2, 0.0)) / length
            ends[end] += (1 - 2 * end) * min(WITHIN_BALL * room, GAP_LENGTHS)
        for end, gap in enumerate(stubs):
            if gap is None:
                continue
            t = np.abs(np.array(gap) - end)
            ends[end] = t[1]
            edges.append([pair[end], len(points)][:: 1 - 2 * end])
            part.append(len(field.edges) + 2 * s + end)
            widths = width[0] + t * (width[1] - width[0])
            points.append(start + t[0] * along)
            at_points.append(float(widths[0]))
            balls.append(0.0)
            # a disc lies where the cone touches its ball; the first one of a gap is nearer to the start of the strut
            at = np.sort(t + widths * (width[0] - width[1]) / length**2)
            gaps.append(start + at[:, None] * along)
        pieces.append((start + ends[:, None] * along, width[0] + ends * (width[1] - width[0]), shown))
    graph = StrutGraph(np.array(points), np.array(edges, np.int64).reshape(-1, 2), np.array(at_points), np.array(balls))
    divided_struts = DividedStruts(
        graph,
        _sort_into_sets(pieces),
        np.array(gaps).reshape(-1, 2, 3),
        len(thinned),
        step if thinned else 0.0,
    )
    return divided_struts, np.array(part, np.int64)


def _find_gap(clear: BoolArray, length: float) -> tuple[float, float] | None:
    """From where to where along a strut the first gap may lie, in its length, which is given in radii; None if none is clear."""
    places = int(np.ceil(max(GAP_RADII / length, GAP_LENGTHS) * PLACES))
    if places >= PLACES - 2:
        return None
    runs = np.lib.stride_tricks.sliding_window_view(clear[1:-1], places + 1).all(axis=1)
    begin = np.flatnonzero(runs)
    return ((begin[0] + 1) / PLACES, (begin[0] + 1 + places) / PLACES) if len(begin) else None


def _cover_pairs(pairs: IntArray, width: Array) -> list[int]:
    """Struts such that one of each pair (p, 2) is among them, first those in many pairs or else thinner; -1 is none."""
    chosen = []
    while len(pairs):
        strut, count = np.unique(pairs[pairs >= 0], return_counts=True)
        chosen.append(int(strut[np.lexsort((width[strut], -count))[0]]))
        pairs = pairs[(pairs != chosen[-1]).all(axis=1)]
    return chosen


def _sort_into_sets(pieces: Sequence[tuple[Array, Array, Array]]) -> tuple[StrutGraph, ...]:
    """Pieces, ends (2, 3), radii (2,) and balls (2,) of each, as sets within which none touch; first those with balls."""
    if not pieces:
        return ()
    pieces = sorted(pieces, key=lambda piece: -piece[2].max())
    points, radii, balls = (np.concatenate(each) for each in zip(*pieces, strict=True))
    struts = np.arange(len(points)).reshape(-1, 2)
    touches: list[set[int]] = [set() for _ in pieces]
    for i, j in find_touching((points, struts, radii, balls), -1.0).tolist():
        touches[max(i, j)] |= {min(i, j)} - {max(i, j)}
    number: list[int] = []
    for before in touches:
        taken = {number[i] for i in before}
        number.append(next(n for n in range(len(pieces)) if n not in taken))
    sets = []
    for n in range(max(number) + 1):
        own = struts[np.array(number) == n].ravel()
        sets.append(StrutGraph(points[own], np.arange(len(own)).reshape(-1, 2), radii[own], balls[own]))
    return tuple(sets)


def bound_struts(field: StrutsField, tol: float) -> Brep:
    """The boundary of the struts within a tolerance, free ends included; TrimmingError if they are not cut by each other."""
    divided = divide_struts(field, tol)
    brep = build_strut_brep(*divided.nodes)
    for pieces in divided.pieces:
        brep = _unite(brep, pieces)
    # the kernel refused one of 996 faces whose edges had their own deviation as tolerance, and none with half as much again
    if divided.pieces:
        loose = np.where(brep.edges.deviation > DEFAULT_TOL, 2.0, 1.0)
        brep = replace(brep, edges=replace(brep.edges, deviation=loose * brep.edges.deviation))
    return bridge_gaps(brep, divided.gaps, DISC_RTOL * float(field.radii.min()))


def _unite(brep: Brep, pieces: StrutGraph) -> Brep:
    """The union with pieces at once; in halves, which may be moved otherwise, if that fails."""
    try:
        return combine_networks(brep, build_strut_brep(*pieces), "union").brep
    except TrimmingError:
        if len(pieces.struts) == 1:
            raise
    n = len(pieces.struts) // 2
    first, second = (
        StrutGraph(
            pieces.points[own], pieces.struts[: len(pieces.points[own]) // 2], pieces.radii[own], pieces.balls[own]
        )
        for own in (slice(2 * n), slice(2 * n, None))
    )
    return _unite(_unite(brep, first), second)


def bound_struts_in_box(field: StrutsField, lo: Array, hi: Array) -> Brep:
    """The boundary of the part of struts in a box; TrimmingError unless nodes lie in its sides or keep clear of them."""
    size = float((hi - lo).max())
    graph = as_graph(field)
    depth = np.concatenate([field.points - lo, hi - field.points], axis=1)
    on_side = np.abs(depth) <= OUTSIDE_RTOL * size
    if not (on_side | (depth >= field.balls[:, None] * (1 - OUTSIDE_RTOL))).all():
        raise TrimmingError("nodes lie near sides of the box, not in them")
    contact = find_contact(*graph, (lo, hi))
    if contact is not None and contact.ratio <= 1:
        raise TrimmingError(f"{contact.what} in a side of the box near {format_point(contact.place, 5)}")
    brep = build_strut_brep(*graph, (lo, hi))
    if (brep.vertices < lo - OUTSIDE_RTOL * size).any() or (brep.vertices > hi + OUTSIDE_RTOL * size).any():
        raise TrimmingError("a joint reaches through a side of the box that its node does not lie in")
    return brep
