"""Many patches fitted at once, each by itself, joining with curvature continuity (G2) though none knows its neighbours.

On a lattice that a map has bent no patch is a copy of another. But all are charts of one analytic surface, and neighbouring
charts differ by the projective half-turn of the Klein model. In one chart let xi be the coordinate out of the patch, y the one
along the side, L = 1/c - c with c = 1/sqrt 3 half the Klein square. Second-order Taylor expansion of the half-turn
(xi, y) -> -L / (L - 2 xi) (xi, y) shows that the side's data

    C = X,   d1 = L X_xi - y X_y,   d2 = L^2 X_xixi - 2 y L X_xiy + y^2 X_yy - 2 L X_xi + 2 y X_y

reach the neighbour as C, -d1, d2 at -y. So if both patches take the same polynomials for them, they join G2. The polynomials of
degree p come from the exact surface by a rule that treats both alike: least squares with exact derivatives at the ends (up to
order 4 for C, 3 for d1, 2 for d2, just what makes the two strips of a corner agree on their common 3 x 3 poles, at the vertices
where six patches meet as well). The strips fix three rows of poles along each side, the rest is tensor least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import BSpline
from scipy.linalg import null_space

from tpmscad._typing import Array
from tpmscad.splines.bspline import BSplineSurface

MIN_DEGREE = 9
"""Ten poles along a side: five derivatives at each end."""

CHEBYSHEV_NODES = 48
"""Chebyshev nodes along each parameter that carry the exact surface. Joints of a stretched gyroid: 1e-4 degrees with 24 nodes,
1e-8 with 36; stretched by (1, 2, 0.7): 3e-6 with 36, 2e-8 with 48, 1e-8 with 56."""

SAMPLE_OVERHANG = 0.04
"""The nodes reach this far past the patch, where the surface goes on: derivatives on the border are then interior ones."""

END_DERIVATIVE_ORDERS = (4, 3, 2)
KLEIN_EDGE = 2.0 / np.sqrt(3.0)  # 2c, the side of the Klein square, is also L = 1/c - c


def sample_parameters() -> Array:
    """Parameters of the samples along u and v, a little beyond [0, 1] at both ends: (NODES,)."""
    cosine = np.cos(np.pi * np.arange(CHEBYSHEV_NODES)[::-1] / (CHEBYSHEV_NODES - 1))
    return 0.5 + (0.5 + SAMPLE_OVERHANG) * cosine


def fit_g2_patches(samples: Array, degree: int) -> Array:
    """Bezier poles (P, degree + 1, degree + 1, 3) of patches sampled on `sample_parameters` squared (P, NODES, NODES, 3)."""
    if degree < MIN_DEGREE:
        raise ValueError(f"degree {degree} leaves a side too few poles; the least is {MIN_DEGREE}")
    rule = _fit_operators(degree)
    poles = np.zeros((len(samples), degree + 1, degree + 1, 3))
    for flip in (False, True):  # sides u = 0 and u = 1, then the same for v by exchanging the parameters
        values = samples.swapaxes(1, 2) if flip else samples
        target = poles.swapaxes(1, 2) if flip else poles
        for end in (0, 1):
            strip = _boundary_strip(values, end, rule)
            rows = slice(0, 3) if end == 0 else slice(degree - 2, degree + 1)
            target[:, rows] = strip if end == 0 else strip[:, ::-1]
    residual = np.einsum("am,pmnk,bn->pabk", rule.at_sites, samples, rule.at_sites, optimize=True) - np.einsum(
        "ai,pijk,bj->pabk", rule.basis, poles, rule.basis, optimize=True
    )
    poles[:, 3:-3, 3:-3] = np.einsum("ia,pabk,jb->pijk", rule.inner, residual, rule.inner, optimize=True)
    return poles


def bezier_surface(poles: Array) -> BSplineSurface:
    """One patch's poles as a surface on the unit square."""
    degree = len(poles) - 1
    knots = np.repeat([0.0, 1.0], degree + 1)
    return BSplineSurface(poles, knots, knots, degree, degree)


@dataclass(frozen=True, slots=True, eq=False)
class _FitOperators:
    """The linear operators of one degree, nodal values (NODES) in, Bernstein coefficients (degree + 1) out."""

    along: tuple[Array, Array, Array]  # for C, d1, d2
    times_y_slope: Array  # Bernstein coefficients of f -> those of y f'
    times_y2_bend: Array  # of f -> y^2 f''
    at_sites: Array
    basis: Array
    inner: Array


