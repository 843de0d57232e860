"""Moments of trimmed B-spline faces by Green's theorem, with the 3-D curves of the edges as trimming loops.

    int_D f du dv = oint F(u, v) dv,    F(u, v) = int_{u0}^{u} f(s, v) ds,    loops counter-clockwise.

The integrand f is sampled on a tensor grid of Gauss nodes per knot cell, interpolated there in Legendre polynomials and
integrated along u in closed form. Points of the edges are projected onto the surface by Newton's method, which starts from the
OCCT pcurve: a pcurve computed by a STEP reader is accurate to the edge's tolerance only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from OCP.BRepAdaptor import BRepAdaptor_Curve2d
from OCP.GeomAbs import GeomAbs_Line
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array, IntArray
from tpmscad.kernel.measure.edge_quadrature import EdgeNodeCache
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.quadrature import composite_gauss_legendre, gauss_legendre

MAX_NEWTON_STEPS = 12
"""Newton steps of the projection; from a pcurve accurate to 1e-7, two steps reach round-off."""

MAX_LEVEL_SLOPE = 1e-10
"""Slope below which a straight pcurve is parallel to u, where dv = 0 and the integral vanishes."""

NEWTON_STEP_TOL = 1e-7
"""Newton step, as a fraction of the parameter range, below which quadratic convergence has reached round-off."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchGaussGrid:
    """Tensor Gauss nodes of all knot cells: basis values, basis derivatives and weights along u and along v."""

    values: tuple[Array, Array]
    slopes: tuple[Array, Array]
    weights: tuple[Array, Array]


def gauss_grid(surface: BSplineSurface, points: tuple[int, int]) -> PatchGaussGrid:
    """Gauss grid with the given numbers of points per knot cell along u and v."""
    u = _axis_basis(tuple(surface.knots_u.tolist()), surface.degree_u, points[0])
    v = _axis_basis(tuple(surface.knots_v.tolist()), surface.degree_v, points[1])
    return PatchGaussGrid((u[0], v[0]), (u[1], v[1]), (u[2], v[2]))


@lru_cache
def _axis_basis(knots: tuple[float, ...], degree: int, points: int) -> tuple[Array, Array, Array]:
    """Basis values, derivatives and weights along one parameter, cached: all patches of a lattice share them."""
    vector = np.array(knots)
    nodes, weights = composite_gauss_legendre(np.unique(vector), points)
    return design_matrix(vector, degree, nodes), design_matrix(vector, degree, nodes, 1), weights


