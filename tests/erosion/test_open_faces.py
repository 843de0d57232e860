"""Eroded bodies with open faces: closed forms, free-form bodies, faces that lean, and rounds that end the skin."""

from __future__ import annotations

from typing import Any

import build123d as bd
import numpy as np
import pytest

from benchmarks.small_bodies import FREE_FORM_BODIES
from tests.erosion.test_eroded_body import ellipse_perimeter
from tests.shapes.misfits import volume
from tpmscad.brep.boundary_representation import Brep
from tpmscad.erosion.eroded_body import erode_body
from tpmscad.erosion.offset_shell import build_offset_shell
from tpmscad.erosion.sites import FaceSite
from tpmscad.kernel.body_import.body_brep import read_free_form_body
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.boolean.hollow_body import find_skin_faces
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.skin_depth import SkinDepth, measure_skin_thickness
from tpmscad.kernel.occt.exploration import faces_of

pytestmark = pytest.mark.kernel


def eroded(
    body: Any, skin: float, open_along: tuple[bd.Vector, ...] = (), at_height: float | None = None
) -> tuple[Brep, float, float]:
    """The part deeper than the skin, without one below the outermost planar faces, and the least and greatest thickness.

    at_height: that of a face that looks up and gets none.
    """
    read = read_body(body)
    own = faces_of(read.shape)
    opened = [outermost(body, along) for along in open_along]
    if at_height is not None:
        opened += [f for f in body.faces() if abs(f.center().Z - at_height) < 1e-9 and f.normal_at().Z > 0.99]
    source = read_free_form_body(read.shape, [str(i) for i in range(len(own))])
    is_open = np.array([any(face.IsSame(o.wrapped) for o in opened) for face in own])
    brep = erode_body(source.brep, source.free_form, skin, is_open[source.brep.faces.tag])
    parts = [read_body(solid) for solid in build_solids(brep).solids]  # which refuses what the kernel calls invalid
    inner = find_skin_faces([part.shape for part in parts], [o.wrapped for o in opened])
    depth = SkinDepth(read.shape, [face for face, o in zip(own, is_open, strict=True) if not o])
    measured = measure_skin_thickness(inner, depth)
    return brep, measured.least, measured.greatest


def outermost(body: Any, along: bd.Vector) -> bd.Face:
    planar = [f for f in body.faces() if f.geom_type == bd.GeomType.PLANE]
    return max(planar, key=lambda f: f.center().dot(along))


UP, DOWN, RIGHT = bd.Vector(0, 0, 1), bd.Vector(0, 0, -1), bd.Vector(1, 0, 0)


def test_open_faces_get_no_skin_adjacent_ones_included() -> None:
    brep, least, greatest = eroded(bd.Box(16, 14, 12), 1.5, (UP, RIGHT))
    assert volume(brep) == pytest.approx(14.5 * 11 * 10.5, rel=1e-12)
    assert (least, greatest) == pytest.approx((1.5, 1.5), rel=1e-9)


def test_concave_edges_may_end_in_an_open_face() -> None:
    """The tubes of the upright edges of a blind pocket go on beyond the plane that ends them."""
    t = 1.3
    brep, *thickness = eroded(bd.Box(30, 26, 22) - bd.Pos(0, 0, 6) * bd.Box(12, 10, 12), t, (UP,))
    pocket = (
        12 * 10 * (11 + t) + 2 * t * (12 + 10) * 11 + np.pi * t**2 / 4 * (2 * (12 + 10) + 4 * 11) + 2 / 3 * np.pi * t**3
    )
    assert volume(brep) == pytest.approx((30 - 2 * t) * (26 - 2 * t) * (22 - t) - pocket, rel=1e-9)
    assert thickness == pytest.approx([t, t], rel=1e-6)


