"""The kernel finds trimmed lattices valid, closed and of the same volume, and its boolean operation gives the same result."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.trimming.operands.polyhedra import box
from tpmscad.trimming.trim_pipeline import trim

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize(
    ("name", "layers", "phase"),
    [
        *itertools.product(("gyroid", "diamond", "schwarz_p"), [(-0.05, 0.05), (None, 0.0)], [(0.11, 0.23, 0.37)]),
        pytest.param("gyroid", (-0.05, 0.05), (0.0, 0.0, 0.0), marks=pytest.mark.slow),
        pytest.param("schwarz_p", (-0.05, 0.05), (0.125 + 1.5e-8, 0.25, 0.0), marks=pytest.mark.slow),
        pytest.param("diamond", (None, 0.0), (0.125 + 1.5e-8, 0.25, 0.0), marks=pytest.mark.slow),
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
    assert found.volume == pytest.approx(
        float(integral_properties.volume(integral_properties.integrate_faces(trimmed))[0]), rel=1e-7
    )


def place(shape: object) -> object:
    import build123d as bd

    return bd.Pos(9.3, 10.2, 9.8) * bd.Rot(20, 35, 10) * shape


def body(name: str) -> object:
    """A body centred near the middle of the lattice."""
    import build123d as bd

    if name == "rounded box":
        return place(bd.fillet(bd.Box(9, 7, 8).edges(), 1.5))
    if name == "bracket":
        wall = bd.Pos(-3.5, 0, 3) * bd.Box(2, 8, 8)
        solid = bd.Box(9, 8, 2) + wall - bd.Pos(2, 0, 0) * bd.Cylinder(1.4, 9)
        inner = [e for e in solid.edges() if abs(e.center().X + 2.5) < 0.01 and abs(e.center().Z - 1) < 0.01]
        return place(bd.fillet(inner, 1.5))
    return place({"cone": bd.Cone(4, 2, 7), "torus": bd.Torus(4, 2)}[name])


@pytest.mark.parametrize("name", ["rounded box", "cone", "torus", "bracket"])
def test_a_lattice_cut_by_a_body_is_what_the_kernels_boolean_makes_of_it(name: str, cover: Callable[..., Brep]) -> None:
    from tpmscad.kernel.body_import.body_brep import brep_from_shape
    from tpmscad.kernel.boolean import boolean_operations

    lattice, shape = cover("gyroid", (2, 2, 2), (0.0, 0.0, 0.0), (-0.05, 0.05)), body(name)
    trimmed = trim(lattice, brep_from_shape(shape))
    assert trimmed.report.shifted == 0
    found = check_shape(build_solids(trimmed.brep).shape)
    assert found.valid
    assert found.closed
    assert found.volume == pytest.approx(
        float(integral_properties.volume(integral_properties.integrate_faces(trimmed.brep))[0]), rel=1e-6
    )
    around = shape.bounding_box()
    low, high = np.array(tuple(around.min)) - 0.25, np.array(tuple(around.max)) + 0.25
    block = build_solids(trim(lattice, box(low, high)).brep).shape
    other = boolean_operations.intersect_solids(block, shape.wrapped)
    assert found.volume == pytest.approx(sum(check_shape(s).volume for s in other), rel=1e-6)
