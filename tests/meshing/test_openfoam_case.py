"""Cases of OpenFOAM: meshes of regions obey its rules, patches and flow are as asked, and its own programs take them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.meshing.mesh_facets import boundary_facets, interior_facets
from tests.meshing.test_volume_mesh import EXTENT, block
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.facet_search import tabulate_faces
from tpmscad.meshing.mesh_arrays import sort_nodes
from tpmscad.meshing.poly_meshes import divide_regions, name_for_foam, vector_areas
from tpmscad.meshing.volume_mesh import VolumeMesh


def exchanger(kind: str = "tetra10") -> VolumeMesh:
    """A box whose half of least y carries a fluid along x, beside a solid half, with their interface."""
    mesh = block(kind)
    ((_, nodes),) = mesh.cells.items()
    fluid = mesh.points[nodes][:, :, 1].mean(axis=1) < EXTENT[1] / 2
    groups = {"channel +": np.flatnonzero(fluid), "wall": np.flatnonzero(~fluid)}
    ((face_kind, outer),) = boundary_facets(mesh.cells).items()
    table = tabulate_faces({kind: nodes[~fluid]})[face_kind].nodes
    between = table[(np.abs(mesh.points[table][:, :, 1] - EXTENT[1] / 2) < 1e-9).all(axis=1)]
    facets = {face_kind: np.concatenate([outer, between])}
    at = mesh.points[outer]
    in_fluid = at[:, :, 1].mean(axis=1) < EXTENT[1] / 2
    ends = {"-": (at[:, :, 0] == 0.0).all(axis=1), "+": (at[:, :, 0] == EXTENT[0]).all(axis=1)}
    named = {f"channel +: opening X{sign}": np.flatnonzero(end & in_fluid) for sign, end in ends.items()}
    openings = frozenset(named)
    named["wall | channel +"] = len(outer) + np.arange(len(between))
    groups_and_sides = {"cell_groups": groups, "facet_groups": named, "openings": openings}
    return sort_nodes(replace(mesh, facets=facets, periodic={}, **groups_and_sides))


@pytest.mark.parametrize("kind", ["tetra", "tetra10", "hexahedron27"])
def test_regions_are_closed_hold_their_volume_and_order_their_faces(kind: str) -> None:
    mesh = exchanger(kind)
    assert interior_facets(mesh.cells, mesh.facets).sum() == len(mesh.facet_groups["wall | channel +"])
    for part in divide_regions(mesh):
        corners = part.points[part.faces]
        centre = corners.mean(axis=1)
        area = 0.5 * np.cross(corners[:, 2] - corners[:, 0], np.roll(corners, -1, axis=1)[:, 2] - corners[:, 1])
        if corners.shape[1] == 3:
            area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inside = len(part.neighbour)
        assert (part.owner[:inside] < part.neighbour).all()
        keys = part.owner[:inside] * (part.owner.max() + 1) + part.neighbour
        assert (np.diff(keys) > 0).all()
        closed = np.zeros((part.owner.max() + 1, 3))
        np.add.at(closed, part.owner, area)
        np.add.at(closed, part.neighbour, -area[:inside])
        np.testing.assert_allclose(closed, 0.0, atol=1e-12)
        volume = np.einsum("fa,fa->", centre[inside:], area[inside:]) / 3.0
        assert volume == pytest.approx(EXTENT.prod() / 2)
        assert inside + sum(patch.count for patch in part.patches) == len(part.faces)


def test_names_are_words() -> None:
    assert name_for_foam("channel +: opening X-") == "channel_plus_opening_X_minus"
    assert name_for_foam("wall | channel -") == "wall_to_channel_minus"
    assert name_for_foam("wall: body 3 gr\u00f6\u00dfe").isascii()


def test_both_sides_of_an_interface_are_mapped_to_each_other(tmp_path: Path) -> None:
    exchanger().write_openfoam(tmp_path / "case", velocity=0.02)
    text = {
        name: (tmp_path / f"case/constant/{name}/polyMesh/boundary").read_text() for name in ("wall", "channel_plus")
    }
    ours = re.search(
        r"wall_to_channel_plus \{ type mappedWall;.*sampleRegion (\w+); samplePatch (\w+); nFaces (\d+)", text["wall"]
    )
    theirs = re.search(
        r"channel_plus_to_wall \{ type mappedWall;.*samplePatch (\w+); nFaces (\d+)", text["channel_plus"]
    )
    assert ours
    assert theirs
    assert ours.group(1, 2) == ("channel_plus", "channel_plus_to_wall")
    assert theirs.group(1) == "wall_to_channel_plus"
    assert ours.group(3) == theirs.group(2)
    regions = (tmp_path / "case/constant/regionProperties").read_text()
    assert "regions ( fluid (channel_plus) solid (wall) );" in regions
    zones = (tmp_path / "case/constant/channel_plus/polyMesh/faceZones").read_text()
    assert f"interfaces {{ type faceZone; faceLabels List<label> {ours.group(3)}(" in zones
    velocity = (tmp_path / "case/flow/channel_plus/0/U").read_text()
    assert "opening_X_minus { type fixedValue; value uniform (20 0 0); }" in velocity
    assert "opening_X_plus { type zeroGradient; }" in velocity


@pytest.mark.parametrize("kind", ["tetra", "hexahedron27"])
def test_the_flow_does_not_depend_on_the_names_of_groups(kind: str, tmp_path: Path) -> None:
    mesh = exchanger(kind)
    new = {name: f"group {n}" for n, name in enumerate(mesh.facet_groups)}
    renamed = replace(
        mesh,
        facet_groups={new[name]: numbers for name, numbers in mesh.facet_groups.items()},
        openings=frozenset(new[name] for name in mesh.openings),
    )
    mesh.write_openfoam(tmp_path / "one")
    renamed.write_openfoam(tmp_path / "other")
    for file in ("flow/channel_plus/0/U", "constant/channel_plus/polyMesh/boundary", "constant/wall/polyMesh/boundary"):
        text, other = ((tmp_path / case / file).read_text() for case in ("one", "other"))
        assert "fixedValue" in text or "mappedWall" in text
        for name in mesh.openings:
            other = re.sub(rf"\b{name_for_foam(new[name])}\b", name_for_foam(name), other)
        assert sorted(re.findall(r"\w+ \{.*\}", other)) == sorted(re.findall(r"\w+ \{.*\}", text))


def test_a_case_that_fits_no_mesh_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    mesh = exchanger()
    with pytest.raises(InvalidRequest, match=r"cannot flow to 'Y\+': it is open at X\+, X-"):
        mesh.write_openfoam(tmp_path / "case", flow={"channel +": "Y+"})
    with pytest.raises(InvalidRequest, match="openings at two opposite sides"):
        replace(mesh, openings=frozenset()).write_openfoam(tmp_path / "case")
    with pytest.raises(InvalidRequest, match=r"openings: 'channel \+: opening X\+' is no group of facets"):
        replace(mesh, facet_groups={})
    for flow, words in (
        ({"chanel": "X+"}, "flow: 'chanel' is no group of elements; they are 'channel \\+', 'wall'"),
        ({"channel +": 3}, "flow .* is no dictionary of names and sides; .* as in flow="),
        ("X+", "flow 'X\\+' is no dictionary"),
    ):
        with pytest.raises(InvalidRequest, match=words):
            mesh.write_openfoam(tmp_path / "case", flow=flow)  # type: ignore[arg-type]
    mixed = VolumeMesh(mesh.points, {"tetra": [[0, 1, 2, 3]], "hexahedron": [range(8)]})  # type: ignore[dict-item,list-item]
    with pytest.raises(InvalidRequest, match="from one kind of elements, not tetra and hexahedron"):
        mixed.write_openfoam(tmp_path / "case")
    with pytest.raises(InvalidRequest, match="every element has to be in one group"):
        block("tetra").write_openfoam(tmp_path / "case")
    assert not list(tmp_path.iterdir())
    (tmp_path / "note").touch()
    with pytest.raises(InvalidRequest, match="not an empty folder"):
        mesh.write_openfoam(tmp_path)


def channel(kind: str) -> VolumeMesh:
    """A box that is periodic along x and y, between two walls."""
    mesh = block(kind)
    periodic = {axis: mesh.periodic[axis] for axis in "xy"}
    return replace(mesh, cell_groups={"channel": np.arange(mesh.n_cells)}, periodic=periodic)


@pytest.mark.parametrize("kind", ["tetra", "tetra10", "hexahedron27"])
def test_cyclic_patches_repeat_each_other_face_by_face_and_corner_by_corner(kind: str) -> None:
    (part,) = divide_regions(channel(kind))
    patches = {patch.name: patch for patch in part.patches}
    for axis, shift in zip("xy", np.diag(EXTENT), strict=False):
        near, far = (part.points[part.faces[part.number_faces([f"period_{axis}_{end}"])]] for end in ("near", "far"))
        assert len(near) > 0
        backwards = [0, *range(near.shape[1] - 1, 0, -1)]
        np.testing.assert_allclose(near + shift, far[:, backwards], atol=1e-12)
        assert patches[f"period_{axis}_near"].image == f"period_{axis}_far"
        area = vector_areas(near)
        np.testing.assert_allclose(area.sum(axis=0), -shift * EXTENT.prod() / shift.sum() ** 2, atol=1e-12)


def test_a_periodic_channel_is_driven_by_a_force_and_has_no_heat(tmp_path: Path) -> None:
    channel("tetra").write_openfoam(tmp_path / "case", flow={"channel": "Y-"}, velocity=0.02)
    force = (tmp_path / "case/flow/channel/constant/fvOptions").read_text()
    assert "meanVelocityForce; selectionMode all; fields (U); Ubar (0 -20 0);" in force
    velocity = (tmp_path / "case/flow/channel/0/U").read_text()
    assert "period_x_near { type cyclic; }" in velocity
    assert "fixedValue" not in velocity
    run = (tmp_path / "case/Allrun").read_text()
    assert "simpleFoam -case flow/channel" in run
    assert "chtMultiRegion" not in run
    assert f"$1 * {4.0 * 9.97e-4:.9g} }}" in run
    with pytest.raises(InvalidRequest, match=r"cannot flow to 'Z\+': it is open at no side"):
        channel("tetra").write_openfoam(tmp_path / "other", flow={"channel": "Z+"})


def test_heat_converges_when_each_fluids_is_steady_and_none_stays_in_the_solid(tmp_path: Path) -> None:
    exchanger().write_openfoam(tmp_path / "case", velocity=0.02)
    control = (tmp_path / "case/system/controlDict").read_text()
    greatest = (
        50 * 4.167 * 20.0 * EXTENT[1] / 2 * EXTENT[2]
    )  # mW, by the rate of flow and the temperatures at the inlets
    steady, gain, loss = re.findall(r"\w+ \{ type (?:average|minMax);.*groupID 1; \}", control)
    assert f"functionObject heat_channel_plus; tolerance {1e-4 * greatest:.6g};" in steady
    assert f"functionObject imbalance_wall; mode minimum; value {1e-4 * greatest:.6g};" in gain
    assert f"functionObject imbalance_wall; mode maximum; value {-1e-4 * greatest:.6g};" in loss


needs_openfoam = pytest.mark.skipif(shutil.which("simpleFoam") is None, reason="Debian's openfoam is not installed")


def run_case(case: Path) -> str:
    """What the case's script prints."""
    done = subprocess.run([case / "Allrun"], capture_output=True, text=True, check=False, env=dict(os.environ))
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@needs_openfoam
def test_openfoam_finds_the_meshes_in_order_and_balances_heat(tmp_path: Path) -> None:
    """The solid is adiabatic but for the fluid: it takes the fluid's temperature everywhere."""
    exchanger().write_openfoam(tmp_path / "case")
    printed = run_case(tmp_path / "case")
    assert printed.count("Mesh OK") == 2
    assert re.search(r"^channel_plus: the flow converged in \d+ iterations$", printed, re.MULTILINE)
    assert re.search(r"^channel_plus: pressure drop [\d.e+-]+ Pa$", printed, re.MULTILINE)
    iterations = re.search(r"^the heat converged in (\d+) iterations$", printed, re.MULTILINE)
    assert iterations
    text = (
        (tmp_path / "case" / iterations[1] / "wall/T").read_text().split("boundaryField")[0].split("internalField")[1]
    )
    values = np.array(re.findall(r"^([\d.e+]+)$", text, re.MULTILINE), float)[1:]
    assert len(values) == 36
    np.testing.assert_allclose(values, 350.0, atol=0.1)
