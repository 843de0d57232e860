"""Effective properties of lattices: below the bounds, cubic, and what voxel computations of others say."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import tpmscad
from tests.cli.test_cli import run
from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.requests.study_options import HomogenizeOptions
from tpmscad.simulation.periodic_cell import IsotropicMaterial, solve_cell
from tpmscad.studies import _homogenize

pytest.importorskip("gmsh")
pytest.importorskip("skfem")

pytestmark = [pytest.mark.kernel, pytest.mark.slow]


def test_a_cell_of_schwarz_p_is_cubic_below_the_bounds_and_the_same_on_tetrahedra(tmp_path: Path) -> None:
    """Conductivity 0.287 and error 2 to 3 % by fast Fourier transforms on 64^3 voxels of the nodal sheet."""
    report = tmp_path / "p.json"
    assert run(f"homogenize P --volume-fraction 0.4 -o {tmp_path / 'p.inp'} --report {report}") == 0
    found = json.loads(report.read_text())
    assert found["conductivity"][0][0] == pytest.approx(0.287, rel=0.03)
    assert found["volume_fraction"] == pytest.approx(0.4, rel=1e-3)
    assert found["cubic_deviation"] < 1e-12
    assert 0.8 < found["hashin_shtrikman_ratio"] < 1.0
    assert 0.9 < found["conductivity_ratio"] < 1.0
    assert 0.0 < found["error"] < 0.01
    assert found["C11"] < found["youngs_modulus"]
    assert "*ELASTIC, TYPE=ANISO" in (tmp_path / "p.inp").read_text()
    mesh = tpmscad.lattice("schwarz_p", cell=1, volume_fraction=0.4).mesh(0.16, periodic=True)
    tetrahedra = solve_cell(mesh, IsotropicMaterial())
    assert mesh.n_cells > 4 * found["cells"]
    np.testing.assert_allclose(tetrahedra.stiffness, found["stiffness"], atol=0.02 * found["C11"])
    np.testing.assert_allclose(tetrahedra.conductivity, found["conductivity"], atol=0.003)


def test_a_field_with_a_porosity_is_the_lattice_between_the_same_levels() -> None:
    """Half of the cell lies on either side of the nodal surface itself; other fractions are counted on a grid."""
    phi = fields.tpms("schwarz_p", 2.0)
    by_porosity = tpmscad.homogenize(phi, porosity=0.5, kind="skeletal", size=0.4)
    assert by_porosity.volume_fraction == pytest.approx(0.5, abs=1e-4)
    lattice = tpmscad.lattice("P", cell=2.0, volume_fraction=0.5, kind="skeletal", reference="nodal")
    expected = solve_cell(lattice.mesh(0.4, periodic=True), IsotropicMaterial()).stiffness
    np.testing.assert_allclose(by_porosity.stiffness, expected, atol=0.005 * expected[0, 0])
    grid = np.indices((40, 40, 40)).reshape(3, -1).T / 20.0
    values = phi(grid)
    for kind, solid in (("skeletal", values), ("sheet", np.abs(values))):
        cut = _homogenize._cut_structure(phi, HomogenizeOptions(phi, porosity=0.7, kind=kind))
        inside = cut(grid) < 0
        assert solid[inside].max() < solid[~inside].min()
        assert inside.mean() == pytest.approx(0.3, abs=3e-3)


def test_thin_struts_carry_what_their_stretching_does() -> None:
    """Struts along <111> in tension alone: C11 = C12 = C44 = rho E / 9 (Gurtner and Durand, 2014); joints make them stiffer."""
    found = tpmscad.homogenize("bcc", porosity=0.93)
    assert found.volume_fraction == pytest.approx(0.07, rel=2e-3)
    for entry in (found.stiffness[0, 0], found.stiffness[0, 1], found.stiffness[3, 3]):
        assert 1.0 < entry / (0.07 / 9) < 1.4
    assert 0.99 < 3 * found.conductivity[0, 0] / found.volume_fraction < 1.25
    assert found.error < 0.01


def test_fields_that_are_no_cell_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="has no periods"):
        tpmscad.homogenize(fields.sphere((0, 0, 0), 1.0))
    with pytest.raises(InvalidRequest, match="has no periods"):
        tpmscad.homogenize(fields.strut_lattice("bcc", 1.0, 0.1), porosity=0.9)
    with pytest.raises(InvalidRequest, match="exactly one"):
        tpmscad.homogenize("bcc")
    with pytest.raises(InvalidRequest, match="kind and reference are those of surfaces"):
        tpmscad.homogenize("bcc", porosity=0.9, kind="skeletal")
    with pytest.raises(InvalidRequest, match="reference is that of a name"):
        tpmscad.homogenize(fields.tpms("P", 1.0), porosity=0.9, reference="nodal")
