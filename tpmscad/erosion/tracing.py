"""Edges of an eroded body, traced on two sheets at once from vertex to vertex.

From every vertex the common curves of two sheets are traced as those of two networks are, and kept as far as they are deep enough
and inside both domains; where that ends is a vertex of a third sheet, or one on a rim. So each edge is traced once, with its
parameters on both sheets.

Not resolved are edges that begin inside a sheet, at a centre of curvature, and sheets that touch without crossing.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.erosion.edge_graph import MERGE_REL_TOL, EdgeGraph, TracedEdge
from tpmscad.erosion.sites import DEPTH_REL_TOL
from tpmscad.errors import TrimmingError, format_point
from tpmscad.index_ranges import repeat_rows
from tpmscad.trimming.intersect.common_curves import correct_points
from tpmscad.trimming.intersect.common_points import make_work
from tpmscad.trimming.intersect.face_face import trace_from
from tpmscad.trimming.intersect.network_hits import evaluate_faces

Pair = tuple[int, int]
"""Numbers of two sheets."""

FIRST_STEP = 1e-3
"""In skins: distance from a vertex at which it is seen whether an edge begins there."""

CHECKS_PER_STEP, CHECK_LENGTH = 4, 0.03
"""Points in a step at which depth and domains are tested, and in body sizes how far they are apart at most."""

CHECKS_AT_ONCE = 16
"""Points that are tested together: beyond the first that is not good the others are needless."""

TANGENT_SINE = 1e-4
"""Sine of the angle between sheets below which no edge of both leaves a vertex."""

SAME_DIRECTION = 0.999
"""Cosine of the angle between edges of one pair of sheets at a vertex within which they are one."""

CLOSING_REL_TOL = 1e-9
"""In body sizes: distance from its start within which a curve is closed."""

CHORD_SAG = 0.1
"""Of a chord between points of an edge: distance from it within which a point of both sheets is on the edge."""

SAME_BRANCH = 0.5
"""Of the change of parameters along a chord: how far those of a point near it may be from the chord's."""

MAX_BISECTIONS, NEWTON_STEPS = 60, 16
"""Halvings of the interval that holds the end of an edge, and steps to the point where it meets a third sheet."""

RESIDUAL_REL_TOL = 1e-13
"""In sizes of the coordinates: distance of the points on the sheets that counts as zero."""

SWAPPED = [0, 1, 2, 5, 6, 3, 4, 7, 8, 9]
"""Columns of a path on the same two sheets in the other order; the tangent turns round."""


def leave_vertices(graph: EdgeGraph) -> None:
    """Trace all edges that begin at vertices, and at those where they end.

    Raises TrimmingError where an edge cannot be followed to its end.
    """
    known: list[int] = []
    while True:
        known += [0] * (len(graph.vertices) - len(known))
        grown = [v for v, own in enumerate(graph.incident) if len(own) > known[v]]
        if not grown:
            return
        for v in grown:
            own, first = graph.incident[v].copy(), known[v]
            known[v] = len(own)
            for (_, (a, uva)), (k, (b, uvb)) in combinations(enumerate(own), 2):
                if k >= first:
                    _leave_vertex(graph, v, (a, b), np.concatenate([uva, uvb]))
                    _leave_vertex(graph, v, (b, a), np.concatenate([uvb, uva]))


def _leave_vertex(graph: EdgeGraph, vertex: int, pair: Pair, y: Array) -> None:
    """Trace the edge of two sheets that begins at a vertex in the direction of the product of their normals, if there is one."""
    tangent = find_tangent(graph, pair, y)
    if tangent is None:
        return
    for edge in graph.edges:
        if sorted(edge.sheets) == sorted(pair):
            for own, leaving in ((edge.start, edge.path[0, 7:]), (edge.end, -edge.path[-1, 7:])):
                if own == vertex and leaving @ tangent > SAME_DIRECTION:
                    return
    start = np.concatenate([graph.vertices[vertex], y, tangent])
    path, end = _follow(graph, pair, start, FIRST_STEP * graph.shell.skin)
    if len(path) > 1:
        if end < 0:
            raise TrimmingError(f"an edge of the eroded body returns to {format_point(start[:3])}")
        _add_edge(graph, pair, path, vertex, end)


