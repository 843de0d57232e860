"""Many patches fitted at once, each on its own, that join with curvature continuity (G2) without knowing their neighbours.

On a lattice bent by a coordinate map no patch is a copy of another. All patches are charts of one analytic surface, however,
and neighbouring charts differ by the projective half-turn of the Klein model. In one chart let xi be the coordinate out of the
patch, y the coordinate along the side, and L = 1/c - c with c = 1/sqrt 3 half the Klein square. The second-order Taylor
expansion of the half-turn (xi, y) -> -L / (L - 2 xi) (xi, y) shows that the data of the side

    C = X,   d1 = L X_xi - y X_y,   d2 = L^2 X_xixi - 2 y L X_xiy + y^2 X_yy - 2 L X_xi + 2 y X_y

reach the neighbour as C, -d1, d2 at -y. If both patches take the same polynomials for them, they join G2.

**Conditions.** The polynomials of degree p come from the exact surface by a rule that treats both patches alike: least squares
with exact derivatives at the ends, up to order 4 for C, 3 for d1 and 2 for d2. These orders are just what makes the two
strips of a corner agree on their common 3 x 3 poles, at vertices of six patches too. The strips determine three rows of
poles along each side.

**Fit.** The remaining poles are those of CPIA (`splines.cpia`) under the condition that the strips stay as they
are: the iteration runs in coordinates of the inner Bernstein polynomials that are orthonormal on Chebyshev points, for all
patches together. One step reaches the limit, and the next difference proves how near it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import null_space, solve_triangular

from tpmscad._typing import Array
from tpmscad.splines.affine_subspace import unconstrained_subspace
from tpmscad.splines.basis import apply_bases, bernstein_basis
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.chart_fit import make_break_knots
from tpmscad.splines.cpia import NetConvergence, solve_cpia

MIN_DEGREE = 9
"""Ten poles along a side: five derivatives at each end."""

CHEBYSHEV_NODES = 48
"""Chebyshev nodes along each parameter that carry the exact surface; fewer nodes leave larger tangent jumps at the joints."""

PIECE_NODES = 32
"""The same of pieces of a patch, which are half as large."""

SAMPLE_OVERHANG = 0.04
"""The nodes reach this far beyond the patch, where the surface continues: derivatives on the border are then interior ones."""

END_DERIVATIVE_ORDERS = (4, 3, 2)
"""Orders of the derivatives that C, d1 and d2 take over exactly at both ends of a side."""

KLEIN_EDGE = 2.0 / np.sqrt(3.0)
"""2 c, the side of the Klein square, which is also L = 1/c - c."""


def sample_parameters(nodes: int = CHEBYSHEV_NODES) -> Array:
    """Parameters of the samples along u and v, which reach a little beyond [0, 1] at both ends: (nodes,)."""
    cosine = np.cos(np.pi * np.arange(nodes)[::-1] / (nodes - 1))
    return 0.5 + (0.5 + SAMPLE_OVERHANG) * cosine


def find_least_coefficients(values: Array) -> Array:
    """The greatest of the last Chebyshev coefficients (P,) of functions sampled at `sample_parameters` squared, (P, n, n)."""
    inverse = _inverse_vandermonde(values.shape[1])
    size = np.abs(np.einsum("am,pmn,bn->pab", inverse, values, inverse, optimize=True))
    return np.maximum(size[:, -3:].max(axis=(1, 2)), size[:, :, -3:].max(axis=(1, 2)))


def fit_g2_patches(samples: Array, degree: int) -> tuple[Array, NetConvergence]:
    """Bezier poles (P, degree + 1, degree + 1, 3) of patches sampled at `sample_parameters` squared, and their convergence.

    samples: (P, n, n, 3), or (P, k, k, n, n, 3) of the k x k pieces of each patch, which are fitted apart and join as patches do:
    (P, k, k, degree + 1, degree + 1, 3). ValueError below MIN_DEGREE.
    """
    if degree < MIN_DEGREE:
        raise ValueError(f"degree {degree} leaves a side too few poles; the least is {MIN_DEGREE}")
    operators = _fit_operators(degree, samples.shape[-2])
    pieces = 1 if samples.ndim == 4 else samples.shape[1]
    poles = _fit_boundary_strips(samples.reshape(-1, pieces, pieces, *samples.shape[-3:]), degree)
    shape = (*samples.shape[:-3], *poles.shape[3:])
    poles, samples = poles.reshape(-1, *poles.shape[3:]), samples.reshape(-1, *samples.shape[-3:])
    to_sites, basis = operators.values_at_sites, operators.basis
    data = apply_bases(to_sites, samples, to_sites) - apply_bases(basis, poles, basis)
    data = np.moveaxis(data, 0, 2)
    sites, inner = operators.inner_basis.shape
    solution = solve_cpia(
        data.reshape(sites, sites, -1),
        operators.inner_basis,
        operators.inner_basis,
        unconstrained_subspace(inner**2 * data[0, 0].size),
    )
    half = solve_triangular(operators.inner_triangle, solution.coordinates.reshape(inner, -1))
    half = half.reshape(inner, inner, len(samples), 3).swapaxes(0, 1)
    inner_poles = solve_triangular(operators.inner_triangle, half.reshape(inner, -1)).reshape(half.shape)
    poles[:, 3:-3, 3:-3] = inner_poles.transpose(2, 1, 0, 3)
    # At the sites |S| <= |row_u| |row_v| |x|; between them a polynomial of degree p exceeds its values at N Chebyshev
    # points by at most the factor 1 / cos(pi p / 2 N) per direction (Ehlich, Zeller, Math. Z. 86 (1964)).
    at_sites = float((operators.inner_basis**2).sum(axis=1).max())
    convergence = solution.convergence(at_sites / float(np.cos(np.pi * degree / (2 * sites))) ** 2)
    return poles.reshape(shape), convergence


def join_pieces(poles: Array) -> BSplineSurface:
    """The patch over the unit square whose k x k pieces have Bezier poles (k, k, p + 1, p + 1, 3), twice differentiable."""
    pieces, degree = poles.shape[0], poles.shape[2] - 1
    rows = _join_along(np.moveaxis(poles, 2, 1))  # (k, p + 1, k, p + 1, 3) -> (U, k, p + 1, 3)
    net = np.moveaxis(_join_along(np.moveaxis(rows, 0, 2)), 0, 1)
    knots = _piece_knots(pieces, degree)
    return BSplineSurface(np.ascontiguousarray(net), knots, knots, degree, degree)


@lru_cache(maxsize=16)
def _piece_knots(pieces: int, degree: int) -> Array:
    """The knots of patches of so many pieces, which all of them share."""
    knots = make_break_knots(np.linspace(0.0, 1.0, pieces + 1), np.full(pieces - 1, 2), degree)
    knots.flags.writeable = False
    return knots


def _join_along(poles: Array) -> Array:
    """Poles (n, ...) of a spline with knots of multiplicity p - 2 from those of its pieces, (k, p + 1, ...).

    A pole is the polar form at p consecutive knots (Ramshaw 1989). Where these reach over a knot on either side, they differ from
    those of a pole of the left piece in one argument, of which the polar form is an affine function.
    """
    beyond = (2 * poles[:-1, -2] - poles[:-1, -3])[:, None]
    between = np.concatenate([poles[:-1, 2:-2], beyond], axis=1)
    return np.concatenate([poles[0, :2], *between, poles[-1, 2:]])


@dataclass(frozen=True, slots=True, eq=False)
class _FitOperators:
    """Linear operators of one degree p. "Nodal" are values at the parameters of the samples."""

    side_operators: tuple[Array, Array, Array]  # nodal values of C, d1, d2 -> their Bernstein coefficients
    values_at_sites: Array  # nodal values -> values at the 3 p fitting sites
    basis: Array  # Bernstein polynomials at the sites: (3 p, p + 1)
    inner_basis: Array  # the span of the inner ones, orthonormal on the sites: (3 p, p - 5)
    inner_triangle: Array  # inner poles -> coordinates in that basis: (p - 5, p - 5)


@dataclass(frozen=True, slots=True, eq=False)
class _SideTerms:
    """The factors in the data of one side of a piece: d1 = stretch X_xi - y X_y, and d2 is less by 2 turn d1.

    On a side of the patch they are L, the coordinate y and 1; between pieces of a patch, where the neighbour has the same
    chart, they are 1, 0 and 0.
    """

    stretch: float
    y: Array  # at the nodes: (n, 1)
    turn: float
    y_times_derivative: Array  # Bernstein coefficients of f -> those of y f'
    y2_times_second_derivative: Array  # Bernstein coefficients of f -> those of y^2 f''


def _fit_boundary_strips(samples: Array, degree: int) -> Array:
    """Poles (P, k, k, p + 1, p + 1, 3) whose three outer rows along every side are those of the G2 conditions, the others zero.

    samples: (P, k, k, n, n, 3).
    """
    pieces = samples.shape[1]
    poles = np.zeros((*samples.shape[:3], degree + 1, degree + 1, 3))
    for swapped in (False, True):  # sides u = 0 and u = 1, then those of v by exchanging the parameters
        values = samples.transpose(0, 2, 1, 4, 3, 5) if swapped else samples
        target = poles.transpose(0, 2, 1, 4, 3, 5) if swapped else poles
        for end, row, column in np.ndindex(2, pieces, pieces):
            place = column if row == end * (pieces - 1) else None
            side = _side_terms(degree, samples.shape[-2], pieces, place)
            strip = _boundary_strip(values[:, row, column], end, degree, pieces, side)
            if end == 0:
                target[:, row, column, :3] = strip
            else:
                target[:, row, column, -3:] = strip[:, ::-1]
    return poles


def _boundary_strip(samples: Array, end: int, degree: int, pieces: int, side: _SideTerms) -> Array:
    """The three rows of poles next to the side u = end of one piece, outermost first: (P, 3, degree + 1, 3)."""
    nodes, edge = samples.shape[1], KLEIN_EDGE / pieces
    t = sample_parameters(nodes)
    outward = 1.0 if end == 1 else -1.0  # the direction of u in which xi grows
    rows = [
        _evaluation_matrix(np.array([float(end)]), order, nodes)[0] * (outward / edge) ** order for order in range(3)
    ]
    x, x_xi, x_xixi = np.einsum("kn,pnmd->kpmd", np.array(rows), samples)

    def along(f: Array, order: int) -> Array:
        """Derivative by y."""
        return _evaluation_matrix(t, order, nodes) @ f / edge**order

    y, stretch, turn = side.y, side.stretch, side.turn
    d1 = stretch * x_xi - y * along(x, 1)
    d2 = stretch**2 * x_xixi - 2 * y * stretch * along(x_xi, 1) + y**2 * along(x, 2) - 2 * turn * d1
    c, d1, d2 = (m @ f for m, f in zip(_fit_operators(degree, nodes).side_operators, (x, d1, d2), strict=True))
    # X_xi and X_xixi from C, d1, d2, as Bernstein coefficients.
    slope = side.y_times_derivative
    first = (d1 + slope @ c) / stretch
    second = (d2 + 2 * stretch * (slope @ first) - side.y2_times_second_derivative @ c + 2 * turn * d1) / stretch**2
    # Derivatives by the inward parameter w in [0, 1]: d/dw = -edge d/dxi.
    row1 = c - edge * first / degree
    row2 = edge**2 * second / (degree * (degree - 1)) + 2 * row1 - c
    return np.stack([c, row1, row2], axis=1)


@lru_cache(maxsize=64)
def _side_terms(degree: int, nodes: int, pieces: int, place: int | None) -> _SideTerms:
    """Of the piece that is the `place`-th along a side of its patch, or of a side between pieces."""
    nothing = np.zeros((degree + 1, degree + 1))
    if place is None:
        return _SideTerms(1.0, np.zeros((nodes, 1)), 0.0, nothing, nothing)

    def coordinate(t: Array) -> Array:
        return np.asarray(KLEIN_EDGE * ((place + t) / pieces - 0.5))[:, None]

    edge, sites = KLEIN_EDGE / pieces, _chebyshev_points(degree + 1)
    y, to_bernstein = coordinate(sites), np.linalg.inv(bernstein_basis(degree, sites))
    return _SideTerms(
        KLEIN_EDGE,
        coordinate(sample_parameters(nodes)),
        1.0,
        to_bernstein @ (y * bernstein_basis(degree, sites, 1) / edge),
        to_bernstein @ (y**2 * bernstein_basis(degree, sites, 2) / edge**2),
    )


def _chebyshev_points(count: int) -> Array:
    """Chebyshev points of the first kind on [0, 1]: (count,)."""
    return np.asarray(0.5 * (1 - np.cos(np.pi * (np.arange(count) + 0.5) / count)))


@lru_cache(maxsize=4)
def _inverse_vandermonde(nodes: int) -> Array:
    """Nodal values -> Chebyshev coefficients."""
    return np.asarray(np.linalg.inv(chebyshev.chebvander(_to_chebyshev(sample_parameters(nodes)), nodes - 1)), float)


def _to_chebyshev(t: Array) -> Array:
    """Parameters carried to [-1, 1], the interval of the nodes."""
    return (t - 0.5) / (0.5 + SAMPLE_OVERHANG)


def _evaluation_matrix(t: Array, order: int, nodes: int) -> Array:
    """Nodal values -> derivative of that order of the interpolant at t: (len(t), nodes)."""
    coefficients = np.eye(nodes)
    for _ in range(order):
        coefficients = chebyshev.chebder(coefficients, axis=0) / (0.5 + SAMPLE_OVERHANG)
    values = chebyshev.chebvander(_to_chebyshev(t), len(coefficients) - 1) @ coefficients
    return np.asarray(values @ _inverse_vandermonde(nodes))


@lru_cache(maxsize=16)
def _fit_operators(degree: int, nodes: int) -> _FitOperators:
    sites = _chebyshev_points(3 * degree)
    basis, values_at_sites = bernstein_basis(degree, sites), _evaluation_matrix(sites, 0, nodes)
    ends = np.array([0.0, 1.0])
    side_operators = []
    for highest in END_DERIVATIVE_ORDERS:
        fixed = np.concatenate([bernstein_basis(degree, ends, k) for k in range(highest + 1)])
        given = np.concatenate([_evaluation_matrix(ends, k, nodes) for k in range(highest + 1)])
        scale = np.abs(fixed).max(axis=1, keepdims=True)  # rows of order k are of size degree^k
        particular = np.linalg.pinv(fixed / scale) @ (given / scale)
        free = null_space(fixed / scale)
        correction = free @ np.linalg.pinv(basis @ free) @ (values_at_sites - basis @ particular) if free.size else 0.0
        side_operators.append(particular + correction)
    inner_basis, triangle = np.linalg.qr(basis[:, 3:-3])
    return _FitOperators(
        side_operators=(side_operators[0], side_operators[1], side_operators[2]),
        values_at_sites=values_at_sites,
        basis=basis,
        inner_basis=inner_basis,
        inner_triangle=triangle,
    )
