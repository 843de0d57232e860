"""Pictures: a z-buffer that agrees with geometry, a PNG that others can read."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from tests.shapes.kernel_shapes import CASES, drilled_dome, plane_box
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.render.picture import draw_scene
from tpmscad.kernel.render.scene import Scene, pieces_of
from tpmscad.kernel.render.tessellation import tessellate
from tpmscad.kernel.render.viewpoints import VIEWS, section_planes, view_frame
from tpmscad.kernel.render.z_buffer import barycentric_weights, cut_segments, fill_segments, rasterise
from tpmscad.studies._render import render


def test_a_triangle_covers_the_pixels_whose_centres_it_holds_and_the_nearer_one_wins() -> None:
    screen = np.array([[0.0, 0.0], [12.0, 0.0], [0.0, 9.0], [12.0, 9.0]])
    depth = np.array([5.0, 5.0, 5.0, 1.0])
    buffer = rasterise(screen, depth, np.array([[0, 1, 2], [1, 3, 0]]), 12, 9)
    x, y = np.meshgrid(np.arange(12) + 0.5, np.arange(9) + 0.5)
    first, second = x / 12 + y / 9 < 1, x / 12 > y / 9
    np.testing.assert_array_equal(buffer.triangle == 1, second)  # it slopes towards the eye everywhere but on its edge
    np.testing.assert_array_equal(buffer.triangle == 0, first & ~second)
    np.testing.assert_allclose(buffer.depth[second], (5.0 - 4.0 * y / 9)[second])
    assert (buffer.triangle[~first & ~second] == -1).all()


def test_triangles_that_share_edges_cover_every_pixel_once() -> None:
    """A fan around a pixel's center: each of 12 x 12 centers lies in one of eight triangles, edges and corners included."""
    ring = np.array([[0, 0], [6.5, 0], [13, 0], [13, 6.5], [13, 13], [6.5, 13], [0, 13], [0, 6.5]], float)
    screen = np.vstack([ring, [[6.5, 6.5]]])
    fan = np.array([[k, (k + 1) % 8, 8] for k in range(8)])
    counts = sum((rasterise(screen, np.zeros(9), fan[k : k + 1], 12, 12).triangle == 0).astype(int) for k in range(8))
    assert (counts == 1).all()


def test_barycentric_weights_restore_the_point() -> None:
    screen = np.random.default_rng(3).uniform(0, 10, (3, 2))
    x, y = np.array([4.5, 1.5]), np.array([2.5, 7.5])
    weights = barycentric_weights(screen, np.array([[0, 1, 2], [2, 0, 1]]), x, y)
    corners = screen[np.array([[0, 1, 2], [2, 0, 1]])]
    np.testing.assert_allclose(np.einsum("pk,pkd->pd", weights, corners), np.stack([x, y], axis=1))