def find_tangent(graph: EdgeGraph, pair: Pair, y: Array) -> Array | None:
    """The unit tangent (3,) of the edge of two sheets at parameters y (4,); None if they are tangent there."""
    jets = evaluate_faces(graph.patches, np.array(pair), y.reshape(2, 2))
    normals = np.cross(jets[:, 1], jets[:, 2]) * [[graph.shell.sheets[s].sense] for s in pair]
    axis = np.cross(*normals)
    length = float(np.linalg.norm(axis))
    return axis / length if length > TANGENT_SINE * np.linalg.norm(normals, axis=1).prod() else None


def find_good_points(graph: EdgeGraph, pair: Pair, guess: Array, normal: Array) -> tuple[Array, BoolArray]:
    """Rows (n, 10) of two sheets near points (n, 7), as `_correct` finds them, and which are deep and in both domains (n,)."""
    rows, good = _correct(graph, pair, guess, normal)
    good[good] = graph.contain(pair, rows[good, 3:7])
    good[good] = graph.are_deep(rows[good, :3])
    return rows, good


def _correct(graph: EdgeGraph, pair: Pair, guess: Array, normal: Array) -> tuple[Array, BoolArray]:
    """Rows (n, 10) of two sheets in planes through points (n, 7) near both, and which of them Newton's method has found (n,)."""
    sheets = np.repeat(np.array([pair]), len(guess), axis=0)
    return correct_points(graph.patches, sheets, np.ascontiguousarray(guess), np.ascontiguousarray(normal), make_work())


def _add_edge(graph: EdgeGraph, pair: Pair, path: Array, start: int, end: int) -> None:
    """Add an edge to the graph, without points that coincide with an end, as where a seed is a vertex."""
    gaps = np.min([np.linalg.norm(path[:, :3] - path[end, :3], axis=1) for end in (0, -1)], axis=0)
    gaps[[0, -1]] = np.inf
    graph.edges.append(TracedEdge(pair, path[gaps > MERGE_REL_TOL * graph.shell.size], start, end))


def _follow(graph: EdgeGraph, pair: Pair, start: Array, first: float = np.inf) -> tuple[Array, int]:
    """The path (n, 10) of an edge from its row `start` on, and the vertex where it ends, or -1 if it closes.

    first: distance of a point that must be good, else the start alone is returned: no edge begins there.
    """
    size = graph.shell.size
    traced, closes = trace_from(graph.patches, *pair, start[3:7].copy(), CLOSING_REL_TOL * size)
    outside = np.flatnonzero(~graph.contain(pair, traced[1:, 3:7]))
    if len(outside):
        traced, closes = traced[: outside[0] + 2], False
    step = np.diff(traced[:, :7], axis=0)
    length = np.linalg.norm(step[:, :3], axis=1)
    parts = np.maximum(np.ceil(length / (CHECK_LENGTH * size)).astype(np.int64), CHECKS_PER_STEP)
    row, part = repeat_rows(parts)
    fraction = (part + 1) / parts[row]
    if len(row) and first < fraction[0] * length[0]:
        row, fraction = np.append(0, row), np.append(first / length[0], fraction)
    path = start[None]
    for own in np.split(np.arange(len(row)), np.arange(CHECKS_AT_ONCE, len(row), CHECKS_AT_ONCE)):
        guess = traced[row[own], :7] + fraction[own, None] * step[row[own]]
        rows, good = find_good_points(graph, pair, guess, step[row[own], :3])
        if len(path) == 1 and np.isfinite(first) and not good[:1].any():
            return path, -1
        if not good.all():
            k = int(good.argmin())
            path = np.concatenate([path, rows[:k]])
            last, vertex = _end_edge(graph, pair, path[-1], rows[k])
            return np.concatenate([path, last[None]]), vertex
        path = np.concatenate([path, rows])
    if closes:
        return path, -1
    # steps are halved before a point in which the sheets are tangent, as tubes of two edges are at their corner
    if len(step):
        end = _find_vertex(graph, pair, traced[-1], 2.0 * traced[-1] - traced[-2])
        if end is not None:
            return np.concatenate([path, _end_row(graph, path[-1], *end)[None]]), end[0]
    raise TrimmingError(f"an edge of the eroded body cannot be followed from {format_point(path[-1, :3])}")


