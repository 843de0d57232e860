"""CAD files as they come: formats by content, several solids, faces that close, invalid solids; what is repaired is told."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

import build123d as bd
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.Geom import Geom_Plane
from OCP.gp import gp_Dir, gp_Pnt
from OCP.IGESControl import IGESControl_Writer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Shape

import tpmscad
from tpmscad.kernel.body_import import healing
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.body_import.cad_formats import recognise_format
from tpmscad.kernel.body_import.healing import MAX_ARC_READINGS, find_turned_arcs, heal_solid, volume_agrees
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.long_arcs import CircularEdges
from tpmscad.kernel.step.step_reader import read_step

pytestmark = pytest.mark.kernel

BORED = bd.Box(30, 40, 50) - bd.Cylinder(5, 60)


def write_iges(shape: TopoDS_Shape, path: Path, *, unit: str = "MM", solids: bool = False) -> Path:
    writer = IGESControl_Writer(unit, int(solids))
    writer.AddShape(shape)
    writer.ComputeModel()
    assert writer.Write(str(path))
    return path


def write_brep(shape: TopoDS_Shape, path: Path) -> Path:
    bd.export_brep(bd.Shape(shape), path)
    return path


def loose_faces(shape: bd.Shape, lifted: float = 0.0) -> TopoDS_Shape:
    """The faces of a shape without common edges, the first moved by a vector along x, y and z."""
    copies = map(bd.Face, faces_of(shape))
    moved = [face.moved(bd.Location((lifted,) * 3 if i == 0 else (0, 0, 0))) for i, face in enumerate(copies)]
    return make_compound(convert.shape_from_bytes(convert.shape_to_bytes(face.wrapped)) for face in moved)


WRITERS: dict[str, Callable[[Path], Path]] = {
    "part.step": lambda path: bd.export_step(BORED, path) and path,
    "part.igs": lambda path: write_iges(BORED.wrapped, path),
    "solid.iges": lambda path: write_iges(BORED.solid().wrapped, path, solids=True),
    "inches.igs": lambda path: write_iges(BORED.wrapped, path, unit="INCH"),
    "part.brep": lambda path: write_brep(BORED.wrapped, path),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_body_is_the_same_from_every_format_whatever_its_file_is_called(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / name)
    called = path.rename(tmp_path / "other.xyz")
    found = tpmscad.read_body(called)
    assert check_shape(found.shape).volume == pytest.approx(BORED.volume, rel=1e-7)
    assert check_shape(found.shape).ok
    (entry,) = found.solids
    assert entry.size == pytest.approx((30, 40, 50), abs=1e-5)
    assert entry.faces == {"plane": 6, "surfaceofrevolution" if found.healed else "cylinder": 1}
    assert bool(found.healed) == (name in ("part.igs", "inches.igs")), "only faces have to be sewn"
    assert read_body(found).volume == pytest.approx(entry.volume)
    assert recognise_format(called) == {"step": "STEP", "brep": "BREP"}.get(name.partition(".")[2], "IGES")


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("name", ["part.brep", "part.step"])
def test_a_file_cut_short_is_called_damaged(name: str, part: float, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / name)
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    with pytest.raises(tpmscad.InvalidRequest, match=rf"{name} is a damaged file: its text breaks off"):
        tpmscad.read_body(path)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("note.igs", "is not an IGES file: columns 73 to 80"),
        ("note.brep", "is not a BREP file"),
        ("note.stp", "is not a STEP file"),
    ],
)
def test_a_text_is_no_cad_file(name: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("a note\n")
    with pytest.raises(tpmscad.InvalidRequest, match=words):
        tpmscad.read_body(tmp_path / name)


def write_rig(path: Path, plate: bd.Part) -> Path:
    """Two nuts and a plate between them."""
    parts = [bd.Pos(20, 0, 0) * bd.Box(5, 6, 7), plate, bd.Pos(-20, 0, 0) * bd.Box(5, 6, 7)]
    for part, label in zip(parts, ("left nut", "plate", "right nut"), strict=True):
        part.label = label
    bd.export_step(bd.Compound(label="rig", children=parts), path)
    return path


@pytest.fixture(scope="module")
def assembly(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rig(tmp_path_factory.mktemp("assembly") / "assembly.step", bd.Box(10, 11, 12))


def test_solids_of_an_assembly_are_listed_and_chosen_by_number_or_size(assembly: Path) -> None:
    found = tpmscad.read_body(assembly)
    assert [entry.number for entry in found.solids] == [1, 2, 3]
    assert [entry.name for entry in found.solids] == ["rig/left nut", "rig/plate", "rig/right nut"]
    assert [entry.volume for entry in found.solids] == pytest.approx([210, 1320, 210])
    assert found.bodies[0].volume == pytest.approx(1320)
    assert any("taken of the 3 solids" in note and "plate" in note for note in found.notes)
    third = tpmscad.read_body(assembly, solid=3)
    assert check_shape(third.shape).centroid[0] == pytest.approx(-20)
    every = tpmscad.read_body(assembly, solid="all")
    assert check_shape(every.shape).solids == 3
    assert not any("taken of" in note for note in every.notes)


def test_several_solids_are_refused_with_the_list_until_one_is_chosen(assembly: Path) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match=r"3 solids: choose one .*solid=1.*3 'rig/right nut' 5 x 6 x 7 mm"):
        read_body(assembly)
    with pytest.raises(tpmscad.InvalidRequest, match=r"no solid 4, but 3 solids: 1 'rig/left nut'"):
        tpmscad.read_body(assembly, solid=4)
    with pytest.raises(tpmscad.InvalidRequest, match="is unknown; choose one of 'largest', 'all'"):
        tpmscad.read_body(assembly, solid="smallest")
    with pytest.raises(tpmscad.InvalidRequest, match="3 solids were chosen"):
        read_body(tpmscad.read_body(assembly, solid="all"))
    with pytest.raises(tpmscad.InvalidRequest, match=r"has been read: give solid= to tpmscad\.read_body"):
        read_body(tpmscad.read_body(assembly), 1)


def test_solids_of_a_shape_are_chosen_too() -> None:
    two = bd.Box(1, 1, 1) + bd.Pos(5, 0, 0) * bd.Box(2, 2, 2)
    assert read_body(two, "largest").volume == pytest.approx(8)
    assert read_body(two, 1).volume + read_body(two, 2).volume == pytest.approx(9)


def test_loose_faces_are_sewn_within_a_hundred_thousandth_of_their_size(tmp_path: Path) -> None:
    box = bd.Box(60, 60, 60)
    size = 60 * 3**0.5
    for gap, closes in ((0.0, True), (3e-7 * size, True), (4e-6 * size, True), (3e-5 * size, False)):
        path = write_brep(loose_faces(box, gap / 3**0.5), tmp_path / "faces.brep")
        if closes:
            found = tpmscad.read_body(path)
            assert found.bodies[0].volume == pytest.approx(60**3, rel=1e-5)
            (told,) = found.healed
            assert "its 6 faces were sewn within" in told
            assert found.solids[0].edge_tolerance >= 0.4 * gap
            assert any("edges lie up to" in note for note in found.notes) == (gap > 1e-6)
            with pytest.raises(tpmscad.InvalidRequest, match=r"holds no solid.*heal=True makes solids of its faces"):
                tpmscad.read_body(path, heal=False)
        else:
            with pytest.raises(
                tpmscad.InvalidRequest, match=r"do not close .*: 8 edges bound one face only.*longest chain"
            ):
                tpmscad.read_body(path)


def without_lid(box: bd.Part) -> bd.Shell:
    return bd.Shell([face for face in box.faces() if face.normal_at().Z < 0.5])


def test_open_boxes_are_refused_with_the_length_and_the_place_of_the_longest_rim(tmp_path: Path) -> None:
    boxes = [bd.Pos(30, 0, 0) * bd.Box(2, 2, 2), bd.Box(12, 10, 8), bd.Pos(-30, 0, 0) * bd.Box(3, 3, 3)]
    path = write_brep(make_compound(without_lid(box).wrapped for box in boxes), tmp_path / "open.brep")
    with pytest.raises(tpmscad.InvalidRequest, match=r"12 edges bound one face only, .* 44 mm, at \(.*, 4\)"):
        tpmscad.read_body(path)


def test_a_closed_shell_within_another_is_a_cavity(tmp_path: Path) -> None:
    shells = [bd.Box(10, 10, 10).shells()[0].wrapped, bd.Pos(1, 1, 1) * bd.Box(4, 4, 4)]
    inner = shells[1].shells()[0].wrapped
    within = (bd.Pos(1, 1, 1) * bd.Box(2, 2, 2)).shells()[0].wrapped
    path = write_brep(make_compound([inner.Reversed(), within, shells[0]]), tmp_path / "shells.brep")
    found = tpmscad.read_body(path, solid="all")
    assert sorted(body.volume for body in found.bodies) == pytest.approx([8, 1000 - 64])
    assert "3 closed shells; made 2 solids of 944 mm3" in found.healed[0]


def test_a_solid_inside_out_is_turned_and_its_volumes_are_told(tmp_path: Path) -> None:
    path = write_brep(bd.Box(2, 3, 4).solid().wrapped.Reversed(), tmp_path / "inverse.brep")
    found = tpmscad.read_body(path)
    assert found.bodies[0].volume == pytest.approx(24)
    assert "turned round; its volume was -24 mm3 and is 24 mm3" in found.healed[0]
    assert f"healed: {found.healed[0]}" in read_body(path).notes
    with pytest.raises(tpmscad.InvalidRequest, match=r"is inside out: its volume is -24; heal=True repairs it"):
        tpmscad.read_body(path, heal=False)


def misplaced_vertex(off: float) -> TopoDS_Shape:
    """A box with a vertex beside the ends of its edges, within no tolerance."""
    box = bd.Box(20, 20, 20).solid()
    vertex = box.vertices()[0].wrapped
    at = BRep_Tool.Pnt_s(vertex)
    BRep_Builder().UpdateVertex(vertex, gp_Pnt(at.X() + off, at.Y(), at.Z()), 1e-7)
    return box.wrapped


def test_a_vertex_beside_its_edges_is_healed(tmp_path: Path) -> None:
    found = tpmscad.read_body(write_brep(misplaced_vertex(1e-4), tmp_path / "near.brep"))
    assert "changed by the kernel's shape healing; its volume was 8000 mm3 and is 8000" in found.healed[0]


def lifted_face(off: float) -> TopoDS_Shape:
    """A box with the plane of a face beside its edges."""
    box = bd.Box(20, 20, 20).solid()
    face = box.faces().sort_by(bd.Axis.Z)[-1].wrapped
    BRep_Builder().UpdateFace(face, Geom_Plane(gp_Pnt(0, 0, 10 + off), gp_Dir(0, 0, 1)), TopLoc_Location(), 1e-7)
    return box.wrapped


@pytest.mark.parametrize("off", [3.0, 0.05, 0.001])
def test_a_face_farther_off_its_edges_than_faces_are_sewn_cannot_be_healed(off: float, tmp_path: Path) -> None:
    path = write_brep(lifted_face(off), tmp_path / "far.brep")
    with pytest.raises(tpmscad.InvalidRequest, match=r"BRepCheck.: face \d .*; no way of healing makes it sound"):
        tpmscad.read_body(path)
    report = tpmscad.check_step(path)
    assert not report.ok
    assert "cannot be healed" in report.healing[0]


def test_a_face_a_little_off_its_edges_is_healed_and_the_gap_is_told(tmp_path: Path) -> None:
    found = tpmscad.read_body(write_brep(lifted_face(1e-4), tmp_path / "near.brep"))
    assert "changed by the kernel's shape healing" in found.healed[0]
    assert any("edges lie up to 0.0001 mm off their faces" in note for note in found.notes)


def test_what_healing_leaves_invalid_or_of_another_volume_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    invalid = convert.as_solid(misplaced_vertex(1e-4))
    report = check_shape(invalid)
    assert heal_solid(invalid, report, None) is not None
    with monkeypatch.context() as changed:
        changed.setattr(healing, "_fix", lambda solid: [solid])
        assert heal_solid(invalid, report, None) is None
    monkeypatch.setattr(healing, "volume_agrees", lambda solid, report: False)
    assert heal_solid(invalid, report, None) is None


def pocketed() -> bd.Part:
    """A plate with three pockets between arcs of 60 degrees, and a round boss with a flat, whose arc is long and right."""
    arc, other = bd.CenterArc((0, 0), 12, 20, 60), bd.CenterArc((0, 0), 20, 20, 60)
    sides = [bd.Line(arc @ end, other @ end) for end in (0, 1)]
    pocket = bd.extrude(bd.make_face([arc, other, *sides]), 5)
    boss = bd.Pos(-30, -30, 10) * (bd.Cylinder(6, 20) - bd.Pos(7, 0, 0) * bd.Box(6, 20, 30))
    pockets = [bd.Pos(0, 0, 5) * bd.Rot(0, 0, angle) * pocket for angle in (0, 120, 240)]
    return bd.Box(80, 80, 20) + boss - pockets


def flip_arcs(path: Path, radius: float, most: int) -> int:
    """Write the wrong sense of the first edges on circles of a radius; their number."""
    text = path.read_text()
    circles = set(re.findall(rf"#(\d+) = CIRCLE\('',#\d+,{radius:g}\.\)", text))
    curves = circles | {
        curve for curve, of in re.findall(r"#(\d+) = (?:SURFACE|SEAM)_CURVE\('',#(\d+),", text) if of in circles
    }
    count = 0

    def flip(match: re.Match[str]) -> str:
        nonlocal count
        if match[2] not in curves or count == most:
            return match[0]
        count += 1
        return f"{match[1]}{match[2]},.{'F' if match[3] == 'T' else 'T'}.)"

    path.write_text(re.sub(r"(EDGE_CURVE\('',#\d+,#\d+,#)(\d+),\.([TF])\.\)", flip, text))
    return count


def test_arcs_that_run_the_long_way_round_are_turned_and_right_ones_are_not(tmp_path: Path) -> None:
    body, path = pocketed(), tmp_path / "pocket.step"
    bd.export_step(body, path)
    assert tpmscad.read_body(path).healed == ()
    assert flip_arcs(path, 20, 2) == 2
    assert not check_shape(read_step(path).shape).ok
    found = tpmscad.read_body(path)
    (told,) = found.healed
    assert re.search(
        r"BRepCheck.*turned 2 circular edges, which run the wrong way round: entity \d+, \d+ of the file", told
    )
    assert found.bodies[0].volume == pytest.approx(body.volume, rel=1e-9)
    assert found.solids[0].volume == pytest.approx(body.volume, rel=1e-9)
    report = tpmscad.check_step(path)
    assert (report.ok, report.healing) == (False, (told,))
    assert told in report.summary()
    with pytest.raises(tpmscad.InvalidRequest, match="heal=True repairs it if it can be repaired"):
        tpmscad.read_body(path, heal=False)
    other = write_brep(read_step(path).shape, tmp_path / "pocket.brep")  # which says nothing of the arcs any more
    with pytest.raises(tpmscad.InvalidRequest, match=r"InvalidImbricationOfWires; no way of healing makes it sound"):
        tpmscad.read_body(other)


PAIRS = tuple((i, i + 1) for i in range(1, 13, 2))


@given(st.sets(st.sampled_from(PAIRS)), st.sets(st.sampled_from(PAIRS)), st.sets(st.integers(20, 25)))
def test_the_search_finds_the_arcs_to_be_turned_and_no_others(
    wrong: set[tuple[int, int]], suspect: set[tuple[int, int]], wrong_circles: set[int]
) -> None:
    assume(wrong_circles or wrong - {(1, 2)})
    wanted, readings = {arc for pair in wrong for arc in pair} | wrong_circles, 0

    def count_faults(turned: Collection[int]) -> int:
        nonlocal readings
        readings += 1
        return len((set(turned) ^ wanted) - {1, 2})  # of the first pair both states are valid

    arcs = CircularEdges(PAIRS, tuple(sorted(suspect)), tuple((i,) for i in range(20, 26)))
    assert find_turned_arcs(arcs, count_faults) == wanted - {1, 2}
    assert readings <= MAX_ARC_READINGS


def test_the_search_gives_up_where_faults_remain() -> None:
    arcs = CircularEdges(((1, 2),), ((1, 2),), ((3,),))
    assert find_turned_arcs(arcs, lambda turned: 1 + len(turned)) == frozenset()


def test_arcs_that_are_not_shown_to_be_needed_in_time_are_not_turned() -> None:
    arcs = CircularEdges(((1, 2), (3, 4)), (), ())
    assert find_turned_arcs(arcs, lambda turned: 0 if {1, 2} <= set(turned) else 1) == {1, 2}
    assert find_turned_arcs(arcs, lambda turned: 0 if {1, 2} <= set(turned) else 1, seconds=-1.0) == frozenset()


def test_a_volume_that_its_points_do_not_confirm_is_not_believed() -> None:
    ball = bd.Sphere(3).solid().wrapped
    report = check_shape(ball)
    assert volume_agrees(ball, report)
    for factor in (0.8, 1.2, -1.0):
        assert not volume_agrees(ball, replace(report, volume=factor * report.volume))


@pytest.mark.parametrize(("prefix", "scale"), [("MILLI", 1.0), ("CENTI", 10.0)])
def test_the_accuracy_that_a_file_states_is_told_in_millimetres(prefix: str, scale: float, tmp_path: Path) -> None:
    path = tmp_path / "box.step"
    bd.export_step(bd.Box(2, 3, 4), path)
    text = re.sub(r"(UNCERTAINTY_MEASURE_WITH_UNIT\(LENGTH_MEASURE\()[^)]*", r"\g<1>2.E-03", path.read_text())
    path.write_text(text.replace("SI_UNIT(.MILLI.,.METRE.)", f"SI_UNIT(.{prefix}.,.METRE.)"))
    found = tpmscad.read_body(path)
    assert found.accuracy == pytest.approx(0.002 * scale)
    assert found.notes == ()
    report = tpmscad.check_step(path)
    assert report.accuracy == pytest.approx(0.002 * scale)
    assert report.shape.volume == pytest.approx(24 * scale**3)


def test_the_resolution_of_an_iges_file_is_its_accuracy(tmp_path: Path) -> None:
    assert tpmscad.read_body(write_iges(BORED.wrapped, tmp_path / "b.igs")).accuracy == pytest.approx(1e-7)


def test_a_check_lists_solids_and_reports_on_one(assembly: Path) -> None:
    report = tpmscad.check_step(assembly)
    assert [entry.name for entry in report.solids] == ["rig/left nut", "rig/plate", "rig/right nut"]
    assert "solid       2 'rig/plate' 10 x 11 x 12 mm, 1320 mm3; faces: 6 plane" in report.summary()
    one = tpmscad.check_step(assembly, solid=2)
    assert (one.shape.solids, one.shape.volume) == (1, pytest.approx(1320))
    assert [entry["number"] for entry in one.to_dict()["solid_table"]] == [2]
    with pytest.raises(tpmscad.InvalidRequest, match="no solid 5"):
        tpmscad.check_step(assembly, solid=5)


def test_all_solids_are_filled_each_by_itself_under_its_name(tmp_path: Path) -> None:
    assembly = write_rig(tmp_path / "rig.step", bd.Box(6.8, 6, 7))
    wanted = {"cell": 40 / 6, "thickness": 1.0, "tol": 0.1, "progress": False}
    every = tpmscad.infill(assembly, "schwarz_p", solid="all", **wanted)
    parts = [tpmscad.infill(assembly, "schwarz_p", solid=number, **wanted) for number in (1, 2)]
    parts.append(parts[0])  # the right nut lies six cells from the left one
    assert every.piece_names[0] == "plate"
    assert {of.name for of in every.named_solids()} == {"left nut", "plate", "right nut"}
    assert every.certificate.met
    assert every.volume == pytest.approx(sum(part.volume for part in parts), rel=1e-9)
    assert every.certificate.betti == tuple(np.sum([part.certificate.betti for part in parts], axis=0))
    assert every.certificate.pieces == pytest.approx(sorted((part.volume for part in parts), reverse=True))
    assert every.certificate.max_deviation == max(part.certificate.max_deviation for part in parts)
    every.export(tmp_path / "filled.step")
    names = re.findall(r"MANIFOLD_SOLID_BREP\('([^']*)'", (tmp_path / "filled.step").read_text())
    assert sorted(names) == ["left nut", "plate", "right nut"]
    with pytest.raises(tpmscad.InvalidRequest, match="numbers in open_faces are those of one solid"):
        tpmscad.infill(assembly, "schwarz_p", solid="all", skin=0.5, open_faces=[1], **wanted)


def test_fluid_domains_take_one_solid_only(assembly: Path) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match="solid 'all' is unknown; choose one of 'largest';"):
        tpmscad.fluid_domains(assembly, "schwarz_p", cell=5, thickness=1.0, solid="all")


@pytest.mark.parametrize(("in_inches", "sizes", "far"), [(2, (10.0, 25.4), 62.7), (0, (10.0, 1.0), 1270.5)])
def test_parts_of_an_assembly_in_several_units_have_their_own_true_sizes(
    in_inches: int, sizes: tuple[float, float], far: float, tmp_path: Path
) -> None:
    """The contexts of geometry are those of the assembly, of its first part and of its second."""
    path = tmp_path / "rig.step"
    bd.export_step(bd.Compound(children=[bd.Box(10, 10, 10), bd.Pos(50, 0, 0) * bd.Box(1, 2, 3)]), path)
    text = path.read_text()
    length = re.findall(r"#(\d+) = \( LENGTH_UNIT\(\) NAMED_UNIT\(\*\) SI_UNIT\(\.MILLI\.,\.METRE\.\) \);", text)
    inch = "(CONVERSION_BASED_UNIT('INCH',#9001) LENGTH_UNIT() NAMED_UNIT(#9002));"
    text = re.sub(rf"#{length[in_inches]} = [^;]*;", f"#{length[in_inches]} = {inch}", text)
    more = (
        "#9001 = LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#9003);\n#9002 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);\n"
        "#9003 = (LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.));\n"
    )
    path.write_text(text.replace("DATA;\n", f"DATA;\n{more}", 1))
    found = [np.ptp(np.array(read_body(path, number).report.bounds), axis=0) for number in (1, 2)]
    assert np.allclose([size[0] for size in found], sizes)
    assert np.allclose(found[1], sizes[1] * np.array([1, 2, 3]))
    report = tpmscad.check_step(path)
    assert {unit.lower() for unit in report.units} == {"millimetre", "inch"}
    assert report.shape.bounds[1][0] == pytest.approx(far)
