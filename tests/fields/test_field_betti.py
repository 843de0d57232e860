"""Betti numbers of fields whose necks are far thinner than any grid that is tried."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields, topology
from tpmscad.fields.analysis import betti_numbers, saddles
from tpmscad.fields.analysis.betti_numbers import INITIAL_LINES, compute_betti_numbers, count_tunnels_near_surface
from tpmscad.fields.data.sample_grid import SampleGrid

LO, HI = np.array([-1.9, -1.45, -1.3]), np.array([1.93, 1.38, 1.51])


def ovals(half: float, sign: float) -> fields.Field:
    """Cassini ovals turned about x, with a neck (or, half < 0, a gap) of that half width at the origin; solid or void."""
    level = np.sign(half) * 2 * half**2

    def value(x: np.ndarray) -> np.ndarray:
        square = (x * x).sum(axis=-1)
        along = 2 * x[..., 0] ** 2 - square
        return sign * (square**2 - 2 * along - level)

    return fields.as_field(value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "sign", "expected"),
    [(1, 1, (1, 0, 0)), (-1, 1, (2, 0, 0)), (1, -1, (1, 0, 1)), (-1, -1, (1, 0, 2))],
    ids=["strut", "gap", "channel", "wall"],
)
def test_necks_thinner_than_the_grids_spacing_are_seen(way: int, sign: int, expected: tuple[int, int, int]) -> None:
    assert compute_betti_numbers(ovals(way * 1e-3, sign), LO, HI) == expected


def test_plain_grids_do_not_see_them() -> None:
    axes = [np.linspace(a, b, INITIAL_LINES) for a, b in zip(LO, HI, strict=True)]
    seen = {topology.betti(ovals(way * 1e-3, 1).on_grid(*axes)).b0 for way in (1, -1)}
    assert len(seen) == 1


BALL, FAR = fields.sphere((0.1, 0.0, 0.1), 1.0), fields.sphere((-1.4, -1.0, -0.9), 0.3)


@pytest.mark.parametrize(
    ("field", "expected"),
    [
        (fields.sheet(BALL, -0.01, 0.01), (1, 0, 1)),
        (BALL & -fields.sphere((0.1, 0.0, 0.1), 0.7), (1, 0, 1)),
        (-BALL & -FAR, (1, 0, 2)),
        (BALL | FAR, (2, 0, 0)),
    ],
    ids=["sheet", "hollow ball", "two hollows", "two balls"],
)
@pytest.mark.slow
def test_minima_and_maxima_are_counted_by_their_operands(field: fields.Field, expected: tuple[int, int, int]) -> None:
    assert compute_betti_numbers(field, LO, HI) == expected


UNIT_CUBE = np.zeros(3), np.ones(3)
SADDLE_IN_FACE = "(y - 0.4812)^2 - (z - 0.5317)^2"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        (f"{SADDLE_IN_FACE} + 1e-6 + 0.3*x", (2, 0, 0)),
        (f"{SADDLE_IN_FACE} - 1e-6 + 0.3*x", (1, 0, 0)),
        (f"{SADDLE_IN_FACE} + 1e-6 + 0.3*(1 - x)", (2, 0, 0)),
        ("(z - 0.5317)^2 - 1e-7 + 0.3*(x + y)", (1, 0, 0)),
        ("(x - 0.4411)^2 + (y - 0.4812)^2 + (z - 0.5317)^2 - 1e-7", (1, 0, 0)),
        ("1e-7 - (x - 0.4411)^2 - (y - 0.4812)^2 - (z - 0.5317)^2", (1, 0, 1)),
        ("sqrt((x - 0.4411)^2 + (y - 0.4812)^2 + (z - 0.5317)^2) - 3e-4", (1, 0, 0)),
        ("3e-4 - sqrt((x - 0.4411)^2 + (y - 0.4812)^2 + (z - 0.5317)^2)", (1, 0, 1)),
        ("sqrt((x - 0.4411)^2 + y^2 + z^2) - 3e-4", (1, 0, 0)),
    ],
    ids=[
        *("gap", "neck", "gap in the other face", "speck on an edge", "speck", "pore"),
        *("speck of a distance", "pore of a distance", "speck of a distance on an edge"),
    ],
)
def test_what_is_narrow_is_seen_in_faces_and_edges_of_the_box_and_where_a_field_has_a_kink(
    formula: str, expected: tuple[int, int, int]
) -> None:
    assert compute_betti_numbers(fields.expression(formula), *UNIT_CUBE) == expected


@pytest.mark.parametrize("value", [0.0, 1e-9, -1.0])
def test_nothing_narrow_is_sought_where_a_field_is_constant(value: float) -> None:
    grid = SampleGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (9, 9, 9))
    [narrow] = saddles.find_narrow_points([fields.constant(value)], grid, 0.1)
    assert len(narrow.points) == 0


def test_no_neck_is_sought_on_the_creases_of_a_distance_far_from_its_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    starts = []
    search = saddles._find_critical_points

    def count(field: fields.Field, points: np.ndarray, *options: object) -> np.ndarray:
        starts.append(len(points))
        return search(field, points, *options)

    monkeypatch.setattr(saddles, "_find_critical_points", count)
    grid = SampleGrid((0.0, 0.0, 0.0), (2.2, 2.2, 2.2), (25, 25, 25))
    distance = fields.normal_distance(fields.tpms("gyroid", 10.0))
    for field in (distance - 0.5, ovals(4e-3, 1)):
        saddles.find_saddles(field, grid, np.ones(grid.shape, bool), 0.75 * grid.spacing[0])
    assert starts[0] == 0 < starts[1]


@pytest.mark.slow
def test_lines_near_a_neck_are_no_denser_than_it_is_wide() -> None:
    """A neck ten times as wide has fewer lines, the closest within half of its half width, and its count is right."""
    n_lines = []
    for half in (2e-3, 2e-2):
        grid = SampleGrid(tuple(LO), tuple(HI), (49, 37, 37))
        [narrow] = saddles.find_narrow_points([ovals(half, 1)], grid, 0.75 * float(grid.spacing.min()))
        assert len(narrow.points) == 1
        assert narrow.half_widths[0] == pytest.approx(half, rel=1e-2)
        lines = betti_numbers._grade_lines(grid.axes[0], grid.spacing[0], narrow.points[:, 0], narrow.half_widths)
        near = np.sort(np.abs(lines - narrow.points[0, 0]))
        assert near[0] == 0.0
        assert near[1] <= max(half / 2, grid.spacing[0] / 64)
        n_lines.append(len(lines))
        assert compute_betti_numbers(ovals(half, 1), LO, HI) == (1, 0, 0)
    assert n_lines[1] < n_lines[0]


@pytest.mark.slow
def test_grids_without_lines_through_all_necks_count_only_where_the_count_is_confirmed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without room for more lines all grids see one piece where there are two."""
    for kind in ("", "FOREIGN_"):
        monkeypatch.setattr(f"tpmscad.fields.analysis.betti_numbers.MAX_{kind}GRADED_NODES", 1)
        monkeypatch.setattr(f"tpmscad.fields.analysis.betti_numbers.MAX_{kind}UNIFORM_NODES", 2**21)
    gap = ovals(-1e-3, 1)
    assert compute_betti_numbers(gap, LO, HI) is None
    asked = []
    assert compute_betti_numbers(gap, LO, HI, confirm=lambda betti: asked.append(betti) or False) is None
    assert compute_betti_numbers(gap, LO, HI, confirm=lambda betti: True) == asked[0]
    assert compute_betti_numbers(BALL, LO, HI) == (1, 0, 0), "a field without necks needs no more lines"


