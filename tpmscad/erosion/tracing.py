"""The graph of edges and vertices of an eroded body on its offset shell.

A point of the shell bounds the eroded body if no site is nearer than the skin. First the rims are cut where they get shallow.
From every vertex found, edges of two sheets are traced as long as they are deep enough and inside both domains; where they end
is a vertex of a third sheet, or one on a rim. Edges that no rim leads to are found from grids on all sheets, at nodes next to
each other of which one is deep enough. So each edge is traced once, with its parameters on both sheets.

Not resolved are edges that begin inside a sheet, at a centre of curvature, and sheets that touch without crossing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray
from tpmscad.erosion.intersections import meet_pair, meet_rim, meet_three
from tpmscad.erosion.offset_shell import OffsetShell
from tpmscad.erosion.sheets import ring_radius
from tpmscad.erosion.sites import FaceSite, OpenSite, depth_limit
from tpmscad.errors import TrimmingError, format_point

MERGE_REL_TOL = 1e-6
"""In body sizes: vertices within it are one."""

RIM_SAMPLES = 65
"""Points along a rim at which its depth is tested."""

GRID = 33
"""Nodes along each parameter of a sheet, between which crossings are sought."""

FIRST_STEP = 1e-3
"""In skins: step from a vertex that tells whether an edge begins there."""

START_STEP, MAX_STEP = 0.02, 0.12
"""In body sizes: steps along an edge."""

MIN_STEP = 1e-7
"""In body sizes: a trace that would need a smaller step is given up."""

MAX_TURN_COSINE = 0.97
"""Cosine of the angle by which an edge may turn in one step: a quarter of a radian."""

CHECKS = np.array([0.25, 0.5, 0.75, 1.0])
"""Places in a step at which depth and domains are tested."""

TANGENT_SINE = 1e-4
"""Sine of the angle between sheets below which no edge of both leaves a vertex."""

SAME_DIRECTION = 0.999
"""Cosine of the angle between edges of one pair of sheets at a vertex within which they are one."""

CHORD_SAG = 0.1
"""Of a chord: distance within which a point of two sheets is on the edge that has the chord. An edge turns by a quarter of a
radian in two chords at most."""

MAX_TRACE = 2000
"""Steps of one edge."""


@dataclass(frozen=True, slots=True, eq=False)
class TracedEdge:
    """An edge of two sheets: parameters (m, 4) and points (m, 3) in order, and its vertices."""

    sheets: tuple[int, int]
    parameters: Array
    points: Array
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class RimPiece:
    """A part of a rim between two parameters and vertices."""

    rim: int
    span: tuple[float, float]
    start: int
    end: int


@dataclass(slots=True, eq=False)
class EdgeGraph:
    """Vertices with the sheets that meet there and the parameters on them, traced edges, and pieces of rims."""

    shell: OffsetShell
    vertices: list[Array] = field(default_factory=list)
    incident: list[list[tuple[int, Array]]] = field(default_factory=list)
    edges: list[TracedEdge] = field(default_factory=list)
    rim_pieces: list[RimPiece] = field(default_factory=list)

    @property
    def limit(self) -> float:
        """Depth from which a point counts as deep enough."""
        return depth_limit(self.shell.skin, self.shell.size)

    def vertex_at(self, point: Array, entries: list[tuple[int, Array]]) -> int:
        """The vertex at a point, made if there is none, with sheets and parameters added."""
        gaps = np.linalg.norm(np.reshape(self.vertices, (-1, 3)) - point, axis=1)
        if len(gaps) and gaps.min() <= MERGE_REL_TOL * self.shell.size:
            vertex = int(gaps.argmin())
        else:
            vertex = len(self.vertices)
            self.vertices.append(point)
            self.incident.append([])
        own = self.incident[vertex]
        for sheet, uv in entries:
            if all(s != sheet or not self._same_place(sheet, w, uv) for s, w in own):
                own.append((sheet, uv))
        return vertex

    def _same_place(self, sheet: int, one: Array, other: Array) -> bool:
        """Whether parameters that belong to one point are the same place of a sheet."""
        extent = np.ptp(self.shell.sheets[sheet].box(), axis=0)
        return bool((np.abs(one - other) <= 1e-3 * extent).all())


def trace_edges(shell: OffsetShell) -> EdgeGraph:
    """All edges of the eroded body. Raises TrimmingError where an edge cannot be followed to its ends."""
    graph = EdgeGraph(shell)
    for rim in range(len(shell.rims)):
        _cut_rim(graph, rim)
    done = 0
    while True:
        while done < len(graph.vertices):
            _leave_vertex(graph, done)
            done += 1
        seed = next(_find_seeds(graph), None)
        if seed is None:
            return graph
        _trace_from_seed(graph, *seed)


def _cut_rim(graph: EdgeGraph, number: int) -> None:
    """The pieces of a rim that are deep enough, with their vertices."""
    shell, rim = graph.shell, graph.shell.rims[number]

    def own_parameters(t: Array) -> list[Array]:
        found = []
        for s, pcurve in zip(rim.sheets, rim.pcurves, strict=True):
            carrier = shell.sheets[s].carrier
            found.append(carrier.parameters(rim.curve(t)) if pcurve is None else pcurve(t))  # type: ignore[union-attr]
        return found

    def reaches(t: Array) -> BoolArray:
        """Whether the sheets have not ended in a pole."""
        return np.all(
            [
                ring_radius(shell.sheets[s].carrier, uv[:, 1]) > 0
                for s, uv in zip(rim.sheets, own_parameters(t), strict=True)
            ],
            axis=0,
        )

    def is_kept(t: Array) -> BoolArray:
        return reaches(t) & np.isinf(shell.sites.nearest(rim.curve(t), graph.limit).depth)

    def vertex(t: float, *more: tuple[int, Array]) -> int:
        uvs = own_parameters(np.array([t]))
        entries = [(s, uv[0]) for s, uv in zip(rim.sheets, uvs, strict=True)]
        return graph.vertex_at(rim.curve(t), [*entries, *more])

    def end(good: float, bad: float) -> tuple[float, int]:
        for _ in range(60):
            if reaches(np.array([bad]))[0]:
                found = _pierce(graph, number, good, bad)
                if found is not None:
                    return found[0], vertex(found[0], found[1])
            middle = 0.5 * (good + bad)
            if is_kept(np.array([middle]))[0]:
                good = middle
            else:
                bad = middle
        if reaches(np.array([bad]))[0]:
            raise TrimmingError(f"a joint of two offset faces ends in nothing at {format_point(rim.curve(good))}")
        return good, vertex(good)

    samples = np.linspace(*rim.span, RIM_SAMPLES)
    kept = is_kept(samples)
    changes = np.flatnonzero(kept[1:] != kept[:-1])
    ends = [(float(samples[0]), vertex(float(samples[0])))] if kept[0] else []
    ends += [
        end(*(float(samples[k + (0 if kept[k] else 1)]), float(samples[k + (1 if kept[k] else 0)]))) for k in changes
    ]
    if kept[-1]:
        ends.append((float(samples[-1]), vertex(float(samples[-1]))))
    for (low, start), (high, stop) in zip(ends[::2], ends[1::2], strict=True):
        if start != stop or high - low > 0.5 * (rim.span[1] - rim.span[0]):
            graph.rim_pieces.append(RimPiece(number, (low, high), start, stop))


def _pierce(graph: EdgeGraph, number: int, good: float, bad: float) -> tuple[float, tuple[int, Array]] | None:
    """Where a rim pierces the sheet of the site that is too near at its parameter `bad`; None if not between both parameters."""
    shell, rim = graph.shell, graph.shell.rims[number]
    at = rim.curve(bad)
    nearest = _nearest_sheet(graph, at)
    if nearest is None:
        return None
    sheet, uv = nearest
    found = meet_rim(rim, shell.sheets[sheet], bad, uv)
    if found is None:
        return None
    t, uv, point = found
    slack = 1e-9 * (rim.span[1] - rim.span[0])
    if not min(good, bad) - slack <= t <= max(good, bad) + slack or not _is_deep(graph, point[None])[0]:
        return None
    return t, (sheet, uv)


def _nearest_sheet(graph: EdgeGraph, point: Array) -> tuple[int, Array] | None:
    """The sheet of the site that is too near to a point (3,), and parameters on it to start from; None if it has no sheet."""
    shell = graph.shell
    near = shell.sites.nearest(point[None], shell.skin)
    site = int(near.site[0])
    sheet = int(shell.sheet_of_site[site]) if site >= 0 else -1
    if sheet < 0:
        return None
    if isinstance(shell.sites.sites[site], FaceSite | OpenSite):
        return sheet, near.parameters[0]
    return sheet, shell.sheets[sheet].parameters_near(point)


def _is_deep(graph: EdgeGraph, points: Array) -> BoolArray:
    return np.isinf(graph.shell.sites.nearest(points, graph.limit).depth)


def _leave_vertex(graph: EdgeGraph, vertex: int) -> None:
    """Trace all edges that begin at a vertex and are not known yet."""
    shell, point = graph.shell, graph.vertices[vertex]
    for (a, uva), (b, uvb) in combinations(list(graph.incident[vertex]), 2):
        one, other = shell.sheets[a], shell.sheets[b]
        axis = np.cross(one.outward(uva[None])[0], other.outward(uvb[None])[0])
        sine = float(np.linalg.norm(axis))
        if not sine > TANGENT_SINE:
            continue
        for along in (axis / sine, -axis / sine):
            if _is_known(graph, vertex, (a, b), along):
                continue
            y = np.concatenate([uva, uvb])
            step = _advance(graph, (a, b), y, point, along, FIRST_STEP * shell.skin)
            if step is None or not _is_good(graph, (a, b), step[0][None], step[1][None])[0]:
                continue
            states, end = _trace(graph, (a, b), [(y, point), step], along)
            if end < 0:
                raise TrimmingError(f"an edge of the eroded body returns to {format_point(point)}")
            _add_edge(graph, (a, b), states, vertex, end)


def _is_known(graph: EdgeGraph, vertex: int, pair: tuple[int, int], along: Array) -> bool:
    """Whether an edge of two sheets leaves a vertex in a direction already."""
    for edge in graph.edges:
        if sorted(edge.sheets) != sorted(pair):
            continue
        for own, steps in ((edge.start, edge.points[:2]), (edge.end, edge.points[:-3:-1])):
            step = steps[1] - steps[0]
            if own == vertex and step @ along > SAME_DIRECTION * np.linalg.norm(step):
                return True
    return False


def _add_edge(graph: EdgeGraph, pair: tuple[int, int], states: list[tuple[Array, Array]], start: int, end: int) -> None:
    parameters, points = (np.array(part) for part in zip(*states, strict=True))
    graph.edges.append(TracedEdge(pair, parameters, points, start, end))


def _is_good(graph: EdgeGraph, pair: tuple[int, int], y: Array, points: Array) -> BoolArray:
    """Which points of an edge are deep enough and inside both domains."""
    one, other = (graph.shell.sheets[s] for s in pair)
    return one.contains(y[:, :2]) & other.contains(y[:, 2:]) & _is_deep(graph, points)


def _advance(
    graph: EdgeGraph, pair: tuple[int, int], y: Array, point: Array, along: Array, step: float
) -> tuple[Array, Array] | None:
    """The point of an edge at a distance along its tangent, with its parameters; None if Newton's method fails."""
    one, other = (graph.shell.sheets[s] for s in pair)
    guess = y.copy()
    for k, sheet in enumerate((one, other)):
        _, along_u, along_v = sheet.jet(y[None, 2 * k : 2 * k + 2])
        frame = np.stack([along_u[0], along_v[0]], axis=1)
        guess[2 * k : 2 * k + 2] += np.linalg.lstsq(frame, step * along, rcond=None)[0]
    found, points, ok = meet_pair(one, other, guess[None], (point + step * along)[None], along[None])
    if not ok[0] or np.linalg.norm(points[0] - point - step * along) > 0.3 * step:
        return None
    return found[0], points[0]


