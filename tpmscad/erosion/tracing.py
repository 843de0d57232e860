"""Edges of an eroded body, traced on two sheets at once from vertex to vertex.

From every vertex edges of two sheets are traced as long as they are deep enough and inside both domains; where they end is a
vertex of a third sheet, or one on a rim. So each edge is traced once, with its parameters on both sheets.

Not resolved are edges that begin inside a sheet, at a centre of curvature, and sheets that touch without crossing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.conics import cross_single
from tpmscad.erosion.edge_graph import MERGE_REL_TOL, EdgeGraph, TracedEdge
from tpmscad.erosion.intersections import Meeting, meet_pair, meet_rim, meet_three
from tpmscad.erosion.rim_cuts import RIM_SAMPLES
from tpmscad.errors import TrimmingError, format_point
from tpmscad.splines.bspline import BSplineSurface

Pair = tuple[int, int]
"""Numbers of two sheets."""

FIRST_STEPS = 1e-3, 1e-4, 1e-5
"""In skins: steps from a vertex that tell whether an edge begins there; the next where one leaves the curve."""

START_STEP, MAX_STEP = 0.02, 0.12
"""In body sizes: steps along an edge."""

MIN_STEP = 1e-7
"""In body sizes: a trace that would need a smaller step is given up."""

MAX_TURN_COSINE = 0.88
"""Cosine of the angle by which an edge may turn in one step: half a radian."""

CHECKS = np.array([0.25, 0.5, 0.75, 1.0])
"""Places in a step at which depth and domains are tested."""

TANGENT_SINE = 1e-4
"""Sine of the angle between sheets below which no edge of both leaves a vertex."""

NO_SINE = 1e-9
"""Sine of the angle between sheets below which their edge goes on in the direction that it has."""

LEAST_GRAM = 1e-20
"""Determinant, relative to squared lengths, below which the derivatives of a sheet count as parallel."""

SAME_DIRECTION = 0.999
"""Cosine of the angle between edges of one pair of sheets at a vertex within which they are one."""

MAX_DRIFT = 0.3
"""Of a step: how far its end may lie from the tangent."""

MAX_JUMP = 0.5
"""Of the change of a fitted sheet's parameters by their slopes: how far the actual change may differ."""

MAX_TRACE = 2000
"""Steps of one edge."""


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """A point (3,) of an edge, parameters (4,), derivatives (4, 3) of the sheets by these, and the unit tangent (3,)."""

    parameters: Array
    point: Array
    frames: Array
    tangent: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """An edge that leaves a vertex: its sheets, its first two states."""

    vertex: int
    pair: Pair
    first: _State
    second: _State


def leave_vertices(graph: EdgeGraph) -> None:
    """Trace all edges that begin at vertices, and at those where they end.

    Raises TrimmingError where an edge cannot be followed to its end.
    """
    known = [0] * len(graph.vertices)
    while True:
        known += [0] * (len(graph.vertices) - len(known))
        grown = [v for v, own in enumerate(graph.incident) if len(own) > known[v]]
        if not grown:
            return
        starts = [start for v in grown for start in _find_starts(graph, v, known[v])]
        for v in grown:
            known[v] = len(graph.incident[v])
        if not starts:
            continue
        for start, deep in zip(starts, graph.are_deep(np.array([s.second.point for s in starts])), strict=True):
            if deep and not _is_known(graph, start):
                states, end = _trace(graph, start.pair, [start.first, start.second])
                if end < 0:
                    raise TrimmingError(f"an edge of the eroded body returns to {format_point(start.first.point)}")
                _add_edge(graph, start.pair, states, start.vertex, end)


def _find_starts(graph: EdgeGraph, vertex: int, known: int) -> list[_Start]:
    """The edges inside two domains that leave a vertex, of pairs of sheets of which one comes after the first `known` ones."""
    shell, point = graph.shell, graph.vertices[vertex]
    found = []
    own = list(enumerate(graph.incident[vertex]))
    for (_, (a, uva)), (k, (b, uvb)) in combinations(own, 2):
        if k < known:
            continue
        one, other = shell.sheets[a], shell.sheets[b]
        y = np.concatenate([uva, uvb])
        frames = _frames(graph, (a, b), y)
        axis = _unit_axis(frames)
        if axis is None or axis[1] <= TANGENT_SINE:
            continue
        first = _State(y, point, frames, axis[0])
        for start in (first, replace(first, tangent=-first.tangent)):
            second = _first_state(graph, (a, b), start)
            if second is None:
                continue
            y = second.parameters
            if one.contains(y[None, :2])[0] and other.contains(y[None, 2:])[0]:
                found.append(_Start(vertex, (a, b), start, second))
    return found


