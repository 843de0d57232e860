"""Sums over a table with separable weights, sum_ijk a_i(x) b_j(y) c_k(z) table[i, j, k], few of the weights not zero.

On a grid the axes are contracted one after the other; on points the same sums are formed in the same order, point by point, so
that both give the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array
from tpmscad.fields.evaluation import FieldJet, is_grid

IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Stencil:
    """Of one axis at many coordinates: which entries of the table take part, with which weights, and their derivatives."""

    entries: Sequence[IndexArray]
    weights: Sequence[Array]
    slopes: Sequence[Array]


def contract_table(table: Array, stencils: Sequence[Stencil], coordinates: Sequence[Array]) -> Array:
    return _contract(table, stencils, [s.weights for s in stencils], is_grid(*coordinates))


def contract_table_jet(table: Array, stencils: Sequence[Stencil], coordinates: Sequence[Array]) -> FieldJet:
    grid = is_grid(*coordinates)
    weights = [s.weights for s in stencils]
    slopes = []
    for axis, stencil in enumerate(stencils):
        turned = [stencil.slopes if other == axis else w for other, w in enumerate(weights)]
        slopes.append(_contract(table, stencils, turned, grid))
    return _contract(table, stencils, weights, grid), slopes[0], slopes[1], slopes[2]


def _contract(table: Array, stencils: Sequence[Stencil], weights: Sequence[Sequence[Array]], grid: bool) -> Array:
    x, y, z = stencils
    a, b, c = weights
    if grid:
        across = _weighted_sum(a, [table[i.ravel()] for i in x.entries])
        plane = _weighted_sum(b, [across[:, j.ravel()] for j in y.entries])
        return _weighted_sum(c, [plane[:, :, k.ravel()] for k in z.entries])
    return _weighted_sum(
        c,
        [
            _weighted_sum(b, [_weighted_sum(a, [table[i, j, k] for i in x.entries]) for j in y.entries])
            for k in z.entries
        ],
    )


def _weighted_sum(weights: Sequence[Array], parts: Sequence[Array]) -> Array:
    total = weights[0] * parts[0]
    for weight, part in zip(weights[1:], parts[1:], strict=True):
        total = total + weight * part
    return total
