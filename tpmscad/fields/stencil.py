"""Separable interpolation in a table: sum_ijk a_i(x) b_j(y) c_k(z) table[i, j, k] with weights of compact support.

On a grid the axes are contracted one after the other. On points the same sums are formed in the same order for each point, so
that both routes give the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tpmscad._typing import Array, IntArray
from tpmscad.fields.evaluation import FieldJet, is_grid


@dataclass(frozen=True, slots=True, eq=False)
class Stencil:
    """Interpolation along one axis at many coordinates: entries of the table, their weights and the weights' derivatives."""

    entries: Sequence[IntArray]
    weights: Sequence[Array]
    derivatives: Sequence[Array]


def cubic_weights(r: Array, rate: float | Array) -> tuple[list[Array], list[Array]]:
    """Weights of the four cubic cardinal B-splines at the fraction r of a step, and derivatives where r grows by `rate`."""
    s = 1.0 - r
    weights = [
        (s * s * s) / 6.0,
        (4.0 + (r * r) * (3.0 * r - 6.0)) / 6.0,
        (4.0 + (s * s) * (3.0 * s - 6.0)) / 6.0,
        (r * r * r) / 6.0,
    ]
    derivatives = [
        (-0.5 * rate) * (s * s),
        (0.5 * rate) * (r * (3.0 * r - 4.0)),
        (-0.5 * rate) * (s * (3.0 * s - 4.0)),
        (0.5 * rate) * (r * r),
    ]
    return weights, derivatives


def contract_table(table: Array, stencils: Sequence[Stencil], coordinates: Sequence[Array]) -> Array:
    """Values at coordinates that broadcast."""
    return _contract(table, stencils, [s.weights for s in stencils], is_grid(*coordinates))


def contract_table_jet(table: Array, stencils: Sequence[Stencil], coordinates: Sequence[Array]) -> FieldJet:
    """Values and derivatives at coordinates that broadcast."""
    grid = is_grid(*coordinates)
    weights = [s.weights for s in stencils]
    gradient = []
    for axis, stencil in enumerate(stencils):
        differentiated = [stencil.derivatives if other == axis else w for other, w in enumerate(weights)]
        gradient.append(_contract(table, stencils, differentiated, grid))
    return _contract(table, stencils, weights, grid), gradient[0], gradient[1], gradient[2]


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
    """Sum of weight * part in the given order."""
    total = weights[0] * parts[0]
    for weight, part in zip(weights[1:], parts[1:], strict=True):
        total = total + weight * part
    return total
