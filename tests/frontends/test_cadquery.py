"""The methods that cq_plugins.tpms gives to CadQuery's Workplane: chains, selectors, booleans and exporters go on after it."""

from __future__ import annotations

import importlib
import inspect
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import tpmscad

pytestmark = [pytest.mark.kernel, pytest.mark.frontend]

P: dict[str, Any] = {"surface": "P", "cell": 10, "thickness": 1, "tol": 0.1}
PIECES: dict[str, Any] = {
    "surface": "gyroid",
    "cell": 10,
    "thickness": 1,
    "tol": 0.1,
    "phase": (0.0, 0.0, 0.0),
    "loose": "keep",
}
"""One cell of a gyroid sheet falls into three pieces at the phase of the nodal formula."""

BCC: dict[str, Any] = {"kind": "bcc", "cell": (8, 9, 10), "diameter": 1}


@pytest.fixture(scope="module")
def cq() -> Any:
    """CadQuery with the plug-in; imported here, as tests are collected without it too."""
    import cadquery

    import cq_plugins.tpms  # noqa: F401

    return cadquery


@pytest.fixture(scope="module")
def gyroid(cq: Any) -> Any:
    return cq.Workplane().tpms(**PIECES)


@pytest.fixture(scope="module")
def schwarz(cq: Any) -> Any:
    return cq.Workplane().tpms(**P)


def box_of_caps(shape: Any) -> tuple[list[float], list[float]]:
    """Corners of the box of the shape's vertices: what the caps span, without the slack of a kernel bounding box."""
    corners = [v.toTuple() for v in shape.Vertices()]
    return [min(c) for c in zip(*corners, strict=True)], [max(c) for c in zip(*corners, strict=True)]


@pytest.mark.parametrize(("method", "function"), [("tpms", tpmscad.lattice), ("struts", tpmscad.struts)])
def test_the_keywords_are_those_of_the_function_with_centered_combine_and_clean(
    cq: Any, method: str, function: Any
) -> None:
    ours, theirs = (inspect.signature(of).parameters for of in (getattr(cq.Workplane, method), function))
    assert [*theirs, "centered", "combine", "clean"] == list(ours)[1:]
    assert all(ours[name].default == theirs[name].default and ours[name].kind == theirs[name].kind for name in theirs)


def test_the_models_behind_a_chain_stay_with_it(cq: Any, gyroid: Any, schwarz: Any) -> None:
    (model,) = gyroid.faces(">Z").workplane().tpmsModels()
    assert model.certificate.met
    assert model.certificate.volume == pytest.approx(
        gyroid.val().Volume(), rel=1e-8
    )  # CadQuery asks the kernel's quadrature
    twice = schwarz.center(50, 0).tpms(**P, combine=False)
    assert [m.name for m in twice.edges("|Z").tpmsModels()] == ["schwarz_p sheet"] * 2
    assert twice.tpmsModels()[0] is schwarz.tpmsModels()[0]
    assert cq.Workplane().box(1, 1, 1).tpmsModels() == ()