def _first_state(graph: EdgeGraph, pair: Pair, start: _State) -> _State | None:
    """The state a short step after the start of an edge, None if Newton's method finds none on the same curve."""
    for step in FIRST_STEPS:
        found = _advance(graph, pair, start, np.array([step * graph.shell.skin]))
        second = _state_at(found, 0, start.tangent)
        if found.converged[0] and not _jumps(graph, pair, [start, second]):
            return second
    return None


def _is_known(graph: EdgeGraph, start: _Start) -> bool:
    """Whether an edge of two sheets leaves a vertex in a direction already."""
    for edge in graph.edges:
        if sorted(edge.sheets) != sorted(start.pair):
            continue
        for own, leaving in zip((edge.start, edge.end), edge.leaving, strict=True):
            if own == start.vertex and leaving @ start.first.tangent > SAME_DIRECTION:
                return True
    return False


def _add_edge(graph: EdgeGraph, pair: Pair, states: Sequence[_State], start: int, end: int) -> None:
    """Add an edge to the graph, without states that coincide with an end, as where a seed is a vertex."""
    parameters, points = np.array([s.parameters for s in states]), np.array([s.point for s in states])
    gaps = np.min([np.linalg.norm(points - points[end], axis=1) for end in (0, -1)], axis=0)
    gaps[[0, -1]] = np.inf
    kept = gaps > MERGE_REL_TOL * graph.shell.size
    parameters, points = parameters[kept], points[kept]
    leaving = []
    for y, step in ((parameters[0], points[1] - points[0]), (parameters[-1], points[-2] - points[-1])):
        along = step / np.linalg.norm(step)
        leaving.append(_tangent(_frames(graph, pair, y), along))
    graph.edges.append(TracedEdge(pair, parameters, points, np.array(leaving), start, end))


def is_good(graph: EdgeGraph, pair: Pair, y: Array, points: Array) -> BoolArray:
    """Which points (n, 3) of an edge, of parameters (n, 4), are deep enough and inside both domains: (n,)."""
    one, other = (graph.shell.sheets[s] for s in pair)
    good = one.contains(y[:, :2]) & other.contains(y[:, 2:])
    good[good] = graph.are_deep(points[good])
    return good


def _unit_axis(frames: Array) -> tuple[Array, float] | None:
    """The unit vector along two sheets with derivatives (4, 3), and the sine of their angle; None where it is undefined."""
    one, other = cross_single(frames[0], frames[1]), cross_single(frames[2], frames[3])
    axis = cross_single(one, other)
    length, scale = float(np.linalg.norm(axis)), float(np.linalg.norm(one) * np.linalg.norm(other))
    return (axis / length, length / scale) if length > 0 else None


def _tangent(frames: Array, along: Array) -> Array:
    """The unit tangent (3,) of an edge on the side of `along`, or that itself where the sheets are tangent."""
    axis = _unit_axis(frames)
    if axis is None or axis[1] <= NO_SINE:
        return along
    return axis[0] if axis[0] @ along > 0 else -axis[0]


def _frames(graph: EdgeGraph, pair: Pair, y: Array) -> Array:
    """Derivatives (4, 3) of two sheets by their parameters y (4,)."""
    one, other = (graph.shell.sheets[s] for s in pair)
    return np.concatenate([one.jet(y[None, :2])[1:], other.jet(y[None, 2:])[1:]])[:, 0]


def _slope(frames: Array, along: Array) -> Array:
    """The rates (4,) of the parameters of two sheets with derivatives (4, 3) along a direction (3,)."""
    gram, slopes = (frames @ frames.T).tolist(), (frames @ along).tolist()
    found = []
    for i, j in ((0, 1), (2, 3)):
        a, b, c = gram[i][i], gram[i][j], gram[j][j]
        determinant = a * c - b * b
        if determinant > LEAST_GRAM * a * c:
            found += [(c * slopes[i] - b * slopes[j]) / determinant, (a * slopes[j] - b * slopes[i]) / determinant]
        else:
            found += np.linalg.lstsq(frames[i : j + 1].T, along, rcond=None)[0].tolist()
    return np.array(found)


def _state_at(found: Meeting, i: int, along: Array) -> _State:
    """The state at a point of two sheets, with the tangent on the side of `along`, or that itself where they are tangent."""
    tangent = _tangent(found.frames[i], along)
    return _State(found.parameters[i], found.points[i], found.frames[i], tangent)