@pytest.mark.parametrize("case", ["mirrored box", "bent frame", "drilled dome"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_filled_section_has_the_area_of_the_body_s_section(case: str, axis: int) -> None:
    """Against the kernel's intersection of the body with a planar face."""
    import build123d as bd

    scene = Scene.of_pieces(pieces_of(build_solids(CASES[case]()).shape))
    low, high = scene.box
    normal, offset = np.eye(3)[axis], float(low[axis] + 0.37 * (high - low)[axis])
    start, end = cut_segments(scene.points, scene.triangles, normal, offset)
    across = [k for k in range(3) if k != axis]
    scale = 400 / float((high - low)[across].max())
    filled = fill_segments((start[:, across] - low[across]) * scale, (end[:, across] - low[across]) * scale, 400, 400)
    plane = bd.Plane(origin=tuple(offset * normal), z_dir=tuple(normal))
    section = bd.Face.make_rect(100, 100, plane) & bd.Solid(build_solids(CASES[case]()).shape)
    assert filled.sum() / scale**2 == pytest.approx(sum(face.area for face in section.faces()), rel=0.02)


def test_a_section_that_is_not_closed_is_left_empty_where_it_is_open() -> None:
    square = np.array([[2.0, 2.0], [8.0, 2.0], [8.0, 8.0], [2.0, 8.0]])
    start, end = square, np.roll(square, -1, axis=0)
    assert fill_segments(start, end, 10, 10).sum() == 36
    broken = end.copy()
    broken[1] = [8.0, 5.0]  # the right side ends half-way down
    assert fill_segments(start, broken, 10, 10).sum() == 18


def test_a_cut_sphere_shows_a_filled_disc_in_its_own_colour() -> None:
    import build123d as bd
    from PIL import Image

    scene = Scene.of_pieces(pieces_of(bd.Sphere(1.0) - bd.Sphere(0.5))).with_piece_colours([(0.9, 0.1, 0.1)])
    pictures = {
        section: np.asarray(Image.open(BytesIO(draw_scene(scene, view="top", section=section, size=(200, 200)))), float)
        for section in (None, "z=0", ((0, 0, 0), (0, 0, -1)))
    }
    ring, hollow = pictures["z=0"][100, 40], pictures["z=0"][100, 100]
    assert ring[0] > 2.5 * ring[1]
    assert hollow[0] > 2.5 * hollow[1]  # the wall of the cavity below, not the background
    assert pictures["z=0"][100, 40].sum() < pictures[None][100, 40].sum()
    assert np.abs(pictures[None] - pictures["z=0"]).max() > 20
    from_below = pictures[((0, 0, 0), (0, 0, -1))]  # the far half is taken away: the near one hides the cut
    np.testing.assert_allclose(from_below[60:140, 60:140], pictures[None][60:140, 60:140], atol=6)


def test_touching_solids_show_the_face_that_looks_at_the_eye() -> None:
    """The top of the lower box and the bottom of the upper one coincide: from below only the lower box's bottom is seen."""
    import build123d as bd
    from PIL import Image

    pair = bd.Compound([bd.Box(2, 2, 1).solid(), (bd.Pos(0, 0, 1) * bd.Box(2, 2, 1)).solid()])
    scene = Scene.of_pieces(pieces_of(pair)).with_piece_colours([(0.9, 0.1, 0.1), (0.1, 0.1, 0.9)])
    for view, brighter in (("bottom", 0), ("top", 2)):
        pixel = np.asarray(Image.open(BytesIO(draw_scene(scene, view=view, size=(64, 64)))), float)[32, 32]
        assert np.argmax(pixel) == brighter


@pytest.mark.parametrize("view", VIEWS)
def test_frames_of_views_are_right_handed_and_z_is_up_where_it_can_be(view: str) -> None:
    frame = view_frame(view)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    assert frame[1, 2] > 0 or abs(frame[2, 2]) == 1.0
    np.testing.assert_allclose(view_frame(",".join(map(str, VIEWS[view]))), frame)


def test_the_front_view_has_x_to_the_right_and_the_eye_at_negative_y() -> None:
    np.testing.assert_array_equal(view_frame("front"), [[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def test_sections_are_read_as_they_are_written() -> None:
    low, high, eye = np.zeros(3), np.array([2.0, 4.0, 6.0]), view_frame("iso")[2]
    (z,) = section_planes("z=5", eye, low, high)
    np.testing.assert_array_equal([*z.normal, z.offset], [0, 0, 1, 5])
    x, y = section_planes("x = 1.5, y", eye, low, high)
    np.testing.assert_array_equal([*x.normal, x.offset, *y.normal, y.offset], [1, 0, 0, 1.5, 0, -1, 0, -2])
    (tilted,) = section_planes(((1, 1, 0), (2, 0, 0)), eye, low, high)
    np.testing.assert_array_equal([*tilted.normal, tilted.offset], [1, 0, 0, 1])
    assert len(section_planes(["z=1", ((0, 0, 0), (0, 1, 0))], eye, low, high)) == 2
    for wrong in ("w=3", "z=high", 5, (1, 2, 3), ((0, 0, 0), (0, 0, 0))):
        with pytest.raises(InvalidRequest, match=r"section|normal"):
            section_planes(wrong, eye, low, high)


@pytest.mark.parametrize("wrong", ["isometric", "1,2", (0, 0, 0), 7, (1, float("nan"), 0)])
def test_a_view_that_is_not_understood_is_refused_with_the_names(wrong: object) -> None:
    with pytest.raises(InvalidRequest, match="front"):
        view_frame(wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [(8, 100), (100, 100000), "large", (100,)])
def test_a_size_that_cannot_be_drawn_is_refused(size: object) -> None:
    with pytest.raises(InvalidRequest, match="size"):
        draw_scene(Scene.of_pieces(pieces_of(build_solids(plane_box()).shape)), size=size)  # type: ignore[arg-type]


def test_the_mean_curvature_is_positive_on_convex_faces_whatever_their_orientation() -> None:
    import build123d as bd

    part = bd.Sphere(3) - bd.Pos(3, 0, 0) * bd.Cylinder(0.5, 20)
    for body in (part, bd.mirror(part, bd.Plane.YZ)):
        scene = Scene.of_pieces(pieces_of(body))
        curvature = scene.mean_curvature()
        on_sphere = np.abs(np.linalg.norm(scene.points, axis=1) - 3) < 1e-9
        inside = np.linalg.norm(scene.points, axis=1) < 2.9
        np.testing.assert_allclose(curvature[on_sphere & np.isfinite(curvature)].max(), 1 / 3)
        np.testing.assert_allclose(curvature[inside], -1.0)


def test_drawing_leaves_a_shape_without_triangles_as_it_was() -> None:
    import build123d as bd
    from OCP.BRep import BRep_Tool
    from OCP.TopLoc import TopLoc_Location

    body = bd.Sphere(1.0)
    Scene.of_pieces(pieces_of(body))
    assert BRep_Tool.Triangulation_s(body.face().wrapped, TopLoc_Location()) is None


def test_triangles_off_the_picture_are_clipped() -> None:
    buffer = rasterise(
        np.array([[-50.0, -50.0], [80.0, -50.0], [-50.0, 80.0]]), np.zeros(3), np.array([[0, 1, 2]]), 6, 4
    )
    assert (buffer.triangle == 0).all()


@pytest.mark.parametrize("case", ["mirrored box", "bent frame", "drilled dome"])
def test_normals_point_out_of_the_solid_and_corners_turn_with_them(case: str) -> None:
    found = tessellate(build_solids(CASES[case]()).shape, 0.01)
    a, b, c = (found.points[found.triangles[:, k]] for k in range(3))
    facet = np.cross(b - a, c - a)
    assert (np.einsum("fd,fkd->fk", facet, found.normals[found.triangles]) > 0).all()
    volume = np.einsum("fd,fd->", facet, a) / 6
    assert volume == pytest.approx(check_shape(build_solids(CASES[case]()).shape).volume, rel=0.02)


def test_a_picture_is_a_png_that_shows_the_body_before_a_light_ground(tmp_path: Path) -> None:
    from matplotlib.image import imread

    render(build_solids(drilled_dome()).shape, tmp_path / "dome.png", size=(160, 120))
    image = imread(tmp_path / "dome.png")[..., :3]
    assert image.shape == (120, 160, 3)
    assert image[0, 0].min() > 0.9
    dark = image.mean(axis=2) < 0.8
    assert 0.15 < dark.mean() < 0.7
    assert image[dark].std() > 0.05  # shaded, not a silhouette


def test_equal_shapes_make_equal_pictures() -> None:
    first, second = (
        draw_scene(Scene.of_pieces(pieces_of(build_solids(plane_box()).shape)), size=(64, 48)) for _ in range(2)
    )
    assert first == second


def test_another_extension_or_a_missing_folder_is_refused(tmp_path: Path) -> None:
    shape = build_solids(plane_box()).shape
    with pytest.raises(InvalidRequest, match=r"\.jpg"):
        render(shape, tmp_path / "a.jpg")
    with pytest.raises(InvalidRequest, match=r"folder .*nowhere"):
        render(shape, tmp_path / "nowhere" / "a.png")


@pytest.mark.parametrize("section", ["z=5.1", "x=1,y=-0.1", ((9.0, 9.0, 9.0), (1.0, 1.0, 1.0))])
def test_a_section_beside_the_part_is_refused_with_its_box(section: Any) -> None:
    scene = Scene.of_pieces(pieces_of(build_solids(CASES["box of planes"]()).shape))
    with pytest.raises(InvalidRequest, match=r"lies between \(0, 0, 0\) and \(2, 3, 5\)"):
        draw_scene(scene, section=section, size=(60, 60))
