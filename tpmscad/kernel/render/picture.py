"""Shaded pictures of shapes as PNG files, without a display or graphics library.

OCCT triangulates the shape, a z-buffer finds the visible triangle of each sample, and two soft lights with depth shading give
the colour.
"""

from __future__ import annotations

import os
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tpmscad._typing import Array
from tpmscad.kernel.occt.bounding_boxes import bounding_box
from tpmscad.kernel.render.tessellation import tessellate
from tpmscad.kernel.render.z_buffer import rasterise
from tpmscad.kernel.step.atomic_file import atomic_write, validate_output_path

VIEW_DIRECTION = (1.0, -1.35, 0.85)
"""From the model to the eye: nearly isometric, rotated so that the three visible faces of a cube differ."""

SAMPLES_PER_PIXEL_AXIS = 2
"""Samples per pixel along x and along y."""

DEFLECTION_FRACTION = 6e-4
"""Distance of the triangles from the shape, in diagonals of its box: half a pixel of a large picture."""

MARGIN_FRACTION = 0.04
"""Width of the empty border, as a fraction of the picture."""

SURFACE_COLOUR = np.array([0.62, 0.71, 0.80])
BACKGROUND_COLOURS = np.array([[0.985, 0.985, 0.98], [0.86, 0.875, 0.89]])
KEY_LIGHT = np.array([-0.45, 0.62, 0.64])
"""Direction of the main light in the eye's frame: x right, y up, z towards the eye."""

FILL_LIGHT = np.array([0.85, 0.1, 0.5])
"""Direction of the second light, in the eye's frame."""

KEY_STRENGTH, FILL_STRENGTH, AMBIENT, SKY_STRENGTH = 0.62, 0.30, 0.14, 0.18
HIGHLIGHT_STRENGTH, HIGHLIGHT_EXPONENT = 0.22, 40

DEPTH_BLURS = ((3.0, 1.6), (16.0, 2.6), (48.0, 1.3))
"""Radius in samples and strength of each depth blur."""

MAX_DEPTH_OFFSET = 0.16
"""Depth difference, as a fraction of the depth range, beyond which a sample is not darkened further."""

MIN_DEPTH_SHADE = 0.3


def render_png(shape: Any, path: str | os.PathLike[str], *, width: int = 1200, height: int = 900) -> None:
    """Draw a TopoDS, build123d or CadQuery shape to a PNG file.

    Raises InvalidRequest for another extension or a missing folder, and KernelError if the shape has no face to draw.
    """
    target = validate_output_path(path, (".png",))
    pixels = render_pixels(shape, width, height)
    with atomic_write(target) as aside:
        aside.write_bytes(encode_png(pixels))


def render_pixels(shape: Any, width: int, height: int) -> Array:
    """The picture as colours in [0, 1]: (height, width, 3)."""
    low, high = bounding_box(shape)
    found = tessellate(shape, DEFLECTION_FRACTION * float(np.linalg.norm(high - low)))
    eye = _view_frame(np.array(VIEW_DIRECTION))
    seen = found.points @ eye.T
    w, h = SAMPLES_PER_PIXEL_AXIS * width, SAMPLES_PER_PIXEL_AXIS * height
    centre = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    scale = (1 - 2 * MARGIN_FRACTION) * min(w / np.ptp(seen[:, 0]), h / np.ptp(seen[:, 1]))
    screen = np.array([0.5 * w, 0.5 * h]) + (seen - centre)[:, :2] * np.array([scale, -scale])
    buffer = rasterise(screen, -seen[:, 2] * scale, found.triangles, w, h)
    shown = buffer.triangle >= 0
    corners = found.triangles[buffer.triangle[shown]]
    normal = np.einsum("pk,pkd->pd", buffer.weights[shown], (found.normals @ eye.T)[corners])
    image = np.tile(np.linspace(BACKGROUND_COLOURS[0], BACKGROUND_COLOURS[1], h)[:, None, :], (1, w, 1))
    image[shown] = _shade(normal) * _depth_shading(buffer.depth, shown)[shown][:, None]
    return np.asarray(
        image.reshape(height, SAMPLES_PER_PIXEL_AXIS, width, SAMPLES_PER_PIXEL_AXIS, 3).mean(axis=(1, 3)).clip(0.0, 1.0)
    )


def _view_frame(towards_eye: Array) -> Array:
    """Rows: unit vectors to the right, up, and towards the eye."""
    z = towards_eye / np.linalg.norm(towards_eye)
    x = np.cross([0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _shade(normal: Array) -> Array:
    """Colours for unit normals in the eye's frame: two lights, ambient light from above, and a highlight."""
    n = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    n = np.where(n[:, 2:] < 0, -n, n)
    key, fill = KEY_LIGHT / np.linalg.norm(KEY_LIGHT), FILL_LIGHT / np.linalg.norm(FILL_LIGHT)
    sky = 0.5 + 0.5 * n[:, 1]
    diffuse = KEY_STRENGTH * (n @ key).clip(0) + FILL_STRENGTH * (n @ fill).clip(0) + AMBIENT + SKY_STRENGTH * sky
    half = key + np.array([0.0, 0.0, 1.0])
    shine = HIGHLIGHT_STRENGTH * (n @ (half / np.linalg.norm(half))).clip(0) ** HIGHLIGHT_EXPONENT
    return np.asarray(diffuse[:, None] * SURFACE_COLOUR + shine[:, None])


def _depth_shading(depth: Array, shown: NDArray[np.bool_]) -> Array:
    """Factor per sample that darkens hollows and the surroundings of outlines.

    It is depth unsharp masking: samples deeper than the blurred depth around them become darker.
    """
    filled = np.where(shown, depth, depth[shown].max())
    shade = np.ones_like(depth)
    extent = np.ptp(depth[shown]) + 1e-12
    for radius, strength in DEPTH_BLURS:
        behind = (filled - gaussian_filter(filled, radius)) / extent
        shade -= strength * behind.clip(0.0, MAX_DEPTH_OFFSET)
    return shade.clip(MIN_DEPTH_SHADE, 1.0)


def encode_png(pixels: Array) -> bytes:
    """Bytes of an 8-bit PNG file of colours in [0, 1], (height, width, 3)."""
    rows = np.rint(255.0 * pixels).astype(np.uint8)
    height, width, _ = rows.shape
    raw = np.concatenate([np.zeros((height, 1), np.uint8), rows.reshape(height, -1)], axis=1).tobytes()

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b"")