def _advance(graph: EdgeGraph, pair: Pair, state: _State, lengths: Array) -> Meeting:
    """The points of an edge at distances (n,) along its tangent; those too far off the tangent count as not converged."""
    one, other = (graph.shell.sheets[s] for s in pair)
    at = state.point + lengths[:, None] * state.tangent
    along = np.broadcast_to(state.tangent, at.shape)
    found = meet_pair(one, other, state.parameters + lengths[:, None] * _slope(state.frames, state.tangent), at, along)
    drift = np.linalg.norm(found.points - at, axis=1)
    return replace(found, converged=found.converged & (drift <= MAX_DRIFT * np.abs(lengths)))


def _trace(graph: EdgeGraph, pair: Pair, states: list[_State]) -> tuple[list[_State], int]:
    """The states of an edge after its first ones, and the vertex where it ends, or -1 if it closes."""
    shell, start = graph.shell, states[0].point
    step = START_STEP * shell.size
    state = states[-1]
    travelled = float(np.linalg.norm(state.point - start))
    for _ in range(MAX_TRACE):
        found = _advance(graph, pair, state, step * CHECKS)
        path = [_state_at(found, i, state.tangent) for i in range(len(CHECKS))]
        ahead = path[-1]
        turns = ahead.tangent @ state.tangent < MAX_TURN_COSINE
        if not found.converged.all() or turns or _jumps(graph, pair, [state, *path]):
            step *= 0.5
            if step < MIN_STEP * shell.size:
                raise TrimmingError(f"an edge of the eroded body cannot be followed from {format_point(state.point)}")
            continue
        good = is_good(graph, pair, found.parameters, found.points)
        if good.all():
            if travelled > 2 * step and _passes(start, state.point, ahead.point):
                return states, -1
            states += [path[1], ahead]
            state = ahead
            travelled += step
            step = min(1.5 * step, MAX_STEP * shell.size)
            continue
        k = int(np.flatnonzero(~good)[0])
        last, vertex = _end_edge(graph, pair, path[k - 1] if k else state, path[k])
        states += path[max(k - 1, 0) : k]
        if np.linalg.norm(last.point - states[-1].point) <= MERGE_REL_TOL * shell.size and len(states) > 1:
            states.pop()
        return [*states, last], vertex
    raise TrimmingError(f"an edge of the eroded body has more than {MAX_TRACE} steps from {format_point(start)}")


def _jumps(graph: EdgeGraph, pair: Pair, path: list[_State]) -> bool:
    """Whether the parameters of a fitted sheet change by far more between states than their slopes say.

    Where the skin is little thicker than a radius of curvature, the sheet crosses itself and turns back twice in between. A step
    over that is good in both ends, but it leaves the smooth curve.
    """
    fitted = [isinstance(graph.shell.sheets[s].carrier, BSplineSurface) for s in pair]
    if not any(fitted):
        return False
    lengths = np.linalg.norm(np.diff([s.point for s in path], axis=0), axis=1)
    slopes = np.array([_slope(s.frames, s.tangent) for s in path])
    expected = (0.5 * (slopes[1:] + slopes[:-1]) * lengths[:, None]).reshape(-1, 2, 2)
    change = np.diff([s.parameters for s in path], axis=0).reshape(-1, 2, 2)
    excess = np.linalg.norm(change - expected, axis=2) > MAX_JUMP * np.linalg.norm(expected, axis=2)
    return bool(excess[:, fitted].any())


def _passes(start: Array, one: Array, other: Array) -> bool:
    """Whether a step between two points passes the start."""
    step = other - one
    along = (start - one) @ step / (step @ step)
    return bool(0 <= along <= 1 and np.linalg.norm(start - one - along * step) < 0.2 * np.linalg.norm(step))


def _end_edge(graph: EdgeGraph, pair: Pair, good: _State, bad: _State) -> tuple[_State, int]:
    """The last state of an edge, between a good and a bad one, and its vertex."""
    shell = graph.shell
    one, other = (shell.sheets[s] for s in pair)
    for _ in range(60):
        end = _resolve_end(graph, pair, good, bad)
        if end is not None:
            y, point, vertex = end
            return replace(good, parameters=y, point=point), vertex
        gap = bad.point - good.point
        length = float(np.linalg.norm(gap))
        if length < 1e-13 * shell.size:
            break
        middle = 0.5 * (good.parameters + bad.parameters), 0.5 * (good.point + bad.point)
        found = meet_pair(one, other, middle[0][None], middle[1][None], (gap / length)[None])
        if not found.converged[0]:
            break
        state = _state_at(found, 0, good.tangent)
        if is_good(graph, pair, found.parameters, found.points)[0]:
            good = state
        else:
            bad = state
    known = np.linalg.norm(np.reshape(graph.vertices, (-1, 3)) - good.point, axis=1)
    if len(known) and known.min() <= MERGE_REL_TOL * shell.size:
        return good, int(known.argmin())
    raise TrimmingError(f"an edge of the eroded body ends in nothing at {format_point(good.point)}")


