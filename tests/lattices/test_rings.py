"""Maps that close: rings without a seam, with the topology that counting predicts; walls that lie in each other are refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tpmscad import maps, surfaces
from tpmscad.brep.edge_continuity import measure_edge_continuity
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.errors import InvalidRequest
from tpmscad.lattices import copies, mapped_lattice
from tpmscad.lattices.cell_block import build_incidence, choose_manifold_block
from tpmscad.lattices.mapped_surface import MappedSurface, box_points, find_closed_axes, require_regular
from tpmscad.lattices.revolved_box import find_revolved_box, find_revolved_cylinder
from tpmscad.lattices.self_contact import require_no_self_contact

CELL = 10.0


def ring(cells: int) -> maps.Map:
    return maps.cylinder(cells * CELL / (2 * np.pi))


def mapped(map: maps.Map, cells: tuple[int, int, int], name: str = "schwarz_p") -> MappedSurface:
    closed = find_closed_axes(map, cells, CELL)
    x, y, z = (float(n) if c else 0.0 for n, c in zip(cells, closed, strict=True))
    placements = copies.place_whole_cells(name, cells, np.zeros(3), closed)
    patch, symmetry = surfaces.primitive_patch(name), surfaces.patch_symmetry(name)
    return MappedSurface(patch, symmetry, placements, map, CELL, (x, y, z))


def count_euler_characteristic(name: str, cells: tuple[int, int, int], closed: tuple[bool, bool, bool]) -> int:
    """V - E + F of the mid surface of a block, counted by integer addresses modulo the length of its closed axes."""
    symmetry, square = surfaces.patch_symmetry(name), copies.UNIT_SQUARE_CORNERS
    corners = surfaces.primitive_patch(name).jet(*square.T).position
    motion = symmetry.cell_motions
    incidence = build_incidence(*(motion[:, None].apply(points) for points in (symmetry.side_middles, corners)))
    patches = choose_manifold_block(incidence, cells, closed)

    def distinct(ids: np.ndarray) -> int:
        found = set()
        for patch, *cell in patches:
            for label, *at in ids[patch].tolist():
                moved = (a + b for a, b in zip(at, cell, strict=True))
                found.add((label, *(m % n if c else m for m, n, c in zip(moved, cells, closed, strict=True))))
        return len(found)

    return distinct(incidence.corner_ids) - distinct(incidence.side_ids) + len(patches)


def test_a_map_closes_along_the_axes_after_whose_length_it_repeats() -> None:
    torus = maps.as_map(
        lambda p: np.stack(
            [
                (20 + (5 + p[..., 2]) * np.cos(p[..., 1] / 5)) * np.cos(p[..., 0] / 20),
                (20 + (5 + p[..., 2]) * np.cos(p[..., 1] / 5)) * np.sin(p[..., 0] / 20),
                (5 + p[..., 2]) * np.sin(p[..., 1] / 5),
            ],
            axis=-1,
        )
    )
    assert find_closed_axes(ring(4), (4, 1, 1), CELL) == (True, False, False)
    assert find_closed_axes(ring(4), (3, 1, 1), CELL) == (False, False, False)
    assert find_closed_axes(maps.cylinder(6.3662), (4, 1, 1), CELL) == (False, False, False)
    assert find_closed_axes(torus, (12, 3, 1), np.pi * 10 / 3) == (True, True, False)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gyroid", "diamond", "schwarz_p"])
def test_a_block_that_closes_has_no_open_side_at_its_seam(name: str) -> None:
    closed, cells = (True, False, False), (4, 1, 1)
    symmetry = surfaces.patch_symmetry(name)
    placements = copies.place_whole_cells(name, cells, np.zeros(3), closed)
    patch, side = copies.find_open_sides(symmetry, placements, (4.0, 0.0, 0.0))
    # The open sides repeat cell by cell: the seam is as any other place between two cells.
    middle = np.stack([placements[p].apply(symmetry.side_middles[s]) for p, s in zip(patch, side, strict=True)])
    turned = np.mod(middle + [1.0, 0.0, 0.0] + 1e-9, [4.0, 1e9, 1e9])
    here = {tuple(p) for p in np.mod(middle + 1e-9, [4.0, 1e9, 1e9]).round(6).tolist()}
    assert {tuple(p) for p in turned.round(6).tolist()} == here


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4])
def test_a_ring_is_one_smooth_closed_solid_with_the_tunnels_that_counting_gives(count: int) -> None:
    surface = mapped(ring(count), (count, 1, 1))
    fit = mapped_lattice.fit_mapped_layers(surface, (-0.3, 0.3), 0.3)
    brep = mapped_lattice.assemble_mapped_lattice(surface, *fit.surfaces, natural=True)
    found, solid = measure_edge_continuity(brep, ("offset+", "offset-")), measure_solid(brep)
    assert solid.closed
    assert solid.betti == (1, 1 - count_euler_characteristic("schwarz_p", (count, 1, 1), (True, False, False)), 0)
    assert found.gap < 1e-9
    assert found.tangent_jump_deg < 1e-6
    assert found.curvature_jump < 1e-6
    # One cell is fitted and turned: the carriers of the two offset surfaces do not grow with the ring.
    lower, _ = fit.surfaces
    assert lower is not None
    assert len(lower.patches) <= 12
    # The centroid lies on the axis, because the ring has the symmetry of its cells.
    np.testing.assert_allclose(solid.centroid[:2], 0, atol=1e-8)


def helix(p: np.ndarray, pitch: float) -> np.ndarray:
    angle, r = p[..., 0] / 12, 12 + p[..., 1]
    return np.stack([r * np.sin(angle), r * np.cos(angle), p[..., 2] + pitch * angle / (2 * np.pi)], axis=-1)


def loop(p: np.ndarray) -> np.ndarray:
    """A strip along Tschirnhausen's cubic, which crosses itself once."""
    t, y = (p[..., 0] / 50 - 0.5) * 4.4, p[..., 1] - 5
    speed = 1 + t**2
    x, across = 10 * (1 - 3 * t**2), 10 * t * (3 - t**2)
    normal = np.stack([-(1 - t**2), -2 * t], axis=-1) / speed[..., None]
    return np.stack([x + y * normal[..., 0], across + y * normal[..., 1], p[..., 2]], axis=-1)


