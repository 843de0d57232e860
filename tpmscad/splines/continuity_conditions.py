"""Continuity between a patch and rigid copies of it, as linear rows on the patch's poles.

A patch X on its square is joined over side `side` to the copy R X + t, whose side `other` lies on it. Coordinates at a side:
xi outward and y along it, counter-clockwise, both scaled so that the patch is [-1, 1]^2 and the side is xi = 1. A joined side
runs in the opposite direction, y -> -y, unless the motion is a mirror.

**Transition.** With four patches at every corner the square continues into the Euclidean tiling, and the parameters of the copy
are (-xi, -y) about the middle of the side: parametric continuity. With q patches at every corner this is impossible; C^1 would
force X_u = X_v = 0 there. But the square is also a tile {4, q} of the projective (Klein) model of the hyperbolic plane, with half
side c, in which isometries are the projective maps that preserve the form <v, w> = v1 w1 + v2 w2 - v0 w0. The angle at a corner,
2 pi / q, is that between the sides x = c and y = c, whose normals are (c; 1, 0) and (c; 0, 1), so

    cos(2 pi / q) = c^2 / (1 - c^2) =: k.

The half-turn about the middle of the side, M = (1; c, 0), is v -> 2 <v, M> / <M, M> M - v, a harmonic homology. In the scaled
coordinates, with s = xi - 1,

    s' = -s / (1 - 2 k s),      y' = -y / (1 - 2 k s).

These maps of the tiling close up around every corner. A patch that meets its copies to second order through them is therefore
curvature continuous (G2) along all sides and at all corners, where second-order contact is passed on from patch to patch
by regular maps. q = 4 gives k = 0, parametric C^2; q = 6 gives k = 1/2, c = 1/sqrt(3).

**Conditions.** With s = e / (1 + k e), y = h / (1 + k e) the transition becomes linear, (e, h) -> (-e, -h). The patch at (e, h)
and the copy at (-e, -h) agree to order n at e = 0 if and only if, for m = 0..n, the derivatives D_m = d^m X / de^m at e = 0
satisfy

    D_m(side, y) = (-1)^m R D_m(other, y') + [m = 0] t,

and s_e = 1, s_ee = -2k, y_e = -k h, y_ee = 2 k^2 h at e = 0 give

    D_0 = X
    D_1 = X_s - k y X_y
    D_2 = X_ss - 2 k y X_sy + k^2 y^2 X_yy - 2 k X_s + 2 k^2 y X_y.

Derivatives along the side follow, since the conditions hold for all y. So do, from D_0, the two terms of D_2 without X_s. Each
D_m is a polynomial in y of the degree along the side in every span, so that degree + 1 points per span make the identity exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.splines.quadrature import composite_gauss_legendre
from tpmscad.splines.spline_axis import SplineAxis

ROUND_OFF_TOL = 1e-12
"""Knots, and entries of a rotation, that differ by less count as equal."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A joint: side `side` of a patch and the copy whose side `other` lies on it.

    Parameters
    ----------
    side : int
        Side 0..3 of the patch, numbered as in `bspline`.
    rotation : ndarray, shape (D, D)
        Orthogonal part of the motion x -> rotation x + translation. With determinant -1 it is a mirror and keeps the direction
        of the side.
    translation : ndarray, shape (D,)
        Translation of the motion.
    other : int
        Side 0..3 of the copy.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import Joint
    >>> Joint(1, np.eye(3), np.array([1.0, 0.0, 0.0]), 3).direction
    -1
    """

    side: int
    rotation: Array
    translation: Array
    other: int

    @property
    def direction(self) -> int:
        """+1 if the side of the copy runs in the direction of the patch's side, -1 if against it."""
        return -1 if np.linalg.det(self.rotation) > 0 else 1

    @property
    def mutual(self) -> bool:
        """Whether the motion is an involution on one side, so that the conditions at y and y' coincide."""
        square = self.rotation @ self.rotation
        return self.side == self.other and bool(np.abs(square - np.eye(len(square))).max() < ROUND_OFF_TOL)


@dataclass(frozen=True, slots=True, eq=False)
class ContinuityConditions:
    """Linear conditions matrix @ x = target on the flattened (U, V, D) unknowns of a patch.

    Rows are scaled by the root of a quadrature weight along the side, and by one factor per order so that the longest row
    of each order has length one.

    Parameters
    ----------
    matrix : ndarray, shape (rows, U V D)
        Left-hand sides.
    target : ndarray, shape (rows,)
        Right-hand sides.
    order : ndarray of int, shape (rows,)
        Order of the derivative in each row.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import ContinuityConditions
    >>> conditions = ContinuityConditions(np.eye(2), np.zeros(2), np.zeros(2, int))
    """

    matrix: Array
    target: Array
    order: IntArray

    @classmethod
    def from_blocks(
        cls, blocks: Sequence[Array], targets: Sequence[Array], orders: Sequence[IntArray]
    ) -> ContinuityConditions:
        """Conditions of concatenated blocks, each order scaled so that its longest row has length one."""
        matrix, target, order = np.concatenate(blocks), np.concatenate(targets), np.concatenate(orders)
        lengths = np.linalg.norm(matrix, axis=1)
        scale = np.array([lengths[order == m].max() for m in range(int(order.max()) + 1)])[order]
        return cls(matrix / scale[:, None], target / scale, order)


