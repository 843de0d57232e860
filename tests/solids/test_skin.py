"""Skins: the part of a body deeper than the skin against closed forms, the thickness measured, and what is refused."""

from __future__ import annotations

from typing import Any

import build123d as bd
import numpy as np
import pytest
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_IN

import tpmscad
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.boolean.hollow_body import count_closed_cavities, find_skin_faces
from tpmscad.kernel.measure.skin_depth import SkinDepth, SkinThickness, measure_skin_thickness, sample_depths
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.solids.skins import offset_skin
from tpmscad.solids.skins.filled_skin import describe_closed_voids
from tpmscad.solids.skins.offset_skin import (
    DEEP_RATIO,
    DEPTH_SAMPLES,
    INSET_SAMPLES,
    SKIN_EXCESS,
    ErodedBody,
    ErosionRequest,
    check_eroded,
    check_skin_thickness,
    erode_body,
    erode_in_arrays,
)

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

PI = np.pi


def eroded(body: Any, skin: float = 1.0, open_faces: Any = ()) -> ErodedBody:
    return erode_body(read_body(body), skin, tuple(face.wrapped for face in open_faces))


def volume(found: ErodedBody) -> float:
    return sum(part.volume for part in found.parts)


def thickness(found: ErodedBody, open_faces: Any = ()) -> SkinThickness:
    shapes = [part.shape for part in found.parts]
    return measure_skin_thickness(find_skin_faces(shapes, [f.wrapped for f in open_faces]), found.depth)


def bracket() -> bd.Part:
    return bd.Box(40, 24, 6) + bd.Pos(-17, 0, 12) * bd.Box(6, 24, 20)


def grown_box(x: float, y: float, z: float, by: float) -> float:
    """Volume of the points within a distance of a box."""
    return x * y * z + 2 * by * (x * y + y * z + z * x) + PI * by**2 * (x + y + z) + 4 / 3 * PI * by**3


CLOSED_FORMS = {
    "a bracket with a sharp concave edge": (bracket, 1.0, 22 * (38 * 4 + 4 * 19 + (1 - PI / 4))),
    "a box with a cavity": (
        lambda: bd.Box(30, 26, 22) - bd.Box(14, 10, 8),
        1.0,
        28 * 24 * 20 - grown_box(14, 10, 8, 1.0),
    ),
    "fillets smaller than the skin": (lambda: bd.fillet(bd.Box(20, 18, 16).edges(), 0.5), 1.0, 18 * 16 * 14),
    "fillets larger than the skin": (
        lambda: bd.fillet(bd.Box(20, 18, 16).edges(), 3.0),
        1.0,
        grown_box(14, 12, 10, 2.0),
    ),
    "two blocks with a bridge thinner than two skins": (
        lambda: bd.Box(30, 10, 10) - bd.Pos(0, 0, 3.5) * bd.Box(10, 10, 14),
        1.0,
        2 * 8 * (8 * 8 + 0.5 - 0.5 * (0.5 * np.sqrt(0.75) + PI / 6)),
    ),
}


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_what_is_deeper_than_the_skin_has_its_closed_form_volume(name: str) -> None:
    make, skin, expected = CLOSED_FORMS[name]
    found = eroded(make(), skin)
    assert volume(found) == pytest.approx(expected, rel=1e-7)
    measured = thickness(found)
    assert measured.least == pytest.approx(skin, rel=1e-6)
    assert measured.greatest == pytest.approx(skin, rel=1e-6)


def test_a_skin_of_just_the_reach_of_a_tube_is_made_a_little_thicker() -> None:
    """Deep inside the corner edges of the offset box the tubes touch them: a triangle of sides 3, 4 and 5."""
    pocketed = read_body(bd.Box(30, 26, 22) - bd.Pos(0, 0, 6) * bd.Box(12, 10, 12))
    depth = SkinDepth(pocketed.shape, faces_of(pocketed.shape))
    request = ErosionRequest(pocketed, 5.0, (), depth, np.zeros((0, 3)))
    with pytest.raises(tpmscad.TrimmingError):
        erode_in_arrays(request)
    parts = erode_in_arrays(request, excess=SKIN_EXCESS)
    measured = measure_skin_thickness([face for part in parts for face in faces_of(part.shape)], depth)
    assert (measured.least, measured.greatest) == pytest.approx((5.0005, 5.0005), rel=1e-6)


