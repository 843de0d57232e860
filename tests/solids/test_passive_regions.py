"""CAD bodies that the solid of a field contains, or that stay empty: volumes by formulas, exact faces, what is told, refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("OCP")

import build123d as bd

import tpmscad
from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.results.model import Model
from tpmscad.solids import passive_regions

pytestmark = pytest.mark.kernel

BOX = ((0.0, 0.0, 0.0), (20.0, 16.0, 10.0))
PLATE = 20.0 * 16.0 * 4.0
MIDDLE = (9.1, 7.7)
BOSS, BORE = 9.0 * np.pi, 2.25 * np.pi
"""Areas of a boss of radius 3 and a bore of radius 1.5."""


def plate(points: Array) -> Array:
    """A field whose solid is 4 high, plane on its upper side."""
    height: Array = points[..., 2] - 4.0
    return height


def cylinder(radius: float, low: float, high: float) -> Any:
    return bd.Pos(*MIDDLE, 0.5 * (low + high)) * bd.Cylinder(radius, high - low)


def body_labels(model: Model) -> set[str]:
    return {label for solid in model.named_solids() for label in solid.labels if label.startswith("kept")}


def make(**passive: Any) -> Model:
    return tpmscad.solidify(plate, BOX, tol=0.02, progress=False, **passive)


def require_sound(model: Model, volume: float, path: Path) -> None:
    """The certificate is met with this volume, and so is the file."""
    assert model.certificate.met, model.certificate.shortfalls
    assert model.certificate.volume == pytest.approx(volume, rel=1e-6)
    model.export_step(path)  # which reads it back


def test_a_boss_stands_out_of_the_solid_with_its_own_faces(tmp_path: Path) -> None:
    model = make(keep=cylinder(3.0, 1.0, 9.0))
    require_sound(model, PLATE + 5.0 * BOSS, tmp_path / "boss.step")
    assert model.trimmed_by == "patches"
    assert len(body_labels(model)) == 2  # its side and its top; its bottom is within the solid
    assert any("is contained, 3" in note for note in model.certificate.notes)


def test_a_bore_goes_through_a_boss_that_the_field_fills(tmp_path: Path) -> None:
    model = make(keep=cylinder(3.0, 1.0, 9.0), clear=cylinder(1.5, -1.0, 11.0))
    require_sound(model, PLATE + 5.0 * BOSS - 9.0 * BORE, tmp_path / "bore.step")
    assert model.certificate.betti == (1, 1, 0)
    assert any("is empty, 7" in note for note in model.certificate.notes)


def test_a_body_flush_with_sides_of_the_box_leaves_one_plane_there(tmp_path: Path) -> None:
    boss = bd.Pos(0, 5, 0) * bd.Box(3, 4, 9, align=(bd.Align.MIN,) * 3)
    model = make(keep=boss)
    require_sound(model, PLATE + 3.0 * 4.0 * 5.0, tmp_path / "flush.step")
    assert model.trimmed_by == "kernel"
    planes = [face for face in model.solid.faces() if face.geom_type == bd.GeomType.PLANE]
    assert sum(abs(face.center().X) < 1e-7 for face in planes) == 1
    assert sum(abs(face.center().Z) < 1e-7 for face in planes) == 1


def test_a_body_may_reach_beyond_the_box_and_a_file_may_hold_several(tmp_path: Path) -> None:
    file = tmp_path / "two.step"
    two = [bd.Pos(4, 4, 3) * bd.Box(2, 2, 14), bd.Pos(15.3, 9.1, 6) * bd.Cylinder(2.0, 9)]
    bd.export_step(bd.Compound(two), file)
    model = make(keep=file)
    assert make(keep=two).volume == pytest.approx(model.volume, rel=1e-9)
    require_sound(model, PLATE + 4.0 * 10.0 + np.pi * 4.0 * 6.5, tmp_path / "out.step")
    assert sum("is contained" in note for note in model.certificate.notes) == 2


def test_bodies_may_overlap_and_what_is_cleared_is_empty(tmp_path: Path) -> None:
    """Two crossing bars are kept, and the corner that two boxes share is cleared."""
    bars = bd.Compound([bd.Pos(9, 8, 6) * bd.Box(12, 2, 2), bd.Pos(9.1, 7.9, 6.1) * bd.Box(2, 12, 2)])
    holes = bd.Compound([bd.Pos(4.2, 8.1, 6.2) * bd.Box(4, 4, 9), bd.Pos(5.1, 8.3, 6.4) * bd.Box(3, 3, 10)])
    model = make(keep=bars, clear=holes)
    kept, cleared = (one.solids()[0] + one.solids()[1] for one in (bars, holes))
    expected = (bd.Pos(10, 8, 2) * bd.Box(20, 16, 4) + kept - cleared).volume
    require_sound(model, expected, tmp_path / "crossing.step")


def test_messages_name_what_is_kept() -> None:
    with pytest.raises(InvalidRequest, match=r"the kept shape holds no solid \(compound\)"):
        make(keep=bd.Rectangle(3, 3))
    with pytest.raises(InvalidRequest, match=r"there is no file absent\.step"):
        make(clear="absent.step")


def test_what_a_body_joins_is_no_loose_piece() -> None:
    balls = fields.union(fields.sphere((4, 8, 5), 3.0), fields.sphere((14, 8, 5), 0.6))
    apart = tpmscad.solidify(balls, BOX, tol=0.02, progress=False)
    assert len(apart.certificate.dropped) == 1
    joined = tpmscad.solidify(balls, BOX, tol=0.02, keep=bd.Pos(9.1, 8.03, 5.02) * bd.Box(10, 0.5, 0.5), progress=False)
    assert joined.certificate.met
    assert joined.certificate.dropped == ()
    assert joined.certificate.betti == (1, 0, 0)


def test_a_body_that_touches_nothing_is_refused_not_dropped() -> None:
    off = bd.Pos(10, 8, 8) * bd.Box(1, 1, 1)
    with pytest.raises(InvalidRequest, match="touches nothing of the solid and is a loose piece of 1 mm3"):
        make(keep=off)
    assert tpmscad.solidify(plate, BOX, tol=0.02, keep=off, loose="keep", progress=False).certificate.betti[0] == 2


def test_a_wrong_volume_is_seen_by_the_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """The body replaced by a thinner one when it is united: the check by points of the right one must notice."""
    combine = passive_regions._combine
    (thin,) = passive_regions.PassiveRegions.read(cylinder(2.0, 1.0, 9.0)).kept
    other = passive_regions._read_brep(thin)
    monkeypatch.setattr(passive_regions, "_combine", lambda brep, _, operation: combine(brep, other, operation))
    model = make(keep=cylinder(3.0, 1.0, 9.0))
    assert not model.certificate.met
    assert "the volume with the passive regions is" in model.certificate.shortfalls[0]


def test_a_map_takes_no_passive_regions() -> None:
    faces = bd.Box(4, 4, 4).faces().sort_by(bd.Axis.Z)
    with pytest.raises(InvalidRequest, match="in a box or a body, not under a map"):
        tpmscad.solidify(plate, tpmscad.maps.between(faces[0], faces[-1]), tol=0.02, keep=bd.Box(1, 1, 1))


def test_what_is_kept_round_a_hole_no_wider_than_the_skin_lies_in_it() -> None:
    plate = bd.Box(20, 16, 8) - bd.Pos(3, 1, 0) * bd.Cylinder(2, 8)
    core: dict[str, Any] = {"surface": "square", "cell": 3.0, "thickness": 0.4, "skin": 1.0}
    kept = tpmscad.infill(plate, keep=("bosses", 1.0), **core)
    assert kept.certificate.met
    assert kept.volume == pytest.approx(tpmscad.infill(plate, **core).volume, rel=1e-12)
    assert tpmscad.infill(plate, keep=("bosses", 1.2), **core).volume > kept.volume + 1.0


def test_a_boss_of_a_filled_body_and_its_bolt_hole_have_their_own_faces(tmp_path: Path) -> None:
    """The boss ends in faces of the body: it is grown beyond them, so that no faces coincide where the cut is made."""
    body, boss, bolt = bd.Box(8, 7, 5), bd.Pos(1, 0.5, 0) * bd.Cylinder(2, 5), bd.Pos(1, 0.5, 0) * bd.Cylinder(1, 9)
    wall: dict[str, Any] = {"surface": "schwarz_p", "cell": 7, "thickness": 0.8, "tol": 0.1, "progress": False}
    for skin in (None, 0.8):
        model = tpmscad.infill(body, **wall, skin=skin, keep=boss, clear=bolt)
        assert model.certificate.met, model.certificate.shortfalls
        assert model.trimmed_by == "patches"
        ring = bd.Pos(1, 0.5, 0) * (
            bd.Cylinder(1.99, 4.9) - bd.Cylinder(1.01, 9)
        )  # the kernel errs where faces coincide
        assert (model.solid & ring).volume == pytest.approx(ring.volume, rel=1e-6)
    solid = tpmscad.infill(body, **wall, skin=0.8, keep=boss)
    assert solid.volume - model.volume == pytest.approx(np.pi * 5, rel=1e-9)  # the bolt's hole
    model.export_step(tmp_path / "boss.step")
    with pytest.raises(InvalidRequest, match="the kept shape reaches beyond the body, which has a skin: unite"):
        tpmscad.infill(body, **wall, skin=0.8, keep=bd.Cylinder(2, 10))


@pytest.mark.parametrize("skin", [None, 0.2])
def test_kept_solids_that_touch_each_other_are_one(skin: float | None) -> None:
    """One of them ends in a face of the body."""
    apart = bd.Pos(0.3, 0.2, 0) * bd.Box(0.8, 0.8, 1), bd.Pos(0.3, 0.2, 0.75) * bd.Box(0.6, 0.6, 0.5)
    models = [
        tpmscad.infill(
            bd.Box(3.3, 2.5, 2), "gyroid", cell=2, thickness=0.3, tol=0.02, skin=skin, keep=keep, progress=False
        )
        for keep in (bd.Compound(list(apart)), apart[0] + apart[1])
    ]
    for model in models:
        assert model.certificate.met, model.certificate.shortfalls
    assert models[0].volume == pytest.approx(models[1].volume, rel=1e-7)


def test_a_kept_plate_that_a_strut_touches_from_within_is_united_with_it() -> None:
    """The strut is as deep as it is thick: it is moved by some millionths, the plate is not."""
    frame = fields.struts([[0, 0, 0], [10, 0, 0], [5, 0, 8]], [[0, 1], [0, 2], [1, 2]], 1.0)
    volumes = []
    for top in (0.5, 0.5001):
        plate = bd.Pos(5, 0, top - 1) * bd.Box(14, 6, 2)
        model = tpmscad.solidify(frame, ((-2, -3, -2), (12, 3, 10)), tol=0.02, keep=plate, progress=False)
        assert model.certificate.met, model.certificate.shortfalls
        volumes.append(model.volume - plate.volume)
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-3)


def test_the_surroundings_of_holes_are_kept_by_a_width_or_a_radius() -> None:
    body = bd.Box(11, 7, 4) - bd.Pos(-3, 1, 0) * bd.Cylinder(1, 20) - bd.Pos(3, -1, 0) * bd.Cylinder(1.5, 20)
    wall: dict[str, Any] = {"surface": "gyroid", "cell": 6, "thickness": 0.7, "tol": 0.1, "progress": False}
    both = tpmscad.infill(body, **wall, keep=("bosses", 0.8))
    one = tpmscad.infill(body, **wall, keep=("bosses", 0.8, 1.5))
    assert both.trimmed_by == one.trimmed_by == "patches"
    for model, kept in ((both, ((-3, 1, 1.0), (3, -1, 1.5))), (one, ((3, -1, 1.5),))):
        for x, y, radius in kept:
            ring = bd.Pos(x, y, 0) * (bd.Cylinder(radius + 0.79, 3.9) - bd.Cylinder(radius + 0.01, 4))
            assert (model.solid & ring).volume == pytest.approx(ring.volume, rel=1e-6)
    assert one.volume < both.volume
    post = bd.Pos(3.9, 2.4, 0) * bd.Box(1.6, 1.4, 2.6)
    mixed = tpmscad.infill(body, **wall, keep=[post, ("bosses", 0.8, 1.5)])
    assert (mixed.solid & post).volume == pytest.approx(post.volume, rel=1e-6)
    assert mixed.volume == pytest.approx(one.volume + post.volume - (one.solid & post).volume, rel=1e-5)
    with pytest.raises(InvalidRequest, match=r"its round holes have radii of 1, 1\.5"):
        tpmscad.infill(body, **wall, keep=("bosses", 0.8, 2.0))
    for wrong in (("bosses",), ("bosses", -1), ("bosses", "wide")):
        with pytest.raises(InvalidRequest, match=r'must be \("bosses", width\)'):
            tpmscad.infill(body, **wall, keep=wrong)


def test_the_surroundings_of_a_hole_are_kept_within_the_skin_of_its_boss() -> None:
    """The concave edge at the foot of the boss has an offset face with the same axis, whose seam lies along x, too."""
    boss = bd.Pos(0, 0, 1.5) * bd.Cylinder(3, 6)
    body = bd.Box(12, 12, 5) + boss - bd.Cylinder(1.6, 20)
    top = max((f for f in body.faces() if abs(f.center().Z - 2.5) < 1e-6), key=lambda face: face.area)
    keywords: dict[str, Any] = {
        "cell": 8,
        "thickness": 0.8,
        "skin": 0.8,
        "tol": 0.05,
        "open_faces": [top],
        "progress": False,
    }
    model = tpmscad.infill(body, "diamond", keep=("bosses", 1.1), **keywords)
    assert model.certificate.met, model.certificate.shortfalls
    ring = bd.Cylinder(2.69, 4.9) - bd.Cylinder(1.61, 5)
    assert (model.solid & ring).volume == pytest.approx(ring.volume, rel=1e-6)


def test_each_of_several_solids_keeps_what_lies_in_it_and_the_surroundings_of_its_holes() -> None:
    plain, bored = bd.Pos(-3, 0, 0) * bd.Box(4, 4, 4), bd.Pos(3, 0, 0) * (bd.Box(4, 4, 4) - bd.Cylinder(0.5, 4))
    both = bd.Compound([plain, bored])
    given = {"cell": 4.0, "kind": "skeletal", "tol": 0.1, "solid": "all", "progress": False}
    block = bd.Pos(-3.1, 0.2, 0.1) * bd.Box(1, 1.2, 1)
    model = tpmscad.infill(both, "schwarz_p", keep=[block, ("bosses", 0.4)], clear=bd.Cylinder(0.3, 9), **given)
    assert model.certificate.met
    notes = " ".join(model.certificate.notes)
    assert notes.count("solid 1: the kept") == 1
    assert notes.count("solid 2: the hole of radius 0.5 with 0.4 around it is contained") == 1
    with pytest.raises(InvalidRequest, match="lies in none of the 2 solids as a whole"):
        tpmscad.infill(both, "schwarz_p", keep=bd.Box(4, 1, 1), **given)
    with pytest.raises(InvalidRequest, match="it has no round holes"):
        tpmscad.infill(both, "schwarz_p", keep=("bosses", 0.4, 2.0), **given)
