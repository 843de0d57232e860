"""The network of creases: closed forms, polyhedra, hidden loops, tangencies, and what cannot be proved."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import HalfspaceIntersection
from scipy.special import ellipe

from benchmarks.hidden_creases import LENGTH_RTOL, draw_hidden_ball, measure_hidden
from tpmscad import fields
from tpmscad.fields.analysis import crease_cells, crease_network
from tpmscad.fields.analysis.crease_network import BOX, CORNER, UNRESOLVED, CreaseNetwork, count_curves, trace_creases
from tpmscad.fields.analysis.crease_pieces import SIDE_TOL
from tpmscad.fields.analysis.outermost_extremes import expose_extremes, list_leaves
from tpmscad.fields.field import Field


def trace(field: Field, size: float = 2.0) -> CreaseNetwork:
    return trace_creases(field, np.full(3, -size), np.full(3, size))


def count_ends(network: CreaseNetwork, name: str) -> int:
    return sum(arc.ends.count(name) for arc in network.arcs)


def assert_on_leaves(field: Field, network: CreaseNetwork) -> None:
    """The points of arcs and corners lie on their leaves."""
    leaves = list_leaves(expose_extremes(field))
    for arc in network.arcs:
        assert max(np.abs(leaves[k](arc.points)).max() for k in arc.leaves) < 1e-11
    for corner in network.corners:
        assert max(abs(float(leaves[k](corner.point))) for k in corner.leaves) < 1e-9


@pytest.mark.parametrize("apart", [1.9, 1.0, 0.2, 0.02])
def test_two_balls_meet_in_a_circle(apart: float) -> None:
    direction = np.array([1.0, 0.3, -0.2]) / np.linalg.norm([1.0, 0.3, -0.2])
    field = fields.sphere(tuple(apart / 2 * direction), 1.0) | fields.sphere(tuple(-apart / 2 * direction), 1.0)
    network = trace(field)
    assert network.is_proved
    assert [arc.is_closed for arc in network.arcs] == [True]
    assert network.length == pytest.approx(2 * np.pi * np.sqrt(1 - apart**2 / 4), rel=1e-9)
    np.testing.assert_allclose(network.arcs[0].points[0], network.arcs[0].points[-1], atol=1e-10)
    assert_on_leaves(field, network)


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 10**6), st.integers(4, 9))
def test_creases_of_convex_polyhedra_are_their_edges_and_vertices(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = rng.uniform(0.5, 1.2, count)
    spaces = [fields.halfspace(tuple(d * n), tuple(n)) for n, d in zip(normals, offsets, strict=True)]
    network = trace(fields.intersection(*spaces))
    box = np.concatenate([np.eye(3), -np.eye(3)])
    sides = np.full(6, 2.0 + 4.0 * SIDE_TOL)  # the box that is searched, a billionth wider, for creases in its sides
    rows = np.hstack([np.concatenate([normals, box]), -np.concatenate([offsets, sides])[:, None]])
    vertices = HalfspaceIntersection(rows, np.zeros(3)).intersections
    on = np.abs(vertices @ rows[:, :3].T + rows[:, 3]) < 1e-9  # the planes through each vertex
    length, edges = 0.0, 0
    for i in range(count):
        for j in range(i):
            ends = vertices[on[:, i] & on[:, j]]
            if len(ends) == 2:
                edges, length = edges + 1, length + float(np.linalg.norm(ends[0] - ends[1]))
    assert network.is_proved
    assert len(network.arcs) == edges
    assert network.length == pytest.approx(length, rel=1e-8)
    assert len(network.corners) == (on[:, :count].sum(axis=1) == 3).sum()


def test_planes_along_the_axes_and_through_each_other() -> None:
    drilled = fields.box((-1, -1, -1), (1.5, 1.5, 1.5)) & ~fields.cylinder((0.2, 0.1, 0), 0.6, "z")
    network = trace(drilled)
    assert network.is_proved
    assert (len(network.arcs), len(network.corners), sum(arc.is_closed for arc in network.arcs)) == (14, 8, 2)
    assert network.length == pytest.approx(12 * 2.5 + 2 * 2 * np.pi * 0.6, rel=1e-9)
    stacked = fields.box((-1, -1, -1), (1, 1, 0)) | fields.box((0, 0, 0), (1.5, 1.5, 1.5))
    assert trace(stacked).is_proved


def test_four_cylinders_through_a_point_have_corners_of_four_fields() -> None:
    axes = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]
    field = fields.union(*[fields.cylinder((0, 0, 0), 0.5, axis) for axis in axes])
    network = trace(field)
    assert network.is_proved
    assert (len(network.arcs), count_ends(network, CORNER)) == (12, 24)
    assert [corner.leaves for corner in network.corners] == [(0, 1, 2, 3)] * 6
    found = np.sort(np.abs([corner.point for corner in network.corners]), axis=1)
    np.testing.assert_allclose(found, [[0, 0, 0.5 * np.sqrt(1.5)]] * 6, atol=1e-9)
    assert_on_leaves(field, network)


def test_cylinders_that_touch_while_crossing_are_unresolved_there_and_nowhere_else() -> None:
    network = trace(fields.cylinder((0, 0, 0), 0.5, "x") | fields.cylinder((0, 0, 0), 0.5, "y"))
    assert not network.is_proved
    assert (len(network.arcs), count_ends(network, UNRESOLVED)) == (4, 8)
    middles = 0.5 * (network.unresolved.lo + network.unresolved.hi)
    assert (np.linalg.norm(np.abs(middles) - [0, 0, 0.5], axis=1) < 1e-4).all()
    assert (network.unresolved.hi - network.unresolved.lo).max() < 1e-5
    # two ellipses of half-axes r and r sqrt(2)
    assert network.length == pytest.approx(2 * 4 * 0.5 * np.sqrt(2) * ellipe(0.5), rel=1e-4)


@pytest.mark.slow
def test_complements_and_scaled_leaves_have_the_same_creases() -> None:
    sheet, rod = fields.sheet(fields.tpms("gyroid", 4.0), -0.4, 0.4), fields.rod(fields.tpms("schwarz_p", 4.0), -0.3)
    first = trace(sheet & ~rod)
    for other in (~(sheet & ~rod), 3.0 * (~sheet | rod), (sheet & ~rod) & sheet):
        again = trace(other)
        assert again.is_proved
        assert len(again.arcs) == len(first.arcs)
        assert again.length == pytest.approx(first.length, rel=1e-9)
    assert first.is_proved
    assert count_ends(first, BOX) == 2 * sum(not arc.is_closed for arc in first.arcs) > 0


@pytest.mark.parametrize("deep", [0.1, 0.5, 0.99])
def test_a_ball_that_just_reaches_an_edge_cuts_it(deep: float) -> None:
    radius = 0.02
    edge = fields.halfspace((0, 0, 0), (1, 0, 2)) & fields.halfspace((0, 0, 0), (-2, 0, -1))
    inwards = np.array([1.0, 0.0, -1.0]) / np.sqrt(2)  # the wedge's bisector
    center = np.array([0, 0.31, 0]) + (1 - deep) * radius * inwards
    network = trace(edge & ~fields.sphere(tuple(center), radius))
    chord = 2 * radius * np.sqrt(1 - (1 - deep) ** 2)
    straight = [arc for arc in network.arcs if arc.leaves == (0, 1)]
    assert network.is_proved
    assert (len(straight), len(network.corners), len(network.arcs)) == (2, 2, 4)
    assert sum(arc.length for arc in straight) == pytest.approx(4.0 - chord, rel=1e-7)


@pytest.mark.parametrize("case", [0, 2, 5, 7])
@pytest.mark.slow
def test_a_loop_hidden_between_samples_is_found(case: int) -> None:
    rng, hidden = np.random.default_rng([11, case]), None
    while hidden is None:
        hidden = draw_hidden_ball(rng, 1 + case % 3)
    loops, length = measure_hidden(hidden, trace_creases(hidden.field, np.zeros(3), np.full(3, 10.0)))
    assert loops == 1
    assert abs(length / hidden.circle - 1) < LENGTH_RTOL


def test_creases_of_functions_without_bounds_are_not_claimed() -> None:
    foreign = fields.from_function(lambda x, y, z: x + 0.1 * y - z)
    network = trace(foreign & fields.sphere((0, 0, 0), 1.0))
    assert not network.is_proved
    assert not network.is_enclosed
    assert len(network.unresolved.lo)


def test_a_search_without_end_is_given_up_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    field = fields.sphere((0, 0, 0), 1.0) & fields.sphere((1, 0, 0), 1.0)
    monkeypatch.setattr(crease_cells, "MAX_CELLS", 600)
    found = trace_creases(field, np.full(3, -2.0), np.full(3, 2.0))
    assert not found.is_proved
    assert 600 < found.cells_tested < 5000


@pytest.mark.slow
def test_surfaces_that_coincide_are_told() -> None:
    twisted = fields.halfspace((0, 0, 0.1), "z") & (fields.expression("(0.1 - z)*(1 + 0.1*x)"))
    network = trace(twisted)
    assert not network.is_proved
    np.testing.assert_allclose(0.5 * (network.unresolved.lo + network.unresolved.hi)[:, 2], 0.1, atol=0.1)


def test_curves_pass_where_two_edges_meet_and_end_elsewhere() -> None:
    loop, path, fork = [[0, 1], [1, 2], [2, 0]], [[3, 4], [4, 5]], [[5, 6], [5, 7]]
    assert count_curves(np.array(loop)) == 1
    assert count_curves(np.array(path)) == 1
    assert count_curves(np.array(loop + path)) == 2
    assert count_curves(np.array(loop + path + fork)) == 4
    assert count_curves(np.array([[8, 8]])) == 1
    assert count_curves(np.zeros((0, 2), int)) == 0
    pins = fields.sphere((0, 0, 0), 1.0) & fields.halfspace((0, 0, 0.3), "z") & fields.halfspace((0.2, 0, 0), "x")
    assert trace(pins).n_curves == 3


def test_a_tree_without_creases_has_none() -> None:
    network = trace(fields.sheet(fields.tpms("gyroid", 3.0), -0.3, 0.3))
    assert network.is_proved
    assert not network.arcs
    assert trace(fields.sphere((0, 0, 0), 1.0)).is_proved


def test_a_grid_whose_pieces_do_not_join_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """A crease that runs in the sides of cells belongs to four of them."""
    field = fields.halfspace((0, 0, 0), "x") & fields.halfspace((0, 0, 0), "y")
    monkeypatch.setattr(crease_network, "GRID_SHIFTS", np.zeros((1, 3)))
    assert not trace(field).is_proved
    monkeypatch.setattr(crease_network, "GRID_SHIFTS", np.array([[0.0, 0.0, 0.0], [0.3, 0.4, 0.2]]))
    network = trace(field)
    assert network.is_proved
    assert network.length == pytest.approx(4.0, rel=1e-7)


def test_points_of_arcs_follow_each_other() -> None:
    network = trace(fields.sphere((0.3, 0, 0), 1.2) & ~fields.cylinder((0, 0, 0), 0.7, (1, 1, 0.3)))
    assert network.is_proved
    gaps = np.concatenate([np.linalg.norm(np.diff(arc.points, axis=0), axis=1) for arc in network.arcs])
    assert gaps.sum() == pytest.approx(network.length, rel=2e-3)
    assert gaps.sum() <= network.length
    assert gaps.max() < 0.2
