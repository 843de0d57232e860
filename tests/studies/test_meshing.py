"""Models become meshes on their exact faces: size as asked, no element turned over, groups by the names of faces, sides alike."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tests.cli.test_cli import run
from tests.meshing.mesh_facets import interior_facets
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.export.shape_file import name_solids, write_solids
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.requests.study_options import MeshOptions
from tpmscad.studies._mesh_step import mesh_step
from tpmscad.studies.volume_meshing import mesh_named_solids

pytest.importorskip("gmsh")
skfem = pytest.importorskip("skfem")

pytestmark = [pytest.mark.kernel, pytest.mark.slow]


@pytest.fixture(scope="module")
def model() -> Any:
    return tpmscad.lattice("P", cell=10, thickness=2.0, tol=0.02)


@pytest.fixture(scope="module")
def cell(model: Any) -> VolumeMesh:
    return model.mesh(1.6, periodic=True)


def test_a_cell_has_the_size_asked_and_no_inverted_element(model: Any, cell: VolumeMesh) -> None:
    assert cell.order == 2
    assert cell.quality.inverted == 0
    assert cell.quality.size == pytest.approx(1.6, rel=0.3)
    assert cell.volume == pytest.approx(model.volume, rel=5e-4)


def test_groups_of_facets_cover_the_boundary_and_have_the_areas_of_the_faces(model: Any, cell: VolumeMesh) -> None:
    groups = cell.facet_groups
    assert {"surface +", "surface -", *(f"cap {axis}{sign}" for axis in "XYZ" for sign in "+-")} == set(groups)
    assert sorted(np.concatenate(list(groups.values()))) == list(range(cell.n_facets))
    mesh = cell.to_skfem()
    areas = {name: skfem.FacetBasis(mesh, skfem.ElementTetP1(), facets=name).dx.sum() for name in groups}
    assert sum(areas.values()) == pytest.approx(model.area, rel=1e-3)
    assert areas["cap X+"] == pytest.approx(areas["cap X-"], rel=1e-12)
    normals = skfem.FacetBasis(mesh, skfem.ElementTetP1(), facets="cap X+").normals
    np.testing.assert_allclose(normals[0], 1.0)


def test_sides_are_images_of_each_other_to_the_last_bits(cell: VolumeMesh) -> None:
    assert list(cell.periodic) == ["x", "y", "z"]
    assert cell.mismatch < 1e-12
    for axis, name in enumerate("xyz"):
        on_side = np.flatnonzero(np.abs(cell.points[:, axis] - 10.0) < 1e-12)
        np.testing.assert_array_equal(np.sort(cell.periodic[name][:, 1]), on_side)


def test_the_solid_of_a_periodic_field_has_a_periodic_mesh() -> None:
    """Its patches end at other places on either side, and the curves of both agree within the tolerance only."""
    rod = tpmscad.fields.rod(tpmscad.fields.tpms("gyroid", 10.0), -0.2)
    model = tpmscad.solidify(rod, ((0, 0, 0), (10, 10, 10)), tol=0.05, loose="keep")
    mesh = model.mesh(1.6, periodic=True)
    assert list(mesh.periodic) == ["x", "y", "z"]
    assert mesh.mismatch == 0.0
    assert 0 < mesh.moved < 0.1
    assert mesh.quality.inverted == 0
    assert mesh.quality.smallest_scaled_jacobian > 0.02
    assert mesh.volume == pytest.approx(model.volume, rel=2e-3)
    for axis, name in enumerate("xyz"):
        on_side = np.flatnonzero(np.abs(mesh.points[:, axis] - 10.0) < 1e-12)
        np.testing.assert_array_equal(np.sort(mesh.periodic[name][:, 1]), on_side)


def test_sides_that_differ_are_not_taken_for_periodic() -> None:
    shape = bd.Box(4, 4, 4) - bd.Pos(0, 0, 2) * bd.Cylinder(1, 2)
    with pytest.raises(InvalidRequest, match="faces at one side along z"):
        mesh_named_solids(
            name_solids(shape, "box"), ["body"], ((-2, -2, -2), (2, 2, 2)), MeshOptions(1.5, periodic=True), name="box"
        )


def test_curvature_refines_where_it_is_asked_for() -> None:
    shape = bd.Pos(5, 0, 0) * bd.Box(10, 4, 4) - bd.Pos(2, 0, 0) * bd.Cylinder(0.5, 4)
    bounds = ((0, -2, -2), (10, 2, 2))
    even, fine = (
        mesh_named_solids(name_solids(shape, "bar"), ["body"], bounds, MeshOptions(3.0, per_turn=n), name="bar")
        for n in (None, 12)
    )
    assert fine.n_cells > 2 * even.n_cells
    assert fine.volume == pytest.approx(160.0 - np.pi, rel=1e-3)


def test_a_model_of_the_caller_in_gmsh_is_left_alone() -> None:
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("mine")
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        size = gmsh.option.getNumber("Mesh.MeshSizeMax")
        box = name_solids(bd.Pos(1, 1, 1) * bd.Box(2, 2, 2), "box")
        mesh = mesh_named_solids(box, ["body"], ((0, 0, 0), (2, 2, 2)), MeshOptions(1.5, 1), name="box")
        assert list(mesh.cells) == ["tetra"]
        assert mesh.volume == pytest.approx(8.0)
        assert not mesh.periodic
        assert gmsh.model.getCurrent() == "mine"
        assert gmsh.option.getNumber("Mesh.MeshSizeMax") == size
    finally:
        gmsh.finalize()


WHOLE_CELL = bd.Box(6, 6, 6, align=bd.Align.MIN)


def check_periodic(mesh: VolumeMesh) -> None:
    """A node and its image, exactly a period away, touch elements of the same domains."""
    assert set(mesh.periodic) == set("xyz")
    assert mesh.mismatch == 0.0
    ((_, nodes),) = mesh.cells.items()
    touches = np.zeros((nodes.max() + 1, len(mesh.cell_groups)), bool)
    for k, numbers in enumerate(mesh.cell_groups.values()):
        touches[nodes[numbers], k] = True
    for pairs in mesh.periodic.values():
        np.testing.assert_array_equal(*touches[pairs.T])


def test_wall_and_channels_share_their_nodes_and_conduct_in_balance() -> None:
    """Steady conduction from X- to X+ through three materials in a box; the heat that enters leaves."""
    parts = tpmscad.fluid_domains(WHOLE_CELL, "schwarz_p", cell=6, thickness=1.2, tol=0.05)
    mesh = parts.mesh(1.4, periodic=True)
    check_periodic(mesh)
    assert set(mesh.cell_groups) == {"wall", "channel +", "channel -"}
    assert mesh.quality.inverted == 0
    assert mesh.volume == pytest.approx(216.0, rel=1e-12)
    for name, model in parts.domains.items():
        assert mesh.cell_volumes[mesh.cell_groups[name]].sum() == pytest.approx(model.volume, rel=2e-3)
    between = {name for name in mesh.facet_groups if "|" in name}
    assert between == {"wall | channel +", "wall | channel -"}
    inner = interior_facets(mesh.cells, mesh.facets)
    np.testing.assert_array_equal(
        np.flatnonzero(inner), np.sort(np.concatenate([mesh.facet_groups[g] for g in between]))
    )
    assert abs(conducted_heat(mesh)) < 1e-6


def test_domains_of_whole_cells_without_mirrors_have_periodic_meshes() -> None:
    mesh = tpmscad.fluid_domains(WHOLE_CELL, "gyroid", cell=6, thickness=0.8, tol=0.05).mesh(2.5, 1, True)
    check_periodic(mesh)
    np.testing.assert_allclose(mesh.periods, 6.0, rtol=1e-14)


def test_domains_of_broken_cells_have_no_periodic_meshes() -> None:
    with pytest.raises(InvalidRequest, match="are no copies of"):
        tpmscad.fluid_domains(WHOLE_CELL, "P", cell=5, thickness=0.8, tol=0.05).mesh(2.0, 1, True)


def conducted_heat(mesh: VolumeMesh) -> float:
    """Sum of the heat through both ends, relative to one: reactions of second-order elements at fixed temperatures."""
    from skfem.helpers import dot, grad

    found = mesh.to_skfem()
    basis = skfem.Basis(found, skfem.ElementTetP2())
    conductivity = np.ones(mesh.n_cells)
    conductivity[mesh.cell_groups["wall"]] = 20.0
    on_points = np.repeat(conductivity[:, None], basis.X.shape[-1], axis=1)
    matrix = skfem.BilinearForm(lambda u, v, w: w.k * dot(grad(u), grad(v))).assemble(basis, k=on_points)
    ends = [basis.get_dofs(lambda x, end=end: np.isclose(x[0], end)).all() for end in (0.0, 6.0)]
    values = np.zeros(basis.N)
    values[ends[1]] = 1.0
    solved = skfem.solve(*skfem.condense(matrix, x=values, D=np.concatenate(ends)))
    reactions = matrix @ solved
    assert reactions[ends[1]].sum() > 1.0
    return float((reactions[ends[0]].sum() + reactions[ends[1]].sum()) / reactions[ends[1]].sum())


def test_the_command_meshes_a_file_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part, mesh, report = tmp_path / "part.step", tmp_path / "part.inp", tmp_path / "part.json"
    tpmscad.export_step(bd.Box(4, 3, 2), part)
    assert run(f"mesh {part} --size 1.5 --periodic -o {mesh} --report {report}") == 0
    content = json.loads(report.read_text())
    assert content["volume"] == pytest.approx(24.0)
    assert content["periodic"] == ["x", "y", "z"]
    assert "surface X+" in content["groups"]
    assert "*EQUATION" in mesh.read_text()
    assert "share no nodes" not in capsys.readouterr().out
    assert run(f"mesh {part} --size 1.5 --order 3 -o {mesh}") == 2
    assert run(f"mesh {part} --size 1.5 -o {tmp_path / 'part.stl'}") == 2


def test_facets_of_a_file_have_the_names_that_its_faces_have(tmp_path: Path) -> None:
    labels = ("cap X-", "cap X+", "surface +", "surface -", "gap", "")
    solid = NamedSolid("part", bd.Box(4, 3, 2).solid().wrapped, labels)
    write_solids([solid], tmp_path / "part.step", schema="ap242", name="part")
    groups = mesh_step(tmp_path / "part.step", 2.0, order=1).facet_groups
    assert set(groups) == {*labels[:-1], "surface Z+"}


def test_the_command_says_that_touching_solids_of_a_step_file_share_no_nodes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pair = make_compound([bd.Box(2, 2, 2).wrapped, (bd.Pos(2, 0, 0) * bd.Box(2, 2, 2)).wrapped])
    tpmscad.export_step(pair, tmp_path / "pair.step")
    assert run(f"mesh {tmp_path / 'pair.step'} --size 2 --order 1 -o {tmp_path / 'pair.msh'}") == 0
    assert "mesh that file" in capsys.readouterr().out
