"""Masks from pictures: PNG files, read with the standard library, and arrays of NumPy.

PNG as in its specification (W3C, third edition): 1 to 16 bits, grey, colour or palette, with or without alpha, not interlaced.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array
from tpmscad.recipe.toml_entry import Entry

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
N_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Of each colour type: grey, colour, palette, grey and alpha, colour and alpha."""

LUMA_WEIGHTS = np.array([0.299, 0.587, 0.114])
"""Brightness of red, green and blue (ITU-R BT.601)."""


def read_mask(entry: Entry) -> NDArray[np.bool_]:
    """The solid pixels of the picture or array that an image's table names: (nx, ny) or (nx, ny, nz), y upwards.

    Of a picture those darker than `threshold` (0 to 1, by default 0.5), or lighter with solid = "light"; of an array of truth
    values the true ones.
    """
    named = entry["file"]
    path = named.beside()
    if path.suffix.lower() == ".npy":
        values = read_numpy_array(named)
        if values.dtype == bool:
            return values
        raise named.error(f"{path.name} holds {values.dtype}, not truth values: save the comparison with a threshold")
    try:
        picture = read_png_brightness(path)
    except ValueError as error:
        raise named.error(f"{path.name}: {error}") from error
    threshold, solid = entry.get("threshold"), entry.get("solid")
    limit = 0.5 if threshold is None else threshold.number()
    dark = solid is None or solid.text(("dark", "light")) == "dark"
    chosen = picture < limit if dark else picture >= limit
    if chosen.all() or not chosen.any():
        raise named.error(
            f"{path.name} has nothing on {'one' if dark else 'the other'} side of the threshold {limit:g}"
        )
    return np.ascontiguousarray(chosen.T[:, ::-1])


def read_numpy_array(entry: Entry) -> NDArray[Any]:
    """The array of a .npy file."""
    path = entry.beside()
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except (ValueError, OSError) as error:
        raise entry.error(f"{path.name} is no array that NumPy saved: {error}") from error


@dataclass(frozen=True, slots=True)
class _PngHeader:
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
        raise ValueError("is no PNG file; save the picture as PNG, or a mask with numpy.save")
    header, palette, packed, at = None, None, b"", len(PNG_SIGNATURE)
    while at + 8 <= len(content):
        length, name = int.from_bytes(content[at : at + 4], "big"), content[at + 4 : at + 8]
        chunk = content[at + 8 : at + 8 + length]
        at += 12 + length
        if name == b"IHDR":
            width, height = int.from_bytes(chunk[:4], "big"), int.from_bytes(chunk[4:8], "big")
            header = _PngHeader(width, height, chunk[8], chunk[9])
            if chunk[12]:
                raise ValueError("is interlaced; save it without")
        elif name == b"PLTE":
            palette = np.frombuffer(chunk, np.uint8).reshape(-1, 3) / 255
        elif name == b"IDAT":
            packed += chunk
    if header is None or not packed:
        raise ValueError("is cut short")
    try:
        raw = zlib.decompress(packed)
    except zlib.error as error:
        raise ValueError(f"can't be unpacked: {error}") from error
    return _convert_to_grey(_decode_samples(raw, header), header, palette)


def _decode_samples(raw: bytes, header: _PngHeader) -> NDArray[np.uint16]:
    """The rows with their filters undone: (height, width, channels)."""
    step = max(1, header.channels * header.bits // 8)
    length = (header.width * header.channels * header.bits + 7) // 8
    if len(raw) < header.height * (length + 1):
        raise ValueError("is cut short")
    rows = np.frombuffer(raw, np.uint8, header.height * (length + 1)).reshape(header.height, length + 1)
    lines = np.zeros((header.height, length), np.uint8)
    above = [0] * length
    for k, (how, *row) in enumerate(rows.tolist()):
        above = _undo_row_filter(how, row, above, step)
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


def _undo_row_filter(how: int, row: list[int], above: list[int], step: int) -> list[int]:
    """A row as it was before filter 0 to 4 (none, left, up, mean, Paeth)."""
    if how == 0:
        return row
    if how == 2:
        return [(a + b) & 255 for a, b in zip(row, above, strict=True)]
    out = [0] * step + row
    for k in range(len(row)):
        left, up, corner = out[k], above[k], above[k - step] if k >= step else 0
        if how == 1:
            guess = left
        elif how == 3:
            guess = (left + up) // 2
        else:
            first, second, third = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
            guess = left if first <= second and first <= third else up if second <= third else corner
        out[k + step] = (row[k] + guess) & 255
    return out[step:]


def _convert_to_grey(samples: NDArray[np.uint16], header: _PngHeader, palette: Array | None) -> Array:
    if header.colour == 3:
        if palette is None:
            raise ValueError("has no palette")
        return palette[samples[..., 0]] @ LUMA_WEIGHTS
    values = samples / (2.0**header.bits - 1)
    grey = values[..., :3] @ LUMA_WEIGHTS if header.colour in (2, 6) else values[..., 0]
    if header.colour in (4, 6):
        grey = 1.0 - values[..., -1] * (1.0 - grey)
    return np.asarray(grey)