def _tangent(graph: EdgeGraph, pair: tuple[int, int], y: Array, along: Array) -> Array:
    """The unit tangent of an edge on the side of `along`; that itself where the sheets are tangent."""
    one, other = (graph.shell.sheets[s] for s in pair)
    axis = np.cross(one.outward(y[None, :2])[0], other.outward(y[None, 2:])[0])
    length = float(np.linalg.norm(axis))
    return along if length < 1e-9 else axis / length * (1.0 if axis @ along > 0 else -1.0)


def _trace(
    graph: EdgeGraph, pair: tuple[int, int], states: list[tuple[Array, Array]], along: Array
) -> tuple[list[tuple[Array, Array]], int]:
    """The states of an edge after its first ones, and the vertex where it ends, or -1 if it closes."""
    shell, start = graph.shell, states[0][1]
    one, other = (shell.sheets[s] for s in pair)
    step = START_STEP * shell.size
    y, point = states[-1]
    travelled = float(np.linalg.norm(point - start))
    for _ in range(MAX_TRACE):
        along = _tangent(graph, pair, y, along)
        found = _advance(graph, pair, y, point, along, step)
        if found is None or _tangent(graph, pair, found[0], along) @ along < MAX_TURN_COSINE:
            step *= 0.5
            if step < MIN_STEP * shell.size:
                raise TrimmingError(f"an edge of the eroded body cannot be followed from {format_point(point)}")
            continue
        between = y + CHECKS[:, None] * (found[0] - y)
        at = point + CHECKS[:, None] * (found[1] - point)
        direction = np.broadcast_to((found[1] - point) / np.linalg.norm(found[1] - point), at.shape)
        ys, points, ok = meet_pair(one, other, between, at, direction)
        if not ok.all():
            step *= 0.5
            if step < MIN_STEP * shell.size:
                raise TrimmingError(f"an edge of the eroded body cannot be followed from {format_point(point)}")
            continue
        good = _is_good(graph, pair, ys, points)
        if good.all():
            if travelled > 2 * step and _passes(start, point, found[1]):
                return states, -1
            states.append((ys[1], points[1]))
            states.append(found)
            y, point = found
            travelled += step
            step = min(1.5 * step, MAX_STEP * shell.size)
            continue
        k = int(np.flatnonzero(~good)[0])
        before = (ys[k - 1], points[k - 1]) if k else (y, point)
        last, vertex = _end_edge(graph, pair, before, (ys[k], points[k]))
        states += [(ys[i], points[i]) for i in range(max(k - 1, 0), k)]
        if np.linalg.norm(last[1] - states[-1][1]) <= MERGE_REL_TOL * shell.size and len(states) > 1:
            states.pop()
        return [*states, last], vertex
    raise TrimmingError(f"an edge of the eroded body has more than {MAX_TRACE} steps from {format_point(start)}")


