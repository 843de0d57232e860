"""Lattices of a porosity and a pore size, measured on the solid's own patches.

    python -m benchmarks.pore_size [SURFACE ...]

The porosity is that of the volume of 2 x 2 x 2 cells. The largest sphere is sought on a grid of the middle cell's size, in the
void, as the greatest distance to samples of the boundary patches, by a kd-tree; the solution uses nothing of it.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from scipy.spatial import cKDTree

import tpmscad
from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import spline_faces
from tpmscad.requests.lattice_request import read_lattice_request

SURFACES = ("gyroid", "diamond", "schwarz_p", "lidinoid", "fischer_koch_s", "split_p", "octo")
POROSITY, PORE_SIZE = 0.7, 0.6
SAMPLES_PER_SIDE = 9
GRID_PER_CELL = 40
REFINEMENTS, N_DEEPEST = 6, 30


def sample_boundary(model: tpmscad.Model) -> Array:
    """Points (n, 3) on the carriers of the spline faces; of faces cut by the box they may lie outside it."""
    t = np.linspace(0.0, 1.0, SAMPLES_PER_SIDE)
    parts = []
    for own, carrier in spline_faces(model.patches):
        (u0, u1), (v0, v1) = carrier.domain
        points = carrier.grid(u0 + (u1 - u0) * t, v0 + (v1 - v0) * t).reshape(-1, 3)
        parts.append(model.patches.faces.motion[own, None].apply(points).reshape(-1, 3))
    return np.concatenate(parts)


def find_depth(tree: cKDTree, points: Array, step: float) -> float:
    """The greatest distance from the samples near points (n, 3) of a grid of this step, on finer and finer grids."""
    depth = tree.query(points)[0]
    around = np.stack(np.meshgrid(*3 * [np.linspace(-1.0, 1.0, 5)], indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(REFINEMENTS):
        points = (points[np.argsort(-depth)[:N_DEEPEST]][:, None] + step * around).reshape(-1, 3)
        depth, step = tree.query(points)[0], step / 2
    return float(depth.max())


def main(names: list[str]) -> None:
    """Print the table."""
    print(f"{'surface':15}   cell   porosity   largest sphere (-, +)   of the request   seconds")
    for name in names or SURFACES:
        start = time.perf_counter()
        model = tpmscad.lattice(
            name, porosity=POROSITY, pore_size=PORE_SIZE, cells=2, phase=(0.0, 0.0, 0.0), loose="keep"
        )
        request = read_lattice_request(name, porosity=POROSITY, pore_size=PORE_SIZE)
        cell = request.cell[0]
        seconds = time.perf_counter() - start
        tree = cKDTree(sample_boundary(model))
        t = (0.5 + (np.arange(GRID_PER_CELL) + 0.5) / GRID_PER_CELL) * cell
        grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
        phi = fields.tpms(name, cell)
        if request.levels is None:
            distance = fields.normal_distance(phi)(grid)
            below, above = distance < request.offset[0], distance > request.offset[1]
        else:
            below, above = phi(grid) < request.levels[0], phi(grid) > request.levels[1]
        diameters = [2 * find_depth(tree, grid[side], cell / GRID_PER_CELL) for side in (below, above)]
        porosity = 1 - model.volume / (2 * cell) ** 3
        print(
            f"{name:15} {cell:7.4f} {porosity:9.6f} {diameters[0]:12.4f} {diameters[1]:10.4f} "
            f"{max(diameters) / PORE_SIZE:14.4f} {seconds:12.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
