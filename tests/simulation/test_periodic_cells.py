"""Effective properties against closed forms: laminates, uniform solids, bounds; the solver against a direct one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from tests.meshing.test_volume_mesh import block
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.meshing.hexahedra import mesh_hexahedra
from tpmscad.meshing.mesh_arrays import sort_nodes
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.simulation import multigrid
from tpmscad.simulation.multigrid import solve
from tpmscad.simulation.periodic_cell import IsotropicMaterial, solve_cell
from tpmscad.simulation.properties import HomogenizedProperties
from tpmscad.sources.catalogue_sources import lattice_source

pytest.importorskip("skfem")

STEEL = IsotropicMaterial(210.0, 0.3)


def plate(kind: str) -> VolumeMesh:
    """Two of three layers of a periodic box: a plate in the planes x = const, which repeats along y and z only as a solid."""
    mesh = block(kind)
    keep = mesh.points[mesh.cells[kind]].mean(axis=1)[:, 0] < 2.0
    cells = mesh.cells[kind][keep]
    used = np.zeros(len(mesh.points), bool)
    used[cells] = True
    pairs = {axis: found[used[found].all(axis=1)] for axis, found in mesh.periodic.items()}
    return sort_nodes(replace(mesh, cells={kind: cells}, facets={}, cell_groups={}, facet_groups={}, periodic=pairs))


@pytest.mark.parametrize("kind", ["tetra10", "hexahedron27"])
def test_a_full_box_has_the_stiffness_of_the_solid(kind: str) -> None:
    found = solve_cell(block(kind), STEEL)
    np.testing.assert_allclose(found.stiffness, STEEL.stiffness, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.conductivity, np.eye(3), atol=1e-9)
    assert found.volume_fraction == pytest.approx(1.0)


@pytest.mark.parametrize("kind", ["tetra10", "hexahedron27"])
def test_a_plate_has_the_stiffness_of_plane_stress(kind: str) -> None:
    """Across the plate nothing carries; in its plane E / (1 - nu^2) and E nu / (1 - nu^2), and G in shear, times its fraction."""
    found = solve_cell(plate(kind), STEEL)
    e, nu, part = 210.0, 0.3, 2.0 / 3.0
    expected = np.zeros((6, 6))
    expected[1, 1] = expected[2, 2] = part * e / (1.0 - nu**2)
    expected[1, 2] = expected[2, 1] = part * e * nu / (1.0 - nu**2)
    expected[3, 3] = part * e / (2.0 * (1.0 + nu))
    np.testing.assert_allclose(found.stiffness, expected, atol=1e-6)
    np.testing.assert_allclose(found.conductivity, np.diag([0.0, part, part]), atol=1e-9)


@pytest.mark.slow
def test_hexahedra_of_a_natural_gyroid_agree_with_the_thin_sheet() -> None:
    """Its bulk modulus tends to 2 rho E / (9 (1 - nu)), its conductivity to 2 rho / 3; the constants of the cell are cubic."""
    source = lattice_source("gyroid", "minimal")
    sheet = source.fit((-0.008, 0.008), 1.0, 1e-3).surfaces
    volumes = source.fill(sheet, (1, 1, 1), np.zeros(3), natural=True)
    found = solve_cell(mesh_hexahedra(volumes, 2, (1, 0)), IsotropicMaterial())
    rho, c = found.volume_fraction, found.stiffness
    assert mesh_hexahedra(volumes, 2, (2, 0)).volume == pytest.approx(volumes.integrate_volume(), rel=2e-4)
    assert (c[0, 0] + 2 * c[0, 1]) / 3 == pytest.approx(2 * rho / (9 * 0.7), rel=0.02)
    np.testing.assert_allclose(found.conductivity, 2 / 3 * rho * np.eye(3), atol=0.01 * rho)
    cubic = np.diag([c[0, 0] - c[0, 1]] * 3 + [c[3, 3]] * 3)
    cubic[:3, :3] += c[0, 1]
    np.testing.assert_allclose(c, cubic, atol=1e-9)


def test_meshes_that_do_not_repeat_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="periodic along x, y and z"):
        solve_cell(replace(block("tetra10"), periodic={}), STEEL)
    with pytest.raises(InvalidRequest, match="second order"):
        solve_cell(block("tetra"), STEEL)


def test_the_solver_agrees_with_a_direct_one_and_says_when_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    count = 60
    line = sparse.diags([-np.ones(count - 1), np.full(count, 2.001), -np.ones(count - 1)], [-1, 0, 1], format="csr")
    prolongation = sparse.csr_matrix(np.maximum(0.0, 1.0 - np.abs(np.arange(count)[:, None] / 2 - np.arange(30))))
    loads = np.random.default_rng(2).standard_normal((count, 3))
    found = solve(line, loads, prolongation, 1.0)
    np.testing.assert_allclose(found.values, np.linalg.solve(line.toarray(), loads), rtol=1e-6, atol=1e-6)
    assert found.iterations < 15
    monkeypatch.setattr(multigrid, "MAX_ITERATIONS", 2)
    with pytest.raises(KernelError, match="after 2 iterations"):
        solve(line, loads, prolongation, 1.0)


def properties(stiffness: Array) -> HomogenizedProperties:
    return HomogenizedProperties(
        *("test part", stiffness, 0.25 * np.eye(3), 0.4, 0.001, stiffness, 0.25 * np.eye(3), 1.0, 0.3, 1, 1, 0.0)
    )


def test_constants_of_an_isotropic_stiffness_are_its_own() -> None:
    found = properties(IsotropicMaterial(3.0, 0.25).stiffness)
    assert found.engineering_constants == pytest.approx(
        {"E1": 3.0, "E2": 3.0, "E3": 3.0, "nu12": 0.25, "nu13": 0.25, "nu23": 0.25, "G12": 1.2, "G13": 1.2, "G23": 1.2}
    )
    assert found.zener_ratio == pytest.approx(1.0)
    assert found.bulk_modulus == pytest.approx(2.0)
    assert found.cubic_deviation < 1e-15
    np.testing.assert_allclose(found.directional_modulus([[1, 0, 0], [1, 1, 0], [1, 2, 3]]), 3.0)


def test_a_cubic_stiffness_has_its_modulus_along_the_diagonal() -> None:
    stiffness = np.diag([5.0] * 3 + [2.0] * 3)
    stiffness[:3, :3] += 1.0
    c11, c12, c44 = 6.0, 1.0, 2.0
    s11, s12 = (c11 + c12) / ((c11 - c12) * (c11 + 2 * c12)), -c12 / ((c11 - c12) * (c11 + 2 * c12))
    expected = 1.0 / (s11 - 2.0 / 3.0 * (s11 - s12 - 0.5 / c44))
    assert properties(stiffness).directional_modulus([1, 1, 1]) == pytest.approx(expected)
    assert properties(stiffness).cubic_constants == pytest.approx((c11, c12, c44))


def test_material_cards_hold_the_constants(tmp_path: Path) -> None:
    stiffness = np.arange(36.0).reshape(6, 6)
    stiffness = stiffness + stiffness.T + 100.0 * np.eye(6)
    found = properties(stiffness)
    found.write(tmp_path / "card.inp")
    lines = (tmp_path / "card.inp").read_text().splitlines()
    start = lines.index("*ELASTIC, TYPE=ANISO")
    numbers = [float(x) for line in lines[start + 1 : start + 4] for x in line.strip(",").split(",")]
    assert len(numbers) == 22
    assert numbers[9] == stiffness[5, 5]  # D1212
    assert numbers[14] == stiffness[4, 4]  # D1313
    assert numbers[20] == stiffness[3, 3]  # D2323
    assert lines[start - 1] == "*MATERIAL, NAME=TEST_PART"
    found.write(tmp_path / "card.csv")
    assert "C11," in (tmp_path / "card.csv").read_text()
    with pytest.raises(InvalidRequest):
        found.write(tmp_path / "card.txt")


def read_deck(path: Path) -> tuple[Array, Array, list[list[tuple[int, int, float]]]]:
    """Nodes (n, 3), elements (m, k) and equations, (node, freedom, factor) each, of an input of CalculiX, numbered from 0."""
    blocks: dict[str, list[list[float]]] = {}
    lines = [line for line in path.read_text().splitlines() if not line.startswith("**")]
    for line in lines:
        if line.startswith("*"):
            keyword = line.split(",")[0]
            blocks.setdefault(keyword, [])
        else:
            blocks[keyword].append([float(word) for word in line.split(",") if word.strip().lstrip("-")[:1].isdigit()])
    nodes = np.array(blocks["*NODE"])[:, 1:]
    elements = np.array(blocks["*ELEMENT"]).astype(int)[:, 1:] - 1
    numbers, equations = [x for row in blocks["*EQUATION"] for x in row], []
    while numbers:
        terms, numbers = np.reshape(numbers[1 : 1 + 3 * int(numbers[0])], (-1, 3)), numbers[1 + 3 * int(numbers[0]) :]
        equations.append([(int(node) - 1, int(freedom) - 1, factor) for node, freedom, factor in terms.tolist()])
    return nodes, elements, equations


@pytest.mark.parametrize("sides", [((0, 0),), ((1, 1),), ((1, 1), (2, 2)), ((1, 2),)])
def test_the_energy_of_a_calculix_deck_is_that_of_the_effective_stiffness(
    sides: tuple[tuple[int, int], ...], tmp_path: Path
) -> None:
    """What the guide says to read: twice the energy over the box' volume, with the reference nodes (axis, freedom) moved."""
    import skfem
    from skfem.models.elasticity import linear_elasticity

    mesh = plate("tetra10")
    mesh.write(tmp_path / "cell.inp")
    nodes, elements, equations = read_deck(tmp_path / "cell.inp")
    count = len(nodes) - 3
    of_skfem = skfem.MeshTet(nodes[: elements[:, :4].max() + 1].T, elements[:, :4].T.copy())
    basis = skfem.Basis(of_skfem, skfem.ElementVector(skfem.ElementTetP1()))
    stiffness = linear_elasticity(*STEEL.lame).assemble(basis)
    freedoms = basis.N + 9
    dof = np.full((len(nodes), 3), -1)
    dof[: of_skfem.p.shape[1]] = basis.nodal_dofs.T
    dof[count:] = basis.N + np.arange(9).reshape(3, 3)
    ties = [[(dof[n, f], x) for n, f, x in terms] for terms in equations if all(dof[n, f] >= 0 for n, f, _ in terms)]
    moved, strain = np.zeros(9), np.zeros((3, 3))
    for axis, freedom in sides:
        moved[3 * axis + freedom], strain[axis, freedom] = mesh.periods[axis], 1.0
    rows = [(k, *term) for k, terms in enumerate(ties) for term in terms]
    rows += [(len(ties) + k, basis.N + k, 1.0) for k in range(9)]
    row, column, factor = zip(*rows, strict=True)
    constraints = sparse.csr_matrix((factor, (row, column)), (len(ties) + 9, freedoms)).toarray()
    full = np.zeros((freedoms, freedoms))
    full[: basis.N, : basis.N] = stiffness.toarray()
    n = len(constraints)
    saddle = np.block([[full, constraints.T], [constraints, np.zeros((n, n))]])
    right = np.concatenate([np.zeros(freedoms + len(ties)), moved])
    found = np.linalg.lstsq(saddle, right, rcond=1e-12)[0][:freedoms]
    strain = 0.5 * (strain + strain.T)
    voigt = np.array([*np.diag(strain), 2 * strain[1, 2], 2 * strain[0, 2], 2 * strain[0, 1]])
    expected = voigt @ solve_cell(mesh, STEEL).stiffness @ voigt
    assert found @ full @ found / np.prod(mesh.periods) == pytest.approx(expected, abs=1e-6)