def test_the_import_adds_its_methods_and_overrides_nothing(cq: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    import cq_plugins.tpms as plugin

    ours = [name for name, value in vars(cq.Workplane).items() if getattr(value, "__module__", "") == plugin.__name__]
    assert ours == ["tpms", "struts", "tpmsInfill", "tpmsModels"]
    importlib.reload(plugin)
    monkeypatch.setattr(cq.Workplane, "tpms", lambda self: self)
    with pytest.raises(ImportError, match="already has a method tpms"):
        importlib.reload(plugin)


@pytest.mark.parametrize(("which", "pieces"), [("schwarz", 1), ("gyroid", 3)])
def test_the_stack_holds_the_lattice(which: str, pieces: int, request: pytest.FixtureRequest) -> None:
    work = request.getfixturevalue(which)
    model = tpmscad.lattice(**(P if which == "schwarz" else PIECES))
    assert work.size() == 1
    assert work.val().isValid()
    assert work.solids().size() == pieces == model.certificate.betti[0]
    assert work.val().Volume() == pytest.approx(model.solid.volume, rel=1e-12)
    low, high = box_of_caps(work.val())
    assert low == pytest.approx([0, 0, 0], abs=1e-9)
    assert high == pytest.approx([10, 10, 10], abs=1e-9)


def test_one_lattice_stands_at_every_point(cq: Any) -> None:
    points = [(0, 0), (30, 0), (0, 40)]
    work = cq.Workplane().pushPoints(points).tpms(**P, combine=False)
    assert [box_of_caps(v)[0][:2] for v in work.vals()] == [pytest.approx(p, abs=1e-9) for p in points]
    combined = cq.Workplane().rarray(20, 20, 2, 2).tpms(**P)
    assert (combined.size(), combined.solids().size()) == (1, 4)


def test_it_follows_the_workplane(cq: Any) -> None:
    plane = cq.Workplane("XZ", origin=(1, 2, 3))
    low, high = box_of_caps(plane.tpms(**P | {"cells": (1, 2, 3)}).val())
    assert low == pytest.approx([1, 2 - 30, 3], abs=1e-9)
    assert high == pytest.approx([11, 2, 23], abs=1e-9)
    pushed = plane.pushPoints([(0, 0), (30, 40)]).tpms(**P, combine=False).vals()
    assert [box_of_caps(v)[0] for v in pushed] == [pytest.approx([1 + x, 2 - 10, 3 + z]) for x, z in ((0, 0), (30, 40))]


@pytest.mark.parametrize(("centered", "low"), [(True, [-5, -10, -15]), ((True, False, True), [-5, 0, -15])])
def test_centered_is_of_the_box_of_cells(cq: Any, centered: Any, low: list[float]) -> None:
    work = cq.Workplane().tpms(**P | {"cells": (1, 2, 3)}, centered=centered)
    assert box_of_caps(work.val())[0] == pytest.approx(low, abs=1e-9)


@pytest.mark.parametrize("which", ["schwarz", "gyroid"])
def test_booleans_share_the_volume_out(cq: Any, which: str, request: pytest.FixtureRequest) -> None:
    work = request.getfixturevalue(which)
    tool = cq.Workplane().center(5, 5).circle(4).extrude(10)
    cut, common = work.cut(tool).val(), work.intersect(tool).val()
    assert cut.isValid()
    assert common.isValid()
    assert cut.Volume() + common.Volume() == pytest.approx(work.val().Volume(), rel=1e-6)


def test_it_combines_with_the_part_in_the_chain(cq: Any, schwarz: Any) -> None:
    plate = cq.Workplane().box(14, 14, 2)
    joined = plate.faces(">Z").workplane().tpms(**P, centered=(True, True, False))
    assert joined.val().isValid()
    assert joined.solids().size() == 1
    assert joined.val().Volume() == pytest.approx(14 * 14 * 2 + schwarz.val().Volume(), rel=1e-6)
    left = cq.Workplane().box(12, 12, 12).tpms(**P, centered=True, combine="cut")
    assert left.val().isValid()
    assert left.val().Volume() == pytest.approx(12**3 - schwarz.val().Volume(), rel=1e-6)


def test_cadquery_writes_and_reads_it(cq: Any, gyroid: Any, tmp_path: Path) -> None:
    cq.exporters.export(gyroid, str(tmp_path / "part.step"))
    cq.Assembly().add(gyroid, name="core", loc=cq.Location((1, 2, 3))).export(str(tmp_path / "assembly.step"))
    for name in ("part.step", "assembly.step"):
        back = cq.importers.importStep(str(tmp_path / name))
        assert back.val().isValid()
        assert back.solids().size() == 3
        assert sum(s.Volume() for s in back.solids().vals()) == pytest.approx(gyroid.val().Volume(), rel=1e-9)
    cq.exporters.export(gyroid, str(tmp_path / "part.stl"), tolerance=0.1)
    assert (tmp_path / "part.stl").stat().st_size > 1000


def test_calls_that_do_not_fit_are_answered_with_the_call_as_it_is_written(cq: Any) -> None:
    with pytest.raises(TypeError, match=r"tpms takes surface by position .* tpms\(\"gyroid\", cell=10"):
        cq.Workplane().tpms("gyroid", 10, 1)
    with pytest.raises(TypeError, match="tpms has no keyword 'centred'; it is called centered="):
        cq.Workplane().tpms("gyroid", cell=10, thickness=1, centred=True)
    with pytest.raises(tpmscad.InvalidRequest, match="combine 'fuse' is none of"):
        cq.Workplane().tpms("gyroid", cell=10, thickness=1, combine="fuse")
    with pytest.raises(tpmscad.InvalidRequest, match="a mapped lattice lies where the map puts it: leave centered out"):
        cq.Workplane().tpms("P", cell=10, thickness=1, map=tpmscad.maps.cylinder(20), centered=True)
    with pytest.raises(tpmscad.InvalidRequest, match="combine 'cut' is neither"):
        cq.Workplane().box(9, 9, 9).tpmsInfill("gyroid", cell=10, thickness=1, combine="cut")


def test_the_model_of_a_centered_lattice_stays_where_it_was_made(cq: Any, tmp_path: Path) -> None:
    (model,) = cq.Workplane().tpms("P", cell=10, thickness=1, tol=0.1, centered=True).tpmsModels()
    assert model.wrapped.Location().IsIdentity()
    model.export(tmp_path / "p.stl")


def test_what_cannot_be_put_at_points_is_refused(cq: Any) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match="leave centered out"):
        cq.Workplane().tpms("P", cell=10, thickness=1, map=lambda points: points, centered=True)
    with pytest.raises(tpmscad.InvalidRequest, match="combine 'fuse' is none of"):
        cq.Workplane().struts(**BCC, combine="fuse")


def test_a_result_that_misses_the_request_is_not_put_on_the_stack(cq: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    import cq_plugins.tpms as plugin

    model = tpmscad.lattice(**P)
    failed = replace(model, certificate=replace(model.certificate, met=False, shortfalls=("gap 1 exceeds 0.1",)))
    monkeypatch.setattr(plugin, "lattice", lambda *args, **kwargs: failed)
    with pytest.raises(tpmscad.NotMet, match="gap 1 exceeds") as caught:
        plugin.tpms(cq.Workplane(), **P)
    assert caught.value.certificate is failed.certificate


def test_struts_are_on_the_stack_and_their_model_stays_with_the_chain(cq: Any) -> None:
    bcc = cq.Workplane().struts(**BCC)
    (model,) = bcc.faces(">Z").tpmsModels()
    assert model.certificate.met
    assert bcc.val().isValid()
    assert bcc.solids().size() == 1
    assert bcc.val().Volume() == pytest.approx(model.certificate.volume, rel=1e-9)
    low, high = box_of_caps(bcc.val())
    assert low == pytest.approx([0, 0, 0], abs=1e-9)
    assert high == pytest.approx([8, 9, 10], abs=1e-9)


def test_struts_stand_at_every_point_centred_along_the_axes_that_say_so(cq: Any) -> None:
    work = cq.Workplane().pushPoints([(0, 0), (30, 40)]).struts(**BCC, centered=(True, True, False), combine=False)
    lows = [box_of_caps(v)[0] for v in work.vals()]
    assert lows == [pytest.approx(low, abs=1e-9) for low in ([-4, -4.5, 0], [26, 35.5, 0])]
