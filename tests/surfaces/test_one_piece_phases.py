"""The catalogue's phases make one piece of a lattice in a box: counted on grids of the normal distance, without any patch."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tpmscad import fields, surfaces
from tpmscad._typing import Array, BoolArray

N = 32
"""Intervals of the grid along a cell."""

N_CLOUD = 56
"""Points along a cell that are projected on the surface: the cloud whose distance is the normal distance."""

TOUCHING = np.ones((3, 3, 3), bool)
"""Voxels that touch in a corner are connected: thin walls stay whole."""

ALL = tuple(surfaces.CATALOGUE)
KINDS = (("sheet", "-"), ("skeletal", "-"), ("skeletal", "+"))
CHIP = 0.01
SPECK_VOXELS = 2
"""Pieces that the grid does not resolve: next to the corners of the box, where the surface grazes its edges."""


@cache
def cloud(name: str) -> cKDTree:
    """Points of the nodal surface on one period, by Newton's method along the gradient."""
    field = fields.tpms(name, 1.0)
    axis = (np.arange(N_CLOUD) + 0.37) / N_CLOUD
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    value, gradient = field.value_and_gradient(points)
    points = points[np.abs(value) < 1.5 * np.linalg.norm(gradient, axis=1) / N_CLOUD]
    for _ in range(6):
        value, gradient = field.value_and_gradient(points)
        points = points - (value / np.maximum((gradient**2).sum(axis=1), 1e-12))[:, None] * gradient
    points = points[np.abs(field(points)) < 1e-9] % 1.0
    return cKDTree(np.where(points >= 1.0, 0.0, points), boxsize=1.0)


@cache
def distances(name: str, phase: tuple[float, float, float]) -> Array:
    """Signed distance from the surface, moved by `phase`, on the grid (N, N, N) of one period."""
    axis = np.arange(N) / N
    points = (np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1) - phase) % 1.0
    points[points >= 1.0] = 0.0
    return np.asarray(np.sign(fields.tpms(name, 1.0)(points)) * cloud(name).query(points)[0])


def fill_box(periodic: Array, cells: tuple[int, int, int]) -> Array:
    """The samples in a box of cells, both faces included."""
    return periodic[np.ix_(*(np.arange(n * N + 1) % N for n in cells))]


def volumes(solid: BoolArray) -> Array:
    """Numbers of voxels of the pieces, largest first."""
    labels, _ = ndimage.label(solid, TOUCHING)
    return np.sort(np.bincount(labels.ravel())[1:])[::-1]


def count_endless_pieces(solid: BoolArray) -> int:
    """Pieces of the endless solid in eight cells, opposite faces identified: separate networks and balls stay apart."""
    labels, count = ndimage.label(np.pad(np.tile(solid, (2, 2, 2)), [(0, 1)] * 3, mode="wrap"), TOUCHING)
    pairs = np.concatenate(
        [np.stack([np.take(labels, 0, k).ravel(), np.take(labels, -1, k).ravel()]) for k in range(3)], axis=1
    )
    pairs = pairs[:, pairs.min(axis=0) > 0]
    joined, _ = connected_components(coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(count + 1,) * 2))
    return int(joined) - 1


def offset_limits(name: str) -> tuple[float, float]:
    """The offsets that a reference near the nodal surface allows, in cells; of the others most of the reach."""
    exact = surfaces.CATALOGUE[name].primitives == "exact"
    references = (
        surfaces.CATALOGUE[name].references if exact else ("nodal",)
    )  # the cloud is nodal, others lie farther off
    if surfaces.CATALOGUE[name].primitives in ("exact", "mirrored"):
        measures = [surfaces.cell_measures(name, reference) for reference in references]
        return min(m.min_offset for m in measures), max(m.max_offset for m in measures)
    reach = distances(name, (0.0, 0.0, 0.0))
    return 0.8 * float(reach.min()), 0.8 * float(reach.max())


def solids(name: str, kind: str, side: str) -> list[BoolArray]:
    """The periodic solid at many offsets, as samples of one period at the catalogue's phase."""
    distance = distances(name, surfaces.CATALOGUE[name].one_piece.phase_of(kind, side))
    low, high = offset_limits(name)
    if kind == "sheet":
        return [np.abs(distance) <= half for half in np.linspace(1.0 / N, min(-low, high), 16)]
    sign = -1.0 if side == "+" else 1.0
    return [sign * distance <= sign * offset for offset in np.linspace(low, high, 24)]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "side"), KINDS)
@pytest.mark.parametrize("name", ALL)
def test_a_lattice_in_a_box_is_one_piece_at_every_thickness(name: str, kind: str, side: str) -> None:
    """But for chips where the catalogue says that no phase is free of them, and for endless solids that fall apart themselves."""
    chips = kind == "skeletal" and surfaces.CATALOGUE[name].one_piece.skeletal_chips
    found = [solid for solid in solids(name, kind, side) if count_endless_pieces(solid) == 1]
    assert len(found) >= (16 if kind == "sheet" else 12)
    for solid in found:
        for cells in ((1, 1, 1), (2, 1, 3)):
            pieces = volumes(fill_box(solid, cells))
            assert len(pieces) == 1 or pieces[1] <= max(SPECK_VOXELS, CHIP * pieces[0] if chips else 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_the_mid_surface_in_a_box_is_one_piece_so_the_thinnest_sheet_is(name: str) -> None:
    """Cubes of the grid that the surface crosses, joined across faces: no thickness is too thin for them."""
    positive = fill_box(distances(name, surfaces.CATALOGUE[name].one_piece.sheet), (1, 1, 1)) > 0
    corners = [positive[tuple(slice(c, N + c) for c in corner)] for corner in itertools.product((0, 1), repeat=3)]
    crossed = np.any(corners, axis=0) & ~np.all(corners, axis=0)
    assert ndimage.label(crossed)[1] == 1


@pytest.mark.parametrize(("name", "expected"), [("gyroid", 3), ("diamond", 3)])
@pytest.mark.slow
def test_at_the_phase_of_the_nodal_formula_corners_come_off(name: str, expected: int) -> None:
    """The count above can fail."""
    sheet = np.abs(distances(name, (0.0, 0.0, 0.0))) <= 0.05
    assert len(volumes(fill_box(sheet, (1, 1, 1)))) == expected


@pytest.mark.parametrize("name", ["gyroid", "diamond", "fischer_koch_s"])
def test_the_two_sides_of_an_odd_formula_have_opposite_phases(name: str) -> None:
    """f(-x) = -f(x) takes one side to the other, and the phase to its opposite."""
    points = np.random.default_rng(1).random((50, 3))
    field, phases = fields.tpms(name, 1.0), surfaces.CATALOGUE[name].one_piece
    np.testing.assert_allclose(field(-points), -field(points), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.add(phases.minus, phases.plus) % 1.0, 0.0, rtol=0, atol=1e-12)
