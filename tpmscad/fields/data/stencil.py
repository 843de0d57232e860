"""Separable interpolation in a table: sum_ijk a_i(x) b_j(y) c_k(z) table[i, j, k] with weights of compact support.

On a grid the axes are contracted one after the other. On points a compiled loop forms the same sums in the same order for each
point, so that both routes give the same bits: fused multiplications and reordered sums are off, as numba leaves them by default.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.fields.tape.evaluation import FieldJet, is_grid


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
    if is_grid(*coordinates):
        return _contract_grid(table, stencils, [s.weights for s in stencils])
    (x, y, z), shape = _as_columns(stencils, coordinates)
    return _contract_points(table, *x[:2], *y[:2], *z[:2]).reshape(shape)


def contract_table_jet(table: Array, stencils: Sequence[Stencil], coordinates: Sequence[Array]) -> FieldJet:
    """Values and derivatives at coordinates that broadcast."""
    if is_grid(*coordinates):
        weights = [s.weights for s in stencils]
        gradient = []
        for axis, stencil in enumerate(stencils):
            differentiated = [stencil.derivatives if other == axis else w for other, w in enumerate(weights)]
            gradient.append(_contract_grid(table, stencils, differentiated))
        return _contract_grid(table, stencils, weights), gradient[0], gradient[1], gradient[2]
    (x, y, z), shape = _as_columns(stencils, coordinates)
    jet = _contract_points_jet(table, *x, *y, *z)
    return jet[0].reshape(shape), jet[1].reshape(shape), jet[2].reshape(shape), jet[3].reshape(shape)


def _contract_grid(table: Array, stencils: Sequence[Stencil], weights: Sequence[Sequence[Array]]) -> Array:
    x, y, z = stencils
    a, b, c = weights
    across = _weighted_sum(a, [table[i.ravel()] for i in x.entries])
    plane = _weighted_sum(b, [across[:, j.ravel()] for j in y.entries])
    return _weighted_sum(c, [plane[:, :, k.ravel()] for k in z.entries])


def _weighted_sum(weights: Sequence[Array], parts: Sequence[Array]) -> Array:
    """Sum of weight * part in the given order."""
    total = weights[0] * parts[0]
    for weight, part in zip(weights[1:], parts[1:], strict=True):
        total = total + weight * part
    return total


def _as_columns(
    stencils: Sequence[Stencil], coordinates: Sequence[Array]
) -> tuple[list[tuple[IntArray, Array, Array]], tuple[int, ...]]:
    """Entries, weights and derivatives (m, n) of each axis at n points, and the shape that the coordinates broadcast to."""
    shape = np.broadcast_shapes(*(t.shape for t in coordinates))

    def stack(parts: Sequence[Any]) -> Any:
        columns = np.empty((len(parts), *shape), parts[0].dtype)
        for k, part in enumerate(parts):
            columns[k] = part  # np.broadcast_to takes longer than the interpolation at few points
        return columns.reshape(len(parts), -1)

    return [(stack(s.entries), stack(s.weights), stack(s.derivatives)) for s in stencils], shape


@njit_cached
def _contract_points(table, i, a, j, b, k, c):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Sums (n,) over entries i, j, k (m, n) of the table with weights a, b, c (m, n)."""
    found = np.empty(a.shape[1])
    for point in range(a.shape[1]):
        total = 0.0
        for w in range(c.shape[0]):
            plane = 0.0
            for v in range(b.shape[0]):
                line = a[0, point] * table[i[0, point], j[v, point], k[w, point]]
                for u in range(1, a.shape[0]):
                    line += a[u, point] * table[i[u, point], j[v, point], k[w, point]]
                plane = b[0, point] * line if v == 0 else plane + b[v, point] * line
            total = c[0, point] * plane if w == 0 else total + c[w, point] * plane
        found[point] = total
    return found


@njit_cached
def _contract_points_jet(table, i, a, da, j, b, db, k, c, dc):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Values and the three derivatives, (4, n), in one pass over the table."""
    found = np.empty((4, a.shape[1]))
    for point in range(a.shape[1]):
        total = slope_x = slope_y = slope_z = 0.0
        for w in range(c.shape[0]):
            plane = plane_x = plane_y = 0.0
            for v in range(b.shape[0]):
                entry = table[i[0, point], j[v, point], k[w, point]]
                line, line_x = a[0, point] * entry, da[0, point] * entry
                for u in range(1, a.shape[0]):
                    entry = table[i[u, point], j[v, point], k[w, point]]
                    line += a[u, point] * entry
                    line_x += da[u, point] * entry
                if v == 0:
                    plane, plane_x, plane_y = b[0, point] * line, b[0, point] * line_x, db[0, point] * line
                else:
                    plane += b[v, point] * line
                    plane_x += b[v, point] * line_x
                    plane_y += db[v, point] * line
            if w == 0:
                total, slope_x = c[0, point] * plane, c[0, point] * plane_x
                slope_y, slope_z = c[0, point] * plane_y, dc[0, point] * plane
            else:
                total += c[w, point] * plane
                slope_x += c[w, point] * plane_x
                slope_y += c[w, point] * plane_y
                slope_z += dc[w, point] * plane
        found[0, point], found[1, point], found[2, point], found[3, point] = total, slope_x, slope_y, slope_z
    return found
