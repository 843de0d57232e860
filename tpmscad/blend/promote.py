"""A line weight turned into a volume weight of the same values, when one dimension has too little freedom for a repair."""

from __future__ import annotations

import numpy as np

from tpmscad.blend.grid import Field, Grid
from tpmscad.blend.weights_fit import layout, local_lspia
from tpmscad.blend.weights_line import LineWeight
from tpmscad.blend.weights_volume import Knots, Triple, VolumeWeight, uniform_knots

SAMPLES_PER_COEFFICIENT = 2.0
"""Samples per knot span of a promoted weight: at one, weights were seen to build bridges one sample wide."""

FIT_STEPS = 60


def promoted(weight: LineWeight, grid: Grid, first: Field, second: Field, blending: Field) -> VolumeWeight:
    """The same weight with coefficients along all three axes: exact along x, y or z, else fitted to the line weight's values."""
    spacing = grid.spacing * SAMPLES_PER_COEFFICIENT
    if weight.axis is None:
        count = tuple(max(int(e / s), 4) + 3 for e, s in zip(grid.extent, spacing, strict=True))
        shape = layout(grid, first, second, blending, (count[0], count[1], count[2]), (3, 3, 3))
        x, y, z = ((axis[:-1] + axis[1:]) / 2 for axis in grid.axes)
        values = weight.on_grid(x, y, z)
        return local_lspia(shape, (x, y, z), values, np.ones(values.shape, bool), FIT_STEPS)
    knots, degree = [], [3, 3, 3]
    degree[weight.axis] = weight.degree
    for axis in range(3):
        if axis == weight.axis:
            knots.append(weight.knots)
        else:
            spans = max(round(grid.extent[axis] / spacing[axis]), 4)
            knots.append(uniform_knots(grid.low[axis], grid.high[axis], spans + 3, 3))
    lengths = [len(t) - p - 1 for t, p in zip(knots, degree, strict=True)]
    shape3 = [1, 1, 1]
    shape3[weight.axis] = -1
    coefficients = np.broadcast_to(weight.coefficients.reshape(shape3), lengths).copy()
    free = np.broadcast_to(weight.free.reshape(shape3), lengths).copy()
    all_knots: Knots = (knots[0], knots[1], knots[2])
    all_degrees: Triple = (degree[0], degree[1], degree[2])
    return VolumeWeight(coefficients, all_knots, all_degrees, free)
