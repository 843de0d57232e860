"""Laws of joints between patches of a level set: their tangent planes are the same to round-off, at T-vertices too."""

from __future__ import annotations

import numpy as np
import pytest

from tests.shapes.ball_level_sets import ball_fit
from tpmscad import fields
from tpmscad.levelset.level_set_fit import LevelSetFit
from tpmscad.levelset.periodic.periodic_layers import fit_periodic_offset
from tpmscad.levelset.quadmesh.patch_network import FIRST_HALF, SECOND_HALF, WHOLE
from tpmscad.splines.basis import bernstein_basis

PIECE_SPAN = {WHOLE: (0.0, 1.0), FIRST_HALF: (0.0, 0.5), SECOND_HALF: (0.5, 1.0)}


def evaluate_side(poles: np.ndarray, side: int, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivative across a side of one patch, and the unit normal, at t (m,) along the side, counter-clockwise."""
    p, q = poles.shape[0] - 1, poles.shape[1] - 1
    u, v = ((t, 0 * t), (1 + 0 * t, t), (1 - t, 1 + 0 * t), (0 * t, 1 - t))[side]
    along_u, along_v = (
        np.einsum("mi,mj,ijx->mx", bernstein_basis(p, u, i), bernstein_basis(q, v, 1 - i), poles) for i in (1, 0)
    )
    normal = np.cross(along_u, along_v)
    return (along_u if side % 2 else along_v), normal / np.linalg.norm(normal, axis=1, keepdims=True)


def joined_sides(fit: LevelSetFit) -> list[tuple[int, int]]:
    return [tuple(row) for row in np.argwhere(fit.network.plane[fit.network.curve] < 0)]


def curve_parameters(fit: LevelSetFit, patch: int, side: int, t: np.ndarray) -> np.ndarray:
    """Parameters on the curve of a side at t (m,) along the side."""
    low, high = PIECE_SPAN[int(fit.network.piece[patch, side])]
    return low + (high - low) * (t if fit.network.sense[patch, side] > 0 else 1 - t)


def test_the_network_has_what_makes_joints_hard() -> None:
    fit = ball_fit(share=0.1)
    network = fit.network
    valences = set(np.bincount(network.corners[network.corners >= 0])) - {1, 2}
    assert len(network.split_curve) > 20
    assert {3, 4, 5} <= valences


@pytest.mark.slow
def test_the_derivative_across_a_side_is_orthogonal_to_the_normal_of_its_curve_identically() -> None:
    fit = ball_fit(share=0.1)
    worst = 0.0
    for patch, side in joined_sides(fit):
        poles, normal = fit.fit.patches[patch], fit.fit.normals[fit.network.curve[patch, side]]
        degree = len(normal) - 1 + poles.shape[side % 2] - 1
        t = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
        across, _ = evaluate_side(poles, side, t)
        along = bernstein_basis(len(normal) - 1, curve_parameters(fit, patch, side, t)) @ normal
        # the coefficients of the polynomial through these values, without the products that the fit uses
        coefficients = np.linalg.solve(bernstein_basis(degree, t), np.einsum("mx,mx->m", along, across))
        worst = max(worst, np.abs(coefficients).max() / np.linalg.norm(across, axis=1).min())
        assert np.linalg.norm(along, axis=1).min() > 0.5
    assert worst < 1e-8


def test_patches_on_both_sides_of_a_joint_have_the_same_normals_at_random_parameters() -> None:
    fit = ball_fit(share=0.1)
    rng = np.random.default_rng(5)
    sides: dict[int, list[tuple[int, int]]] = {}
    for patch, side in joined_sides(fit):
        sides.setdefault(int(fit.network.curve[patch, side]), []).append((patch, side))
    n_compared, worst = 0, 0.0
    for found in sides.values():
        s = rng.uniform(0.0, 1.0, 101)
        normals, known = np.zeros((len(found), 101, 3)), np.zeros((len(found), 101), bool)
        for k, (patch, side) in enumerate(found):
            low, high = PIECE_SPAN[int(fit.network.piece[patch, side])]
            known[k] = (s >= low) & (s <= high)
            t = (s[known[k]] - low) / (high - low)
            t = t if fit.network.sense[patch, side] > 0 else 1 - t
            normals[k, known[k]] = evaluate_side(fit.fit.patches[patch], side, t)[1]
        assert (known.sum(axis=0) == 2).all()
        total = normals.sum(axis=0)  # of two unit vectors at an angle a: 2 cos(a / 2)
        first = normals[known.argmax(axis=0), np.arange(101)]
        worst = max(worst, np.linalg.norm(2 * first - total, axis=1).max())
        n_compared += 101
    assert n_compared > 101 * 100
    assert np.degrees(worst) < 1e-5


@pytest.mark.slow
def test_patches_of_a_periodic_level_set_meet_their_copies_tangentially() -> None:
    fit = fit_periodic_offset(fields.tpms("gyroid", 10.0), 0.4, 1e-2)
    assert fit.met
    assert fit.tangent_jump_deg.max() < 1e-5
