"""The motions of the patch, and that its copies make the whole surface."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes, mesh_surface_area

from tpmscad import surfaces

NAMES = [info.name for info in surfaces.CATALOGUE.values() if info.primitives == "exact"]
BOTH = list(itertools.product(NAMES, ("minimal", "nodal")))
SIDE = np.linspace(0, 1, 17)
SIDES = np.array([(SIDE, 0 * SIDE), (0 * SIDE + 1, SIDE), (SIDE[::-1], 0 * SIDE + 1), (0 * SIDE, SIDE[::-1])])
EULER = {"gyroid": -8, "diamond": -16, "schwarz_p": -4}
LATTICE = {
    "gyroid": [(0, 0, 0), (0.5, 0.5, 0.5)],
    "diamond": [(0, 0, 0), (0, 0.5, 0.5), (0.5, 0, 0.5), (0.5, 0.5, 0)],
    "schwarz_p": [(0, 0, 0)],
}
OPEN_SIDES = {"gyroid": 40, "diamond": 48, "schwarz_p": 22}


def placed(name: str, points: np.ndarray) -> np.ndarray:
    """(..., 3) on every patch of the cell: (n, ..., 3)."""
    symmetry = surfaces.patch_symmetry(name)
    return symmetry.cell_motions[:, None].apply(points.reshape(-1, 3)).reshape(-1, *points.shape)


def labels(points: np.ndarray, periodic: bool) -> np.ndarray:
    """The same label for the same point, to 1e-9, modulo the cell if `periodic`: (...)."""
    grains = np.rint(points / 1e-9).astype(np.int64)
    if periodic:
        grains %= 10**9
    return np.unique(grains.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(points.shape[:-1])


@pytest.mark.parametrize("name", NAMES)
def test_the_neighbour_over_a_side_is_the_patch_turned_by_half_about_its_middle(name: str) -> None:
    symmetry, patch = surfaces.patch_symmetry(name), surfaces.primitive_patch(name)
    middles = patch.jet(*SIDES[:, :, 8].T).position
    np.testing.assert_allclose(symmetry.side_middles, middles, rtol=0, atol=4e-15)
    np.testing.assert_allclose(symmetry.edge_motions.apply(middles), middles, rtol=0, atol=4e-15)
    for turn, shift in zip(symmetry.edge_motions.rotation, symmetry.edge_motions.translation, strict=True):
        np.testing.assert_array_equal(turn @ turn, np.eye(3))
        np.testing.assert_array_equal(turn @ shift + shift, 0)


@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_the_rotoinversion_turns_the_patch_and_swaps_its_offsets(name: str, reference: str) -> None:
    symmetry, surface = surfaces.patch_symmetry(name), surfaces.primitive_patch(name, reference)
    u, v = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 7))
    for offset in (0.0, 0.13):
        here, there = surface.jet(u, v, offset), surface.jet(1 - v, u, -offset)
        turned = symmetry.swap.apply(here.position)
        np.testing.assert_allclose(turned, there.position, rtol=0, atol=4e-15)
        np.testing.assert_allclose(symmetry.swap.apply_to_vectors(here.normal), -there.normal, rtol=0, atol=4e-15)
    power = np.linalg.matrix_power(symmetry.swap.rotation, 4)
    np.testing.assert_array_equal(power, np.eye(3))
    assert np.linalg.det(symmetry.swap.rotation) == -1


@pytest.mark.parametrize("name", NAMES)
def test_motions_are_exact_elements_of_a_cubic_space_group(name: str) -> None:
    symmetry = surfaces.patch_symmetry(name)
    for rotation in (*symmetry.edge_motions.rotation, *symmetry.cell_motions.rotation):
        np.testing.assert_array_equal(np.sort(np.abs(rotation), axis=0), [[0, 0, 0], [0, 0, 0], [1, 1, 1]])
        assert np.linalg.det(rotation) == pytest.approx(1)
    for motion in (symmetry.edge_motions, symmetry.cell_motions, symmetry.swap):
        translation = motion.translation
        np.testing.assert_array_equal(8 * translation, np.rint(8 * translation))


@pytest.mark.parametrize("name", NAMES)
def test_the_translations_that_keep_the_sides_are_those_of_the_space_group(name: str) -> None:
    np.testing.assert_array_equal(surfaces.patch_symmetry(name).centring, LATTICE[name])


@pytest.mark.parametrize("name", NAMES)
def test_the_cell_closes_up_modulo_its_translations(name: str) -> None:
    """Every edge is shared by two patches, every vertex by six, and Euler's characteristic is that of the genus."""
    info = surfaces.CATALOGUE[name]
    count = len(surfaces.patch_symmetry(name).cell_motions)
    assert count == info.patches_per_cell
    surface = surfaces.primitive_patch(name)
    middle = labels(placed(name, surface.jet(*SIDES[:, :, 8].T).position), periodic=True)
    corner = labels(placed(name, surface.jet(*SIDES[:, :, 0].T).position), periodic=True)
    assert (np.bincount(middle.ravel()) == 2).all()
    assert (np.bincount(corner.ravel()) == 6).all()
    euler = corner.max() + 1 - (middle.max() + 1) + count
    assert euler == EULER[name]
    assert euler == (2 - 2 * info.genus) * len(LATTICE[name])


@pytest.mark.parametrize("name", NAMES)
def test_the_patches_of_a_cell_hang_together_by_their_sides(name: str) -> None:
    middle = labels(placed(name, surfaces.patch_symmetry(name).side_middles), periodic=False)
    patch = np.broadcast_to(np.arange(len(middle))[:, None], middle.shape)
    graph = coo_array((np.ones(middle.size), (patch.ravel(), middle.ravel())), shape=(len(middle), middle.max() + 1))
    assert connected_components((graph @ graph.T).tocsr())[0] == 1
    assert (np.bincount(middle.ravel()) == 1).sum() == OPEN_SIDES[name]
    centre = placed(name, surfaces.primitive_patch(name).jet(0.5, 0.5).position).mean(axis=0)
    assert ((centre >= 0) & (centre < 1)).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_copies_are_the_whole_level_set_once(name: str) -> None:
    """Area of the copies against a triangulation of the formula, which knows of no patches."""
    n = 64
    x, y, z = np.meshgrid(*[2 * np.pi * np.arange(n + 1) / n] * 3, indexing="ij")
    s, c = np.sin, np.cos
    values = {
        "gyroid": s(x) * c(y) + s(y) * c(z) + s(z) * c(x),
        "diamond": s(x) * s(y) * s(z) + s(x) * c(y) * c(z) + c(x) * s(y) * c(z) + c(x) * c(y) * s(z),
        "schwarz_p": c(x) + c(y) + c(z),
    }[name]
    vertices, triangles, *_ = marching_cubes(values, 0.0, spacing=(1 / n,) * 3)
    assert surfaces.area(name, "nodal") == pytest.approx(mesh_surface_area(vertices, triangles), rel=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_the_symmetry_is_computed_once_and_cannot_be_changed(name: str) -> None:
    symmetry = surfaces.patch_symmetry(name)
    assert surfaces.patch_symmetry(name) is symmetry
    with pytest.raises(ValueError, match="read-only"):
        symmetry.cell_motions.translation[0] += 1.0
