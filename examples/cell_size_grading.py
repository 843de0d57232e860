"""A gyroid whose cells shrink from 10 mm to 5 mm along a block, all three edges alike, with little distortion.

The obvious way, phi(k(x) x) with the wave number k = 1 / size, misses the size where k varies: the gradient of k(x) x is
k + k' x. Here the coordinates of the periodic field are phases whose gradients are the closest to k(x) e_i in the mean square,
the solutions of Poisson equations, laplace phase_i = div(k e_i), with Neumann conditions (`cell_phases.py`). Sizes along the
block are then exact; those across it cannot be, for k e_y is no gradient, and come as close as any.

All structures have one volume fraction, hence one homogenised stiffness, whatever the size of their cells. Cell sizes, volume
fractions and strain energies between rigid plates (`voxel_beam.py`) are compared; the best becomes a solid.

    pip install "tpmscad[simulation]" pyamg
    python examples/cell_size_grading.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import tpmscad
from tpmscad import fields

sys.path.insert(0, str(Path(__file__).parent))
from cell_phases import Frequency, follow, modulate, solve_phases
from voxel_beam import confined_moduli

SURFACE, FRACTION = "gyroid", 0.4
SIZES = (10.0, 5.0)
"""Of the cells at both ends, mm; linear between them."""

SPACING = 0.5
"""Of the samples of the phases, mm."""

WINDOWS, CONTROL = 4, 10.0
"""Windows along the block in which structures are measured; the cell of the uniform lattice they are compared with, mm."""


def cut_rods(phi: fields.Field, box: tuple) -> fields.Field:
    """Rods with the volume fraction in the box."""
    return fields.rod(phi, fields.threshold_for(phi, FRACTION, domain=box))


def measure_gradients(phases: list[fields.Field], frequency: Frequency, box: tuple) -> dict[str, float]:
    """Root mean square errors of cell sizes, and the greatest ratio of stretches of a cell, from the gradients of the phases."""
    points = np.random.default_rng(1).uniform(*box, (5000, 3))
    jacobian = np.stack([phase.gradient(points) for phase in phases], axis=1)
    ratio = frequency(points)[:, None] / np.linalg.norm(jacobian, axis=2)
    stretches = np.linalg.svd(jacobian, compute_uv=False)
    return {
        "cell size error, rms": float(np.sqrt(np.mean((ratio - 1) ** 2))),
        "cell size error, greatest": float(np.abs(ratio - 1).max()),
        "greatest ratio of stretches": float((stretches[:, 0] / stretches[:, 2]).max()),
    }


def count_crossings(field: fields.Field, box: tuple, axis: int) -> np.ndarray:
    """Crossings of the surface per length of lines along an axis, in windows of equal length along x."""
    steps = [0.1 if k == axis else 0.47 for k in range(3)]
    grid = [np.arange(low + s / 2, high, s) for low, high, s in zip(*box, steps, strict=True)]
    changes = np.diff(field.on_grid(*grid) < 0, axis=axis) / steps[axis]
    return np.array([part.mean() for part in np.array_split(changes, WINDOWS)])


def measure_structure(rods: fields.Field, frequency: Frequency, box: tuple) -> dict[str, float]:
    """Root mean square errors of cell sizes by crossings, and of volume fractions, in windows along x."""
    phi = fields.tpms(SURFACE, CONTROL)
    control = fields.rod(phi, fields.threshold_for(phi, FRACTION))
    points = np.random.default_rng(1).uniform(*box, (200_000, 3))
    window = (WINDOWS * (points[:, 0] - box[0][0]) / (box[1][0] - box[0][0])).astype(int)
    per_window = np.bincount(window)
    wanted = np.bincount(window, frequency(points)) / per_window
    fraction = np.bincount(window, rods(points) < 0) / per_window
    ratios = []
    for axis in range(3):
        per_cell = CONTROL * count_crossings(control, ((0.0,) * 3, (CONTROL,) * 3), axis).mean()
        ratios.append(per_cell * wanted / count_crossings(rods, box, axis))
    return {
        "measured cell size error, rms": float(np.sqrt(np.mean((np.array(ratios) - 1) ** 2))),
        "volume fraction error, rms": float(np.sqrt(np.mean((fraction - FRACTION) ** 2))),
    }


def homogenised_modulus() -> float:
    """C11 of cells of the volume fraction, of any size."""
    cell = tpmscad.lattice(
        SURFACE, cell=1.0, volume_fraction=FRACTION, kind="skeletal", reference="nodal", phase=(0, 0, 0), tol=0.01
    )
    return float(tpmscad.homogenize(cell, elements="tetrahedra", size=0.12).stiffness[0, 0])


def main(
    path: str | Path = "cell_size_grading.step",
    size: tuple[float, float, float] = (12.0, 6.0, 6.0),
    tol: float = 0.2,
    voxels: int = 24,
) -> dict[str, Any]:
    """Grade a block, measure the structures, write and draw the solid, in mm; `voxels` lie along the block.

    "energy error": of the strain energy at a given force along x, y and z against the homogenised one, also for uniform cells of
    both sizes, which shows what voxels and plates add.
    """
    length, width, height = size
    box = ((0.0, -width / 2, -height / 2), (length, width / 2, height / 2))

    def frequency(p: np.ndarray) -> np.ndarray:
        return 1 / np.interp(p[:, 0], (0, length), SIZES)

    ways = {
        "phases": solve_phases(frequency, box, SPACING),
        "plain modulation from the middle": modulate(frequency, box, np.mean(box, axis=0)),
        "plain modulation from a corner": modulate(frequency, box, np.array(box[0])),
    }
    phi = fields.tpms(SURFACE, 1.0)
    uniform = {f"uniform, {s:g} mm": cut_rods(fields.tpms(SURFACE, s), box) for s in SIZES}
    structures = {name: cut_rods(follow(phi, phases), box) for name, phases in ways.items()}
    model = tpmscad.solidify(structures["phases"], box, tol=tol)
    model.export(path)
    model.render(Path(path).with_suffix(".png"), view=(-0.3, -0.8, 0.6))
    certificate = model.certificate
    modulus = homogenised_modulus()
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "tolerance": tol,
        "betti": certificate.betti,
        "volume fraction": model.volume / (length * width * height),
        "errors": {
            name: measure_gradients(phases, frequency, box) | measure_structure(structures[name], frequency, box)
            for name, phases in ways.items()
        },
        "energy error": {
            name: [modulus / found - 1 for found in confined_moduli(field, box, voxels)]
            for name, field in (structures | uniform).items()
        },
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
