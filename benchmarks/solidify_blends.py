"""Random blends as solids: accepted or refused, faces per period, CPU seconds, and the reasons of what was refused.

    python -m benchmarks.solidify_blends [FIRST [LAST [2x1x1,3x1x1,...]]]

Pairs are those of random_pairs.py; a period is that of the mean number of periods along x. The box has the periods stated (in
turn; less where the regions end), its middle on the middle of the blending region. The tolerance is 5e-3 of the period. Beside
the certificate each solid is written to a STEP file, read by the kernel and checked once more, its joints are measured there
(`benchmarks.joints`), and the field's Betti numbers are counted on two plain grids: a solid that is met and fails the check, or
agrees with neither, is WRONG. Where the two disagree a neck is thinner than their spacing.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.joints import worst_joint
from benchmarks.random_pairs import Pair, random_pair
from benchmarks.solidify_figures import cpu, sampled_betti
from tpmscad.blending import blend
from tpmscad.errors import TpmscadError
from tpmscad.kernel.measure.shape_report import check_step
from tpmscad.solids._solidify import solidify

PERIODS = "2x1x1,2x1x1,3x1x1,2x2x1,4x2x2"
TOL = 5e-3
LINES = 223, 320
"""Samples along the longest edge of the box for the Betti numbers of the field."""


def box_of(pair: Pair, periods: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, float]:
    """The box of so many periods about the middle of the pair's blending region, and the period.

    The blend is defined in its regions only, [0, 1] x [0, side]^2: the box ends there at the latest.
    """
    structures, rest = pair.name.split(", side ")
    counts, side = [float(name.rsplit(" x", 1)[1]) for name in structures.split(" + ")], float(rest.split(",")[0])
    period = 1 / float(np.mean(counts))
    half = min(0.5, 0.5 * periods[0] * period)
    return np.array([0.5 - half, 0, 0]), np.array([0.5 + half, *(min(side, period * n) for n in periods[1:])]), period


def main(first: int, last: int, sizes: list[tuple[int, ...]]) -> None:
    made, faces, missed, wrong = 0, [], 0, 0
    for seed in range(first, last):
        pair, periods = random_pair(seed), sizes[seed % len(sizes)]
        lo, hi, period = box_of(pair, periods)
        field = blend(pair.structures, pair.regions, [pair.blending]).field
        line = f"{seed:3d} {pair.name:75s} {'x'.join(map(str, periods))}"
        begun, before = time.perf_counter(), cpu()
        try:
            model = solidify(field, (lo, hi), tol=TOL * period)
        except TpmscadError as error:
            print(f"{line} REFUSED cpu {cpu() - before:.1f} s: {error}", flush=True)
            continue
        taken, wall = cpu() - before, time.perf_counter() - begun
        c = model.certificate
        with TemporaryDirectory() as folder:
            path = Path(folder) / "blend.step"
            model.export_step(path)
            valid = check_step(path, healed=False).ok
            jump, joints = worst_joint(path)
        counted = {sampled_betti(field, (lo, hi), lines) for lines in LINES}
        pieces, *others = c.betti
        right = valid and (pieces + len(c.dropped), *others) in counted  # the field has the loose pieces, too
        seen = " or ".join(map(str, sorted(counted)))
        made += c.met and right
        missed += not c.met
        wrong += c.met and not right
        faces.append(c.n_faces / np.prod((hi - lo) / period))
        print(
            f"{line} {'NOT MET' if not c.met else 'met' if right else 'WRONG'} {'valid' if valid else 'NOT VALID'} "
            f"faces {c.n_faces} ({faces[-1]:.0f} a period) deviation {c.max_deviation / period:.1e} "
            f"poles {c.n_poles} {joints} joints bent by {jump:.0e} degrees, betti {c.betti} field {seen} pieces {len(c.pieces)} "
            f"cpu {taken:.1f} s wall {wall:.1f} s {'; '.join((*c.shortfalls, *c.notes))}",
            flush=True,
        )
    median = np.median(faces or [np.nan])
    print(f"{made} of {last - first} met, {missed} not met, {wrong} wrong, faces a period: median {median:.0f}")


if __name__ == "__main__":
    given = sys.argv[1:]
    sizes = [tuple(map(int, part.split("x"))) for part in (given[2] if len(given) > 2 else PERIODS).split(",")]
    main(int(given[0]) if given else 0, int(given[1]) if len(given) > 1 else 20, sizes)
