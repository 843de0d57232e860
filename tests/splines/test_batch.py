"""Patches fitted in one batch share borders exactly and are least-squares fits inside."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.splines.axis import bezier_knots, uniform_knots
from tpmscad.splines.batch import fit_patches
from tpmscad.splines.bspline import Surface

POINTS = (1 - np.cos(np.pi * np.linspace(0, 1, 23))) / 2
KNOTS = uniform_knots(3, 4, 2)


def sheet(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([x, y, np.sin(2 * x) * np.cos(3 * y)], axis=-1)


def test_borders_of_neighbours_are_the_same_bits_whichever_way_they_run() -> None:
    x, y = np.meshgrid(POINTS, POINTS, indexing="ij")
    first = sheet(x, y)
    second = sheet(2 - x, 1 - y)  # turned by half a turn: its border at u = 1 is the first's, run backwards
    second[-1] = first[-1, ::-1]
    third = sheet(1 - y, 1 + x).copy()  # a quarter: its border at u = 0 is the first's at v = 1, run backwards
    third[0] = first[::-1, -1]
    poles = fit_patches(np.stack([first, second, third]), POINTS, POINTS, KNOTS, KNOTS, 4, 4)
    np.testing.assert_array_equal(poles[1, -1], poles[0, -1, ::-1])
    np.testing.assert_array_equal(poles[2, 0], poles[0, ::-1, -1])
    np.testing.assert_array_equal(poles[0, [0, 0, -1, -1], [0, -1, 0, -1]], first[[0, 0, -1, -1], [0, -1, 0, -1]])
    for k, exact in enumerate((first, second, third)):
        fitted = Surface(poles[k], KNOTS, KNOTS, 4, 4).grid(POINTS, POINTS)
        assert np.abs(fitted - exact).max() < 1e-3


def test_a_batch_is_no_different_from_one_patch_at_a_time() -> None:
    rng = np.random.default_rng(0)
    u, v = np.linspace(0, 1, 12), POINTS
    samples = rng.normal(size=(5, len(u), len(v), 3))
    spaces = bezier_knots(5), KNOTS, 5, 4
    whole = fit_patches(samples, u, v, *spaces)
    assert whole.shape == (5, 6, len(KNOTS) - 5, 3)
    for one, poles in zip(samples, whole, strict=True):
        np.testing.assert_allclose(fit_patches(one[None], u, v, *spaces)[0], poles, atol=1e-13)


def test_inner_poles_are_the_least_squares_ones_for_these_borders() -> None:
    rng = np.random.default_rng(0)
    u, v = np.linspace(0, 1, 12), POINTS
    samples = rng.normal(size=(1, len(u), len(v), 3))
    spaces = bezier_knots(5), KNOTS, 5, 4
    poles = fit_patches(samples, u, v, *spaces)[0]

    def error(candidate: np.ndarray) -> float:
        return float(((Surface(candidate, *spaces).grid(u, v) - samples[0]) ** 2).sum())

    best = error(poles)
    for _ in range(20):
        change = np.zeros_like(poles)
        change[1:-1, 1:-1] = 1e-3 * rng.normal(size=change[1:-1, 1:-1].shape)
        assert error(poles + change) > best
        change_on_border = np.zeros_like(poles)
        change_on_border[1:-1, 0] = 1e-3 * rng.normal(size=change_on_border[1:-1, 0].shape)
        border = np.linalg.norm(Surface(poles, *spaces).grid(u, v[:1]) - samples[0][:, :1])
        assert np.linalg.norm(Surface(poles + change_on_border, *spaces).grid(u, v[:1]) - samples[0][:, :1]) > border


@pytest.mark.parametrize(
    ("u", "message"),
    [
        (np.linspace(0.01, 1, 12), "ends of the domain"),
        (np.linspace(0, 1, 12) ** 2, "symmetric"),
        (np.linspace(0, 1, 5), "can't determine 6"),
    ],
)
def test_grids_that_can_not_serve_are_refused(u: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fit_patches(np.zeros((1, len(u), len(POINTS), 3)), u, POINTS, bezier_knots(5), KNOTS, 5, 4)
