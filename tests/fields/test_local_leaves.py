"""Trees of many solids, asked cell by cell: decisions of the octree against the field itself, volumes against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.fields.analysis.local_leaves import (
    LocalLeaves,
    find_meeting_leaves,
    halve_cells,
    has_slope_bounds,
    keeps_sign,
    locate_leaves,
)
from tpmscad.fields.analysis.local_measures import measure_locally
from tpmscad.fields.analysis.slope_bounds import bound_slope
from tpmscad.fields.field import Field

LO, HI = np.array([-1.0, 0.0, 0.5]), np.array([3.0, 5.0, 3.5])
COUNTS = np.array([4, 5, 3])
BALL = 4 / 3 * np.pi


def build_tree(seed: int, depth: int = 4) -> Field:
    """A random tree of balls, struts, half-spaces, scaled, moved and complemented."""
    rng = np.random.default_rng(seed)

    def leaf() -> Field:
        point, axis = rng.uniform(LO, HI), rng.normal(size=3)
        kinds = (fields.sphere(point, rng.uniform(0.5, 2)), fields.cylinder(point, rng.uniform(0.2, 0.8), axis))
        return [*kinds, 3 * fields.halfspace(point, axis)][rng.integers(3)]

    def node(depth: int) -> Field:
        parts = [node(depth - 1) if depth and rng.random() < 0.7 else leaf() for _ in range(rng.integers(2, 4))]
        found = [fields.union, fields.intersection][rng.integers(2)](*parts)
        return ~found if rng.random() < 0.3 else found

    return node(depth)


def locate(field: Field, halvings: int = 2) -> LocalLeaves:
    local = locate_leaves(field, LO, HI, COUNTS)
    for _ in range(halvings):
        local = halve_cells(local)
    return local


PLUGGED = (fields.sphere((1, 2, 2), 1.5) & ~fields.sphere((1, 2, 2), 0.5)) | fields.sphere((1, 2, 2), 0.8)
"""A ball with a cavity, which another ball fills: no leaf but the first bounds the solid."""

WAVES = build_tree(0, 2) | (fields.tpms("gyroid", 2.0) & build_tree(1, 2))
UNBOUNDED = build_tree(0, 2) | (fields.expression("x*y - z") & build_tree(1, 2))


@pytest.mark.parametrize("field", [*(build_tree(seed) for seed in range(12)), PLUGGED, WAVES, UNBOUNDED])
def test_decisions_of_cells_are_those_of_the_field_everywhere(field: Field) -> None:
    local = locate(field)
    centres = [low + (np.arange(n) + 0.5) * s for low, n, s in zip(LO, local.counts, local.size, strict=True)]
    assert (local.on_grid() == (field.on_grid(*centres) < 0)).all()
    offsets = np.random.default_rng(7).random((len(local.cells), 3, 3))
    points = local.lo + (local.cells[:, None] + offsets) * local.size
    assert (local.is_solid(offsets) == (field(points) < 0)).all()
    # no surface passes a cell that is decided: all its points are as its centre
    at = LO + np.random.default_rng(8).random((20_000, 3)) * (HI - LO)
    cell = np.minimum((at - LO) // local.size, local.counts - 1).astype(int)
    undecided = np.zeros(local.counts, bool)
    undecided[tuple(local.cells.T)] = True
    decided = ~undecided[tuple(cell.T)]
    assert (local.on_grid()[tuple(cell.T)] == (field(at) < 0))[decided].all()


def test_few_of_many_leaves_matter_in_a_cell() -> None:
    struts = fields.union(*(fields.cylinder((0, y, z), 0.05, "x") for y in range(6) for z in (1, 2, 3)))
    local = locate(struts, 3)
    assert len(local.cells) > 0
    assert max(np.bincount(np.concatenate(local.members))) == 1
    assert sum(map(len, locate(PLUGGED, 4).members[1:])) == 0


BOUNDED = (
    build_tree(3),
    2 * fields.box((0, 0, 0), (1, 2, 3)) - 1,
    fields.constant(2.0),
    *(fields.tpms(name, (2.0, 3.0, 5.0)) for name in fields.TPMS),
    fields.expression("sin(2*x)*cos(y)^3 - 0.3*sin(x + z)"),
    fields.tpms("gyroid", 3.0) - fields.ramp("x", (0.0, 0.5), (0.0, 2.0)),
    fields.expression("x*y"),
    fields.expression("exp(sin(x))"),
)

BOX = np.full(3, -3.0), np.full(3, 3.0)


@pytest.mark.parametrize("field", BOUNDED)
def test_no_gradient_exceeds_its_bound_and_none_is_far_below(field: Field) -> None:
    points = np.random.default_rng(0).uniform(-3, 3, (2000, 3))
    for each in (field, fields.translate(field, (1, 2, 3)), fields.rotate(field, "z", 30.0), -0.5 * field):
        gradient = np.linalg.norm(each.gradient(points), axis=1)
        assert gradient.max() <= bound_slope(each, *BOX) * (1 + 1e-12)
        assert bound_slope(each, *BOX) <= 6 * gradient.max()
    assert has_slope_bounds(field, *BOX)


def test_fields_without_a_bound_have_none() -> None:
    for each in (
        fields.from_function(lambda x, y, z: x),
        fields.expression("sqrt(x + 3)"),
        fields.sphere((0, 0, 0), 1.0) * fields.tpms("gyroid", 1.0),
    ):
        assert bound_slope(each, *BOX) == np.inf
        assert not has_slope_bounds(fields.sphere((0, 0, 0), 1.0) | each, *BOX)


@pytest.mark.parametrize("gap", [0.3, 0.8, 1.37])
def test_volumes_are_within_their_stated_uncertainty(gap: float) -> None:
    pair = fields.sphere((1 - gap / 2, 2.1, 2), 1.0) | fields.sphere((1 + gap / 2, 2.1, 2), 1.0)
    lens = np.pi * (4 + gap) * (2 - gap) ** 2 / 12
    found = measure_locally(pair, LO, HI, (1, 0, 0).__eq__)
    assert abs(found.volume - (2 * BALL - lens)) <= found.uncertainty <= 3e-4 * found.volume
    whole = measure_locally(~pair, LO, HI, (1, 0, 1).__eq__)
    assert whole.betti == (1, 0, 1)
    assert abs(whole.volume + found.volume - 60) <= whole.uncertainty + found.uncertainty


@pytest.mark.slow
def test_a_ring_of_struts_has_a_tunnel_whatever_else_was_counted() -> None:
    sides = [
        fields.cylinder((1 + x, 2 + y, 2), 0.3, axis, 2.6)
        for x, y, axis in ((1, 0, "y"), (-1, 0, "y"), (0, 1, "x"), (0, -1, "x"))
    ]
    assert measure_locally(fields.union(*sides), LO, HI, (1, 0, 0).__eq__).betti == (1, 1, 0)


def test_leaves_meet_where_both_bound_the_solid() -> None:
    pair = fields.sphere((0.6, 2, 2), 1.0) | fields.sphere((1.4, 2, 2), 1.0)
    at = find_meeting_leaves(pair, LO, HI, 0.01, (True, True))
    assert at is not None
    assert np.hypot(at[0] - 1, np.hypot(at[1] - 2, at[2] - 2) - np.sqrt(1 - 0.16)) < 0.03
    assert find_meeting_leaves(pair, LO, HI, 0.01, (False, False)) is None
    apart = fields.sphere((0, 2, 2), 0.9) | fields.sphere((2, 2, 2), 1.0)
    assert find_meeting_leaves(apart, LO, HI, 0.02, (True, True)) is None
    assert find_meeting_leaves(apart, LO, HI, 0.3, (True, False)) is not None
    assert find_meeting_leaves(PLUGGED, LO, HI, 0.02, (True, True, True)) is None


def test_a_leaf_without_a_surface_in_the_box_keeps_its_sign() -> None:
    assert keeps_sign(fields.sphere((1, 2, 2), 9.0), LO, HI)
    assert keeps_sign(fields.cylinder((1, 9, 2), 1.0, "x"), LO, HI)
    assert not keeps_sign(fields.cylinder((1, 5, 2), 1.0, "x"), LO, HI)
    assert not keeps_sign(fields.from_function(lambda x, y, z: x + 9.0), LO, HI)