def _passes(start: Array, one: Array, other: Array) -> bool:
    """Whether a step between two points passes the start."""
    step = other - one
    along = (start - one) @ step / (step @ step)
    return bool(0 <= along <= 1 and np.linalg.norm(start - one - along * step) < 0.2 * np.linalg.norm(step))


def _end_edge(
    graph: EdgeGraph, pair: tuple[int, int], good: tuple[Array, Array], bad: tuple[Array, Array]
) -> tuple[tuple[Array, Array], int]:
    """The last state of an edge, between a good and a bad one, and its vertex."""
    shell = graph.shell
    one, other = (shell.sheets[s] for s in pair)
    for _ in range(60):
        found = _resolve_end(graph, pair, good, bad)
        if found is not None:
            return found
        gap = bad[1] - good[1]
        length = float(np.linalg.norm(gap))
        if length < 1e-13 * shell.size:
            break
        y, point, ok = meet_pair(
            one, other, 0.5 * (good[0] + bad[0])[None], 0.5 * (good[1] + bad[1])[None], (gap / length)[None]
        )
        if not ok[0]:
            break
        if _is_good(graph, pair, y, point)[0]:
            good = y[0], point[0]
        else:
            bad = y[0], point[0]
    known = np.linalg.norm(np.reshape(graph.vertices, (-1, 3)) - good[1], axis=1)
    if len(known) and known.min() <= MERGE_REL_TOL * shell.size:
        return good, int(known.argmin())
    raise TrimmingError(f"an edge of the eroded body ends in nothing at {format_point(good[1])}")


