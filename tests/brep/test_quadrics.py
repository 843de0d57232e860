"""Quadrics as carriers, and boundary representations with faces on them: distances, derivatives, moments against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from tests.shapes.round_shapes import cone, cylinder, flask, frustum, pierced_block, sphere, torus
from tpmscad.brep.boundary_representation import scale_brep
from tpmscad.brep.carriers import (
    Circle,
    ConicalSurface,
    CylindricalSurface,
    Ellipse,
    Plane,
    SphericalSurface,
    ToroidalSurface,
)
from tpmscad.brep.edge_continuity import measure_edge_continuity
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.rigid_motion import Motion

TURN = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
FRAME = np.array([0.4, -7.0, 2.5]), TURN[0], TURN[1]
CARRIERS = {
    "plane": Plane(*FRAME),
    "cylinder": CylindricalSurface(*FRAME, 1.3),
    "opening cone": ConicalSurface(*FRAME, 1.3, 0.4),
    "closing cone": ConicalSurface(*FRAME, 2.3, -0.7),
    "sphere": SphericalSurface(*FRAME, 2.1),
    "torus": ToroidalSurface(*FRAME, 3.0, 1.1),
}
CURVES = {"circle": Circle(*FRAME, 1.7), "ellipse": Ellipse(*FRAME, 2.3, 0.6)}
PLACES = {
    "at rest": {},
    "turned": {"rotation": TURN, "translation": (0.4, -7.0, 2.5)},
    "mirrored": {"rotation": np.diag([1.0, -1.0, 1.0]) @ TURN, "translation": (1.0, 2.0, 3.0)},
}


@pytest.fixture(params=CARRIERS)
def carrier(request):
    return CARRIERS[request.param]


@pytest.fixture
def pairs():
    rng = np.random.default_rng(3)
    return rng.uniform(-3.0, 3.0, 12), rng.uniform(-1.3, 1.3, 12)


def normal(carrier, u, v):
    n = np.cross(carrier(u, v, 1, 0), carrier(u, v, 0, 1))
    return n / np.linalg.norm(n, axis=1)[:, None]


def test_parameters_find_a_point_again_and_its_distance_is_none(carrier, pairs) -> None:
    points = carrier(*pairs)
    np.testing.assert_allclose(carrier.parameters(points), np.column_stack(pairs), atol=1e-14)
    np.testing.assert_allclose(carrier.distance(points), 0.0, atol=2e-15 * 8)


@pytest.mark.parametrize("by", [-0.3, 0.2])
def test_a_step_along_the_normal_is_a_distance_of_its_length_and_sign(carrier, pairs, by: float) -> None:
    n = normal(carrier, *pairs)
    away = carrier(*pairs) + by * n
    np.testing.assert_allclose(carrier.distance(away), by, atol=2e-14)
    np.testing.assert_allclose(carrier.gradient(away), n, atol=2e-14)
    np.testing.assert_allclose(carrier.parameters(away), np.column_stack(pairs), atol=2e-14)


def test_no_point_of_the_carrier_is_nearer_than_the_distance(carrier) -> None:
    for point in np.random.default_rng(5).uniform(-4, 4, (6, 3)) + FRAME[0]:
        foot = carrier.parameters(point)
        nearest = min(
            minimize(lambda p, x=point: np.linalg.norm(carrier(*p) - x), start, tol=1e-12).fun
            for start in (foot, foot + 1.0, foot - 1.0)
        )
        assert nearest >= abs(carrier.distance(point)) - 1e-9


def test_derivatives_are_those_of_the_values(carrier, pairs) -> None:
    u, v = pairs
    h = 1e-5
    for a, b in ((0, 0), (1, 0), (0, 1), (1, 1), (2, 1), (0, 3)):
        along_u = (carrier(u + h, v, a, b) - carrier(u - h, v, a, b)) / (2 * h)
        along_v = (carrier(u, v + h, a, b) - carrier(u, v - h, a, b)) / (2 * h)
        np.testing.assert_allclose(carrier(u, v, a + 1, b), along_u, atol=2e-9)
        np.testing.assert_allclose(carrier(u, v, a, b + 1), along_v, atol=2e-9)
    points = carrier(u, v) + 0.2 * normal(carrier, u, v)
    steps = h * np.eye(3)
    slope = np.stack([(carrier.distance(points + s) - carrier.distance(points - s)) / (2 * h) for s in steps], axis=-1)
    np.testing.assert_allclose(carrier.gradient(points), slope, atol=2e-9)


def test_a_jet_is_a_point_and_its_derivatives(carrier, pairs) -> None:
    u, v = pairs
    for found, orders in zip(carrier.jet(u, v), ((0, 0), (1, 0), (0, 1)), strict=True):
        np.testing.assert_allclose(found, carrier(u, v, *orders), atol=1e-13)


def test_on_the_axis_everything_is_finite(carrier) -> None:
    on_axis = FRAME[0] + np.array([0.0, 0.7])[:, None] * FRAME[2]
    for value in (carrier.parameters, carrier.distance, carrier.gradient):
        assert np.isfinite(value(on_axis)).all()


def test_what_is_moved_or_scaled_keeps_its_distances(carrier) -> None:
    points = np.random.default_rng(1).uniform(-4, 4, (9, 3))
    for place in PLACES.values():
        if place:
            rotation, shift = place["rotation"], np.array(place["translation"])
            moved = carrier.moved(Motion(rotation, shift))
            np.testing.assert_allclose(
                moved.distance(points @ rotation.T + shift), carrier.distance(points), atol=1e-13
            )
    np.testing.assert_allclose(carrier.scaled(2.5).distance(2.5 * points), 2.5 * carrier.distance(points), atol=1e-13)


@pytest.mark.parametrize("name", CURVES)
def test_conics_lie_where_they_say_and_move_with_their_parameter(name: str) -> None:
    curve = CURVES[name]
    t = np.linspace(-1, 8, 13)
    arm = curve(t) - curve.origin
    a, b = (curve.radius,) * 2 if name == "circle" else (curve.major, curve.minor)
    np.testing.assert_allclose((arm @ curve.x_axis / a) ** 2 + (arm @ curve.y_axis / b) ** 2, 1.0, atol=1e-14)
    np.testing.assert_allclose(arm @ curve.normal, 0.0, atol=1e-14)
    for order in range(4):
        slope = (curve(t + 1e-5, order) - curve(t - 1e-5, order)) / 2e-5
        np.testing.assert_allclose(curve(t, order + 1), slope, atol=1e-9)
    mirror = PLACES["mirrored"]["rotation"]
    np.testing.assert_allclose(curve.moved(Motion(mirror, np.ones(3)))(t), curve(t) @ mirror.T + 1.0, atol=1e-14)
    np.testing.assert_allclose(curve.scaled(3.0)(t), 3.0 * curve(t), atol=1e-14)


CLOSED_FORMS = {
    "cylinder": (lambda **p: cylinder(2, 5, **p), 20 * np.pi, 28 * np.pi, 2.5, (1, 0, 0)),
    "frustum": (lambda **p: frustum(3, 1, 2, **p), 26 / 3 * np.pi, (10 + 8 * np.sqrt(2)) * np.pi, 9 / 13, (1, 0, 0)),
    "full cone": (lambda **p: cone(2, 3, **p), 4 * np.pi, (4 + 2 * np.sqrt(13)) * np.pi, 0.75, (1, 0, 0)),
    "sphere": (lambda **p: sphere(2, **p), 32 / 3 * np.pi, 16 * np.pi, 0.0, (1, 0, 0)),
    "torus": (lambda **p: torus(3, 1, **p), 6 * np.pi**2, 12 * np.pi**2, 0.0, (1, 1, 0)),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("shape", CLOSED_FORMS)
def test_round_solids_have_their_volume_area_centre_and_topology(shape: str, place: str) -> None:
    make, volume, area, height, betti = CLOSED_FORMS[shape]
    where = PLACES[place]
    found = measure_solid(make(**where))
    centre = where.get("rotation", np.eye(3)) @ [0, 0, height] + where.get("translation", 0.0)
    assert found.closed
    assert found.betti == betti
    assert found.volume == pytest.approx(volume, rel=1e-14 * 8)
    assert found.area == pytest.approx(area, rel=1e-14 * 8)
    np.testing.assert_allclose(found.centroid, centre, atol=1e-13)


def test_a_flask_has_the_volume_of_its_discs() -> None:
    ball, neck, fillet, bore = 3.0, 1.0, 0.5, 0.6
    rise = np.sqrt((ball + fillet) ** 2 - (neck + fillet) ** 2)
    touch = ball / (ball + fillet) * rise  # height at which the fillet meets the ball

    def outside(z: float) -> float:
        if z < touch:
            return np.sqrt(max(ball**2 - z**2, 0.0))
        return neck if z > rise else neck + fillet - np.sqrt(fillet**2 - (z - rise) ** 2)

    discs = sum(
        np.pi * quad(lambda z: outside(z) ** 2, *between, epsrel=1e-13)[0]
        for between in ((-ball, touch), (touch, rise), (rise, 6.0))
    )
    lip = np.pi * ((neck + bore) / 2) * np.pi * ((neck - bore) / 2) ** 2  # Pappus: half a disc, turned
    drill = np.pi * bore**2 * 5.0 + np.pi * bore**2 * 0.75 / 3
    found = measure_solid(flask())
    assert found.closed
    assert found.betti == (1, 0, 0)
    assert found.volume == pytest.approx(discs + lip - drill, rel=1e-12)


def test_an_oblique_hole_takes_its_cross_section_times_its_slant_height() -> None:
    found = measure_solid(pierced_block())
    tall = 2.0 / np.cos(0.4)
    rims = 2 * np.pi * 0.8**2 / np.cos(0.4)
    assert found.closed
    assert found.betti == (1, 1, 0)
    assert found.volume == pytest.approx(24.0 - np.pi * 0.64 * tall, rel=1e-12)
    assert found.area == pytest.approx(52.0 - rims + 2 * np.pi * 0.8 * tall, rel=1e-12)
    np.testing.assert_allclose(found.centroid, 0.0, atol=1e-12)


@pytest.mark.parametrize("make", [flask, pierced_block])
def test_a_scaled_solid_has_the_cube_of_the_volume_on_the_square_of_the_area(make) -> None:
    small, large = measure_solid(make()), measure_solid(scale_brep(make(), 2.5))
    assert large.volume == pytest.approx(2.5**3 * small.volume, rel=1e-13)
    assert large.area == pytest.approx(2.5**2 * small.area, rel=1e-13)


def test_edges_of_quadrics_and_planes_are_no_joints_of_patches() -> None:
    body = flask()
    assert measure_edge_continuity(body, body.tags).n_classes == 0
