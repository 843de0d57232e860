"""Shifts of a lattice that keep the corners of its patches clear of the faces of a body, so that no sliver arises.

Where a corner of a patch just crosses a face of the body, the trimmed patch gets an edge as short as the corner is deep, and a
mesh its worst elements. The depth of every corner follows from the distances of points from surfaces, without any intersection:
dozens of shifts within the tolerance are compared before the first is carried out.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.trimming.intersect.arrangement import Operands

N_DIRECTIONS = 24
"""Directions of the shifts that are compared, spread evenly over the sphere."""

SHIFT_FRACTIONS = (0.2, 0.4, 0.7, 1.0)
"""Lengths of the shifts that are compared, in parts of the largest one allowed."""

MIN_GAIN = 2.0
"""Factor by which the best shift must improve the clearance if none reaches the one asked for."""


def find_clear_shift(operands: Operands, clearance: float, max_shift: float) -> tuple[Array, float, float]:
    """The shortest of the shifts that gives the clearance, else the best one; the clearances without and with it.

    Zeros (3,) if the lattice is clear as it stands, or if no shift gains `MIN_GAIN`. Corners that lie in a face of the body
    within the vertex tolerance are no slivers as long as they stay there.
    """
    points, surface = _corners_near_surfaces(operands)
    surfaces = operands.body.surfaces.take(surface)

    def distances(shift: Array) -> Array:
        return np.abs(surfaces.value((points + shift)[:, None])[:, 0])

    standing = distances(np.zeros(3))
    before = float(standing[standing >= operands.snap].min(initial=np.inf))
    best, after = np.zeros(3), before
    if before >= clearance or max_shift <= 0:
        return best, before, after
    for length in max_shift * np.array(SHIFT_FRACTIONS):
        for direction in _spread_directions(N_DIRECTIONS):
            reached = float(distances(length * direction).min())
            if reached > after:
                best, after = length * direction, reached
        if after >= clearance:
            break
    return (best, before, after) if after >= min(clearance, MIN_GAIN * before) else (np.zeros(3), before, before)


def _corners_near_surfaces(o: Operands) -> tuple[Array, IntArray]:
    """Corners of patches (n, 3) and surfaces of the body (n,) that these patches may intersect, each pair once."""
    edges = o.lattice.edges
    corners = edges.start[o.sides.edge], edges.end[o.sides.edge]
    face, surface = np.nonzero(o.candidates)
    pairs = [np.column_stack([ends[face, side], surface]) for ends in corners for side in range(4)]
    vertex, surface = np.unique(np.concatenate(pairs), axis=0).T
    return o.lattice.vertices[vertex], surface


def _spread_directions(count: int) -> Array:
    """Unit vectors (count, 3) on a spiral from pole to pole (a Fibonacci lattice)."""
    i = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * i / count, np.pi * (1.0 + 5.0**0.5) * i
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
