"""Cores of sandwich panels: cells along an axis, as fields."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.catalogue import CORES
from tpmscad.errors import InvalidRequest
from tpmscad.fields.analysis.exact_leaves import CoreLeaf, find_exact
from tpmscad.fields.field import Field

CELL, THICKNESS = 3.0, 0.4
POINTS = np.random.default_rng(5).uniform(-7, 7, (4000, 3))

FRACTIONS = {
    "honeycomb": 1 - (1 - THICKNESS / CELL) ** 2,
    "square": 1 - (1 - THICKNESS / CELL) ** 2,
    "triangular": 1 - (1 - math.sqrt(3) * THICKNESS / CELL) ** 2,
}


def measure_walls(structure: str, points: np.ndarray) -> np.ndarray:
    """Distance of points (n, 2) from the middles of the walls, drawn as line segments of many cells."""
    slanted = CELL / (2 * math.cos(math.radians(30)))
    ends: list[tuple[complex, complex]] = []
    numbers = [(i, j) for i in range(-9, 10) for j in range(-9, 10)]
    if structure == "square":
        ends = [(complex(i - 0.5, j) * CELL, complex(i - 0.5, j + 1) * CELL) for i, j in numbers]
        ends += [(complex(i, j - 0.5) * CELL, complex(i + 1, j - 0.5) * CELL) for i, j in numbers]
    if structure == "honeycomb":
        corner = [CELL / math.sqrt(3) * np.exp(1j * math.radians(30 + 60 * k)) for k in range(7)]
        middles = [complex(i + j / 2, j * math.sqrt(0.75)) * CELL for i, j in numbers]
        ends = [(m + a, m + b) for m in middles for a, b in zip(corner, corner[1:], strict=False)]
    if structure == "triangular":
        first = CELL / math.sqrt(3) * 1j  # a corner of the triangle about the origin
        nodes = [first + complex(i + j / 2, j * math.sqrt(0.75)) * CELL for i, j in numbers]
        ends = [(n, n + CELL * np.exp(1j * math.radians(turn))) for n in nodes for turn in (0, 60, 120)]
    if structure == "re-entrant":
        height = 1.5 * slanted  # of a row, whose upright walls are twice as long as the slanted ones
        for i, j in numbers:
            foot = complex((i + 0.5 + j / 2) * CELL, j * height - slanted)
            ends.append((foot, foot + 2j * slanted))
            top = foot + 2j * slanted
            ends += [(top, top + slanted * np.exp(1j * math.radians(turn))) for turn in (-30, 210)]
    start, stop = np.array(ends).T
    p = (points[:, 0] + 1j * points[:, 1])[:, None]
    t = np.clip(((p - start) / (stop - start)).real, 0, 1)
    return np.asarray(np.abs(p - start - t * (stop - start)).min(axis=1))


@pytest.mark.parametrize("structure", CORES)
def test_walls_are_as_thick_as_asked_about_their_middles(structure: str) -> None:
    field = fields.core(structure, CELL, THICKNESS)
    distance, value = measure_walls(structure, POINTS[:, :2]) - THICKNESS / 2, field(POINTS)
    assert (value[distance < 0] < 1e-12).all()
    if (
        structure == "re-entrant"
    ):  # planes are continued beyond corners that stand out, by less than half the thickness here
        assert (value[distance > THICKNESS / 2] > 0).all()
    else:
        np.testing.assert_allclose(value[distance > 0], distance[distance > 0], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(field.gradient(POINTS), axis=1), 1.0)


@pytest.mark.parametrize("structure", FRACTIONS)
def test_the_solid_fraction_is_that_of_the_closed_form(structure: str) -> None:
    axis = (1.0, 2.0, -0.5)
    field = fields.core(structure, CELL, THICKNESS, axis)
    points = np.random.default_rng(1).uniform(-40, 40, (400_000, 3))
    share = float((field(points) < 0).mean())
    assert share == pytest.approx(FRACTIONS[structure], abs=4e-3)
    along = np.array(axis) / np.linalg.norm(axis)
    np.testing.assert_allclose(field(POINTS + 2.7 * along), field(POINTS), atol=1e-12)


def test_periods_are_those_of_the_rectangle_that_repeats() -> None:
    for axis in "xyz":
        field = fields.core("re-entrant", CELL, THICKNESS, axis)
        periods = field.periods()
        assert periods is not None
        for k, period in enumerate(periods):
            np.testing.assert_allclose(field(POINTS + period * np.eye(3)[k]), field(POINTS), atol=1e-12)
    assert fields.core("honeycomb", CELL, THICKNESS, (1, 1, 0)).periods() is None


@pytest.mark.parametrize(
    "field",
    [
        fields.complement(fields.translate(fields.core("triangular", CELL, THICKNESS, "x"), (0.3, 1, -2))),
        fields.scale(fields.rotate(fields.core("re-entrant", CELL, THICKNESS), (1, 2, 3), 40), 0.7) - 0.05,
    ],
    ids=["moved complement", "turned, scaled and thickened"],
)
def test_cores_that_are_moved_reversed_and_offset_are_cores(field: Field) -> None:
    found = find_exact(field)
    assert isinstance(found, CoreLeaf)
    np.testing.assert_array_equal(field(POINTS) < 0, found.sign * found.core(POINTS) < 0)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (("honeycomb", 3.0, 3.0), "make it less than 3"),
        (("triangular", 3.0, 2.0), "make it less than 1.732"),
        (("re-entrant", 3.0, 1.6), "make it less than 1.5"),
        (("kagome", 3.0, 0.1), "choose one of 'honeycomb', 'square'"),
    ],
)
def test_walls_that_fill_the_cells_are_refused(arguments: Any, what: str) -> None:
    with pytest.raises(InvalidRequest, match=what):
        fields.core(*arguments)