OVERLAPS = {
    "a cylinder whose turn is too short": (maps.cylinder(7.0), (5, 1, 1), "repeats after 4.39822972 cells along x"),
    "a band around a sphere": (maps.sphere(7.0, chart="equator"), (5, 1, 1), "repeats after 4.39822972 cells along x"),
    "a helix that rises too little": (maps.as_map(lambda p: helix(p, 5.0)), (9, 1, 1), "Give the walls room"),
    "a loop": (maps.as_map(loop), (5, 1, 1), "Give the walls room"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", OVERLAPS)
def test_a_lattice_that_overlaps_itself_is_refused_with_place_amount_and_remedy(case: str) -> None:
    map, cells, remedy = OVERLAPS[case]
    surface = mapped(map, cells)
    surface.orientation()  # nothing is wrong near any point
    with pytest.raises(InvalidRequest, match=rf"near \(.*cells lie .* deep in each other. .*{remedy}"):
        require_no_self_contact(surface, (-0.3, 0.3))


CLEAR = {
    "a closed ring": (ring(4), (4, 1, 1)),
    "an open ring": (ring(5), (4, 1, 1)),
    "a helix that rises by more than its wall": (maps.as_map(lambda p: helix(p, 16.0)), (9, 1, 1)),
    "a dome": (maps.sphere(10.0, centre=(10.0, 10.0)), (2, 2, 1)),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CLEAR)
def test_a_lattice_that_only_comes_near_itself_is_not_refused(case: str) -> None:
    map, cells = CLEAR[case]
    require_no_self_contact(mapped(map, cells), (-0.3, 0.3))


@pytest.mark.slow
def test_the_amount_is_half_the_wall_where_two_turns_coincide() -> None:
    with pytest.raises(InvalidRequest, match=r"lie 0\.25 deep"):
        require_no_self_contact(mapped(ring(4), (8, 1, 1)), (-0.1, 0.4))


@pytest.mark.parametrize(
    ("function", "match"),
    [
        (lambda p: p * [1, 1, 0], r"squeezes the lattice flat near lattice point \(0, 0, 0\).*one-to-one"),
        (
            lambda p: np.stack([(p[..., 0] - 5) ** 2 / 5, p[..., 1], p[..., 2]], axis=-1),
            r"folds.*near lattice point \(5,",
        ),
        (maps.sphere(4.0, centre=(0.0, 0.0)), "folds"),
    ],
)
def test_maps_that_are_singular_somewhere_are_refused_with_the_place(
    function: Callable[[np.ndarray], np.ndarray], match: str
) -> None:
    with pytest.raises(InvalidRequest, match=match):
        require_regular(maps.as_map(function), box_points((2, 2, 1), CELL), CELL)


def test_a_wrap_around_a_cylinder_makes_a_tube_or_a_sector_of_the_box() -> None:
    size = np.array([40.0, 10.0, 5.0])
    tube, sector = (find_revolved_box(maps.cylinder(r), size) for r in (20 / np.pi, 10.0))
    assert tube is not None
    assert tube.closed
    assert sector is not None
    assert not sector.closed
    assert sector.angle == pytest.approx(4.0, rel=1e-12)
    for found, radius in ((tube, 20 / np.pi), (sector, 10.0)):
        assert all(found.straight)
        corners = found.sides[:, 0]
        np.testing.assert_allclose(np.abs(found.axis), [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(sorted(np.hypot(*corners.T[:2])), [radius] * 2 + [radius + 10] * 2, rtol=1e-12)
        np.testing.assert_allclose(sorted(corners[:, 2]), [0, 0, 5, 5], atol=1e-12)


def test_spheres_are_trimmed_by_arcs_and_cones_and_other_boxes_not_at_all() -> None:
    size = np.array([40.0, 10.0, 5.0])
    band = find_revolved_box(maps.sphere(20 / np.pi, chart="equator", centre=(0.0, 5.0)), size)
    assert band is not None
    assert band.straight == (False, True, False, True)
    cap = find_revolved_cylinder(maps.sphere(40 / np.pi, centre=(20.0, 20.0)), np.array([40.0, 40.0, 5.0]))
    assert cap is not None
    assert cap.straight == (False, True, False, True)
    # Half a sphere: the rim lies in the plane of the equator.
    np.testing.assert_allclose(cap.sides[1, :, 2], 0, atol=1e-12)
    for map in (maps.stretching((1.0, 2.0, 3.0)), maps.grading(0, (1.0, 2.0), 40.0), maps.as_map(loop)):
        assert find_revolved_box(map, size) is None
    assert find_revolved_box(maps.as_map(lambda p: helix(p, 16.0)), size) is None  # a screw is no rotation
    with pytest.raises(InvalidRequest, match=r"1.06103295 times round .* at most 0.942477796 times as long along x"):
        find_revolved_box(maps.cylinder(6.0), size)