def joint_conditions(
    joints: Sequence[Joint], axis_u: SplineAxis, axis_v: SplineAxis, order: int = 2, valence: int = 4
) -> ContinuityConditions:
    """Conditions of contact between a patch and its copies.

    Parameters
    ----------
    joints : sequence of Joint
        The joints.
    axis_u, axis_v : SplineAxis
        Spline spaces; their coordinates are the unknowns. With `pole_axis` these are the poles.
    order : int, optional
        Order of contact: 0, 1 or 2.
    valence : int, optional
        Number of patches around every corner: 4 asks for parametric C0, C1 or C2, any other number for G1 or G2 with the
        projective transition.

    Returns
    -------
    ContinuityConditions
        The rows; redundant ones are included.

    Raises
    ------
    ValueError
        If the order is not 0, 1 or 2, or the valence is less than 3.

    Notes
    -----
    The derivation is in the module's documentation. TPMS2STEP (eqs. 10-13) asks for parametric C2, which no regular patch has
    where six patches meet.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import Joint, bezier_knots, gauss_axis, joint_conditions
    >>> axis = gauss_axis(bezier_knots(3), 3)
    >>> joint = Joint(1, np.eye(3), np.array([1.0, 0.0, 0.0]), 3)
    >>> joint_conditions([joint], axis, axis, order=0).matrix.shape
    (12, 48)
    """
    if valence < 3 or not 0 <= order <= 2:
        raise ValueError(f"order {order} must be 0, 1 or 2 and valence {valence} at least 3")
    k = cos(2 * pi / valence) if valence != 4 else 0.0
    blocks, targets, orders = [], [], []
    for joint in joints:
        y, weights = _collocation_points(joint, axis_u, axis_v)
        here = side_derivative_rows(joint.side, axis_u, axis_v, y, order, k)
        there = side_derivative_rows(joint.other, axis_u, axis_v, joint.direction * y, order, k)
        dim = len(joint.translation)
        for m in range(order + 1):
            sign = -1 if m == 1 else 1
            difference = np.einsum("nx,ij->nixj", here[m], np.eye(dim)) - sign * np.einsum(
                "nx,ij->nixj", there[m], joint.rotation
            )
            target = joint.translation if m == 0 else np.zeros(dim)
            roots = np.sqrt(weights)
            blocks.append((roots[:, None, None, None] * difference).reshape(len(y) * dim, -1))
            targets.append(np.outer(roots, target).ravel())
            orders.append(np.full(len(y) * dim, m))
    return ContinuityConditions.from_blocks(blocks, targets, orders)


def side_derivative_rows(
    side: int, axis_u: SplineAxis, axis_v: SplineAxis, y: Array, order: int, k: float
) -> list[Array]:
    """D_0 .. D_order of the module's text at y in [-1, 1] along the side, for the constant k: each (len(y), U V)."""
    across, along = (axis_v, axis_u) if side in (0, 2) else (axis_u, axis_v)
    outward = 1 if side in (1, 2) else -1
    forward = 1 if side in (0, 1) else -1
    (a0, a1), (b0, b1) = across.domain, along.domain
    end = np.array([a1 if outward > 0 else a0])
    t = (b0 + b1) / 2 + forward * (b1 - b0) / 2 * y

    at_end = [across.design_matrix(end, m)[0] * (outward * (a1 - a0) / 2) ** m for m in range(order + 1)]
    on_side = [along.design_matrix(t, n) * (forward * (b1 - b0) / 2) ** n for n in range(order + 1)]

    def rows(m: int, n: int) -> Array:
        """d^(m + n) / ds^m dy^n."""
        product = np.einsum("a,nb->nba" if side in (0, 2) else "a,nb->nab", at_end[m], on_side[n])
        return product.reshape(len(y), -1)

    result = [rows(0, 0)]
    h = y[:, None]
    if order >= 1:
        result.append(rows(1, 0) - k * h * rows(0, 1))
    if order >= 2:
        second = rows(2, 0) - 2 * k * h * rows(1, 1) + (k * h) ** 2 * rows(0, 2)
        result.append(second - 2 * k * rows(1, 0) + 2 * k**2 * h * rows(0, 1))
    return result


def _collocation_points(joint: Joint, axis_u: SplineAxis, axis_v: SplineAxis) -> tuple[Array, Array]:
    """Points y and weights: degree + 1 in every span of the common refinement of both sides; half of them for an involution."""

    def knots_along(side: int) -> tuple[Array, int]:
        axis = axis_u if side in (0, 2) else axis_v
        low, high = axis.domain
        scaled = 2 * (axis.knots[axis.degree : len(axis.knots) - axis.degree] - low) / (high - low) - 1
        return (scaled if side in (0, 1) else -scaled), axis.degree

    here, degree = knots_along(joint.side)
    there, other_degree = knots_along(joint.other)
    knots = np.sort(np.concatenate([here, joint.direction * there]))
    knots = knots[np.concatenate([[True], np.diff(knots) > ROUND_OFF_TOL])]
    y, weights = composite_gauss_legendre(knots, max(degree, other_degree) + 1)
    if joint.mutual and joint.direction < 0:
        keep = y > -ROUND_OFF_TOL
        y, weights = y[keep], weights[keep]
    return y, weights
