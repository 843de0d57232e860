"""Masks from pictures (PNG files, decoded with the standard library) and from saved NumPy arrays.

The decoder follows the PNG specification (W3C, third edition): 1 to 16 bits; grey, colour or palette, with or without alpha; not
interlaced.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
N_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Number of channels of each colour type: grey, colour, palette, grey with alpha, colour with alpha."""

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
            'kind = "sampled" with a level'
        )
    try:
        picture = read_png_brightness(path)
    except ValueError as error:
        raise InvalidRequest(f"file {path.name} {error}") from error
    chosen = picture < threshold if solid == "dark" else picture >= threshold
    if chosen.all() or not chosen.any():
        raise InvalidRequest(
            f"threshold {threshold:g} has all pixels of {path.name} on one side: change it, or the picture"
        )
    return np.ascontiguousarray(chosen.T[:, ::-1])


@dataclass(frozen=True, slots=True)
class _PngHeader:
    """Size in pixels, bits per channel and colour type."""

    width: int
    height: int
    bits: int
    colour: int

    @property
    def channels(self) -> int:
        return N_CHANNELS[self.colour]


def read_png_brightness(path: Path) -> Array:
    """The brightness of a PNG file, 0 to 1, rows from the top: (height, width). Transparent pixels are white."""
    content = path.read_bytes()
    if not content.startswith(PNG_SIGNATURE):
        raise ValueError("is not a PNG file; save the picture as PNG, or a mask with numpy.save")
    header, palette, packed, at = None, None, b"", len(PNG_SIGNATURE)
    while at + 8 <= len(content):
        length, name = int.from_bytes(content[at : at + 4], "big"), content[at + 4 : at + 8]
        chunk = content[at + 8 : at + 8 + length]
        at += 12 + length
        if name == b"IHDR":
            width, height = int.from_bytes(chunk[:4], "big"), int.from_bytes(chunk[4:8], "big")
            header = _PngHeader(width, height, chunk[8], chunk[9])
            if chunk[12]:
                raise ValueError("is interlaced; save it without interlacing")
        elif name == b"PLTE":
            palette = np.frombuffer(chunk, np.uint8).reshape(-1, 3) / 255
        elif name == b"IDAT":
            packed += chunk
    if header is None or not packed:
        raise ValueError("is incomplete")
    try:
        raw = zlib.decompress(packed)
    except zlib.error as error:
        raise ValueError(f"cannot be decompressed: {error}") from error
    return _convert_to_grey(_decode_samples(raw, header), header, palette)


def _decode_samples(raw: bytes, header: _PngHeader) -> NDArray[np.uint16]:
    """The samples of the unfiltered rows: (height, width, channels)."""
    pixel_bytes = max(1, header.channels * header.bits // 8)
    length = (header.width * header.channels * header.bits + 7) // 8
    if len(raw) < header.height * (length + 1):
        raise ValueError("is incomplete")
    rows = np.frombuffer(raw, np.uint8, header.height * (length + 1)).reshape(header.height, length + 1)
    lines = np.zeros((header.height, length), np.uint8)
    above = [0] * length
    for k, (filter_type, *row) in enumerate(rows.tolist()):
        above = _undo_row_filter(filter_type, row, above, pixel_bytes)
        lines[k] = above
    if header.bits == 16:
        values = lines.reshape(header.height, -1, 2).astype(np.uint16)
        flat = values[..., 0] * np.uint16(256) + values[..., 1]
    elif header.bits == 8:
        flat = lines.astype(np.uint16)
    else:
        single = np.unpackbits(lines, axis=1).reshape(header.height, -1, header.bits)
        flat = (single @ (1 << np.arange(header.bits)[::-1])).astype(np.uint16)
    return flat[:, : header.width * header.channels].reshape(header.height, header.width, header.channels)


def _undo_row_filter(filter_type: int, row: list[int], above: list[int], pixel_bytes: int) -> list[int]:
    """The bytes of a row before its filter, 0 to 4: none, left, up, mean, Paeth."""
    if filter_type == 0:
        return row
    if filter_type == 2:
        return [(a + b) & 255 for a, b in zip(row, above, strict=True)]
    out = [0] * pixel_bytes + row
    for k in range(len(row)):
        left, up, corner = out[k], above[k], above[k - pixel_bytes] if k >= pixel_bytes else 0
        if filter_type == 1:
            predictor = left
        elif filter_type == 3:
            predictor = (left + up) // 2
        else:
            first, second, third = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
            predictor = left if first <= second and first <= third else up if second <= third else corner
        out[k + pixel_bytes] = (row[k] + predictor) & 255
    return out[pixel_bytes:]


def _convert_to_grey(samples: NDArray[np.uint16], header: _PngHeader, palette: Array | None) -> Array:
    """The brightness of samples (height, width, channels) on white, 0 to 1: (height, width)."""
    if header.colour == 3:
        if palette is None:
            raise ValueError("has no palette")
        return palette[samples[..., 0]] @ LUMA_WEIGHTS
    values = samples / (2.0**header.bits - 1)
    grey = values[..., :3] @ LUMA_WEIGHTS if header.colour in (2, 6) else values[..., 0]
    if header.colour in (4, 6):
        grey = 1.0 - values[..., -1] * (1.0 - grey)
    return np.asarray(grey)
