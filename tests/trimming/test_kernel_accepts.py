"""The kernel finds trimmed lattices valid, closed and of the same volume, and its boolean operation gives the same result."""

from __future__ import annotations

from collections.abc import Callable

import build123d as bd
import numpy as np
import pytest

from tests.shapes.misfits import volume
from tests.trimming.network_operands import trim
from tpmscad.brep.boundary_representation import Brep
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.boolean import boolean_operations
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.trimming.operands.polyhedra import box

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize(
    ("name", "layers", "phase"),
    [
        ("gyroid", (-0.05, 0.05), (0.0, 0.0, 0.0)),
        pytest.param("schwarz_p", (-0.05, 0.05), (0.125 + 1.5e-8, 0.25, 0.0), marks=pytest.mark.slow),
        pytest.param("schwarz_p", (None, 0.0), (0.125 + 1.5e-8, 0.25, 0.0), marks=pytest.mark.slow),
        pytest.param("diamond", (None, 0.0), (0.11, 0.23, 0.37), marks=pytest.mark.slow),
    ],
)
def test_a_trimmed_cell_is_a_valid_solid_of_the_same_volume(
    name: str,
    layers: tuple[float | None, float | None],
    phase: tuple[float, float, float],
    cover: Callable[..., Brep],
) -> None:
    trimmed = trim(cover(name, (1, 1, 1), phase, layers), box(np.zeros(3), np.full(3, 10.0))).brep
    found = check_shape(build_solids(trimmed).shape)
    assert found.valid
    assert found.volume == pytest.approx(volume(trimmed), rel=1e-7)


def bracket() -> bd.Shape:
    """Planes, a concave fillet and a bore, near the middle of the lattice."""
    solid = bd.Box(6, 5, 1.5) + bd.Pos(-2.25, 0, 2) * bd.Box(1.5, 5, 5) - bd.Pos(1.5, 0, 0) * bd.Cylinder(1, 9)
    inner = [e for e in solid.edges() if abs(e.center().X + 1.5) < 0.01 and abs(e.center().Z - 0.75) < 0.01]
    return bd.Pos(9.3, 10.2, 9.8) * bd.Rot(20, 35, 10) * bd.fillet(inner, 1)


@pytest.mark.slow
def test_a_lattice_cut_by_a_body_is_what_the_kernels_boolean_makes_of_it(cover: Callable[..., Brep]) -> None:
    lattice, shape = cover("gyroid", (2, 2, 2), (0.0, 0.0, 0.0), (-0.05, 0.05)), bracket()
    trimmed = trim(lattice, brep_from_shape(shape))
    assert trimmed.report.shifted == 0
    found = check_shape(build_solids(trimmed.brep).shape)
    assert found.valid
    assert found.closed
    assert found.volume == pytest.approx(volume(trimmed.brep), rel=1e-6)
    around = shape.bounding_box()
    low, high = np.array(tuple(around.min)) - 0.25, np.array(tuple(around.max)) + 0.25
    block = build_solids(trim(lattice, box(low, high)).brep).shape
    other = boolean_operations.intersect_solids(block, shape.wrapped)
    assert found.volume == pytest.approx(sum(check_shape(s).volume for s in other), rel=1e-6)