def _end_edge(graph: EdgeGraph, pair: Pair, good: Array, bad: Array) -> tuple[Array, int]:
    """The last row (10,) of an edge, between a good and a bad one, and its vertex."""
    for _ in range(MAX_BISECTIONS):
        end = _find_vertex(graph, pair, good, bad)
        if end is None and graph.contain(pair, bad[None, 3:7])[0]:
            end = _meet_third(graph, pair, good, bad)
        if end is not None:
            return _end_row(graph, good, *end), end[0]
        rows, is_good = find_good_points(graph, pair, 0.5 * (good + bad)[None, :7], (bad - good)[None, :3])
        good, bad = (rows[0], bad) if is_good[0] else (good, rows[0])
    end = _find_tangent_vertex(graph, pair, good)
    if end is not None:
        return _end_row(graph, good, *end), end[0]
    raise TrimmingError(f"an edge of the eroded body ends in nothing at {format_point(good[:3])}")


def _find_tangent_vertex(graph: EdgeGraph, pair: Pair, good: Array) -> tuple[int, Array] | None:
    """The vertex near the last row (10,) of an edge in which its sheets are tangent, and its parameters (4,) on both.

    Sheets that are off by e there, as fitted ones are, meet off it by the root of e times their radius of curvature.
    """
    reach = np.sqrt(DEPTH_REL_TOL * graph.shell.size * graph.shell.skin)
    distance = np.linalg.norm(np.reshape(graph.vertices, (-1, 3)) - good[:3], axis=1)
    for v in np.flatnonzero(distance <= reach).tolist():
        for y in _list_parameters(graph, pair, v):
            if find_tangent(graph, pair, y) is None:
                return v, y
    return None


def _list_parameters(graph: EdgeGraph, pair: Pair, vertex: int) -> Iterator[Array]:
    """The parameters (4,) of a vertex on both sheets, several where a sheet passes it more than once."""
    own = [[uv for s, uv in graph.incident[vertex] if s == sheet] for sheet in pair]
    return map(np.concatenate, product(*own))


def _end_row(graph: EdgeGraph, before: Array, vertex: int, y: Array) -> Array:
    """The row (10,) at a vertex, its tangent that of the row before, reflected in the chord."""
    chord = graph.vertices[vertex] - before[:3]
    square = float(chord @ chord)
    tangent = 2 * (chord @ before[7:]) / square * chord - before[7:] if square else before[7:]
    return np.concatenate([graph.vertices[vertex], y, tangent])


def _find_vertex(graph: EdgeGraph, pair: Pair, good: Array, bad: Array) -> tuple[int, Array] | None:
    """The first known vertex of two sheets between two rows (10,) of their curve, and its parameters (4,) on both."""
    arm = np.reshape(graph.vertices, (-1, 3)) - good[:3]
    reach = 2.0 * np.linalg.norm(bad[:3] - good[:3]) + MERGE_REL_TOL * graph.shell.size
    near = np.flatnonzero(np.linalg.norm(arm, axis=1) <= reach)
    for v in near[np.argsort(arm[near] @ (bad - good)[:3], kind="stable")].tolist():
        for y in _list_parameters(graph, pair, v):
            if _is_between(graph, pair, good, bad, np.concatenate([graph.vertices[v], y])):
                return v, y
    return None


