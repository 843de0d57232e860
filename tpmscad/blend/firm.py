"""Level margin: no component or hole inside the blending regions that a small change of level would make.

Between its samples a field may be a little higher or lower than at them, so what the census sees is safe only if it sees the
same at levels a little below and above zero. Isolated parts of {f <= -margin} and {f <= +margin} that lie inside the blending
regions are mended like errors, as long as none of the errors proper comes back.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad.blend.census import census
from tpmscad.blend.demands import NONE, Demands, agreed
from tpmscad.blend.grid import Ints, Mask
from tpmscad.blend.optimise import State, Tool, look, repaired
from tpmscad.blend.repair import Wanted, repair
from tpmscad.blend.scene import Scene
from tpmscad.blend.weight import Weight
from tpmscad.topology.grid import Labels

FINER = 0.5
"""The margin on the grid of twice the samples, in parts of that on the working grid."""

ROUNDS = 4
PAST = 0.15
"""How far past the level a repair moves f, in the same unit."""


def firmed(scenes: Sequence[Scene], start: State, margin: float) -> tuple[State, int]:
    """The state with as few near errors as a few rounds reach, and the rounds taken; clean like the start.

    margin: in parts of f's rms in the blending regions, on the working grid. (Parts that no sample sees are the business of
    `clear.py`; this is for parts that a change of level would set free, in making say.)
    """
    best, rounds = start, 0
    groups, least = _near(scenes, best.weights, margin)
    while least and rounds < ROUNDS:
        weights, kept = list(best.weights), [NONE] * len(best.weights)
        for stage, weight in enumerate(weights):
            if groups[stage]:
                kept[stage], found, _ = agreed(weight, weight.coefficients, NONE, groups[stage])
                weights[stage] = weight.moved(found)
        state = look(scenes, weights)
        rounds += 1
        if not state.clean:
            state, used = repaired(scenes, state, Tool(), ROUNDS, kept)
            rounds += used
        if not state.clean:
            break
        groups, left = _near(scenes, state.weights, margin)
        if left >= least:
            break
        best, least = state, left
    return best, rounds


def _near(scenes: Sequence[Scene], weights: Sequence[Weight], level: float) -> tuple[list[list[Demands]], int]:
    """Demands of each stage that mend the near errors of all grids, and how many there are."""
    groups: list[list[Demands]] = [[] for _ in weights]
    count = 0
    for scene in scenes:
        values, movable = scene.values(weights), scene.movable()
        unit = float(np.sqrt(np.mean(values[movable] ** 2)))
        for margin in (-level * unit, level * unit):
            seen = census(values - margin)
            for phase, sign in ((seen.solid, 1), (seen.void, -1)):
                errors = _inside(phase.labels, phase.errors, movable) if len(phase.errors) else phase.errors
                count += len(errors)
                if not len(errors):
                    continue
                wanted = Wanted(values - margin, phase, errors, sign, PAST * unit)
                for stage, weight in enumerate(weights):
                    groups[stage] += repair(scene.sampled(weights, stage), weight, wanted).groups
        level *= FINER
    return groups, count


def _inside(labels: Labels, errors: Ints, movable: Mask) -> Ints:
    outside = np.bincount(labels[~movable], minlength=int(errors.max()) + 1)
    return errors[outside[errors] == 0]
