"""The FreeCAD workbench: its command, its runs with programs that stand in, and the whole way inside FreeCAD, where that is."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import typer

import tpmscad
from freecad.tpmscad_workbench import infill_run
from freecad.tpmscad_workbench.infill_run import Cancelled, FillRun, FillSettings, Refusal
from tpmscad import cli
from tpmscad.catalogue import CATALOGUE, CORES
from tpmscad.recipe.solid_recipe import read_solid_recipe
from tpmscad.strut_cells import KINDS

ROOT = Path(__file__).resolve().parents[2]
WORKBENCH = ROOT / "freecad" / "tpmscad_workbench"
EVERY_SETTING = FillSettings(
    cell="8,8,10",
    wall="offset",
    wall_value="-0.6,0.4",
    skin="1",
    open_faces="Face3, >Z",
    tol="0.05",
    more="--solid 2",
    keep="holes 2",
    clear="Bolt, Nut",
)
FINISHED = """
echo '{"stage": "trim", "done": 0.25}' >&2
echo 'a warning' >&2
printf '{"stage": "wri' >&2; sleep 0.3; echo 'te", "done": 0.0}' >&2
echo met; echo 'wrote       filled.step'; echo '{"volume": 2.5}' >filled.json; touch filled.step
"""


def stand_in(folder: Path, script: str) -> list[str]:
    """A program of a shell script."""
    program = folder / "program"
    program.write_text(f"#!/bin/sh\n{script}")
    program.chmod(0o755)
    return [str(program)]


@pytest.fixture
def real_program(tmp_path: Path) -> list[str]:
    """The command line of this source tree."""
    return stand_in(tmp_path, f'PYTHONPATH="{ROOT}" exec "{sys.executable}" -m tpmscad "$@"\n')


def test_a_command_holds_what_is_given_and_nothing_else() -> None:
    command = infill_run.build_command(["tpmscad"], FillSettings(skin=" "))
    assert " ".join(command) == (
        "tpmscad infill body.step gyroid --kind=sheet --cell=10 --thickness=1 "
        "--output=filled.step --report=filled.json --progress=lines"
    )


def test_names_of_faces_become_numbers_and_values_with_a_minus_stay_values() -> None:
    command = infill_run.build_command(["tpmscad"], EVERY_SETTING)
    assert "--open-faces=2, >Z" in command
    assert "--offset=-0.6,0.4" in command
    assert command[command.index("--solid") + 1] == "2"


@pytest.mark.parametrize("wall", infill_run.WALLS)
def test_the_program_knows_every_option(wall: str) -> None:
    options = {
        option
        for parameter in typer.main.get_command(cli.make_app("infill")).commands["infill"].params  # type: ignore[attr-defined]
        for option in parameter.opts
    }
    settings = FillSettings.from_json(json.dumps({**vars(EVERY_SETTING), "wall": wall, "more": ""}))
    words = infill_run.build_command(["tpmscad"], settings)[4:]
    assert len(words) == 11
    assert {word.partition("=")[0] for word in words} <= options


def test_settings_come_back_from_their_text() -> None:
    assert FillSettings.from_json(EVERY_SETTING.to_json()) == EVERY_SETTING


def test_an_open_quotation_is_refused() -> None:
    with pytest.raises(Refusal, match=r"further options '--phase \"0,0,0': No closing quotation"):
        infill_run.build_command(["tpmscad"], FillSettings(more='--phase "0,0,0'))


def test_a_program_is_found_on_path_and_a_python_runs_the_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("tpmscad", "python3.12"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert infill_run.find_program() == [str(tmp_path / "tpmscad")]
    assert infill_run.find_program(f" {tmp_path}/python3.12") == [f"{tmp_path}/python3.12", "-m", "tpmscad"]
    (tmp_path / "tpmscad").unlink()
    with pytest.raises(Refusal, match=r"not on PATH: install tpmscad .* Edit > Preferences > tpmscad"):
        infill_run.find_program("")
    with pytest.raises(Refusal, match=r"/no/such is no program"):
        infill_run.find_program("/no/such")


def test_the_variables_of_a_bundle_do_not_reach_the_program(tmp_path: Path) -> None:
    bundle = {"APPDIR": "/tmp/.mount", "PYTHONHOME": "/tmp/.mount/usr", "PYTHONPATH": "/tmp/.mount/usr/lib"}
    given = {**bundle, "HOME": "/home/u", "LD_LIBRARY_PATH": os.pathsep.join(["/tmp/.mount/usr/lib", "/opt/lib"])}
    made = infill_run.make_environment(given, tmp_path)
    assert not set(bundle) & set(made)
    assert (made["HOME"], made["LD_LIBRARY_PATH"], made["TMPDIR"]) == ("/home/u", "/opt/lib", str(tmp_path))
    assert "LD_LIBRARY_PATH" not in infill_run.make_environment({"APPDIR": "/a", "LD_LIBRARY_PATH": "/a/b"}, tmp_path)


def test_a_run_tells_its_steps_and_gives_what_was_made(tmp_path: Path) -> None:
    run = FillRun(stand_in(tmp_path, FINISHED), tmp_path)
    told: list[tuple[str, float]] = []
    filled = run.wait(lambda stage, done: told.append((stage, done)))
    assert ("trim", 0.25) in told
    assert (run.stage, run.done) == ("write", 0.0)
    assert (filled.summary, filled.warnings) == ("met", ("a warning",))
    assert filled.certificate == {"volume": 2.5}
    assert filled.step.exists()


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("echo noise >&2; echo 'tpmscad: cell -1 must be above zero' >&2; exit 2", r"^cell -1 must be above zero$"),
        ("printf 'Segmentation fault' >&2; exit 139", r"^Segmentation fault$"),
        ("exit 3", r"program ended with status 3 and no word$"),
    ],
)
def test_a_failed_run_ends_with_the_words_of_the_program(tmp_path: Path, script: str, message: str) -> None:
    with pytest.raises(Refusal, match=message):
        FillRun(stand_in(tmp_path, script), tmp_path).wait()


def test_a_program_that_cannot_start_is_refused(tmp_path: Path) -> None:
    (tmp_path / "program").write_text("no program")
    with pytest.raises(Refusal, match="program does not start: Permission denied"):
        FillRun([str(tmp_path / "program")], tmp_path)


def test_a_cancelled_program_that_goes_on_is_killed_with_its_children(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(infill_run, "GRACE_SECONDS", 0.3)
    run = FillRun(stand_in(tmp_path, "trap '' INT; sleep 60 & echo $! >child; wait; sleep 60"), tmp_path)
    while not ((tmp_path / "child").exists() and (tmp_path / "child").read_text()):
        time.sleep(0.02)
    run.cancel()
    began = time.monotonic()
    with pytest.raises(Cancelled):
        run.wait()
    assert time.monotonic() - began > 0.2, "it had time to end by itself"
    state = Path(f"/proc/{(tmp_path / 'child').read_text().strip()}/stat")
    assert not state.exists() or state.read_text().split()[2] == "Z"


def test_a_refusal_of_the_real_program_arrives(real_program: list[str], tmp_path: Path) -> None:
    (tmp_path / "body.step").touch()
    run = FillRun(infill_run.build_command(real_program, FillSettings(cell="8,5 mm")), tmp_path)
    with pytest.raises(Refusal, match=r"'--cell': '8,5 mm' .* leave the unit out"):
        run.wait()


def test_the_structures_are_those_of_the_program(real_program: list[str], tmp_path: Path) -> None:
    struts = [f"{kind} struts" for kind in KINDS]
    found = infill_run.list_structures(real_program, tmp_path)
    assert [name for titles in found.values() for name in titles] == [*CATALOGUE, *CORES, *struts, "recipe"]
    with pytest.raises(Refusal, match=r"program does not list its structures \(broken\)"):
        infill_run.list_structures(stand_in(tmp_path, "echo broken >&2; exit 1"), tmp_path)


@pytest.mark.parametrize("path", sorted(WORKBENCH.glob("*.py")), ids=lambda path: path.name)
def test_a_module_can_be_read_by_the_oldest_python_and_needs_no_tpmscad(path: Path) -> None:
    tree = ast.parse(path.read_text(), feature_version=(3, 8))
    names = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    names += [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    assert not [name for name in names if str(name).split(".")[0] == "tpmscad"]


def test_the_metadata_name_what_is_there() -> None:
    space = {"": "https://wiki.freecad.org/Package_Metadata"}
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.findtext("version", namespaces=space) == tpmscad.__version__
    icons = [*package.iterfind("icon", space), *package.iterfind("content/workbench/icon", space)]
    assert len(icons) == 2
    for icon in icons:
        assert ElementTree.parse(ROOT / str(icon.text)).getroot().tag.endswith("svg")
    name = package.findtext("content/workbench/classname", namespaces=space)
    assert f"class {name}(" in (WORKBENCH / "init_gui.py").read_text()


IN_FREECAD = """
import json, os, sys
try:
    import FreeCAD
    import Part
    import freecad.tpmscad_workbench  # found as an addon is
    from freecad.tpmscad_workbench import filled_objects
    from freecad.tpmscad_workbench.infill_run import FillSettings, Refusal

    FreeCAD.ParamGet(filled_objects.PREFERENCES).SetString("Program", os.environ["TPMSCAD_PROGRAM"])
    document = FreeCAD.newDocument("block")
    box, bore = document.addObject("Part::Box", "Box"), document.addObject("Part::Cylinder", "Bore")
    box.Length, box.Width, box.Height, bore.Radius, bore.Height = 12, 10, 8, 1.5, 8
    bore.Placement.Base = FreeCAD.Vector(6, 5, 0)
    cut, part = document.addObject("Part::Cut", "Block"), document.addObject("App::Part", "Part")
    cut.Base, cut.Tool = box, bore
    part.addObject(cut)
    part.Placement.Base = FreeCAD.Vector(100, 0, 0)
    document.recompute()
    sides = [face for face in cut.Shape.Faces if abs(face.CenterOfMass.x - 12) < 1e-6]
    number = [face.isSame(sides[0]) for face in cut.Shape.Faces].index(True) + 1
    told, answer = [], {}
    settings = FillSettings(cell="8", skin="1", tol="0.1", open_faces="Face%d" % number, keep="holes 1.7")
    filled = filled_objects.fill(cut, settings, lambda stage, done: told.append(stage))
    for name in filled_objects.PROPERTIES:
        value = getattr(filled, name) if name != "Body" else filled.Body.Name
        answer[name] = value if isinstance(value, (str, float)) else len(value)
    filled.Density = 2.5
    document.recompute()
    filled_objects.save(filled, os.environ["ANSWER"] + ".step")
    saved = Part.Shape()
    saved.read(os.environ["ANSWER"] + ".step")
    answer.update(Heavier=filled.Mass, Saved=saved.Volume)
    hollow = Part.makeBox(4, 4, 4).cut(Part.makeBox(1, 1, 2, FreeCAD.Vector(2, 2, 1)))
    answer["Hollow"] = [[*centre, volume] for centre, volume in filled_objects.find_cavities(hollow)]
    answer.update(Certificate=list(filled.Certificate), Told=told, Valid=filled.Shape.isValid(), Volume=filled.Shape.Volume)
    plane = [face for face in filled.Shape.Faces if face.Surface.TypeId == "Part::GeomPlane"]
    at = lambda x: sum(face.Area for face in plane if abs(face.CenterOfMass.x - x) < 1e-6)
    answer.update(Opened=at(112), Closed=at(100))
    plane = document.addObject("Part::Plane", "Sheet")
    for name, other, keep in (("NoSolid", plane, ""), ("Thick", cut, ""), ("NoBoss", cut, "Boss")):
        document.recompute()
        try:
            filled_objects.fill(other, FillSettings(cell="8", wall_value="9", keep=keep))
        except Refusal as refusal:
            answer[name] = str(refusal)
    body = document.addObject("PartDesign::Body", "Design")
    inside, link = body.newObject("PartDesign::AdditiveBox", "Pad"), document.addObject("App::Link", "Link")
    body.Placement.Base, link.LinkedObject, link.Placement.Base = FreeCAD.Vector(50, 0, 0), body, FreeCAD.Vector(0, 0, 70)
    document.recompute()
    answer["Places"] = [list(filled_objects.placed_shape(one).CenterOfMass) for one in (body, inside, link)]
    answer["Owned"] = [filled_objects.is_face_of(body, one) for one in (body, inside, cut)]
    open(os.environ["ANSWER"], "w").write(json.dumps(answer))
