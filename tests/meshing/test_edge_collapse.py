"""Short edges of flat tetrahedra are collapsed without a change of volume, groups, boundary or periodic pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.meshing.mesh_facets import boundary_facets
from tests.meshing.test_volume_mesh import EXTENT, block
from tpmscad.meshing import edge_collapse, mesh_improvement
from tpmscad.meshing.edge_collapse import collapse_shortest_edge
from tpmscad.meshing.editable_mesh import Change, EditableMesh
from tpmscad.meshing.element_shapes import SHAPES
from tpmscad.meshing.volume_mesh import VolumeMesh


def squeeze(mesh: VolumeMesh, gone: tuple[float, ...], kept: tuple[float, ...], axis: int | None = None) -> VolumeMesh:
    """The mesh with one corner, and its image along an axis, moved to within a hundredth of another, and straight edges."""
    points = mesh.points.copy()
    for shift in (0.0, 1.0) if axis is not None else (0.0,):
        move = shift * EXTENT * (np.arange(3) == axis)
        a, b = (int(np.argmin(np.linalg.norm(mesh.points - place - move, axis=1))) for place in (gone, kept))
        points[a] = points[b] + 0.01 * (points[a] - points[b])
    return straighten(replace(mesh, points=points))


def straighten(mesh: VolumeMesh) -> VolumeMesh:
    ((kind, cells),) = mesh.cells.items()
    points = mesh.points.copy()
    points[cells] = np.einsum("pn,mnc->mpc", SHAPES["tetra"].values(SHAPES[kind].nodes), points[cells[:, :4]])
    return replace(mesh, points=points)


def collapse_short_edges(mesh: VolumeMesh, size: float) -> VolumeMesh:
    """The mesh with collapses alone, at each poor element in turn."""
    state, count = EditableMesh(mesh, None), 0
    while done := mesh_improvement._repair_poor(
        state, lambda cell: collapse_shortest_edge(state, cell, 0.5 * size), {}
    ):
        count += done
    return replace(state.build(), collapsed=count) if count else mesh


def areas(mesh: VolumeMesh) -> dict[str, float]:
    ((_, facets),) = mesh.facets.items()
    a, b, c = mesh.points[facets[:, :3]].swapaxes(0, 1)
    each = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return {name: float(each[numbers].sum()) for name, numbers in mesh.facet_groups.items()}


def check_same_body(found: VolumeMesh, before: VolumeMesh) -> None:
    assert found.quality.inverted == 0
    assert found.volume == pytest.approx(before.volume, rel=1e-12)
    assert areas(found) == pytest.approx(areas(before), rel=1e-12)
    assert found.mismatch == 0.0
    assert {name: len(of) for name, of in found.cell_groups.items()}["body"] == found.n_cells
    ((_, facets),) = found.facets.items()
    ((_, outer),) = boundary_facets(found.cells).items()
    assert {frozenset(row) for row in facets.tolist()} == {frozenset(row) for row in outer.tolist()}
    for name, pairs in found.periodic.items():
        number = "xyz".index(name)
        on_side = np.flatnonzero(np.abs(found.points[:, number] - EXTENT[number]) < 1e-12)
        np.testing.assert_array_equal(np.sort(pairs[:, 1]), on_side)


@pytest.mark.parametrize("kind", ["tetra", "tetra10"])
@pytest.mark.parametrize(
    ("gone", "kept", "axis", "count"),
    [
        ((1.0, 2.0, 1.0), (2.0, 2.0, 1.0), None, 1),  # both inside
        ((2.0, 2.0, 1.0), (3.0, 2.0, 1.0), None, 1),  # on to a side
        ((0.0, 2.0, 1.0), (0.0, 2.0, 0.0), 0, 2),  # within a side, on to an edge of the box, and the image
    ],
)
def test_an_edge_is_collapsed_with_its_images(
    kind: str, gone: tuple[float, ...], kept: tuple[float, ...], axis: int | None, count: int
) -> None:
    flat = squeeze(block(kind), gone, kept, axis)
    assert flat.quality.smallest_scaled_jacobian < 0.02
    found = collapse_short_edges(flat, 2.0)
    assert found.collapsed == count
    assert found.quality.smallest_scaled_jacobian > 0.1
    check_same_body(found, flat)
    corners = {tuple(point) for point in found.points.tolist()}
    assert {tuple(p) for p in (EXTENT * np.array(list(np.ndindex(2, 2, 2)))).tolist()} <= corners


@pytest.mark.parametrize("by_angle", [False, True])
def test_an_edge_of_the_box_stays_when_its_node_is_near_one_of_a_side(by_angle: bool) -> None:
    """The node that may go is the other one: the edge belongs to groups that this is not in, or facets would turn."""
    mesh = block("tetra10")
    mesh = replace(mesh, periodic={}, facet_groups={} if by_angle else mesh.facet_groups)
    flat = squeeze(mesh, (0.0, 2.0, 1.0), (0.0, 2.0, 0.0))
    found = collapse_short_edges(flat, 0.5)
    assert found.collapsed == 1
    assert (np.abs(found.points - (0.0, 2.0, 0.0)).max(axis=1) == 0).any()
    assert found.volume == pytest.approx(np.prod(EXTENT), rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_many_collapses_leave_a_mesh_of_the_same_body(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_improvement, "POOR", 0.9)
    mesh = block("tetra")
    rng = np.random.default_rng(seed)
    inner = (mesh.points > 1e-9) & (mesh.points < EXTENT - 1e-9)
    ties, _ = mesh.periodic_ties()
    jitter = rng.uniform(-0.45, 0.45, mesh.points.shape)[ties] * inner  # alike for images
    moved = replace(mesh, points=mesh.points + jitter)
    found = collapse_short_edges(moved, 10.0)
    assert found.collapsed > 0
    check_same_body(found, moved)


def test_an_edge_at_whose_ends_facets_would_fall_together_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node of three facets, on an element whose fourth triangle has both ends of the edge: two facets would be one."""
    monkeypatch.setattr(edge_collapse, "_turns", lambda *_: False)  # on thin parts normals do not tell
    points = np.array([(-0.1, 0, 0), (0.1, 0, 0), (0, 2, 0), (0, 1, 0.02), (0, -2, 0), (-2, 0, 0), (0, 0, -2)])
    cells = {"tetra": np.array([(0, 1, 2, 3), (1, 0, 2, 6), (0, 1, 4, 6), (5, 2, 0, 6), (4, 5, 0, 6)])}
    mesh = replace(block("tetra"), points=points, cells=cells, facets=boundary_facets(cells), periodic={})
    state = EditableMesh(replace(mesh, cell_groups={}, facet_groups={}), None)
    assert mesh.quality.inverted == 0
    assert edge_collapse._examine(state, 0, 1) is None


