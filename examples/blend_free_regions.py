"""Blending regions of any shape: along a wave, and from a picture with four separate shapes.

They follow figures 10 and 11 of the porous-blending paper. The weight is a trivariate B-spline, fitted to the distances from both
sides of the blending region. Outside it every structure keeps its values bit for bit.
"""

from __future__ import annotations

import numpy as np
from blend_slices import draw, figure, show
from scipy.ndimage import distance_transform_edt

from tpmscad import fields
from tpmscad.blending import BlendResult, blend

BOX = fields.box((0, 0, 0), (1, 1, 0.25))
ROD_P = fields.rod(fields.tpms("schwarz_p", period=0.25), -0.8)
ROD_G = fields.rod(fields.tpms("gyroid", period=0.25), -0.8)
ROD_W = fields.rod(fields.tpms("iwp", period=0.25), -2.0)


def wave(shift: float) -> fields.Field:
    """Below the curve y = 1/2 - sin(2 pi x) / 4 + shift."""
    return fields.from_function(lambda p: p[:, 1] + 0.25 * np.sin(2 * np.pi * p[:, 0]) - 0.5 - shift)


def along_wave(offset: float) -> BlendResult:
    """The border is the wave, the blending region lies between the wave moved by -offset and by offset along y."""
    band = wave(offset) & ~wave(-offset)
    return blend([ROD_P, ROD_W], [wave(0) & BOX, ~wave(0) & BOX], [band], resolution=(100, 100, 25))


def drawing(size: int = 128) -> np.ndarray:
    """A disc, a square, a bar and a diamond."""
    x, y = (np.mgrid[0:size, 0:size] + 0.5) / size
    disc = (x - 0.27) ** 2 + (y - 0.25) ** 2 < 0.15**2
    square = (abs(x - 0.26) < 0.13) & (abs(y - 0.74) < 0.13)
    bar = (abs(x - 0.75) < 0.10) & (abs(y - 0.26) < 0.15)
    return disc | square | bar | (abs(x - 0.74) + abs(y - 0.74) < 0.18)


def from_picture(pixels: int = 8) -> BlendResult:
    """Gyroid rods in the four shapes, Schwarz P around them, blended over 8 pixels on either side of each border."""
    white = drawing()
    near = np.where(white, distance_transform_edt(white), distance_transform_edt(~white)) <= pixels
    shapes, band = (fields.image_region(mask, (0, 0), (1, 1)) for mask in (white, near))
    return blend([ROD_P, ROD_G], [BOX & ~shapes, BOX & shapes], [band], resolution=(50, 50, 25))


def main() -> dict[str, BlendResult]:
    """The blends for offsets of 0.1, 0.2 and 0.3, and from the picture."""
    results = {f"wave {offset}": along_wave(offset) for offset in (0.1, 0.2, 0.3)}
    results["picture"] = from_picture()
    for name, result in results.items():
        assert result.converged, f"{name}: {result.message}"
        assert result.weights[0].coefficients.ndim == 3
    points = np.random.default_rng(0).uniform((0, 0, 0), (1, 1, 0.25), (20_000, 3))
    below, above = (wave(-0.2)(points) < 0), (wave(0.2)(points) > 0)
    values = results["wave 0.2"].field(points)
    assert np.array_equal(values[below], ROD_P(points)[below])
    assert np.array_equal(values[above], ROD_W(points)[above])
    return results


def picture(results: dict[str, BlendResult], path: str) -> None:
    """Slices of the solids."""

    def fill(panels: list) -> None:
        for panel, (name, result) in zip(panels, results.items(), strict=True):
            draw(panel, result, ((0, 1), (0, 1)), 0.03)
            panel.set_title(name)

    figure(2, 2, (11, 11), path, fill)


if __name__ == "__main__":
    show(main, picture, "blend_free_regions.png")
