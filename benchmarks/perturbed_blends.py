"""Random blends as solids, each several times with the field changed in its last digits: how far the numbers of faces spread.

    python -m benchmarks.perturbed_blends [FIRST [LAST [RUNS]]]

Each run but the first adds to the field noise of its own, two units in the last place of 1: the level set is the same but for
round-off. The search for a solid decides by comparisons, so that it may take another way.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from benchmarks.random_pairs import random_pair
from benchmarks.solidify_blends import PERIODS, TOL, box_of
from tpmscad import fields
from tpmscad.blending import blend
from tpmscad.errors import TpmscadError
from tpmscad.fields.field import Field
from tpmscad.solids._solidify import solidify


def add_noise(field: Field, run: int) -> Field:
    """The field with noise of a run's own, in the last digits of its values; run 0 adds none."""
    return field + fields.expression(f"4e-16*sin({run}e3*x + 3e3*y + 2e3*z)") if run else field


def main(first: int, last: int, runs: int) -> None:
    sizes = [tuple(map(int, part.split("x"))) for part in PERIODS.split(",")]
    spreads = []
    for seed in range(first, last):
        pair, periods = random_pair(seed), sizes[seed % len(sizes)]
        lo, hi, period = box_of(pair, periods)
        field = blend(pair.structures, pair.regions, [pair.blending]).field
        used, faces = time.process_time(), []
        for k in range(runs):
            try:
                model = solidify(add_noise(field, k), (lo, hi), tol=TOL * period)
            except TpmscadError:
                continue  # benchmarks.solidify_blends prints the reasons
            faces.append(model.certificate.n_faces if model.certificate.met else 0)
        if faces:
            spreads.append(max(faces) / min(faces) - 1 if min(faces) else np.inf)
        text = f"{min(faces)} to {max(faces)} faces, {100 * spreads[-1]:.1f} %" if faces else "refused each time"
        print(
            f"{seed:3d} {len(faces)} of {runs} solids, {text}, cpu {time.process_time() - used:.1f} s {faces}",
            flush=True,
        )
    if spreads:
        within = np.count_nonzero(np.array(spreads) <= 0.03)
        print(f"spread: median {100 * np.median(spreads):.1f} %, {within} of {len(spreads)} within 3 %")


if __name__ == "__main__":
    given = [int(a) for a in sys.argv[1:]]
    main(*[*given, *(0, 20, 5)[len(given) :]])