def _resolve_end(
    graph: EdgeGraph, pair: tuple[int, int], good: tuple[Array, Array], bad: tuple[Array, Array]
) -> tuple[tuple[Array, Array], int] | None:
    """The end of an edge on a third sheet or on a rim, if Newton's method finds it between both states."""
    shell = graph.shell
    reach = 1.5 * float(np.linalg.norm(bad[1] - good[1])) + MERGE_REL_TOL * shell.size
    for k in (0, 1):
        if not shell.sheets[pair[k]].contains(bad[0][None, 2 * k : 2 * k + 2])[0]:
            return _end_on_rim(graph, pair, k, good, bad, reach)
    nearest = _nearest_sheet(graph, bad[1])
    if nearest is None:
        return None
    sheet, uv = nearest
    three = [shell.sheets[s] for s in (*pair, sheet)]
    found = meet_three(three, np.concatenate([bad[0], uv]))
    if found is None:
        return None
    y, point = found
    if np.linalg.norm(point - good[1]) > reach or not _is_deep(graph, point[None])[0]:
        return None
    entries = [(s, y[2 * k : 2 * k + 2]) for k, s in enumerate((*pair, sheet))]
    if not all(_is_inside(graph, s, w) for s, w in entries):
        return None
    return (y[:4], point), graph.vertex_at(point, entries)


