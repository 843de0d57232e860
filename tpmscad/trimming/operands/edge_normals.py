"""The ruled surface of the normals along an edge of any shape, as the zero set of a smooth function about the edge.

With the foot C(t) of a point p on the edge, T = C', and b(t) a unit vector along T x N, N being the normal of a face,

    h(p) = (p - C(t)) . b(t)

vanishes on the normals along the edge and has the gradient b there. It is a distance to first order about the edge only. Beyond
the ends of the edge the foot stays at the end, so that h goes on as the distance from a plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from tpmscad._typing import Array
from tpmscad.brep.carriers import EdgeCurve
from tpmscad.brep.orthogonal_projection import project_to_curve
from tpmscad.splines.bspline import BSplineCurve

ACROSS_DEGREE = 5
"""Degree of the spline b(t). Its error turns the surface about the edge, but does not move it off the edge."""

ACROSS_SAMPLES = 97
"""Parameters at which b(t) is interpolated."""

MIN_BEND_FRACTION = 1e-2
"""Least -d/dt of (p - C) . C', relative to |C'|^2: where it is less, p lies near the edge's axis of curvature."""

BOX_MARGIN = 0.05
"""Enlargement of the box of an edge's samples, relative to its diagonal."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeNormals:
    """The ruled surface of normals along `curve` over `span`; `across` is b(t)."""

    curve: EdgeCurve
    span: tuple[float, float]
    across: BSplineCurve

    def box(self) -> tuple[Array, Array]:
        """Low and high corner of a box that contains the edge, with a margin."""
        points = self.curve(np.linspace(*self.span, ACROSS_SAMPLES))
        low, high = points.min(axis=0), points.max(axis=0)
        margin = BOX_MARGIN * np.linalg.norm(high - low)
        return low - margin, high + margin

    def jet(self, points: Array, order: int) -> list[Array]:
        """The function h (n,), its gradient (n, 3) and its Hessian (n, 3, 3) at points (n, 3), up to `order`."""
        t = np.clip(project_to_curve(self.curve, self.span, points)[0], *self.span)
        arm = points - self.curve(t)
        b, db = self.across(t), self.across(t, 1)
        value = np.einsum("nk,nk->n", arm, b)
        if order == 0:
            return [value]
        first, second = self.curve(t, 1), self.curve(t, 2)
        square = np.einsum("nk,nk->n", first, first)
        bend = np.maximum(square - np.einsum("nk,nk->n", arm, second), MIN_BEND_FRACTION * square)
        inside = (t > self.span[0]) & (t < self.span[1])
        turn = np.where(inside[:, None], first / bend[:, None], 0.0)  # gradient of t
        by_t = np.einsum("nk,nk->n", arm, db) - np.einsum("nk,nk->n", first, b)
        found = [value, b + by_t[:, None] * turn]
        if order > 1:
            third, ddb = self.curve(t, 3), self.across(t, 2)
            by_tt = (
                np.einsum("nk,nk->n", arm, ddb)
                - 2.0 * np.einsum("nk,nk->n", first, db)
                - np.einsum("nk,nk->n", second, b)
            )
            twist = np.einsum("nk,nk->n", arm, third) - 3.0 * np.einsum("nk,nk->n", first, second)
            squared = turn[:, :, None] * turn[:, None, :]
            crossed = second[:, :, None] * turn[:, None, :]
            bending = crossed + np.swapaxes(crossed, 1, 2) + twist[:, None, None] * squared
            bending = np.where(inside[:, None, None], bending / bend[:, None, None], 0.0)  # second derivatives of t
            mixed = db[:, :, None] * turn[:, None, :]
            found.append(
                mixed + np.swapaxes(mixed, 1, 2) + by_tt[:, None, None] * squared + by_t[:, None, None] * bending
            )
        return found


def build_edge_normals(curve: EdgeCurve, span: tuple[float, float], parameters: Array, normals: Array) -> EdgeNormals:
    """The ruled surface of normals (n, 3), given at parameters (n,) from one end of the span to the other."""
    across = np.cross(curve(parameters, 1), normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    found = make_interp_spline(parameters, across, ACROSS_DEGREE)
    return EdgeNormals(curve, span, BSplineCurve(np.asarray(found.c), np.asarray(found.t), ACROSS_DEGREE))
