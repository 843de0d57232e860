"""Gyroid, Diamond and Schwarz P from the Enneper-Weierstrass integrals, to machine precision up to the flat points.

Units are those of the integrals themselves ("raw"): the curvature is 2 at the centre of the patch. With the spinor
(alpha, beta) of `spinor_series`, holomorphic in the disc coordinate t, and the Bonnet rotation e^(i theta), the surface
(TPMS2STEP, eq. 1, with its factor e^(i theta) moved inside Re) and its normal are

    X = Re e^(i theta) int phi dt,    phi = (alpha^2 - beta^2, i (alpha^2 + beta^2), 2 alpha beta),
    n = (2 Re(conj(alpha) beta), 2 Im(conj(alpha) beta), |beta|^2 - |alpha|^2) / m,    m = |alpha|^2 + |beta|^2.

Associates share their normals. With W = alpha beta' - alpha' beta (zero at the flat points) all derivatives are closed forms:

    n_t = W conj(phi) / m^2,    n_t conj(t) = -2 |W|^2 / m^2 n,    principal curvatures +-2 |W| / m^2.

The parameters (x, y) are the coordinates of Klein's model of the disc, in which the quadrilateral is a square with straight
sides, |x|, |y| <= KLEIN_HALF_SIDE; the map (x, y) -> X is real-analytic and regular on the closed square, corners included.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

from tpmscad._typing import Array
from tpmscad.surfaces.spinor_series import SPINOR_A, SPINOR_B

KLEIN_HALF_SIDE = 1.0 / np.sqrt(3.0)
"""Half the side of the square in the Klein disc."""

MIN_CURVATURE_RADIUS = 0.5
"""Least radius of curvature, attained at the centre of the patch, in raw units."""

Complex = NDArray[np.complex128]

SpinorSeries = tuple[int, Array]
"""(first, c) stands for sum c[k] t^(4k + first), first in 0..3."""


def _product(p: SpinorSeries, q: SpinorSeries) -> SpinorSeries:
    return p[0] + q[0], np.convolve(p[1], q[1])[: len(p[1])]


def _derivative(p: SpinorSeries) -> SpinorSeries:
    first, c = p
    coefficients = (4.0 * np.arange(len(c)) + first) * c
    return (first - 1, coefficients) if first else (3, coefficients[1:])


def _integral(p: SpinorSeries) -> SpinorSeries:
    first, c = p
    return first + 1, c / (4.0 * np.arange(len(c)) + first + 1)


_ALPHA: SpinorSeries = (0, SPINOR_A)
_BETA: SpinorSeries = (1, SPINOR_B)
_ALPHA1, _BETA1 = _derivative(_ALPHA), _derivative(_BETA)
_TABLES = (
    *(_ALPHA, _ALPHA1, _derivative(_ALPHA1)),
    *(_BETA, _BETA1, _derivative(_BETA1)),
    *(_integral(_product(p, q)) for p, q in ((_ALPHA, _ALPHA), (_BETA, _BETA), (_ALPHA, _BETA))),
)


def evaluate_weierstrass(x: Array, y: Array, bonnet: complex) -> tuple[Array, Array]:
    """Surface and unit normal with their derivatives by x and y at Klein coordinates of one shape (...): two (6, 3, ...), raw.

    The first axis is value, x, y, xx, xy, yy, the second the coordinate. `bonnet` is e^(i theta): 1 for Diamond, i for
    Schwarz P.
    """
    t, *by_xy = _klein_to_poincare(x, y)
    powers = (np.ones_like(t), t, t * t, t * t * t)
    s = powers[2] ** 2
    alpha, alpha1, alpha2, beta, beta1, beta2, int_aa, int_bb, int_ab = (
        powers[first] * polyval(s, coefficients) for first, coefficients in _TABLES
    )
    phi = _null_vector(alpha * alpha, beta * beta, 2 * alpha * beta)
    phi1 = 2 * _null_vector(alpha * alpha1, beta * beta1, alpha * beta1 + alpha1 * beta)
    position = (bonnet * _null_vector(int_aa, int_bb, 2 * int_ab)).real

    alpha_sq, beta_sq = _abs_squared(alpha), _abs_squared(beta)
    m = alpha_sq + beta_sq
    m_t = alpha.conj() * alpha1 + beta.conj() * beta1
    cross = alpha.conj() * beta
    normal = np.stack([2 * cross.real, 2 * cross.imag, beta_sq - alpha_sq]) / m
    w = alpha * beta1 - alpha1 * beta
    w_t = alpha * beta2 - alpha2 * beta
    n_t = (w / m**2) * phi.conj()
    n_tt = ((w_t - 2 * w * m_t / m) / m**2) * phi.conj()
    n_mixed = (-2 * _abs_squared(w) / m**2) * normal
    return (
        _chain_rule(position, 0.5 * bonnet * phi, 0.5 * bonnet * phi1, np.zeros_like(position), *by_xy),
        _chain_rule(normal, n_t, n_tt, n_mixed, *by_xy),
    )


def _chain_rule(
    value: Array,
    d: Complex,
    dd: Complex,
    mixed: Array,
    t_x: Complex,
    t_y: Complex,
    t_xx: Complex,
    t_xy: Complex,
    t_yy: Complex,
) -> Array:
    """Derivatives by x and y of a real function of t from its Wirtinger derivatives `d`, `dd`, `mixed` by t, tt and t conj(t)."""
    return np.stack(
        [
            value,
            2 * (d * t_x).real,
            2 * (d * t_y).real,
            2 * (dd * t_x**2 + d * t_xx).real + 2 * _abs_squared(t_x) * mixed,
            2 * (dd * t_x * t_y + d * t_xy).real + 2 * (t_x * t_y.conj()).real * mixed,
            2 * (dd * t_y**2 + d * t_yy).real + 2 * _abs_squared(t_y) * mixed,
        ]
    )


def _abs_squared(z: Complex) -> Array:
    """|z|^2."""
    return z.real**2 + z.imag**2


def _null_vector(p: Complex, q: Complex, r: Complex) -> Complex:
    """The vector (p - q, i (p + q), r); with p = alpha^2, q = beta^2, r = 2 alpha beta it is null: phi . phi = 0."""
    return np.stack([p - q, 1j * (p + q), r])


def _klein_to_poincare(x: Array, y: Array) -> tuple[Complex, Complex, Complex, Complex, Complex, Complex]:
    """Map from the Klein to the Poincare disc with its derivatives: t, t_x, t_y, t_xx, t_xy, t_yy.

    t = e^(i pi / 4) z / (1 + r) with z = x + iy, r = (1 - |z|^2)^(1/2). The rotation by an eighth of a turn takes the sides of
    the square to those of the quadrilateral.
    """
    z = x + 1j * y
    r = np.sqrt(1 - x * x - y * y)
    g = 1 / (1 + r)  # with the derivatives g_x = x g^2 / r and (g^2 / r)_x = x h
    g1 = g * g / r
    h = (2 * g / r + 1 / r**2) * g1
    turn = np.sqrt(0.5) * (1 + 1j)
    return (
        turn * z * g,
        turn * (g + z * x * g1),
        turn * (1j * g + z * y * g1),
        turn * (2 * x * g1 + z * (g1 + x * x * h)),
        turn * ((y + 1j * x) * g1 + z * x * y * h),
        turn * (2j * y * g1 + z * (g1 + y * y * h)),
    )
