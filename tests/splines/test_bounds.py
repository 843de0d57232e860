"""Bounds are upper bounds, on random surfaces, and decay as they should."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.error_bounds import (
    derivative_bounds,
    filip_bound,
    fit_error_bound,
    second_derivative_bounds,
    zheng_sederberg_bound,
)
from tpmscad.splines.knots import bezier_knots, uniform_knots
from tpmscad.splines.spline_axis import sampled_axis
from tpmscad.splines.surface_fit import fit_surface

DENSE = np.linspace(0, 1, 73)


def some_surface(seed: int, degree_u: int = 3, degree_v: int = 5, smoothness: int | None = None) -> BSplineSurface:
    ku, kv = uniform_knots(3, degree_u, None), uniform_knots(2, degree_v, smoothness)
    rng = np.random.default_rng(seed)
    poles = rng.normal(size=(len(ku) - degree_u - 1, len(kv) - degree_v - 1, 3)) * rng.uniform(0.1, 3, 3)
    return BSplineSurface(poles, ku, kv, degree_u, degree_v)


def triangle_mesh(surface: BSplineSurface, u: np.ndarray, v: np.ndarray, n: int) -> np.ndarray:
    """The mesh over an n x n grid, cells cut from (0, 0) to (1, 1), at the parameters u x v."""
    t = np.linspace(0, 1, n + 1)
    points = surface.grid(t, t)
    i, j = (np.minimum((x * n).astype(int), n - 1) for x in (u, v))
    a, b = (u * n - i)[:, None, None], (v * n - j)[None, :, None]
    p00, p10, p01, p11 = (points[np.ix_(i + k, j + m)] for k, m in ((0, 0), (1, 0), (0, 1), (1, 1)))
    low = p00 + a * (p10 - p00) + b * (p11 - p10)
    high = p00 + b * (p01 - p00) + a * (p11 - p01)
    return np.where(a >= b, low, high)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 4), st.integers(2, 5), st.integers(1, 12))
def test_filip_bounds_the_distance_to_the_mesh(seed: int, degree_u: int, degree_v: int, n: int) -> None:
    surface = some_surface(seed, degree_u, degree_v)
    distance = np.linalg.norm(surface.grid(DENSE, DENSE) - triangle_mesh(surface, DENSE, DENSE, n), axis=-1).max()
    assert distance <= filip_bound(*second_derivative_bounds(surface), 1 / n, 1 / n)


@pytest.mark.parametrize(
    ("du", "dv", "greatest"), [(3, 0, 6.0), (0, 2, 2.0), (3, 2, 12.0), (4, 0, 0.0), (0, 3, 0.0), (2, 1, 12.0)]
)
def test_bounds_of_derivatives_up_to_the_degree_and_beyond(du: int, dv: int, greatest: float) -> None:
    """S = (u^3 v^2, 0, 0) on the unit square."""
    poles = np.zeros((4, 3, 3))
    poles[3, 2, 0] = 1.0
    surface = BSplineSurface(poles, bezier_knots(3), bezier_knots(2), 3, 2)
    assert derivative_bounds(surface, du, dv) == pytest.approx(np.full((1, 1), greatest))


def test_filip_is_sharp_for_quadratics_and_the_printed_form_is_no_bound() -> None:
    """S = (1, 1, 1) u^2 / 2: vector norms give the exact distance, maxima over components a third of sqrt(3) of it."""
    poles = np.zeros((3, 2, 3))
    poles[2] = 0.5
    surface = BSplineSurface(poles, bezier_knots(2), bezier_knots(1), 2, 1)
    distance = np.linalg.norm(surface.grid(DENSE, DENSE) - triangle_mesh(surface, DENSE, DENSE, 4), axis=-1).max()
    assert distance == pytest.approx(filip_bound(*second_derivative_bounds(surface), 1 / 4, 1 / 4))
    assert distance > 1.7 * filip_bound(1.0, 0.0, 0.0, 1 / 4, 1 / 4)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 9))
def test_zheng_sederberg_bounds_the_distance_from_bilinear_facets_to_triangles(seed: int, n: int) -> None:
    surface = some_surface(seed)
    t = np.linspace(0, 1, n + 1)
    weights = np.maximum(1 - np.abs(DENSE[:, None] - t) * n, 0)
    bilinear = np.einsum("ai,ijd,bj->abd", weights, surface.grid(t, t), weights)
    distance = np.linalg.norm(bilinear - triangle_mesh(surface, DENSE, DENSE, n), axis=-1).max()
    assert distance <= zheng_sederberg_bound(second_derivative_bounds(surface)[1], 1 / n, 1 / n) * (1 + 1e-12)


@pytest.mark.parametrize("orders", [(0, 0), (2, 0), (1, 1), (0, 2)])
@pytest.mark.parametrize("smoothness", [None, 0])
def test_derivative_bounds_hold_span_by_span_and_tighten(orders: tuple[int, int], smoothness: int | None) -> None:
    surface = some_surface(1, 4, 3, smoothness)
    coarse = derivative_bounds(surface, *orders)
    assert coarse.shape == (3, 2)
    for i in range(3):
        for j in range(2):
            u, v = np.linspace(i / 3 + 1e-9, (i + 1) / 3 - 1e-9, 31), np.linspace(j / 2 + 1e-9, (j + 1) / 2 - 1e-9, 31)
            assert np.linalg.norm(surface.grid(u, v, *orders), axis=-1).max() <= coarse[i, j]
    fine = derivative_bounds(surface, *orders, pieces=4)
    assert fine.shape == (12, 8)
    assert fine.max() <= coarse.max() * (1 + 1e-12)
    true = np.linalg.norm(surface.grid(DENSE, DENSE, *orders), axis=-1).max()
    assert fine.max() - true < 0.5 * (coarse.max() - true) + 1e-9


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.integers(5, 40))
def test_the_virtual_surface_bounds_the_error_of_a_fit(seed: int, n: int) -> None:
    original = some_surface(seed)
    axes = sampled_axis(bezier_knots(4), 4, DENSE), sampled_axis(bezier_knots(3), 3, DENSE)
    fitted = fit_surface(original.grid(DENSE, DENSE), *axes)
    u, v = np.linspace(0, 1, n), np.linspace(0, 1, n + 3)
    error = np.linalg.norm(fitted.grid(DENSE, DENSE) - original.grid(DENSE, DENSE), axis=-1).max()
    assert error <= fit_error_bound(original.grid(u, v), u, v, second_derivative_bounds(original), fitted)
    with pytest.raises(ValueError, match="domain"):
        fit_error_bound(original.grid(u[:-1], v), u[:-1], v, (1.0, 1.0, 1.0), fitted)
