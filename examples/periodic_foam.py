"""A foam that repeats in space: struts along the edges of a periodic Voronoi diagram, cut by its box and meshed periodically.

An edge joins node i and the image of node j in another box, that of a shift by whole boxes. Short edges are contracted to nodes,
with these shifts, so that the foam still repeats. What the sides cut off from the rest goes on in the opposite side: it is kept.

    python examples/periodic_foam.py
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from scipy.spatial import Voronoi

import tpmscad
from tpmscad import fields

RELAXATIONS = 5
"""Steps in which each point moves to the middle of its cell's corners, which evens out the cells (Lloyd)."""

SHIFTS = np.array(list(product((-1, 0, 1), repeat=3)))
"""The box, at row 13, and those around it."""


def list_periodic_edges(count: int, size: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) and edges (m, 5) of the cells of relaxed random points: two nodes, and the shift of the second, in boxes."""
    seeds, first = size * np.random.default_rng(seed).random((count, 3)), 13 * count
    for step in range(RELAXATIONS + 1):
        found = Voronoi((seeds + size * SHIFTS[:, None]).reshape(-1, 3))
        if step < RELAXATIONS:
            cells = found.point_region[first : first + count]
            seeds = np.array([found.vertices[found.regions[cell]].mean(axis=0) for cell in cells]) % size
    rings = [
        ring
        for pair, ring in zip(found.ridge_points, found.ridge_vertices, strict=True)
        if ((pair >= first) & (pair < first + count)).any()
    ]
    edges = np.concatenate([np.column_stack([ring, np.roll(ring, -1)]) for ring in rings])
    used, ends = np.unique(edges, return_inverse=True)
    corners = found.vertices[used]
    _, which, node = np.unique(np.round(corners / size % 1, 9) % 1, axis=0, return_index=True, return_inverse=True)
    points = corners[which] % size
    box = np.rint((corners - points[node.ravel()]) / size).astype(int)
    i, j = ends.reshape(-1, 2).T
    return points, sort_edges(np.column_stack([node.ravel()[i], node.ravel()[j], box[j] - box[i]]))


def sort_edges(edges: np.ndarray) -> np.ndarray:
    """Each edge once, from the node that it is given from at last."""
    both = np.stack([edges, np.column_stack([edges[:, 1], edges[:, 0], -edges[:, 2:]])], axis=1)
    return np.array(sorted({min(map(tuple, pair)) for pair in both.tolist()}))


def contract_short_edges(
    points: np.ndarray, edges: np.ndarray, shortest: float, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """The graph with edges shorter than a limit contracted to their middle, the shortest first."""
    points = points.copy()
    while True:
        length = np.linalg.norm(points[edges[:, 1]] + size * edges[:, 2:] - points[edges[:, 0]], axis=1)
        if length.min() >= shortest:
            return points, edges
        kept, gone, *rest = edges[length.argmin()].tolist()
        shift = np.array(rest)
        points[kept] = 0.5 * (points[kept] + points[gone] + size * shift)
        edges = np.delete(edges, length.argmin(), axis=0)
        start, end = edges[:, 0] == gone, edges[:, 1] == gone
        edges[start, 2:] += shift
        edges[end, 2:] -= shift
        edges[start, 0], edges[end, 1] = kept, kept
        edges = sort_edges(edges[(edges[:, 0] != edges[:, 1]) | (edges[:, 2:] != 0).any(axis=1)])


def fill_box(points: np.ndarray, edges: np.ndarray, size: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and edges (m, 2) of all images of edges that come nearer to the box than `reach`."""
    number: dict[tuple[int, ...], int] = {}
    found = []
    for i, j, *shift in edges.tolist():
        for box in np.array(list(product(range(-3, 4), repeat=3))):
            ends = np.stack([points[i] + size * box, points[j] + size * (box + shift)])
            if (ends.min(axis=0) < size + reach).all() and (ends.max(axis=0) > -reach).all():
                keys = (i, *box.tolist()), (j, *(box + shift).tolist())
                found.append([number.setdefault(key, len(number)) for key in keys])
    return np.array([points[i] + size * np.array(box) for i, *box in number]), np.array(found)


def main(
    count: int = 5, size: float = 10.0, diameter: float = 0.5, shortest: float = 1.2, seed: int = 4
) -> dict[str, Any]:
    """Make the foam of so many cells, and its mesh with equal nodes in opposite sides; lengths in mm."""
    nodes, edges = contract_short_edges(*list_periodic_edges(count, size, seed), shortest, size)
    foam = fields.struts(*fill_box(nodes, edges, size, diameter), diameter)
    model = tpmscad.solidify(foam, ((0, 0, 0), (size,) * 3), tol=0.005, loose="keep")
    mesh = model.mesh(0.6 * diameter, order=1, periodic=True)
    mesh.write("periodic_foam.msh")
    return {
        "met": model.certificate.met,
        "struts": len(edges),
        "volume fraction": model.volume / size**3,
        "elements": mesh.n_cells,
        "pairs of nodes in opposite sides": {axis: len(pairs) for axis, pairs in mesh.periodic.items()},
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
