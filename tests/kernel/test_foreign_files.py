"""Files from elsewhere are read in a child process: damage, a crash or an endless loop is an error that names the file."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import build123d as bd
import pytest
from OCP.BRep import BRep_Tool
from OCP.Interface import Interface_Static
from OCP.STEPControl import STEPControl_Reader

import tpmscad
from tests.kernel.test_sphere_seams import write_without_pcurves
from tpmscad.atomic_file import validate_output_path
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.body_import.isolated_reader import check_foreign_step, read_foreign_step
from tpmscad.kernel.export.brep_file import write_brep_file
from tpmscad.kernel.export.shape_file import write_shape
from tpmscad.kernel.measure.shape_report import check_shape, check_step, is_valid
from tpmscad.kernel.occt import child_process
from tpmscad.kernel.occt.child_process import ChildFailure, call_in_child
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import shape_from_bytes, shape_to_bytes
from tpmscad.kernel.occt.exploration import edges_of
from tpmscad.kernel.step.coloured_reader import read_coloured_solids
from tpmscad.kernel.step.step_reader import read_step

pytestmark = pytest.mark.kernel

CRASHING = ("DIRECTION('',", "DIRECTION(('',")
"""A text whose change makes OCCT 7.8 and 7.9 read memory that is not theirs."""


@pytest.fixture
def box_file(tmp_path: Path) -> Path:
    write_shape(bd.Box(3, 4, 5), tmp_path / "box.step")
    return tmp_path / "box.step"


def damage(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.fixture(params=["fork", "new interpreter"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "fork" and not child_process.CAN_FORK:
        pytest.skip("this system has no safe fork")
    monkeypatch.setattr(child_process, "CAN_FORK", request.param == "fork")


@pytest.mark.usefixtures("way")
def test_a_child_returns_values_and_errors_and_its_death_is_an_error(tmp_path: Path) -> None:
    assert call_in_child(math.sqrt, 1764.0, seconds=60) == 42.0
    with pytest.raises(tpmscad.InvalidRequest, match=r"ends in '\.txt'"):
        call_in_child(validate_output_path, tmp_path / "a.txt", (".step",), seconds=60)
    with pytest.raises(ChildFailure, match=r"crashed .Segmentation fault"):
        call_in_child(signal.raise_signal, int(signal.SIGSEGV), seconds=60)
    with pytest.raises(ChildFailure, match=r"crashed \(status 3\)"):
        call_in_child(os._exit, 3, seconds=30)
    begun = time.monotonic()
    with pytest.raises(ChildFailure, match=r"did not end within 0\.3 s"):
        call_in_child(time.sleep, 40, seconds=0.3)
    assert time.monotonic() - begun < 30


@pytest.mark.parametrize("read", [read_step, read_coloured_solids])
@pytest.mark.parametrize(
    ("entities", "words"),
    [
        ("", "holds no solid"),
        ("#1=CARTESIAN_POINT('',(0.,0.,0.));\n", "holds no solid: export the part as a solid, not as surfaces"),
        ("#1=FOO(((;\n", "is a damaged file: its text breaks off or cannot be parsed"),
    ],
)
def test_both_readers_refuse_files_without_a_solid_or_that_break_off(
    box_file: Path, read: Callable[[Path], object], entities: str, words: str
) -> None:
    header = box_file.read_text().partition("DATA;")[0]
    box_file.write_text(f"{header}DATA;\n{entities}ENDSEC;\nEND-ISO-10303-21;\n")
    with pytest.raises(tpmscad.InvalidRequest, match=rf"box\.step {words}"):
        read(box_file)


@pytest.mark.parametrize("suffix", ["step", "brep"])
def test_a_face_is_no_part(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"face.{suffix}"
    (bd.export_step if suffix == "step" else bd.export_brep)(bd.Face.make_rect(3, 4), path)
    readers = [read_foreign_step] + [read_coloured_solids] * (suffix == "step")
    for read in readers:
        with pytest.raises(tpmscad.InvalidRequest, match=rf"face\.{suffix} holds no solid: export the part as a solid"):
            read(path)


@pytest.mark.parametrize(
    "read",
    [
        tpmscad.check_step,
        tpmscad.measure,
        lambda path: tpmscad.infill(path, "gyroid", cell=3, thickness=0.3),
        lambda path: tpmscad.render(path, path.with_suffix(".png")),
    ],
    ids=["check", "measure", "infill", "render"],
)
def test_a_file_that_crashes_the_kernel_is_refused_by_name(box_file: Path, read: Callable[[Path], object]) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match=r"box\.step is damaged: the kernel crashed.*export it again"):
        read(damage(box_file, *CRASHING))
    assert os.listdir(box_file.parent) == [box_file.name]


def test_a_file_that_breaks_off_is_refused_in_plain_words(box_file: Path) -> None:
    box_file.write_text(box_file.read_text()[:2000])
    for read in (tpmscad.check_step, tpmscad.measure):
        with pytest.raises(tpmscad.InvalidRequest, match=r"box\.step is a damaged file: its text breaks off"):
            read(box_file)


def test_a_foreign_file_reads_as_in_this_process(box_file: Path) -> None:
    expected = check_step(box_file)
    found = check_foreign_step(box_file)
    assert (found.shape, found.units, found.products) == (expected.shape, expected.units, expected.products)
    foreign = read_foreign_step(box_file)
    assert check_shape(foreign.shape) == expected.shape
    assert foreign.notes == ()


def test_a_shape_survives_bytes_with_its_placed_copies() -> None:
    solid = bd.Box(1, 2, 3).solid()
    copies = make_compound([solid.wrapped, (bd.Pos(5, 0, 0) * solid).wrapped])
    again = shape_from_bytes(shape_to_bytes(copies))
    first, second = (
        bd.Solid(of).faces()[0].wrapped for of in (again_solid.wrapped for again_solid in bd.Compound(again).solids())
    )
    assert first.IsPartner(second)
    assert check_shape(again) == check_shape(copies)


def test_a_file_without_a_unit_is_told(box_file: Path) -> None:
    text = box_file.read_text()
    line = next(line for line in text.splitlines() if "LENGTH_UNIT" in line and "MILLI" in line)
    number = line.partition("=")[0]
    context = text.index("GLOBAL_UNIT_ASSIGNED_CONTEXT")
    box_file.write_text(text[:context] + text[context:].replace(f"{number},", "", 1))
    report = tpmscad.check_step(box_file)
    assert report.units == ()
    assert report.shape.volume == pytest.approx(60.0)
    told = "box.step states no length unit: its numbers were read as millimetres"
    assert report.notes == (told,)
    assert told in report.summary()
    assert read_body(box_file).notes == (told,)


def test_a_name_that_is_no_text_is_refused_and_any_other_is_read(box_file: Path, tmp_path: Path) -> None:
    named = box_file.rename(tmp_path / "Gärtner «ß».step")
    assert tpmscad.check_step(named).ok
    try:
        odd = named.rename(os.fsdecode(os.fsencode(tmp_path) + b"/g\xe4r.step"))
    except OSError:
        pytest.skip("this file system has text names only")
    with pytest.raises(tpmscad.InvalidRequest, match="is no UTF-8 text in this locale: rename it"):
        tpmscad.check_step(odd)


def check_own_box() -> bool:
    return is_valid(bd.Box(1, 1, 1).wrapped)


@pytest.mark.skipif(not child_process.CAN_FORK, reason="the test forks")
def test_a_forked_process_does_not_wait_for_the_kernels_threads() -> None:
    assert check_own_box()  # starts OCCT's threads
    assert call_in_child(check_own_box, seconds=20)


def test_brep_files_are_checked_and_drawn_too(tmp_path: Path) -> None:
    path = tmp_path / "box.brep"
    write_brep_file(bd.Box(3, 4, 5).wrapped, path, 60.0)
    report = tpmscad.check_step(path)
    assert report.ok
    assert report.shape.volume == pytest.approx(60.0)
    assert report.summary().startswith("box.brep: no unit")
    tpmscad.render(path, tmp_path / "box.png", size=(60, 60))
    path.write_text("no shape")
    with pytest.raises(tpmscad.InvalidRequest, match=r"box\.brep is not a BREP file"):
        tpmscad.check_step(path)
    path.write_text("CASCADE Topology V3, (c) Open Cascade")
    with pytest.raises(tpmscad.InvalidRequest, match=r"box\.brep (is a damaged file|holds no solid)"):
        tpmscad.check_step(path)


@pytest.mark.slow
def test_names_beyond_ascii_are_written_and_read_in_a_plain_locale(tmp_path: Path) -> None:
    code = """
