"""Poor tetrahedra are repaired without a change of volume, groups, boundary or periodic pairs, and nodes stay on their faces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.meshing.mesh_facets import boundary_facets
from tests.meshing.test_edge_collapse import check_same_body, squeeze, straighten
from tests.meshing.test_volume_mesh import EXTENT, block
from tpmscad._typing import Array
from tpmscad.meshing import edge_collapse, editable_mesh, mesh_improvement
from tpmscad.meshing.edge_collapse import find_images
from tpmscad.meshing.editable_mesh import Change, EditableMesh, FacesOfFacets
from tpmscad.meshing.mesh_improvement import improve_poor_elements
from tpmscad.meshing.node_moves import move_node
from tpmscad.meshing.swaps import _divisions, _remove_face, swap_around
from tpmscad.meshing.volume_mesh import VolumeMesh


def jitter(mesh: VolumeMesh, seed: int, most: float) -> VolumeMesh:
    """The mesh with corners moved along the sides that they lie in, alike for images, and with straight edges."""
    rng = np.random.default_rng(seed)
    free = (mesh.points > 1e-9) & (mesh.points < EXTENT - 1e-9)
    ties, _ = mesh.periodic_ties()
    moved = mesh.points + rng.uniform(-most, most, mesh.points.shape)[ties] * free
    return straighten(replace(mesh, points=moved))


@pytest.mark.parametrize(("kind", "seed"), [("tetra", 0), ("tetra", 1), ("tetra10", 2)])
def test_poor_elements_become_better_and_the_body_stays(kind: str, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_improvement, "POOR", 0.15)
    monkeypatch.setattr(mesh_improvement, "MAX_PASSES", 2)
    before = jitter(block(kind), seed, 0.42)
    found = improve_poor_elements(before, 1.0)
    check_same_body(found, before)
    assert found.swapped > 0
    assert found.shifted > 0
    worst = before.quality.smallest_scaled_jacobian
    assert found.quality.smallest_scaled_jacobian > worst + 0.02


@pytest.mark.parametrize("n", range(3, 8))
def test_a_polygon_has_as_many_divisions_as_catalan_says(n: int) -> None:
    catalan = [1, 1, 2, 5, 14, 42]
    assert len(set(_divisions(n))) == catalan[n - 2]
    assert all(len(division) == n - 2 for division in _divisions(n))


def swaps_between(state: EditableMesh, left: set[int]) -> list[Change | None]:
    """The swaps of faces with an element of a set on one side only."""
    found = []
    for cell in left:
        corners = state.cells[cell, :4].tolist()
        for face in (set(corners) - {n} for n in corners):
            around = set.intersection(*(state.cells_at[n] for n in face))
            if len(around) == 2 and len(around & left) == 1:
                found.append(_remove_face(state, cell, face))
    return found


def test_a_swap_within_one_region_only() -> None:
    """Elements of two regions are not put together: each keeps its volume."""
    before = jitter(block("tetra"), 1, 0.42)
    centres = before.points[before.cells["tetra"]].mean(axis=1)
    left = np.flatnonzero(centres[:, 1] < 0.5 * EXTENT[1])
    right = np.setdiff1d(np.arange(before.n_cells), left)
    before = replace(before, cell_groups={"left": left, "right": right})
    state = EditableMesh(before, None)
    assert all(swap is None for swap in swaps_between(state, set(left.tolist())))
    assert any(swaps_between(EditableMesh(replace(before, cell_groups={}), None), set(left.tolist())))
    done = sum(swap_around(state, cell) for cell in range(before.n_cells) if state.alive[cell])
    assert done > 0
    found = state.build()
    for name, of in found.cell_groups.items():
        volume = before.cell_volumes[before.cell_groups[name]].sum()
        assert found.cell_volumes[of].sum() == pytest.approx(volume, rel=1e-12)


def height(x: Array) -> Array:
    return EXTENT[2] + 0.04 * (x - 1.5) ** 2


def make_vault() -> tuple[VolumeMesh, FacesOfFacets]:
    """The block under a parabolic vault; its faces: five planes and the vault, to which points are projected along z."""
    mesh = replace(block("tetra10"), periodic={}, periods=np.full(3, np.nan))
    ((_, facets),) = mesh.facets.items()
    corners = mesh.points[facets[:, :3]]
    sides = np.stack([np.abs(corners - level).max(axis=1) for level in (0.0, EXTENT)], axis=1).reshape(len(facets), 6)
    face = np.argmin(sides, axis=1)
    points = mesh.points.copy()
    points[:, 2] *= height(points[:, 0]) / EXTENT[2]

    def project(number: int, point: Array) -> Array:
        place = point.copy()
        upper, axis = divmod(number, 3)
        place[axis] = height(point[0]) if number == 5 else upper * EXTENT[axis]
        return place

    groups = {f"side {n}": np.flatnonzero(face == n) for n in range(6)}
    return replace(mesh, points=points, facet_groups=groups), FacesOfFacets(face, project)


def test_nodes_that_move_stay_on_their_faces() -> None:
    mesh, faces = make_vault()
    place = np.array([2.0, 2.0, height(2.0)])
    node = int(np.argmin(np.linalg.norm(mesh.points - place, axis=1)))
    state = EditableMesh(mesh, faces)
    start = state.points[node] + (0.7, 0.6, 0.0)
    state.points[node] = faces.project(5, start)
    worst = state.quality()[1].min()
    assert move_node(state, node, 1.0) == 1
    assert state.quality()[1].min() > worst
    assert state.deviation() < 1e-12
    found = state.build()
    assert found.deviation < 1e-12
    assert np.abs(state.points[node] - start).max() > 0.1


def test_the_distance_of_nodes_from_their_faces_is_told() -> None:
    mesh, faces = make_vault()
    points = mesh.points.copy()
    node = int(np.argmin(np.linalg.norm(points - (2.0, 2.0, height(2.0)), axis=1)))
    points[node, 2] += 1e-3
    found = improve_poor_elements(replace(mesh, points=points), 1.0, faces)
    assert found.deviation == pytest.approx(1e-3, rel=1e-6)


def test_a_point_between_two_faces_goes_to_their_curve() -> None:
    """A plane and a sphere that meets it at an angle of 48 degrees."""
    mesh, faces = make_vault()
    centre, radius = np.array([1.5, 2.0, 0.0]), 3.0

    def project(number: int, point: Array) -> Array:
        if number != 5:
            return faces.project(number, point)
        return np.asarray(centre + radius * (point - centre) / np.linalg.norm(point - centre))

    state = EditableMesh(mesh, FacesOfFacets(faces.face, project))
    edge = np.array([2.0, 0.0, height(2.0)])
    node = int(np.argmin(np.linalg.norm(state.points - edge, axis=1)))
    found = state.project_on(state.facets_at[node], edge + np.array([0.3, 0.3, 0.2]))
    assert found[1] == pytest.approx(0.0, abs=1e-8)
    assert np.linalg.norm(found - centre) == pytest.approx(radius, abs=1e-8)


def first_collapse(mesh: VolumeMesh, gone: tuple[float, ...], kept: tuple[float, ...]) -> tuple[EditableMesh, int, int]:
    a, b = (int(np.argmin(np.linalg.norm(mesh.points - place, axis=1))) for place in (gone, kept))
    return EditableMesh(mesh, None), a, b


INSIDE = (1.0, 2.0, 1.0), (2.0, 2.0, 1.0)


def test_changes_that_share_elements_are_not_made_together() -> None:
    flat = squeeze(block("tetra"), *INSIDE)
    state = EditableMesh(flat, None)
    pair = min(
        ((i, j) for i in range(len(flat.points)) for j in state.neighbours(i)),
        key=lambda each: float(np.linalg.norm(flat.points[each[0]] - flat.points[each[1]])),
    )
    change = edge_collapse._examine(state, *pair)
    assert isinstance(change, Change)
    assert state.judge_changes([change]) is not None
    assert state.judge_changes([change, change]) is None


def test_an_edge_whose_image_is_missing_is_kept() -> None:
    """An end in a side has an image; an end inside has none there."""
    state, a, b = first_collapse(block("tetra"), (0.0, 2.0, 1.0), (1.0, 2.0, 1.0))
    assert find_images(state, a, b) == []
    assert len(find_images(state, b, a)) == 1


def remove_cells(mesh: VolumeMesh, gone: list[int]) -> VolumeMesh:
    kept = np.setdiff1d(np.arange(mesh.n_cells), gone)
    cells = {"tetra": mesh.cells["tetra"][kept]}
    return VolumeMesh(mesh.points, cells, boundary_facets(cells), {"body": np.arange(len(kept))})


def test_an_edge_of_a_cavity_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """The opposite edge and both ends make triangles, but no element: a collapse would fold the cavity together."""
    monkeypatch.setattr(editable_mesh, "CREASE_COSINE", -2.0)
    monkeypatch.setattr(edge_collapse, "CREASE_COSINE", -2.0)
    monkeypatch.setattr(edge_collapse, "LEAST_COSINE", -2.0)
    mesh = block("tetra")
    inner = ((mesh.points > 0.1) & (mesh.points < EXTENT - 0.1)).all(axis=1)
    both = np.flatnonzero(inner)
    cell = next(i for i, row in enumerate(mesh.cells["tetra"].tolist()) if set(both.tolist()) <= set(row))
    whole = EditableMesh(remove_cells(mesh, []), None)
    assert edge_collapse._examine(whole, *both[:2].tolist()) is not None
    cut = EditableMesh(remove_cells(mesh, [cell]), None)
    assert edge_collapse._examine(cut, *both[:2].tolist()) is None


def make_ring() -> VolumeMesh:
    """A triangular prism with a triangular hole, of 18 tetrahedra."""
    angles = 2 * np.pi * np.arange(3) / 3
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    flat = np.concatenate([circle, 4.0 * circle])
    points = np.concatenate([np.column_stack([flat, np.full(6, z)]) for z in (0.0, 1.0)])
    rows = []
    for i in range(3):
        j = (i + 1) % 3
        for triangle in ((i, 3 + i, j), (3 + i, 3 + j, j)):
            a, b, c = sorted(triangle)
            rows += [(a, b, c, c + 6), (a, b, b + 6, c + 6), (a, a + 6, b + 6, c + 6)]
    cells = np.array(rows)
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    cells[np.linalg.det(edges) < 0] = cells[np.linalg.det(edges) < 0][:, [1, 0, 2, 3]]
    blocks = {"tetra": cells}
    return VolumeMesh(points, blocks, boundary_facets(blocks), {"body": np.arange(len(cells))})


def test_an_edge_around_a_hole_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its ends have a neighbour in common, with which they make no element: a collapse would pinch the hole."""
    monkeypatch.setattr(edge_collapse, "CREASE_COSINE", -2.0)
    monkeypatch.setattr(edge_collapse, "LEAST_COSINE", -2.0)
    ring = make_ring()
    assert ring.quality.inverted == 0
    assert edge_collapse._examine(EditableMesh(ring, None), 0, 1) is None


