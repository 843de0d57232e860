"""Initial trivariate weights, and weights of the same values in a larger spline space.

The initial weight follows Algorithm 1 of the porous-blending paper (eqs 14 to 17): each grid cell of the blending region gets a
target value from its distances to the two interfaces (eq. 15), and Local-LSPIA fits the free coefficients to these values. The
distances come from Euclidean distance transforms of the cell grid; they equal those of the paper's KD-trees.

Where the paper states the number of coefficients, the knots are refined here whenever a support meets both regions or too few
coefficients are free. A weight that cannot be repaired can also be refined during the optimisation, which the paper does not do:
a univariate weight becomes a trivariate one, and the knots of a trivariate weight are halved.
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
)
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.sample_grid import SampleGrid
from tpmscad.splines.knots import insert_knot, uniform_knots

MAX_COEFFICIENTS = 4_000_000
"""Number of coefficients (32 MB) above which knots are not refined further."""

INITIAL_LSPIA_STEPS = 20
"""Iterations of the initial fit, after which its rms error is within a few percent of the least-squares fit's."""

REFINEMENT_LSPIA_STEPS = 60
"""Iterations of the fit of a trivariate weight to the values of a univariate one."""

SAMPLES_PER_COEFFICIENT = 2.0
"""Samples per knot span of a trivariate weight: one per sample could build bridges that are a single sample wide."""

MIN_REFINABLE_SPAN_SAMPLES = 1.2
"""Median knot span, in samples, up to which an axis is not refined any more."""

MIN_SPANS_PER_AXIS = 4


@dataclass(frozen=True, slots=True, eq=False)
class StageMasks:
    """Masks (nx, ny, nz) of a grid's samples: the first and second region of a stage without its mixing samples, and these."""

    grid: SampleGrid
    first_region: BoolArray
    second_region: BoolArray
    mixing: BoolArray


def fit_volume_weight(
    coarse: StageMasks, fine: StageMasks, count: IntTriple, degree: IntTriple = (3, 3, 3)
) -> VolumeWeight:
    """The initial weight of a blending region of any shape: 0 in the first region, 1 in the second (Algorithm 1).

    The cells of the coarse grid are the data points; the samples of the fine grid decide which supports meet a region. Raises
    InvalidRequest if a region does not touch the blending region, or if too many coefficients were needed.
    """
    start = choose_knots(fine, count, degree)
    values, is_data = assign_target_values(coarse)
    return fit_local_lspia(start, _cell_centres(coarse.grid), values, is_data, INITIAL_LSPIA_STEPS)


def choose_knots(masks: StageMasks, count: IntTriple, degree: IntTriple) -> VolumeWeight:
    """A weight with suitable knots, its fixed coefficients at 0 and 1 and its free ones at 1/2.

    The knots start clamped and uniform over the grid's box, with `count` basis functions along each axis. They are halved under
    supports that meet both regions, or everywhere if too few coefficients are free.
    """
    knots: Knots = tuple(  # type: ignore[assignment]
        uniform_knots(n - p, p, domain=(a, b))
        for a, b, n, p in zip(masks.grid.low, masks.grid.high, count, degree, strict=True)
    )
    while True:
        zero, one = (
            find_touched_supports(region, masks.grid.axes, knots, degree)
            for region in (masks.first_region, masks.second_region)
        )
        both, is_free = zero & one, ~(zero | one)
        if not both.any() and is_free.sum() >= MIN_FREE_COEFFICIENTS:
            return VolumeWeight(np.where(is_free, 0.5, one.astype(float)), knots, degree, is_free)
        if 8 * is_free.size > MAX_COEFFICIENTS:
            why = (
                f"{int(both.sum())} supports meet both regions"
                if both.any()
                else f"only {int(is_free.sum())} are free, and at least {MIN_FREE_COEFFICIENTS} must be"
            )
            raise InvalidRequest(
                f"{' x '.join(map(str, zero.shape))} weight coefficients are too few: {why}; about "
                f"{' x '.join(str(2 * n - p) for n, p in zip(zero.shape, degree, strict=True))} are needed, or a wider "
                "blending region"
            )
        knots = _refine_under_supports(knots, degree, both if both.any() else np.ones(both.shape, bool))


