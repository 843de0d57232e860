"""A cantilever of Schwarz P and I-WP, from the topology optimisation of a plate to one blended solid in STEP.

Follows figure 14 of the porous-blending paper. `beam_plate.py` finds the lattice and the volume fraction at every place. Here the
lattices get these volume fractions by graded thresholds, are blended without isolated parts where they meet, and become a solid.
The compliance of the optimum, of hard switching between the lattices and of the blend is compared, the last two with all their
pores (`voxel_beam.py`). `python -m benchmarks.beam` refines the elements of the plate and the voxels.

    pip install "tpmscad[simulation]" matplotlib nlopt pyamg
    python examples/beam.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

import tpmscad
from tpmscad import fields
from tpmscad.blending import BlendResult

sys.path.insert(0, str(Path(__file__).parent))
from beam_plate import CELL, GREATEST, LEAST, MEAN, Design, Plate, evaluate, fit_stiffness, optimise, read_units
from voxel_beam import resolve_compliance

BAND = 4.0
"""Half the width of the blending region, mm."""


def extrude(values: np.ndarray, size: float) -> fields.Field:
    """The field of values (nx, ny) at the centers of elements, constant along z."""
    return fields.sampled(values[..., None], (size, size, CELL), (size / 2, size / 2, CELL / 2), centred=True)


def lattice_rods(density: fields.Field) -> list[fields.Field]:
    """Both lattices with the local volume fraction."""
    span = (LEAST - 0.03, GREATEST + 0.03)  # the spline through the densities passes their range a little
    made = []
    for name, cut, kind in (("schwarz_p", fields.rod, "rod"), ("iwp", fields.pore, "pore")):
        phi = fields.tpms(name, period=CELL)
        made.append(cut(phi, fields.graded_threshold(phi, density, span, kind)))
    return made


def find_interface(design: Design) -> fields.Field:
    """The distance from the border between the lattices, rounded; negative where I-WP is."""
    second = np.kron(design.share > 0.5, np.ones((2, 2), bool))  # on halves of the elements
    size = design.size / 2
    distance = (ndimage.distance_transform_edt(~second) - ndimage.distance_transform_edt(second)) * size
    return extrude(ndimage.gaussian_filter(distance, 2.0, mode="nearest"), size)


def structures(design: Design, box: tuple) -> tuple[fields.Field, BlendResult]:
    """The design with hard switching between the lattices, and blended."""
    first, second = lattice_rods(extrude(design.density, design.size))
    interface = find_interface(design)
    hard = (second & interface) | (first & fields.complement(interface))
    blended = tpmscad.blend(
        [first, second],
        [fields.complement(interface), interface],
        [fields.sheet(interface, -BAND, BAND)],
        weight="volume",
        domain=box,
        remove_input_defects=True,
        progress=False,
    )
    return hard, blended


def resolve(
    structures: dict[str, fields.Field], box: tuple, voxels: int, with_uniform: bool = True
) -> dict[str, dict[str, float]]:
    """Compliance, volume fraction and loose parts with `voxels` per cell, of the lattices alone first."""
    uniform = zip(("Schwarz P, uniform", "I-WP, uniform"), lattice_rods(fields.constant(MEAN)), strict=True)
    made = {**(dict(uniform) if with_uniform else {}), **structures}
    return {name: resolve_compliance(field, box, round(voxels * box[1][0] / CELL)) for name, field in made.items()}


def main(
    path: str | Path = "beam.step",
    cells: tuple[int, int] = (6, 3),
    size: float = 5.0,
    iterations: int = 15,
    voxels: int = 6,
    tol: float = 0.3,
) -> dict[str, Any]:
    """Optimise on elements of `size` mm, blend, write and draw the beam; return what was measured on it, in mm.

    `homogenised` has compliances of the plate; `resolved` those of every structure with `voxels` per cell, with its volume
    fraction and its loose parts.
    """
    length, height = (CELL * n for n in cells)
    box = ((0.0, 0.0, 0.0), (length, height, CELL))
    splines, plate = fit_stiffness(read_units()), Plate(length, height, size)
    best = optimise(plate, splines, CELL, iterations)
    flat = np.full(plate.shape, MEAN)
    hard, blended = structures(best, box)
    made = {"hard switching": hard, "blend": blended.field}
    model = tpmscad.solidify(blended.field, box, tol=tol)
    model.export(path)
    model.render(Path(path).with_suffix(".png"), view=(-0.4, -0.8, 0.9))
    draw_design(best, box, made, Path(path).with_name(f"{Path(path).stem}_design.png"))
    certificate = model.certificate
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "tolerance": tol,
        "betti": certificate.betti,
        "volume fraction": model.volume / (length * height * CELL),
        "isolated parts of the blend": blended.errors.remaining,
        "homogenised": {
            "Schwarz P, uniform": evaluate(plate, splines, flat, 0 * flat)[0],
            "I-WP, uniform": evaluate(plate, splines, flat, 0 * flat + 1)[0],
            "optimum": best.compliance,
        },
        "resolved": resolve(made, box, voxels),
    }


def draw_design(design: Design, box: tuple, solids: dict[str, fields.Field], path: Path) -> None:
    """Draw the volume fraction, the lattices, and slices of the structures near mid-thickness."""
    import matplotlib.pyplot as plt

    length, height, depth = box[1]
    extent = (0, length, 0, height)
    figure, axes = plt.subplots(2, 2, figsize=(11, 6), layout="constrained")
    for panel, values, label, limits, colours in (
        (axes[0, 0], design.density, "volume fraction", (LEAST, GREATEST), "viridis"),
        (axes[0, 1], design.share, "share of I-WP", (0, 1), "coolwarm"),
    ):
        drawn = panel.imshow(values.T, origin="lower", extent=extent, cmap=colours, vmin=limits[0], vmax=limits[1])
        figure.colorbar(drawn, ax=panel, label=label)
    x, y = np.linspace(0, length, 800), np.linspace(0, height, 400)
    for panel, (name, field) in zip(axes[1], solids.items(), strict=True):
        solid = field.on_grid(x, y, [0.45 * depth])[..., 0] <= 0
        panel.imshow(solid.T, origin="lower", extent=extent, cmap="Greys")
        panel.set_title(f"{name}, slice at z = {0.45 * depth:g} mm")
    for panel in axes.flat:
        panel.set(xlabel="x, mm", ylabel="y, mm")
    figure.savefig(path, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
