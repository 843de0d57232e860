"""Regions: exact distances, images, and fields in other coordinates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tpmscad import fields

RNG = np.random.default_rng(3)
POINTS = RNG.uniform(-4, 4, (2000, 3))
REGIONS = {
    "box": fields.box((0, -1, 0.5), (2, 1, 3)),
    "slab": fields.box((0, -np.inf, -np.inf), (2, np.inf, np.inf)),
    "corner": fields.box((-np.inf, -np.inf, -np.inf), (2, 1, np.inf)),
    "halfspace": fields.halfspace((1, 0, 0.5), (1, 2, 3)),
    "sphere": fields.sphere((0.1, 0.2, 0.3), 1.3),
    "cylinder": fields.cylinder((0.1, 0.2, 0.3), 0.8, (1, 1, 0.3)),
    "short cylinder": fields.cylinder((0.1, 0.2, 0.3), 0.8, "y", 1.4),
    "turned box": fields.rotate(fields.box((0, -1, 0.5), (2, 1, 3)), (1, 2, 3), 40),
    "larger cylinder": fields.scale(fields.cylinder((0, 0, 0), 0.5, "x", 1.0), 3.0, (0, 1, 0)),
}


@pytest.mark.parametrize("name", REGIONS)
def test_a_signed_distance_leads_to_the_border_and_has_a_unit_gradient(name: str) -> None:
    region = REGIONS[name]
    value, slope = region.value_and_gradient(POINTS)
    np.testing.assert_allclose(np.linalg.norm(slope, axis=-1), 1, atol=1e-12)
    border = POINTS - value[:, None] * slope
    np.testing.assert_allclose(region(border), 0, atol=1e-12)


@pytest.mark.parametrize("name", REGIONS)
def test_no_point_of_the_border_is_nearer_than_the_distance(name: str) -> None:
    region = REGIONS[name]
    many = np.random.default_rng(0).uniform(-6, 6, (40_000, 3))
    value, slope = region.value_and_gradient(many)
    near, _ = cKDTree(many - value[:, None] * slope).query(POINTS)
    assert (near >= np.abs(region(POINTS)) - 1e-9).all()
    assert np.median(near - np.abs(region(POINTS))) < 0.03


def test_regions_are_where_they_are_drawn() -> None:
    x, y, z = POINTS.T
    inside = {
        "box": (x > 0) & (x < 2) & (np.abs(y) < 1) & (z > 0.5) & (z < 3),
        "slab": (x > 0) & (x < 2),
        "corner": (x < 2) & (y < 1),
        "halfspace": (x - 1) + 2 * y + 3 * (z - 0.5) < 0,
        "sphere": (x - 0.1) ** 2 + (y - 0.2) ** 2 + (z - 0.3) ** 2 < 1.69,
        "short cylinder": ((x - 0.1) ** 2 + (z - 0.3) ** 2 < 0.64) & (np.abs(y - 0.2) < 0.7),
        "larger cylinder": ((y + 2) ** 2 + z**2 < 2.25) & (np.abs(x) < 1.5),
    }
    for name, mask in inside.items():
        assert ((REGIONS[name](POINTS) < 0) == mask).all(), name


def test_turning_is_counter_clockwise_in_degrees() -> None:
    field = fields.tpms("gyroid", (2.0, 3.0, 4.0))
    turn, center = Rotation.from_rotvec(np.deg2rad(33) * np.array([1.0, 2, 2]) / 3), np.array([1.0, 0, -1])
    moved = turn.apply(POINTS - center) + center
    np.testing.assert_allclose(fields.rotate(field, (1, 2, 2), 33, center)(moved), field(POINTS), atol=1e-12)
    np.testing.assert_allclose(
        fields.translate(field, (1, 2, 3))(POINTS + np.array((1, 2, 3))), field(POINTS), atol=1e-12
    )
    np.testing.assert_allclose(
        fields.scale(field, 2, center)(2 * (POINTS - center) + center), 2 * field(POINTS), atol=1e-11
    )


def test_a_shifted_grid_is_still_evaluated_as_a_grid() -> None:
    shapes = []

    class Spy(fields.Field):
        def at(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
            shapes.append((x.shape, y.shape, z.shape))
            return x + y + z

    axes = np.arange(3.0), np.arange(4.0), np.arange(5.0)
    fields.translate(fields.scale(Spy(), 2.0), (1, 0, 2)).on_grid(*axes)
    assert shapes == [((3, 1, 1), (1, 4, 1), (1, 1, 5))]


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_an_image_is_extruded_with_the_sign_of_its_pixels(axis: str) -> None:
    mask = RNG.random((7, 5)) > 0.4
    region = fields.image_region(mask, (-1, 2), (2.5, 4), axis=axis)
    u, v = np.meshgrid(-1 + 0.5 * (np.arange(7) + 0.5), 2 + 0.4 * (np.arange(5) + 0.5), indexing="ij")
    w = RNG.uniform(-9, 9, u.shape)
    points = np.stack(np.insert(np.stack([u, v]), "xyz".index(axis), w, axis=0), axis=-1)
    assert ((region(points) < 0) == mask).all()
    outward = points.copy()
    outward[..., 1 if axis == "x" else 0] -= 100 * (u == u.min())
    np.testing.assert_allclose(region(outward), region(points), atol=1e-9)


def test_an_image_of_a_straight_border_is_its_signed_distance() -> None:
    mask = np.arange(20)[:, None, None] + np.zeros((1, 3, 4)) < 8
    region = fields.image_region(mask, (0, 0, 0), (10, 3, 4))
    x = np.linspace(0.25, 9.75, 40)
    points = np.stack([x, 0 * x + 1, 0 * x + 2], axis=-1)
    np.testing.assert_allclose(region(points), x - 4, atol=1e-12)
    band = fields.sheet(region, -1, 1)
    assert ((band(points) <= 0) == (np.abs(x - 4) <= 1)).all()


def test_a_periodic_spline_of_equal_coefficients_is_constant_and_reproduces_waves() -> None:
    np.testing.assert_allclose(fields.bspline_unit(np.full((3, 1, 4), 0.7), (1, 2, 3))(POINTS), 0.7, atol=1e-14)
    errors = []
    for count in (16, 32):
        i = np.arange(count) / count
        # a cubic spline damps a wave of w = 2 pi / count per knot by (2 + cos w) / 3
        wave = np.sin(2 * np.pi * i)[:, None, None] * np.cos(2 * np.pi * i)[None, :, None] * np.ones((1, 1, 2))
        spline = fields.bspline_unit(wave * (3 / (2 + np.cos(2 * np.pi / count))) ** 2, (3.0, 4.0, 5.0))
        exact = np.sin(2 * np.pi * POINTS[:, 0] / 3) * np.cos(2 * np.pi * POINTS[:, 1] / 4)
        errors.append(np.abs(spline(POINTS) - exact).max())
    assert errors[0] < 2e-3
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.2)


def test_maps_compose_with_their_derivatives() -> None:
    polar = fields.warp(
        fields.tpms("schwarz_p", 1.0),
        lambda p: np.stack([np.arctan2(p[:, 1], p[:, 0]), np.hypot(p[:, 0], p[:, 1]), p[:, 2]], axis=-1),
    )
    x, y, z = POINTS.T
    expected = sum(np.cos(2 * np.pi * t) for t in (np.arctan2(y, x), np.hypot(x, y), z))
    np.testing.assert_allclose(polar(POINTS), expected, atol=1e-12)
