"""How far a fitted piece of a mirror surface is from the nodal surface at its offset, in both directions.

Neither direction uses the chart the piece was fitted over. From the patch: its points' distances by Newton's method on the
formula. To the patch: points of the level set on segments between two edges of the tetrahedron, offset along the gradient, and
their feet on the patch, found from the nearest of its samples. A piece that is folded is infinitely far.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tpmscad.patches.deviation import Deviation, around_peaks, feet, mean_square
from tpmscad.splines.bspline import Array, Surface
from tpmscad.surfaces import MirrorSymmetry
from tpmscad.surfaces.waves import NoFoot

SAMPLES = 41
"""Samples along each parameter, and along each edge of the tetrahedron."""

FOLDED = Deviation(np.inf, np.inf, np.inf, np.inf)


def mirror_deviation(symmetry: MirrorSymmetry, patch: Surface, offset: float) -> Deviation:
    """The two-way distance between the patch and the level set's piece at the normal distance `offset`, in cells."""
    grid = (1 - np.cos(np.pi * np.linspace(0.0, 1.0, SAMPLES))) / 2  # errors' lobes are narrow near borders
    try:
        _, normal, _ = symmetry.waves.foot(patch.grid(grid, grid))
    except NoFoot:
        return FOLDED
    facing = np.einsum("ijk,ijk->ij", patch.normal(grid[:, None], grid), normal)
    if facing.min() <= 0 <= facing.max():
        return FOLDED

    def to_reference(u: Array, v: Array) -> Array:
        return np.abs(symmetry.waves.foot(patch(u, v))[0] - offset)

    samples = cKDTree(patch.grid(grid, grid).reshape(-1, 3))

    def from_reference(s: Array, t: Array) -> Array:
        points, _ = symmetry.on_segments(s, t)
        gradient = symmetry.waves.gradient(points)
        points = points + offset * gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)
        i, j = np.unravel_index(samples.query(points)[1], (SAMPLES, SAMPLES))
        return feet(patch, points, grid[i], grid[j])[0]

    u, v = (g.ravel() for g in np.meshgrid(grid, grid, indexing="ij"))
    largest, squares = [], []
    for measure in (to_reference, from_reference):
        distances = measure(u, v).reshape(SAMPLES, SAMPLES)
        finer = measure(*around_peaks(distances, grid, grid))
        largest.append(float(max(distances.max(), finer.max())))
        squares.append(mean_square(distances))
    return Deviation(max(largest), float(np.sqrt(np.mean(squares))), largest[0], largest[1])
