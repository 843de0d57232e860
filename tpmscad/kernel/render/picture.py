"""Shaded pictures of shapes, without a display or graphics library.

OCCT triangulates the shape, a z-buffer finds the visible triangle of each sample, and two soft lights with depth shading give
the colour. Sections are cut sample by sample: what lies in front of the planes is left out, and the cut of a closed piece is
filled where its winding number in the plane is not zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray, Colour, IntArray
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel.render.labels import LabelledPicture, has_labels, scale_panel_width
from tpmscad.kernel.render.palette import UNVALUED_COLOUR, ColourScale
from tpmscad.kernel.render.scene import Scene
from tpmscad.kernel.render.shading import depth_shading, shade_cut, shade_surface
from tpmscad.kernel.render.viewpoints import SectionPlane, View, require_cuts, section_planes, view_frame
from tpmscad.kernel.render.z_buffer import MIN_FACING, barycentric_weights, cut_segments, fill_segments, rasterise

SAMPLES_PER_PIXEL_AXIS = 2
"""Samples per pixel along x and along y."""

MARGIN_FRACTION = 0.04
"""Width of the empty border, as a fraction of the picture."""

BACKGROUND_COLOURS = np.array([[0.985, 0.985, 0.98], [0.86, 0.875, 0.89]])

MIN_PIXELS, MAX_PIXELS = 16, 4096
"""Least and greatest width and height; the greatest picture takes about 6 GB of memory."""

VALUE_SHADING = 0.5
"""Strength of light and shade where colours are values, so that they can be read off the scale."""

FLUSH_FRACTION = 1e-9
"""Fraction of the size of the scene by which a sample must lie in front of a section plane to be left out."""


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """An orthographic view: rows of `frame` are right, up and towards the eye; `scale` in samples per model unit."""

    frame: Array
    centre: Array
    scale: float
    width: int
    height: int

    def project(self, points: Array) -> tuple[Array, Array]:
        """Sample coordinates (n, 2), x to the right and y down, and depth (n,), of points (n, 3)."""
        seen = (points @ self.frame.T - self.centre) * self.scale
        return np.array([0.5 * self.width, 0.5 * self.height]) + seen[:, :2] * np.array([1.0, -1.0]), -seen[:, 2]

    def plane(self, plane: SectionPlane) -> tuple[Array, float]:
        """Coefficients (a, b, c) and e of the plane: a x + b y + c depth + e is the height above it, in samples."""
        a, b, c = self.frame @ plane.normal
        centre = float(self.frame @ plane.normal @ self.centre)
        e = (centre - plane.offset) * self.scale - a * 0.5 * self.width + b * 0.5 * self.height
        return np.array([a, -b, -c]), float(e)


def draw_scene(
    scene: Scene,
    *,
    view: View = "iso",
    section: Any = None,
    size: tuple[int, int] = (1200, 900),
    scale: ColourScale | None = None,
    key: Sequence[tuple[str, Colour]] = (),
    axes: bool = False,
) -> bytes:
    """The bytes of a PNG picture of the scene; see `viewpoints` for the views and sections.

    scale: the scale of the scene's values, drawn at the right side. key: names and colours in the upper left corner.
    axes: whether the directions of the axes are shown.
    """
    width, height = _validate_size(size)
    frame = view_frame(view)
    planes = section_planes(section, frame[2], *scene.box)
    require_cuts(planes, *scene.box)
    panel = scale_panel_width(width, height) if scale is not None else 0
    ground = _background(width, height)
    ground[:, : width - panel] = _draw_pixels(scene, frame, planes, width - panel, height, scale)
    picture = LabelledPicture(ground)
    if has_labels(width, height):
        if key:
            picture.add_key(key)
        if scale is not None:
            picture.add_scale(scale)
        if axes:
            picture.add_axes(frame)
    return picture.encode()


def _draw_pixels(
    scene: Scene, frame: Array, planes: tuple[SectionPlane, ...], width: int, height: int, scale: ColourScale | None
) -> Array:
    """The picture without labels, as colours in [0, 1]: (height, width, 3)."""
    step = SAMPLES_PER_PIXEL_AXIS
    camera = _fit_camera(scene.points, frame, step * width, step * height)
    screen, depth = camera.project(scene.points)
    triangles = scene.triangles[_faces_eye(scene, screen)]
    buffer = rasterise(screen, depth, triangles, camera.width, camera.height, _kept_behind(camera, planes))
    image = np.repeat(_background(1, camera.height), camera.width, axis=1)
    front, shown = buffer.depth, buffer.triangle >= 0
    y, x = np.nonzero(shown)
    corners = triangles[buffer.triangle[shown]]
    weights = barycentric_weights(screen, corners, x + 0.5, y + 0.5)
    normal = np.einsum("pk,pkd->pd", weights, (scene.normals @ frame.T)[corners])
    strength = 1.0 if scale is None else VALUE_SHADING
    image[shown] = shade_surface(normal, _surface_colours(scene, corners, weights, scale), strength)
    cut = _draw_cuts(scene, camera, planes, front)
    if cut is not None:
        front, of_piece = cut
        visible = of_piece >= 0
        image[visible] = shade_cut(of_piece, scene.cut_colours)[visible]
        shown = shown | visible
    if not shown.any():
        raise KernelError("draw", "nothing of the shape lies behind the section planes: move them")
    image[shown] *= 1.0 - strength + strength * depth_shading(front, shown)[shown][:, None]
    return np.asarray(image.reshape(height, step, width, step, 3).mean(axis=(1, 3)).clip(0.0, 1.0))


def _surface_colours(scene: Scene, corners: IntArray, weights: Array, scale: ColourScale | None) -> Array:
    """Colours (n, 3) of visible samples, from the colours or from the values of the scene's points."""
    if scene.values is None or scale is None:
        return scene.colours[corners[:, 0]]
    value = np.einsum("pk,pk->p", weights, scene.values[corners])
    known = np.isfinite(value)
    colours = np.tile(np.array(UNVALUED_COLOUR), (len(value), 1))
    colours[known] = scale.colours(value[known])
    return colours


