"""Coordinates orthonormal on the samples, and their poles."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.splines.basis import design_matrix, legendre_to_bernstein
from tpmscad.splines.knots import bezier_knots, greville_abscissae, uniform_knots
from tpmscad.splines.quadrature import composite_gauss_legendre
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis, pole_axis, sampled_axis

AXES = {
    "Bezier 7": gauss_axis(bezier_knots(7, (-1.0, 2.5)), 7),
    "Bezier 16": gauss_axis(bezier_knots(16), 16, 0),
    "quintic C2": gauss_axis(uniform_knots(4, 5, 2), 5),
    "cubic": gauss_axis(uniform_knots(5, 3, None, (2.0, 3.0)), 3),
    "Bezier on its own points": sampled_axis(bezier_knots(9), 9, np.linspace(0, 1, 33) ** 2),
    "cubic on its own points": sampled_axis(uniform_knots(5, 3), 3, np.linspace(0, 1, 21), np.linspace(1, 2, 21)),
}


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_coordinates_are_orthonormal_on_the_samples(axis: SplineAxis) -> None:
    sampled = axis.weighted_design_matrix()
    np.testing.assert_allclose(sampled.T @ sampled, np.eye(axis.n_coordinates), atol=1e-13)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_coordinates_and_their_poles_are_the_same_spline(axis: SplineAxis, order: int) -> None:
    low, high = axis.domain
    t = np.linspace(low, high, 41)
    by_poles = design_matrix(axis.knots, axis.degree, t, order) @ axis.to_poles
    scale = np.abs(by_poles).max()
    np.testing.assert_allclose(axis.design_matrix(t, order) / scale, by_poles / scale, atol=1e-11)


def test_the_pole_axis_has_poles_for_coordinates() -> None:
    knots = uniform_knots(3, 4, 1)
    t = np.linspace(0, 1, 17)
    np.testing.assert_array_equal(pole_axis(knots, 4).design_matrix(t, 1), design_matrix(knots, 4, t, 1))


def test_legendre_columns_in_bernstein_form_are_legendre_polynomials() -> None:
    t = np.linspace(0, 1, 13)
    values = design_matrix(bezier_knots(6), 6, t) @ legendre_to_bernstein(6)
    for i in range(7):
        expected = np.polynomial.legendre.Legendre.basis(i, domain=[0, 1])(t) * np.sqrt(2 * i + 1)
        np.testing.assert_allclose(values[:, i], expected, atol=1e-13)


def test_span_gauss_integrates_piecewise_polynomials_exactly() -> None:
    knots = uniform_knots(3, 4, 2, (1.0, 4.0))
    points, weights = composite_gauss_legendre(knots, 4)
    np.testing.assert_allclose(weights @ points**7, (4.0**8 - 1) / 8, rtol=1e-14)


def test_a_linear_spline_has_the_greville_points_for_poles() -> None:
    knots = uniform_knots(3, 4, 2, (1.0, 4.0))
    t = np.linspace(1, 4, 9)
    np.testing.assert_allclose(design_matrix(knots, 4, t) @ greville_abscissae(knots, 4), t, atol=1e-14)


@pytest.mark.parametrize(
    ("points", "message"),
    [(np.linspace(0, 1, 6), "can't determine 8"), (np.linspace(0, 0.3, 20), "too few")],
)
def test_samples_that_leave_the_spline_open_are_refused(points: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sampled_axis(uniform_knots(5, 3), 3, points)


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_no_spline_exceeds_its_coordinates_by_more_than_the_factor(axis: SplineAxis) -> None:
    greatest = np.linalg.norm(
        axis.design_matrix(np.linspace(*axis.domain, 401)), axis=1
    ).max()  # of |S(t)| where |x| = 1
    assert greatest <= axis.max_norm_factor * (1 + 1e-12)


def test_the_factor_of_orthonormal_legendre_polynomials_is_attained() -> None:
    axis = gauss_axis(bezier_knots(7), 7)
    at_end = np.linalg.norm(axis.design_matrix(np.array([1.0])))
    assert axis.max_norm_factor == pytest.approx(at_end, rel=1e-9)
