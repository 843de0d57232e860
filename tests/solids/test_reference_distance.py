"""Distances from the reference surface of a lattice or a field, at points whose distance is known by construction."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields, maps, surfaces
from tpmscad.requests.lattice_request import LatticeRequest, read_lattice_request
from tpmscad.solids.matter.reference_distance import (
    field_distance,
    lattice_distance,
)
from tpmscad.sources.patched_surface import PatchedSurface

TURN = np.array([[0.0, -1.0, 0.0], [0.8, 0.0, -0.6], [0.6, 0.0, 0.8]])
"""A proper rotation."""


def request(surface: str, reference: str = "minimal", **options: object) -> LatticeRequest:
    options = {"cell": 10.0, "thickness": 1.0, "phase": (0.2, 0.1, 0.0), "tol": 0.01, **options}
    return read_lattice_request(surface, reference=reference, **options)  # type: ignore[arg-type]


def points_off(surface: str, reference: str, phase: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) in and around a lattice of cell 10, and their signed distances (n,) from its mid surface."""
    rng = np.random.default_rng(7)
    patch, symmetry = surfaces.primitive_patch(surface, reference), surfaces.patch_symmetry(surface)
    u, v = rng.random((2, 500))
    motion = symmetry.cell_motions[rng.integers(0, len(symmetry.cell_motions), 500)]
    jet, distance = patch.jet(u, v), rng.uniform(-1.0, 1.0, 500)
    placed = motion.apply(jet.position) + rng.integers(-2, 5, (500, 3)) + phase
    return 10 * placed + distance[:, None] * motion.apply_to_vectors(jet.normal), distance


@pytest.mark.slow
@pytest.mark.parametrize(
    ("surface", "reference"), [("gyroid", "minimal"), ("diamond", "nodal"), ("schwarz_p", "minimal")]
)
def test_the_distance_is_that_from_the_nearer_offset_surface_in_every_cell(surface: str, reference: str) -> None:
    asked = request(surface, reference)
    points, distance = points_off(surface, reference, asked.phase)
    expected = np.minimum(np.abs(distance - 0.5), np.abs(distance + 0.5))
    np.testing.assert_allclose(lattice_distance(asked, None)(points), expected, atol=1e-7)
    turned = lattice_distance(asked, None, TURN)(points @ TURN.T)
    np.testing.assert_allclose(turned, expected, atol=1e-7)


def test_patches_and_level_set_give_the_same_distance() -> None:
    asked = request("gyroid", "nodal", phase=(0, 0, 0))
    patched = asked.source.mid_surface(asked.cell, asked.cells, np.zeros(3), None)
    assert isinstance(patched, PatchedSurface)
    points = np.random.default_rng(2).uniform(0, 10, (4000, 3))
    phi = fields.tpms("gyroid", 10.0)
    points = points[np.abs(phi(points)) < 0.4]
    level_set = fields.normal_distance(phi)(points)
    np.testing.assert_allclose(patched(points), level_set, atol=1e-6)
    assert (np.sign(level_set) == np.sign(phi(points))).all()


def test_a_wrapped_wall_keeps_its_distance_from_the_wrapped_surface() -> None:
    """The oracle offsets the wrapped surface along the normal of finite differences."""
    wrap, asked = maps.cylinder(20.0), request("gyroid", cells=(2, 1, 1), phase=(0, 0, 0))
    patch, symmetry = surfaces.primitive_patch("gyroid"), surfaces.patch_symmetry("gyroid")
    rng, h = np.random.default_rng(5), 1e-5
    u, v = rng.uniform(0.1, 0.9, (2, 200))
    motion = symmetry.cell_motions[rng.integers(0, len(symmetry.cell_motions), 200)]

    def surface(s: np.ndarray, t: np.ndarray) -> np.ndarray:
        return wrap(10 * motion.apply(patch.jet(s, t).position))

    normal = np.cross(surface(u + h, v) - surface(u - h, v), surface(u, v + h) - surface(u, v - h))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distance = rng.uniform(-0.8, 0.8, 200)
    found = lattice_distance(asked, wrap)(surface(u, v) + distance[:, None] * normal)
    np.testing.assert_allclose(found, np.minimum(np.abs(distance - 0.5), np.abs(distance + 0.5)), atol=1e-5)


def test_unequal_cell_edges_are_followed() -> None:
    asked = request("gyroid", cell=(10.0, 10.0, 14.0), thickness=0.5, phase=(0, 0, 0.3))
    patch, symmetry = surfaces.primitive_patch("gyroid"), surfaces.patch_symmetry("gyroid")
    on_surface = symmetry.cell_motions[:, None].apply(patch.jet(np.full(3, 0.4), np.linspace(0, 1, 3)).position)
    points = (on_surface.reshape(-1, 3) + asked.phase + [3, -1, 2]) * asked.cell
    np.testing.assert_allclose(lattice_distance(asked, None)(points), 0.25, atol=1e-7)


def test_the_distance_from_a_field_is_in_model_units() -> None:
    ball = fields.sphere((0, 0, 0), 3.0) * 7.0
    points = np.array([[3.001, 0, 0], [0, 2.999, 0]])
    np.testing.assert_allclose(field_distance(ball)(points), 0.001, rtol=1e-3)


@pytest.mark.slow
def test_the_distance_from_a_graded_wall_follows_its_thickness() -> None:
    def thickness(p: np.ndarray) -> np.ndarray:
        return 0.6 + 0.02 * p[..., 2]

    map = maps.stretching((1.0, 1.0, 1.0))
    asked = request("gyroid", cells=(1, 1, 1), phase=(0.0, 0.0, 0.0), thickness=thickness, map=map, boundary="natural")
    symmetry, patch = surfaces.patch_symmetry("gyroid"), surfaces.primitive_patch("gyroid", "minimal")
    rng = np.random.default_rng(4)
    u, v = rng.random((2, 300))
    motion = symmetry.cell_motions[rng.integers(0, len(symmetry.cell_motions), 300)]
    jet = patch.jet(u, v)
    foot, normal = 10 * motion.apply(jet.position), motion.apply_to_vectors(jet.normal)
    height = rng.uniform(-0.6, 0.6, 300)
    points = foot + height[:, None] * normal
    expected = np.abs(np.abs(height) - thickness(foot) / 2)
    np.testing.assert_allclose(lattice_distance(asked, map)(points), expected, atol=1e-7)
