"""Direct fits: reproduction, optimality under conditions, accuracy on the minimal surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space

from tpmscad import surfaces
from tpmscad.lattices.primitive import self_joint_conditions
from tpmscad.splines.affine_subspace import pole_metric, solve_conditions, unconstrained_subspace
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.continuity_conditions import Joint, joint_conditions
from tpmscad.splines.knots import bezier_knots, uniform_knots
from tpmscad.splines.spline_axis import gauss_axis, pole_axis, sampled_axis
from tpmscad.splines.surface_fit import coordinates_from_surface, fit_surface

TRANSLATES = [Joint(1, np.eye(3), np.array([1.0, 0.2, 0.0]), 3), Joint(2, np.eye(3), np.array([0.0, 1.0, -0.3]), 0)]
U, V = np.linspace(0, 1, 15), np.linspace(0, 1, 18) ** 1.5


def wavy(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    x, y = np.meshgrid(u, v, indexing="ij")
    return np.stack([x, y, np.sin(5 * x + 2 * y) + x * y], axis=-1)


def test_a_surface_of_the_space_is_reproduced() -> None:
    ku, kv = uniform_knots(3, 4, 2), bezier_knots(6)
    rng = np.random.default_rng(0)
    surface = BSplineSurface(rng.normal(size=(len(ku) - 5, 7, 3)), ku, kv, 4, 6)
    axes = sampled_axis(ku, 4, U), sampled_axis(kv, 6, V, np.linspace(1, 3, len(V)))
    np.testing.assert_allclose(fit_surface(surface.grid(U, V), *axes).poles, surface.poles, atol=1e-11)


def test_coordinates_of_a_surface_give_it_back() -> None:
    axes = gauss_axis(uniform_knots(3, 4, 2), 4), gauss_axis(bezier_knots(6), 6)
    surface = fit_surface(wavy(axes[0].points, axes[1].points), *axes)
    back = np.einsum("pu,uvd,qv->pqd", axes[0].to_poles, coordinates_from_surface(surface, *axes), axes[1].to_poles)
    np.testing.assert_allclose(back, surface.poles, atol=1e-12)


@pytest.mark.parametrize("weights", [None, np.linspace(1, 4, len(V))])
def test_the_constrained_fit_is_the_solution_of_the_normal_equations_in_the_null_space(weights) -> None:
    """The oracle works on the poles: null space by SciPy, then one dense least-squares problem."""
    ku, kv = uniform_knots(3, 4, 2), bezier_knots(6)
    axes = sampled_axis(ku, 4, U), sampled_axis(kv, 6, V, weights)
    got = fit_surface(wavy(U, V), *axes, solve_conditions(joint_conditions(TRANSLATES, *axes, order=1)))
    poles = pole_axis(ku, 4), pole_axis(kv, 6)
    rows = joint_conditions(TRANSLATES, *poles, order=1)
    basis = null_space(rows.matrix, rcond=1e-10)
    particular = np.linalg.lstsq(rows.matrix, rows.target, rcond=1e-10)[0]
    root = np.sqrt(axes[1].weights)
    collocation = np.kron(np.kron(poles[0].design_matrix(U), root[:, None] * poles[1].design_matrix(V)), np.eye(3))
    target = (root[:, None] * wavy(U, V)).ravel()
    free_part = np.linalg.lstsq(collocation @ basis, target - collocation @ particular, rcond=None)[0]
    np.testing.assert_allclose(got.poles.ravel(), particular + basis @ free_part, atol=1e-10)


def test_a_subspace_of_no_conditions_changes_nothing() -> None:
    axes = gauss_axis(uniform_knots(3, 4, 2), 4), gauss_axis(bezier_knots(6), 6)
    samples = wavy(axes[0].points, axes[1].points)
    whole = unconstrained_subspace(3 * axes[0].n_coordinates * axes[1].n_coordinates)
    assert whole.dimension == whole.null_space_basis().shape[1] == 3 * axes[0].n_coordinates * axes[1].n_coordinates
    np.testing.assert_array_equal(fit_surface(samples, *axes, whole).poles, fit_surface(samples, *axes).poles)


@pytest.mark.parametrize("weighted", [False, True])
def test_subspace_directions_and_basis_agree(weighted: bool) -> None:
    axes = gauss_axis(uniform_knots(3, 4, 2), 4), gauss_axis(bezier_knots(6), 6)
    conditions = joint_conditions(TRANSLATES, *axes)
    metric = np.random.default_rng(1).uniform(0.1, 10, conditions.matrix.shape[1]) if weighted else None
    subspace = solve_conditions(conditions, metric)
    basis, squares = subspace.null_space_basis(), np.ones(conditions.matrix.shape[1]) if metric is None else metric**2
    x = np.random.default_rng(0).normal(size=len(basis))
    assert basis.shape[1] == subspace.dimension
    np.testing.assert_allclose(basis.T @ (squares[:, None] * basis), np.eye(subspace.dimension), atol=1e-12)
    np.testing.assert_allclose(basis @ (basis.T @ (squares * x)), subspace.project_direction(x), atol=1e-12)
    np.testing.assert_allclose(conditions.matrix @ subspace.project(x), conditions.target, atol=1e-12)
    np.testing.assert_allclose(basis.T @ (squares * (x - subspace.project(x))), 0.0, atol=1e-10)


@pytest.mark.parametrize("reference", ["minimal", "nodal"])
def test_the_pole_metric_keeps_poles_near_the_surface(reference: str) -> None:
    patch = surfaces.primitive_patch("schwarz_p", reference)
    axis = gauss_axis(bezier_knots(14), 14)
    samples = patch.jet(*np.meshgrid(axis.points, axis.points, indexing="ij"), 0.8 * patch.max_offset).position
    conditions = self_joint_conditions("schwarz_p", axis, axis)
    sizes = []
    for metric in (None, pole_metric(axis, axis)):
        fitted = fit_surface(samples, axis, axis, solve_conditions(conditions, metric))
        sizes.append(np.ptp(fitted.poles.reshape(-1, 3), axis=0).max() / np.ptp(samples.reshape(-1, 3), axis=0).max())
    assert sizes[0] > 2
    assert sizes[1] < 1.3


def test_the_pole_metric_is_flat_at_low_degrees() -> None:
    axis = gauss_axis(bezier_knots(7), 7)
    np.testing.assert_allclose(pole_metric(axis, axis), 1.0, atol=0.06)


def test_samples_off_the_grid_are_refused() -> None:
    axes = gauss_axis(uniform_knots(3, 4, 2), 4), gauss_axis(bezier_knots(6), 6)
    with pytest.raises(ValueError, match="grid"):
        fit_surface(wavy(axes[1].points, axes[0].points), *axes)