def _is_inside(graph: EdgeGraph, sheet: int, uv: Array) -> bool:
    """Whether parameters lie in the domain of a sheet, or on its border to the accuracy of its polygon."""
    own = graph.shell.sheets[sheet]
    steps = 1e-5 * np.ptp(own.box(), axis=0) * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    return bool(own.contains(uv + steps).any())


def _end_on_rim(
    graph: EdgeGraph,
    pair: tuple[int, int],
    k: int,
    good: tuple[Array, Array],
    bad: tuple[Array, Array],
    reach: float,
) -> tuple[tuple[Array, Array], int] | None:
    """The end of an edge on a rim of its sheet k, which it leaves."""
    shell = graph.shell
    best: tuple[float, int, float] | None = None
    for number, rim in enumerate(shell.rims):
        if pair[k] in rim.sheets:
            t = np.linspace(*rim.span, RIM_SAMPLES)
            gaps = np.linalg.norm(rim.curve(t) - bad[1], axis=1)
            i = int(gaps.argmin())
            if best is None or gaps[i] < best[0]:
                best = float(gaps[i]), number, float(t[i])
    if best is None:
        return None
    rim = shell.rims[best[1]]
    other = pair[1 - k]
    found = meet_rim(rim, shell.sheets[other], best[2], bad[0][2 * (1 - k) : 2 * (1 - k) + 2])
    if found is None or np.linalg.norm(found[2] - good[1]) > reach:
        return None
    t, uv, point = found
    if not _is_deep(graph, point[None])[0]:
        return None
    entries = [(other, uv)]
    y = np.zeros(4)
    y[2 * (1 - k) : 2 * (1 - k) + 2] = uv
    for s, pcurve in zip(rim.sheets, rim.pcurves, strict=True):
        carrier = shell.sheets[s].carrier
        own = carrier.parameters(point) if pcurve is None else pcurve(t)  # type: ignore[union-attr]
        entries.append((s, own))
        if s == pair[k]:
            y[2 * k : 2 * k + 2] = own
    return (y, point), graph.vertex_at(point, entries)


