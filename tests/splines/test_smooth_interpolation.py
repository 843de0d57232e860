"""Patches of high degree through points: exact sides, and control nets that stay near the patch."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad._typing import Array
from tpmscad.splines.basis import bernstein_basis, bezier_interpolation, evaluate_bezier_patches
from tpmscad.splines.smooth_interpolation import interpolate_patches


def evaluate_wave(u: Array, v: Array) -> Array:
    """A bent patch of size 1."""
    return np.stack([u + 0.3 * v**2, v + 0.2 * u**3, 0.4 * np.sin(2 * u) * np.cos(2 * v)], axis=-1)


def sample_wave(degree: int) -> Array:
    nodes, _ = bezier_interpolation(degree)
    return evaluate_wave(*np.meshgrid(nodes, nodes, indexing="ij"))


def last_term(degree: int) -> Array:
    """The product of two Chebyshev polynomials at the nodes: +-1, and the sign changes from node to node."""
    sign = (-1.0) ** np.arange(degree + 1)
    sign[[0, -1]] = 0.0  # the sides stay
    return np.multiply.outer(sign, sign)


@pytest.mark.parametrize("degree", [3, 9, 16])
def test_the_patch_passes_through_the_points(degree: int) -> None:
    points = sample_wave(degree)
    (poles,) = interpolate_patches(points[None])
    nodes, _ = bezier_interpolation(degree)
    basis = bernstein_basis(degree, nodes)
    found = evaluate_bezier_patches(basis, poles[None], basis).reshape(points.shape)
    assert np.abs(found - points).max() < 1e-9
    for side in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        np.testing.assert_allclose(found[side], points[side], rtol=0, atol=1e-12)
    t = np.linspace(0, 1, 33)
    between = bernstein_basis(degree, t)
    exact = evaluate_wave(*np.meshgrid(t, t, indexing="ij"))
    error = np.abs(evaluate_bezier_patches(between, poles[None], between).reshape(exact.shape) - exact).max()
    assert error < {3: 0.1, 9: 1e-5, 16: 1e-9}[degree]


def test_noise_moves_poles_by_little_more_than_a_patch() -> None:
    noise = 1e-8 * last_term(16)[..., None]
    _, to_poles = bezier_interpolation(16)
    points = np.stack([sample_wave(16), sample_wave(16) + noise])
    plain = np.einsum("ai,bj,nijd->nabd", to_poles, to_poles, points)
    assert np.abs(plain[1] - plain[0]).max() > 10, "plain interpolation moves them by ten sizes of the patch"
    quiet = interpolate_patches(points)
    assert np.abs(quiet[1] - quiet[0]).max() < 0.1
    basis = bernstein_basis(16, bezier_interpolation(16)[0])
    found = evaluate_bezier_patches(basis, quiet, basis).reshape(points.shape)
    assert np.abs(found - points).max() < 2e-8


def test_neighbours_share_the_poles_of_a_side() -> None:
    points = sample_wave(12)
    other = points[::-1].copy()
    other[1:] += np.random.default_rng(3).normal(scale=0.1, size=other[1:].shape)
    a, b = interpolate_patches(np.stack([points, other]))
    np.testing.assert_allclose(a[-1], b[0], rtol=0, atol=1e-13)
