"""Hyperbolic quadrilaterals on the unit square: reflections that close up around every corner."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.surfaces.klein_quadrilateral import KleinQuadrilateral, solve_klein_quadrilateral

CASES = [((4, 2, 4, 2), 1.4), ((4, 2, 4, 3), 2.0), ((2, 3, 2, 2), 1.2), ((4, 3, 2, 2), 1.7)]
SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
LINES = np.array([[0.0, 0, 1], [-1, 1, 0], [-1, 0, 1], [0, 1, 0]])  # of sides 0..3, on (1, u, v)
FORM = np.diag([-1.0, 1, 1])


def homologies(shape: KleinQuadrilateral) -> list[np.ndarray]:
    """The reflections as projective maps of (1, u, v): axis the side, centre as given."""
    return [np.eye(3) - 2 * np.outer(c, line) / (line @ c) for c, line in zip(shape.centres, LINES, strict=True)]


@pytest.mark.parametrize(("orders", "product"), CASES)
def test_the_reflections_of_neighbouring_sides_have_the_order_of_their_corner(
    orders: tuple[int, ...], product: float
) -> None:
    maps = homologies(solve_klein_quadrilateral(np.pi / np.array(orders), product))
    for i, order in enumerate(orders):
        turn = np.linalg.matrix_power(maps[i - 1] @ maps[i], order)
        np.testing.assert_allclose(turn / turn[0, 0], np.eye(3), rtol=0, atol=1e-10)
        for fewer in range(1, order):
            turn = np.linalg.matrix_power(maps[i - 1] @ maps[i], fewer)
            assert np.abs(turn / turn[0, 0] - np.eye(3)).max() > 0.1


@pytest.mark.parametrize(("orders", "product"), CASES)
def test_the_reflections_keep_the_hyperbolic_form(orders: tuple[int, ...], product: float) -> None:
    shape = solve_klein_quadrilateral(np.pi / np.array(orders), product)
    form = shape.projection.T @ FORM @ shape.projection
    for reflection in homologies(shape):
        np.testing.assert_allclose(reflection.T @ form @ reflection, form, rtol=0, atol=1e-10 * np.abs(form).max())


@pytest.mark.parametrize(("orders", "product"), CASES)
def test_the_angles_in_the_metric_are_those_asked_for(orders: tuple[int, ...], product: float) -> None:
    metric = np.linalg.inv(solve_klein_quadrilateral(np.pi / np.array(orders), product).dirichlet_tensor(*SQUARE.T))
    np.testing.assert_allclose(np.linalg.det(metric), 1, rtol=1e-9)
    ahead = np.roll(SQUARE, -1, axis=0) - SQUARE
    behind = np.roll(SQUARE, 1, axis=0) - SQUARE
    for g, p, q, order in zip(metric, ahead, behind, orders, strict=True):
        assert (p @ g @ q) / np.sqrt((p @ g @ p) * (q @ g @ q)) == pytest.approx(np.cos(np.pi / order), abs=1e-9)
