"""Masks from pictures and from saved NumPy arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest

LUMA_WEIGHTS = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue in the brightness (ITU-R BT.601)."""


def read_numpy_array(path: Path) -> NDArray[Any]:
    """The array of a .npy file."""
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except (ValueError, OSError) as error:
        raise InvalidRequest(f"file {path.name} is not an array that NumPy saved: {error}") from error


def read_mask(path: Path, threshold: float, solid: str) -> NDArray[np.bool_]:
    """The solid pixels of a picture or the true voxels of an array: (nx, ny) or (nx, ny, nz), y upwards.

    In a picture they are darker than `threshold` (0 to 1), or lighter if `solid` is "light". An array must be boolean.
    """
    if path.suffix.lower() == ".npy":
        values = read_numpy_array(path)
        if values.dtype == bool:
            return values
        raise InvalidRequest(
            f"file {path.name} holds {values.dtype}, not booleans: save the comparison with a threshold, or use "
            'kind = "sampled" with a level, or kind = "labels" for integers'
        )
    picture = read_brightness(path)
    chosen = picture < threshold if solid == "dark" else picture >= threshold
    if chosen.all() or not chosen.any():
        raise InvalidRequest(
            f"threshold {threshold:g} has all pixels of {path.name} on one side: change it, or the picture"
        )
    return np.ascontiguousarray(chosen.T[:, ::-1])


def read_brightness(path: Path) -> Array:
    """The brightness of a PNG or TIFF picture, 0 to 1, rows from the top: (height, width). Transparent pixels are white.

    Colours and alpha of 16 bits are read as 8 bits, grey ones as 16.
    """
    try:
        with Image.open(path, formats=("PNG", "TIFF")) as picture:
            picture.load()
    except UnidentifiedImageError as error:
        raise InvalidRequest(
            f"file {path.name} is not a PNG file, nor TIFF; save the picture as PNG, or a mask with numpy.save"
        ) from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InvalidRequest(f"file {path.name} cannot be decompressed: {error}") from error
    if picture.mode.startswith("I;16"):
        return np.asarray(picture) / 65535
    bands = "L" if picture.mode in ("1", "L", "LA") else "RGB"
    transparent = picture.has_transparency_data
    samples = np.atleast_3d(np.asarray(picture.convert(bands + ("A" if transparent else "")))) / 255
    grey = samples[..., 0] if bands == "L" else samples[..., :3] @ LUMA_WEIGHTS
    return 1.0 - samples[..., -1] * (1.0 - grey) if transparent else grey