except Exception:
    import traceback
    open(os.environ["ANSWER"], "w").write(json.dumps(traceback.format_exc()))
os._exit(0)  # FreeCAD's own ending knows no status
"""


@pytest.mark.kernel
@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("freecadcmd") is None, reason="FreeCAD is not installed: apt-get install freecad-python3"
)
def test_a_body_is_filled_inside_freecad(real_program: list[str], tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(IN_FREECAD)
    (tmp_path / "Mod").mkdir()
    (tmp_path / "Mod" / "tpmscad").symlink_to(ROOT)
    places = {"HOME": str(tmp_path), "FREECAD_USER_HOME": str(tmp_path), "ANSWER": str(tmp_path / "answer.json")}
    subprocess.run(
        ["freecadcmd", str(tmp_path / "script.py")],
        env={**os.environ, **places, "TPMSCAD_PROGRAM": real_program[0]},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=280,
    )
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert isinstance(answer, dict), answer
    report = json.loads(answer["Report"])
    assert answer["Valid"]
    assert answer["Volume"] == pytest.approx(report["volume"], rel=1e-6)
    assert answer["ReadBack"].startswith("valid, 1 solid(s)")
    assert answer["Certificate"][0] == "met"
    assert "trim" in answer["Told"]
    assert answer["Body"] == "Block"
    assert answer["Closed"] == pytest.approx(10 * 8, rel=1e-6), "the side without an opening is whole"
    assert answer["Opened"] < 0.6 * 10 * 8, "the face that was named has no skin"
    assert FillSettings.from_json(answer["Settings"]).cell == "8"
    assert answer["Mass"] == pytest.approx(report["volume"] / 1000, rel=1e-6)
    assert answer["Heavier"] == pytest.approx(2.5 * answer["Mass"], rel=1e-9)
    assert answer["Saved"] == pytest.approx(answer["Volume"], rel=1e-9)
    assert answer["Hollow"] == [pytest.approx([2.5, 2.5, 2.0, 2.0], abs=1e-9)]
    assert answer["NoBoss"].startswith("keep: no body is called 'Boss' in this document")
    assert any("1.7 around it" in line for line in answer["Certificate"])
    assert answer["NoSolid"].startswith("Sheet holds no solid: select a body")
    assert "thickness below" in answer["Thick"]
    assert answer["Places"] == pytest.approx(np.array([(55, 5, 5), (55, 5, 5), (5, 5, 75)]), abs=1e-9)
    assert answer["Owned"] == [True, True, False]


def test_struts_cover_the_box_of_the_body(tmp_path: Path) -> None:
    settings = FillSettings(surface="octet struts", cell="4,4,8", wall_value="0.5", tol="0.01")
    infill_run.write_struts(settings, (-1, 0, 3), (10, 4, 9), tmp_path)
    recipe = read_solid_recipe(tmp_path / infill_run.STRUTS_FILE)
    low, high = np.array(recipe.domain)
    assert (low <= (-1, 0, 3)).all()
    assert (high >= (10, 4, 9)).all()
    np.testing.assert_array_equal(low % (4, 4, 8), 0)
    np.testing.assert_allclose(recipe.field((0.0, 0.0, 8.0)), -0.25)
    assert infill_run.build_command(["t"], settings)[2:5] == ["body.step", "struts.toml", "--tol=0.01"]
    for wrong, said in (({"wall": "porosity"}, "wall: struts take"), ({"cell": "8 mm"}, "cell '8 mm'")):
        with pytest.raises(Refusal, match=said):
            infill_run.write_struts(FillSettings(surface="bcc struts", **wrong), (0, 0, 0), (1, 1, 1), tmp_path)
    with pytest.raises(Refusal, match=r"recipe '.*none.toml' is no file"):
        infill_run.build_command(["t"], FillSettings(surface="recipe", recipe=str(tmp_path / "none.toml")))


def test_passive_bodies_refusals_and_files_are_read_as_typed() -> None:
    assert infill_run.read_passive("holes 2.50") == ("bosses,2.5", [])
    assert infill_run.read_passive(" Boss, Rib ") == ("", ["Boss", "Rib"])
    assert infill_run.read_passive("Boss, holes 3, Rib") == ("bosses,3", ["Boss", "Rib"])
    assert "--keep=keep.step,bosses,3" in infill_run.build_command(["t"], FillSettings(keep="holes 3, Boss"))
    with pytest.raises(Refusal, match="holes 2, holes 3: give one width"):
        infill_run.read_passive("holes 2, holes 3")
    fields = ["cell", "skin", "open_faces", "thickness"]
    assert infill_run.name_field("--open-faces '=Z' is no selector; --cell is well", fields) == "open_faces"
    assert infill_run.name_field("thickness below 1", fields) == "thickness"
    assert infill_run.name_field("the kernel failed", fields) == ""
    command = infill_run.build_command(["t"], FillSettings(clear="Bolt"))
    assert "--clear=clear.step" in command
    assert "--output=/a/b.3mf" in infill_run.save_command(command, Path("/a/b.3mf"))
    with pytest.raises(Refusal, match=r"b.obj ends in '.obj': give it a name ending in .step, .3mf, .stl"):
        infill_run.save_command(command, Path("b.obj"))
