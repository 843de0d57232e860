"""Spline bases: Bernstein polynomials, B-splines and Legendre polynomials, their derivatives and the maps between them.

Every basis function of the program is evaluated here. A knot vector holds its knots with repetition and has
len(knots) - degree - 1 basis functions. Two evaluators stand side by side because each is the fastest for its caller, and
because their results differ in the last digits:

- `design_matrix` and `design_matrices`: all basis functions at each parameter, dense. A patch has tens of basis functions, for
  which a dense matrix times the poles is faster than a sparse one. One span is evaluated as Bernstein polynomials
  from one table of powers; several spans are evaluated by SciPy's B-splines.
- `nonzero_basis`: only the degree + 1 basis functions that do not vanish, by the Cox-de Boor recursion. Trivariate tensor
  products with long knot vectors need these alone.

Thousands of curves with different knot vectors are evaluated by de Boor's algorithm in one call (`curve_batch`).

Sources: C. de Boor, A Practical Guide to Splines (2001), chapters IX and X; R. T. Farouki, Legendre-Bernstein basis
transformations, J. Comput. Appl. Math. 119 (2000), 145-160.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import comb, factorial

import numpy as np
from numpy.polynomial import legendre
from scipy.interpolate import BSpline

from tpmscad._typing import Array, IntArray


def knot_domain(knots: Array, degree: int) -> tuple[float, float]:
    """Ends of the interval on which the basis functions sum to one."""
    return float(knots[degree]), float(knots[-degree - 1])


def check_knot_counts(poles: Array, knots: Sequence[Array], degrees: Sequence[int]) -> None:
    """ValueError unless a control net (..., D) has as many knots along each of its parameters as poles and degree need."""
    for axis, (t, degree) in enumerate(zip(knots, degrees, strict=True)):
        if poles.ndim != len(knots) + 1 or len(t) != poles.shape[axis] + degree + 1:
            raise ValueError(
                f"poles {poles.shape} of degree {degree} along {'uvw'[axis]} need {poles.shape[axis] + degree + 1} knots, "
                f"not {len(t)}"
            )


def scipy_spline(knots: Array, coefficients: Array, degree: int) -> BSpline:
    """SciPy's B-spline without the validation, which takes longer than the evaluation of a few points."""
    return BSpline.construct_fast(np.asarray(knots, float), np.asarray(coefficients, float), degree)


def power_coefficients(knots: Array, coefficients: Array, degree: int) -> tuple[Array, Array]:
    """The polynomials of a spline function: breaks (m + 1,) of its spans, and coefficients (degree + 1, m), highest power first.

    The layout is that of SciPy's `PPoly`. `PPoly.from_spline` calls FITPACK's `splder`, whose work arrays hold six coefficients
    of a span: from degree 8 on it writes beyond them and the process crashes.
    """
    breaks = np.unique(knots)
    return breaks, _taylor_coefficients(scipy_spline(knots, coefficients, degree), breaks[:-1])


def span_polynomials(knots: Array, degree: int) -> tuple[Array, Array]:
    """The B-splines of each span as polynomials: ends (m + 1,) of the spans, coefficients (m, degree + 1, degree + 1).

    Coefficient (i, j, k) is of the j-th B-spline that is not zero in span i, highest power of the distance from its start first.
    """
    ends = np.asarray(knots[degree : len(knots) - degree], float)
    splines = scipy_spline(knots, np.eye(len(knots) - degree - 1), degree)
    powers = np.moveaxis(_taylor_coefficients(splines, ends[:-1]), 0, -1)
    span = np.arange(len(ends) - 1)[:, None]
    return ends, powers[span, span + np.arange(degree + 1)]


def _taylor_coefficients(spline: BSpline, at: Array) -> Array:
    """Derivatives over factorials (degree + 1, m, ...) at parameters (m,), from the highest order down."""
    return np.stack([spline(at, order) / factorial(order) for order in range(spline.k, -1, -1)])


