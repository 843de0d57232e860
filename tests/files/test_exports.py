"""Results of every kind behave alike and go into files that independent readers take: trimesh, lib3mf, the kernel's own."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import build123d as bd
import lib3mf
import numpy as np
import pytest
import trimesh

import tpmscad
from tests.part21 import check, parser
from tpmscad import fields
from tpmscad.brep.triangles.closed_mesh import SolidMesh
from tpmscad.kernel.export.brep_file import count_distinct_faces, read_brep_file
from tpmscad.kernel.export.solid_mesh import _split_repeated_chords, count_open_sides, mesh_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.results.domain_results import FluidDomains

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

P: dict[str, Any] = {"surface": "P", "cell": 10, "thickness": 1, "tol": 0.1}
IN_A_BODY = P | {"cell": 8}
MIDDLE = bd.Pos(4, 4, 4)  # of a cell: bodies there cut few of its patches
DEVIATION = 0.05


@cache
def domains() -> FluidDomains:
    return tpmscad.fluid_domains(MIDDLE * bd.Box(8.4, 7, 6), **IN_A_BODY)


def blended() -> tpmscad.Model:
    phi = fields.tpms("P", 10.0)
    left, middle, right = (fields.box((x, 0, 0), (x + w, 5, 5)) for x, w in ((0, 4), (4, 4), (8, 4)))
    result = tpmscad.blend(
        [fields.rod(phi, -0.3), fields.rod(phi, 0.2)],
        regions=[left, right],
        blending_regions=[middle],
        resolution=(24, 10, 10),
    )
    return tpmscad.solidify(result.field, ((0, 0, 0), (12, 5, 5)), tol=0.2)


RESULTS: dict[str, Callable[[], tpmscad.Model]] = {
    "lattice": lambda: tpmscad.lattice(**P),
    "skeletal lattice": lambda: tpmscad.lattice("P", cell=8, offset=0.2, kind="skeletal", tol=0.1),
    "infill by patches": lambda: tpmscad.infill(MIDDLE * bd.Sphere(4.2), **IN_A_BODY),
    "infill by the kernel": lambda: tpmscad.infill(bd.Pos(4, 4, 1) * bd.extrude(bd.Ellipse(4.2, 3.5), 6), **IN_A_BODY),
    "infill with a skin": lambda: tpmscad.infill(MIDDLE * bd.Box(8.4, 7, 6), **IN_A_BODY, skin=1.0),
    "solid of a field": lambda: tpmscad.solidify(
        fields.sheet(fields.tpms("P", 10.0), -0.4, 0.4), ((0, 0, 0), (7, 6, 5)), tol=0.1
    ),
    "solid of a blend": blended,
    "wall": lambda: domains().wall,
    "channel +": lambda: domains().plus,
}


@cache
def made(name: str) -> tpmscad.Model:
    return RESULTS[name]()


@cache
def exact_volume(name: str) -> float:
    """Volume by the kernel's own adaptive quadrature."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(made(name).wrapped, properties, 1e-5)
    return properties.Mass()


