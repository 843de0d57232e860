"""Interpolation by Gaussians."""

from __future__ import annotations

import numpy as np

from tpmscad.splines.gaussian_interpolation import interpolate_samples

RNG = np.random.default_rng(2)
ORIGIN, SPACING, SHAPE = np.array([1.0, -2.0, 0.5]), 0.4, (9, 12, 10)
GRID = ORIGIN + SPACING * np.moveaxis(np.indices(SHAPE), 0, -1)


def test_samples_are_interpolated_and_linear_functions_are_kept() -> None:
    values = RNG.random(SHAPE)
    found = interpolate_samples(values, ORIGIN, SPACING)
    np.testing.assert_allclose(found(GRID.reshape(-1, 3)), values.ravel(), rtol=0, atol=1e-9)
    slope = np.array([0.3, -0.2, 0.7])
    linear = interpolate_samples(GRID @ slope + 2.0, ORIGIN, SPACING)
    points = ORIGIN + SPACING * (np.array(SHAPE) - 1) * RNG.random((50, 3))
    np.testing.assert_allclose(linear(points), points @ slope + 2.0, rtol=0, atol=1e-13)


def test_a_crease_is_rounded_by_a_part_of_the_spacing_and_has_fourth_derivatives() -> None:
    found = interpolate_samples(np.abs(GRID[..., 0] - 2.5), ORIGIN, SPACING)
    x = np.linspace(2.0, 3.0, 401)
    points = np.column_stack([x, np.zeros_like(x), np.full_like(x, 2.0)])
    assert 0.02 * SPACING < np.abs(found(points) - np.abs(x - 2.5)).max() < 0.25 * SPACING
    fourth = np.diff(found(points)[::20], 4)
    assert np.abs(np.diff(fourth)).max() < 3 * np.abs(fourth).max()