def test_a_crease_is_not_left_sideways(monkeypatch: pytest.MonkeyPatch) -> None:
    """All facets are of one group: the angle between them alone says that an edge of the box is one."""
    mesh = replace(block("tetra"), periodic={}, facet_groups={})
    state, a, b = first_collapse(mesh, (0.0, 2.0, 0.0), (1.0, 2.0, 0.0))
    monkeypatch.setattr(edge_collapse, "LEAST_COSINE", -2.0)
    assert edge_collapse._examine(state, a, b) is None
    monkeypatch.setattr(edge_collapse, "CREASE_COSINE", -2.0)
    assert edge_collapse._examine(state, a, b) is not None


def test_facets_do_not_turn_with_a_collapse(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, _ = make_vault()
    points = mesh.points.copy()
    on_top = np.abs(points[:, 2] - height(points[:, 0])) < 1e-9
    points[on_top, 2] += 0.3 * (points[on_top, 0] - 1.5) ** 2
    state, a, b = first_collapse(
        replace(mesh, points=points), (1.0, 2.0, height(1.0) + 0.075), (0.0, 2.0, height(0.0) + 0.675)
    )
    monkeypatch.setattr(edge_collapse, "CREASE_COSINE", -2.0)
    assert edge_collapse._examine(state, a, b) is None
    monkeypatch.setattr(edge_collapse, "LEAST_COSINE", -2.0)
    assert edge_collapse._examine(state, a, b) is not None
