"""Light and depth shading of the samples of a picture, and the colours of cuts."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from tpmscad._typing import Array, BoolArray, IntArray

KEY_LIGHT = np.array([-0.45, 0.62, 0.64])
"""Direction of the main light in the eye's frame: x right, y up, z towards the eye."""

FILL_LIGHT = np.array([0.85, 0.1, 0.5])
"""Direction of the second light, in the eye's frame."""

KEY_STRENGTH, FILL_STRENGTH, AMBIENT, SKY_STRENGTH = 0.58, 0.34, 0.20, 0.18
HIGHLIGHT_STRENGTH, HIGHLIGHT_EXPONENT = 0.22, 40

DEPTH_BLURS = ((3.0, 1.6), (16.0, 2.6), (48.0, 1.3))
"""Radius in samples and strength of each depth blur."""

SAMPLES_PER_BLUR_RADIUS = 4
"""A wide blur is computed on a coarser grid, with this many of its samples in a radius."""

MAX_DEPTH_OFFSET = 0.16
"""Depth difference, as a fraction of the depth range, beyond which a sample is not darkened further."""

MIN_DEPTH_SHADE = 0.3

CUT_SHADE, HATCH_SHADE, OUTLINE_SHADE = 0.80, 0.70, 0.32
"""Factors of a piece's colour on a cut, on the hatch lines of a cut, and on its outline."""

HATCH_SPACING, HATCH_WIDTH = 14, 3
"""Distance and width of hatch lines, in samples along x."""


def shade_surface(normal: Array, colour: Array, strength: float = 1.0) -> Array:
    """Colours (n, 3) of surfaces of given colours with unit normals in the eye's frame, lit from two sides and above.

    strength: 1 for full light and shade, 0 for the plain colour.
    """
    n = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    n = np.where(n[:, 2:] < 0, -n, n)
    key, fill = KEY_LIGHT / np.linalg.norm(KEY_LIGHT), FILL_LIGHT / np.linalg.norm(FILL_LIGHT)
    sky = 0.5 + 0.5 * n[:, 1]
    diffuse = KEY_STRENGTH * (n @ key).clip(0) + FILL_STRENGTH * (n @ fill).clip(0) + AMBIENT + SKY_STRENGTH * sky
    half = key + np.array([0.0, 0.0, 1.0])
    shine = HIGHLIGHT_STRENGTH * (n @ (half / np.linalg.norm(half))).clip(0) ** HIGHLIGHT_EXPONENT
    light = 1.0 - strength + strength * diffuse
    return np.asarray(light[:, None] * colour + strength * shine[:, None])


def depth_shading(depth: Array, shown: BoolArray) -> Array:
    """Factor per sample that darkens hollows and the surroundings of outlines.

    It is depth unsharp masking: samples deeper than the blurred depth around them become darker.
    """
    filled = np.where(shown, depth, depth[shown].max(initial=0.0))
    shade = np.ones_like(depth)
    extent = np.ptp(depth[shown]) + 1e-12 if shown.any() else 1.0
    for radius, strength in DEPTH_BLURS:
        behind = (filled - _blur(filled, radius)) / extent
        shade -= strength * behind.clip(0.0, MAX_DEPTH_OFFSET)
    return shade.clip(MIN_DEPTH_SHADE, 1.0)


def _blur(values: Array, radius: float) -> Array:
    """Gaussian blur, on a coarser grid if the radius is wide."""
    step = max(1, int(radius / SAMPLES_PER_BLUR_RADIUS))
    if step == 1 or min(values.shape) < 4 * step:
        return np.asarray(gaussian_filter(values, radius, mode="nearest"))
    rows, columns = (-(-n // step) * step for n in values.shape)
    padded = np.pad(values, ((0, rows - values.shape[0]), (0, columns - values.shape[1])), mode="edge")
    coarse = padded.reshape(rows // step, step, columns // step, step).mean(axis=(1, 3))
    blurred = gaussian_filter(coarse, radius / step, mode="nearest")
    fine = zoom(blurred, step, order=1, mode="nearest", grid_mode=True)
    return np.asarray(fine[: values.shape[0], : values.shape[1]])


def shade_cut(piece: IntArray, colour: Array) -> Array:
    """Colours (height, width, 3) of the cut, where piece (height, width) >= 0; colour (p, 3) is that of each piece.

    The cut is darker than the surface, hatched at 45 degrees, and outlined where it ends or meets another piece.
    """
    rows, columns = np.arange(piece.shape[0])[:, None], np.arange(piece.shape[1])[None]
    lean = np.where(piece % 2 == 0, rows + columns, rows - columns + piece.shape[1] * HATCH_SPACING)
    factor = np.where(lean % HATCH_SPACING < HATCH_WIDTH, HATCH_SHADE, CUT_SHADE)
    for axis in (0, 1):
        for step in (-1, 1):
            edge = np.roll(piece, step, axis=axis) != piece
            factor[edge] = OUTLINE_SHADE
    return np.asarray(factor[..., None] * colour[piece.clip(0)])
