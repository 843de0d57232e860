"""Iterations converge to what the direct solvers give, at the rates that are claimed."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from benchmarks.progressive_iteration import (
    cpia_convergence_rate,
    iterate_lspia,
    iterate_pia,
    pia_convergence_rate,
)
from tpmscad.splines.affine_subspace import solve_conditions, unconstrained_subspace
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.continuity_conditions import Joint, joint_conditions
from tpmscad.splines.cpia import (
    DataGrid,
    fit_cpia,
    iterate_cpia,
    trapezoidal_grid,
)
from tpmscad.splines.knots import bezier_knots, greville_abscissae, uniform_knots
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis, pole_axis, sampled_axis
from tpmscad.splines.surface_fit import fit_surface, gram_eigenvalue_bounds

KNOTS_U, KNOTS_V = uniform_knots(5, 3), uniform_knots(3, 4)


def wavy(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    x, y = np.meshgrid(u, v, indexing="ij")
    return np.stack([x, y, np.sin(5 * x + 2 * y) + x * y], axis=-1)


def test_pia_comes_to_interpolate_at_its_rate() -> None:
    u, v = greville_abscissae(KNOTS_U, 3), greville_abscissae(KNOTS_V, 4)
    bases = design_matrix(KNOTS_U, 3, u), design_matrix(KNOTS_V, 4, v)
    limit = np.linalg.solve(bases[0], wavy(u, v).reshape(len(u), -1)).reshape(len(u), len(v), 3)
    limit = (
        np.linalg.solve(bases[1], limit.swapaxes(0, 1).reshape(len(v), -1)).reshape(len(v), len(u), 3).swapaxes(0, 1)
    )
    errors = [np.linalg.norm(poles - limit) for poles in islice(iterate_pia(wavy(u, v), *bases), 400)]
    assert (errors[300] / errors[200]) ** 0.01 == pytest.approx(pia_convergence_rate(*bases), abs=1e-3)
    assert errors[-1] < 1e-6 * errors[0]


def test_lspia_comes_to_the_least_squares_fit_at_its_rate() -> None:
    u, v = np.linspace(0, 1, 23), np.linspace(0, 1, 19)
    bases = design_matrix(KNOTS_U, 3, u), design_matrix(KNOTS_V, 4, v)
    limit = fit_surface(wavy(u, v), sampled_axis(KNOTS_U, 3, u), sampled_axis(KNOTS_V, 4, v)).poles
    errors = [np.linalg.norm(poles - limit) for poles in islice(iterate_lspia(wavy(u, v), *bases), 1500)]
    low, high = gram_eigenvalue_bounds(*bases)
    assert all(
        later <= (high - low) / (high + low) * earlier for earlier, later in zip(errors[:-1], errors[1:], strict=True)
    )
    assert errors[-1] < errors[0] * ((high - low) / (high + low)) ** 1499


U, V = np.linspace(0, 1, 33), (1 - np.cos(np.pi * np.linspace(0, 1, 29))) / 2
TRANSLATES = [Joint(1, np.eye(3), np.array([1.0, 0.2, 0.0]), 3), Joint(2, np.eye(3), np.array([0.0, 1.0, -0.3]), 0)]
AXES = {
    "poles": (pole_axis(uniform_knots(3, 3), 3), pole_axis(bezier_knots(4), 4)),
    "orthonormal": (gauss_axis(uniform_knots(3, 3), 3), gauss_axis(bezier_knots(4), 4)),
}


@pytest.mark.parametrize("axes", AXES.values(), ids=AXES)
@pytest.mark.parametrize("chebyshev", [False, True])
def test_cpia_keeps_the_conditions_and_its_proven_bounds_at_every_step(
    axes: tuple[SplineAxis, SplineAxis], chebyshev: bool
) -> None:
    u, v = np.linspace(0, 1, 15), np.linspace(0, 1, 17)
    grid, samples = trapezoidal_grid(u, v), wavy(u, v)
    conditions = joint_conditions(TRANSLATES, *axes, order=1)
    subspace = solve_conditions(conditions)
    bases = [
        np.sqrt(w)[:, None] * a.design_matrix(t)
        for w, a, t in zip((grid.weights_u, grid.weights_v), axes, (u, v), strict=True)
    ]
    collocation = np.kron(np.kron(*bases), np.eye(3))
    basis = subspace.null_space_basis()
    root = np.sqrt(np.outer(grid.weights_u, grid.weights_v))[..., None]
    target = (root * samples).ravel() - collocation @ subspace.min_norm_point
    limit = subspace.min_norm_point + basis @ np.linalg.lstsq(collocation @ basis, target, rcond=None)[0]
    rate = cpia_convergence_rate(grid, *axes, chebyshev=chebyshev)
    steps = list(islice(iterate_cpia(samples, grid, *axes, subspace, chebyshev=chebyshev), 40))
    errors = [np.linalg.norm(x.ravel() - limit) for x, _ in steps]
    for k, (x, bound) in enumerate(steps):
        assert np.abs(conditions.matrix @ x.ravel() - conditions.target).max() < 1e-13
        assert errors[k] <= bound + 1e-12
        proven = 2 * rate**k / (1 + rate ** (2 * k)) if chebyshev else rate**k
        assert errors[k] <= proven * errors[0] + 1e-12


def test_the_rate_of_plain_cpia_is_that_of_the_extreme_eigenvalues_on_the_subspace() -> None:
    u, v = np.linspace(0, 1, 15), np.linspace(0, 1, 17)
    grid, axes = trapezoidal_grid(u, v), AXES["poles"]
    subspace = solve_conditions(joint_conditions(TRANSLATES, *axes, order=1))
    bases = [
        np.sqrt(w)[:, None] * a.design_matrix(t)
        for w, a, t in zip((grid.weights_u, grid.weights_v), axes, (u, v), strict=True)
    ]
    gram = np.kron(np.kron(bases[0].T @ bases[0], bases[1].T @ bases[1]), np.eye(3))
    on_subspace = np.linalg.eigvalsh(subspace.null_space_basis().T @ gram @ subspace.null_space_basis())
    low, high = gram_eigenvalue_bounds(*bases)
    assert low * (1 - 1e-9) <= on_subspace[0]
    assert on_subspace[-1] <= high * (1 + 1e-9)
    expected = max(abs(1 - 2 * value / (low + high)) for value in (on_subspace[0], on_subspace[-1]))
    bounds = fit_cpia(wavy(u, v), grid, *axes, subspace, tol=0.0, max_iterations=800, chebyshev=False).bounds
    assert (bounds[800] / bounds[600]) ** 0.005 == pytest.approx(expected, abs=1e-4)


def test_too_few_iterations_are_reported_and_a_good_start_saves_them() -> None:
    grid, axes = DataGrid(U, V, np.ones(len(U)), np.ones(len(V))), AXES["orthonormal"]
    everything = unconstrained_subspace(3 * axes[0].n_coordinates * axes[1].n_coordinates)
    short = fit_cpia(wavy(U, V), grid, *axes, everything, tol=1e-12, max_iterations=3)
    assert (short.converged, short.iterations, len(short.bounds)) == (False, 3, 4)
    full = fit_cpia(wavy(U, V), grid, *axes, everything, tol=1e-12)
    again = fit_cpia(wavy(U, V), grid, *axes, everything, tol=1e-11, start=full.surface)
    assert full.converged
    assert again.iterations == 0


def test_cpia_refuses_a_subspace_with_a_metric_of_its_own() -> None:
    axes = AXES["orthonormal"]
    subspace = solve_conditions(
        joint_conditions(TRANSLATES, *axes), np.full(3 * axes[0].n_coordinates * axes[1].n_coordinates, 2.0)
    )
    with pytest.raises(ValueError, match="metric"):
        fit_cpia(wavy(U, V), trapezoidal_grid(U, V), *axes, subspace, tol=1e-9)
