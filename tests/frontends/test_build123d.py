"""Tpms and Struts in build123d: part objects like any other, which hold what tpmscad.lattice and tpmscad.struts make."""

from __future__ import annotations

import copy
import inspect
from pathlib import Path
from typing import Any

import build123d as bd
import pytest

import tpmscad
from tpmscad.build123d import Struts, Tpms, TpmsInfill

pytestmark = pytest.mark.kernel

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
def gyroid() -> Tpms:
    return Tpms(**PIECES)


@pytest.fixture(scope="module")
def schwarz() -> Tpms:
    return Tpms(**P)


@pytest.fixture(scope="module")
def bcc() -> Struts:
    return Struts(**BCC)


def box_of_caps(part: bd.Shape) -> tuple[list[float], list[float]]:
    """Corners of the box of the part's vertices: what the caps span, without the slack of a kernel bounding box."""
    corners = [tuple(v) for v in part.vertices()]
    return [min(c) for c in zip(*corners, strict=True)], [max(c) for c in zip(*corners, strict=True)]


@pytest.mark.parametrize(("part", "function"), [(Tpms, tpmscad.lattice), (Struts, tpmscad.struts)])
def test_the_keywords_are_those_of_the_function_with_rotation_align_and_mode(part: type, function: Any) -> None:
    ours, theirs = (inspect.signature(of).parameters for of in (part, function))
    assert [*theirs, "rotation", "align", "mode"] == list(ours)
    assert all(ours[name].default == theirs[name].default and ours[name].kind == theirs[name].kind for name in theirs)


def test_every_parameter_becomes_an_attribute_under_its_name(schwarz: Tpms) -> None:
    given = P | {
        "cells": (1, 1, 1),
        "kind": "sheet",
        "phase": None,
        "loose": "drop",
        "align": bd.Align.CENTER,
        "map": None,
    }
    assert {name: getattr(schwarz, name) for name in given} == given
    assert schwarz.mode is bd.Mode.ADD


def test_the_part_is_the_lattice_about_the_origin(gyroid: Tpms) -> None:
    part, model = gyroid, tpmscad.lattice(**PIECES)
    assert part.is_valid
    assert part.certificate.met
    assert part.model.name == part.label == model.name
    assert len(part.solids()) == len(model.solid.solids()) == part.certificate.betti[0]
    assert part.volume == pytest.approx(model.solid.volume, rel=1e-12)
    assert tuple(part.center()) == pytest.approx(tuple(model.solid.center() - bd.Vector(5, 5, 5)), abs=1e-9)


def test_alignment_is_of_the_box_of_cells_exactly() -> None:
    part = Tpms(**P | {"cells": (1, 2, 3)}, align=(bd.Align.MIN, bd.Align.CENTER, bd.Align.MAX))
    low, high = box_of_caps(part)
    assert low == pytest.approx([0, -10, -30], abs=1e-9)
    assert high == pytest.approx([10, 10, 0], abs=1e-9)


def test_a_natural_boundary_is_aligned_by_the_same_box() -> None:
    part = Tpms(**P, boundary="natural")
    left = tpmscad.lattice(**P, boundary="natural").solid
    assert tuple(part.center()) == pytest.approx(tuple(left.center() - bd.Vector(5, 5, 5)), abs=1e-9)


def test_without_align_the_lattice_stays_where_it_is_made() -> None:
    low, high = box_of_caps(Tpms(**P, align=None))
    assert low == pytest.approx([0, 0, 0], abs=1e-9)
    assert high == pytest.approx([10, 10, 10], abs=1e-9)


@pytest.mark.slow
def test_a_mapped_lattice_is_aligned_by_the_image_of_its_box() -> None:
    part = Tpms(**P | {"tol": 0.5}, map=lambda points: points * [1, 1, 1.2] + [3, 0, 0])
    low, high = box_of_caps(part)
    assert low == pytest.approx([-5, -5, -6], abs=1e-6)
    assert high == pytest.approx([5, 5, 6], abs=1e-6)


