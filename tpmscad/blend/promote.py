"""Weights with more freedom and the same values: a line weight made a volume weight, a volume weight's knots halved."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from tpmscad.blend.weight import Weight
from tpmscad.blend.weights_fit import Zones, layout, local_lspia
from tpmscad.blend.weights_line import LineWeight
from tpmscad.blend.weights_volume import Knots, Triple, VolumeWeight, contract, touched, uniform_knots
from tpmscad.splines.knots import insert

SAMPLES_PER_COEFFICIENT = 2.0
"""Samples per knot span of a promoted weight: at one, weights were seen to build bridges one sample wide."""

FIT_STEPS = 60


def freer(weight: Weight, coarse: Zones, fine: Zones) -> Weight | None:
    """A weight of the same values with more free coefficients, or None where there are as many as samples."""
    if isinstance(weight, LineWeight):
        return promoted(weight, coarse, fine)
    if not isinstance(weight, VolumeWeight):
        return None
    return halved(weight, coarse, fine)


def halved(weight: VolumeWeight, coarse: Zones, fine: Zones) -> VolumeWeight | None:
    """The same weight on knots twice as fine along every axis where a span is wider than a sample; None if none is."""
    knots, maps = [], []
    for axis, (t, degree) in enumerate(zip(weight.knots, weight.degree, strict=True)):
        matrix, refined = np.eye(len(t) - degree - 1), t
        inner = t[degree:-degree]
        if float(np.median(np.diff(np.unique(inner)))) > 1.2 * coarse.grid.spacing[axis]:
            for middle in (inner[:-1] + inner[1:]) / 2:
                if middle not in inner:
                    matrix, refined = insert(matrix, refined, degree, float(middle))
        knots.append(refined)
        maps.append(csr_array(matrix))
    if all(len(a) == len(b) for a, b in zip(knots, weight.knots, strict=True)):
        return None
    closer: Knots = (knots[0], knots[1], knots[2])
    met = [touched(zone, fine.grid.axes, closer, weight.degree) for zone in (fine.zero, fine.one)]
    low, high = (contract(np.broadcast_to(b, weight.free.shape), maps) for b in (weight.low, weight.high))
    return VolumeWeight(contract(weight.coefficients, maps), closer, weight.degree, ~(met[0] | met[1]), low, high)


def promoted(weight: LineWeight, coarse: Zones, fine: Zones) -> VolumeWeight:
    """The same weight with coefficients along all three axes: exact along x, y or z, else fitted to the line weight's values."""
    grid = coarse.grid
    spacing = grid.spacing * SAMPLES_PER_COEFFICIENT
    if weight.axis is None:
        count = tuple(max(int(e / s), 4) + 3 for e, s in zip(grid.extent, spacing, strict=True))
        shape = layout(fine, (count[0], count[1], count[2]), (3, 3, 3))
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
    low, high = (
        np.broadcast_to(np.broadcast_to(b, weight.free.shape).reshape(shape3), lengths)
        for b in (weight.low, weight.high)
    )
    all_knots: Knots = (knots[0], knots[1], knots[2])
    all_degrees: Triple = (degree[0], degree[1], degree[2])
    return VolumeWeight(coefficients, all_knots, all_degrees, free, low, high)
