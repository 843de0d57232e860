"""The patches against 60-digit arithmetic: the series derived again from first principles, the jets by differences.

The spinor's Taylor coefficients are exact rationals times powers of one constant, itself a quotient of Gamma functions. That
derivation is checked at its root against the hypergeometric closed form of t(tau) and the Weierstrass integrals.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import mpmath as mp
import numpy as np
import pytest

from tpmscad import surfaces
from tpmscad.surfaces import minimal_patch, spinor_series

TERMS = 32  # |t|^4 <= 0.0718 on the patch, 0.152 at the corners of the margin: below 1e-24
NAMES = [info.name for info in surfaces.CATALOGUE.values() if info.primitives == "exact"]


@pytest.fixture(autouse=True)
def sixty_digits():
    with mp.workdps(60):
        yield


def product(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    return [sum((a[i] * b[n - i] for i in range(n + 1)), Fraction(0)) for n in range(TERMS)]


def power(a: list[Fraction], exponent: Fraction) -> list[Fraction]:
    """a^exponent for a[0] = 1 (J. C. P. Miller's recurrence)."""
    c = [Fraction(1)]
    for n in range(1, TERMS):
        c.append(sum(((exponent * k - (n - k)) * a[k] * c[n - k] for k in range(1, n + 1)), Fraction(0)) / n)
    return c


def padded(*a: int) -> list[Fraction]:
    return [Fraction(x) for x in a] + [Fraction(0)] * (TERMS - len(a))


def solution(q: list[Fraction], first: int) -> list[Fraction]:
    """y = tau^first (1 + ...) with y'' + tau^2 q(tau^4) y = 0, as a series in tau^4."""
    c = [Fraction(1)]
    for n in range(1, TERMS):
        e = 4 * n + first
        c.append(-sum((q[k] * c[n - 1 - k] for k in range(n)), Fraction(0)) / (e * (e - 1)))
    return c


@cache
def rational_spinor() -> tuple[list[Fraction], list[Fraction], list[Fraction]]:
    """Coefficients in s = (t / C)^4 of alpha C^(1/2), of beta C^(1/2) / (t / C) and of tau / (t / C)."""
    p = padded(1, -14, 1)
    q = product(padded(36, 72, 36), power(p, Fraction(-2)))
    y2 = solution(q, 0)
    ratio = product(solution(q, 1), power(y2, Fraction(-1)))  # t / C = tau ratio(tau^4)
    tau = [power(ratio, Fraction(-(4 * k + 1)))[k] / (4 * k + 1) for k in range(TERMS)]  # Lagrange inversion
    outer = product(y2, power(p, Fraction(-1, 4)))
    inner = [Fraction(0), *power(tau, Fraction(4))[:-1]]
    alpha = padded()
    for c in reversed(outer):
        alpha = product(alpha, inner)
        alpha[0] += c
    return alpha, product(alpha, tau), tau


def scale() -> mp.mpf:
    corner = (mp.sqrt(3) - 1) / mp.sqrt(2)
    above = mp.gammaprod([mp.mpf(3) / 4, mp.mpf(11) / 24, mp.mpf(23) / 24], [])
    below = mp.gammaprod([mp.mpf(5) / 4, mp.mpf(5) / 24, mp.mpf(17) / 24], [])
    return mp.mpf(108) ** mp.mpf("0.25") * corner * above / below


@cache
def spinor_digits() -> tuple[list[mp.mpf], list[mp.mpf]]:
    alpha, beta, _ = rational_spinor()
    c = scale()
    digits = [[mp.mpf(x.numerator) / x.denominator for x in row] for row in (alpha, beta)]
    return (
        [x * c ** (-4 * k - mp.mpf("0.5")) for k, x in enumerate(digits[0])],
        [x * c ** (-4 * k - mp.mpf("1.5")) for k, x in enumerate(digits[1])],
    )


@cache
def integrands() -> list[list[mp.mpf]]:
    """Series of alpha^2, beta^2 / t^2 and alpha beta / t in t^4."""
    a, b = spinor_digits()
    return [[sum(p[i] * q[n - i] for i in range(n + 1)) for n in range(TERMS)] for p, q in ((a, a), (b, b), (a, b))]


def disc(u: mp.mpf, v: mp.mpf) -> mp.mpc:
    x, y = ((2 * w - 1) / mp.sqrt(3) for w in (u, v))
    return mp.expjpi(mp.mpf(1) / 4) * mp.mpc(x, y) / (1 + mp.sqrt(1 - x * x - y * y))


def raw(u: mp.mpf, v: mp.mpf, bonnet: mp.mpc) -> tuple[mp.matrix, mp.matrix]:
    """Position and normal in the Weierstrass frame, 60 digits."""
    t = disc(u, v)
    a, b = spinor_digits()
    aa, bb, ab = integrands()

    def integral(c: list[mp.mpf], first: int) -> mp.mpc:
        return sum(x * t ** (4 * k + first) / (4 * k + first) for k, x in enumerate(c))

    faa, fbb, fab = integral(aa, 1), integral(bb, 3), integral(ab, 2)
    position = [mp.re(bonnet * f) for f in (faa - fbb, 1j * (faa + fbb), 2 * fab)]
    tau = t * mp.polyval(b[::-1], t**4) / mp.polyval(a[::-1], t**4)
    square = abs(tau) ** 2
    return mp.matrix(position), mp.matrix([2 * tau.real, 2 * tau.imag, square - 1]) / (1 + square)


def constants(name: str) -> tuple[mp.mpc, mp.mpf, mp.matrix]:
    k, k1 = mp.ellipk(mp.mpf(1) / 4), mp.ellipk(mp.mpf(3) / 4)
    theta = mp.acot(k1 / k)
    bonnet, cell = {
        "gyroid": (mp.expj(theta), 2 * k * mp.cos(theta)),
        "diamond": (mp.mpc(1), 2 * k),
        "schwarz_p": (mp.mpc(0, 1), k1),
    }[name]
    return bonnet, cell, mp.matrix(minimal_patch.PLACEMENTS[name].centre)


def nodal_function(name: str, p: mp.matrix) -> mp.mpf:
    angles = {c: 2 * mp.pi * x for c, x in zip("xyz", p, strict=True)}
    return eval(surfaces.CATALOGUE[name].formula, {"sin": mp.sin, "cos": mp.cos} | angles)


def exact(name: str, reference: str, u: mp.mpf, v: mp.mpf, offset: mp.mpf) -> mp.matrix:
    bonnet, cell, centre = constants(name)
    root = mp.sqrt(mp.mpf(1) / 2)
    axes = mp.matrix([[root, root, 0], [-root, root, 0], [0, 0, 1]])
    position, normal = raw(u, v, bonnet)
    position, normal = axes * position / cell + centre, axes * normal
    if reference == "nodal":
        height = mp.findroot(lambda h: nodal_function(name, position + h * normal), mp.mpf(0))
        position = position + height * normal
        h = mp.mpf(10) ** -16
        steps = [h * mp.matrix([int(i == j) for j in range(3)]) for i in range(3)]
        slope = mp.matrix([nodal_function(name, position + s) - nodal_function(name, position - s) for s in steps])
        normal = slope / mp.norm(slope)
    return position + offset * normal


@pytest.mark.slow
def test_the_tables_are_the_rational_series_to_the_last_bit() -> None:
    for table, digits in zip((spinor_series.SPINOR_A, spinor_series.SPINOR_B), spinor_digits(), strict=True):
        np.testing.assert_array_equal(table, [float(x) for x in digits[: len(table)]])


def test_the_terms_left_out_are_below_round_off() -> None:
    left = [x for digits in spinor_digits() for x in digits[len(spinor_series.SPINOR_A) :]]
    edge = (2 * minimal_patch.KLEIN_HALF_SIDE * (0.5 + surfaces.PARAMETER_MARGIN)) * np.sqrt(
        2.0
    )  # |z| at the margin's corner
    for radius in (spinor_series.CORNER_RADIUS, edge / (1 + np.sqrt(1 - edge**2))):
        exponents = 4 * np.arange(len(spinor_series.SPINOR_A), TERMS)
        tail = np.abs(np.array([float(x) for x in left])).reshape(2, -1) * exponents**2 * radius ** (exponents - 2)
        assert tail.sum() < 2e-15


def test_the_coordinate_is_the_quotient_of_hypergeometric_functions() -> None:
    _, _, tau_of_t = rational_spinor()
    for t in (mp.mpc("0.21", "0.13"), mp.mpc("-0.1", "0.3")):
        s = t / scale()
        tau = sum(mp.mpf(x.numerator) / x.denominator * s ** (4 * k + 1) for k, x in enumerate(tau_of_t))
        p = tau**8 - 14 * tau**4 + 1
        j = -108 * tau**4 * (1 + tau**4) ** 4 / p**3
        f1 = mp.hyp2f1(mp.mpf(11) / 24, mp.mpf(7) / 24, mp.mpf(5) / 4, j)
        f2 = mp.hyp2f1(mp.mpf(5) / 24, mp.mpf(1) / 24, mp.mpf(3) / 4, j)
        assert abs(scale() * tau * (1 + tau**4) * p ** mp.mpf("-0.75") * f1 / f2 - t) < 1e-20


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_points_are_the_weierstrass_integrals_up_to_their_own_gauss_image(name: str) -> None:
    bonnet, cell, centre = constants(name)
    surface = surfaces.primitive_patch(name)
    x = np.sqrt(0.5) * np.array([[1, 1, 0], [-1, 1, 0], [0, 0, np.sqrt(2)]])  # Weierstrass to cubic axes
    for u, v in ((0.2, 0.35), (0.83, 0.6), (0.45, 0.99)):
        at = surface.jet(u, v)
        n = at.normal @ x
        tau = mp.mpc(*(n[:2] / (1 - n[2])))

        def r(z: mp.mpc) -> mp.mpc:
            return 1 / mp.sqrt(z**8 - 14 * z**4 + 1)

        integrals = [
            mp.quad(lambda z, f=f: f(z) * r(z), [0, tau])
            for f in (lambda z: 1 - z**2, lambda z: 1j * (1 + z**2), lambda z: 2 * z)
        ]
        expected = np.array([float(mp.re(bonnet * i)) for i in integrals]) @ x.T / float(cell)
        np.testing.assert_allclose(at.position - np.array(centre, float).ravel(), expected, rtol=0, atol=2e-15)


@pytest.mark.slow
@pytest.mark.parametrize("reference", ["minimal", "nodal"])
@pytest.mark.parametrize("name", NAMES)
def test_jets_hold_thirteen_digits_on_the_closed_patch(name: str, reference: str) -> None:
    surface = surfaces.primitive_patch(name, reference)
    h = mp.mpf(10) ** -9
    for u, v, offset in ((0.3, 0.9, 0.0), (1.049, -0.05, -0.11), (1.0, 0.0, 0.13)):
        f = {
            (i, j): exact(name, reference, mp.mpf(u) + i * h, mp.mpf(v) + j * h, mp.mpf(offset))
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        }
        expected = [
            f[0, 0],
            (f[1, 0] - f[-1, 0]) / (2 * h),
            (f[0, 1] - f[0, -1]) / (2 * h),
            (f[1, 0] - 2 * f[0, 0] + f[-1, 0]) / h**2,
            (f[1, 1] - f[1, -1] - f[-1, 1] + f[-1, -1]) / (4 * h**2),
            (f[0, 1] - 2 * f[0, 0] + f[0, -1]) / h**2,
        ]
        at = surface.jet(u, v, offset)
        measured = (at.position, at.du, at.dv, at.duu, at.duv, at.dvv)
        for name_of, e, m in zip(("X", "u", "v", "uu", "uv", "vv"), expected, measured, strict=True):
            np.testing.assert_allclose(
                m, np.array(e, float).ravel(), rtol=0, atol=1e-13, err_msg=f"{name_of} at {u}, {v}"
            )
