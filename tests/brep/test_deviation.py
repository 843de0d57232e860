"""The measured deviation against surfaces whose distance is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.brep.deviation import measure_deviation
from tpmscad.brep.edge_continuity import evaluate_curvature, measure_edge_continuity
from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.brep.welding import weld_patches
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface

RNG = np.random.default_rng(3)
KNOTS = np.repeat([0.0, 1.0], 4)


def bump(scale: float = 0.2) -> BSplineSurface:
    """A bicubic patch over the unit square with random heights."""
    x = np.linspace(0, 1, 4)
    poles = np.stack([*np.meshgrid(x, x, indexing="ij"), scale * RNG.random((4, 4))], axis=-1)
    return BSplineSurface(poles, KNOTS, KNOTS, 3, 3)


@pytest.mark.parametrize("distance", [1e-2, -3e-4, 1e-8])
def test_parallel_planes_are_their_distance_apart_whatever_their_parameters(distance: float) -> None:
    x = np.linspace(0, 1, 4)
    poles = np.stack([*np.meshgrid(x, x, indexing="ij"), np.full((4, 4), distance)], axis=-1)
    poles[1:3, 1:3, :2] += 0.05 * RNG.standard_normal((2, 2, 2))  # interior parameters wander, the point set does not
    result = measure_deviation(BSplineSurface(poles, KNOTS, KNOTS, 3, 3), lambda u, v: np.stack([u, v, 0 * u], axis=-1))
    assert result.max == pytest.approx(abs(distance), rel=1e-6)
    assert result.rms == pytest.approx(abs(distance), rel=1e-6)


def test_an_offset_surface_is_its_offset_away_in_both_directions() -> None:
    surface = bump()

    def offset(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        n = surface.normal(u, v)
        return surface(u, v) + 1e-3 * n / np.linalg.norm(n, axis=-1, keepdims=True)

    result = measure_deviation(surface, offset)
    assert result.to_reference == pytest.approx(1e-3, rel=1e-6)
    assert result.from_reference >= 1e-3 * (1 - 1e-6)


def test_a_dent_between_the_samples_is_found() -> None:
    flat = bump(0.0)
    centre = np.array([0.5137, 0.2911])

    def dented(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack([u, v, 1e-3 * np.exp(-((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / 0.05**2)], axis=-1)

    assert measure_deviation(flat, dented).max == pytest.approx(1e-3, rel=1e-2)  # the plain grid is 10 % off


def test_the_curvature_tensor_of_a_sphere_and_of_a_turned_surface() -> None:
    u, v = RNG.random((2, 20))
    surface = bump(0.4)
    _, n, k = evaluate_curvature(surface, u, v)
    # A turned copy's tensor is the turned tensor; the tensor annihilates the normal.
    turn = np.linalg.qr(RNG.standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    _, m, q = evaluate_curvature(surface.moved(Motion(turn, np.zeros(3))), u, v)
    np.testing.assert_allclose(m, n @ turn.T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(q, turn @ k @ turn.T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", k, n), 0, rtol=0, atol=1e-12)


def test_halves_of_one_surface_join_without_a_jump_and_a_kinked_pair_does_not() -> None:
    x = np.linspace(0, 1, 4)
    y, h = np.meshgrid(x, x, indexing="ij")
    paraboloid = [
        BSplineSurface(np.stack([lift + y, h, np.zeros((4, 4))], axis=-1), KNOTS, KNOTS, 3, 3) for lift in (0.0, 1.0)
    ]

    def bent(surface: BSplineSurface, slope: float) -> BSplineSurface:
        poles = surface.poles.copy()
        poles[..., 2] += slope * np.maximum(poles[..., 0] - 1.0, 0.0)
        return BSplineSurface(poles, KNOTS, KNOTS, 3, 3)

    def measured(slope: float) -> float:
        pair = [bent(s, slope) for s in paraboloid]
        one = np.ones(2, int)
        brep = weld_patches(pair, np.arange(2), Motion.identity(2), one, 0 * one, ["a"])
        return measure_edge_continuity(brep, ("a",)).tangent_jump_deg

    assert measured(0.0) < 1e-12
    assert measured(0.01) == pytest.approx(np.degrees(np.arctan(0.01)), rel=1e-9)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("end", [0.0, 1.0])
def test_the_foot_of_a_point_beyond_a_side_slides_along_the_side(side: int, end: float) -> None:
    """A sheared parallelogram: without sliding, the foot would stay where the first step leaves the patch."""
    x = np.linspace(0, 1, 4)
    u, v = np.meshgrid(x, x, indexing="ij")
    along = (u, v)[1 - side]
    poles = np.stack([u, v, np.zeros_like(u)], axis=-1)
    poles[..., 1 - side] += 0.8 * (u, v)[side] * along  # the lines of constant parameter are not square to the side
    patch = BSplineSurface(poles, KNOTS, KNOTS, 3, 3)
    t = np.linspace(0.0, 1.0, 4001)
    at_side = patch(np.full_like(t, end), t) if side == 0 else patch(t, np.full_like(t, end))
    beyond = np.array([0.3, 0.5, 0.7])
    points = np.zeros((3, 3))
    points[:, side] = end + (0.25 if end else -0.25)
    points[:, 1 - side] = beyond
    points[:, 2] = 0.1
    expected = np.linalg.norm(points[:, None] - at_side, axis=-1).min(axis=1)
    found, foot_u, foot_v = project_to_patch(patch, points, np.full(3, 0.5), np.full(3, 0.5))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert ((foot_u, foot_v)[side] == end).all()
