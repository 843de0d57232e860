"""Patches fitted apart join with curvature continuity if they are charts of one surface under the projective half-turn."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.brep.edge_continuity import evaluate_curvature
from tpmscad.lattices import g2_fit
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import bezier_surface

EDGE = 2 / np.sqrt(3)  # of the Klein square; half of it is c, and 1/c - c is again EDGE


def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """An analytic surface over Klein's disc, without any symmetry."""
    return np.stack(
        [x + 0.1 * np.sin(2 * y) + 0.2 * x * y, y + 0.15 * np.cos(1.5 * x), 0.4 * np.sin(1.7 * x + 0.3) * np.cos(y)], -1
    )


def chart(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (u - 0.5) * EDGE, (v - 0.5) * EDGE


def neighbour(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The chart over side u = 1, by the half-turn of hyperbolic geometry: a harmonic homology in Klein's model."""
    x, y = chart(u, v)
    out = x - EDGE / 2
    factor = -EDGE / (EDGE - 2 * out)
    return EDGE / 2 + factor * out, factor * y


def sample_charts(pieces: int, nodes: int) -> np.ndarray:
    """Samples of both charts over all pieces of them: (2, pieces, pieces, nodes, nodes, 3)."""
    t = (np.arange(pieces)[:, None] + g2_fit.sample_parameters(nodes)) / pieces
    u, v = np.broadcast_arrays(t[:, None, :, None], t[None, :, None, :])
    return np.stack([surface(*chart(u, v)), surface(*neighbour(u, v))])


@pytest.fixture(scope="module")
def samples() -> np.ndarray:
    return sample_charts(1, g2_fit.CHEBYSHEV_NODES)[:, 0, 0]


def assert_second_order(here: BSplineSurface, there: BSplineSurface) -> None:
    """The patches join with continuous curvature along the sides u = 1."""
    s = np.linspace(0, 1, 31)
    (x, n, k), (y, m, q) = evaluate_curvature(here, np.ones(31), s), evaluate_curvature(there, np.ones(31), 1 - s)
    assert np.abs(x - y).max() < 1e-9
    assert np.abs(n - m).max() < 1e-8
    assert np.abs(k - q).max() < 1e-6 * np.abs(k).max()


@pytest.mark.parametrize("degree", [9, 10, 13, 16])
def test_neighbouring_charts_join_to_second_order(samples: np.ndarray, degree: int) -> None:
    assert_second_order(*(bezier_surface(p) for p in g2_fit.fit_g2_patches(samples, degree)[0]))


@pytest.mark.parametrize(("pieces", "degree"), [(2, 9), (2, 12), (3, 10)])
def test_charts_of_several_spans_join_to_second_order_and_are_nearer_to_the_surface(pieces: int, degree: int) -> None:
    poles = g2_fit.fit_g2_patches(sample_charts(pieces, g2_fit.PIECE_NODES), degree)[0]
    here, there = (g2_fit.join_pieces(p) for p in poles)
    assert here.degree_u == here.degree_v == degree
    assert len(np.unique(here.knots_u)) == len(np.unique(here.knots_v)) == pieces + 1
    assert_second_order(here, there)
    u, v = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41), indexing="ij")
    whole = bezier_surface(g2_fit.fit_g2_patches(sample_charts(1, 48)[:, 0, 0], degree)[0][1])
    off, before = (np.abs(patch(u, v) - surface(*neighbour(u, v))).max() for patch in (there, whole))
    assert off < before / 50
    t = np.linspace(0, 1 / pieces, 11)
    np.testing.assert_allclose(here.grid(t, t), bezier_surface(poles[0, 0, 0]).grid(pieces * t, pieces * t), atol=1e-9)


def test_the_fit_approaches_the_surface_with_the_degree(samples: np.ndarray) -> None:
    u, v = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21), indexing="ij")
    errors = [
        np.abs(bezier_surface(g2_fit.fit_g2_patches(samples, d)[0][1])(u, v) - surface(*neighbour(u, v))).max()
        for d in (9, 12, 16)
    ]
    assert errors[0] > 10 * errors[1] > 100 * errors[2]
    assert errors[2] < 1e-6


def test_polynomials_within_the_degree_are_reproduced() -> None:
    t = g2_fit.sample_parameters()
    u, v = np.meshgrid(t, t, indexing="ij")

    def polynomial(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack([u + v**3, v - u**2 * v, u**4 * v**5 - u], axis=-1)

    fitted = bezier_surface(g2_fit.fit_g2_patches(polynomial(u, v)[None], 9)[0][0])
    s, r = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9), indexing="ij")
    # 2e-10 of round-off was measured: fourth derivatives are taken of the samples.
    np.testing.assert_allclose(fitted(s, r), polynomial(s, r), rtol=0, atol=1e-9)


def test_too_low_a_degree_is_refused(samples: np.ndarray) -> None:
    with pytest.raises(ValueError, match="least is 9"):
        g2_fit.fit_g2_patches(samples, 8)
