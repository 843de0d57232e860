"""Curvature continuity of a patch with its reflections in the planes of its sides, as linear rows on its poles.

On the unit square the reflection in side i is the harmonic homology with that side as axis and `centres[i]` as centre (see
`surfaces.klein_quadrilateral`): it exchanges the points P + e C and P - e C, with P on the side and C the centre, in homogeneous
coordinates. In affine coordinates, with C = (C0, Cu, Cv), p = Cu - u C0 and q = Cv - v C0, the derivatives by e at e = 0 are

    D_0 = X,   D_1 = p X_u + q X_v,   D_2 = p^2 X_uu + 2 p q X_uv + q^2 X_vv - 2 C0 D_1.

The patch meets its mirror image to second order if D_0 lies in the plane n . x = c, D_1 is parallel to n, and D_2 is orthogonal
to n. On a side one of p, q is constant and the other linear, so each condition is a polynomial of the degree along the side, and
degree + 1 points express it exactly. The two homologies of a corner generate as many maps as its mirrors do; corners of eight
patches are therefore no exception.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.continuity_conditions import ContinuityConditions
from tpmscad.splines.quadrature import gauss_legendre_unit
from tpmscad.splines.spline_axis import SplineAxis


def mirror_conditions(
    axis_u: SplineAxis, axis_v: SplineAxis, centres: Array, normals: Array, offsets: Array
) -> ContinuityConditions:
    """Contact of second order with the reflections in the planes normals[i] . x = offsets[i] over sides 0..3.

    Each axis has one span. The unknowns are the coordinates (U, V, 3) of the two axes.
    """
    blocks, targets, orders = [], [], []
    for side, (centre, normal, offset) in enumerate(zip(centres, normals, offsets, strict=True)):
        count = (axis_u if side in (0, 2) else axis_v).degree + 1
        along, weights = gauss_legendre_unit(count)
        roots = np.sqrt(weights)
        end = np.full(count, float(side in (1, 2)))
        u, v = (along, end) if side in (0, 2) else (end, along)
        rows = _homology_derivatives(axis_u, axis_v, u, v, centre)
        first, second = _plane_basis(normal)
        for order, directions in enumerate(((normal,), (first, second), (normal,))):
            for direction in directions:
                block = np.einsum("n,nx,j->nxj", roots, rows[order], direction)
                blocks.append(block.reshape(count, -1))
                targets.append(roots * (offset if order == 0 else 0.0))
                orders.append(np.full(count, order))
    return ContinuityConditions.from_blocks(blocks, targets, orders)


def _homology_derivatives(
    axis_u: SplineAxis, axis_v: SplineAxis, u: Array, v: Array, centre: Array
) -> tuple[Array, Array, Array]:
    """D_0, D_1, D_2 of the module's text at the points (n,) of a side: each (n, U V)."""

    def rows(m: int, n: int) -> Array:
        return np.einsum("na,nb->nab", axis_u.design_matrix(u, m), axis_v.design_matrix(v, n)).reshape(len(u), -1)

    p, q = centre[1] - u * centre[0], centre[2] - v * centre[0]
    size = max(np.abs(p).max(), np.abs(q).max())
    p, q, c0 = p[:, None] / size, q[:, None] / size, centre[0] / size
    first = p * rows(1, 0) + q * rows(0, 1)
    second = p**2 * rows(2, 0) + 2 * p * q * rows(1, 1) + q**2 * rows(0, 2) - 2 * c0 * first
    return rows(0, 0), first, second


def _plane_basis(normal: Array) -> tuple[Array, Array]:
    """Two orthonormal vectors that span the plane."""
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    return first, np.cross(normal, first)