def test_the_model_stays_where_it_was_made_and_can_be_written(schwarz: Tpms, tmp_path: Path) -> None:
    model = schwarz.model
    model.solid.move(bd.Location((30, 0, 0)))
    bd.Shape(model.wrapped).move(bd.Location((30, 0, 0)))
    assert model.wrapped.Location().IsIdentity()
    model.export(tmp_path / "p.stl")
    (mesh,) = bd.Mesher().read(str(tmp_path / "p.stl"))
    assert abs(mesh.bounding_box().min.X) < 0.2


def test_rotation_turns_the_aligned_lattice() -> None:
    part = Tpms(**P | {"cells": (1, 1, 2)}, align=bd.Align.MIN, rotation=(90, 0, 0))
    low, high = box_of_caps(part)
    assert low == pytest.approx([0, -20, 0], abs=1e-9)
    assert high == pytest.approx([10, 0, 10], abs=1e-9)
    assert part.is_valid


class TestAlgebraMode:
    def test_a_placed_lattice_keeps_its_certificate(self, schwarz: Tpms) -> None:
        turned = bd.Rot(0, 0, 30) * schwarz
        assert turned.is_valid
        assert turned.volume == pytest.approx(schwarz.volume, rel=1e-9)
        for placed in (bd.Pos(1, 2, 3) * schwarz, turned, copy.copy(schwarz), copy.deepcopy(schwarz)):
            assert placed.certificate is schwarz.certificate
            assert placed.model is schwarz.model

    def test_booleans_share_the_volume_out(self, schwarz: Tpms) -> None:
        tool = bd.Cylinder(radius=4, height=12)
        cut, common = schwarz - tool, schwarz & tool
        assert cut.is_valid
        assert common.is_valid
        assert cut.volume + common.volume == pytest.approx(schwarz.volume, rel=1e-6)


class TestBuilderMode:
    def test_it_is_added_at_every_location(self, schwarz: Tpms) -> None:
        with bd.BuildPart() as built, bd.GridLocations(20, 30, 2, 1):
            part = Tpms(**P)
        assert built.part.is_valid
        assert len(built.part.solids()) == 2
        assert built.part.volume == pytest.approx(2 * schwarz.volume, rel=1e-9)
        assert sorted(round(s.center().X, 4) for s in built.part.solids()) == [-10, 10]
        assert part.certificate.met

    def test_it_is_subtracted_in_that_mode(self, schwarz: Tpms) -> None:
        with bd.BuildPart() as built:
            bd.Box(12, 12, 12)
            Tpms(**P, mode=bd.Mode.SUBTRACT)
        assert built.part.is_valid
        assert built.part.volume == pytest.approx(12**3 - schwarz.volume, rel=1e-6)

    def test_it_takes_no_part_in_a_sketch(self) -> None:
        with bd.BuildSketch(), pytest.raises(RuntimeError, match="Tpms"):
            Tpms(**P)


def test_selectors_find_caps_edges_and_pieces(gyroid: Tpms) -> None:
    caps = gyroid.faces().filter_by(bd.GeomType.PLANE)
    top = caps.group_by(bd.Axis.Z)[-1]
    assert len(caps) == 6 * len(top)
    assert [face.center().Z for face in top] == pytest.approx([5] * len(top), abs=1e-9)
    assert len(gyroid.edges().filter_by(bd.Axis.Z)) == 12
    assert len(gyroid.solids().sort_by(bd.SortBy.VOLUME)) == 3


def test_calls_that_do_not_fit_are_answered_with_the_call_as_it_is_written() -> None:
    with pytest.raises(TypeError, match=r"Tpms takes surface by position .* Tpms\(\"gyroid\", cell=10"):
        Tpms("gyroid", 10, 1)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="Tpms has no keyword 'aling'; it is called align="):
        Tpms("gyroid", cell=10, thickness=1, aling=None)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="TpmsInfill takes body and surface by position"):
        TpmsInfill(bd.Box(1, 1, 1), "gyroid", 8)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"Struts takes kind by position .* Struts\(\"octet\", cell=10"):
        Struts("bcc", 10, 1)  # type: ignore[call-arg]


