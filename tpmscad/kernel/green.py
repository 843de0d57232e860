"""Integrals over a trimmed B-spline face by Green's theorem, its loops being the edges' own 3-D curves.

    int_D f du dv = loop int F(u, v) dv,    F(u, v) = int_{u0}^{u} f(s, v) ds,    counter-clockwise loops.

f is sampled on a tensor grid of Gauss nodes per knot cell, interpolated there in Legendre polynomials and integrated along u in
closed form. The edges are brought to the surface by Newton from the kernel's parameter curve: one that a reader makes up is only
as good as its tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from OCP.BRepAdaptor import BRepAdaptor_Curve2d
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad.kernel.edge_nodes import EdgeNodes, composite, gauss
from tpmscad.patches.complex import Array, Ints
from tpmscad.splines.bspline import Surface, design

NEWTON_STEPS = 12
"""The kernel's own parameters are good to 1e-7 mostly, where two steps reach round-off; a bad guess may take more."""

NEWTON_STOP = 1e-7
"""A step below this fraction of the parameter range is the last: what is left squares, to round-off."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Tensor Gauss nodes of every knot cell: basis values, slopes and weights along u and along v."""

    values: tuple[Array, Array]
    slopes: tuple[Array, Array]
    weights: tuple[Array, Array]


def grid(surface: Surface, points: tuple[int, int]) -> Grid:
    """The grid with that many points per cell along u and v."""
    u = _axis(tuple(surface.knots_u.tolist()), surface.degree_u, points[0])
    v = _axis(tuple(surface.knots_v.tolist()), surface.degree_v, points[1])
    return Grid((u[0], v[0]), (u[1], v[1]), (u[2], v[2]))


@lru_cache
def _axis(knots: tuple[float, ...], degree: int, points: int) -> tuple[Array, Array, Array]:
    """Basis values, slopes and weights; the same for all patches of a lattice."""
    vector = np.array(knots)
    nodes, weights = composite(np.unique(vector), points)
    return design(vector, degree, nodes), design(vector, degree, nodes, 1), weights


def integrand(poles: Array, grid: Grid) -> Array:
    """|N|, x . N / 3 and x (x . N) / 4 on the grid, of surfaces with poles (F, U, V, 3): (F, A, B, 5)."""
    (u, v), (du, dv) = grid.values, grid.slopes
    along_v = np.matmul(v, poles)  # (F, U, B, 3)
    x = np.einsum("au,fubd->fabd", u, along_v, optimize=True)
    xu = np.einsum("au,fubd->fabd", du, along_v, optimize=True)
    xv = np.einsum("au,fubd->fabd", u, np.matmul(dv, poles), optimize=True)
    n = np.cross(xu, xv)
    area = np.linalg.norm(n, axis=-1)
    cone = (x * n).sum(-1)[..., None]
    return np.concatenate([area[..., None], cone / 3.0, cone * x / 4.0], axis=-1)


def trimmed_moments(
    surface: Surface, edges: Sequence[TopoDS_Edge], face: TopoDS_Face, nodes_of: EdgeNodes, points: tuple[int, int]
) -> Array:
    """The five integrals over the part of the patch that the edges bound: (5,). `points` as for `grid`."""
    f = integrand(surface.poles[None], grid(surface, points))[0]
    u, v, dv = _parameter_nodes(surface, edges, face, nodes_of)
    along_u = _antiderivative(surface.knots_u, points[0], u)
    along_v = _interpolation(surface.knots_v, points[1], v) * dv[:, None]
    inner = (along_u @ f.reshape(len(f), -1)).reshape(len(u), -1, f.shape[2])
    return np.asarray(np.einsum("nb,nbk->k", along_v, inner))


