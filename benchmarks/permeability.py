"""Permeability of one channel at porosity 1/2 against published values.

`python -m benchmarks.permeability [SURFACE ...] [--size 0.1 0.08]`; sizes of the tetrahedra are in cells. Published: Jung and
Torquato, Phys. Rev. E 72 (2005) 056319, per square of the cell.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import tpmscad
from tpmscad.simulation.permeability import permeability

PUBLISHED = {"P": 3.4765e-3, "gyroid": 2.2889e-3, "diamond": 1.4397e-3}
DEFAULT_SIZES = (0.12, 0.09)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("surfaces", nargs="*", default=list(PUBLISHED))
    parser.add_argument("--size", nargs="+", type=float, default=DEFAULT_SIZES)
    given = parser.parse_args()
    for name in given.surfaces:
        channel = tpmscad.lattice(name, cell=1.0, volume_fraction=0.5, kind="skeletal", progress=False)
        for size in given.size:
            begun = time.process_time()
            mesh = channel.mesh(size, periodic=True, progress=False)
            k = permeability(mesh)
            mean, off = np.trace(k) / 3, np.abs(k - np.trace(k) / 3 * np.eye(3)).max()
            print(
                f"{name:<8} size {size:<5g} {mesh.n_cells:>6} elements  k = {mean:.4e} a^2, {mean / PUBLISHED[name] - 1:+.2%} "
                f"off the published value, isotropic to {off / mean:.1e}, {time.process_time() - begun:.0f} CPU s",
                flush=True,
            )


if __name__ == "__main__":
    main()