PLATE = bd.Pos(0, 0, 5) * bd.Box(40, 30, 10)
RIM = np.pi / 4 * 56  # a quarter of a tube below each side of the outline of 16 x 12, on either side of it
CORNER = np.pi / 6  # an eighth of a sphere below each of its corners
CONCAVE_OPEN = {
    "plate with a round boss": (
        PLATE + bd.Pos(0, 0, 15) * bd.Cylinder(8, 10),
        38 * 28 * 9 + np.pi * 49 * 9 - np.pi / 2 * 16 * np.pi,
    ),
    "plate with a block": (
        PLATE + bd.Pos(0, 0, 15) * bd.Box(16, 12, 10),
        38 * 28 * 9 + 14 * 10 * 9 - 2 * RIM - 4 * CORNER + 4 * 2 / 3,
    ),
    "pocket": (
        bd.Pos(0, 0, 10) * bd.Box(30, 30, 20) - bd.Pos(0, 0, 15) * bd.Box(16, 12, 10),
        28 * 28 * 18 - (16 * 12 + 56 + np.pi) * 9 - 2 * RIM - 4 * CORNER + 4 * 2 / 3,
    ),
}
"""Bodies whose face at height 10 is open and meets faces with a skin of 1 along concave edges, and what is left of them. Where
two quarters of tubes meet within the outline they have 2/3 in common."""


@pytest.mark.parametrize("name", CONCAVE_OPEN)
def test_below_an_open_face_the_skin_goes_round_its_concave_edges(name: str) -> None:
    body, expected = CONCAVE_OPEN[name]
    brep, *thickness = eroded(body, 1.0, at_height=10.0)
    assert volume(brep) == pytest.approx(expected, rel=1e-9)
    assert thickness == pytest.approx([1.0, 1.0], rel=1e-6)


@pytest.mark.parametrize(
    "boss",
    [
        bd.extrude(bd.Pos(0, 0, 10) * bd.Ellipse(12, 7), 8),
        bd.extrude(bd.Pos(0, 0, 10) * bd.Polygon((-10, -8), (12, -6), (0, 9)), 8),
        bd.extrude(bd.Pos(0, 0, 10) * bd.RectangleRounded(16, 12, 3), 8),
        bd.Pos(0, 0, 15) * bd.Cone(9, 5, 10),
        bd.Pos(0, 10, 15) * bd.Box(16, 10, 10),
    ],
    ids=["ellipse", "triangle", "rounded", "cone", "flush with a side"],
)
def test_below_an_open_face_the_skin_has_its_thickness_round_any_boss(boss: Any) -> None:
    _, *thickness = eroded(PLATE + boss, 1.0, at_height=10.0)
    assert thickness == pytest.approx([1.0, 1.0], rel=1e-6)


@pytest.mark.parametrize("skin", [0.1, 0.01])
def test_a_skin_may_be_much_thinner_than_a_face(skin: float) -> None:
    """Than what lies between two nodes at which the depth is sampled."""
    for opened, size in (((), (10 - 2 * skin) ** 3), ((UP,), (10 - 2 * skin) ** 2 * (10 - skin))):
        brep, *thickness = eroded(bd.Box(10, 10, 10), skin, opened)
        assert volume(brep) == pytest.approx(size, rel=1e-9)
        assert thickness == pytest.approx([skin, skin], rel=1e-6)


def test_rounds_that_end_the_skin_may_end_in_an_open_face() -> None:
    body = bd.fillet(bd.Box(20, 20, 12).edges().filter_by(bd.Axis.Z), 3)
    brep, *thickness = eroded(body, 1.5, (UP, RIGHT, -RIGHT, bd.Vector(0, 1, 0), bd.Vector(0, -1, 0)))
    corner = 3 * 3 + np.pi * 1.5**2 / 4  # its square without a quarter disc of 1.5, and two of them beside it
    assert volume(brep) == pytest.approx((20 * 20 - 4 * corner) * 10.5, rel=1e-9)
    assert thickness == pytest.approx([1.5, 1.5], rel=1e-6)


def test_a_free_form_body_open_at_one_end_has_its_closed_form_volume() -> None:
    a, b, skin = 3.9, 2.4, 0.8
    brep, least, greatest = eroded(FREE_FORM_BODIES["ellipse"](), skin, (UP,))
    section = np.pi * a * b - ellipse_perimeter(a, b) * skin + np.pi * skin**2
    assert volume(brep) == pytest.approx(section * (5 - skin), rel=2e-7)
    assert (least, greatest) == pytest.approx((skin, skin), rel=1e-6)


