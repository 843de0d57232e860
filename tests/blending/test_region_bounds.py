"""The box of regions holds all of them and is no larger than it has to be."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.blending import CylinderRadius, SphereRadius
from tpmscad.blending.sampling_domain import find_region_bounds, resolve_domain

BOX, BALL = fields.box((-1, -2, -3), (1, 2.5, 0.5)), fields.sphere((1.0, -0.5, 0.3), 1.7)
ROD = fields.cylinder((0.4, 0.2, -0.6), 0.8, (1, 2, -2), height=3.0)
REGIONS = {
    "box": BOX,
    "sphere": BALL,
    "tilted cylinder": ROD,
    "union": BALL | ROD,
    "union of three": BOX | BALL | ROD,
}


@pytest.mark.parametrize("name", REGIONS)
def test_the_bounds_of_a_region_are_those_of_a_dense_sample_of_it(name: str) -> None:
    axes = [np.linspace(-6, 6, 121)] * 3
    inside = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)[REGIONS[name].on_grid(*axes) <= 0]
    low, high = find_region_bounds(REGIONS[name])
    assert (inside.min(axis=0) >= low - 1e-12).all()
    assert (inside.max(axis=0) <= high + 1e-12).all()
    np.testing.assert_allclose([inside.min(axis=0), inside.max(axis=0)], [low, high], atol=0.2)


def test_intersections_and_differences_are_bounded_by_what_they_are_made_of() -> None:
    np.testing.assert_allclose(find_region_bounds(BOX & BALL), [[-0.7, -2, -1.4], [1, 1.2, 0.5]])
    np.testing.assert_allclose(find_region_bounds(BOX & -BALL), find_region_bounds(BOX))
    assert np.isinf(find_region_bounds(fields.cylinder((0, 0, 0), 1.0))).all()


def test_the_domain_is_the_box_of_all_regions() -> None:
    assert resolve_domain([BOX, fields.sphere((4, 0, 0), 1.0)], None) == ((-1, -2, -3), (5, 2.5, 1))


def test_radii_are_measured_from_the_origin_unless_another_centre_is_given() -> None:
    points = np.random.default_rng(0).normal(size=(9, 3))
    for radius, n_axes in ((CylinderRadius(), 2), (SphereRadius(), 3)):
        np.testing.assert_allclose(radius(points), [math.hypot(*p[:n_axes]) for p in points.tolist()], rtol=1e-14)
    np.testing.assert_allclose(SphereRadius((1, 2, 3))(points), SphereRadius()(points - np.arange(1, 4)), rtol=1e-12)
