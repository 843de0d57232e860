"""Groups of a filled body's faces: each face of the body as given is one, whatever made the solid."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.body_import.isolated_reader import read_foreign_coloured_solids
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.studies._render import find_pieces
from tpmscad.trimming import network_boolean

pytestmark = pytest.mark.kernel

P: dict[str, Any] = {"surface": "P", "cell": 10, "thickness": 1, "tol": 0.1}
SKIN = 1.5


def areas_of_groups(model: Any) -> Counter[str]:
    """The area of each group of faces."""
    found: Counter[str] = Counter()
    for of in model.named_solids():
        for label, area in zip(of.labels, face_moments(faces_of(of.solid))[:, 0].tolist(), strict=True):
            found[label] += area
    return found


def bored_block() -> bd.Part:
    return bd.Box(15, 13, 14) - bd.Pos(1, 0, 0) * bd.Cylinder(2, 30)


def stepped_block() -> bd.Part:
    """A step as high as the skin: the skin's inner side lies in the plane of the lower face, and both look up."""
    return bd.Box(16, 13, 14) - bd.Pos(5, 0, 7) * bd.Box(6, 13, 2 * SKIN)


def domed_block() -> bd.Part:
    """A block under a free-form face."""
    outline = bd.Polyline((-8, 0), (-8, -7), (8, -7), (8, 0)) + bd.Spline((8, 0), (3, 3), (-2, 1.5), (-8, 0))
    return bd.extrude(bd.Plane.XZ * bd.make_face(outline), 7, both=True)


@pytest.mark.slow
def test_each_face_with_a_skin_is_a_group_of_its_whole_area() -> None:
    body = stepped_block()
    found = areas_of_groups(tpmscad.infill(body, **P, skin=SKIN))
    for number, face in enumerate(body.faces()):
        assert found.pop(f"body {number}") == pytest.approx(face.area, rel=1e-9)
    assert found.keys() == {"skin", "surface +", "surface -"}


@pytest.mark.slow
def test_what_is_left_of_an_open_face_is_a_group_too() -> None:
    body = bored_block()
    found = areas_of_groups(tpmscad.infill(body, **P, skin=SKIN, open_faces=[">Z"]))
    top = int(np.argmax([face.center().Z for face in body.faces()]))
    for number, face in enumerate(body.faces()):
        area = found[f"body {number}"]
        assert 0 < area < face.area if number == top else area == pytest.approx(face.area, rel=1e-9)


def test_a_lattice_that_was_moved_keeps_the_labels_of_its_walls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network_boolean, "SHIFT_TOLS", (25.0,))  # else it is cut where it is
    side = 10 + 2 * (SKIN + 3e-4)
    model = tpmscad.infill(bd.Box(side, side, side), **P, skin=SKIN)
    assert any("the lattice was moved" in note for note in model.certificate.notes)
    walls = {"surface +", "surface -"}
    area = areas_of_groups(model)
    assert walls | {"skin"} < area.keys()
    lattice = areas_of_groups(tpmscad.lattice(**P))
    assert sum(area[wall] for wall in walls) == pytest.approx(sum(lattice[wall] for wall in walls), rel=1e-2)


@pytest.mark.slow
def test_the_deviation_of_a_lattice_that_was_moved_is_that_from_where_it_was_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(network_boolean, "SHIFT_TOLS", ())
    monkeypatch.setattr(network_boolean, "FAR_SHIFTS", (0.9,))
    side = 10 + 2 * (SKIN + 3e-4)
    body = bd.Box(side, side, side)
    model = tpmscad.infill(body, "neovius", cell=10, thickness=0.6, tol=0.03, skin=SKIN)
    assert any("the lattice was moved" in note for note in model.certificate.notes)
    assert model.certificate.met
    assert model.distance_to_reference is not None
    points = [
        tuple(edge @ t)
        for of in model.named_solids()
        for label, face in zip(of.labels, bd.Shape.cast(of.solid).faces(), strict=True)
        if label.startswith("surface")
        for edge in face.edges()
        for t in (0.0, 0.4)
    ]
    off = float(model.distance_to_reference(np.array(points)).max())
    assert 0.01 < off <= model.certificate.max_deviation <= 0.03


@pytest.mark.slow
def test_the_wall_has_the_groups_of_the_body_and_channels_have_openings() -> None:
    domains = tpmscad.fluid_domains(domed_block(), **P | {"phase": (0.1, 0.2, 0.3)})
    wall = areas_of_groups(domains.wall)
    for contact in domains.touches:
        assert contact.label == f"body {contact.face}"
        assert wall[contact.label] == pytest.approx(contact.areas["wall"], rel=1e-6)
    for side, channel in (("+", domains.plus), ("-", domains.minus)):
        groups = areas_of_groups(channel)
        assert {label.split()[0] for label in groups} == {"surface", "opening"}
        assert groups[f"surface {side}"] == pytest.approx(wall[f"surface {side}"], rel=1e-6)
        on_body = sum(area for label, area in groups.items() if label.startswith("opening"))
        assert on_body == pytest.approx(sum(c.areas.get(channel.name, 0.0) for c in domains.touches), rel=1e-6)


