"""Elements that are flat on a curved face are repaired: the edge opposite to the face is split, and its node goes inwards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.meshing.mesh_facets import boundary_facets
from tests.meshing.test_edge_collapse import check_same_body
from tests.meshing.test_mesh_improvement import jitter
from tests.meshing.test_volume_mesh import EXTENT, block
from tpmscad._typing import Array
from tpmscad.meshing import mesh_improvement, swaps
from tpmscad.meshing.edge_splits import _list_places, _make_change, split_edge
from tpmscad.meshing.editable_mesh import Change, EditableMesh, FacesOfFacets
from tpmscad.meshing.element_shapes import TETRA_EDGES, determinants
from tpmscad.meshing.mesh_improvement import improve_poor_elements
from tpmscad.meshing.tetrahedra import untangle
from tpmscad.meshing.volume_mesh import VolumeMesh

RADIUS = 2.0


def on_cylinder(x: float, y: float) -> tuple[float, float, float]:
    return (x, y, float(np.sqrt(RADIUS**2 - x * x)))


def make_roof(lift: float = 0.0) -> tuple[VolumeMesh, FacesOfFacets]:
    """A flat element with two facets on a cylinder around y, on three others that meet in a point below.

    The two facets meet in the edge 0-1; the edge 2-3 below it is inside the body.
    """
    points = np.array(
        [
            on_cylinder(0.0, -0.7),
            on_cylinder(0.0, 0.7),
            on_cylinder(-0.7, 0.0),
            on_cylinder(0.7, 0.0),
            (0.0, 0.0, 0.7 - lift),
        ]
    )
    corners = np.array([[0, 1, 2, 3], [0, 2, 3, 4], [1, 3, 2, 4]])
    edges = points[corners[:, 1:]] - points[corners[:, :1]]
    wrong = np.linalg.det(edges) < 0
    corners[wrong] = corners[wrong][:, [1, 0, 2, 3]]
    middles: dict[frozenset[int], int] = {}
    rows, places = [], [*points]
    for row in corners.tolist():
        for i, j in TETRA_EDGES:
            pair = frozenset((row[i], row[j]))
            if pair not in middles:
                middles[pair] = len(places)
                place = 0.5 * (points[row[i]] + points[row[j]])
                if 4 not in pair and pair != {2, 3}:
                    place = np.array(on_cylinder(place[0], place[1]))
                places.append(place)
        rows.append([*row, *(middles[frozenset((row[i], row[j]))] for i, j in TETRA_EDGES)])
    cells = {"tetra10": np.array(rows)}
    facets = boundary_facets(cells)
    on_top = ~(facets["triangle6"][:, :3] == 4).any(axis=1)
    groups = {"top": np.flatnonzero(on_top), "below": np.flatnonzero(~on_top)}
    mesh = VolumeMesh(np.array(places), cells, facets, {"body": np.arange(3)}, groups)

    def project(face: int, point: Array) -> Array:
        return np.array(on_cylinder(point[0], point[1])) if face == 0 else point

    return mesh, FacesOfFacets((~on_top).astype(np.int64), project)


def test_a_flat_element_is_repaired_by_a_split_of_its_edge_inside(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, faces = make_roof()
    state = EditableMesh(mesh, faces)
    worst = state.quality()[1].min()
    assert worst < 0.05
    assert split_edge(state, 0, 1.0) == 1
    found = state.build()
    assert found.n_cells == 6
    assert found.quality.inverted == 0
    assert found.quality.smallest_scaled_jacobian > worst + 0.05
    assert found.volume == pytest.approx(mesh.volume, rel=1e-3)  # curved edges inside became straight
    assert found.n_facets == mesh.n_facets
    new = found.points[np.argmin(np.abs(found.points[:, :2]).sum(axis=1) + 10 * (found.points[:, 2] < 0.8))]
    assert 0.8 < new[2] < on_cylinder(0.7, 0.0)[2]
    assert (
        improve_poor_elements(mesh, 1.0, faces).n_cells == 2
    )  # a flip of the facets, which is tried before, needs fewer
    monkeypatch.setattr(mesh_improvement, "swap_around", lambda state, cell: 0)
    assert improve_poor_elements(mesh, 1.0, faces).split == 1


def test_no_edge_of_a_facet_is_split() -> None:
    """The element below has two facets, too, at its edge to the lowest node; its opposite edge lies on the cylinder."""
    mesh, faces = make_roof()
    state = EditableMesh(mesh, faces)
    cells = mesh.cells["tetra10"][:, :4].tolist()
    below = next(i for i, row in enumerate(cells) if set(row) == {0, 2, 3, 4})
    assert len(state.facets_at[0] & state.facets_at[4]) == 2
    assert len(state.facets_at[2] & state.facets_at[4]) == 2
    assert state.facets_at[0] & state.facets_at[3]
    assert _list_places(state, (2, 4), (0, 3), 1.0).shape == (0, 3)
    assert _list_places(state, (0, 1), (2, 3), 1.0).shape == (6, 3)
    assert split_edge(state, below, 1.0) in (0, 1)
    assert state.build().n_facets == mesh.n_facets


@pytest.mark.parametrize("kind", ["tetra", "tetra10"])
def test_splits_keep_the_body(kind: str) -> None:
    """Every edge inside that may be split is, with whatever becomes of the elements."""
    before = block(kind)
    state = EditableMesh(before, None)
    done = 0
    for cell in range(before.n_cells):
        if not (state.alive[cell] and state.has_room()):
            continue
        corners = state.cells[cell, :4].tolist()
        for i, j in TETRA_EDGES:
            a, b = corners[i], corners[j]
            if not state.facets_at[a] & state.facets_at[b]:
                change = _make_change(state, a, b, 0.5 * (state.points[a] + state.points[b]))
                if change is not None:
                    state.apply(change)
                    done += 1
                    break
    assert done > 3
    check_same_body(state.build(), before)


def test_a_facet_pair_of_one_face_is_flipped_however_it_is_bent(monkeypatch: pytest.MonkeyPatch) -> None:
    """A face has no creases; the same angle between two faces of one group is taken for one."""
    mesh, faces = make_roof()
    facets = sorted(set(np.flatnonzero(faces.face == 0).tolist()))
    bent = EditableMesh(mesh, faces)
    monkeypatch.setattr(swaps, "LEAST_COSINE", 0.999)
    assert bent.normal(facets[0]) @ bent.normal(facets[1]) < 0.999
    ends = [2, 3]
    assert swaps._may_flip(bent, 0, 1, facets, ends)
    apart = faces.face.copy()
    apart[facets[1]] = 2
    assert not swaps._may_flip(EditableMesh(mesh, replace(faces, face=apart)), 0, 1, facets, ends)


def test_what_would_stay_inverted_with_straight_edges_is_refused() -> None:
    """A change that helps the curved elements, of which one could no longer be made straight."""
    mesh, faces = make_roof()
    state = EditableMesh(mesh, faces)
    ends = state.points[[0, 1]]
    sunk = {
        0: ends[0] - (0, 0, 0.35),
        1: ends[1] - (0, 0, 0.35),
    }  # the chord goes below the opposite edge; middles stay
    rows = np.flatnonzero(state.alive)
    change = Change(rows.tolist(), state.cells[rows], rows.tolist(), sunk)
    points = state.points.copy()
    points[[0, 1]] = [sunk[0], sunk[1]]
    corners = points[state.cells[rows, :4]]
    assert determinants(corners[:, 1:] - corners[:, :1]).min() < 0
    assert state.worst_after([change], -2.0) is None
    assert state.worst_after([replace(change, points={})], -2.0) is not None


def test_determinants_are_those_of_numpy() -> None:
    matrices = np.random.default_rng(3).normal(size=(7, 4, 3, 3))
    np.testing.assert_allclose(determinants(matrices), np.linalg.det(matrices), rtol=1e-12, atol=1e-14)


def test_an_element_that_cannot_be_repaired_is_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Later passes go to elements around which something has changed."""
    before = jitter(block("tetra"), 1, 0.42)
    poor = np.flatnonzero(EditableMesh(before, None).quality()[1] < 0.3).tolist()
    tried: list[int] = []

    def change_last(state: EditableMesh, cell: int, size: float) -> int:
        tried.append(cell)
        if len(tried) != len(poor):
            return 0
        state.apply(Change([cell], state.cells[[cell]], [cell], {}))
        return 1

    for name in ("collapse_shortest_edge", "swap_around", "split_edge"):
        monkeypatch.setattr(mesh_improvement, name, lambda *arguments: 0)
    monkeypatch.setattr(mesh_improvement, "_move_nodes", change_last)
    monkeypatch.setattr(mesh_improvement, "POOR", 0.3)
    improve_poor_elements(before, 1.0)
    changed = set(before.cells["tetra"][tried[len(poor) - 1]].tolist())
    near = {cell for cell in poor if changed & set(before.cells["tetra"][cell].tolist())}
    assert len(set(poor) - near) > 5
    assert set(tried) == set(poor)
    assert all(tried.count(cell) == 1 + (cell in near) for cell in poor)


def test_edges_are_made_straight_until_no_element_is_inverted() -> None:
    """To straighten an edge inverts a neighbour, in a row of elements longer than any fixed number of passes."""
    mesh = block("tetra10")
    points = mesh.points.copy()
    inside = np.setdiff1d(np.arange(len(points)), np.concatenate([*mesh.facets.values()]).ravel())
    middles = np.intersect1d(inside, mesh.cells["tetra10"][:, 4:])
    points[middles] += np.random.default_rng(0).uniform(-0.6, 0.6, (len(middles), 3))
    spoilt = replace(mesh, points=points)
    assert spoilt.quality.inverted > 20
    repaired = untangle(spoilt)
    assert repaired.quality.inverted == 0
    assert repaired.straightened == 0
    assert repaired.volume == pytest.approx(float(np.prod(EXTENT)), rel=1e-12)
