"""Points of edges that no vertex leads to, between nodes of sheets next to each other of which one is deep enough."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tpmscad._typing import Array
from tpmscad.erosion.edge_graph import EdgeGraph, SheetGrid, TracedEdge
from tpmscad.erosion.rim_cuts import RIM_SAMPLES
from tpmscad.erosion.tracing import CHORD_SAG, Pair, find_good_points, find_tangent

SECTIONS, SECTION_ROUNDS = np.arange(1, 16) / 16, 6
"""Places between two nodes at which depth changes are sought at once, and how often: 15 points take little longer than one."""


def find_seeds(graph: EdgeGraph) -> Iterator[tuple[Pair, Array]]:
    """Points of edges that were not traced: two sheets, and a row (10,) as of a path."""
    for number, sheet in enumerate(graph.shell.sheets):
        good, bad = _find_changes(graph.grid(number))
        ends = sheet.carrier(*good.T), sheet.carrier(*bad.T)
        middle, cell = 0.5 * (ends[0] + ends[1]), np.linalg.norm(ends[1] - ends[0], axis=1)
        for k in range(len(cell)):
            if _distance_from_edges(graph, number, middle[k]) > 1.5 * cell[k]:
                seed = _refine_seed(graph, number, good[k], bad[k])
                if seed is not None and not any(_passes_through(e, seed[0], seed[1][:3]) for e in graph.edges):
                    yield seed


def _find_changes(grid: SheetGrid) -> tuple[Array, Array]:
    """(u, v) (n, 2) of nodes that are deep enough, and of neighbours that are not."""
    good, bad = [], []
    for axis in (0, 1):
        uv, inside, deep = (
            np.moveaxis(grid.uv, axis, 0),
            *np.moveaxis(np.array([grid.inside, grid.deep]), 1 + axis, 1),
        )
        changes = inside[1:] & inside[:-1] & (deep[1:] != deep[:-1])
        first = deep[:-1][changes][:, None]
        good.append(np.where(first, uv[:-1][changes], uv[1:][changes]))
        bad.append(np.where(first, uv[1:][changes], uv[:-1][changes]))
    return np.concatenate(good), np.concatenate(bad)


def _distance_from_edges(graph: EdgeGraph, sheet: int, point: Array) -> float:
    """Distance of a point (3,) from points along the known edges of a sheet, infinite if it has none."""
    found = [edge.path[:, :3] for edge in graph.edges if sheet in edge.sheets]
    rims = (rim for rim, *_ in graph.rim_pieces if sheet in rim.sheets)
    found += [rim.curve(np.linspace(*rim.span, 4 * RIM_SAMPLES)) for rim in rims]
    return float(np.linalg.norm(np.concatenate(found) - point, axis=1).min()) if found else np.inf


def _passes_through(edge: TracedEdge, pair: Pair, point: Array) -> bool:
    """Whether an edge is one of two sheets and passes a point of both, to the accuracy of its chords."""
    if sorted(edge.sheets) != sorted(pair):
        return False
    start, step = edge.path[:-1, :3], np.diff(edge.path[:, :3], axis=0)
    square = (step * step).sum(axis=1)
    along = np.clip(((point - start) * step).sum(axis=1) / square, 0.0, 1.0)
    gaps = np.linalg.norm(point - start - along[:, None] * step, axis=1)
    return bool((gaps <= CHORD_SAG * np.sqrt(square)).any())


def _refine_seed(graph: EdgeGraph, number: int, good: Array, bad: Array) -> tuple[Pair, Array] | None:
    """A point of an edge between a node that is deep enough and one that is not; None if another sheet has it."""
    sheet = graph.shell.sheets[number]
    for _ in range(SECTION_ROUNDS):
        between = good + SECTIONS[:, None] * (bad - good)
        shallow = np.append(~graph.are_deep(sheet.carrier(*between.T)), True)
        k = int(shallow.argmax())
        good, bad = (between[k - 1] if k else good), (between[k] if k < len(between) else bad)
    nearest = graph.nearest_sheet(sheet.carrier(*bad))
    if nearest is None:
        return None
    pair, y = (number, nearest[0]), np.concatenate([good, nearest[1]])
    tangent = find_tangent(graph, pair, y)
    if tangent is None:
        return None
    rows, found = find_good_points(graph, pair, np.concatenate([sheet.carrier(*good), y])[None], tangent[None])
    return (pair, rows[0]) if found[0] else None