import os, sys
from tpmscad.kernel.occt.convert import encode_file_name
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.export.brep_file import read_brep_file, write_brep_file
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox
from pathlib import Path
assert sys.getfilesystemencoding() == "ascii"
write_brep_file(BRepPrimAPI_MakeBox(1.0, 2.0, 3.0).Shape(), Path(os.fsdecode(b"k\\xc3\\xb6rper.brep")), 6.0)
read_brep_file(Path(os.fsdecode(b"k\\xc3\\xb6rper.brep")))
try:
    encode_file_name("k\\u00f6rper.step")
except InvalidRequest as error:
    print("refused", ascii(str(error)))
"""
    plain = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=plain, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "refused" in done.stdout
    assert [os.fsencode(p.name) for p in tmp_path.iterdir()] == ["körper.brep".encode()]


def test_edges_without_pcurves_are_read_to_the_kernels_precision_whatever_accuracy_the_file_states(
    tmp_path: Path,
) -> None:
    body = bd.Sphere(10) - bd.Pos(3, 2, 0) * bd.Rot(20, 10, 0) * bd.Cylinder(3, 40)
    path = write_without_pcurves(body, tmp_path / "pierced.step")
    text = path.read_text()
    assert "PCURVE" not in text
    stated = "UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE("
    path.write_text(re.sub(re.escape(stated) + r"[^)]*", f"{stated}1.E-02", text))
    assert f"{stated}1.E-02" in path.read_text()
    for read in (lambda: [read_step(path).shape], lambda: [part.solid for part in read_coloured_solids(path)]):
        tolerances = [BRep_Tool.Tolerance_s(edge) for shape in read() for edge in edges_of(shape)]
        assert max(tolerances) < 1e-6  # .0068 mm otherwise
    STEPControl_Reader().ReadFile(str(path))
    assert Interface_Static.IVal_s("read.precision.mode") == 0
