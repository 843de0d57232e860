"""Derivatives of a sheet's properties against central differences of solids that are made anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tpmscad
from benchmarks.design_derivatives import differentiate_design
from tests.meshing.test_volume_mesh import block
from tpmscad.errors import InvalidRequest
from tpmscad.simulation.periodic_cell import IsotropicMaterial, solve_cell

pytestmark = pytest.mark.kernel


def close(value: object, expected: object, rtol: float) -> None:
    scale = float(np.abs(expected).max())  # type: ignore[call-overload]
    np.testing.assert_allclose(value, expected, rtol=0.0, atol=rtol * scale)


@pytest.mark.parametrize(("name", "reference"), [("gyroid", "minimal"), ("iwp", "nodal")])
def test_volume_and_area_change_as_central_differences_say(name: str, reference: str) -> None:
    given = {"thickness": 0.9, "shift": 0.1, "cell": 7.0}
    found = differentiate_design(name, reference=reference, material=None, **given)
    h = 0.02
    for parameter, argument in (("thickness", "thickness"), ("offset", "shift"), ("cell", "cell")):
        values = [given | {argument: given[argument] + k * h} for k in (-2, -1, 1, 2)]
        found_there = [differentiate_design(name, reference=reference, material=None, **each) for each in values]
        for quantity in ("volume", "area"):
            slope = np.array([1, -8, 8, -1]) @ [getattr(each, quantity) for each in found_there] / (12 * h)
            assert found.derivatives[parameter][quantity] == pytest.approx(slope, rel=1e-8, abs=1e-8)


@pytest.mark.slow
def test_volumes_of_solids_change_as_steiner_s_formula_says() -> None:
    """Independent: the solids' volumes by the kernel, fitted to 1e-7 of the cell."""
    h, made = 0.05, []
    for thickness in (0.5 - h, 0.5 + h):
        made.append(tpmscad.lattice("P", cell=5, thickness=thickness, boundary="natural", tol=1e-5).volume)
    found = differentiate_design("P", cell=5, thickness=0.5, material=None)
    cubic = np.pi * -4 / 6 * 3 * h**2 / 3  # of the difference of t^3
    assert (made[1] - made[0]) / (2 * h) - cubic == pytest.approx(found.derivatives["thickness"]["volume"], rel=1e-6)


@pytest.mark.slow
def test_stiffness_and_conductivity_change_as_central_differences_of_new_cells_say(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("skfem")
    monkeypatch.setattr("benchmarks.design_derivatives.CUTS", (1, 0))
    given = {"thickness": 0.12, "shift": 0.02, "cell": 1.0}
    found = differentiate_design("P", **given)

    def properties(thickness: float, shift: float, cell: float) -> tuple[np.ndarray, np.ndarray]:
        offset = (shift - thickness / 2, shift + thickness / 2)
        model = tpmscad.lattice("P", cell=cell, offset=offset, boundary="natural")
        cell_found = solve_cell(model.hexahedra(2, (1, 0)), IsotropicMaterial())
        return cell_found.stiffness, cell_found.conductivity

    for parameter, argument, h in (("thickness", "thickness", 2e-3), ("offset", "shift", 2e-3), ("cell", "cell", 1e-2)):
        low, high = (properties(**(given | {argument: given[argument] + s * h})) for s in (-1, 1))
        for quantity, a, b in zip(("stiffness", "conductivity"), low, high, strict=True):
            close(found.derivatives[parameter][quantity], (b - a) / (2 * h), 1e-3)


def test_surfaces_without_hexahedra_are_refused() -> None:
    with pytest.raises(InvalidRequest):
        differentiate_design("lidinoid", cell=10, thickness=0.2)


def test_hexahedra_that_do_not_repeat_have_no_derivatives(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = replace(block("hexahedron20"), periodic={"x": np.zeros((0, 2), np.int64)})
    monkeypatch.setattr(tpmscad.Model, "hexahedra", lambda *_: mesh)
    with pytest.raises(InvalidRequest, match="do not repeat along x, y and z: no derivatives"):
        differentiate_design("P", cell=10, thickness=0.5)
