"""A bone implant whose porosity follows a CT image: gyroid rods in a rounded plug, dense where the bone is dense.

The image is made up here: a cortical shell round trabecular bone, with noise. `fields.sampled` also reads NIfTI, NRRD
and VTK files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
from scipy import ndimage

import tpmscad
from tpmscad import fields

SPACING = 0.5
"""Of the image, mm."""

LEAST, GREATEST = 0.3, 0.7
"""Volume fractions of the rods for the least and the greatest density of the image."""


def bone_image(radius: float, height: float) -> np.ndarray:
    """Densities (nx, ny, nz) in Hounsfield units of a bone around the z axis, smoothed as measured data should be."""
    reach = radius + 2
    count = round(2 * reach / SPACING) + 1, round((height + 2) / SPACING) + 1
    x, y = (a * SPACING - reach for a in np.mgrid[: count[0], : count[0]])
    shell = 1 / (1 + np.exp(-(np.hypot(x, y) - 0.7 * radius) / 0.6))
    noise = np.random.default_rng(7).normal(0, 150, (count[0], count[0], count[1]))
    return ndimage.gaussian_filter(400 + 900 * shell[..., None] + noise, 2.0)


def graded_rods(image: np.ndarray, radius: float, cell: float) -> fields.Field:
    """Rods of a gyroid whose volume fraction rises with the density of the image."""
    share = (image - image.min()) / np.ptp(image)
    reach = radius + 2
    fraction = fields.sampled(LEAST + (GREATEST - LEAST) * share, SPACING, (-reach, -reach, -1.0))
    gyroid = fields.tpms("gyroid", cell)
    span = LEAST - 0.05, GREATEST + 0.05  # the spline through the samples passes their range a little
    return fields.rod(gyroid, fields.graded_threshold(gyroid, fraction, span))


def main(
    path: str | Path = "implant.step", radius: float = 4.0, height: float = 5.0, cell: float = 4.0, tol: float = 0.1
) -> dict[str, Any]:
    """Make, draw and write the implant, in mm; return what was measured on it."""
    plug = bd.Pos(0, 0, height / 2) * bd.Cylinder(radius, height)
    plug = bd.fillet(plug.edges().sort_by(bd.Axis.Z)[:1], radius / 4)
    rods = graded_rods(bone_image(radius, height), radius, cell)
    model = tpmscad.infill(plug, rods, tol=tol)
    model.export(path)
    model.render(Path(path).with_suffix(".png"), section="y")
    certificate = model.certificate
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "betti": certificate.betti,
        "volume fraction": model.volume / plug.volume,
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
