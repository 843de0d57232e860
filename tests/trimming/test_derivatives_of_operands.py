"""Distances from a body's surfaces along a patch, and parameters on a body's curves, against differences and known values."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.brep.carriers import Carrier, ConicalSurface, CylindricalSurface, Plane, SphericalSurface, ToroidalSurface
from tpmscad.brep.conics import Circle, Ellipse
from tpmscad.brep.orthogonal_projection import project_to_curve
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.quadric_table import build_implicit_surfaces, compose_with_patch, evaluate_second_jet

ORIGIN, X, Z = np.array([0.3, -0.2, 0.1]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])
CARRIERS: dict[str, Carrier] = {
    "plane": Plane(ORIGIN, X, Z),
    "cylinder": CylindricalSurface(ORIGIN, X, Z, 0.7),
    "cone": ConicalSurface(ORIGIN, X, Z, 0.7, 0.4),
    "sphere": SphericalSurface(ORIGIN, X, Z, 0.9),
    "torus": ToroidalSurface(ORIGIN, X, Z, 1.4, 0.5),
}
STEP = 1e-4


def wavy_patch() -> BSplineSurface:
    """A patch of degrees 4 and 3 with poles off a grid."""
    poles = np.stack(np.meshgrid(np.linspace(0.5, 2.0, 5), np.linspace(0.4, 1.5, 4), [0.6], indexing="ij"), axis=-1)
    poles = poles[:, :, 0] + np.random.default_rng(5).uniform(-0.2, 0.2, (5, 4, 3))
    return BSplineSurface(poles, np.repeat([0.0, 1.0], 5), np.repeat([0.0, 1.0], 4), 4, 3)


@pytest.mark.parametrize("name", CARRIERS)
def test_the_second_derivatives_of_a_distance_along_a_patch_are_those_of_differences(name: str) -> None:
    distance = compose_with_patch(wavy_patch(), build_implicit_surfaces([CARRIERS[name]]))
    at = np.array([0.37, 0.61])
    value, gradient, hessian = evaluate_second_jet(distance, at)
    around = {
        (i, k): evaluate_second_jet(distance, at + STEP * np.array([i, k]))
        for i, k in ((1, 0), (-1, 0), (0, 1), (0, -1))
    }
    for axis, (ahead, behind) in enumerate((((1, 0), (-1, 0)), ((0, 1), (0, -1)))):
        ahead, behind = around[ahead], around[behind]
        assert (ahead[0] - behind[0]) / (2 * STEP) == pytest.approx(gradient[axis], rel=1e-5, abs=1e-6)
        np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * STEP), hessian[axis], rtol=1e-5, atol=1e-5)
    assert value == pytest.approx(float(np.ravel(distance.grid(at[:1], at[1:]))[0]))


@pytest.mark.parametrize("start", [-2.0, 0.0, 3.0])
@pytest.mark.parametrize("length", [0.5, 3.0, 6.0])
@pytest.mark.parametrize("kind", ["circle", "ellipse"])
def test_the_parameter_of_a_point_on_a_conic_lies_in_its_span(kind: str, length: float, start: float) -> None:
    curve = Circle(ORIGIN, X, Z, 1.3) if kind == "circle" else Ellipse(ORIGIN, X, Z, 1.6, 0.9)
    expected = np.linspace(start, start + length, 9)
    found, distance = project_to_curve(curve, np.array([start, start + length]), curve(expected))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(distance, 0.0, atol=1e-9)
