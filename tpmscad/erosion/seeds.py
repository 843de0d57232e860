"""Points of edges that no vertex leads to, between nodes of sheets next to each other of which one is deep enough."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.erosion.edge_graph import GRID, EdgeGraph, SheetGrid, TracedEdge
from tpmscad.erosion.intersections import meet_pair
from tpmscad.erosion.rim_cuts import RIM_SAMPLES
from tpmscad.erosion.tracing import TANGENT_SINE, is_good

CHORD_SAG = 0.1
"""Of a chord: distance within which a point of two sheets is on the edge that has the chord. An edge turns by half a radian in
two chords at most."""

SECTIONS, SECTION_ROUNDS = np.arange(1, 16) / 16, 6
"""Places between two nodes at which depth changes are sought at once, and how often: 15 points take little longer than one."""

SAMPLES_PER_CHORD = 8
"""Points of the chords of edges that are sought near a node."""


def find_seeds(graph: EdgeGraph) -> Iterator[tuple[tuple[int, int], Array, Array]]:
    """Points of edges that were not traced: two sheets, parameters (4,) and the point (3,)."""
    for number in range(len(graph.shell.sheets)):
        grid = graph.grid(number)
        good, bad = _find_changes(grid)
        cell = np.linalg.norm(grid.points[good] - grid.points[bad], axis=1)
        middle = 0.5 * (grid.points[good] + grid.points[bad])
        apart = _distances_from_edges(graph, number, middle)
        for k in range(len(cell)):
            if apart[k] <= 1.5 * cell[k]:
                continue
            seed = _refine_seed(graph, number, grid.uv[good][k], grid.uv[bad][k])
            if seed is not None and not any(_passes_through(e, seed[0], seed[2]) for e in graph.edges):
                yield seed
                apart = _distances_from_edges(graph, number, middle)


def _find_changes(grid: SheetGrid) -> tuple[tuple[IntArray, IntArray], tuple[IntArray, IntArray]]:
    """Indices of nodes that are deep enough, and of neighbours that are not."""
    found = []
    for step in ((1, 0), (0, 1)):
        here = np.argwhere(grid.inside[: GRID - step[0], : GRID - step[1]])
        there = here + step
        here, there = (a[grid.inside[tuple(there.T)]] for a in (here, there))
        deep = grid.deep[tuple(here.T)]
        changes = deep != grid.deep[tuple(there.T)]
        found.append(
            np.where(deep[:, None, None], np.stack([here, there], axis=1), np.stack([there, here], axis=1))[changes]
        )
    good, bad = np.concatenate(found).transpose(1, 2, 0)
    return tuple(good), tuple(bad)


def _distances_from_edges(graph: EdgeGraph, sheet: int, points: Array) -> Array:
    """Distances (n,) of points (n, 3) from points along the known edges of a sheet, infinite if it has none."""
    found = []
    w = np.linspace(0, 1, SAMPLES_PER_CHORD + 1)[:-1, None, None]
    for edge in graph.edges:
        if sheet in edge.sheets:
            found.append(((1 - w) * edge.points[:-1] + w * edge.points[1:]).reshape(-1, 3))
    for piece in graph.rim_pieces:
        rim = graph.shell.rims[piece.rim]
        if sheet in rim.sheets:
            found.append(rim.curve(np.linspace(*piece.span, 4 * RIM_SAMPLES)))
    return cKDTree(np.concatenate(found)).query(points)[0] if found and len(points) else np.full(len(points), np.inf)


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
    for _ in range(SECTION_ROUNDS):
        between = good + SECTIONS[:, None] * (bad - good)
        shallow = np.append(~graph.are_deep(sheet.carrier(*between.T)), True)
        k = int(shallow.argmax())
        good, bad = (between[k - 1] if k else good), (between[k] if k < len(between) else bad)
    nearest = graph.nearest_sheet(sheet.carrier(*bad))
    if nearest is None:
        return None
    other, uv = nearest
    y = np.concatenate([good, uv])
    point = sheet.carrier(*good)
    axis = np.cross(sheet.outward(good[None])[0], shell.sheets[other].outward(uv[None])[0])
    length = float(np.linalg.norm(axis))
    if length < TANGENT_SINE:
        return None
    found = meet_pair(sheet, shell.sheets[other], y[None], point[None], axis[None] / length)
    if not found.converged[0] or not is_good(graph, (number, other), found.parameters, found.points)[0]:
        return None
    return (number, other), found.parameters[0], found.points[0]