@pytest.mark.parametrize("name", RESULTS)
class TestEveryResult:
    def test_is_a_model_that_knows_itself(self, name: str) -> None:
        model = made(name)
        assert isinstance(model, tpmscad.Model)
        assert model.volume == model.certificate.volume == pytest.approx(exact_volume(name), rel=1e-4)
        assert model.area == model.certificate.area
        assert model.solid.wrapped.IsSame(model.wrapped)
        assert len(repr(model).splitlines()) <= 10
        assert not [n for n in dir(model) if n.startswith("_")]
        mesh = mesh_solids(model.wrapped, 0.01, 0.2)
        points = np.concatenate([m.points for m in mesh])
        size = np.ptp(points, axis=0).max()
        np.testing.assert_allclose(model.bounding_box, [points.min(axis=0), points.max(axis=0)], atol=1e-3 * size)

    @pytest.mark.parametrize("suffix", ["stl", "3mf", "glb"])
    def test_is_written_as_a_closed_mesh_within_the_deviation(self, name: str, suffix: str, tmp_path: Path) -> None:
        model, path = made(name), tmp_path / f"part.{suffix}"
        model.export(path, deviation=DEVIATION, angle=30)
        scene = trimesh.load(path, file_type=suffix)
        mesh = scene if isinstance(scene, trimesh.Trimesh) else scene.to_geometry()
        if suffix == "glb":  # metres, y up
            mesh.apply_transform(np.array([[1e3, 0, 0, 0], [0, 0, -1e3, 0], [0, 1e3, 0, 0], [0, 0, 0, 1]], float))
            mesh = trimesh.Trimesh(mesh.vertices, mesh.faces)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume == pytest.approx(exact_volume(name), abs=DEVIATION * model.area)
        np.testing.assert_allclose(mesh.bounds, model.bounding_box, atol=2 * DEVIATION)

    def test_is_written_exactly_as_brep(self, name: str, tmp_path: Path) -> None:
        made(name).export(tmp_path / "part.brep")
        again = bd.import_brep(tmp_path / "part.brep")
        assert again.is_valid
        assert check_shape(again).volume == pytest.approx(made(name).volume, rel=1e-9)

    def test_is_written_as_step_with_names_colours_and_what_it_should_measure(self, name: str, tmp_path: Path) -> None:
        model, path = made(name), tmp_path / "part.step"
        model.export(path)
        text = path.read_text()
        header, instances = parser.parse(text)
        assert check.faults(instances, "ap242") == []
        assert "Open CASCADE" not in header
        assert "tpmscad" in header
        labels = {v[0].value.strip("'") for v in parser.of_kind(instances, "ADVANCED_FACE").values()}
        groups = ("surface", "surface +", "surface -", "gap", "cap", "body", "skin", "opening")
        assert all(label.startswith(groups) for label in labels)
        assert any(label.startswith("surface") for label in labels)
        assert len(parser.of_kind(instances, "STYLED_ITEM")) == model.certificate.n_faces
        stated = [v for v in parser.of_kind(instances, "MEASURE_REPRESENTATION_ITEM").values()]
        volume = next(float(v[1].value[1].value) for v in stated if "volume" in v[0].value)
        assert volume == pytest.approx(model.volume, rel=1e-9)
        assert len(text) < 8000 * model.certificate.n_faces
        found = tpmscad.check_step(path)
        assert found.ok
        assert found.products == (model.name,)


