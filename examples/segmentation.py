"""A segmented bone as two solids: its cortical shell as it is, the spongy inside replaced by a diamond lattice.

The segmentation is made up here: label 2 is the shell, label 1 what it encloses. `fields.labels` also reads NIfTI, NRRD and DICOM
files, with their spacing and frame. The surfaces are smooth and within half a voxel of the voxels' faces.

    python examples/segmentation.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import tpmscad
from tpmscad import fields

SHELL, SPONGY = 2, 1


def make_segmentation(size: float, spacing: float) -> np.ndarray:
    """Labels of a piece of bone that widens upwards, cut level at both ends, within a margin of two voxels."""
    count = round(size / spacing) + 4
    x, y, z = (np.indices((count, count, count)) - (count - 1) / 2) * spacing / size
    side = 0.36 + 0.15 * z + 0.05 * np.sin(7 * z) - np.hypot(x, 1.2 * y)
    depth = np.minimum(side, 0.5 - np.abs(z))
    return np.where(depth > 0, np.where(side > 0.09, SPONGY, SHELL), 0).astype(np.uint8)


def main(
    folder: str | Path = ".", size: float = 8.0, spacing: float = 0.5, cell: float = 8.0, tol: float = 0.25
) -> dict[str, Any]:
    """Make, draw and write both solids, in mm; return what was measured on them."""
    organs = make_segmentation(size, spacing)
    spongy = fields.labels(organs, spacing=spacing, label=SPONGY)
    lattice = tpmscad.infill(spongy, "diamond", cell=cell, thickness=0.8, tol=tol)
    shell_field = fields.labels(organs, spacing=spacing, label=SHELL)
    shell = tpmscad.solidify(shell_field, shell_field.domain, tol=tol)
    lattice.export(Path(folder) / "segmentation_lattice.step")
    shell.export(Path(folder) / "segmentation_shell.step")
    lattice.render(Path(folder) / "segmentation_lattice.png", section="y")
    found = {
        name: {
            "met": model.certificate.met,
            "faces": model.certificate.n_faces,
            "deviation": model.certificate.max_deviation,
            "betti": model.certificate.betti,
            "volume": model.volume,
        }
        for name, model in {"lattice": lattice, "shell": shell}.items()
    }
    return {**found, "voxels of the shell": float(np.sum(organs == SHELL) * spacing**3)}


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
