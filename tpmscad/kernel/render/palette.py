"""Colours of pictures: pieces and scales of values; all can be told apart by colour-blind readers.

Colours are red, green and blue from 0 to 1. The colours of pieces are those of Okabe and Ito (2008), without black and yellow;
the sequential scale is viridis, the diverging one runs from blue through grey to red.
"""

from __future__ import annotations

from colorsys import hls_to_rgb
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, Colour

SURFACE_COLOUR = (0.62, 0.71, 0.80)
"""Colour of a shape that is not coloured by anything."""

UNVALUED_COLOUR = (0.74, 0.75, 0.77)
"""Colour of faces without a value on a picture of values."""

DOMAIN_COLOURS = {
    "wall": (0.72, 0.74, 0.76),
    "channel +": (0.36, 0.56, 0.74),
    "channel -": (0.87, 0.60, 0.32),
}
"""Colours of the domains of an exchanger, by name."""

PIECE_COLOURS = (
    (0.34, 0.66, 0.86),
    (0.90, 0.62, 0.12),
    (0.10, 0.62, 0.47),
    (0.80, 0.47, 0.66),
    (0.20, 0.45, 0.70),
    (0.84, 0.40, 0.12),
    (0.55, 0.57, 0.60),
)
"""Colours of other pieces, in turn."""

GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)

VIRIDIS = (
    (0.267, 0.005, 0.329),
    (0.279, 0.175, 0.483),
    (0.230, 0.322, 0.546),
    (0.173, 0.449, 0.558),
    (0.128, 0.567, 0.551),
    (0.158, 0.684, 0.502),
    (0.369, 0.789, 0.383),
    (0.678, 0.864, 0.190),
    (0.993, 0.906, 0.144),
)
DIVERGING = (
    (0.085, 0.235, 0.530),
    (0.190, 0.430, 0.730),
    (0.480, 0.670, 0.860),
    (0.780, 0.860, 0.930),
    (0.930, 0.925, 0.915),
    (0.960, 0.820, 0.740),
    (0.900, 0.570, 0.440),
    (0.770, 0.270, 0.220),
    (0.520, 0.060, 0.120),
)


@dataclass(frozen=True, slots=True)
class ColourScale:
    """A scale of colours from `low` to `high`; values beyond take the colour of the nearer end.

    title: what the values are, with their unit. least, greatest: the extremes of the values that were measured.
    """

    title: str
    low: float
    high: float
    least: float
    greatest: float
    anchors: tuple[Colour, ...] = VIRIDIS

    def colours(self, values: Array) -> Array:
        """Colours (n, 3) of values (n,)."""
        span = self.high - self.low
        t = (values - self.low) / span if span > 0 else np.zeros_like(values)
        at, table = np.linspace(0.0, 1.0, len(self.anchors)), np.array(self.anchors)
        return np.stack([np.interp(t.clip(0.0, 1.0), at, table[:, k]) for k in range(3)], axis=-1)


def piece_colour(name: str, number: int) -> Colour:
    """Colour of a piece by its name, or in turn by its number."""
    return DOMAIN_COLOURS.get(name) or PIECE_COLOURS[number % len(PIECE_COLOURS)]


def numbered_colour(number: int) -> Colour:
    """Pale colour of one of many faces; those of neighbouring numbers are far apart in hue."""
    return hls_to_rgb(number * GOLDEN_RATIO % 1.0, 0.72, 0.5)


def sequential_scale(title: str, values: Array) -> ColourScale:
    """The scale from zero to the greatest of the values that are not NaN."""
    greatest = float(np.nanmax(values, initial=0.0))
    return ColourScale(title, 0.0, greatest, float(np.nanmin(values, initial=greatest)), greatest)


def diverging_scale(title: str, values: Array, share: float) -> ColourScale:
    """The scale symmetric about zero that holds the given share of the values that are not NaN."""
    known = values[np.isfinite(values)]
    if not len(known):
        return ColourScale(title, 0.0, 0.0, 0.0, 0.0, DIVERGING)
    limit = float(np.quantile(np.abs(known), share))
    return ColourScale(title, -limit, limit, float(known.min()), float(known.max()), DIVERGING)
