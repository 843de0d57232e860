"""Spline maps rounded over cells: smooth, near the map, the map itself where that is smooth, and refused with the knot."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from tests.splines.test_common_space import clamped
from tpmscad import maps
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.lattices.rounded_maps import round_over_cells
from tpmscad.lattices.spline_maps import SplineMap
from tpmscad.splines.basis import design_matrix

CELLS, CELL = (4, 6, 1), np.array([10.0, 7.0, 9.0])
SIZE = CELL * CELLS
RNG = np.random.default_rng(5)


def bumpy(height: float, inner_u: list[float], degree_u: int = 3) -> SplineMap:
    """A plate over the block of cells whose lower and upper side are bumpy along u."""
    knots = clamped(degree_u, inner_u), clamped(3, []), clamped(1, [])
    greville = [
        np.array([t[i + 1 : i + p + 1].mean() for i in range(len(t) - p - 1)])
        for t, p in zip(knots, (degree_u, 3, 1), strict=True)
    ]
    net = np.stack(np.meshgrid(*greville, indexing="ij"), axis=-1) * SIZE
    net[..., 2] += height * RNG.uniform(-1, 1, net.shape[:3])
    return maps.trivariate(net, knots, (degree_u, 3, 1))


def inside(count: int) -> Array:
    return SIZE * RNG.random((count, 3))


def test_a_rounded_map_is_within_the_distance_that_it_tells_and_that_within_half_the_tolerance() -> None:
    spline = bumpy(0.5, [0.3, 0.55, 0.8])
    for tol in (0.3, 0.005, 0.001):
        rounded = round_over_cells(spline, CELLS, CELL, tol)
        points = inside(4000)
        distance = np.linalg.norm(rounded.map(points) - spline(points / SIZE), axis=1).max()
        assert 0 < distance <= 1.02 * rounded.moved <= 1.02 * tol / 2
        assert distance > 0.2 * rounded.moved


def test_a_map_of_high_degree_or_of_one_span_is_taken_as_it_is() -> None:
    for spline in (bumpy(0.1, []), bumpy(0.02, [0.4, 0.7], 6)):
        rounded = round_over_cells(spline, CELLS, CELL, 1e-6)
        assert rounded.moved == 0
        points = inside(50)
        np.testing.assert_allclose(rounded.map(points), spline(points / SIZE), rtol=0, atol=1e-12)


def test_away_from_knots_and_ends_the_map_stays_the_same() -> None:
    """What comes from a knot or an end decays by a factor with every span."""
    spline = bumpy(0.5, [0.1])
    rounded = round_over_cells(spline, (24, 6, 1), CELL * [1 / 6, 1, 1], 0.3)
    points = inside(300)
    points[:, 0] = SIZE[0] * (0.5 + 0.1 * RNG.random(300))
    distance = np.linalg.norm(rounded.map(points) - spline(points / SIZE), axis=1).max()
    assert distance < 5e-3 * rounded.moved


def test_the_sixth_derivative_is_continuous_at_the_ends_of_the_spans() -> None:
    rounded = round_over_cells(bumpy(0.5, [0.3, 0.55, 0.8]), CELLS, CELL, 0.3).map
    h = 0.2  # mm; across a jump of a lower derivative the difference grows by 1 / h and more
    weights = np.array([1, -6, 15, -20, 15, -6, 1.0]) / h**6

    def sixth(x: Array) -> Array:
        t = x[:, None] + h * np.arange(-3, 4)
        points = np.stack([t, np.full_like(t, 20.0), np.full_like(t, 4.0)], axis=-1)
        return np.asarray(np.abs(rounded(points)[..., 2] @ weights))

    ends = np.arange(5.0, 40.0, 5.0)  # spans of half a cell
    beside = np.concatenate([ends - 1.0, ends + 1.0])
    # not about the ends themselves: there an even difference of an odd jump is zero
    assert sixth(ends + h / 2).max() < 1.5 * sixth(beside).max()


def test_the_jacobian_is_the_derivative_also_beyond_the_block() -> None:
    rounded = round_over_cells(bumpy(0.5, [0.3, 0.8]), CELLS, CELL, 0.3).map
    points = inside(100) + 0.5 * CELL * RNG.uniform(-1, 1, (100, 3))
    h = 1e-5
    for axis in range(3):
        step = h * np.eye(3)[axis]
        difference = (rounded(points + step) - rounded(points - step)) / (2 * h)
        np.testing.assert_allclose(rounded.jacobian(points, 1.0)[..., axis], difference, rtol=0, atol=1e-7)
    image, jacobian = rounded.images_and_jacobians(points, 1.0)
    np.testing.assert_array_equal(image, rounded(points))
    np.testing.assert_array_equal(jacobian, rounded.jacobian(points, 1.0))


def test_a_closed_map_closes_after_rounding() -> None:
    n, k = 8, np.arange(9)
    ring = np.stack([np.cos(2 * np.pi * k / n), -np.sin(2 * np.pi * k / n)], axis=1)
    ring[-1] = ring[0]
    periodic = make_interp_spline(k / n, ring, 3, bc_type="periodic")
    knots = clamped(3, [*(k[1:-1] / n)])
    greville = np.array([knots[i + 1 : i + 4].mean() for i in range(len(knots) - 4)])
    circle = np.linalg.solve(design_matrix(knots, 3, greville), periodic(greville))
    radius, z = np.meshgrid([20.0, 24.0], [0.0, 9.0], indexing="ij")
    net = np.concatenate(
        [circle[:, None, None] * radius[..., None], np.broadcast_to(z[..., None], (len(circle), 2, 2, 1))], axis=-1
    )
    spline = maps.trivariate(net, [knots, clamped(1, []), clamped(1, [])], (3, 1, 1))
    assert spline.closed == (True, False, False)
    rounded = round_over_cells(spline, (8, 1, 1), np.array([16.0, 4.0, 9.0]), 1.0)
    points = np.array([128.0, 4.0, 9.0]) * RNG.random((50, 3))
    np.testing.assert_allclose(rounded.map(points + np.array([128.0, 0, 0])), rounded.map(points), rtol=0, atol=1e-11)


def test_a_map_too_rough_for_its_cells_is_refused_with_the_knot_and_the_place() -> None:
    spline = bumpy(1.5, [0.3, 0.6, 0.6, 0.8])
    with pytest.raises(
        InvalidRequest, match=r"its knot u = 0\.6 it is C1 only.* near \(.*\) in the model.*more cells along x"
    ):
        round_over_cells(spline, CELLS, CELL, 1e-5)


def test_beyond_its_domain_a_map_of_high_degree_does_not_turn_over() -> None:
    spline = bumpy(0.01, [0.9, 0.95], 9)  # its last polynomials go on over three times their span
    rounded = round_over_cells(spline, CELLS, CELL, 0.3).map
    beyond = np.array([SIZE[0] + 0.5 * CELL[0], 20.0, 4.0])
    assert np.linalg.norm(rounded(beyond) - beyond) < 0.1 * np.linalg.norm(spline(beyond / SIZE) - beyond)