def _parameter_nodes(
    surface: Surface, edges: Sequence[TopoDS_Edge], face: TopoDS_Face, nodes_of: EdgeNodes
) -> tuple[Array, Array, Array]:
    """(u, v) at all nodes of the loops, and v' times weight."""
    walks = [nodes_of(edge) for edge in edges]
    guess = []
    for edge, (nodes, _) in zip(edges, walks, strict=True):
        curve = BRepAdaptor_Curve2d(edge, face)
        guess += [curve.Value(s).Coord() for s in nodes.t.tolist()]
    target = np.concatenate([nodes.points for nodes, _ in walks])
    tangent = np.concatenate([nodes.tangents for nodes, _ in walks])
    weights = np.concatenate([sign * nodes.weights for nodes, sign in walks])
    low, high = np.array(surface.domain).T
    uv = np.array(guess)
    for _ in range(NEWTON_STEPS):
        uv = np.clip(uv, low, high)
        x, xu, xv = _frame(surface, uv)
        step = _in_plane(xu, xv, target - x)
        uv = uv + step
        if (np.abs(step) < NEWTON_STOP * (high - low)).all():
            break
    _, xu, xv = _frame(surface, np.clip(uv, low, high))
    return uv[:, 0], uv[:, 1], weights * _in_plane(xu, xv, tangent)[:, 1]


def _frame(surface: Surface, uv: Array) -> tuple[Array, Array, Array]:
    """Position and first derivatives at the pairs uv (n, 2): (n, 3) each."""
    rows, columns, _ = surface.poles.shape
    flat = surface.poles.reshape(rows, 3 * columns)
    u, v = uv.T
    bu, cu = (design(surface.knots_u, surface.degree_u, u, k) @ flat for k in (0, 1))
    bv, cv = (design(surface.knots_v, surface.degree_v, v, k)[:, None, :] for k in (0, 1))
    bu, cu = bu.reshape(-1, columns, 3), cu.reshape(-1, columns, 3)
    return (bv @ bu)[:, 0], (bv @ cu)[:, 0], (cv @ bu)[:, 0]


def _in_plane(xu: Array, xv: Array, vector: Array) -> Array:
    """Components along x_u and x_v of each vector's projection on their plane: (n, 2)."""
    e, f, g = (xu * xu).sum(1), (xu * xv).sum(1), (xv * xv).sum(1)
    a, b = (vector * xu).sum(1), (vector * xv).sum(1)
    return np.stack([g * a - f * b, e * b - f * a], axis=1) / (e * g - f * f)[:, None]


def _cells(knots: Array, t: Array) -> tuple[Ints, Array, Array]:
    """The knot cell of each t, all cells' half widths, and t in [-1, 1] of its cell."""
    breaks = np.unique(knots)
    cell = np.clip(np.searchsorted(breaks, t, side="right") - 1, 0, len(breaks) - 2)
    half = 0.5 * np.diff(breaks)
    return cell, half, (t - breaks[cell]) / half[cell] - 1.0


def _interpolation(knots: Array, points: int, t: Array) -> Array:
    """Matrix from samples at every cell's Gauss nodes to values at t: (len(t), cells * points)."""
    cell, half, local = _cells(knots, t)
    values = legendre.legvander(local, points - 1) @ _to_legendre(points)
    return _spread(values, cell, len(half))


def _antiderivative(knots: Array, points: int, t: Array) -> Array:
    """Matrix from samples at every cell's Gauss nodes to the integral from the first knot to t."""
    cell, half, local = _cells(knots, t)
    p = legendre.legvander(local, points)
    integral = np.empty((len(t), points))
    integral[:, 0] = local + 1.0
    k = np.arange(1, points)
    integral[:, 1:] = (p[:, 2:] - p[:, : points - 1]) / (2 * k + 1)
    result = _spread(half[cell][:, None] * (integral @ _to_legendre(points)), cell, len(half))
    _, w = gauss(points)
    for i, width in enumerate(half):  # whole cells on the way
        result[cell > i, i * points : (i + 1) * points] = width * w
    return result


@lru_cache
def _to_legendre(points: int) -> Array:
    """Matrix from values at the Gauss nodes to Legendre coefficients."""
    x, w = gauss(points)
    return np.asarray((np.arange(points)[:, None] + 0.5) * legendre.legvander(x, points - 1).T * w)


def _spread(values: Array, cell: Ints, cells: int) -> Array:
    n, points = values.shape
    result = np.zeros((n, cells, points))
    result[np.arange(n), cell] = values
    return result.reshape(n, cells * points)