@pytest.mark.slow
def test_a_face_has_the_name_that_its_file_gives_it(tmp_path: Path) -> None:
    bd.export_step(bd.Pos(1, 2, 3) * bd.Box(10, 10, 10), tmp_path / "box.step")
    text, names = (
        (tmp_path / "box.step").read_text(),
        iter(('mount "A"; left|1', "NONE", "", "gr\u00f6\u00dfe", "", "a" * 99)),
    )
    text = re.sub(r"ADVANCED_FACE\('[^']*'", lambda _: f"ADVANCED_FACE('{next(names)}'", text)
    (tmp_path / "named.step").write_text(text, encoding="utf-8")
    expected = ("body 0 mount A left 1", "body 1", "body 2", "body 3 gr\u00f6\u00dfe", "body 4", "body 5 " + "a" * 50)
    read = read_body(tmp_path / "named.step")
    assert read.face_labels == read_body(read).face_labels == expected
    model = tpmscad.infill(tmp_path / "named.step", **P, phase=(0.1, 0.2, 0.3))
    model.export(tmp_path / "filled.step")
    again = read_foreign_coloured_solids(tmp_path / "filled.step")
    assert {name for solid in again for name in solid.face_names if name.startswith("body")} == set(expected)


def test_the_table_of_a_file_lists_the_faces_under_their_labels(tmp_path: Path) -> None:
    body = bored_block()
    bd.export_step(body, tmp_path / "block.step")
    assert tpmscad.check_step(tmp_path / "block.step").faces == ()
    report = tpmscad.check_step(tmp_path / "block.step", faces=True)
    read = read_body(tmp_path / "block.step")
    (table,) = report.faces
    assert tuple(face.label for face in table) == read.face_labels
    for entry, face in zip(table, bd.Shape.cast(read.shape).faces(), strict=True):
        assert entry.area == pytest.approx(face.area, rel=1e-9)
        assert face.distance_to(bd.Vector(entry.point)) < 1e-9
        assert entry.kind.startswith(face.geom_type.name.lower())
        assert f"face        {entry.label}: {entry.kind}, " in report.summary()
    assert {entry.kind for entry in table} == {"cylinder", *(f"plane {axis}{s}" for axis in "XYZ" for s in "+-")}
    assert len(report.to_dict()["face_table"][0]) == len(table)


def test_a_picture_by_tag_tells_the_faces_of_the_body_apart() -> None:
    model = tpmscad.infill(bd.Box(12, 11, 13), **P)
    (piece,) = find_pieces(model, with_groups=True)
    colours = dict(zip(piece.face_groups, piece.face_colours, strict=True))
    assert colours.keys() == {"surface +", "surface -", *(f"body {n}" for n in range(6))}
    assert len(set(colours.values())) == len(colours)


@pytest.mark.slow
def test_the_domains_of_a_box_of_whole_cells_are_one_piece_each_as_the_lattice_there() -> None:
    surface = "diamond"
    body, asked = bd.Box(10, 10, 10, align=bd.Align.MIN), {"cell": 10, "thickness": 1, "tol": 0.05}
    domains = tpmscad.fluid_domains(body, surface, **asked)
    assert [domain.built.n_solids for domain in domains.domains.values()] == [1, 1, 1]
    assert domains.wall.volume == pytest.approx(tpmscad.lattice(surface, **asked).volume, rel=1e-6)
    assert "loose" not in repr(domains)
    with_chips = tpmscad.fluid_domains(body, surface, **asked, phase=(0, 0, 0))
    chips = with_chips.wall.certificate.pieces[1:]
    assert f"3 pieces (2 of them loose, {sum(chips):.3g} mm3" in repr(with_chips)
    assert "warning   wall: 3 pieces, apart from the largest: chip of " in repr(with_chips)
    assert f"3 pieces (2 of them loose, {sum(chips):.3g} mm3" in with_chips.summary()


@pytest.mark.slow
def test_a_pressure_on_a_face_of_the_body_is_the_force_on_that_face() -> None:
    pytest.importorskip("gmsh")
    body = bd.Box(10, 8, 9)
    mesh = tpmscad.infill(body, "P", cell=10, thickness=1, tol=0.1, skin=1).mesh(2.0, order=1)
    ((_, facets),) = mesh.facets.items()
    a, b, c = (mesh.points[facets[:, k]] for k in range(3))
    vectors = 0.5 * np.cross(b - a, c - a)
    for number, face in enumerate(body.faces()):
        force = vectors[mesh.facet_groups[f"body {number}"]].sum(axis=0)
        assert np.abs(force) == pytest.approx(np.abs(face.area * np.array([*face.normal_at()])), abs=1e-8)