def _faces_eye(scene: Scene, screen: Array) -> BoolArray:
    """Triangles that can be seen: of closed pieces those towards the eye, of open ones all."""
    a, b, c = (screen[scene.triangles[:, k]] for k in range(3))
    turn = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return (turn < 0) | ~scene.closed[scene.piece_of_triangle]  # y runs down, so that turns are reversed


def _kept_behind(camera: Camera, planes: tuple[SectionPlane, ...]) -> Any:
    """The test of `rasterise` for samples that are not in front of all planes; None without planes."""
    if not planes:
        return None
    rows = [camera.plane(plane) for plane in planes]
    slack = FLUSH_FRACTION * (camera.width + camera.height)

    def keep(x: Array, y: Array, depth: Array) -> BoolArray:
        kept = np.zeros(len(x), bool)
        for (a, b, c), e in rows:
            kept |= a * x + b * y + c * depth + e <= slack
        return kept

    return keep


def _draw_cuts(
    scene: Scene, camera: Camera, planes: tuple[SectionPlane, ...], front: Array
) -> tuple[Array, IntArray] | None:
    """Depth with the cuts, and the piece that is cut at each sample, -1 elsewhere; None without visible cuts."""
    depth, of_piece = front.copy(), np.full(front.shape, -1, np.int64)
    y, x = np.arange(front.shape[0])[:, None], np.arange(front.shape[1])[None]
    found = False
    for number, plane in enumerate(planes):
        (a, b, c), e = camera.plane(plane)
        if -c < MIN_FACING:  # seen edge-on, or from behind
            continue
        level = -(a * (x + 0.5) + b * (y + 0.5) + e) / c
        ahead = np.ones(front.shape, bool)
        for other, (normal, constant) in enumerate(map(camera.plane, planes)):
            if other != number:
                ahead &= normal[0] * (x + 0.5) + normal[1] * (y + 0.5) + normal[2] * level + constant > 0
        for piece in np.flatnonzero(scene.closed).tolist():
            own = scene.triangles[scene.piece_of_triangle == piece]
            start, end = cut_segments(scene.points, own, plane.normal, plane.offset)
            filled = fill_segments(camera.project(start)[0], camera.project(end)[0], camera.width, camera.height)
            filled &= ahead & (level <= depth)
            depth[filled], of_piece[filled] = level[filled], piece
            found = found or bool(filled.any())
    return (depth, of_piece) if found else None


def _fit_camera(points: Array, frame: Array, width: int, height: int) -> Camera:
    """The view that shows all points with a margin."""
    seen = points @ frame.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    extent = np.maximum(high - low, 1e-12 * float(np.linalg.norm(high - low)) + 1e-300)
    scale = (1 - 2 * MARGIN_FRACTION) * min(width / extent[0], height / extent[1])
    return Camera(frame, 0.5 * (low + high), float(scale), width, height)


def _background(width: int, height: int) -> Array:
    """A soft gradient: (height, width, 3)."""
    return np.tile(np.linspace(BACKGROUND_COLOURS[0], BACKGROUND_COLOURS[1], height)[:, None, :], (1, width, 1))


def _validate_size(size: Any) -> tuple[int, int]:
    """Width and height in pixels; InvalidRequest if they are not."""
    try:
        width, height = (int(n) for n in size)
    except (TypeError, ValueError):
        raise InvalidRequest(f"size {size!r} of a picture is two whole numbers: width and height in pixels") from None
    if not all(MIN_PIXELS <= n <= MAX_PIXELS for n in (width, height)):
        raise InvalidRequest(f"size {width} x {height} of a picture: give {MIN_PIXELS} to {MAX_PIXELS} pixels for each")
    return width, height
