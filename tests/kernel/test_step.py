"""STEP files: read back by the kernel they hold what was written; read by an independent parser they conform to the schema."""

from __future__ import annotations

import re
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.part21 import check, parser
from tests.part21.types_of_entities import type_faults

pytestmark = pytest.mark.kernel

import build123d as bd

import tpmscad
from tests.shapes.kernel_shapes import CASES, TURN, drilled_dome, plane_box, voxels
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.export.shape_file import write_shape
from tpmscad.kernel.measure.shape_report import check_step
from tpmscad.kernel.step import occt_topology
from tpmscad.kernel.step.brep_writer import write_step
from tpmscad.kernel.step.coloured_reader import read_coloured_solids
from tpmscad.kernel.step.part21 import format_real, format_string
from tpmscad.kernel.step.step_reader import read_step
from tpmscad.rigid_motion import Motion

STAMP = "2026-01-01T00:00:00"


def written(brep, path: Path, **how) -> str:
    write_step(brep, build_solids(brep).nesting, path, **({"time_stamp": STAMP} | how))
    return path.read_text(encoding="ascii")


@lru_cache
def moments_of(case: str) -> integral_properties.FaceMoments:
    return integral_properties.integrate_faces(CASES[case]())


@lru_cache
def parsed(case: str, schema: str) -> tuple[str, dict[int, parser.Instance]]:
    with tempfile.TemporaryDirectory() as folder:
        return parser.parse(written(CASES[case](), Path(folder) / "part.step", schema=schema))


@pytest.mark.parametrize("schema", ["ap242", "ap214"])
@pytest.mark.parametrize("case", CASES)
class TestEveryFile:
    def test_reads_back_valid_closed_in_mm_with_the_same_volume(self, case: str, schema: str, tmp_path: Path) -> None:
        brep, moments = CASES[case](), moments_of(case)
        written(brep, tmp_path / "part.step", schema=schema)
        found = check_step(tmp_path / "part.step")
        assert found.ok
        assert found.units == ("millimetre",)
        assert found.products == ("part",)
        assert found.shape.faces == len(brep.faces)
        assert found.shape.edges == len(brep.edges)
        assert found.shape.volume == pytest.approx(integral_properties.volume(moments)[0], rel=1e-9)
        np.testing.assert_allclose(found.shape.centroid, integral_properties.centroid(moments), atol=1e-9)
        assert found.shape.max_tolerance == 1e-7

    def test_conforms_to_the_schema(self, case: str, schema: str) -> None:
        header, instances = parsed(case, schema)
        assert {"ap242": "AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF", "ap214": "AUTOMOTIVE_DESIGN"}[
            schema
        ] in header
        of_header = parser.header_instances(header)
        assert type_faults(of_header) == []
        assert [name for i in of_header.values() for name in i.parts] == [
            "FILE_DESCRIPTION",
            "FILE_NAME",
            "FILE_SCHEMA",
        ]
        assert check.faults(instances, schema) == []
        assert unused(instances) == []

    def test_states_its_volume_area_and_centroid(self, case: str, schema: str) -> None:
        _, instances = parsed(case, schema)
        moments, stated = moments_of(case), validation(instances)
        assert stated["volume"] == pytest.approx(integral_properties.volume(moments)[0], rel=1e-14)
        assert stated["surface area"] == pytest.approx(moments.area.sum(), rel=1e-14)
        np.testing.assert_allclose(stated["centroid"], integral_properties.centroid(moments), atol=1e-14)

    def test_writes_each_point_once(self, case: str, schema: str) -> None:
        _, instances = parsed(case, schema)
        geometry = referenced(instances, ("B_SPLINE_SURFACE_WITH_KNOTS", "B_SPLINE_CURVE_WITH_KNOTS", "VERTEX_POINT"))
        coordinates = parser.of_kind(instances, "CARTESIAN_POINT")
        points = [tuple(v.value for v in coordinates[i][1].value) for i in geometry]
        assert len(set(points)) == len(points)


def ends_of(instances, oriented) -> tuple[str, str]:
    edge = instances[int(oriented[3].value[1:])].parts["EDGE_CURVE"]
    return (edge[1].value, edge[2].value) if oriented[4].value == ".T." else (edge[2].value, edge[1].value)


