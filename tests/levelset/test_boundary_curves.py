"""Laws of curves fitted to a level set inside a box."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.fields.kinds.linear_extension import extend_linearly
from tpmscad.levelset.fit.joint_normals import EndShapes, measure_second_forms
from tpmscad.levelset.fit.network_curves import fit_curves
from tpmscad.splines.basis import bernstein_basis

LO, HI = np.array([0.0, 0.0, 0.0]), np.array([9.0, 10.0, 11.0])
RADIUS = 4.0
T = np.linspace(0.0, 1.0, 41)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("upper", [0, 1])
@pytest.mark.parametrize("degree", [5, 7])
def test_a_curve_between_points_of_the_box_stays_in_it_where_the_surface_bulges_out(
    axis: int, upper: int, degree: int
) -> None:
    # a ball that sticks out of one face by 0.1: the shortest way between two points beside the section leads beyond the face
    centre = 0.5 * (LO + HI)
    centre[axis] = (LO, HI)[upper][axis] + (-1, 1)[upper] * (0.1 - RADIUS)
    inward = np.zeros(3)
    inward[axis] = (1, -1)[upper]
    rim = np.sqrt(RADIUS**2 - (RADIUS - 0.1) ** 2)
    ends = []
    for angle in (0.3, 2.2):
        around = np.insert(1.15 * rim * np.array([np.cos(angle), np.sin(angle)]), axis, 0.0)
        ends.append(centre + around - inward * np.sqrt(RADIUS**2 - around @ around))
    field = extend_linearly(fields.sphere(tuple(centre), RADIUS), LO, HI)
    start, end = (np.array([p]) for p in ends)
    shapes = EndShapes(*measure_second_forms(field, np.stack([start, end], axis=1), 10.0))
    poles = fit_curves(field, start, end, np.zeros((1, 3), bool), degree, shapes)[0]
    points = bernstein_basis(degree, T) @ poles
    assert np.allclose(points[[0, -1]], [start[0], end[0]], atol=1e-12)
    assert ((points >= LO) & (points <= HI)).all()
    assert np.abs(np.linalg.norm(points - centre, axis=1) - RADIUS).max() < 1e-3


def test_a_curve_in_the_box_is_the_same_with_the_box_and_without() -> None:
    centre = np.array([4.5, 5.0, 5.5])
    ball = fields.sphere(tuple(centre), RADIUS)
    start, end = (centre + RADIUS * np.array([d]) for d in ([0.6, 0.8, 0.0], [0.0, 0.6, 0.8]))
    free = np.zeros((1, 3), bool)
    shapes = EndShapes(*measure_second_forms(ball, np.stack([start, end], axis=1), 10.0))
    assert np.array_equal(
        fit_curves(ball, start, end, free, 5, shapes),
        fit_curves(extend_linearly(ball, LO - 9.0, HI + 9.0), start, end, free, 5, shapes),
    )


@pytest.mark.parametrize("beyond", [0.0, 1e-9, 1e-3, 0.5])
def test_beyond_the_box_the_curvature_is_that_at_the_nearest_point_of_the_box(beyond: float) -> None:
    ball = extend_linearly(
        fields.sphere((4.5, 5.0, 5.5), RADIUS), np.array([4.5, 0.0, 0.0]), np.array([8.0, 10.0, 11.0])
    )
    _, form = measure_second_forms(ball, np.array([[4.5 - beyond, 5.0 + RADIUS, 5.5], [4.5, 5.0 + RADIUS, 5.5]]), 10.0)
    assert np.isfinite(form).all()
    tangential = np.ix_([0, 1], [0, 2], [0, 2])
    np.testing.assert_allclose(form[tangential], np.tile(np.eye(2) / RADIUS, (2, 1, 1)), atol=0.05)
