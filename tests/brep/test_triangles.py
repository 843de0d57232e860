"""Triangles of patches, of one periodic cell, and of bodies filled with such cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpmscad.brep.triangles.cell_polyhedron import PeriodicCell, clip_triangles, find_periodic_cell
from tpmscad.brep.triangles.closed_mesh import SolidMesh, label_points, sum_open_sides
from tpmscad.brep.triangles.filled_mesh import CellChoice, choose_cells, fill_mesh
from tpmscad.errors import TrimmingError

manifold3d = pytest.importorskip("manifold3d")

LOW, CELL = np.array([0.11, 0.23, 0.37]), np.array([1.0, 1.2, 0.9])


def box_mesh(low: np.ndarray, high: np.ndarray) -> SolidMesh:
    made = manifold3d.Manifold.cube(tuple(high - low)).translate(tuple(low)).to_mesh64()
    triangles = np.asarray(made.tri_verts, np.int64)
    return SolidMesh(np.array(made.vert_properties), triangles, np.arange(len(triangles)))


def plate_cell() -> PeriodicCell:
    """A wavy plate: z = h(x, y) and z = h(x, y) + 0.3, which repeat after the cell."""
    n = 8
    x, y = (np.arange(-n, 2 * n + 1) / n * CELL[axis] for axis in (0, 1))
    at = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    height = 0.7 + 0.08 * np.sin(2 * np.pi * at[..., 0] / CELL[0]) * np.cos(2 * np.pi * at[..., 1] / CELL[1])
    i, j = np.meshgrid(np.arange(3 * n), np.arange(3 * n), indexing="ij")
    a = (i * (3 * n + 1) + j).ravel()
    b, c, d = a + 3 * n + 1, a + 3 * n + 2, a + 1
    up = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    points = [np.concatenate([at, (height + lift)[..., None]], axis=-1).reshape(-1, 3) for lift in (0.0, 0.3)]
    return find_periodic_cell(np.concatenate(points), np.concatenate([up[:, ::-1], up + len(points[0])]), LOW, CELL)


@pytest.fixture(scope="module")
def cell() -> PeriodicCell:
    return plate_cell()


def test_a_cell_repeats_to_the_last_bit(cell: PeriodicCell) -> None:
    points = cell.base[cell.node_base] + cell.node_shift * cell.cell
    for axis in range(3):
        lower = {tuple(p) for p in points[cell.triangles[cell.side == 2 * axis]].reshape(-1, 3)}
        upper = points[cell.triangles[cell.side == 2 * axis + 1]].reshape(-1, 3)
        nodes = cell.triangles[cell.side == 2 * axis + 1].ravel()
        assert (cell.node_shift[nodes, axis] == 1).all()
        below = cell.base[cell.node_base[nodes]] + (cell.node_shift[nodes] - np.eye(3, dtype=int)[axis]) * cell.cell
        assert {tuple(p) for p in below} == lower
        assert len(upper) == len(below)
    solid = SolidMesh(points, cell.triangles, cell.side)
    assert solid.volume == pytest.approx(0.3 * CELL[0] * CELL[1], rel=1e-9)


def test_placed_cells_are_closed_and_share_their_nodes(cell: PeriodicCell) -> None:
    cells = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 2, 1]])
    placed = cell.place(cells, np.zeros(3, np.int64), np.array([3, 3, 2]))
    assert sum_open_sides(placed.mesh.triangles.astype(np.uint64)) == 0
    assert placed.mesh.volume == pytest.approx(4 * 0.3 * CELL[0] * CELL[1])
    assert len(np.unique(label_points(placed.mesh.points))) == len(placed.mesh.points)


def test_a_filled_box_is_closed_and_has_its_volume(cell: PeriodicCell) -> None:
    low, high = np.array([-2.4, -3.1, 0.45]), np.array([2.9, 2.2, 2.6])
    body = box_mesh(low, high)
    choice = choose_cells(LOW, CELL, body)
    assert len(choice.whole) > 4
    filled = fill_mesh(cell, choice, body)
    x, y = (np.linspace(low[k], high[k], 801)[:-1] + (high[k] - low[k]) / 1600 for k in (0, 1))
    height = 0.7 + 0.08 * np.outer(np.sin(2 * np.pi * x / CELL[0]), np.cos(2 * np.pi * y / CELL[1]))
    plates = [
        np.clip(height + k * CELL[2] + np.array([0.0, 0.3])[:, None, None], low[2], high[2]) for k in range(-1, 3)
    ]
    thickness = sum(upper - lower for lower, upper in plates)
    assert filled.volume == pytest.approx((high - low)[:2].prod() * thickness.mean(), rel=2e-3)
    inside = (filled.points >= low - 1e-12) & (filled.points <= high + 1e-12)
    assert inside.all()
    assert set(np.unique(filled.face[filled.face > 0]) - 1) <= set(body.face.tolist())


def test_whole_cells_are_those_that_no_boundary_touches(cell: PeriodicCell) -> None:
    body = box_mesh(LOW, LOW + 4 * CELL)
    aligned = choose_cells(LOW, CELL, body)
    assert {tuple(c) for c in aligned.whole.tolist()} == {(i, j, k) for i in (1, 2) for j in (1, 2) for k in (1, 2)}
    hole = box_mesh(LOW + 1.2 * CELL, LOW + 1.7 * CELL)
    shell = SolidMesh(hole.points, hole.triangles[:, ::-1], hole.face)
    assert [1, 1, 1] not in choose_cells(LOW, CELL, body, [shell]).whole.tolist()


def test_what_does_not_repeat_is_refused() -> None:
    box = box_mesh(LOW + 0.2, LOW + 0.5 + CELL)
    with pytest.raises(TrimmingError, match=r"do not repeat|alternate"):
        find_periodic_cell(box.points, box.triangles, LOW, CELL)


@given(st.integers(0, 2**32 - 1))
def test_open_sides_are_told_whatever_the_mesh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sphere = manifold3d.Manifold.sphere(1.0, int(rng.integers(4, 24))).to_mesh64()
    points, triangles = np.array(sphere.vert_properties), np.asarray(sphere.tri_verts, np.int64)
    labels = label_points(points.astype(np.float32))[triangles]
    assert sum_open_sides(labels) == 0
    part = rng.random(len(labels)) < 0.5
    if part.any() and not part.all():
        assert sum_open_sides(labels[part]) != 0
        assert (sum_open_sides(labels[part]) + sum_open_sides(labels[~part])) % 2**64 == 0
    turned = labels.copy()
    turned[0] = turned[0, ::-1]
    assert sum_open_sides(turned) != 0


@given(st.floats(-0.9, 0.9), st.integers(0, 2), st.sampled_from([-1, 1]))
def test_clipped_parts_add_up(at: float, axis: int, keep: int) -> None:
    sphere = manifold3d.Manifold.sphere(1.0, 16).rotate((10, 20, 30)).to_mesh64()
    points, triangles = np.array(sphere.vert_properties), np.asarray(sphere.tri_verts, np.int64)
    areas = []
    for sign in (keep, -keep):
        mesh = SolidMesh(*clip_triangles(points, triangles, axis, at, sign), np.zeros(0))
        assert (sign * (mesh.points[:, axis] - at) >= 0).all()
        areas.append(mesh.area)
    assert sum(areas) == pytest.approx(SolidMesh(points, triangles, np.zeros(0)).area)


def test_surfaces_of_whole_cells_join_cut_ones_without_sides(cell: PeriodicCell) -> None:
    body = box_mesh(LOW - 1.3 * CELL, LOW + 3.4 * CELL)
    choice = choose_cells(LOW, CELL, body)
    all_cut = CellChoice(choice.origin, choice.size, choice.whole[:0], np.concatenate([choice.cut, choice.whole]))
    one, other = fill_mesh(cell, choice, body), fill_mesh(cell, all_cut, body)
    assert one.volume == pytest.approx(other.volume, rel=1e-12)
    assert one.area == pytest.approx(other.area, rel=1e-12)