def test_loops_turn_counter_clockwise_about_the_outward_normal() -> None:
    """The volume under the polygons of a planar box's loops, as a reader that trusts topology would take it."""
    for case in ("box of planes", "mirrored box"):
        _, instances = parsed(case, "ap242")
        place = {
            n: instances[int(v[1].value[1:])].parts["CARTESIAN_POINT"][1]
            for n, v in parser.of_kind(instances, "VERTEX_POINT").items()
        }
        volume = 0.0
        for loop in parser.of_kind(instances, "EDGE_LOOP").values():
            tails = [ends_of(instances, instances[n].parts["ORIENTED_EDGE"])[0] for n in parser.numbers(loop[1])]
            a, b, c, d = (np.array([float(v.value) for v in place[int(t[1:])].value]) for t in tails)
            volume += (a @ np.cross(b, c) + a @ np.cross(c, d)) / 6
        assert volume == pytest.approx(30.0)


def validation(instances) -> dict[str, object]:
    stated: dict[str, object] = {}
    for property_, representation in parser.of_kind(instances, "PROPERTY_DEFINITION_REPRESENTATION").values():
        name = instances[int(property_.value[1:])].parts["PROPERTY_DEFINITION"]
        assert name[0].value == "'geometric validation property'"
        label, items, _ = instances[int(representation.value[1:])].parts["REPRESENTATION"]
        (item,) = (instances[i] for i in parser.numbers(items))
        if "CARTESIAN_POINT" in item.parts:
            stated[label.value.strip("'")] = [float(v.value) for v in item.parts["CARTESIAN_POINT"][1].value]
        else:
            stated[label.value.strip("'")] = float(item.parts["MEASURE_REPRESENTATION_ITEM"][1].value[1].value)
    return stated


def referenced(instances, names) -> set[int]:
    found: set[int] = set()
    for name in names:
        for values in parser.of_kind(instances, name).values():
            candidates = [r for v in values for r in parser.references(v)]
            found.update(r for r in candidates if "CARTESIAN_POINT" in instances[r].parts)
    return found


ROOTS = {
    "APPLIED_ORGANIZATION_ASSIGNMENT",
    "APPLICATION_PROTOCOL_DEFINITION",
    "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION",
    "PRODUCT_RELATED_PRODUCT_CATEGORY",
    "PROPERTY_DEFINITION_REPRESENTATION",
    "SHAPE_DEFINITION_REPRESENTATION",
    "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION",
}


def unused(instances) -> list[str]:
    used = {r for i in instances.values() for values in i.parts.values() for v in values for r in parser.references(v)}
    return [f"#{n} {list(i.parts)}" for n, i in instances.items() if n not in used and not ROOTS & set(i.parts)]


def test_equal_requests_write_equal_bytes_but_for_the_line_of_the_date(tmp_path: Path) -> None:
    texts = []
    for _ in range(2):
        written(drilled_dome(), tmp_path / "part.step", time_stamp=None)
        texts.append((tmp_path / "part.step").read_text().splitlines())
    different = [i for i, (a, b) in enumerate(zip(*texts, strict=True)) if a != b]
    assert different in ([], [4])
    assert re.fullmatch(r"'\d{4}-\d\d-\d\dT[\d:+]+',", texts[0][4])


def test_faces_carry_their_tags_as_names(tmp_path: Path) -> None:
    brep = drilled_dome()
    _, instances = parser.parse(written(brep, tmp_path / "part.step"))
    names = [values[0].value.strip("'") for values in parser.of_kind(instances, "ADVANCED_FACE").values()]
    assert names == [brep.tags[t] for t in brep.faces.tag]


