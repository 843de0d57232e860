"""Initial three-dimensional weights: Algorithm 1 with Local-LSPIA under fixed coefficients (porous blending, eqs 14-17).

The distances of eq. 15 come from Euclidean distance transforms of the cell grid, which give what the paper's KD-trees give.

Weights with more freedom and the same values: a line weight made a volume weight, a volume weight's knots halved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from tpmscad._typing import Array, BoolArray
from tpmscad.blending.weights.line_weight import MIN_FREE_COEFFICIENTS, LineWeight
from tpmscad.blending.weights.volume_weight import (
    IntTriple,
    Knots,
    VolumeWeight,
    apply_along_axes,
    find_touched_supports,
    make_clamped_uniform_knots,
)
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.errors import InvalidRequest
from tpmscad.fields.sample_grid import SampleGrid
from tpmscad.splines.knots import insert_knot

MAX_COEFFICIENTS = 4_000_000
"""Where refinement gives up: 32 MB of coefficients, far above what any blend was seen to need."""

INITIAL_LSPIA_STEPS = 20
"""Iterations of the initial fit: the rms error is then within a few percent of the constrained least-squares fit's."""


@dataclass(frozen=True, slots=True, eq=False)
class StageMasks:
    """What the samples of a grid are to a stage: in its first region or its second, outside where it mixes, or inside that."""

    grid: SampleGrid
    first_region: BoolArray
    second_region: BoolArray
    inside: BoolArray


def fit_volume_weight(
    coarse: StageMasks,
    fine: StageMasks,
    count: IntTriple,
    degree: IntTriple = (3, 3, 3),
    *,
    refine: bool = True,
    steps: int = INITIAL_LSPIA_STEPS,
) -> VolumeWeight:
    """The initial weight of a blending region of any shape: 0 in the first region, 1 in the second.

    Data points are the cells of the coarse grid; the samples of the fine one decide what a support meets. Knots are uniform over
    the grid's box and halved where a support meets both regions, or everywhere if none is free enough. Raises InvalidRequest if a
    region does not touch the blending region, or (refine=False) if knots are too coarse.
    """
    shape = choose_knots(fine, count, degree, refine=refine)
    values, used = assign_target_values(coarse)
    centres = tuple((axis[:-1] + axis[1:]) / 2 for axis in coarse.grid.axes)
    return fit_local_lspia(shape, (centres[0], centres[1], centres[2]), values, used, steps)


def choose_knots(zones: StageMasks, count: IntTriple, degree: IntTriple, *, refine: bool = True) -> VolumeWeight:
    """Knots and fixed coefficients (free ones at 1/2)."""
    knots: Knots = tuple(  # type: ignore[assignment]
        make_clamped_uniform_knots(a, b, n, p)
        for a, b, n, p in zip(zones.grid.low, zones.grid.high, count, degree, strict=True)
    )
    while True:
        zero, one = (
            find_touched_supports(zone, zones.grid.axes, knots, degree)
            for zone in (zones.first_region, zones.second_region)
        )
        both, free = zero & one, ~(zero | one)
        if not both.any() and free.sum() >= MIN_FREE_COEFFICIENTS:
            return VolumeWeight(np.where(free, 0.5, one.astype(float)), knots, degree, free)
        if not refine or 8 * free.size > MAX_COEFFICIENTS:
            why = f"{int(both.sum())} supports meet both regions" if both.any() else f"only {int(free.sum())} are free"
            raise InvalidRequest(
                f"{' x '.join(map(str, zero.shape))} weight coefficients are too few: {why}; about "
                f"{' x '.join(str(2 * n - p) for n, p in zip(zero.shape, degree, strict=True))} are needed, or a wider "
                "blending region"
            )
        knots = _refine_under_supports(knots, degree, both if both.any() else np.ones(both.shape, bool))


def _refine_under_supports(knots: Knots, degree: IntTriple, where: BoolArray) -> Knots:
    """A knot in the middle of every span under the supports marked."""
    refined = []
    for axis, (t, p) in enumerate(zip(knots, degree, strict=True)):
        marked = np.flatnonzero(where.any(axis=tuple(k for k in range(3) if k != axis)))
        spans = np.zeros(len(t) - 1, bool)
        for i in marked:
            spans[i : i + p + 1] = True
        spans &= np.diff(t) > 0
        refined.append(np.sort(np.concatenate([t, ((t[:-1] + t[1:]) / 2)[spans]])))
    return refined[0], refined[1], refined[2]


def assign_target_values(zones: StageMasks) -> tuple[Array, BoolArray]:
    """Algorithm 1: the value v_p of each cell (eq. 15) and which cells are data points, both (nx-1, ny-1, nz-1)."""
    inside, grid = zones.inside, zones.grid
    some, every = _reduce_cell_corners(inside, np.logical_or), _reduce_cell_corners(inside, np.logical_and)
    bounds = [
        some & ~every & _reduce_cell_corners(side, np.logical_or) for side in (zones.first_region, zones.second_region)
    ]
    bounds[1] &= ~bounds[0]
    for name, bound in zip(("first", "second"), bounds, strict=True):
        if not bound.any():
            raise InvalidRequest(
                f"the {name} region does not touch the blending region at this resolution {grid.shape}"
            )
    near, far = (distance_transform_edt(~bound, sampling=grid.spacing) for bound in bounds)
    values = near / np.where(near + far > 0, near + far, 1.0)
    return values, every | bounds[0] | bounds[1]


