"""An open-cell foam: struts along the edges of the Voronoi cells of random points in a box, as an exact solid.

The points are mirrored in the sides of the box, so that the sides bound the cells. Voronoi diagrams have many short edges, which
are shorter than the joints at their ends; they are contracted to nodes first. The faces are cylinders, spheres and planes.

    python examples/voronoi_foam.py
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import Voronoi

import tpmscad
from tpmscad import fields

RELAXATIONS = 5
"""Steps in which each point moves to the middle of its cell's corners, which evens out the cells (Lloyd)."""


def mirror_diagram(seeds: np.ndarray, size: float) -> Voronoi:
    """The Voronoi diagram of points (n, 3) in a box of an edge length, and of their images in its sides."""
    images = [seeds]
    for axis in range(3):
        for side in (0.0, size):
            image = seeds.copy()
            image[:, axis] = 2 * side - image[:, axis]
            images.append(image)
    return Voronoi(np.concatenate(images))


def list_cell_edges(count: int, size: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) and edges (m, 2) of the cells of relaxed random points in a box."""
    seeds = size * np.random.default_rng(seed).random((count, 3))
    for _ in range(RELAXATIONS):
        found = mirror_diagram(seeds, size)
        seeds = np.array([found.vertices[found.regions[r]].mean(axis=0) for r in found.point_region[:count]])
    found = mirror_diagram(seeds, size)
    rings = [
        ring for pair, ring in zip(found.ridge_points, found.ridge_vertices, strict=True) if min(pair) < count
    ]  # of the faces of cells in the box
    edges = np.concatenate([np.column_stack([ring, np.roll(ring, -1)]) for ring in rings])
    points = found.vertices.copy()
    for side in (0.0, size):  # exactly in the sides of the box
        points[np.abs(points - side) < 1e-9 * size] = side
    return points, np.unique(np.sort(edges, axis=1), axis=0)


def contract_short_edges(
    points: np.ndarray, edges: np.ndarray, shortest: float, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """The graph with edges shorter than a limit contracted to their middle, the shortest first; nodes in a side stay in it."""
    points = points.copy()
    while True:
        length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        if length.min() >= shortest:
            return points, edges
        kept, gone = edges[length.argmin()]
        ends = points[[kept, gone]]
        middle = ends.mean(axis=0)
        for side in (0.0, size):
            middle[(ends == side).any(axis=0)] = side
        points[kept] = middle
        edges = np.where(edges == gone, kept, edges)
        edges = np.unique(np.sort(edges[edges[:, 0] != edges[:, 1]], axis=1), axis=0)


def main(
    count: int = 30, size: float = 20.0, diameter: float = 0.6, shortest: float = 1.5, seed: int = 2
) -> dict[str, Any]:
    """Make the foam of so many cells, its STEP file and a picture; lengths in mm."""
    points, edges = contract_short_edges(*list_cell_edges(count, size, seed), shortest, size)
    foam = fields.struts(points, edges, diameter)
    model = tpmscad.solidify(foam, ((0, 0, 0), (size,) * 3), tol=0.001)
    model.export_step("voronoi_foam.step")
    model.render("voronoi_foam.png")
    found = model.certificate
    return {
        "met": found.met,
        "struts": len(foam.edges),
        "nodes": len(foam.points),
        "faces": found.n_faces,
        "betti": found.betti,
        "volume fraction": found.volume / size**3,
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