@pytest.fixture(scope="module")
def step(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The domains in a STEP file."""
    path = tmp_path_factory.mktemp("domains") / "a.step"
    domains().export(path)
    return path


class TestDomains:
    def test_a_brep_file_keeps_the_shared_faces_and_step_does_not(self, step: Path, tmp_path: Path) -> None:
        domains().export(tmp_path / "a.brep")
        faces = sum(len(model.solid.faces()) for model in domains().domains.values())
        distinct = count_distinct_faces(domains().wrapped)
        assert distinct < faces
        assert count_distinct_faces(read_brep_file(tmp_path / "a.brep")) == distinct
        again = bd.import_step(step)
        assert len({hash(face.wrapped) for face in again.faces()}) == faces
        parts = {part.label: part for part in again.children}
        assert set(parts) == {"wall", "channel_+", "channel_-"}  # build123d writes blanks so
        assert len({tuple(part.color) for part in parts.values()}) == 3

    def test_a_step_file_stores_shared_edges_once(self, step: Path) -> None:
        _, instances = parser.parse(step.read_text())
        assert check.faults(instances, "ap242") == []
        edges = {hash(edge.wrapped) for model in domains().domains.values() for edge in model.solid.edges()}
        assert len(parser.of_kind(instances, "EDGE_CURVE")) == len(edges)

    def test_a_mesh_file_holds_three_named_parts_that_touch_without_gaps(self, tmp_path: Path) -> None:
        domains().export(tmp_path / "a.3mf", deviation=DEVIATION)
        scene = trimesh.load(tmp_path / "a.3mf")
        assert set(scene.geometry) == {"wall", "channel +", "channel -"}
        assert all(mesh.is_watertight for mesh in scene.geometry.values())
        assert sum(mesh.volume for mesh in scene.geometry.values()) == pytest.approx(8.4 * 7 * 6, rel=1e-9)

    def test_stl_holds_one_body(self, tmp_path: Path) -> None:
        with pytest.raises(tpmscad.InvalidRequest, match=r"one by one, or as \.3mf"):
            domains().export(tmp_path / "a.stl")

    def test_they_are_told_in_ten_lines(self) -> None:
        assert len(repr(domains()).splitlines()) <= 10
        assert domains().volume == pytest.approx(8.4 * 7 * 6)


def test_3mf_is_read_by_the_consortium_s_library_without_a_warning(tmp_path: Path) -> None:
    made("lattice").export(tmp_path / "part.3mf", deviation=DEVIATION)
    model = lib3mf.Wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(tmp_path / "part.3mf"))
    assert reader.GetWarningCount() == 0
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    objects = model.GetMeshObjects()
    assert objects.MoveNext()
    mesh = objects.GetCurrentMeshObject()
    assert mesh.GetName() == made("lattice").name
    assert mesh.IsManifoldAndOriented()


def test_glb_is_in_metres_with_y_up_and_a_material_for_each_group(tmp_path: Path) -> None:
    made("lattice").export(tmp_path / "part.glb", deviation=DEVIATION)
    content = (tmp_path / "part.glb").read_bytes()
    assert struct.unpack_from("<III", content) == (0x46546C67, 2, len(content))
    document = json.loads(content[20 : 20 + struct.unpack_from("<I", content, 12)[0]])
    assert {m["name"] for m in document["materials"]} >= {"surface +", "surface -", "cap X+", "cap Z-"}
    size = np.ptp(trimesh.load(tmp_path / "part.glb").bounds, axis=0)
    np.testing.assert_allclose(size, [0.01] * 3, rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("part.obj", {}, r"'\.obj'.*\.step, \.stl, \.3mf, \.glb or \.brep"),
        ("part.stl", {"deviation": 0.0}, "deviation = 0.0 must be greater than 0"),
        ("part.stl", {"angle": 120}, "less than 90"),
        ("part.step", {"deviation": 0.1}, "exact: leave deviation"),
        ("part.brep", {"instanced": True}, "for STEP files"),
        ("nowhere/part.stl", {}, "folder"),
    ],
)
def test_what_a_format_has_not_is_refused(name: str, options: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match=message):
        made("lattice").export(tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


def test_a_chord_that_two_faces_share_is_split() -> None:
    """Two tetrahedra that meet in an edge only, each with the edge inside one face."""
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]], float)
    triangles = np.array(
        [[0, 2, 3], [0, 1, 2], [1, 3, 2], [0, 3, 1], [0, 4, 5], [0, 1, 4], [1, 5, 4], [0, 5, 1]], np.int64
    )
    mesh = SolidMesh(points, triangles, np.array([1, 0, 1, 0, 3, 2, 3, 2]))
    assert count_open_sides(mesh.triangles) > 0
    split = _split_repeated_chords(mesh)
    assert count_open_sides(split.triangles) == 0
    assert split.volume == pytest.approx(mesh.volume)
    assert split.area == pytest.approx(mesh.area)


def test_shapes_of_others_are_written_several_at_once(tmp_path: Path) -> None:
    tpmscad.export_step([bd.Box(1, 2, 3), bd.Pos(5, 0, 0) * bd.Sphere(1)], tmp_path / "two.step")
    found = tpmscad.check_step(tmp_path / "two.step")
    assert found.ok
    assert found.shape.solids == 2
    with pytest.raises(tpmscad.InvalidRequest, match="bound no solid"):
        tpmscad.export_step(bd.Rectangle(2, 3).face(), tmp_path / "face.step")


def test_a_solid_without_volume_is_refused(tmp_path: Path) -> None:
    flat = bd.Solid(bd.Shell([bd.Rectangle(2, 3).face()]))
    with pytest.raises(tpmscad.InvalidRequest, match="the solid encloses no volume"):
        tpmscad.export_step(flat, tmp_path / "flat.step")
    assert not list(tmp_path.iterdir())
