"""A body divided by a sheet lattice: the wall and what it leaves fill the body and share their faces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.shapes import round_shapes as shapes
from tests.shapes.misfits import volume
from tests.trimming.network_operands import trim
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, reverse_faces, select_faces
from tpmscad.trimming.network_boolean import DividedNetwork, divide_network
from tpmscad.trimming.operands.polyhedra import box

BODIES = {
    "box": (lambda: box(np.array([1.3, 2.1, 1.7]), np.array([8.2, 9.1, 7.9])), 6.9 * 7.0 * 6.2),
    "sphere": (lambda: shapes.sphere(3.9, translation=(5.1, 4.8, 5.3)), 4 / 3 * np.pi * 3.9**3),
}


@pytest.fixture(scope="module", params=BODIES)
def divided(request: pytest.FixtureRequest, cover: Callable[..., Brep]) -> tuple[Brep, Brep, DividedNetwork, float]:
    """Lattice, body, this divided by that, and the body's volume."""
    lattice = cover("gyroid", (1, 1, 1), (0.02, 0.03, 0.05), (-0.03, 0.05))
    make, expected = BODIES[request.param]
    body = make()
    return lattice, body, divide_network(body, lattice, is_cover=True), expected


def regions(found: DividedNetwork) -> tuple[Brep, Brep]:
    """What lies in the lattice, and what does not."""
    within, beyond = select_faces(found.shared, found.within), select_faces(found.shared, found.beyond)
    sense = np.where(np.isin(found.beyond, found.reversed_beyond), -beyond.faces.sense, beyond.faces.sense)
    return within, replace(beyond, faces=replace(beyond.faces, sense=sense))


@pytest.mark.slow
def test_each_region_is_what_a_cut_of_its_own_gives(divided: tuple[Brep, Brep, DividedNetwork, float]) -> None:
    lattice, body, found, _ = divided
    for region, half in zip(regions(found), (lattice, reverse_faces(lattice)), strict=True):
        alone = trim(half, body).brep
        assert len(region.faces) == len(alone.faces)
        assert len(region.edges) == len(alone.edges)
        np.testing.assert_allclose(volume(region), volume(alone), rtol=1e-9)


@pytest.mark.slow
def test_regions_are_closed_fill_the_body_and_share_the_lattice(
    divided: tuple[Brep, Brep, DividedNetwork, float],
) -> None:
    _, body, found, expected = divided
    both = regions(found)
    assert all(connectivity.is_closed(region) for region in both)
    assert sum(volume(region) for region in both) == pytest.approx(expected, rel=1e-6)
    on_body = found.shared.faces.tag < len(body.tags)
    count = np.bincount(np.concatenate([found.within, found.beyond]), minlength=len(found.shared.faces))
    np.testing.assert_array_equal(count, np.where(on_body, 1, 2))