def _refine_under_supports(knots: Knots, degree: IntTriple, supports: BoolArray) -> Knots:
    """The knots, and the midpoint of every span under the marked supports (nu, nv, nw)."""
    refined = []
    for axis, (t, p) in enumerate(zip(knots, degree, strict=True)):
        marked = np.flatnonzero(supports.any(axis=tuple(k for k in range(3) if k != axis)))
        spans = np.zeros(len(t) - 1, bool)
        for i in marked:
            spans[i : i + p + 1] = True
        spans &= np.diff(t) > 0
        refined.append(np.sort(np.concatenate([t, ((t[:-1] + t[1:]) / 2)[spans]])))
    return refined[0], refined[1], refined[2]


def assign_target_values(masks: StageMasks) -> tuple[Array, BoolArray]:
    """Target value of each cell (eq. 15 of Algorithm 1), and the mask of the cells that are data points: (nx-1, ny-1, nz-1)."""
    mixing, grid = masks.mixing, masks.grid
    any_corner, all_corners = _reduce_corners(mixing, np.logical_or), _reduce_corners(mixing, np.logical_and)
    interfaces = [
        any_corner & ~all_corners & _reduce_corners(region, np.logical_or)
        for region in (masks.first_region, masks.second_region)
    ]
    interfaces[1] &= ~interfaces[0]
    for name, cells in zip(("first", "second"), interfaces, strict=True):
        if not cells.any():
            raise InvalidRequest(
                f"nothing of the {name} region borders on the blending region from outside at this resolution {grid.shape}: move "
                "the blending region, shrink it if it covers the region, or use a finer resolution"
            )
    first_distance, second_distance = (distance_transform_edt(~cells, sampling=grid.spacing) for cells in interfaces)
    total = first_distance + second_distance
    values = first_distance / np.where(total > 0, total, 1.0)
    return values, all_corners | interfaces[0] | interfaces[1]


def _reduce_corners(mask: BoolArray, operation: np.ufunc) -> BoolArray:
    """Logical or / and of the eight corner samples of each cell."""
    for axis in range(3):
        low, high = range(mask.shape[axis] - 1), range(1, mask.shape[axis])
        mask = operation(np.take(mask, low, axis), np.take(mask, high, axis))
    return mask


def _cell_centres(grid: SampleGrid) -> tuple[Array, Array, Array]:
    x, y, z = ((axis[:-1] + axis[1:]) / 2 for axis in grid.axes)
    return x, y, z


def fit_local_lspia(
    weight: VolumeWeight, axes: tuple[Array, Array, Array], values: Array, is_data: BoolArray, steps: int
) -> VolumeWeight:
    """The weight after some steps of Local-LSPIA towards the least-squares fit of grid values (eq. 17).

    Each step is C_i += sum_p B_i(p) (v_p - w(p)) / sum_p B_i(p) for the free coefficients i, over the data points p. It converges
    because the matrix of such a step has its eigenvalues in (0, 1].
    """
    rows = [
        csr_array(BSpline.design_matrix(t, knots, degree))
        for t, knots, degree in zip(axes, weight.knots, weight.degree, strict=True)
    ]
    transposes = [csr_array(matrix.T) for matrix in rows]
    basis_sums = apply_along_axes(is_data.astype(float), transposes)
    is_updated = weight.is_free & (basis_sums > 0)
    step = np.where(is_updated, 1.0 / np.where(is_updated, basis_sums, 1.0), 0.0)
    coefficients = weight.coefficients
    for _ in range(steps):
        residual = np.where(is_data, values - apply_along_axes(coefficients, rows), 0.0)
        coefficients = coefficients + step * apply_along_axes(residual, transposes)
    return weight.with_coefficients(np.clip(coefficients, 0.0, 1.0))