def _is_between(graph: EdgeGraph, pair: Pair, good: Array, bad: Array, at: Array) -> bool:
    """Whether a point (7,) of two sheets is on their curve between two rows (10,), by its place and its parameters."""
    step = (bad - good)[:7]
    along = float((at - good[:7])[:3] @ step[:3]) / max(float(step[:3] @ step[:3]), 1e-300)
    off = at - good[:7] - float(np.clip(along, 0.0, 1.0)) * step
    sizes = graph.shell.size, *(float(np.ptp(graph.shell.sheets[s].box())) for s in pair)
    parts = zip((CHORD_SAG, SAME_BRANCH, SAME_BRANCH), sizes, (slice(0, 3), slice(3, 5), slice(5, 7)), strict=True)
    return all(
        np.linalg.norm(off[own]) <= (ratio * np.linalg.norm(step[own]) if 0 < along < 1 else 0.0) + MERGE_REL_TOL * size
        for ratio, size, own in parts
    )


def _meet_third(graph: EdgeGraph, pair: Pair, good: Array, bad: Array) -> tuple[int, Array] | None:
    """The vertex of an edge and the sheet that is too near at its bad end, and its parameters (4,); None if not between both."""
    nearest = graph.nearest_sheet(bad[:3])
    if nearest is None:
        return None
    sheet, uv = nearest
    y, tol = bad[3:7], RESIDUAL_REL_TOL * (1.0 + float(np.abs(bad[:3]).max()))
    for _ in range(NEWTON_STEPS):
        third = evaluate_faces(graph.patches, np.array([sheet]), uv[None])[0]
        rows, found = _correct(graph, pair, np.concatenate([third[0], y])[None], np.cross(third[1], third[2])[None])
        if not found[0]:
            return None
        y, gap = rows[0, 3:7], rows[0, :3] - third[0]
        uv = uv + np.linalg.lstsq(third[1:].T, gap, rcond=None)[0]
        if np.abs(gap).max() <= tol:
            break
    if np.abs(gap).max() > 1000 * tol or not _is_between(graph, pair, good, bad, rows[0, :7]):
        return None
    entries = [(pair[0], y[:2]), (pair[1], y[2:]), (sheet, uv)]
    if not graph.are_deep(rows[:, :3])[0] or not all(_is_inside(graph, s, own) for s, own in entries):
        return None
    return graph.vertex_at(rows[0, :3], entries), y


def _is_inside(graph: EdgeGraph, sheet: int, uv: Array) -> bool:
    """Whether parameters lie in the domain of a sheet, or on its border to the accuracy of its polygon."""
    own = graph.shell.sheets[sheet]
    steps = 1e-5 * np.ptp(own.box(), axis=0) * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    return bool(own.contains(uv + steps).any())


def trace_from_seed(graph: EdgeGraph, pair: Pair, seed: Array) -> None:
    """Trace an edge both ways from a row (10,) inside it; a closed one is cut into two."""
    ahead, end = _follow(graph, pair, seed)
    if end < 0:
        half = len(ahead) // 2
        ends = [graph.vertex_at(row[:3], [(pair[0], row[3:5]), (pair[1], row[5:7])]) for row in (ahead[0], ahead[half])]
        _add_edge(graph, pair, ahead[: half + 1], ends[0], ends[1])
        _add_edge(graph, pair, ahead[half:], ends[1], ends[0])
        return
    back, start = _follow(graph, pair[::-1], _turn_round(seed[None])[0])
    _add_edge(graph, pair, np.concatenate([_turn_round(back)[:-1], ahead]), start, end)


def _turn_round(path: Array) -> Array:
    """A path (n, 10) in the other direction, on the same two sheets in the other order."""
    turned = path[::-1, SWAPPED]
    turned[:, 7:] *= -1
    return turned
