"""The largest spheres that touch a surface of the catalogue from either side.

Their radius is the maximum over the cell of the distance to a dense sample of the surface, by a search along coordinate
directions and diagonals (compass search; Kolda, Lewis and Torczon, "Optimization by direct search", 2003) from the deepest points
of a grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from tpmscad import fields, surfaces
from tpmscad._typing import Array
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set

SAMPLES_PER_CELL = 48
"""Crossings of the surface with a grid of this spacing are its sample; spheres come out too large by 1e-3 at most."""

SAMPLES_PER_PATCH = 32
"""Samples along each parameter of an exact patch."""

GRID_PER_CELL = 20
N_STARTS = 6
"""Grid whose deepest points on either side are the starts of the search, and the number of starts on each side."""

MIN_SEARCH_STEP_CELLS = 1e-5
"""Step at which the search ends: a hundredth of the error of the sample."""

DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
"""Directions of the search: axes, face diagonals and space diagonals."""


@dataclass(frozen=True, slots=True)
class PoreRadii:
    """Greatest distance from the surface, in cells, of points where its function is below, and above its values there."""

    minus: float
    plus: float


@lru_cache(maxsize=64)
def find_pore_radii(name: str, reference: str) -> PoreRadii:
    """The greatest distances from a surface on either side of it, in cells."""
    exact = reference == "minimal" and surfaces.find_surface(name).primitives == "exact"
    points = _sample_exact_surface(name) if exact else _sample_level(name, reference, 0.0)
    return PoreRadii(*(_deepest(name, reference, points, (0.0, 0.0), sign) for sign in (-1, 1)))


@lru_cache(maxsize=64)
def find_level_pore_radii(name: str, reference: str, levels: tuple[float, float]) -> PoreRadii:
    """The greatest distances from the two levels that bound a wall on the void side of each, in cells."""
    points = np.concatenate([_sample_level(name, reference, level) for level in levels])
    return PoreRadii(*(_deepest(name, reference, points, levels, sign) for sign in (-1, 1)))


def _sample_exact_surface(name: str) -> Array:
    """Points (n, 3) of the exact minimal surface in one cell."""
    t = np.linspace(0.0, 1.0, SAMPLES_PER_PATCH)
    patch, symmetry = surfaces.primitive_patch(name, "minimal"), surfaces.patch_symmetry(name)
    points = patch.jet(t[:, None], t[None, :]).position.reshape(-1, 3)
    return np.asarray(np.mod(symmetry.cell_motions[:, None].apply(points).reshape(-1, 3), 1.0))


def _sample_level(name: str, reference: str, level: float) -> Array:
    """Points (n, 3) of a level of the surface's function in one cell, near its crossings with the lines of a grid."""
    phi = fields.tpms(name, 1.0, reference=reference)
    t = (np.arange(SAMPLES_PER_CELL) + 0.5) / SAMPLES_PER_CELL
    values = phi.on_grid(t, t, t) - level
    parts = []
    for axis in range(3):
        after = np.roll(values, -1, axis)
        at = np.argwhere((values < 0) != (after < 0))
        v, w = values[tuple(at.T)], after[tuple(at.T)]
        points = (at + 0.5) / SAMPLES_PER_CELL
        points[:, axis] += v / (v - w) / SAMPLES_PER_CELL
        parts.append(points)
    points = np.concatenate(parts)
    longest = np.full(len(points), 1.0 / SAMPLES_PER_CELL)
    points = project_to_level_set(phi - level, points, np.zeros(points.shape, bool), longest)
    return np.asarray(np.mod(points, 1.0))


def _deepest(name: str, reference: str, points: Array, levels: tuple[float, float], sign: int) -> float:
    """The greatest distance from points (n, 3) of one cell where the function is below (-1) or above (+1) the levels."""
    phi = fields.tpms(name, 1.0, reference=reference)
    tree = cKDTree(np.minimum(points, np.nextafter(1.0, 0.0)), boxsize=1.0)

    def depth(x: Array) -> Array:
        value = phi(x)
        outside = value < levels[0] if sign < 0 else value > levels[1]
        wrapped = np.minimum(np.mod(x, 1.0), np.nextafter(1.0, 0.0))
        return np.where(outside, tree.query(wrapped)[0], -1.0)

    t = np.arange(GRID_PER_CELL) / GRID_PER_CELL
    grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    depths = depth(grid)
    chosen = np.argsort(-depths, kind="stable")[:N_STARTS]
    best, depths, step = grid[chosen], depths[chosen], 0.5 / GRID_PER_CELL
    while step > MIN_SEARCH_STEP_CELLS:
        trial = best[:, None] + step * DIRECTIONS
        values = depth(trial.reshape(-1, 3)).reshape(trial.shape[:2])
        way = values.argmax(axis=1)
        rows = np.arange(len(best))
        better = values[rows, way] > depths
        best = np.where(better[:, None], trial[rows, way], best)
        depths = np.where(better, values[rows, way], depths)
        if not better.any():
            step /= 2
    return float(depths.max())
