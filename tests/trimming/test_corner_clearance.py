"""A lattice whose patches would leave slivers at a body is moved within the tolerance, told, and leaves none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.shapes.misfits import volume
from tests.trimming.network_operands import trim
from tpmscad.brep.boundary_representation import Brep
from tpmscad.trimming.operands.polyhedra import box

CLEARANCE, MAX_SHIFT = 0.02, 0.05

pytestmark = pytest.mark.slow


def shortest_edge(brep: Brep) -> float:
    ends = brep.vertices[brep.edges.end] - brep.vertices[brep.edges.start]
    return float(np.linalg.norm(ends, axis=1).min())


@pytest.fixture(scope="module")
def grazed(cover: Callable[..., Brep]) -> tuple[Brep, Brep]:
    """A lattice and a box with a face 3 um behind a corner of a patch."""
    lattice = cover("gyroid", (1, 1, 1), (0.02, 0.03, 0.05), (None, 0.05))
    middle = np.array([5.0, 5.0, 5.0])
    corner = lattice.vertices[np.argmin(np.linalg.norm(lattice.vertices - middle, axis=1))]
    low = np.array([corner[0] - 0.003, 2.1, 1.7])
    return lattice, box(low, low + np.array([4.1, 4.3, 5.2]))


def test_a_corner_that_just_crosses_a_face_is_moved_off_it_within_the_limit(grazed: tuple[Brep, Brep]) -> None:
    standing = trim(*grazed)
    assert standing.report.shifted == 0.0
    assert shortest_edge(standing.brep) < 0.01
    moved = trim(*grazed, clearance=CLEARANCE, max_shift=MAX_SHIFT)
    assert 0.0 < moved.report.shifted <= MAX_SHIFT
    assert "0.003" in moved.report.reason
    assert shortest_edge(moved.brep) > 2.0 * shortest_edge(standing.brep)
    volumes = [volume(found.brep) for found in (standing, moved)]
    assert volumes[0] == pytest.approx(volumes[1], abs=MAX_SHIFT * 60.0)


def test_a_lattice_that_is_clear_stays(grazed: tuple[Brep, Brep]) -> None:
    found = trim(*grazed, clearance=0.002, max_shift=MAX_SHIFT)
    assert found.report.shifted == 0.0


def test_a_tolerance_beyond_all_measure_moves_no_farther_than_clearance_asks(grazed: tuple[Brep, Brep]) -> None:
    moved = trim(*grazed, clearance=CLEARANCE, max_shift=1e6)
    assert 0.0 < moved.report.shifted <= 10.0 * CLEARANCE
