"""Continuity between a patch and rigid copies of it, as linear rows on the patch's poles.

A patch X on its square is joined over side `side` to the copy R X + t, whose side `other` lies on it. Coordinates at a side:
xi outward and y along it, counter-clockwise, both scaled so that the patch is [-1, 1]^2 and the side is xi = 1. A joined side
runs the other way, y -> -y, unless the motion is a mirror.

**Transition.** With four patches at every corner the square continues into the Euclidean tiling and the copy's parameters
are (-xi, -y) about the middle of the side: parametric continuity. With q at every corner that is impossible (for C^1 it
would make X_u = X_v = 0 there), but the square is also a tile {4, q} of the projective (Klein) model of the hyperbolic
plane, half side c, where isometries are the projective maps that keep the form <v, w> = v1 w1 + v2 w2 - v0 w0. The angle at
a corner, 2 pi / q, is that between the sides x = c and y = c, whose normals are (c; 1, 0) and (c; 0, 1), so

    cos(2 pi / q) = c^2 / (1 - c^2) =: k.

The half-turn about the middle of the side, M = (1; c, 0), is v -> 2 <v, M> / <M, M> M - v, a harmonic homology; in the scaled
coordinates, with s = xi - 1,

    s' = -s / (1 - 2 k s),      y' = -y / (1 - 2 k s).

These maps of the whole tiling close up around every corner, so a patch that meets its copies to second order through them
is curvature continuous (G2) along all sides and at all corners, where contact to second order is passed on from patch to
patch by regular maps. q = 4 gives k = 0, parametric C^2; q = 6 gives k = 1/2, c = 1/sqrt(3).

**Conditions.** Put s = e / (1 + k e), y = h / (1 + k e): the transition becomes (e, h) -> (-e, -h), linear. The patch at (e, h)
and the copy at (-e, -h) agree to order n at e = 0 iff, for m = 0..n, the derivatives D_m = d^m X / de^m at e = 0 satisfy

    D_m(side, y) = (-1)^m R D_m(other, y') + [m = 0] t,

and s_e = 1, s_ee = -2k, y_e = -k h, y_ee = 2 k^2 h at e = 0 give

    D_0 = X
    D_1 = X_s - k y X_y
    D_2 = X_ss - 2 k y X_sy + k^2 y^2 X_yy - 2 k X_s + 2 k^2 y X_y.

Derivatives along the side follow, since the conditions hold for all y; so do, from D_0, the two terms of D_2 without X_s. Each
D_m is a polynomial in y of the degree along the side in every span, so degree + 1 points per span make the identity exact, not
approximate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.quadrature import composite_gauss_legendre
from tpmscad.splines.spline_axis import SplineAxis

ROUND_OFF_TOL = 1e-12
"""Knots, and entries of a rotation, closer than this are the same."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """Side 0..3 of a patch and the motion x -> rotation x + translation whose copy has its side `other` there.

    Sides are numbered as in `bspline`. A motion with determinant -1 is a mirror and keeps the side's direction.
    """

    side: int
    rotation: Array
    translation: Array
    other: int

    @property
    def direction(self) -> int:
        """+1 if the copy's side runs along the patch's, -1 if against."""
        return -1 if np.linalg.det(self.rotation) > 0 else 1

    @property
    def mutual(self) -> bool:
        """Whether the copy of the copy is the patch itself, so that the conditions at y and at y' are the same."""
        square = self.rotation @ self.rotation
        return self.side == self.other and bool(np.abs(square - np.eye(len(square))).max() < ROUND_OFF_TOL)


@dataclass(frozen=True, slots=True, eq=False)
class ContinuityConditions:
    """matrix @ x = target for the flattened (U, V, D) unknowns of a patch; `order` is the derivative order of each row.

    Rows are scaled: by the root of a quadrature weight along the side, and by one factor per order so that the longest
    row of each order has length one.
    """

    matrix: Array
    target: Array
    order: Array


def joint_conditions(
    joints: Sequence[Joint], axis_u: SplineAxis, axis_v: SplineAxis, order: int = 2, valence: int = 4
) -> ContinuityConditions:
    """The conditions of contact of the given order (0, 1, 2) at all joints, on the coordinates of the two axes.

    `valence` is the number of patches around every corner: 4 asks for parametric C0, C1, C2, any other number for G1, G2 with
    the projective transition. With `pole_axis` axes the unknowns are the poles themselves.
    """
    if valence < 3 or not 0 <= order <= 2:
        raise ValueError(f"order {order} must be 0, 1 or 2 and valence {valence} at least 3")
    bend = cos(2 * pi / valence) if valence != 4 else 0.0
    blocks, targets, orders = [], [], []
    for joint in joints:
        y, weights = _collocation_points(joint, axis_u, axis_v)
        here = side_derivative_rows(joint.side, axis_u, axis_v, y, order, bend)
        there = side_derivative_rows(joint.other, axis_u, axis_v, joint.direction * y, order, bend)
        dim = len(joint.translation)
        for m in range(order + 1):
            sign = -1 if m == 1 else 1
            difference = np.einsum("nx,ij->nixj", here[m], np.eye(dim)) - sign * np.einsum(
                "nx,ij->nixj", there[m], joint.rotation
            )
            target = joint.translation if m == 0 else np.zeros(dim)
            root = np.sqrt(weights)
            blocks.append((root[:, None, None, None] * difference).reshape(len(y) * dim, -1))
            targets.append(np.outer(root, target).ravel())
            orders.append(np.full(len(y) * dim, m))
    matrix, target, row_order = np.concatenate(blocks), np.concatenate(targets), np.concatenate(orders)
    lengths = np.linalg.norm(matrix, axis=1)
    scale = np.array([lengths[row_order == m].max() for m in range(order + 1)])[row_order]
    return ContinuityConditions(matrix / scale[:, None], target / scale, row_order)


def side_derivative_rows(
    side: int, axis_u: SplineAxis, axis_v: SplineAxis, y: Array, order: int, bend: float
) -> list[Array]:
    """D_0 .. D_order of the module's text at y in [-1, 1] along the side: each (len(y), U V)."""
    across, along = (axis_v, axis_u) if side in (0, 2) else (axis_u, axis_v)
    outward = 1 if side in (1, 2) else -1
    forward = 1 if side in (0, 1) else -1
    (a0, a1), (b0, b1) = across.domain, along.domain
    end = np.array([a1 if outward > 0 else a0])
    t = (b0 + b1) / 2 + forward * (b1 - b0) / 2 * y

    def rows(m: int, n: int) -> Array:
        """d^(m + n) / ds^m dy^n."""
        at_end = across.design_matrix(end, m)[0] * (outward * (a1 - a0) / 2) ** m
        on_side = along.design_matrix(t, n) * (forward * (b1 - b0) / 2) ** n
        product = np.einsum("a,nb->nba" if side in (0, 2) else "a,nb->nab", at_end, on_side)
        return product.reshape(len(y), -1)

    result = [rows(0, 0)]
    k, h = bend, y[:, None]
    if order >= 1:
        result.append(rows(1, 0) - k * h * rows(0, 1))
    if order >= 2:
        second = rows(2, 0) - 2 * k * h * rows(1, 1) + (k * h) ** 2 * rows(0, 2)
        result.append(second - 2 * k * rows(1, 0) + 2 * k**2 * h * rows(0, 1))
    return result


def _collocation_points(joint: Joint, axis_u: SplineAxis, axis_v: SplineAxis) -> tuple[Array, Array]:
    """Points y with weights, degree + 1 in every span that the two sides' knots make together; half of them if mutual."""

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
