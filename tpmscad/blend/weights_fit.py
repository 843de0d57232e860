"""Initial three-dimensional weights: Algorithm 1 with Local-LSPIA under fixed coefficients (porous blending, eqs 14-17).

The distances of eq. 15 come from Euclidean distance transforms of the cell grid, which give what the paper's KD-trees give.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from tpmscad.blend.grid import Array, Grid, Mask
from tpmscad.blend.weights_line import MIN_FREE
from tpmscad.blend.weights_volume import Knots, Triple, VolumeWeight, contract, touched, uniform_knots
from tpmscad.errors import InvalidRequest

MAX_COEFFICIENTS = 4_000_000
"""Where refinement gives up: 32 MB of coefficients, far above what any blend was seen to need."""

LSPIA_STEPS = 20
"""Iterations of the initial fit: the rms error is then within a few percent of the constrained least-squares fit's."""


@dataclass(frozen=True, slots=True, eq=False)
class Zones:
    """What the samples of a grid are to a stage: in its first region or its second, outside where it mixes, or inside that."""

    grid: Grid
    zero: Mask
    one: Mask
    inside: Mask


def volume_weight(
    coarse: Zones,
    fine: Zones,
    count: Triple,
    degree: Triple = (3, 3, 3),
    *,
    refine: bool = True,
    steps: int = LSPIA_STEPS,
) -> VolumeWeight:
    """The initial weight of a blending region of any shape: 0 in the first region, 1 in the second.

    Data points are the cells of the coarse grid; the samples of the fine one decide what a support meets. Knots are uniform over
    the grid's box and halved where a support meets both regions, or everywhere if none is free enough. Raises InvalidRequest if a
    region does not touch the blending region, or (refine=False) if knots are too coarse.
    """
    shape = layout(fine, count, degree, refine=refine)
    values, used = targets(coarse)
    centres = tuple((axis[:-1] + axis[1:]) / 2 for axis in coarse.grid.axes)
    return local_lspia(shape, (centres[0], centres[1], centres[2]), values, used, steps)


def layout(zones: Zones, count: Triple, degree: Triple, *, refine: bool = True) -> VolumeWeight:
    """Knots and fixed coefficients (free ones at 1/2)."""
    knots: Knots = tuple(  # type: ignore[assignment]
        uniform_knots(a, b, n, p) for a, b, n, p in zip(zones.grid.low, zones.grid.high, count, degree, strict=True)
    )
    while True:
        zero, one = (touched(zone, zones.grid.axes, knots, degree) for zone in (zones.zero, zones.one))
        both, free = zero & one, ~(zero | one)
        if not both.any() and free.sum() >= MIN_FREE:
            return VolumeWeight(np.where(free, 0.5, one.astype(float)), knots, degree, free)
        if not refine or 8 * free.size > MAX_COEFFICIENTS:
            why = f"{int(both.sum())} supports meet both regions" if both.any() else f"only {int(free.sum())} are free"
            raise InvalidRequest(
                f"{' x '.join(map(str, zero.shape))} weight coefficients are too few: {why}; about "
                f"{' x '.join(str(2 * n - p) for n, p in zip(zero.shape, degree, strict=True))} are needed, or a wider "
                "blending region"
            )
        knots = _refined(knots, degree, both if both.any() else np.ones(both.shape, bool))


def _refined(knots: Knots, degree: Triple, where: Mask) -> Knots:
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


def targets(zones: Zones) -> tuple[Array, Mask]:
    """Algorithm 1: the value v_p of each cell (eq. 15) and which cells are data points, both (nx-1, ny-1, nz-1)."""
    inside, grid = zones.inside, zones.grid
    some, every = _corners(inside, np.logical_or), _corners(inside, np.logical_and)
    bounds = [some & ~every & _corners(side, np.logical_or) for side in (zones.zero, zones.one)]
    bounds[1] &= ~bounds[0]
    for name, bound in zip(("first", "second"), bounds, strict=True):
        if not bound.any():
            raise InvalidRequest(
                f"the {name} region does not touch the blending region at this resolution {grid.shape}"
            )
    near, far = (distance_transform_edt(~bound, sampling=grid.spacing) for bound in bounds)
    values = near / np.where(near + far > 0, near + far, 1.0)
    return values, every | bounds[0] | bounds[1]


def _corners(mask: Mask, join: np.ufunc) -> Mask:
    """Any or all of the eight corners of each cell."""
    for axis in range(3):
        mask = join(np.take(mask, range(mask.shape[axis] - 1), axis), np.take(mask, range(1, mask.shape[axis]), axis))
    return mask


def local_lspia(
    weight: VolumeWeight, axes: tuple[Array, Array, Array], values: Array, used: Mask, steps: int
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
    mass = contract(used.astype(float), back)
    moves = weight.free & (mass > 0)
    step = np.where(moves, 1.0 / np.where(moves, mass, 1.0), 0.0)
    coefficients = weight.coefficients
    for _ in range(steps):
        residual = np.where(used, values - contract(coefficients, rows), 0.0)
        coefficients = coefficients + step * contract(residual, back)
    return weight.moved(np.clip(coefficients, 0.0, 1.0))
