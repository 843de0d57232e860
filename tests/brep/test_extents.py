"""True extents: closed forms for a trimmed paraboloid, and for tori, spheres, cylinders and cones in any position."""

from dataclasses import replace

import numpy as np
import pytest

from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, select_faces
from tpmscad.brep.extents import true_bounds
from tpmscad.brep.quadrics import SphericalSurface, ToroidalSurface
from tpmscad.rigid_motion import Motion
from tpmscad.splines import BSplineCurve, BSplineSurface, bezier_knots, line_segment, split_surface
from tpmscad.splines.basis import bernstein_basis

UNIT = bezier_knots(2, (-1.0, 1.0))
ONE, X, XX = np.ones(3), np.array([-1.0, 0.0, 1.0]), np.array([1.0, -1.0, 1.0])
PARABOLOID = BSplineSurface(
    np.stack([np.outer(X, ONE), np.outer(ONE, X), 1.0 - np.outer(XX, ONE) - np.outer(ONE, XX)], axis=-1),
    UNIT,
    UNIT,
    2,
    2,
)
"""z = 1 - x^2 - y^2"""


def trimmed_face(surface, corners, motion=None):
    """One face inside a polygon of parameters, whose edges are images of straight lines: Bezier curves of degree four."""
    n = len(corners)
    pcurves = [line_segment(corners[i], corners[(i + 1) % n]) for i in range(n)]
    nodes = np.linspace(0.0, 1.0, 5)
    basis = bernstein_basis(4, nodes)
    images = [np.linalg.solve(basis, surface(*c(nodes).T)) for c in pcurves]
    place = Motion.identity(1)[0] if motion is None else motion
    every = Motion.stack([place] * n)
    return Brep(
        (surface,),
        tuple(BSplineCurve(poles, bezier_knots(4), 4) for poles in images),
        tuple(pcurves),
        place.apply(surface(*np.transpose(corners))),
        Edges(np.arange(n), every, np.tile([0.0, 1.0], (n, 1)), np.arange(n), (np.arange(n) + 1) % n, np.zeros(n)),
        EdgeUses(np.arange(n), np.ones(n, int), np.arange(n)),
        Faces(np.zeros(1, int), every[:1], np.ones(1, int), np.zeros(1, int), np.array([0, 1]), np.array([0, n])),
        ("offset+",),
    )


def random_rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.diag(r))


def distance_to_triangle(corners):
    """Distance of the origin from a triangle in the plane."""
    away = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        t = np.clip(-a @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away.append(np.linalg.norm(a + t * (b - a)))
    turns = [a[0] * b[1] - a[1] * b[0] for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return 0.0 if min(turns) > 0 or max(turns) < 0 else min(away)


@pytest.mark.parametrize("seed", range(12))
def test_a_trimmed_paraboloid_is_as_high_as_its_point_nearest_to_the_axis(seed):
    corners = np.random.default_rng(seed).uniform(-0.9, 0.9, (3, 2))
    low, high = true_bounds(trimmed_face(PARABOLOID, corners))
    np.testing.assert_allclose(high, [*corners.max(axis=0), 1.0 - distance_to_triangle(corners) ** 2], atol=2e-9)
    np.testing.assert_allclose(low, [*corners.min(axis=0), 1.0 - (corners**2).sum(axis=1).max()], atol=2e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_the_box_of_a_turned_trimmed_patch_is_that_of_a_dense_sample(seed):
    rng = np.random.default_rng(seed)
    corners, motion = rng.uniform(-0.9, 0.9, (3, 2)), Motion(random_rotation(rng), rng.normal(size=3))
    a, b = np.meshgrid(np.linspace(0, 1, 600), np.linspace(0, 1, 600))
    uv = corners[0] + a[..., None] * (corners[1] - corners[0]) + (a * b)[..., None] * (corners[2] - corners[1])
    points = motion.apply(PARABOLOID(uv[..., 0], uv[..., 1])).reshape(-1, 3)
    low, high = true_bounds(trimmed_face(PARABOLOID, corners, motion))
    assert (points.min(axis=0) >= low - 1e-8).all()
    assert (points.max(axis=0) <= high + 1e-8).all()
    np.testing.assert_allclose([low, high], [points.min(axis=0), points.max(axis=0)], atol=1e-5)


def test_inner_knots_do_not_change_the_box():
    corners = np.array([[-0.5, -0.4], [0.7, -0.3], [0.1, 0.8]])
    low, high = split_surface(PARABOLOID, 0, 0.31)
    knots = np.concatenate([low.knots_u[:-1], high.knots_u[3:]])
    split = BSplineSurface(np.concatenate([low.poles, high.poles[1:]]), knots, UNIT, 2, 2)
    whole = true_bounds(trimmed_face(PARABOLOID, corners))
    np.testing.assert_allclose(true_bounds(trimmed_face(split, corners)), whole, atol=1e-9)


def half_turn(carrier, v, shift):
    """The face u in [0, pi], v in an interval, of a quadric; u runs in a period of its own."""
    u = shift, shift + np.pi
    return trimmed_face(carrier, np.array([[u[0], v[0]], [u[1], v[0]], [u[1], v[1]], [u[0], v[1]]]))


@pytest.mark.parametrize("shift", [0.0, 2 * np.pi, -2 * np.pi])
@pytest.mark.parametrize(
    ("carrier", "v"),
    [
        (SphericalSurface(np.array([1.0, 2, 3]), np.eye(3)[0], np.eye(3)[2], 2.0), (-0.7, 0.4)),
        (ToroidalSurface(np.array([1.0, 2, 3]), np.eye(3)[0], np.eye(3)[2], 3.0, 1.0), (-0.7, 0.4)),
    ],
)
def test_round_faces_reach_their_equator_inside_the_face_in_any_period(carrier, v, shift):
    _, high = true_bounds(half_turn(carrier, v, shift))
    reach = carrier.radius if isinstance(carrier, SphericalSurface) else carrier.major + carrier.minor
    assert high[1] == pytest.approx(2.0 + reach, abs=1e-12)
    low, _ = true_bounds(half_turn(carrier, v, shift))
    assert low[1] == pytest.approx(2.0, abs=1e-9)


def test_a_boundary_without_faces_has_no_extent():
    face = trimmed_face(PARABOLOID, np.array([[0.0, 0], [0.5, 0], [0, 0.5]]))
    with pytest.raises(ValueError, match="no extent"):
        true_bounds(replace(face, faces=select_faces(face, np.zeros(0, int)).faces))