def moment_integrands(poles: Array, grid: PatchGaussGrid) -> Array:
    """|N|, x . N / 3 and x (x . N) / 4 on the grid for surfaces with poles (F, U, V, 3): (F, A, B, 5)."""
    (u, v), (du, dv) = grid.values, grid.slopes
    along_v = np.matmul(v, poles)  # (F, U, B, 3)
    x = np.einsum("au,fubd->fabd", u, along_v, optimize=True)
    xu = np.einsum("au,fubd->fabd", du, along_v, optimize=True)
    xv = np.einsum("au,fubd->fabd", u, np.matmul(dv, poles), optimize=True)
    n = np.cross(xu, xv)
    area = np.linalg.norm(n, axis=-1)
    cone = (x * n).sum(-1)[..., None]
    return np.concatenate([area[..., None], cone / 3.0, cone * x / 4.0], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class TrimmedSplineFace:
    """A trimmed face with its surface and its edges as the loops use them."""

    surface: BSplineSurface
    edges: Sequence[TopoDS_Edge]
    face: TopoDS_Face


def trimmed_face_moments(
    members: Sequence[TrimmedSplineFace], nodes_of: EdgeNodeCache, points: tuple[int, int]
) -> Array:
    """Five moments of each face, with respect to the orientation of its loops: (F, 5).

    All surfaces have the same knots and degrees. `points` as for `gauss_grid`.
    """
    space = members[0].surface
    poles = np.stack([m.surface.poles for m in members])
    f = moment_integrands(poles, gauss_grid(space, points))
    f = f.reshape(*f.shape[:2], -1)  # five moments per node along v
    u, v, dv, bounds = _parameter_nodes(members, poles, nodes_of)
    along_u = _antiderivative_matrix(space.knots_u, points[0], u)
    along_v = _interpolation_matrix(space.knots_v, points[1], v) * dv[:, None]
    result = np.zeros((len(members), 5))
    for i, (start, stop) in enumerate(zip(bounds[:-1], bounds[1:], strict=True)):
        inner = (along_u[start:stop] @ f[i]).reshape(stop - start, -1, 5)
        result[i] = np.einsum("nb,nbk->k", along_v[start:stop], inner)
    return result


def _parameter_nodes(
    members: Sequence[TrimmedSplineFace], poles: Array, nodes_of: EdgeNodeCache
) -> tuple[Array, Array, Array, list[int]]:
    """Parameters u and v at all quadrature nodes of the loops, dv/dt times weight, and the index range of each face."""
    guess, target, tangent, weights, bounds = [], [], [], [], [0]
    for member in members:
        count = 0
        for edge in member.edges:
            curve = BRepAdaptor_Curve2d(edge, member.face)
            if curve.GetType() == GeomAbs_Line and abs(curve.Line().Direction().Y()) < MAX_LEVEL_SLOPE:
                continue
            nodes, sign = nodes_of(edge)
            guess.append(_pcurve_points(curve, nodes.parameters))
            target.append(nodes.points)
            tangent.append(nodes.tangents)
            weights.append(sign * nodes.weights)
            count += len(nodes.parameters)
        bounds.append(bounds[-1] + count)
    space = members[0].surface
    low, high = np.array(space.domain).T
    goal, along, uv = np.concatenate(target), np.concatenate(tangent), np.concatenate(guess)
    for _ in range(MAX_NEWTON_STEPS):
        uv = np.clip(uv, low, high)
        x, xu, xv = _positions_and_tangents(space, poles, uv, bounds)
        step = _tangent_coordinates(xu, xv, goal - x)
        uv = uv + step
        if (np.abs(step) < NEWTON_STEP_TOL * (high - low)).all():
            break
    _, xu, xv = _positions_and_tangents(space, poles, np.clip(uv, low, high), bounds)
    return uv[:, 0], uv[:, 1], np.concatenate(weights) * _tangent_coordinates(xu, xv, along)[:, 1], bounds


def _pcurve_points(curve: BRepAdaptor_Curve2d, t: Array) -> Array:
    """Points of the OCCT pcurve at t: (n, 2)."""
    if curve.GetType() == GeomAbs_Line:
        line = curve.Line()
        return np.array(line.Location().Coord()) + t[:, None] * np.array(line.Direction().Coord())
    return np.array([curve.Value(s).Coord() for s in t.tolist()])


def _positions_and_tangents(
    space: BSplineSurface, poles: Array, uv: Array, bounds: list[int]
) -> tuple[Array, Array, Array]:
    """Positions and first derivatives at uv (n, 2): (n, 3) each; rows bounds[i] to bounds[i + 1] are on face i."""
    count, rows, columns, _ = poles.shape
    flat = poles.reshape(count, rows, 3 * columns)
    (bu, cu), (bv, cv) = (
        (design_matrix(knots, degree, t), design_matrix(knots, degree, t, 1))
        for knots, degree, t in ((space.knots_u, space.degree_u, uv[:, 0]), (space.knots_v, space.degree_v, uv[:, 1]))
    )
    at, along = np.empty((len(uv), columns, 3)), np.empty((len(uv), columns, 3))
    for i, (start, stop) in enumerate(zip(bounds[:-1], bounds[1:], strict=True)):
        at[start:stop] = (bu[start:stop] @ flat[i]).reshape(-1, columns, 3)
        along[start:stop] = (cu[start:stop] @ flat[i]).reshape(-1, columns, 3)
    bv, cv = bv[:, None, :], cv[:, None, :]
    return (bv @ at)[:, 0], (bv @ along)[:, 0], (cv @ at)[:, 0]


def _tangent_coordinates(xu: Array, xv: Array, vector: Array) -> Array:
    """Coordinates of the projection of each vector onto the tangent plane in the basis (x_u, x_v): (n, 2)."""
    e, f, g = (xu * xu).sum(1), (xu * xv).sum(1), (xv * xv).sum(1)
    a, b = (vector * xu).sum(1), (vector * xv).sum(1)
    return np.stack([g * a - f * b, e * b - f * a], axis=1) / (e * g - f * f)[:, None]


def _locate_spans(knots: Array, t: Array) -> tuple[IntArray, Array, Array]:
    """Knot cell of each t, half widths of all cells, and t mapped to [-1, 1] in its cell."""
    breaks = np.unique(knots)
    cell = np.clip(np.searchsorted(breaks, t, side="right") - 1, 0, len(breaks) - 2)
    half = 0.5 * np.diff(breaks)
    return cell, half, (t - breaks[cell]) / half[cell] - 1.0


def _interpolation_matrix(knots: Array, points: int, t: Array) -> Array:
    """Matrix from samples at all cells' Gauss nodes to values at t: (len(t), cells * points)."""
    cell, half, local = _locate_spans(knots, t)
    values = legendre.legvander(local, points - 1) @ _to_legendre(points)
    return _scatter_to_spans(values, cell, len(half))


def _antiderivative_matrix(knots: Array, points: int, t: Array) -> Array:
    """Matrix from samples at all cells' Gauss nodes to the integral from the first knot to t."""
    cell, half, local = _locate_spans(knots, t)
    p = legendre.legvander(local, points)
    integral = np.empty((len(t), points))
    integral[:, 0] = local + 1.0
    k = np.arange(1, points)
    integral[:, 1:] = (p[:, 2:] - p[:, : points - 1]) / (2 * k + 1)
    result = _scatter_to_spans(half[cell][:, None] * (integral @ _to_legendre(points)), cell, len(half))
    _, w = gauss_legendre(points)
    for i, width in enumerate(half):  # cells passed completely
        result[cell > i, i * points : (i + 1) * points] = width * w
    return result


@lru_cache
def _to_legendre(points: int) -> Array:
    """Matrix from values at the Gauss nodes to Legendre coefficients."""
    x, w = gauss_legendre(points)
    return np.asarray((np.arange(points)[:, None] + 0.5) * legendre.legvander(x, points - 1).T * w)


def _scatter_to_spans(values: Array, cell: IntArray, cells: int) -> Array:
    """Rows of `values` (n, points) placed in the columns of their cells: (n, cells * points)."""
    n, points = values.shape
    result = np.zeros((n, cells, points))
    result[np.arange(n), cell] = values
    return result.reshape(n, cells * points)