def _find_seeds(graph: EdgeGraph) -> Iterator[tuple[tuple[int, int], Array, Array]]:
    """Points of edges that were not traced: two sheets, parameters (4,) and the point (3,)."""
    shell = graph.shell
    for number, sheet in enumerate(shell.sheets):
        low, high = sheet.box()
        u, v = np.meshgrid(*(np.linspace(a, b, GRID + 2)[1:-1] for a, b in zip(low, high, strict=True)), indexing="ij")
        uv = np.stack([u, v], axis=2)
        inside = sheet.contains(uv.reshape(-1, 2)).reshape(u.shape)
        points = np.full((*u.shape, 3), np.nan)
        points[inside] = sheet.carrier(*uv[inside].T)
        deep = inside.copy()
        deep[inside] = _is_deep(graph, points[inside])
        tree = _edge_tree(graph, number)
        for axis in (0, 1):
            pair = [np.take(a, range(GRID - 1), axis) for a in (deep, inside)]
            then = [np.take(a, range(1, GRID), axis) for a in (deep, inside)]
            for i, j in np.argwhere((pair[0] != then[0]) & pair[1] & then[1]).tolist():
                ends = [(i, j), (i + 1 - axis, j + axis)]
                good, bad = ends if deep[i, j] else ends[::-1]
                cell = float(np.linalg.norm(points[good] - points[bad]))
                middle = 0.5 * (points[good] + points[bad])
                if tree is not None and tree.query(middle)[0] <= 1.5 * cell:
                    continue
                seed = _refine_seed(graph, number, uv[good], uv[bad])
                if seed is not None and not any(_passes_through(e, seed[0], seed[2]) for e in graph.edges):
                    yield seed


def _edge_tree(graph: EdgeGraph, sheet: int) -> cKDTree | None:
    """Points along the known edges of a sheet."""
    found = []
    for edge in graph.edges:
        if sheet in edge.sheets:
            for w in np.linspace(0, 1, 9)[:-1]:
                found.append((1 - w) * edge.points[:-1] + w * edge.points[1:])
    for piece in graph.rim_pieces:
        rim = graph.shell.rims[piece.rim]
        if sheet in rim.sheets:
            found.append(rim.curve(np.linspace(*piece.span, 4 * RIM_SAMPLES)))
    return cKDTree(np.concatenate(found)) if found else None


def _passes_through(edge: TracedEdge, pair: tuple[int, int], point: Array) -> bool:
    """Whether an edge is one of two sheets and passes a point of both, to the accuracy of its chords."""
    if sorted(edge.sheets) != sorted(pair):
        return False
    start, step = edge.points[:-1], np.diff(edge.points, axis=0)
    square = (step * step).sum(axis=1)
    along = np.clip(((point - start) * step).sum(axis=1) / square, 0.0, 1.0)
    gaps = np.linalg.norm(point - start - along[:, None] * step, axis=1)
    return bool((gaps <= CHORD_SAG * np.sqrt(square)).any())


def _refine_seed(graph: EdgeGraph, number: int, good: Array, bad: Array) -> tuple[tuple[int, int], Array, Array] | None:
    """A point of an edge between a node that is deep enough and one that is not; None if another sheet has it."""
    shell, sheet = graph.shell, graph.shell.sheets[number]
    for _ in range(40):
        middle = 0.5 * (good + bad)
        if _is_deep(graph, sheet.carrier(*middle)[None])[0]:
            good = middle
        else:
            bad = middle
    nearest = _nearest_sheet(graph, sheet.carrier(*bad))
    if nearest is None:
        return None
    other, uv = nearest
    y = np.concatenate([good, uv])
    point = sheet.carrier(*good)
    axis = np.cross(sheet.outward(good[None])[0], shell.sheets[other].outward(uv[None])[0])
    length = float(np.linalg.norm(axis))
    if length < TANGENT_SINE:
        return None
    found, points, ok = meet_pair(sheet, shell.sheets[other], y[None], point[None], axis[None] / length)
    if not ok[0] or not _is_good(graph, (number, other), found, points)[0]:
        return None
    return (number, other), found[0], points[0]


def _trace_from_seed(graph: EdgeGraph, pair: tuple[int, int], y: Array, point: Array) -> None:
    """Trace an edge both ways from a point inside it; a closed one is cut into two."""
    along = _tangent(graph, pair, y, np.ones(3))
    ahead, end = _trace(graph, pair, [(y, point)], along)
    if end < 0:
        half = len(ahead) // 2
        vertices = [graph.vertex_at(p, [(pair[0], w[:2]), (pair[1], w[2:])]) for w, p in (ahead[0], ahead[half])]
        _add_edge(graph, pair, ahead[: half + 1], vertices[0], vertices[1])
        _add_edge(graph, pair, [*ahead[half:], ahead[0]], vertices[1], vertices[0])
        return
    back, start = _trace(graph, pair, [(y, point)], -along)
    _add_edge(graph, pair, [*back[:0:-1], *ahead], start, end)