def design_matrix(knots: Array, degree: int, t: Array, order: int = 0) -> Array:
    """Design (collocation) matrix: every basis function, or its derivative of the given order, at every parameter.

    Parameters
    ----------
    knots : ndarray, shape (n + degree + 1,)
        Knot vector with repetition.
    degree : int
        Polynomial degree.
    t : ndarray, shape (m,)
        Parameters. At the end of the domain the last span is evaluated, so that the matrix is one-sided there.
    order : int, optional
        Order of the derivative.

    Returns
    -------
    ndarray, shape (m, n)
        Basis functions in columns, parameters in rows.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import bezier_knots, design_matrix
    >>> design_matrix(bezier_knots(2), 2, np.array([0.5]))
    array([[0.25, 0.5 , 0.25]])
    """
    return design_matrices(knots, degree, t, (order,))[0]


def design_matrices(knots: Array, degree: int, t: Array, orders: Sequence[int]) -> list[Array]:
    """The design matrices of several orders of derivative at t (m,): each (m, len(knots) - degree - 1)."""
    t = np.asarray(t, float)
    n = len(knots) - degree - 1
    if n == degree + 1 and knots[0] == knots[degree] and knots[-1] == knots[n]:
        return _bernstein_matrices(float(knots[0]), float(knots[-1]), degree, t, orders)
    spline = scipy_spline(knots, np.eye(n), degree)
    return [np.asarray(spline(t, order)) for order in orders]


@lru_cache(maxsize=16)
def bezier_interpolation(degree: int) -> tuple[Array, Array]:
    """Chebyshev nodes on [0, 1] with both ends, symmetric to the bit, and the matrix from values there to Bezier poles."""
    half = (1 - np.cos(np.pi * np.arange(degree + 1) / degree)) / 2
    nodes = (half + (1 - half[::-1])) / 2
    return nodes, np.asarray(np.linalg.inv(bernstein_basis(degree, nodes)), float)


def bernstein_basis(degree: int, t: Array, order: int = 0) -> Array:
    """Bernstein polynomials on [0, 1], or their derivatives of the given order, at t (m,): (m, degree + 1)."""
    return _bernstein_matrices(0.0, 1.0, degree, np.asarray(t, float), (order,))[0]


def _bernstein_matrices(low: float, high: float, degree: int, t: Array, orders: Sequence[int]) -> list[Array]:
    """Bernstein polynomials on [low, high], differentiated: (m, degree + 1) for each order, from one table of powers."""
    width = high - low
    s = (t - low) / width
    highest = max(degree - min(orders), 0)
    rising, falling = _powers(s, highest), _powers(1 - s, highest)
    result = []
    for order in orders:
        rest = degree - order
        if rest < 0:
            result.append(np.zeros((len(t), degree + 1)))
            continue
        values = binomials(rest) * rising[: rest + 1] * falling[rest::-1]
        for k in range(rest + 1, degree + 1):  # B'_{i,k} = k (B_{i-1,k-1} - B_{i,k-1}) / width
            lower, values = values, np.empty((k + 1, len(t)))
            np.subtract(0.0, lower[0], out=values[0])
            np.subtract(lower[:-1], lower[1:], out=values[1:-1])
            values[-1] = lower[-1]
            values *= k / width
        result.append(np.ascontiguousarray(values.T))
    return result


def _powers(s: Array, degree: int) -> Array:
    """s^0 .. s^degree: (degree + 1, n)."""
    powers = np.empty((degree + 1, len(s)))
    powers[0] = 1.0
    for lower, higher in zip(powers[:-1], powers[1:], strict=True):
        np.multiply(lower, s, out=higher)
    return powers


@lru_cache(maxsize=64)
def binomials(degree: int) -> Array:
    """Binomial coefficients as a column: (degree + 1, 1)."""
    return np.array([[float(comb(degree, i))] for i in range(degree + 1)])