def test_a_corner_without_an_offset_is_not_offset_again_by_a_little_more(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = [(-1, -1, 6), (1, -1, 6), (1, 1, 6), (-1, 1, 6), (0, 0, -4)]
    sides = [(0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    faces = [bd.Face(bd.Wire.make_polygon([corners[k] for k in side], close=True)) for side in sides]
    body = read_body(bd.Box(12, 12, 12) - bd.Solid(bd.Shell(faces)))
    skins = []
    made = offset_skin.erode_body_in_arrays
    monkeypatch.setattr(offset_skin, "erode_body_in_arrays", lambda *args: skins.append(args[2]) or made(*args))
    with pytest.raises(tpmscad.TrimmingError, match=r"the corner at \[ 0\.  0\. -4\.\] is too sharp"):
        erode_body(body, 1.0)
    assert skins == [1.0]


def test_the_refusal_of_a_skin_names_the_thickest_one() -> None:
    body = bd.extrude(bd.Ellipse(3.9, 2.4), 5)
    with pytest.raises(
        tpmscad.InvalidRequest, match=r"leaves nothing of the body, which is nowhere deeper than 2\.4: "
    ):
        eroded(body, 2.41)
    assert volume(eroded(body, 2.399)) > 0


def test_a_skin_at_which_two_offset_planes_coincide_is_made_a_little_thicker() -> None:
    """Half the thickness of the plate below the boss; the tube between them ends there in a cusp."""
    found = eroded(bd.Box(40, 30, 8) + bd.Pos(4, 0, 9) * bd.Cylinder(8, 10), 4.0)
    measured = thickness(found)
    assert (measured.least, measured.greatest) == pytest.approx((4.0004, 4.0004), rel=1e-6)
    assert volume(found) == pytest.approx(607.98, rel=1e-4)


def test_beside_a_bore_the_thickness_is_measured_on_the_skin_only() -> None:
    """Points of a grid that the chords of the circle leave in the bore are not points of the face round it."""
    measured = thickness(eroded(bd.Box(30, 24, 18) - bd.Rot(90, 0, 0) * bd.Cylinder(5, 40), 0.8))
    assert measured.least == pytest.approx(0.8, rel=1e-9)


def test_depths_have_the_sign_that_the_classifier_gives() -> None:
    solid = read_body(bd.Box(30, 26, 22) - bd.Pos(0, 0, 6) * bd.Box(12, 10, 12) + bd.Pos(15, 0, 0) * bd.Sphere(6)).shape
    points = np.random.default_rng(2).uniform(-16, 16, (150, 3))
    classifier = BRepClass3d_SolidClassifier(solid)
    inside = []
    for point in points.tolist():
        classifier.Perform(gp_Pnt(*point), 1e-7)
        inside.append(classifier.State() == TopAbs_IN)
    assert 30 < sum(inside) < 140
    np.testing.assert_array_equal(SkinDepth(solid, faces_of(solid))(points) > 0, inside)


def dumbbell() -> bd.Part:
    """A block and a plate of which a sheet of 0.3 is deeper than 1, joined by a rod that is nowhere deeper."""
    block, rod, plate = bd.Box(12, 10, 10), bd.Rot(0, 90, 0) * bd.Cylinder(0.9, 8), bd.Box(2.3, 10, 10)
    return block + bd.Pos(8, 0, 0) * rod + bd.Pos(12, 0, 0) * plate


def test_an_offset_that_lacks_a_part_is_refused() -> None:
    found = eroded(dumbbell())
    assert len(found.parts) == 2
    points, depths = sample_depths(found.depth, 1.0, DEPTH_SAMPLES, INSET_SAMPLES)
    deep = points[depths > DEEP_RATIO]
    check_eroded(found.parts, (), 1.0, found.depth, deep)
    for part in found.parts:
        with pytest.raises(tpmscad.KernelError, match="misses a part of the body near"):
            check_eroded((part,), (), 1.0, found.depth, deep)


def test_a_sheet_barely_deeper_than_the_skin_is_found() -> None:
    assert volume(eroded(bd.Box(40, 30, 2.05))) == pytest.approx(38 * 28 * 0.05, rel=1e-6)


def test_open_faces_get_no_skin() -> None:
    body = bracket()
    top = body.faces().sort_by(bd.Axis.Z)[-1:]
    found = eroded(body, 1.0, top)
    assert volume(found) == pytest.approx(22 * (38 * 4 + 4 * 20 + (1 - PI / 4)), rel=1e-7)
    assert thickness(found, top).greatest == pytest.approx(1.0, rel=1e-6)


def test_a_skin_thicker_than_the_fillets_beside_an_open_face_ends_in_a_round() -> None:
    block = bd.fillet(bd.Box(20, 16, 12).edges().filter_by(bd.Axis.Z), 1.5)
    body = bd.fillet(block.faces().sort_by(bd.Axis.Z)[-1].edges(), 0.7)
    top = body.faces().sort_by(bd.Axis.Z)[-1:]
    measured = thickness(eroded(body, 2.0, top), top)
    assert (measured.least, measured.greatest) == pytest.approx((2.0, 2.0), rel=1e-6)


@pytest.mark.parametrize(("thickest", "words"), [(0.97, "only 0.97 thick near"), (1.46, "1.46 thick near")])
def test_a_skin_outside_the_limits_fails_its_check(thickest: float, words: str) -> None:
    measured = SkinThickness(np.eye(3), np.array([1.0, 1.0, thickest]))
    failed = [check for check in check_skin_thickness(measured, 1.0) if not check.passed]
    assert len(failed) == 1
    assert words in failed[0].shortfall


def test_the_certificate_says_how_thick_the_skin_is() -> None:
    body = bd.Box(20, 12, 8) + bd.Pos(-6, 0, 8) * bd.Box(8, 12, 8)
    found = tpmscad.infill(body, "P", cell=8, thickness=0.8, tol=0.1, skin=1).certificate
    assert found.met
    assert found.betti[0] == 1
    assert found.volume < body.volume
    assert any(note.startswith("skin of 1 by an arrangement of offset faces: 1 to 1 thick") for note in found.notes)


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        ((0, 0, True), []),
        (
            (1, 0, False),
            ["closes off a channel: it is bounded by a shell of its own inside the solid; name open_faces"],
        ),
        ((1, 0, True), ["closes off a channel that no open face reaches: it is bounded"]),
        (
            (3, 1, True),
            ["closes off 2 channels that do not meet and that no open face", "the body's own cavity stays closed"],
        ),
        ((1, 1, True), ["the body's own cavity stays closed: bore into it"]),
    ],
)
def test_closed_voids_are_told_by_their_cause(counts: tuple[int, int, bool], words: list[str]) -> None:
    notes = describe_closed_voids(*counts)
    assert len(notes) == len(words)
    assert all(part in note for part, note in zip(words, notes, strict=True))


def test_cavities_of_the_body_are_counted_unless_they_are_open() -> None:
    body = bd.Box(30, 26, 22) - bd.Pos(6, 0, 0) * bd.Box(8, 10, 8) - bd.Pos(-6, 0, 0) * bd.Cylinder(3, 8)
    inside = min(body.faces(), key=lambda f: abs(f.center().X - 2)).wrapped
    shape = read_body(body)
    assert count_closed_cavities(shape, ()) == 2
    assert count_closed_cavities(shape, (inside,)) == 1