def test_names_of_faces_are_looked_up_only_where_they_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OCCT takes time in proportion to the square of the number of faces: a file that is written and checked needs none."""
    path = tmp_path / "a.step"
    written(plane_box(), path)
    assert read_step(path).face_names == ()
    assert [len(names) for names in read_step(path, with_face_names=True).face_names] == [6]

    def refuse(*_: object) -> None:
        raise AssertionError("the names of faces were looked up")

    monkeypatch.setattr("tpmscad.kernel.step.step_reader._face_names", refuse)
    written(plane_box(), path, verify=lambda file: check_step(file))


def test_a_face_with_a_hole_has_one_outer_bound(tmp_path: Path) -> None:
    _, instances = parser.parse(written(drilled_dome(), tmp_path / "part.step"))
    bounds = [parser.numbers(values[1]) for values in parser.of_kind(instances, "ADVANCED_FACE").values()]
    outer = [sum("FACE_OUTER_BOUND" in instances[b].parts for b in of) for of in bounds]
    assert outer == [1] * 10
    assert sorted(len(of) for of in bounds) == [1] * 8 + [2, 2]


def test_colours_are_read_back_by_tag(tmp_path: Path) -> None:
    chosen = {"side": (1.0, 0.0, 0.0), "hole": (0.0, 0.0, 1.0)}
    text = written(drilled_dome(), tmp_path / "part.step", colours=chosen)
    assert check.faults(parser.parse(text)[1], "ap242") == []
    (found,) = read_coloured_solids(tmp_path / "part.step")
    assert list(found.face_colours) == 4 * [chosen["side"]] + 2 * [None] + 4 * [chosen["hole"]]


def test_a_colour_out_of_range_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="from 0 to 1"):
        written(drilled_dome(), tmp_path / "part.step", colours={"side": (255.0, 0.0, 0.0)})


class TestInstances:
    def test_216_copies_of_one_cell_take_little_room(self, tmp_path: Path) -> None:
        cell, path = CASES["bent frame"](), tmp_path / "lattice.step"
        shifts = 3.0 * np.stack(np.meshgrid(*[np.arange(6)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        text = written(cell, path, instances=[Motion.translations(shifts)])
        assert path.stat().st_size < 1e6
        assert check.faults(parser.parse(text)[1], "ap242") == []
        found = check_step(path)
        assert found.ok
        assert found.shape.solids == 216
        assert found.products == ("lattice cell", "lattice")
        assert found.shape.volume == pytest.approx(
            216 * integral_properties.volume(integral_properties.integrate_faces(cell))[0], rel=1e-9
        )

    def test_copies_stand_where_they_are_put(self, tmp_path: Path) -> None:
        place = Motion(np.stack([np.eye(3), TURN]), np.array([[0.0, 0.0, 0.0], [7.0, -2.0, 1.0]]))
        assert np.linalg.det(TURN) == pytest.approx(1.0)
        written(drilled_dome(), tmp_path / "pair.step", instances=[place])
        centre = integral_properties.centroid(integral_properties.integrate_faces(drilled_dome()))
        found = check_step(tmp_path / "pair.step").shape
        np.testing.assert_allclose(found.centroid, (centre + TURN @ centre + place.translation[1]) / 2, atol=1e-9)

    def test_a_mirror_is_refused(self, tmp_path: Path) -> None:
        mirrored = Motion(np.diag([1.0, 1.0, -1.0])[None], np.zeros((1, 3)))
        with pytest.raises(InvalidRequest, match="mirror the boundary representation instead"):
            written(drilled_dome(), tmp_path / "mirrored.step", instances=[mirrored])


class TestForeignShapes:
    @pytest.mark.parametrize("schema", ["ap242", "ap214"])
    def test_any_shape_is_written_by_the_kernel_and_twice_alike(self, schema: str, tmp_path: Path) -> None:
        from OCP.BRepPrimAPI import BRepPrimAPI_MakeTorus

        path, texts = tmp_path / "ring.stp", []
        for _ in range(2):
            write_shape(BRepPrimAPI_MakeTorus(5.0, 1.5).Shape(), path, schema=schema, name="ring", time_stamp=STAMP)
            texts.append(path.read_bytes())
        assert texts[0] == texts[1]
        found = check_step(path)
        assert found.ok
        assert found.products == ("ring",)
        assert found.shape.volume == pytest.approx(2 * np.pi**2 * 5.0 * 1.5**2, rel=1e-9)

    @pytest.mark.parametrize("radii", [(3.0, 1.0), (1.0, 3.0)])
    def test_a_cone_opens_to_the_side_on_which_it_did(self, radii: tuple[float, float], tmp_path: Path) -> None:
        from OCP.BRepPrimAPI import BRepPrimAPI_MakeCone

        write_shape(BRepPrimAPI_MakeCone(*radii, 4.0).Shape(), tmp_path / "cone.step")
        assert check_step(tmp_path / "cone.step").shape.volume == pytest.approx(np.pi * 4 / 3 * 13, rel=1e-9)

    def test_nothing_is_printed(self, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
        write_shape(build_solids(plane_box()).shape, tmp_path / "box.step")
        check_step(tmp_path / "box.step")
        assert capfd.readouterr() == ("", "")


WRITERS = {
    "complex": lambda path, **how: write_step(plane_box(), build_solids(plane_box()).nesting, path, **how),
    "shape": lambda path, **how: write_shape(build_solids(plane_box()).shape, path, **how),
}


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"no file .*gone"):
        read_step(tmp_path / "gone.step")


@pytest.mark.parametrize("writer", WRITERS)
class TestBadRequests:
    def test_a_path_or_a_schema_that_cannot_be_written_is_refused(self, writer: str, tmp_path: Path) -> None:
        for name, how, words in (
            ("a.iges", {}, r"\.iges.*ending in \.step$"),
            ("nowhere/a.step", {}, r"folder .*nowhere"),
            ("a.step", {"schema": "ap203"}, r"'ap203'.*ap242, ap214"),
        ):
            with pytest.raises(InvalidRequest, match=words):
                WRITERS[writer](tmp_path / name, **how)
        assert list(tmp_path.iterdir()) == []

    def test_interrupted_writing_leaves_what_was_there(
        self, writer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "a.step"
        path.write_text("before")

        def interrupted(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr("os.replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            WRITERS[writer](path)
        assert [p.name for p in tmp_path.iterdir()] == ["a.step"]
        assert path.read_text() == "before"


@pytest.mark.parametrize(("scale", "end"), [(1.0, "1.0"), (2.0**-10, "0.0009765625")])
def test_knots_of_small_splines_of_the_kernel_are_scaled_in_the_file(scale: float, end: str, tmp_path: Path) -> None:
    block = build_solids(voxels(np.ones((1, 1, 1), bool))).solid.scale(scale)
    tpmscad.export_step(block, tmp_path / "block.step")
    surfaces = re.findall(r"B_SPLINE_SURFACE_WITH_KNOTS.*?;", (tmp_path / "block.step").read_text(), re.DOTALL)
    assert len(surfaces) == 6
    assert all(f"(0.0,{end}),(0.0,{end})" in text for text in surfaces)
    report = check_step(tmp_path / "block.step")
    assert report.ok
    assert report.shape.volume == pytest.approx(scale**3 * build_solids(voxels(np.ones((1, 1, 1), bool))).solid.volume)


def test_a_file_that_is_not_verified_is_not_left(tmp_path: Path) -> None:
    seen: list[float] = []

    def verify(path: Path) -> None:
        seen.append(check_step(path).shape.volume)
        raise KernelError("verify", "no")

    with pytest.raises(KernelError, match="verify: no"):
        written(plane_box(), tmp_path / "a.step", verify=verify)
    assert seen == [pytest.approx(30.0)]
    assert list(tmp_path.iterdir()) == []


PART21_REAL = re.compile(r"[+-]?\d+\.\d*(E[+-]?\d+)?")


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_reals_are_part_21_and_read_back_exactly(value: float) -> None:
    assert PART21_REAL.fullmatch(format_real(value))
    assert float(format_real(value)) == value


@given(st.text(st.characters(codec="utf-8", exclude_categories=("Cs",)), max_size=8))
def test_strings_are_printable_ascii_with_quotes_doubled(text: str) -> None:
    quoted = format_string(text)
    assert re.fullmatch(r"'(?:[ -&(-~]|'')*'", quoted)


def test_names_beyond_ascii_come_back(tmp_path: Path) -> None:
    written(plane_box(), tmp_path / "part.step", name="Gitter «ß» d'été")
    assert read_step(tmp_path / "part.step").products == ("Gitter «ß» d'été",)


def test_edges_of_a_loop_are_put_head_to_tail_once_each() -> None:
    face = bd.Box(1, 2, 3).faces()[0]
    edges = [edge.wrapped for edge in face.outer_wire().edges()]
    for order in ([0, 2, 1, 3], [3, 1, 0, 2]):
        chain = occt_topology._chain_edges([edges[i] for i in order], face.wrapped)
        assert len(chain) == 4
        ends = [occt_topology._tail_and_head(edge) for edge in chain]
        assert all(ends[i - 1][1].IsSame(ends[i][0]) for i in range(4))
    with pytest.raises(KernelError, match="not connected"):
        occt_topology._chain_edges([edges[0], edges[2]], face.wrapped)