def _resolve_end(graph: EdgeGraph, pair: Pair, good: _State, bad: _State) -> tuple[Array, Array, int] | None:
    """The end of an edge on a third sheet or on a rim, if Newton's method finds it between both states.

    Its parameters (4,), the point (3,), and the vertex.
    """
    shell = graph.shell
    reach = 1.5 * float(np.linalg.norm(bad.point - good.point)) + MERGE_REL_TOL * shell.size
    for k in (0, 1):
        if not shell.sheets[pair[k]].contains(bad.parameters[None, 2 * k : 2 * k + 2])[0]:
            return _end_on_rim(graph, pair, k, good, bad, reach)
    nearest = graph.nearest_sheet(bad.point)
    if nearest is None:
        return None
    sheet, uv = nearest
    three = [shell.sheets[s] for s in (*pair, sheet)]
    found = meet_three(three, np.concatenate([bad.parameters, uv]))
    if found is None:
        return None
    y, point = found
    if np.linalg.norm(point - good.point) > reach or not graph.are_deep(point[None])[0]:
        return None
    entries = [(s, y[2 * k : 2 * k + 2]) for k, s in enumerate((*pair, sheet))]
    if not all(_is_inside(graph, s, w) for s, w in entries):
        return None
    return y[:4], point, graph.vertex_at(point, entries)


def _is_inside(graph: EdgeGraph, sheet: int, uv: Array) -> bool:
    """Whether parameters lie in the domain of a sheet, or on its border to the accuracy of its polygon."""
    own = graph.shell.sheets[sheet]
    steps = 1e-5 * np.ptp(own.box(), axis=0) * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    return bool(own.contains(uv + steps).any())


def _end_on_rim(
    graph: EdgeGraph, pair: Pair, k: int, good: _State, bad: _State, reach: float
) -> tuple[Array, Array, int] | None:
    """The end of an edge on a rim of its sheet k, which it leaves."""
    shell = graph.shell
    best: tuple[float, int, float] | None = None
    for number, rim in enumerate(shell.rims):
        if pair[k] in rim.sheets:
            t = np.linspace(*rim.span, RIM_SAMPLES)
            gaps = np.linalg.norm(rim.curve(t) - bad.point, axis=1)
            i = int(gaps.argmin())
            if best is None or gaps[i] < best[0]:
                best = float(gaps[i]), number, float(t[i])
    if best is None:
        return None
    rim, other = shell.rims[best[1]], pair[1 - k]
    beside = slice(2 * (1 - k), 2 * (1 - k) + 2)
    found = meet_rim(rim, shell.sheets[other], best[2], bad.parameters[beside])
    if found is None or np.linalg.norm(found[2] - good.point) > reach:
        return None
    t, uv, point = found
    if not graph.are_deep(point[None])[0]:
        return None
    entries = [(other, uv)]
    y = np.zeros(4)
    y[beside] = uv
    for s, pcurve in zip(rim.sheets, rim.pcurves, strict=True):
        carrier = shell.sheets[s].carrier
        own = carrier.parameters(point) if pcurve is None else pcurve(t)  # type: ignore[union-attr]
        entries.append((s, own))
        if s == pair[k]:
            y[2 * k : 2 * k + 2] = own
    return y, point, graph.vertex_at(point, entries)


def trace_from_seed(graph: EdgeGraph, pair: Pair, y: Array, point: Array) -> None:
    """Trace an edge both ways from a point (3,) of parameters (4,) inside it; a closed one is cut into two."""
    frames = _frames(graph, pair, y)
    tangent = _tangent(frames, np.ones(3))
    seed = _State(y, point, frames, tangent)
    ahead, end = _trace(graph, pair, [seed])
    if end < 0:
        half = len(ahead) // 2
        ends = [
            graph.vertex_at(s.point, [(pair[0], s.parameters[:2]), (pair[1], s.parameters[2:])])
            for s in (ahead[0], ahead[half])
        ]
        _add_edge(graph, pair, ahead[: half + 1], ends[0], ends[1])
        _add_edge(graph, pair, [*ahead[half:], ahead[0]], ends[1], ends[0])
        return
    back, start = _trace(graph, pair, [replace(seed, tangent=-tangent)])
    _add_edge(graph, pair, [*back[:0:-1], *ahead], start, end)
