"""Conditions between rigid copies: complete, true of exact surfaces, and what they say about copies that meet."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tpmscad import surfaces
from tpmscad.splines.affine_subspace import solve_conditions
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.continuity_conditions import Joint, joint_conditions, side_derivative_rows
from tpmscad.splines.knots import bezier_knots, uniform_knots
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis, pole_axis
from tpmscad.splines.surface_fit import coordinates_from_surface, fit_surface

EXACT = [info.name for info in surfaces.CATALOGUE.values() if info.primitives == "exact"]

SPACES = {
    "Bezier 7": (bezier_knots(7), 7),
    "Bezier 11": (bezier_knots(11), 11),
    "Bezier 16": (bezier_knots(16), 16),
    "quintic, 2 spans C2": (uniform_knots(2, 5, 2), 5),
    "sextic, 3 spans C3": (uniform_knots(3, 6, 3), 6),
}


def side_parameters(side: int, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(u, v) along a side of the unit square, counter-clockwise."""
    return [(t, 0 * t), (0 * t + 1, t), (1 - t, 0 * t + 1), (0 * t, 1 - t)][side]


def normal_and_curvature(surface: BSplineSurface, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normal (n, 3) and curvature tensor (n, 3, 3), neither of which depends on the parametrisation."""
    tangents = np.stack([surface(u, v, 1, 0), surface(u, v, 0, 1)], axis=-1)
    normal = np.cross(tangents[..., 0], tangents[..., 1])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    second = [[surface(u, v, 2, 0), surface(u, v, 1, 1)], [surface(u, v, 1, 1), surface(u, v, 0, 2)]]
    form = np.array([[(s * normal).sum(-1) for s in row] for row in second]).transpose(2, 0, 1)
    inverse = np.linalg.pinv(tangents)
    return normal, inverse.swapaxes(1, 2) @ form @ inverse


def half_turns(name: str) -> list[Joint]:
    symmetry = surfaces.patch_symmetry(name)
    return [Joint(s, symmetry.edge_motions.rotation[s], symmetry.edge_motions.translation[s], s) for s in range(4)]


@cache
def smooth_fit(name: str, share: float, space: str) -> BSplineSurface:
    """The G2 fit to the offset surface at a share of the greatest offset."""
    knots, degree = SPACES[space]
    axis = gauss_axis(knots, degree)
    patch = surfaces.primitive_patch(name)
    samples = patch.jet(*np.meshgrid(axis.points, axis.points, indexing="ij"), share * patch.max_offset).position
    return fit_surface(
        samples, axis, axis, solve_conditions(joint_conditions(half_turns(name), axis, axis, 2, valence=6))
    )


@pytest.mark.parametrize("share", [0.0, 0.5, -0.8])
@pytest.mark.parametrize("name", EXACT)
def test_the_exact_surface_satisfies_the_conditions_of_valence_six(name: str, share: float) -> None:
    patch, y = surfaces.primitive_patch(name), np.linspace(-1, 1, 21)
    axis = gauss_axis(bezier_knots(28), 28)
    samples = patch.jet(*np.meshgrid(axis.points, axis.points, indexing="ij"), share * patch.max_offset).position
    poles = coordinates_from_surface(fit_surface(samples, axis, axis), axis, axis).reshape(-1, 3)
    for joint in half_turns(name):
        here = side_derivative_rows(joint.side, axis, axis, y, 2, k=0.5)
        there = side_derivative_rows(joint.other, axis, axis, -y, 2, k=0.5)
        for order, sign in enumerate((1, -1, 1)):
            shift = joint.translation if order == 0 else 0.0
            copy = sign * (there[order] @ poles) @ joint.rotation.T + shift
            np.testing.assert_allclose(here[order] @ poles, copy, atol=(1e-12, 1e-8, 1e-6)[order])


@pytest.mark.parametrize(
    ("name", "space"),
    [
        *((name, "Bezier 11") for name in EXACT),
        *(("gyroid", space) for space in SPACES if space != "Bezier 11"),
    ],
)
def test_a_constrained_fit_joins_its_copies_with_curvature_continuity(name: str, space: str) -> None:
    surface = smooth_fit(name, 0.7, space)
    t = np.linspace(0, 1, 57)
    for joint in half_turns(name):
        u, v = side_parameters(joint.side, t)
        gap = surface(u, v) - (surface(u, v)[::-1] @ joint.rotation.T + joint.translation)
        assert np.abs(gap).max() < 1e-13
        normal, curvature = normal_and_curvature(surface, u, v)
        there = normal[::-1] @ joint.rotation.T, joint.rotation @ curvature[::-1] @ joint.rotation.T
        assert np.degrees(np.linalg.norm(np.cross(normal, there[0]), axis=-1).max()) < 1e-8
        assert np.abs(curvature - there[1]).max() < 1e-8 * np.abs(curvature).max()


@pytest.mark.parametrize("name", EXACT)
def test_the_six_patches_around_a_vertex_share_its_tangent_plane_and_curvature(name: str) -> None:
    surface, joints = smooth_fit(name, 0.7, "Bezier 11"), half_turns(name)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    points = surface(*corners.T)
    normals, curvatures = normal_and_curvature(surface, *corners.T)
    largest = np.abs(normal_and_curvature(surface, np.array([0.5]), np.array([0.5]))[1]).max()  # vertices are flat
    rotation, translation, corner = np.eye(3), np.zeros(3), 0
    for _ in range(6):  # turn about corner 0: over the side that ends there, to the copy whose other end it is
        joint = joints[corner - 1]
        rotation, translation = rotation @ joint.rotation, rotation @ joint.translation + translation
        corner = (corner - 1) % 4  # a half-turn of side c - 1 takes its end, corner c, to its start
        np.testing.assert_allclose(rotation @ points[corner] + translation, points[0], atol=1e-13)
        np.testing.assert_allclose(rotation @ normals[corner], normals[0], atol=1e-10)
        np.testing.assert_allclose(rotation @ curvatures[corner] @ rotation.T, curvatures[0], atol=1e-8 * largest)
    # Six turns go once and a half around the patch's corners: the ring has closed on the patch turned about its middle.
    middle = surface(0.5, 0.5)
    np.testing.assert_allclose(rotation @ middle + translation, middle, atol=1e-13)


def random_member(
    joints: list[Joint], axis_u: SplineAxis, axis_v: SplineAxis, order: int, valence: int
) -> BSplineSurface:
    """Some surface that satisfies the conditions: a random one, projected."""
    subspace = solve_conditions(joint_conditions(joints, axis_u, axis_v, order, valence))
    rng = np.random.default_rng(1)
    coordinates = subspace.project(rng.normal(size=3 * axis_u.n_coordinates * axis_v.n_coordinates)).reshape(
        axis_u.n_coordinates, axis_v.n_coordinates, 3
    )
    poles = np.einsum("pu,uvd,qv->pqd", axis_u.to_poles, coordinates, axis_v.to_poles)
    return BSplineSurface(poles, axis_u.knots, axis_v.knots, axis_u.degree, axis_v.degree)


UNEQUAL = {
    "poles": (pole_axis(uniform_knots(3, 4, 2), 4), pole_axis(uniform_knots(2, 6, 3), 6)),
    "orthonormal": (gauss_axis(bezier_knots(6), 6), gauss_axis(uniform_knots(4, 5), 5)),
}


@pytest.mark.parametrize("axes", UNEQUAL.values(), ids=UNEQUAL)
@pytest.mark.parametrize("order", [0, 1, 2])
def test_valence_four_is_parametric_continuity_between_translates(
    axes: tuple[SplineAxis, SplineAxis], order: int
) -> None:
    joints = [Joint(1, np.eye(3), np.array([2.0, 0.5, 0.0]), 3), Joint(2, np.eye(3), np.array([0.0, 1.0, 1.0]), 0)]
    surface = random_member(joints, *axes, order, 4)
    t = np.linspace(0, 1, 23)
    for m in range(3):
        shift = 1.0 if m == 0 else 0.0
        across_u = surface(1 + 0 * t, t, m, 0) - surface(0 * t, t, m, 0) - shift * joints[0].translation
        across_v = surface(t, 1 + 0 * t, 0, m) - surface(t, 0 * t, 0, m) - shift * joints[1].translation
        worst = max(np.abs(across_u).max(), np.abs(across_v).max())
        assert worst < 1e-9 if m <= order else worst > 0.1


def test_a_mirror_copy_joins_along_a_side_run_the_same_way() -> None:
    mirror = Joint(1, np.diag([-1.0, 1.0, 1.0]), np.array([2.0, 0.0, 0.0]), 1)
    surface = random_member([mirror], gauss_axis(bezier_knots(6), 6), gauss_axis(uniform_knots(3, 5, 2), 5), 2, 4)
    t = np.linspace(0, 1, 23)
    np.testing.assert_allclose(surface(1 + 0 * t, t)[:, 0], 1.0, atol=1e-12)
    round_off = 1e-14 * np.abs(surface.poles).max()  # of poles up to 3700
    np.testing.assert_allclose(surface(1 + 0 * t, t, 1, 0)[:, 1:], 0.0, atol=round_off)
    np.testing.assert_allclose(surface(1 + 0 * t, t, 2, 0)[:, 0], 0.0, atol=1e-10)


def test_valence_three_joins_the_six_faces_of_a_cube_to_a_smooth_sphere() -> None:
    axis = gauss_axis(bezier_knots(10), 10)
    x, y = np.meshgrid(2 * axis.points - 1, 2 * axis.points - 1, indexing="ij")
    samples = np.stack([x, y, np.ones_like(x)], axis=-1)
    samples /= np.linalg.norm(samples, axis=-1, keepdims=True)
    joints = []
    for side, (a, b) in enumerate([(0, -1), (1, 0), (0, 1), (-1, 0)]):
        n = np.array([a, b, 1.0]) / np.sqrt(2)
        joints.append(Joint(side, 2 * np.outer(n, n) - np.eye(3), np.zeros(3), side))
    surface = fit_surface(samples, axis, axis, solve_conditions(joint_conditions(joints, axis, axis, 2, valence=3)))
    t = np.linspace(0, 1, 33)
    assert np.abs(np.linalg.norm(surface.grid(t, t), axis=-1) - 1).max() < 1e-3
    for joint in joints:
        normal, curvature = normal_and_curvature(surface, *side_parameters(joint.side, t))
        np.testing.assert_allclose(normal, normal[::-1] @ joint.rotation.T, atol=1e-10)
        np.testing.assert_allclose(curvature, joint.rotation @ curvature[::-1] @ joint.rotation.T, atol=1e-9)


def test_conditions_that_exclude_one_another_are_refused() -> None:
    shifted = [Joint(1, np.eye(3), np.array([1.0, 0, 0]), 3), Joint(1, np.eye(3), np.array([0, 1.0, 0]), 3)]
    axis = gauss_axis(bezier_knots(5), 5)
    with pytest.raises(ValueError, match="contradict"):
        solve_conditions(joint_conditions(shifted, axis, axis))