def _boundary_strip(samples: Array, end: int, rule: _FitOperators) -> Array:
    """The three rows of poles next to the side u = end, outermost first: (P, 3, degree + 1, 3)."""
    t = sample_parameters()
    y = (KLEIN_EDGE * (t - 0.5))[None, :, None]
    length = KLEIN_EDGE
    out = 1.0 if end == 1 else -1.0  # xi grows outwards
    x, x_xi, x_xixi = (
        np.einsum("m,pmnk->pnk", _evaluation_matrix(np.array([float(end)]), order)[0], samples)
        * (out / KLEIN_EDGE) ** order
        for order in range(3)
    )

    def slope(f: Array, order: int) -> Array:
        return np.einsum("mn,pnk->pmk", _evaluation_matrix(t, order), f) / KLEIN_EDGE**order

    d1 = length * x_xi - y * slope(x, 1)
    d2 = (
        length**2 * x_xixi
        - 2 * y * length * slope(x_xi, 1)
        + y**2 * slope(x, 2)
        - 2 * length * x_xi
        + 2 * y * slope(x, 1)
    )
    c, d1, d2 = (np.einsum("in,pnk->pik", m, f) for m, f in zip(rule.along, (x, d1, d2), strict=True))

    def applied(operator: Array, f: Array) -> Array:
        return np.einsum("ij,pjk->pik", operator, f)

    first = (d1 + applied(rule.times_y_slope, c)) / length
    second = (
        d2
        + 2 * length * applied(rule.times_y_slope, first)
        - applied(rule.times_y2_bend, c)
        + 2 * length * first
        - 2 * applied(rule.times_y_slope, c)
    ) / length**2
    degree = len(rule.basis[0]) - 1
    # Derivatives by the inward parameter w in [0, 1]: d/dw = -KLEIN_EDGE d/dxi.
    inward, bend = -KLEIN_EDGE * first, KLEIN_EDGE**2 * second
    row1 = c + inward / degree
    row2 = bend / (degree * (degree - 1)) + 2 * row1 - c
    return np.stack([c, row1, row2], axis=1)


@lru_cache(maxsize=1)
def _inverse_vandermonde() -> Array:
    return np.asarray(
        np.linalg.inv(chebyshev.chebvander(_to_chebyshev(sample_parameters()), CHEBYSHEV_NODES - 1)), float
    )


def _to_chebyshev(t: Array) -> Array:
    return (t - 0.5) / (0.5 + SAMPLE_OVERHANG)


def _evaluation_matrix(t: Array, order: int) -> Array:
    """Nodal values -> the interpolant's derivative of that order at t: (len(t), NODES)."""
    coefficients = np.eye(CHEBYSHEV_NODES)
    for _ in range(order):
        coefficients = chebyshev.chebder(coefficients, axis=0) / (0.5 + SAMPLE_OVERHANG)
    values = chebyshev.chebvander(_to_chebyshev(t), len(coefficients) - 1) @ coefficients
    return np.asarray(values @ _inverse_vandermonde())


def _bernstein_matrix(t: Array, degree: int, order: int = 0) -> Array:
    knots = np.repeat([0.0, 1.0], degree + 1)
    return np.asarray(BSpline(knots, np.eye(degree + 1), degree)(t, order))


@lru_cache(maxsize=16)
def _fit_operators(degree: int) -> _FitOperators:
    sites = 0.5 * (1 - np.cos(np.pi * (np.arange(3 * degree) + 0.5) / (3 * degree)))
    basis, at_sites = _bernstein_matrix(sites, degree), _evaluation_matrix(sites, 0)
    ends = np.array([0.0, 1.0])
    along = []
    for top in END_DERIVATIVE_ORDERS:
        fixed = np.concatenate([_bernstein_matrix(ends, degree, k) for k in range(top + 1)])
        given = np.concatenate([_evaluation_matrix(ends, k) for k in range(top + 1)])
        scale = np.abs(fixed).max(axis=1, keepdims=True)  # rows of order k are of size degree^k
        particular = np.linalg.pinv(fixed / scale) @ (given / scale)
        free = null_space(fixed / scale)
        correction = free @ np.linalg.pinv(basis @ free) @ (at_sites - basis @ particular) if free.size else 0.0
        along.append(particular + correction)
    own = 0.5 * (1 - np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1)))
    to_bernstein = np.linalg.inv(_bernstein_matrix(own, degree))
    y = (KLEIN_EDGE * (own - 0.5))[:, None]
    return _FitOperators(
        along=(along[0], along[1], along[2]),
        times_y_slope=to_bernstein @ (y * _bernstein_matrix(own, degree, 1) / KLEIN_EDGE),
        times_y2_bend=to_bernstein @ (y**2 * _bernstein_matrix(own, degree, 2) / KLEIN_EDGE**2),
        at_sites=at_sites,
        basis=basis,
        inner=np.asarray(np.linalg.pinv(basis[:, 3:-3]), float),
    )