@pytest.mark.parametrize("name", ["cam", "blade"])
def test_free_form_bodies_may_be_open(name: str) -> None:
    """Faces of `handle` and `blade` lean in above the open end, where the skin is thicker by the slope."""
    skin = 0.3
    brep, least, greatest = eroded(FREE_FORM_BODIES[name](), skin, (UP,))
    assert least == pytest.approx(skin, rel=1e-6)
    assert greatest < 1.06 * skin
    assert {brep.tags[t] for t in brep.faces.tag} == {"skin"}


def test_smooth_edges_may_meet_open_faces_at_an_angle() -> None:
    """An oblique prism between open ends: its section across is eroded, and its length stays."""
    length, width, radius, height, skin, lean = 20.0, 14.0, 5.0, 12.0, 0.8, (0.3, 0.2)
    along = bd.Vector(*lean, 1).normalized()
    body = bd.extrude(bd.RectangleRounded(length, width, radius), height / along.Z, along)
    brep, least, greatest = eroded(body, skin, (UP, DOWN))
    area = (length * width - (4 - np.pi) * radius**2) * along.Z
    straight = [2 * (size - 2 * radius) * np.sqrt(1 - c**2) for size, c in ((length, along.X), (width, along.Y))]
    section = area - (sum(straight) + ellipse_perimeter(radius, radius * along.Z)) * skin + np.pi * skin**2
    assert volume(brep) == pytest.approx(section * height / along.Z, rel=1e-7)
    assert least == pytest.approx(skin, rel=1e-6)
    assert greatest == pytest.approx(skin / along.Z, rel=3e-3)  # at samples


def test_where_two_faces_go_on_side_by_side_no_foot_is_in_neither() -> None:
    """The halves of a countersunk hole, which goes on to open faces along the rims between them."""
    skin = 0.9
    hole = bd.Pos(0, 0, 5) * bd.Cylinder(4, 10) + bd.Pos(0, 0, 1) * bd.Cone(6, 4, 2)
    body = bd.Rot(0, 0, 35) * (bd.Pos(0, 0, 5) * bd.Box(30, 24, 10) - hole)
    own = faces_of(read_body(body).shape)
    source = read_free_form_body(body.wrapped, [str(i) for i in range(len(own))])
    opened = [outermost(body, along).wrapped for along in (UP, DOWN)]
    is_open = np.array([any(face.IsSame(o) for o in opened) for face in own])[source.brep.faces.tag]
    shell = build_offset_shell(source.brep, source.free_form, skin, is_open)
    faces = [site for site in shell.sites.sites if isinstance(site, FaceSite)]
    points = np.concatenate([rim.curve(np.linspace(*rim.span, 400)) for rim in shell.rims])
    assert np.min([face.feet(points, 2 * skin)[0] for face in faces], axis=0).max() < skin * (1 + 1e-9)


def test_offset_sheets_go_on_beyond_the_ends_of_splines() -> None:
    outlines = ((-22, 10, 9), (-8, 14, 11), (8, 15, 10), (22, 9, 9))
    body = bd.loft([bd.Plane.XY.offset(z) * bd.Ellipse(*radii) for z, *radii in outlines])
    _, least, greatest = eroded(body, 0.6, (UP, DOWN))
    assert least == pytest.approx(0.6, rel=1e-6)
    assert greatest < 1.45 * 0.6


def test_the_skin_ends_in_a_round_beside_a_leaning_face_and_a_fillet() -> None:
    long_edges = bd.Box(40, 24, 12).edges().filter_by(bd.Axis.Y).sort_by(bd.Axis.Z)[-2:]
    below_the_fillet, below_the_round = 3 * 2 - np.pi, np.pi / 4
    brep, *thickness = eroded(bd.fillet(long_edges, 3), 1.0, (UP,))
    assert volume(brep) == pytest.approx(22 * (38 * 11 - 2 * (below_the_fillet + below_the_round)), rel=1e-7)
    assert thickness == pytest.approx([1.0, 1.0], rel=1e-6)
    _, *thickness = eroded(bd.extrude(bd.Rectangle(40, 40), 8, taper=60), 1.0, (UP,))
    assert thickness == pytest.approx([1.0, 1.0], rel=1e-6)
