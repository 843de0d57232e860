"""The polynomials of a spline are the spline itself, whatever the degree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline, PPoly

from tpmscad.splines.basis import power_coefficients


@pytest.mark.parametrize("degree", [1, 3, 5, 8, 12])
def test_the_polynomials_of_a_spline_take_its_values(degree: int) -> None:
    inner = [0.3, 0.3, 0.7] if degree > 2 else [0.3, 0.7]
    knots = np.concatenate([[-0.5], np.zeros(degree), inner, np.ones(degree + 1)])
    coefficients = np.random.default_rng(degree).normal(size=len(knots) - degree - 1)
    breaks, powers = power_coefficients(knots, coefficients, degree)
    x = np.linspace(0.0, 1.0, 23)
    np.testing.assert_allclose(PPoly(powers, breaks)(x), BSpline(knots, coefficients, degree)(x), atol=1e-11)