def refine_weight(weight: SplineWeight, coarse: StageMasks, fine: StageMasks) -> SplineWeight | None:
    """A weight of the same values with more free coefficients; None if there are as many as samples already."""
    if isinstance(weight, LineWeight):
        return convert_line_to_volume(weight, coarse, fine)
    return refine_knots(weight, coarse, fine) if isinstance(weight, VolumeWeight) else None


def refine_knots(weight: VolumeWeight, coarse: StageMasks, fine: StageMasks) -> VolumeWeight | None:
    """The same function on halved knot spans, by knot insertion along each axis coarser than the samples; None if none is."""
    knots, matrices = [], []
    for axis, (t, degree) in enumerate(zip(weight.knots, weight.degree, strict=True)):
        matrix, refined = np.eye(len(t) - degree - 1), t
        inner = t[degree:-degree]
        span = float(np.median(np.diff(np.unique(inner))))
        if span > MIN_REFINABLE_SPAN_SAMPLES * coarse.grid.spacing[axis]:
            for middle in (inner[:-1] + inner[1:]) / 2:
                if middle not in inner:
                    matrix, refined = insert_knot(matrix, refined, degree, float(middle))
        knots.append(refined)
        matrices.append(csr_array(matrix))
    if all(len(a) == len(b) for a, b in zip(knots, weight.knots, strict=True)):
        return None
    refined_knots: Knots = (knots[0], knots[1], knots[2])
    zero, one = (
        find_touched_supports(region, fine.grid.axes, refined_knots, weight.degree)
        for region in (fine.first_region, fine.second_region)
    )
    lower, upper = (
        apply_along_axes(np.broadcast_to(bounds, weight.is_free.shape), matrices)
        for bounds in (weight.lower_bounds, weight.upper_bounds)
    )
    coefficients = apply_along_axes(weight.coefficients, matrices)
    return VolumeWeight(coefficients, refined_knots, weight.degree, ~(zero | one), lower, upper)


def convert_line_to_volume(weight: LineWeight, coarse: StageMasks, fine: StageMasks) -> VolumeWeight:
    """A trivariate weight of the same values: the same function along x, y or z, else a fit to the univariate weight."""
    grid = coarse.grid
    spacing = grid.spacing * SAMPLES_PER_COEFFICIENT
    if weight.axis is None:
        nx, ny, nz = (max(int(e / s), MIN_SPANS_PER_AXIS) + 3 for e, s in zip(grid.extent, spacing, strict=True))
        start = choose_knots(fine, (nx, ny, nz), (3, 3, 3))
        centres = _cell_centres(grid)
        values = weight.on_grid(*centres)
        return fit_local_lspia(start, centres, values, np.ones(values.shape, bool), REFINEMENT_LSPIA_STEPS)
    knots, degree = [], [3, 3, 3]
    degree[weight.axis] = weight.degree
    for axis in range(3):
        if axis == weight.axis:
            knots.append(weight.knots)
        else:
            n_spans = max(round(grid.extent[axis] / spacing[axis]), MIN_SPANS_PER_AXIS)
            knots.append(uniform_knots(n_spans, 3, domain=(grid.low[axis], grid.high[axis])))
    shape = [len(t) - p - 1 for t, p in zip(knots, degree, strict=True)]
    along_axis = [1, 1, 1]
    along_axis[weight.axis] = -1
    coefficients = np.broadcast_to(weight.coefficients.reshape(along_axis), shape).copy()
    is_free = np.broadcast_to(weight.is_free.reshape(along_axis), shape).copy()
    lower, upper = (
        np.broadcast_to(np.broadcast_to(bounds, weight.is_free.shape).reshape(along_axis), shape)
        for bounds in (weight.lower_bounds, weight.upper_bounds)
    )
    return VolumeWeight(
        coefficients, (knots[0], knots[1], knots[2]), (degree[0], degree[1], degree[2]), is_free, lower, upper
    )
