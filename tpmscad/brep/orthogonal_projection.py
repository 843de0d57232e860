"""Orthogonal projection of points onto surfaces and curves: the parameters of their foot points, in batches.

On a surface every step is that of Gauss and Newton, or of Newton where the surface gives second derivatives and the distance
has a minimum; the iteration goes on for the points that still move. A parameter that would leave the domain stops at its side,
and the other takes its own best step, so that the foot point slides along the side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.carriers import Circle, EdgeCurve, Ellipse
from tpmscad.brep.conics import TWO_PI
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

FOOT_PARAMETER_TOL = 1e-10
"""Parameter step at which a foot point has converged: the tangential residual is then far below any deviation."""

MAX_FOOT_STEPS = 20
"""Steps on a surface. Those of Gauss and Newton converge at the rate of the distance over the radius of curvature."""

LEAST_DIVISOR = 1e-300
"""Least divisor of a step: a derivative of length zero moves nothing."""

SAMPLES_PER_CURVE = 129
"""Samples along a curve without a closed form; the nearest one starts Newton's method."""

CURVE_STEPS = 8
"""Newton steps on a curve."""

SurfaceJet = Callable[[Array, Array, IntArray], Sequence[Array]]
"""Positions (n, 3), derivatives by u and v, and possibly by uu, uv and vv, at parameters (n,), (n,), for the points of `rows`."""


def project_to_surface(
    jet: SurfaceJet,
    points: Array,
    u: Array,
    v: Array,
    domain: Sequence[Sequence[float]],
    tol: float = FOOT_PARAMETER_TOL,
) -> tuple[Array, Array]:
    """Parameters (n,), (n,) of the foot points of points (n, 3) in the domain ((u0, u1), (v0, v1)), from parameters u, v (n,)."""
    (u0, u1), (v0, v1) = domain
    u, v, rows = u.astype(float), v.astype(float), np.arange(len(points))
    for _ in range(MAX_FOOT_STEPS):
        position, along_u, along_v, *second = jet(u[rows], v[rows], rows)
        residual = points[rows] - position
        du, dv = _step(residual, along_u, along_v, second)
        leaves_u, leaves_v = (
            ~((u[rows] + du >= u0) & (u[rows] + du <= u1)),
            ~((v[rows] + dv >= v0) & (v[rows] + dv <= v1)),
        )
        dv = np.where(leaves_u, _dot(along_v, residual) / np.maximum(_dot(along_v, along_v), LEAST_DIVISOR), dv)
        du = np.where(leaves_v, _dot(along_u, residual) / np.maximum(_dot(along_u, along_u), LEAST_DIVISOR), du)
        new_u, new_v = np.clip(u[rows] + du, u0, u1), np.clip(v[rows] + dv, v0, v1)
        moved = np.maximum(np.abs(new_u - u[rows]), np.abs(new_v - v[rows]))
        u[rows], v[rows] = new_u, new_v
        rows = rows[moved > tol]
        if not len(rows):
            break
    return u, v


def project_to_patch(patch: BSplineSurface, points: Array, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Distances (n,) of points (n, 3) from a patch and parameters (n,), (n,) of their foot points, from parameters u, v (n,)."""

    def jet(s: Array, t: Array, _: IntArray) -> Sequence[Array]:
        return patch(s, t), patch(s, t, 1, 0), patch(s, t, 0, 1)

    u, v = project_to_surface(jet, points, u, v, patch.domain)
    return np.linalg.norm(points - patch(u, v), axis=-1), u, v


def project_to_curve(curve: EdgeCurve, span: Sequence[float] | Array, points: Array) -> tuple[Array, Array]:
    """Orthogonal projection of points (n, 3) onto a curve: parameters (n,) and distances (n,).

    Angles are shifted by periods to within half a turn of the middle of the span.
    """
    if isinstance(curve, BSplineCurve) and curve.degree == 1 and len(curve.poles) == 2:
        low, high = curve.domain
        direction = curve.poles[1] - curve.poles[0]
        t = low + (high - low) * ((points - curve.poles[0]) @ direction) / float(direction @ direction)
    elif isinstance(curve, Circle | Ellipse):
        arm = points - curve.origin
        x, y = arm @ curve.x_axis, arm @ curve.y_axis
        if isinstance(curve, Circle):
            t = np.arctan2(y, x)
        else:
            t = _minimise_distance(curve, np.arctan2(y / curve.minor, x / curve.major), points)
        middle = 0.5 * (span[0] + span[1])
        t = middle + (t - middle + TWO_PI / 2) % TWO_PI - TWO_PI / 2
    else:
        at = np.linspace(span[0], span[1], SAMPLES_PER_CURVE)
        nearest = cKDTree(curve(at)).query(points)[1]
        t = np.clip(_minimise_distance(curve, at[nearest], points), span[0], span[1])
    return t, np.linalg.norm(curve(t) - points, axis=1)


def _minimise_distance(curve: EdgeCurve, t: Array, points: Array) -> Array:
    """Newton's method for the foot points, from parameters t (n,)."""
    for _ in range(CURVE_STEPS):
        gap, first, second = curve(t) - points, curve(t, 1), curve(t, 2)
        bend = _dot(first, first) + _dot(gap, second)
        t = t - _dot(gap, first) / np.where(bend > 0, bend, _dot(first, first))
        if isinstance(curve, BSplineCurve):
            t = np.clip(t, *curve.domain)
    return t


def _step(residual: Array, along_u: Array, along_v: Array, second: Sequence[Array]) -> tuple[Array, Array]:
    """The parameter step that cancels the tangential component of the residual, to second order if derivatives are given."""
    uu, uv, vv = _dot(along_u, along_u), _dot(along_u, along_v), _dot(along_v, along_v)
    if second:
        a, b, c = (part - _dot(residual, bend) for part, bend in zip((uu, uv, vv), second, strict=True))
        is_minimum = (a > 0) & (a * c > b * b)
        uu, uv, vv = np.where(is_minimum, (a, b, c), (uu, uv, vv))
    ru, rv = _dot(along_u, residual), _dot(along_v, residual)
    determinant = np.maximum(uu * vv - uv**2, LEAST_DIVISOR)
    return (vv * ru - uv * rv) / determinant, (uu * rv - uv * ru) / determinant


def _dot(a: Array, b: Array) -> Array:
    """Dot products (n,) of vectors (n, 3)."""
    return np.einsum("ni,ni->n", a, b)
