"""Layers for a printer, of a part with tens of thousands of cells, without its solid: one cell is cut and repeated.

The part is a manifold block with two bores, below a skin. `main(cell=1.0)` makes 20,000 cells; the default is a quick look with
large cells. The picture shows one layer: solid is dark.

    pip install "tpmscad[layers]"
    python examples/layers.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
from PIL import Image, ImageChops, ImageDraw

import tpmscad

LENGTH, WIDTH, HEIGHT = 44.0, 28.0, 19.0
PICTURE_WIDTH = 1280


def block() -> bd.Part:
    """A block with rounded edges and two bores, in mm."""
    part = bd.fillet(bd.Box(LENGTH, WIDTH, HEIGHT).edges(), 3)
    return part - bd.Pos(-11, 0, 0) * bd.Cylinder(5, 2 * HEIGHT) - bd.Pos(11, 0, 0) * bd.Cylinder(5, 2 * HEIGHT)


def draw_layer(contours: Any, path: Path) -> None:
    """The contours of a layer, those of holes cut out, as a picture."""
    scale = PICTURE_WIDTH / LENGTH
    picture = Image.new("1", (PICTURE_WIDTH, round(WIDTH * scale)))
    for contour in contours:
        filled = Image.new("1", picture.size)
        points = (np.asarray(contour)[:, :2] * (1, -1) + (LENGTH / 2, WIDTH / 2)) * scale
        ImageDraw.Draw(filled).polygon([tuple(point) for point in points], fill=1)
        picture = ImageChops.logical_xor(picture, filled)
    ImageChops.invert(picture.convert("L")).save(path)


def main(
    path: str | Path = "layers.cli", cell: float = 6.0, height: float = 0.5, chord_error: float = 0.02
) -> dict[str, Any]:
    """Make and write the layers, draw the middle one; return what was measured on them."""
    part = block()
    layers = tpmscad.infill_layers(
        part, "gyroid", cell=cell, volume_fraction=0.25, skin=0.8, height=height, chord_error=chord_error
    )
    layers.write(path)
    middle = layers[len(layers) // 2]
    draw_layer(middle.contours, Path(path).with_suffix(".png"))
    return {
        "cells": round(part.volume / cell**3),
        "layers": len(layers),
        "contours": layers.n_contours,
        "points": layers.n_points,
        "volume fraction": layers.volume / part.volume,
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
