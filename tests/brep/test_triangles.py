"""Triangles of patches, of one periodic cell, and of bodies filled with such cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpmscad.brep.triangles.cell_polyhedron import clip_triangles, find_periodic_cell
from tpmscad.brep.triangles.closed_mesh import SolidMesh, is_closed, label_points, sum_open_sides
from tpmscad.brep.triangles.filled_mesh import PieceChoice, choose_pieces, fill_mesh
from tpmscad.brep.triangles.repeated_pieces import SURFACE, RepeatedPieces, close_walls
from tpmscad.errors import TrimmingError

manifold3d = pytest.importorskip("manifold3d")

LOW, CELL = np.array([0.11, 0.23, 0.37]), np.array([1.0, 1.2, 0.9])


def box_mesh(low: np.ndarray, high: np.ndarray) -> SolidMesh:
    made = manifold3d.Manifold.cube(tuple(high - low)).translate(tuple(low)).to_mesh64()
    triangles = np.asarray(made.tri_verts, np.int64)
    return SolidMesh(np.array(made.vert_properties), triangles, np.arange(len(triangles)))


def plate_cell() -> RepeatedPieces:
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
def cell() -> RepeatedPieces:
    return plate_cell()


def plate_walls() -> RepeatedPieces:
    """The same plate as walls over 2 x 3 patches of a mid surface, each of 4 x 4 rectangles in 2 x 2 blocks."""
    i, j = np.meshgrid(np.arange(5), np.arange(5), indexing="ij")
    a = (i[:4, :4] * 5 + j[:4, :4]).ravel()
    b, c, d = a + 5, a + 6, a + 1
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    block = np.tile((i[:4, :4] // 2 * 2 + j[:4, :4] // 2).ravel(), 2)
    mid = []
    for p, q in np.ndindex(2, 3):
        x, y = (i + 4 * p) / 8 * CELL[0], (j + 4 * q) / 12 * CELL[1]
        height = 0.85 + 0.08 * np.sin(2 * np.pi * x / CELL[0]) * np.cos(2 * np.pi * y / CELL[1])
        mid.append(np.stack([x, y, height], axis=-1).reshape(-1, 3))
    arm = np.broadcast_to(np.array([0, 0, 0.15]), (6, 25, 3))
    both = np.stack([triangles, triangles])
    return close_walls(CELL, np.array(mid), np.stack([-arm, arm]), both, block, np.ones(6, int), (1.0, 1.0), 1e-9)


@pytest.fixture(scope="module")
def walls() -> RepeatedPieces:
    return plate_walls()


def test_a_cell_repeats_to_the_last_bit(cell: RepeatedPieces) -> None:
    for axis in range(3):
        step = np.eye(3, dtype=int)[axis]
        sides = [cell.node[cell.triangles[(cell.beyond_shift == s * step).all(axis=1)]] for s in (-1, 1)]
        lower, upper = ({tuple(row) for row in side.reshape(-1, 5).tolist()} for side in sides)
        assert lower == {(b, w, *(np.array(shift) - step).tolist()) for b, w, *shift in upper}
    assert SolidMesh(cell.points, cell.triangles, cell.piece).volume == pytest.approx(0.3 * CELL[0] * CELL[1], rel=1e-9)


def test_pieces_of_walls_are_closed_and_pair_their_sides(walls: RepeatedPieces) -> None:
    assert len(walls.low) == 24
    total = 0.0
    for piece in range(24):
        own = walls.piece == piece
        assert is_closed(walls.triangles[own])
        total += SolidMesh(walls.points, walls.triangles[own], walls.piece[own]).volume
        corners = walls.points[walls.triangles[own]].reshape(-1, 3)
        assert (corners.min(axis=0) >= walls.low[piece] - 1e-12).all()
        assert (corners.max(axis=0) <= walls.high[piece] + 1e-12).all()
    assert total == pytest.approx(0.3 * CELL[0] * CELL[1], rel=1e-9)
    assert len(np.unique(walls.beyond)) == 25


@pytest.mark.parametrize("kind", ["cell", "walls"])
def test_placed_pieces_are_closed_and_share_their_nodes(kind: str, request: pytest.FixtureRequest) -> None:
    pieces = request.getfixturevalue(kind)
    cut = np.zeros((3, 3, 2, len(pieces.low)), bool)
    cut[tuple(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 2, 1]]).T)] = True
    placed = pieces.place(~cut, cut, np.zeros(3, np.int64))
    assert is_closed(placed.cut)
    block = placed.block
    assert is_closed(block.triangles)
    assert block.volume == pytest.approx(4 * 0.3 * CELL[0] * CELL[1])
    assert len(np.unique(label_points(placed.points))) == len(placed.points)
    surfaces = placed.cut[placed.cut_face != SURFACE]
    everything = pieces.place(cut | ~cut, cut & ~cut, np.zeros(3, np.int64))
    assert len(placed.whole) + len(surfaces) == len(everything.whole)
    # seen from the whole pieces the sides of the cut ones are open, and the other way round
    joined = np.concatenate([placed.whole, surfaces])
    labels = label_points(placed.points)
    assert sum_open_sides(joined, labels) == sum_open_sides(everything.whole, label_points(everything.points))


def test_a_scale_moves_both_walls_of_a_node(walls: RepeatedPieces) -> None:
    every = np.ones((2, 2, 1, 24), bool)
    placed = walls.place(~every, every, np.zeros(3, np.int64), lambda points: 1.0 + points[:, [0, 0]])
    x = (np.arange(16) + 0.5) / 8 * CELL[0]
    assert placed.block.volume == pytest.approx(0.3 * float((1 + x).mean()) * 4 * CELL[0] * CELL[1], rel=1e-3)


def test_pairs_of_sides_that_meet_in_an_edge_are_parted(walls: RepeatedPieces) -> None:
    """Pieces of a checkerboard touch in edges only; Manifold takes their block as it is."""
    cut = np.zeros((1, 1, 1, 24), bool)
    cut[0, 0, 0, [0, 3]] = True
    block = walls.place(~cut, cut, np.zeros(3, np.int64)).block
    sides = np.sort(np.stack([block.triangles, np.roll(block.triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()
    assert is_closed(block.triangles)


@pytest.mark.parametrize("kind", ["cell", "walls"])
def test_a_filled_box_is_closed_and_has_its_volume(kind: str, request: pytest.FixtureRequest) -> None:
    cell = request.getfixturevalue(kind)
    low, high = np.array([-2.4, -3.1, 0.45]), np.array([2.9, 2.2, 2.6])
    body = box_mesh(low, high)
    choice = choose_pieces(cell.cell, cell.low, cell.high, body)
    assert choice.whole.sum() > 4
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


def test_whole_cells_are_those_that_no_boundary_touches(cell: RepeatedPieces) -> None:
    body = box_mesh(LOW, LOW + 4 * CELL)
    aligned = choose_pieces(cell.cell, cell.low, cell.high, body)
    whole = np.argwhere(aligned.whole[..., 0]) + aligned.origin
    assert {tuple(c) for c in whole.tolist()} == {(i, j, k) for i in (1, 2) for j in (1, 2) for k in (1, 2)}
    hole = box_mesh(LOW + 1.2 * CELL, LOW + 1.7 * CELL)
    shell = SolidMesh(hole.points, hole.triangles[:, ::-1], hole.face)
    assert not choose_pieces(cell.cell, cell.low, cell.high, body, [shell]).whole[tuple(1 - aligned.origin)].any()


def test_what_does_not_repeat_is_refused() -> None:
    box = box_mesh(LOW + 0.2, LOW + 0.5 + CELL)
    with pytest.raises(TrimmingError, match=r"do not repeat|alternate"):
        find_periodic_cell(box.points, box.triangles, LOW, CELL)


@given(st.integers(0, 2**32 - 1))
def test_open_sides_are_told_whatever_the_mesh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sphere = manifold3d.Manifold.sphere(1.0, int(rng.integers(4, 24))).to_mesh64()
    points, triangles = np.array(sphere.vert_properties), np.asarray(sphere.tri_verts, np.int64)
    labels = label_points(points.astype(np.float32))
    assert sum_open_sides(triangles, labels) == 0
    part = rng.random(len(triangles)) < 0.5
    if part.any() and not part.all():
        first, other = (int(sum_open_sides(triangles[which], labels)) for which in (part, ~part))
        assert first != 0
        assert (first + other) % 2**64 == 0
    turned = triangles.copy()
    turned[0] = turned[0, ::-1]
    assert sum_open_sides(turned, labels) != 0


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


@pytest.mark.parametrize("kind", ["cell", "walls"])
def test_surfaces_of_whole_pieces_join_cut_ones_without_sides(kind: str, request: pytest.FixtureRequest) -> None:
    pieces = request.getfixturevalue(kind)
    body = box_mesh(LOW - 1.3 * CELL, LOW + 3.4 * CELL)
    choice = choose_pieces(pieces.cell, pieces.low, pieces.high, body)
    all_cut = PieceChoice(choice.origin, choice.whole & False, choice.cut | choice.whole)
    one, other = fill_mesh(pieces, choice, body), fill_mesh(pieces, all_cut, body)
    assert one.volume == pytest.approx(other.volume, rel=1e-12)
    assert one.area == pytest.approx(other.area, rel=1e-12)