class TestTheOneKindOfResult:
    def test_a_file_holds_the_part_where_it_is(self, schwarz: Tpms, tmp_path: Path) -> None:
        moved = bd.Pos(30, 0, 0) * bd.Rot(0, 0, 30) * schwarz
        moved.export(tmp_path / "p.step")
        read = bd.import_step(str(tmp_path / "p.step"))
        assert read.volume == pytest.approx(moved.volume, rel=1e-9)
        assert tuple(read.center()) == pytest.approx(tuple(moved.center()), abs=1e-6)
        assert box_of_caps(read)[1] == pytest.approx(box_of_caps(moved)[1], abs=1e-6)

    def test_the_placed_model_has_the_true_extents_and_the_faces_of_the_part(self, schwarz: Tpms) -> None:
        turned = bd.Pos(1, 2, 3) * bd.Rot(0, 0, 90) * schwarz
        low, high = turned.placed_model.bounding_box
        assert low == pytest.approx((-4, -3, -2), abs=1e-6)
        assert high == pytest.approx((6, 7, 8), abs=1e-6)
        labels = turned.placed_model.named_solids()[0].labels
        assert sorted(labels) == sorted(schwarz.model.named_solids()[0].labels)
        assert turned.placed_model.certificate is schwarz.certificate

    def test_a_mirrored_part_is_not_written_as_if_it_were_the_model(self, gyroid: Tpms) -> None:
        changed = copy.copy(gyroid)
        changed.wrapped = bd.Part(bd.mirror(gyroid, bd.Plane.XY).wrapped).wrapped
        with pytest.raises(tpmscad.InvalidRequest, match="not the model's solid any more"):
            _ = changed.placed_model

    def test_it_says_what_it_is(self, schwarz: Tpms) -> None:
        assert repr(schwarz) == "Tpms: schwarz_p sheet, 1 piece, 102 faces, volume 232.1074, met"

    def test_an_operator_on_the_model_says_to_take_its_solid(self, schwarz: Tpms) -> None:
        with pytest.raises(tpmscad.InvalidRequest, match=r"model\.solid - Box"):
            schwarz.model - bd.Box(1, 1, 1)


class TestStruts:
    def test_the_part_is_the_lattice_about_the_origin(self, bcc: Struts) -> None:
        model = tpmscad.struts(**BCC)
        assert bcc.is_valid
        assert bcc.certificate.met
        assert bcc.label == bcc.model.name == "bcc struts"
        assert bcc.cell == (8, 9, 10)
        assert bcc.volume == pytest.approx(model.volume, rel=1e-7)
        low, high = box_of_caps(bcc)
        assert low == pytest.approx([-4, -4.5, -5], abs=1e-9)
        assert high == pytest.approx([4, 4.5, 5], abs=1e-9)
        assert {face.geom_type for face in bcc.faces()} == {bd.GeomType.CYLINDER, bd.GeomType.PLANE}

    def test_they_are_aligned_before_they_are_rotated(self) -> None:
        part = Struts(**BCC, align=(bd.Align.MIN, bd.Align.CENTER, bd.Align.MAX), rotation=(0, 0, 90))
        low, high = box_of_caps(part)
        assert low == pytest.approx([-4.5, 0, -10], abs=1e-9)
        assert high == pytest.approx([4.5, 8, 0], abs=1e-9)

    def test_placed_ones_are_written_where_they_are(self, bcc: Struts, tmp_path: Path) -> None:
        moved = copy.copy(bd.Pos(30, 0, 0) * bcc)
        assert moved.certificate is bcc.certificate
        moved.export(tmp_path / "bcc.step")
        read = bd.import_step(tmp_path / "bcc.step")
        assert read.volume == pytest.approx(bcc.volume, rel=1e-7)
        assert box_of_caps(read)[0] == pytest.approx([26, -4.5, -5], abs=1e-6)

    def test_a_builder_joins_them_and_a_plate(self, bcc: Struts) -> None:
        with bd.BuildPart() as built:
            with bd.Locations((0, 0, -6)):
                bd.Box(10, 11, 2)
            Struts(**BCC)
        assert built.part.is_valid
        assert len(built.part.solids()) == 1
        assert built.part.volume == pytest.approx(bcc.volume + 10 * 11 * 2, rel=1e-6)
