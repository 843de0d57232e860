"""Networks with faces on quadrics: exact volumes, carriers that stay what they are, and poles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.shapes import round_shapes as shapes
from tests.shapes.misfits import volume
from tests.trimming.network_operands import combine, rod
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import (
    Circle,
    ConicalSurface,
    CylindricalSurface,
    Ellipse,
    Plane,
    Quadric,
    SphericalSurface,
    ToroidalSurface,
)
from tpmscad.brep.quadrics import MIN_POLE_STEP_ANGLE
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.network_hits import locate_in_faces, prepare_networks
from tpmscad.trimming.network_boolean import combine_networks
from tpmscad.trimming.operands.conic_splines import approximate_conic, approximate_quadric
from tpmscad.trimming.operands.edge_uses import divide_uses
from tpmscad.trimming.operands.polyhedra import box

TILT = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
ORIGIN, X, Z = np.array([1.0, 2.0, 3.0]), TILT[0], TILT[2]

QUADRICS: list[Quadric] = [
    CylindricalSurface(ORIGIN, X, Z, 2.0),
    ConicalSurface(ORIGIN, X, Z, 2.0, 0.4),
    ConicalSurface(ORIGIN, X, Z, 0.3, -0.7),
    SphericalSurface(ORIGIN, X, Z, 2.0),
    ToroidalSurface(ORIGIN, X, Z, 3.0, 1.0),
]

BODIES = {
    "cylinder": lambda: shapes.cylinder(0.9, 5.0, rotation=TILT, translation=(-1.1, 0.7, -2.3)),
    "sphere": lambda: shapes.sphere(1.4, rotation=TILT, translation=(0.1, 0.2, -0.1)),
    "cone": lambda: shapes.cone(1.5, 3.0, rotation=TILT, translation=(0.1, 0.2, -1.7)),
    "torus": lambda: shapes.torus(1.2, 0.4, rotation=TILT, translation=(0.1, 0.2, -0.1)),
}


def measure_edges(brep: Brep) -> float:
    """The largest distance of edges from the planes and quadrics of their faces."""
    worst = 0.0
    for k, f in enumerate(brep.face_of_use.tolist()):
        e, carrier = brep.uses.edge[k], brep.carriers[brep.faces.carrier[f]]
        if not isinstance(carrier, BSplineSurface):
            t = np.linspace(*brep.edges.span[e], 17)
            points = brep.edges.motion[e].apply(brep.curves[brep.edges.curve[e]](t))
            off = carrier.distance(brep.faces.motion[f].apply_inverse(points))
            worst = max(worst, float(np.abs(off).max()))
    return worst


@pytest.mark.parametrize("quadric", QUADRICS, ids=lambda q: type(q).__name__)
def test_a_quadric_is_a_spline_up_to_round_off(quadric: Quadric) -> None:
    rng = np.random.default_rng(0)
    uv = rng.uniform([0.2, -1.1], [3.4, 1.3], (400, 2))
    if isinstance(quadric, ConicalSurface):  # only the nappe is a face
        uv = uv[quadric.radius + uv[:, 1] * np.sin(quadric.angle) > 0]
    patch = approximate_quadric(quadric, uv)
    np.testing.assert_allclose(patch(*uv.T), quadric(*uv.T), atol=5e-14)
    for order in ((1, 0), (0, 1)):
        np.testing.assert_allclose(patch(*uv.T, *order), quadric(*uv.T, *order), atol=2e-12)


@pytest.mark.parametrize("conic", [Circle(ORIGIN, X, Z, 2.0), Ellipse(ORIGIN, X, Z, 2.0, 0.7)])
def test_a_conic_is_a_spline_up_to_round_off(conic: Circle | Ellipse) -> None:
    t = np.linspace(-0.7, 5.9, 97)
    curve = approximate_conic(conic, -0.7, 5.9)
    np.testing.assert_allclose(curve(t), conic(t), atol=5e-14)
    np.testing.assert_allclose(curve(t, 1), conic(t, 1), atol=2e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", BODIES)
def test_patches_are_cut_by_quadrics(name: str) -> None:
    """Volumes add up, and the faces of the result lie on the carriers of the operands."""
    body = BODIES[name]()
    found = combine(rod(), body)
    v = {operation: volume(result.brep) for operation, result in found.items()}
    total = volume(rod()) + volume(body)
    assert v["union"] + v["intersection"] == pytest.approx(total, rel=1e-9)
    assert v["difference"] + v["intersection"] == pytest.approx(volume(rod()), rel=1e-9)
    carriers = {id(c) for brep in (rod(), body) for c in brep.carriers}
    for result in found.values():
        assert result.report.max_deviation <= 1e-7
        assert measure_edges(result.brep) < 1.5e-7
        assert {id(getattr(c, "whole", c)) for c in result.brep.carriers} <= carriers  # or parts of them
        assert any(not isinstance(c, BSplineSurface | Plane) for c in result.brep.carriers)


def test_two_balls_have_the_lens_of_the_formula() -> None:
    """Two spheres of radii R and r whose centres are d apart: pi (R + r - d)^2 (d^2 + 2 d (R + r) - 3 (R - r)^2) / 12 d."""
    big, small, d = 1.3, 0.9, 1.4
    turned = Rotation.from_rotvec([1.1, -0.2, 0.7]).as_matrix()
    first, second = shapes.sphere(big, rotation=TILT), shapes.sphere(small, rotation=turned, translation=d * X)
    found = combine(first, second)
    lens = np.pi * (big + small - d) ** 2 * (d**2 + 2 * d * (big + small) - 3 * (big - small) ** 2) / (12 * d)
    assert volume(found["intersection"].brep) == pytest.approx(lens, abs=1e-6)
    assert volume(found["difference"].brep) == pytest.approx(4 / 3 * np.pi * big**3 - lens, abs=1e-6)


def test_a_ball_with_a_hole_through_its_poles_is_a_ring() -> None:
    """Of a ball of radius R with a hole of radius r along its axis 4/3 pi (R^2 - r^2)^(3/2) is left."""
    ball = shapes.sphere(1.5, rotation=TILT)
    spin = Rotation.from_rotvec([0.0, 0.0, 0.4]).as_matrix()
    hole = shapes.cylinder(0.7, 6.0, rotation=TILT @ spin, translation=-3.0 * TILT[:, 2])
    found = combine(ball, hole)
    assert volume(found["difference"].brep) == pytest.approx(4 / 3 * np.pi * (1.5**2 - 0.7**2) ** 1.5, abs=1e-6)
    kept = volume(ball) - 4 / 3 * np.pi * (1.5**2 - 0.7**2) ** 1.5
    assert volume(found["intersection"].brep) == pytest.approx(kept, abs=1e-6)  # its faces have the poles


@pytest.mark.parametrize("height", [-0.9, 0.3, 1.2])
def test_a_half_space_leaves_a_cap_of_a_ball(height: float) -> None:
    """The faces of the cap end in a pole; a plane across the axis cuts circles v = const."""
    ball = shapes.sphere(1.5)
    block = box((-4, -4.1, height), (4.2, 4, 5))
    cap = volume(combine(ball, block)["intersection"].brep)
    h = 1.5 - height
    assert cap == pytest.approx(np.pi * h**2 * (3 * 1.5 - h) / 3, abs=1e-6)


def test_loops_step_along_poles() -> None:
    """A point on the other side of the pole is outside of a half ball's face, and one on this side inside."""
    network = prepare_networks(shapes.sphere(1.5), shapes.sphere(1.5), 0.0)[0]
    brep = network.brep
    use, _, length = divide_uses(brep)
    assert (length == 0).sum() == 2 * len(brep.faces)  # both poles of each face
    assert (np.bincount(use[length == 0]) <= 1).all()
    for f in range(len(brep.faces)):
        (low, high) = np.sort(network.faces.regions.segments[network.faces.regions.first[f] :][:, 0, 0])[[0, -1]]
        assert high - low > MIN_POLE_STEP_ANGLE
    for v in (-1.5, 0.0, 1.5):
        u = np.linspace(-np.pi, np.pi, 40) + 0.01
        inside = [
            locate_in_faces(network, np.full(40, f), np.column_stack([u + turn, np.full(40, v)]))[0]
            for f in range(len(brep.faces))
            for turn in (-2 * np.pi, 0.0, 2 * np.pi)
        ]
        assert (np.sum(inside, axis=0) == 1).all()


@pytest.mark.slow
def test_a_hole_beside_a_pole_is_inside_its_face() -> None:
    """The loop around a pole runs up to it: a hole in the corner between the last sample of a meridian and the pole counts."""
    ball, away, angle = shapes.sphere(1.5), 0.12, 2.8
    pin = shapes.cylinder(0.04, 4.0, translation=(away * np.cos(angle), away * np.sin(angle), -2.0))
    left = combine_networks(ball, pin, "difference").brep
    assert connectivity.is_closed(left)
    hole = 2 * np.pi * 0.04**2 * np.sqrt(1.5**2 - away**2 - 0.04**2 / 2)
    assert volume(ball) - volume(left) == pytest.approx(hole, rel=1e-5)
    assert len(left.faces) == len(ball.faces) + 2