@pytest.mark.slow
def test_the_characteristic_of_a_grid_is_the_sum_of_its_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the solid reaches the box's sides, and where blocks are left out."""
    noise = np.random.default_rng(3).normal(size=(8, 7, 6))
    for field in (BALL, fields.sampled(noise, 0.5, (-1.9, -1.45, -1.3), smoothing=1)):
        cells = np.array([61, 53, 47])
        axes = [np.linspace(a, b, n + 1) for a, b, n in zip(LO, HI, cells, strict=True)]
        whole = topology.euler_characteristic(field.on_grid(*axes))
        for size in (5, 16, 48):
            monkeypatch.setattr(betti_numbers, "BLOCK_CELLS", size)
            assert betti_numbers._sum_blocks(field, LO, HI, cells) == whole


@pytest.mark.slow
def test_tunnels_that_coarse_grids_show_are_not_counted_where_finer_ones_deny_them() -> None:
    """A tilted lens, .1 thick in its middle: its rim falls apart on grids of .04."""
    lens = fields.expression("x^2 + y^2 + ((z - 0.31*x - 0.17*y)/0.05)^2 - 1")
    axes = [np.linspace(a, b, INITIAL_LINES) for a, b in zip(LO, HI, strict=True)]
    seen = topology.betti(lens.on_grid(*axes))
    assert (seen.b0, seen.b1) != (1, 0)
    assert count_tunnels_near_surface(lens, LO, HI, (1, 7, 0), (1, 0, 0).__eq__) == (1, 0, 0)
    assert count_tunnels_near_surface(lens, LO, HI, (1, 7, 0), (1, 2, 0).__eq__) is None