def nonzero_basis(knots: Array, degree: int, t: Array) -> tuple[IntArray, Array, Array]:
    """The basis functions that do not vanish at t (n,): index of the first (n,), values and slopes (n, degree + 1) each.

    By the Cox-de Boor recursion. At a knot the span above it is evaluated, at the end of the domain the last.
    """
    last = len(knots) - degree - 2
    span = np.clip(np.searchsorted(knots, t, side="right") - 1, degree, last)
    about = knots[span - degree + 1 + np.arange(2 * degree)[:, None]]
    return (span - degree, *nonzero_basis_of_spans(about, degree, t))


def nonzero_basis_of_spans(knots: Array, degree: int, t: Array) -> tuple[Array, Array]:
    """Values and slopes (n, degree + 1) at t (n,) of the basis functions on the spans in the middle of knots (2 degree, n)."""
    upper = [knots[degree - 1 + j] - t for j in range(1, degree + 1)]
    lower = [t - knots[degree - j] for j in range(1, degree + 1)]
    values = [np.ones(len(t))]
    ratios: list[Array] = []
    for j in range(1, degree + 1):
        ratios = [values[r] / (upper[r] + lower[j - 1 - r]) for r in range(j)]
        rising = [np.zeros(len(t))] + [lower[j - 1 - r] * ratios[r] for r in range(j)]
        falling = [upper[r] * ratios[r] for r in range(j)] + [np.zeros(len(t))]
        values = [a + b for a, b in zip(rising, falling, strict=True)]
    zero = np.zeros(len(t))
    slopes = [degree * (a - b) for a, b in zip([zero, *ratios], [*ratios, zero], strict=True)]
    return np.stack(values, axis=-1), np.stack(slopes, axis=-1)


def differentiate_poles(poles: Array, knots: Array, degree: int) -> tuple[Array, Array, int]:
    """Poles, knots and degree of the derivative along the first axis of the whole control net (N, M, D)."""
    gaps = knots[degree + 1 : -1] - knots[1 : -degree - 1]
    # A gap of zero belongs to a basis function that is zero: the spline is discontinuous there, its spans are not.
    factors = np.divide(degree, gaps, out=np.zeros_like(gaps), where=gaps > 0)
    return factors[:, None, None] * np.diff(poles, axis=0), knots[1:-1], degree - 1


def evaluate_bezier_patches(rows: Array, poles: Array, columns: Array) -> Array:
    """Points (n, k l, 3) of many Bezier patches (n, U, V, 3) on the grid of two design matrices (k, U), (l, V), u first."""
    return apply_bases(rows, poles, columns).reshape(len(poles), -1, 3)


def apply_bases(left: Array, grids: Array, right: Array) -> Array:
    """The products left @ grid @ right^T for every last component: (m, U), (..., U, V, D), (n, V) give (..., m, n, D)."""
    half = left @ grids.reshape(*grids.shape[:-2], -1)
    return right @ half.reshape(*half.shape[:-1], *grids.shape[-2:])


def apply_span_bases(left: Array, grids: Array, right: Array) -> Array:
    """The same for each pair of spans: (a, k, U), (..., U, V, D), (b, l, V) give (..., a, b, k, l, D)."""
    (a, k), (b, m) = left.shape[:2], right.shape[:2]
    found = apply_bases(left.reshape(a * k, -1), grids, right.reshape(b * m, -1))
    found = found.reshape(*grids.shape[:-3], a, k, b, m, grids.shape[-1])
    return np.ascontiguousarray(np.swapaxes(found, -4, -3))


@lru_cache(maxsize=64)
def second_differences(order: int) -> Array:
    """Matrix (order - 2, order) from a row of poles to their second differences."""
    return np.diff(np.eye(order), 2, axis=0)


