"""Laws of curves and patches on level sets that turn by a right angle within a small part of them."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.levelset.fit import network_curves
from tpmscad.levelset.fit.fit_quality import sample_patches
from tpmscad.levelset.fit.network_fit import fit_joined_curves, fit_patches
from tpmscad.splines.basis import bending_energy, bernstein_basis

BAR = fields.from_function(
    lambda p: p[..., 0] ** 12 + p[..., 2] ** 12 - 1.0,
    gradient=lambda p: np.stack([12 * p[..., 0] ** 11, 0 * p[..., 1], 12 * p[..., 2] ** 11], axis=-1),
)
"""A square bar along y with rounded edges: the level set turns by 80 degrees in a fifth of the corners' distance."""

DEGREE = 9


def on_bar(x: float, y: float) -> np.ndarray:
    return np.array([x, y, (1 - x**12) ** (1 / 12)])


def corners() -> np.ndarray:
    """Four points, counter-clockwise from outside, two on either side of an edge."""
    far = [on_bar(x, y)[[2, 1, 0]] for x, y in ((0.35, 0.2), (0.2, 0.75))]
    return np.array([on_bar(0.3, 0.0), far[0], far[1], on_bar(0.15, 0.6)])


def joined_curves() -> np.ndarray:
    start = corners()
    return fit_joined_curves(BAR, start, np.roll(start, -1, axis=0), np.zeros((4, 3), bool), 2.0, DEGREE, None)


def length_ratios() -> np.ndarray:
    """Lengths of the control polygons of the sides across the edge, relative to the curves'."""
    curves = joined_curves()[[0, 2], 0]
    points = bernstein_basis(DEGREE, np.linspace(0.0, 1.0, 401)) @ curves
    return np.divide(*(np.linalg.norm(np.diff(x, axis=1), axis=2).sum(axis=1) for x in (curves, points)))


def test_the_energy_of_a_net_is_that_of_its_differences_and_vanishes_for_linear_nets() -> None:
    u, v = np.meshgrid(np.arange(5.0), np.arange(7.0), indexing="ij")
    energy = bending_energy(5, 7)
    assert np.abs(energy @ (3 * u - 2 * v + 1).ravel()).max() < 1e-12
    found = [net.ravel() @ energy @ net.ravel() for net in (u**2, v**2, u * v)]
    np.testing.assert_allclose(found, [4.0 * 3 * 7, 4.0 * 5 * 5, 2.0 * 4 * 6])
    curve = np.random.default_rng(4).normal(size=6)
    np.testing.assert_allclose(curve @ bending_energy(6, 1) @ curve, (np.diff(curve, 2) ** 2).sum())


def test_control_polygons_are_at_most_twice_as_long_as_the_curves_and_longer_without_fairness(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fair = length_ratios()
    assert fair.max() < 2.2
    monkeypatch.setattr(network_curves, "FAIRNESS_WEIGHT", 0.0)
    assert length_ratios().max() > 1.5 * fair.max()


def test_a_patch_across_a_rounded_edge_does_not_fold() -> None:
    joined = joined_curves()
    border, normals = ([joined[[i], k] for i in range(4)] for k in (0, 1))
    samples = sample_patches(BAR, fit_patches(BAR, border, normals))
    assert samples.min_normal_cosine.min() > 0.95
    assert samples.distance.max() < 0.02
