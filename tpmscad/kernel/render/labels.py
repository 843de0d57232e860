"""Text in pictures: the key of pieces or tags, the bar of a colour scale, and the axes. Pillow draws it with its own font."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tpmscad._typing import Array, Colour
from tpmscad.kernel.render.palette import ColourScale

TEXT_COLOUR = (45, 50, 58)
FRAME_COLOUR = (120, 126, 134)
AXIS_COLOURS = ((0.80, 0.25, 0.20), (0.20, 0.55, 0.30), (0.20, 0.40, 0.75))
MAX_KEY_ENTRIES = 20
"""Entries of the key; further ones are counted."""

TEXT_FRACTION = 0.022
"""Height of the text, as a fraction of the picture's shorter side."""

MIN_TEXT_PIXELS = 10
"""Below this height text cannot be read; small pictures go without labels."""

MIN_LABELLED_PIXELS = 240
"""Shorter side of the smallest picture that has labels."""

BAR_TICKS = 5
"""Labelled values of the bar of a colour scale."""


def scale_panel_width(width: int, height: int) -> int:
    """Pixels at the right of a picture that the bar of a colour scale takes; 0 in pictures too small for labels."""
    return round(11.0 * _text_pixels(width, height)) if has_labels(width, height) else 0


def has_labels(width: int, height: int) -> bool:
    """Whether a picture of this size is large enough for text."""
    return min(width, height) >= MIN_LABELLED_PIXELS


class LabelledPicture:
    """A picture in work, to which labels are added."""

    def __init__(self, pixels: Array) -> None:
        """Begin with colours in [0, 1]: (height, width, 3)."""
        self._image = Image.fromarray(np.rint(255.0 * pixels.clip(0.0, 1.0)).astype(np.uint8))
        self._draw = ImageDraw.Draw(self._image)
        self._text = _text_pixels(*self._image.size)
        self._font = ImageFont.load_default(self._text)

    def add_key(self, entries: Sequence[tuple[str, Colour]]) -> None:
        """A square of colour and a name for each entry, in the upper left corner."""
        shown = list(entries[:MAX_KEY_ENTRIES])
        side, y = self._text, self._text
        for name, colour in shown:
            self._draw.rectangle((side, y, 2 * side, y + side), _to_bytes(colour), FRAME_COLOUR)
            self._write(2.5 * side, y + 0.5 * side, name, "lm")
            y += round(1.6 * side)
        if len(entries) > len(shown):
            self._write(side, y + 0.5 * side, f"and {len(entries) - len(shown)} more", "lm")

    def add_scale(self, scale: ColourScale) -> None:
        """The bar of a colour scale at the right side, with its values and what they are."""
        width, height = self._image.size
        unit = self._text
        left = width - scale_panel_width(width, height) + unit
        right = left + unit
        top, bottom = round(0.16 * height), round(0.86 * height)
        values = np.linspace(scale.high, scale.low, bottom - top)
        bar = np.repeat(np.rint(255 * scale.colours(values)).astype(np.uint8)[:, None], right - left, axis=1)
        self._image.paste(Image.fromarray(bar), (left, top))
        self._draw.rectangle((left - 1, top - 1, right, bottom), None, FRAME_COLOUR)
        for t in np.linspace(0.0, 1.0, BAR_TICKS):
            value, y = scale.low + float(t) * (scale.high - scale.low), bottom - float(t) * (bottom - top)
            self._draw.line((right, y, right + 0.4 * unit, y), FRAME_COLOUR)
            beyond = ">= " if t == 1 and scale.greatest > value else "<= " if t == 0 and scale.least < value else ""
            self._write(right + 0.7 * unit, y, f"{beyond}{value:.3g}", "lm")
        lines = scale.title.split("\n")
        for k, line in enumerate(lines):
            self._write(left, top - (1.3 * (len(lines) - k) + 0.2) * unit, line, "lm")
        self._write(left, bottom + 1.3 * unit, f"least {scale.least:.3g}", "lm")
        self._write(left, bottom + 2.6 * unit, f"greatest {scale.greatest:.3g}", "lm")

    def add_axes(self, frame: Array) -> None:
        """The directions of x, y and z in the lower left corner; rows of the frame are right, up and towards the eye."""
        length, margin = 2.2 * self._text, 3.6 * self._text
        origin = np.array([margin, self._image.size[1] - margin])
        for axis in np.argsort(frame[2]):  # the farthest first
            end = origin + length * np.array([frame[0, axis], -frame[1, axis]])
            colour = _to_bytes(AXIS_COLOURS[axis])
            self._draw.line((*origin.tolist(), *end.tolist()), colour, max(1, self._text // 8))
            if np.linalg.norm(end - origin) > 0.2 * length:
                tip = origin + 1.28 * (end - origin)
                self._write(float(tip[0]), float(tip[1]), "XYZ"[axis], "mm", colour)

    def encode(self) -> bytes:
        """The bytes of an 8-bit PNG file."""
        stream = BytesIO()
        self._image.save(stream, "PNG", compress_level=6)
        return stream.getvalue()

    def _write(self, x: float, y: float, text: str, anchor: str, colour: tuple[int, int, int] = TEXT_COLOUR) -> None:
        self._draw.text((x, y), text, colour, self._font, anchor)


def _text_pixels(width: int, height: int) -> int:
    """Height of the text in a picture of this size."""
    return max(MIN_TEXT_PIXELS, round(TEXT_FRACTION * min(width, height)))


def _to_bytes(colour: Colour) -> tuple[int, int, int]:
    """The colour as bytes."""
    red, green, blue = (round(255 * c) for c in colour)
    return red, green, blue
