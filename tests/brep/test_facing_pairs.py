"""Bounds of pairs of cells: no pair that holds places which face each other is dropped, and no bound is above their distance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tpmscad._typing import Array
from tpmscad.brep.cell_bounds import bound_nets, bound_normals, chords_meet_boxes, find_longer_directions, halve_nets
from tpmscad.brep.facing_pairs import MAX_TAPER, CellBounds, select_facing
from tpmscad.brep.patch_pairs import unit_vectors
from tpmscad.brep.surface_cells import _CONE_ROWS, evaluate_cells


def random_net(rng: np.random.Generator, size: float) -> Array:
    """A bent patch (4, 4, 3) over a square of this size, outwards is up."""
    grid = np.stack(np.meshgrid(*2 * [np.linspace(0, size, 4)], indexing="ij"), axis=-1)
    bend = 10.0 ** rng.uniform(-5.0, -0.5)
    return np.concatenate([grid, bend * size * rng.random((4, 4, 1))], axis=2)


def normal_at(net: Array, st: Array) -> tuple[Array, Array]:
    """Point and unit normal (3,) at parameters (2,)."""
    point, du, dv = evaluate_cells(net[None], st[None])
    return point[0], unit_vectors(np.cross(du, dv))[0]


def bounds_of(nets: Array) -> CellBounds:
    """The two cells, of one solid; sharp edges may end their sides."""
    n = len(nets)
    center, radius, axis, angle = np.empty((n, 3)), np.empty(n), np.empty((n, 3)), np.empty(n)
    bound_nets(nets, center, radius)
    bound_normals(nets, np.ones(n), *_CONE_ROWS, axis, angle)
    zeros = np.zeros(n, np.int64)
    keys, more = np.array([[7]]), np.array([False])
    return CellBounds(nets, np.zeros(n), center, radius, axis, angle, zeros, zeros, zeros, keys, more)


@pytest.mark.slow
@pytest.mark.parametrize("through", [-1.0, 1.0])
def test_a_pair_with_places_that_face_each_other_is_kept_and_its_bound_holds(through: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(2000):
        distance = 10.0 ** rng.uniform(-2, 1)
        one, two = (random_net(rng, 10.0 ** rng.uniform(-2, 0.3)) for _ in range(2))
        place, other = rng.random((2, 2))
        p, n = normal_at(one, place)
        q, m = normal_at(two, other)
        taper = Rotation.from_rotvec(MAX_TAPER * rng.random() * unit_vectors(np.cross(n, rng.normal(size=3))[None])[0])
        facing = taper.apply(-n)
        turn = Rotation.from_rotvec(rng.uniform(0, 2 * np.pi) * facing) * Rotation.align_vectors(facing, m)[0]
        nets = np.stack([one, turn.apply((two - q).reshape(-1, 3)).reshape(4, 4, 3) + p + through * distance * n])
        pairs, low = np.empty((1, 2), np.int64), np.empty(1)
        parents, first = np.array([[0, 1]]), np.arange(3)
        found = select_facing(bounds_of(nets), parents, first, 1.001 * distance, through, 10, pairs, low)
        assert found == 1
        assert low[0] <= distance * (1 + 1e-9)


def test_balls_and_cones_hold_the_poles_and_the_normals_of_a_cell() -> None:
    rng = np.random.default_rng(2)
    nets = np.stack([random_net(rng, 1.0) for _ in range(200)])
    cells = bounds_of(nets)
    assert (np.linalg.norm(nets - cells.center[:, None, None], axis=-1).max(axis=(1, 2)) <= cells.radius + 1e-12).all()
    for st in rng.random((50, 2)):
        _, du, dv = evaluate_cells(nets, np.tile(st, (len(nets), 1)))
        cosine = (unit_vectors(np.cross(du, dv)) * cells.axis).sum(axis=1)
        assert (np.arccos(np.clip(cosine, -1, 1)) <= cells.angle).all()


def test_halves_of_a_patch_are_the_patch_on_halves_of_its_parameters() -> None:
    rng = np.random.default_rng(3)
    nets, at = np.stack([random_net(rng, 1.0), random_net(rng, 1.0) * [0.5, 2.0, 1.0]]), rng.random((4, 2))
    axis = np.empty(2, np.int64)
    find_longer_directions(nets, axis)
    assert axis[1] == 1
    parent, half, halves = np.array([0, 0, 1, 1]), np.array([0, 1, 0, -1]), np.empty((4, 4, 4, 3))
    halve_nets(nets, parent, half, axis, halves)
    inside = at.copy()
    for k in range(3):
        inside[k, axis[parent[k]]] = 0.5 * (at[k, axis[parent[k]]] + half[k])
    np.testing.assert_allclose(evaluate_cells(halves, at)[0], evaluate_cells(nets[parent], inside)[0], atol=1e-14)


def test_a_chord_meets_a_rectangle_where_points_of_it_lie_inside() -> None:
    rng = np.random.default_rng(4)
    chords, slack = rng.random((2000, 2, 2)), 0.1 * rng.random((2000, 2))
    chords[:200, 1, 0] = chords[:200, 0, 0]  # level in u
    box = np.sort(rng.random((2000, 2, 2)), axis=2)
    points = chords[:, :1] + np.linspace(0, 1, 2001)[:, None] * (chords[:, 1:] - chords[:, :1])
    inside = (
        ((points > (box[:, :, 0] - slack)[:, None]) & (points < (box[:, :, 1] + slack)[:, None]))
        .all(axis=2)
        .any(axis=1)
    )
    meets = chords_meet_boxes(chords, slack, box)
    assert meets[inside].all()
    assert (meets & ~inside).mean() < 0.002  # touched between samples
