"""The control nets of exact, mirrored and mapped lattices are CPIA's: they equal the direct solution within the proven bound."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import lstsq

from tpmscad import surfaces
from tpmscad.lattices import g2_fit, mirror_fit
from tpmscad.lattices.harmonic_chart import compute_harmonic_chart
from tpmscad.lattices.primitive import fit_primitive, self_joint_conditions
from tpmscad.splines.affine_subspace import pole_metric, solve_conditions
from tpmscad.splines.basis import bernstein_basis
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import bezier_knots, bezier_surface
from tpmscad.splines.spline_axis import gauss_axis
from tpmscad.splines.surface_fit import fit_surface

EXACT = [info.name for info in surfaces.CATALOGUE.values() if info.primitives == "exact"]
T = np.linspace(0, 1, 33)


def distance(first: BSplineSurface, second: BSplineSurface) -> float:
    return float(np.linalg.norm(first.grid(T, T) - second.grid(T, T), axis=-1).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("tol", [1e-3, 1e-6])
def test_the_net_of_an_exact_surface_is_the_direct_solution_within_the_proven_bound(name: str, tol: float) -> None:
    offset = 0.05
    fit = fit_primitive(name, "minimal", offset, tol)
    axis = gauss_axis(bezier_knots(fit.degree), fit.degree)
    samples = surfaces.primitive_patch(name).jet(axis.points[:, None], axis.points, offset).position
    conditions = self_joint_conditions(name, axis, axis)
    direct = fit_surface(samples, axis, axis, solve_conditions(conditions, pole_metric(axis, axis)))
    assert distance(fit.surface, direct) <= fit.convergence.bound <= 1e-3 * tol
    assert fit.convergence.iterations == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["iwp", "neovius", "frd"])
def test_the_net_of_a_mirror_surface_is_the_direct_solution_within_the_proven_bound(name: str) -> None:
    chart, offset = compute_harmonic_chart(name), 0.03
    space = mirror_fit._make_piece_space(chart, 9)
    net = mirror_fit._fit_chart_samples(chart, space, offset)
    t = space.axis.points
    direct = fit_surface(chart.offset(t[:, None], t, offset), space.axis, space.axis, space.subspace)
    assert distance(net.patch, direct) <= net.convergence.bound <= 1e-9

    corrected = mirror_fit._fit_corrected_samples(chart, space, net, offset)
    assert corrected.convergence.bound <= 1e-9
    before, after = (mirror_fit._max_offset_error(chart, n.patch, offset) for n in (net, corrected))
    assert after < before


@pytest.mark.slow
def test_the_last_step_of_a_mirror_fit_does_not_increase_the_sum_of_squared_distances() -> None:
    chart, offset = compute_harmonic_chart("iwp"), 0.03
    space = mirror_fit._make_piece_space(chart, 9)
    charted = mirror_fit._fit_chart_samples(chart, space, offset)
    n = space.axis.n_coordinates
    slid = mirror_fit._slide_along_surface(chart, space, charted.coordinates, offset).reshape(n, n, 3)
    last = mirror_fit._fit_corrected_samples(chart, space, charted, offset).coordinates.reshape(n, n, 3)

    def sum_of_squares(coordinates: np.ndarray) -> float:
        design = space.axis.design_matrix(space.axis.points)
        points = np.einsum("mu,uvd,nv->mnd", design, coordinates, design)
        found = chart.symmetry.waves.project_to_level_set(points)[0] - offset
        return float((np.outer(space.axis.weights, space.axis.weights) * found**2).sum())

    assert sum_of_squares(last) <= sum_of_squares(slid) * (1 + 1e-9)


@pytest.mark.parametrize("degree", [9, 12, 16])
def test_the_inner_poles_of_mapped_patches_are_the_direct_solution_within_the_proven_bound(degree: int) -> None:
    """Direct: least squares on the sites in the Bernstein basis, one direction after the other, by SciPy."""
    t = g2_fit.sample_parameters()
    u, v = np.meshgrid(t, t, indexing="ij")
    patch = np.stack([u, v + 0.3 * np.sin(2 * u), np.sin(3 * u + v) * np.cos(2 * v)], axis=-1)
    samples = np.stack([patch, 10 * patch[..., ::-1] + 3])
    poles, convergence = g2_fit.fit_g2_patches(samples, degree)
    border = poles.copy()
    border[:, 3:-3, 3:-3] = 0
    operators = g2_fit._fit_operators(degree, len(t))
    sites = 0.5 * (1 - np.cos(np.pi * (np.arange(3 * degree) + 0.5) / (3 * degree)))
    basis = bernstein_basis(degree, sites)
    values = np.einsum("am,pmnk,bn->pabk", operators.values_at_sites, samples, operators.values_at_sites)
    rest = values - np.einsum("ai,pijk,bj->pabk", basis, border, basis)
    k, sites_count = degree - 5, len(sites)
    half = lstsq(basis[:, 3:-3], rest.transpose(1, 0, 2, 3).reshape(sites_count, -1))[0]
    half = half.reshape(k, 2, sites_count, 3).transpose(2, 0, 1, 3)
    inner = lstsq(basis[:, 3:-3], half.reshape(sites_count, -1))[0].reshape(k, k, 2, 3)
    direct = border
    direct[:, 3:-3, 3:-3] = inner.transpose(2, 1, 0, 3)
    apart = max(distance(bezier_surface(p), bezier_surface(q)) for p, q in zip(poles, direct, strict=True))
    assert apart <= convergence.bound <= 1e-8
    assert convergence.iterations == 1
