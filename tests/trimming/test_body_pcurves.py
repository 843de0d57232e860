"""Curves that pass the pole of a sphere or the apex of a cone at any distance have accurate pcurves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpmscad.brep.carriers import ConicalSurface, Plane, Quadric, SphericalSurface
from tpmscad.trimming.operands.face_regions import FaceRegion
from tpmscad.trimming.rebuild.body_pcurves import fit_pcurve

TOL = 5e-8
ORIGIN, X, Z = np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.0]), np.array([0.6, 0.0, 0.8])
SPHERE = SphericalSurface(ORIGIN, X, Z, 4.0)
CONE = ConicalSurface(ORIGIN, X, Z, 0.0, 0.6)


def region(carrier: Plane | Quadric) -> FaceRegion:
    return FaceRegion(carrier, np.zeros((0, 2, 2)), np.zeros((0, 2, 3)), np.zeros(2))


@settings(max_examples=12)
@given(power=st.floats(-10.0, 0.0), begin=st.floats(-2.0, -0.1), end=st.floats(0.1, 2.5))
@pytest.mark.parametrize("carrier", [SPHERE, CONE])
def test_a_curve_past_a_pole_or_an_apex_has_parameters(
    carrier: SphericalSurface | ConicalSurface, power: float, begin: float, end: float
) -> None:
    apart = 10.0**power

    def curve(y: np.ndarray) -> np.ndarray:
        """A curve in a plane parallel to the axis, at the distance `apart` from it."""
        r2 = apart**2 + y**2
        z = np.sqrt(16 - r2) if isinstance(carrier, SphericalSurface) else np.sqrt(r2) / np.tan(0.6)
        return ORIGIN + apart * X + y[:, None] * np.cross(Z, X) + z[:, None] * Z

    made, off = fit_pcurve(curve, np.array([begin, end]), region(carrier), TOL, 4)
    t = np.linspace(begin, end, 3001)
    found = np.linalg.norm(carrier(*made(t).T) - curve(t), axis=1).max()
    assert found < 1.5 * TOL
    assert off < 1.001 * TOL
    assert np.ptp(made(t)[:, 0]) < np.pi + 0.1  # the curve passes the pole without turning round it


def test_a_curve_beside_its_face_is_not_refused_for_that() -> None:
    """The distance of the curve from the carrier is no error of its pcurve."""

    def curve(t: np.ndarray) -> np.ndarray:
        r = 4.0 + 1.2 * TOL * np.cos(400 * t)
        return ORIGIN + r[:, None] * (np.cos(t)[:, None] * X + np.sin(t)[:, None] * np.cross(Z, X))

    made, off = fit_pcurve(curve, np.array([0.3, 1.7]), region(SPHERE), TOL, 4)
    t = np.linspace(0.3, 1.7, 3001)
    assert np.linalg.norm(SPHERE(*made(t).T) - curve(t), axis=1).max() < 1.4 * TOL
    assert off < 1.4 * TOL