@lru_cache(maxsize=64)
def bending_energy(rows: int, columns: int) -> Array:
    """Matrix (rows columns,) * 2 of the discrete thin-plate energy of a control net, which is alike in all directions.

    It is the sum of the squares of the second differences along either axis, and of twice the squares of the mixed ones.
    """
    eyes, steps = ([f(n) for n in (rows, columns)] for f in (np.eye, lambda n: np.diff(np.eye(n), axis=0)))
    parts = (
        np.kron(second_differences(rows), eyes[1]),
        np.kron(eyes[0], second_differences(columns)),
        np.sqrt(2) * np.kron(*steps),
    )
    return sum((each.T @ each for each in parts), np.zeros((rows * columns,) * 2))


def legendre_basis(degree: int, domain: tuple[float, float], t: Array, order: int = 0) -> Array:
    """Legendre polynomials orthonormal on [0, 1], carried to the domain, or derivatives, at t (m,): (m, degree + 1).

    The polynomial of degree i is at most sqrt(2 i + 1) in absolute value, which it attains at the ends.
    """
    low, high = domain
    scale = 2 / (high - low)
    series = np.diag(np.sqrt(2 * np.arange(degree + 1) + 1))
    for _ in range(order):
        series = legendre.legder(series, scl=scale)
    return np.asarray(legendre.legval(scale * (t - low) - 1, series)).T


def legendre_to_bernstein(degree: int) -> Array:
    """Bernstein coefficients of the Legendre polynomials orthonormal on [0, 1], one polynomial per column.

    Farouki (2000), eq. 20. The sums are of integers, hence exact.
    """
    n = degree
    matrix = np.empty((n + 1, n + 1))
    for i in range(n + 1):
        for j in range(n + 1):
            terms = range(max(0, i + j - n), min(i, j) + 1)
            total = sum((-1) ** (j + k) * comb(j, k) ** 2 * comb(n - j, i - k) for k in terms)
            matrix[i, j] = total / comb(n, i)
    return matrix * np.sqrt(2 * np.arange(n + 1) + 1)


@lru_cache(maxsize=256)
def bernstein_elevation_matrix(low: int, high: int) -> Array:
    """Bernstein coefficients of degree `high` from those of degree `low`: (high + 1, low + 1)."""
    return np.array(
        [
            [
                comb(low, j) * comb(high - low, i - j) / comb(high, i) if 0 <= i - j <= high - low else 0.0
                for j in range(low + 1)
            ]
            for i in range(high + 1)
        ]
    )


@lru_cache(maxsize=64)
def bernstein_product(p: int, q: int) -> Array:
    """Tensor (p + q + 1, p + 1, q + 1) from the Bernstein coefficients of two polynomials to those of their product."""
    product = np.zeros((p + q + 1, p + 1, q + 1))
    for i in range(p + 1):
        for j in range(q + 1):
            product[i + j, i, j] = comb(p, i) * comb(q, j) / comb(p + q, i + j)
    return product


@lru_cache(maxsize=256)
def halving_matrix(degree: int, half: int) -> Array:
    """Matrix from the Bernstein coefficients on [0, 1] to those on the first (1) or the second (2) half, by de Casteljau."""
    first = np.array([[comb(i, j) * 0.5**i if j <= i else 0.0 for j in range(degree + 1)] for i in range(degree + 1)])
    return first if half == 1 else first[::-1, ::-1]


@lru_cache(maxsize=256)
def side_pole_matrix(low: int, high: int, half: int, direction: int) -> Array | None:
    """Matrix from the poles of a Bezier curve to those of a part of it, elevated in degree and possibly reversed.

    `half` is 0 for the whole curve, 1 or 2 for its first or second half; `direction` is +1 or -1. None stands for the identity.
    """
    if low == high and half == 0 and direction > 0:
        return None
    matrix = halving_matrix(low, half) if half else np.eye(low + 1)
    matrix = bernstein_elevation_matrix(low, high) @ matrix
    return matrix if direction > 0 else matrix[::-1]
