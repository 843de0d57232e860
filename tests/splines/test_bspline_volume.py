"""Trivariate splines: their volumes, their Jacobian determinants, and the proof that these are positive."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad._typing import Array
from tpmscad.splines import BSplineSurface, BSplineVolume, bezier_knots, ruled_volume, uniform_knots
from tpmscad.splines.jacobian_bounds import bernstein_jacobian, bound_jacobian, multiply_bernstein

RNG = np.random.default_rng(7)
DEGREES = (3, 2, 1)


def make_body(bend: float, spans: tuple[int, int, int] = (2, 3, 1)) -> BSplineVolume:
    """A block of 3 x 2 x 1 with poles moved at random by at most `bend`."""
    knots = tuple(uniform_knots(n, p) for n, p in zip(spans, DEGREES, strict=True))
    axes = [
        size * np.array([k[i + 1 : i + p + 1].mean() for i in range(len(k) - p - 1)])
        for k, p, size in zip(knots, DEGREES, (3, 2, 1), strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return BSplineVolume(grid + bend * RNG.uniform(-1, 1, grid.shape), (knots[0], knots[1], knots[2]), DEGREES)


def evaluate_bernstein(coefficients: Array, at: Array) -> Array:
    """A trivariate Bernstein polynomial at points (n, 3), by the definition."""
    from scipy.special import binom

    rows = []
    for axis in range(3):
        n = coefficients.shape[axis] - 1
        i, t = np.arange(n + 1), at[:, axis, None]
        rows.append(binom(n, i) * t**i * (1 - t) ** (n - i))
    return np.einsum("ijk,ni,nj,nk->n", coefficients, *rows)


def test_the_volume_is_that_inside_the_boundary() -> None:
    """Divergence theorem: a third of the flux of x through the six sides, by rules of many points."""
    body = make_body(0.1)
    x, weights = np.polynomial.legendre.leggauss(12)
    flux = 0.0
    for axis in range(3):
        for last in (False, True):
            side = body.end(axis, last)
            for u0, u1 in zip(np.unique(side.knots_u)[:-1], np.unique(side.knots_u)[1:], strict=True):
                for v0, v1 in zip(np.unique(side.knots_v)[:-1], np.unique(side.knots_v)[1:], strict=True):
                    u, v = u0 + (u1 - u0) * (1 + x) / 2, v0 + (v1 - v0) * (1 + x) / 2
                    normal = np.cross(side.grid(u, v, 1, 0), side.grid(u, v, 0, 1))
                    value = np.einsum("ijk,ijk,i,j->", side.grid(u, v), normal, weights, weights)
                    sign = (1 if last else -1) * (-1 if axis == 1 else 1)
                    flux += sign * value * (u1 - u0) * (v1 - v0) / 4
    assert body.integrate_volume() == pytest.approx(flux / 3, rel=1e-13)
    assert body.reversed_w().integrate_volume() == pytest.approx(-flux / 3, rel=1e-13)


def test_spans_as_bezier_nets_are_the_body() -> None:
    body = make_body(0.2)
    nets = body.bezier_nets()
    assert nets.shape == (6, 4, 3, 2, 3)
    inside = RNG.random((5, 3))
    lows = [(i / 2, j / 3, 0.0) for i in range(2) for j in range(3)]
    for net, low in zip(nets, lows, strict=True):
        at = np.array(low) + inside * [1 / 2, 1 / 3, 1.0]
        wanted = np.array([body.grid(*p[:, None])[0, 0, 0] for p in at])
        found = np.stack([evaluate_bernstein(net[..., c], inside) for c in range(3)], axis=-1)
        np.testing.assert_allclose(found, wanted, atol=1e-13)


def test_products_of_bernstein_polynomials_are_products() -> None:
    first, second = RNG.normal(size=(1, 4, 2, 3)), RNG.normal(size=(1, 2, 5, 1))
    at = RNG.random((6, 3))
    found = evaluate_bernstein(multiply_bernstein(first, second)[0], at)
    np.testing.assert_allclose(found, evaluate_bernstein(first[0], at) * evaluate_bernstein(second[0], at), rtol=1e-12)


def test_coefficients_of_the_jacobian_are_those_of_the_determinant() -> None:
    body = make_body(0.2, spans=(1, 1, 1))
    coefficients = bernstein_jacobian(body.bezier_nets())[0]
    at = RNG.random((6, 3))
    wanted = [body.jacobian(*p[:, None])[0, 0, 0] for p in at]
    np.testing.assert_allclose(evaluate_bernstein(coefficients, at), wanted, rtol=1e-12)
    assert coefficients.mean() == pytest.approx(body.integrate_volume(), rel=1e-13)


def fold(depth: float) -> BSplineVolume:
    """A body whose determinant has its least value, proportional to 1/4 - depth, on the line u = v = 1/2 inside it."""
    t = np.linspace(0, 1, 4)
    grid = np.stack(np.meshgrid(t, t, [0.0, 1.0], indexing="ij"), axis=-1)
    # x(u) = u^3 - 1.5 u^2 + (1 - depth) u, whose slope at 1/2 is 1/4 - depth
    cubic = np.array([0.0, (1 - depth) / 3, 2 * (1 - depth) / 3 - 0.5, 0.5 - depth])
    grid[..., 0] = cubic[:, None, None]
    knots = bezier_knots(3)
    return BSplineVolume(grid, (knots, knots, bezier_knots(1)), (3, 3, 1))


@pytest.mark.parametrize("depth", [0.2, 0.2499, 0.2501, 0.3])
def test_the_sign_of_the_jacobian_is_decided_though_its_coefficients_have_both_signs(depth: float) -> None:
    body = fold(depth)
    assert bernstein_jacobian(body.bezier_nets()).min() < 0
    bound = bound_jacobian(body.bezier_nets())
    assert bound.positive == (depth < 0.25)
    assert bound.lower <= 0.25 - depth + 1e-12
    assert bound.attained >= 0.25 - depth - 1e-12
    if not bound.positive:
        assert bound.parameters[0] == pytest.approx(0.5, abs=0.3)


def test_a_ruled_volume_has_straight_segments_between_two_surfaces() -> None:
    knots_u, knots_v = bezier_knots(2), bezier_knots(3)
    lower, upper = (BSplineSurface(RNG.normal(size=(3, 4, 3)), knots_u, knots_v, 2, 3) for _ in range(2))
    body = ruled_volume(lower, upper)
    u, v = np.array([0.3]), np.array([0.8])
    found = body.grid(u, v, [0.0, 0.25, 1.0])[0, 0]
    np.testing.assert_allclose(found[0], lower(0.3, 0.8), atol=1e-14)
    np.testing.assert_allclose(found[2], upper(0.3, 0.8), atol=1e-14)
    np.testing.assert_allclose(found[1], 0.75 * lower(0.3, 0.8) + 0.25 * upper(0.3, 0.8), atol=1e-14)
    with pytest.raises(ValueError, match="one spline space"):
        ruled_volume(lower, lower.turned(1))


def test_turning_a_surface_turns_its_sides() -> None:
    surface = BSplineSurface(RNG.normal(size=(3, 4, 3)), bezier_knots(2, (0.0, 2.0)), uniform_knots(2, 2), 2, 2)
    for turns in range(5):
        turned = surface.turned(turns)
        for side in range(4):
            wanted = surface.side((side + turns) % 4)
            np.testing.assert_array_equal(turned.side(side).poles, wanted.poles)
            np.testing.assert_allclose(turned.side(side).knots, wanted.knots, atol=1e-15)