def test_a_good_mesh_is_left_alone() -> None:
    mesh = block("tetra10")
    assert collapse_short_edges(mesh, 1.0) is mesh


def test_long_edges_of_flat_elements_are_kept() -> None:
    flat = squeeze(block("tetra"), (1.0, 2.0, 1.0), (2.0, 2.0, 1.0))
    assert collapse_short_edges(flat, 0.01) is flat


def test_a_very_short_edge_goes_even_if_a_curved_element_stays_poor(monkeypatch: pytest.MonkeyPatch) -> None:
    """No node can be moved so that an element at the short edge is good; the curved edge can be repaired."""
    flat = squeeze(block("tetra10"), (1.0, 2.0, 1.0), (2.0, 2.0, 1.0))
    state = EditableMesh(flat, None)
    pairs = [
        (i, j) for i in range(len(flat.points)) for j in (state.neighbours(i) if state.cells_at[i] else ()) if i < j
    ]
    a, b = min(pairs, key=lambda pair: float(np.linalg.norm(flat.points[pair[0]] - flat.points[pair[1]])))
    cell = min(state.cells_at[a] & state.cells_at[b])
    examine = edge_collapse._examine

    def examine_and_bend(mesh: EditableMesh, gone: int, kept: int) -> Change | None:
        change = examine(mesh, gone, kept)
        assert change is not None
        middle = int(change.cells[0, 4])
        return replace(change, points={**change.points, middle: mesh.points[middle] + (0.0, 0.0, 2.0)})

    monkeypatch.setattr(edge_collapse, "_examine", examine_and_bend)
    with monkeypatch.context() as patch:
        patch.setattr(edge_collapse, "FAR_SHORTER", 0.0)
        assert collapse_shortest_edge(state, cell, 0.5) == 0
    assert collapse_shortest_edge(state, cell, 0.5) == 1
    assert state.build().quality.inverted > 0