def _reduce_cell_corners(mask: BoolArray, join: np.ufunc) -> BoolArray:
    """Any or all of the eight corners of each cell."""
    for axis in range(3):
        mask = join(np.take(mask, range(mask.shape[axis] - 1), axis), np.take(mask, range(1, mask.shape[axis]), axis))
    return mask


def fit_local_lspia(
    weight: VolumeWeight, axes: tuple[Array, Array, Array], values: Array, used: BoolArray, steps: int
) -> VolumeWeight:
    """The weight whose free coefficients approach the least-squares fit of values (used ones) on the grid of the axes (eq. 17).

    C_i += sum_p B_i(p) (v_p - w(p)) / sum_p B_i(p) for free i: LSPIA's step, which converges because the matrix of such a step
    has its eigenvalues in (0, 1].
    """
    rows = [
        csr_array(BSpline.design_matrix(t, knots, degree))
        for t, knots, degree in zip(axes, weight.knots, weight.degree, strict=True)
    ]
    back = [csr_array(matrix.T) for matrix in rows]
    mass = apply_along_axes(used.astype(float), back)
    moves = weight.free & (mass > 0)
    step = np.where(moves, 1.0 / np.where(moves, mass, 1.0), 0.0)
    coefficients = weight.coefficients
    for _ in range(steps):
        residual = np.where(used, values - apply_along_axes(coefficients, rows), 0.0)
        coefficients = coefficients + step * apply_along_axes(residual, back)
    return weight.moved(np.clip(coefficients, 0.0, 1.0))


SAMPLES_PER_REFINED_COEFFICIENT = 2.0
"""Samples per knot span of a promoted weight: at one, weights were seen to build bridges one sample wide."""

REFINEMENT_LSPIA_STEPS = 60


def refine_weight(weight: SplineWeight, coarse: StageMasks, fine: StageMasks) -> SplineWeight | None:
    """A weight of the same values with more free coefficients, or None where there are as many as samples."""
    if isinstance(weight, LineWeight):
        return convert_line_to_volume(weight, coarse, fine)
    if not isinstance(weight, VolumeWeight):
        return None
    return refine_knots(weight, coarse, fine)


def refine_knots(weight: VolumeWeight, coarse: StageMasks, fine: StageMasks) -> VolumeWeight | None:
    """The same weight on knots twice as fine along every axis where a span is wider than a sample; None if none is."""
    knots, maps = [], []
    for axis, (t, degree) in enumerate(zip(weight.knots, weight.degree, strict=True)):
        matrix, refined = np.eye(len(t) - degree - 1), t
        inner = t[degree:-degree]
        if float(np.median(np.diff(np.unique(inner)))) > 1.2 * coarse.grid.spacing[axis]:
            for middle in (inner[:-1] + inner[1:]) / 2:
                if middle not in inner:
                    matrix, refined = insert_knot(matrix, refined, degree, float(middle))
        knots.append(refined)
        maps.append(csr_array(matrix))
    if all(len(a) == len(b) for a, b in zip(knots, weight.knots, strict=True)):
        return None
    closer: Knots = (knots[0], knots[1], knots[2])
    met = [
        find_touched_supports(zone, fine.grid.axes, closer, weight.degree)
        for zone in (fine.first_region, fine.second_region)
    ]
    low, high = (apply_along_axes(np.broadcast_to(b, weight.free.shape), maps) for b in (weight.low, weight.high))
    return VolumeWeight(
        apply_along_axes(weight.coefficients, maps), closer, weight.degree, ~(met[0] | met[1]), low, high
    )


def convert_line_to_volume(weight: LineWeight, coarse: StageMasks, fine: StageMasks) -> VolumeWeight:
    """The same weight with coefficients along all three axes: exact along x, y or z, else fitted to the line weight's values."""
    grid = coarse.grid
    spacing = grid.spacing * SAMPLES_PER_REFINED_COEFFICIENT
    if weight.axis is None:
        count = tuple(max(int(e / s), 4) + 3 for e, s in zip(grid.extent, spacing, strict=True))
        shape = choose_knots(fine, (count[0], count[1], count[2]), (3, 3, 3))
        x, y, z = ((axis[:-1] + axis[1:]) / 2 for axis in grid.axes)
        values = weight.on_grid(x, y, z)
        return fit_local_lspia(shape, (x, y, z), values, np.ones(values.shape, bool), REFINEMENT_LSPIA_STEPS)
    knots, degree = [], [3, 3, 3]
    degree[weight.axis] = weight.degree
    for axis in range(3):
        if axis == weight.axis:
            knots.append(weight.knots)
        else:
            spans = max(round(grid.extent[axis] / spacing[axis]), 4)
            knots.append(make_clamped_uniform_knots(grid.low[axis], grid.high[axis], spans + 3, 3))
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
    all_degrees: IntTriple = (degree[0], degree[1], degree[2])
    return VolumeWeight(coefficients, all_knots, all_degrees, free, low, high)
