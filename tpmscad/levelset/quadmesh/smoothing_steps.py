"""Compiled steps of a smoothing sweep: normals, moves along the surface, and positions on the grid that ends round-off."""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.short_vectors import difference_of, dot_as_einsum, norm_of
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR

MAX_MOVE_FRACTION = 0.25
"""Largest step of a vertex, as a fraction of its leaf and of its shortest side."""

MIN_BOX_SIDE_RATIO = 0.3
"""Least ratio of the two sides in a face of the box at a vertex. Where the level set cuts off a small corner of the box, the
large polygons beside it would otherwise pull the vertex out of the box."""


@njit_cached
def set_normals(normals: Array, ids: IntArray, gradient: Array) -> None:  # pragma: no cover
    """Set the normals (V, 3) of vertices `ids` (n,) to the directions of the gradients (n, 3)."""
    for k in range(len(ids)):
        size = max(norm_of(gradient[k]), MIN_DIVISOR)
        for x in range(3):
            normals[ids[k], x] = gradient[k, x] / size


@njit_cached
def step_along_surface(
    old: Array,
    target: Array,
    shortest: Array,
    ids: IntArray,
    value: Array,
    gradient: Array,
    fixed: BoolArray,
    max_step: Array,
    lo: Array,
    hi: Array,
    new: Array,
    is_out: BoolArray,
) -> None:  # pragma: no cover
    """New positions (n, 3): a tangential step towards the target and one Newton step towards the level set.

    Vertices `ids` (n,) move from `old` (n, 3), with the field's value and gradient there, in the coordinates that are not fixed.
    `target` (V, 3) and `shortest` (V,) are of all vertices. `is_out` (n,) becomes whether the position is outside the box.
    """
    free, normal, move, newton = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(ids)):
        for x in range(3):
            free[x] = 0.0 if fixed[k, x] else gradient[k, x]
            move[x] = 0.0 if fixed[k, x] else target[ids[k], x] - old[k, x]
        size = max(norm_of(free), MIN_DIVISOR)
        for x in range(3):
            normal[x] = free[x] / size
        along = dot_as_einsum(move, normal)
        slope = -(value[k] / max(dot_as_einsum(free, free), MIN_DIVISOR))
        for x in range(3):
            move[x] -= along * normal[x]
            newton[x] = slope * free[x]
        longest = min(max_step[k], MAX_MOVE_FRACTION * shortest[ids[k]])
        shorten_move = min(1.0, longest / max(norm_of(move), MIN_DIVISOR))
        shorten_newton = min(1.0, max_step[k] / max(norm_of(newton), MIN_DIVISOR))
        is_out[k] = False
        for x in range(3):
            new[k, x] = old[k, x] + move[x] * shorten_move + shorten_newton * newton[x]
            is_out[k] |= (new[k, x] < lo[x]) | (new[k, x] > hi[x])


@njit_cached
def place_vertices(
    vertices: Array,
    ids: IntArray,
    new: Array,
    fixed: BoolArray,
    lo: Array,
    grid: Array,
    on_face: IntArray,
    neighbours: IntArray,
) -> None:  # pragma: no cover
    """Move vertices `ids` (n,) to the positions `new` (n, 3), free coordinates rounded to multiples of `grid` (3,) from `lo`.

    Vertices `on_face` (m,) of the box stay where the move would leave their sides to `neighbours` (m, 2) too unequal.
    """
    before, ratio_before = np.empty((len(on_face), 3)), np.empty(len(on_face))
    for k in range(len(on_face)):
        for x in range(3):
            before[k, x] = vertices[on_face[k], x]
        ratio_before[k] = _side_length_ratio(vertices, on_face[k], neighbours[k])
    for k in range(len(ids)):
        for x in range(3):
            rounded = lo[x] + grid[x] * np.rint((new[k, x] - lo[x]) / grid[x])
            vertices[ids[k], x] = new[k, x] if fixed[k, x] else rounded
    is_reverted = np.zeros(len(on_face), np.bool_)
    for k in range(len(on_face)):
        ratio = _side_length_ratio(vertices, on_face[k], neighbours[k])
        is_reverted[k] = (ratio < MIN_BOX_SIDE_RATIO) & (ratio < ratio_before[k])
    for k in range(len(on_face)):
        if is_reverted[k]:
            for x in range(3):
                vertices[on_face[k], x] = before[k, x]


@njit_cached
def _side_length_ratio(vertices: Array, vertex: int, neighbours: IntArray) -> float:  # pragma: no cover
    """Ratio, at most 1, of the distances from a vertex to its two neighbours (2,)."""
    one = norm_of(difference_of(vertices, vertex, neighbours[0]))
    other = norm_of(difference_of(vertices, vertex, neighbours[1]))
    return min(one, other) / max(max(one, other), MIN_DIVISOR)
