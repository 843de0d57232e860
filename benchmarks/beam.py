"""The cantilever of `examples/beam.py` refined: the elements of its plate, and the voxels of its structures.

    python -m benchmarks.beam [plate] [voxels 10 14 20]

`plate` optimises on elements of several sizes and evaluates each design on the smallest ones, too. `voxels` prints the compliance
of both lattices alone, of hard switching and of the blend for each number of voxels per cell.
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

CELLS = (6, 3)
SIZES = (5.0, 2.5, 1.25)
"""Of the elements of the plate, mm."""

ITERATIONS = (15, 30)
"""Of the method of moving asymptotes for each penalty."""

VOXELS = (10, 14, 20)
"""Per cell."""


def refine_plate() -> None:
    """Print the compliance of the optimum by size of the elements and number of iterations."""
    import beam_plate

    length, height = (beam_plate.CELL * n for n in CELLS)
    splines = beam_plate.fit_stiffness(beam_plate.read_units())
    plates = {size: beam_plate.Plate(length, height, size) for size in SIZES}
    finest = plates[SIZES[-1]]
    for iterations in ITERATIONS:
        for size, plate in plates.items():
            begun = time.process_time()
            found = beam_plate.optimise(plate, splines, beam_plate.CELL, iterations)
            repeat = np.ones((round(size / finest.size),) * 2)
            density, share = np.kron(found.density, repeat), np.round(np.kron(found.share, repeat))
            again = beam_plate.evaluate(finest, splines, density, share)[0]
            print(
                f"{iterations} iterations, {size:g} mm: {found.compliance:.2f}, on the smallest elements {again:.2f}, share of "
                f"I-WP {(found.share > 0.5).mean():.3f}, {len(found.history)} evaluations, "
                f"{time.process_time() - begun:.1f} CPU s",
                flush=True,
            )


def refine_voxels(counts: tuple[int, ...], size: float = 2.5) -> None:
    """Print the compliance of each structure of the example by the number of voxels per cell."""
    import beam

    length, height = (beam.CELL * n for n in CELLS)
    box = ((0.0, 0.0, 0.0), (length, height, beam.CELL))
    splines = beam.fit_stiffness(beam.read_units())
    for iterations in ITERATIONS:
        design = beam.optimise(beam.Plate(length, height, size), splines, beam.CELL, iterations)
        hard, blended = beam.structures(design, box)
        made = {"hard switching": hard, "blend": blended.field}
        for count in counts:
            begun = time.process_time()
            found = beam.resolve(made, box, count, with_uniform=iterations == ITERATIONS[0])
            for name, values in found.items():
                print(f"{iterations} iterations, {count} voxels per cell, {name}: {values}")
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
            print(f"  {time.process_time() - begun:.0f} CPU s, {memory:.1f} GB so far", flush=True)


def main() -> None:
    words = sys.argv[1:] or ["plate", "voxels"]
    counts = tuple(int(word) for word in words if word.isdigit())
    if "plate" in words:
        refine_plate()
    if "voxels" in words:
        refine_voxels(counts or VOXELS)


if __name__ == "__main__":
    main()
