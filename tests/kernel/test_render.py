"""Pictures: a z-buffer that agrees with geometry, a PNG that others can read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from tests.shapes.kernel_shapes import CASES, drilled_dome, plane_box
from tpmscad import kernel
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.render.picture import encode_png, render_pixels
from tpmscad.kernel.render.tessellation import tessellate
from tpmscad.kernel.render.z_buffer import rasterise


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


def test_triangles_off_the_picture_are_clipped() -> None:
    buffer = rasterise(
        np.array([[-50.0, -50.0], [80.0, -50.0], [-50.0, 80.0]]), np.zeros(3), np.array([[0, 1, 2]]), 6, 4
    )
    assert (buffer.triangle == 0).all()


@pytest.mark.parametrize("case", ["mirrored box", "bent frame", "drilled dome"])
def test_normals_point_out_of_the_solid_and_corners_turn_with_them(case: str) -> None:
    found = tessellate(kernel.build_solids(CASES[case]()).shape, 0.01)
    a, b, c = (found.points[found.triangles[:, k]] for k in range(3))
    facet = np.cross(b - a, c - a)
    assert (np.einsum("fd,fkd->fk", facet, found.normals[found.triangles]) > 0).all()
    volume = np.einsum("fd,fd->", facet, a) / 6
    assert volume == pytest.approx(kernel.check_shape(kernel.build_solids(CASES[case]()).shape).volume, rel=0.02)


def test_a_picture_is_a_png_that_shows_the_body_before_a_light_ground(tmp_path: Path) -> None:
    from matplotlib.image import imread

    kernel.render_png(kernel.build_solids(drilled_dome()).shape, tmp_path / "dome.png", width=160, height=120)
    image = imread(tmp_path / "dome.png")[..., :3]
    assert image.shape == (120, 160, 3)
    assert image[0, 0].min() > 0.9
    dark = image.mean(axis=2) < 0.8
    assert 0.15 < dark.mean() < 0.7
    assert image[dark].std() > 0.05  # shaded, not a silhouette


def test_equal_shapes_make_equal_pictures() -> None:
    first, second = (encode_png(render_pixels(kernel.build_solids(plane_box()).shape, 64, 48)) for _ in range(2))
    assert first == second


def test_another_extension_or_a_missing_folder_is_refused(tmp_path: Path) -> None:
    shape = kernel.build_solids(plane_box()).shape
    with pytest.raises(InvalidRequest, match=r"\.jpg"):
        kernel.render_png(shape, tmp_path / "a.jpg")
    with pytest.raises(InvalidRequest, match=r"folder .*nowhere"):
        kernel.render_png(shape, tmp_path / "nowhere" / "a.png")
