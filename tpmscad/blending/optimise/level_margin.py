"""Level margin: no component or hole inside the blending regions that a small change of level would make.

Between its samples a field may be a little higher or lower than at them, so what the census sees is safe only if it sees the
same at levels a little below and above zero. Isolated parts of {f <= -margin} and {f <= +margin} that lie inside the blending
regions are mended like errors, as long as none of the errors proper comes back.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import BoolArray, IntArray
from tpmscad.blending.composition.defects import count_defects
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.optimiser import BlendState, Strategy, evaluate_weights, repair_defects
from tpmscad.blending.optimise.repair import RepairRequest, propose_repairs
from tpmscad.blending.weights.constraints import NO_CONSTRAINTS, WeightConstraints, add_consistent_constraints
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.topology.voxels import Labels

FINE_GRID_MARGIN_RATIO = 0.5
"""The margin on the grid of twice the samples, in parts of that on the working grid."""

MAX_MARGIN_ROUNDS = 4
OVERSHOOT_RMS_FRACTION = 0.15
"""How far past the level a repair moves f, in the same unit."""


def enforce_level_margin(
    scenes: Sequence[SampledComposition], start: BlendState, margin: float
) -> tuple[BlendState, int]:
    """The state with as few near errors as a few rounds reach, and the rounds taken; clean like the start.

    margin: in parts of f's rms in the blending regions, on the working grid. (Parts that no sample sees are the business of
    `clear.py`; this is for parts that a change of level would set free, in making say.)
    """
    best, rounds = start, 0
    groups, least = _find_marginal_defects(scenes, best.weights, margin)
    while least and rounds < MAX_MARGIN_ROUNDS:
        weights, kept = list(best.weights), [NO_CONSTRAINTS] * len(best.weights)
        for stage, weight in enumerate(weights):
            if groups[stage]:
                kept[stage], found, _ = add_consistent_constraints(
                    weight, weight.coefficients, NO_CONSTRAINTS, groups[stage]
                )
                weights[stage] = weight.moved(found)
        state = evaluate_weights(scenes, weights)
        rounds += 1
        if not state.is_clean:
            state, used = repair_defects(scenes, state, Strategy(), MAX_MARGIN_ROUNDS, kept)
            rounds += used
        if not state.is_clean:
            break
        groups, left = _find_marginal_defects(scenes, state.weights, margin)
        if left >= least:
            break
        best, least = state, left
    return best, rounds


def _find_marginal_defects(
    scenes: Sequence[SampledComposition], weights: Sequence[SplineWeight], level: float
) -> tuple[list[list[WeightConstraints]], int]:
    """Demands of each stage that mend the near errors of all grids, and how many there are."""
    groups: list[list[WeightConstraints]] = [[] for _ in weights]
    count = 0
    for scene in scenes:
        values, movable = scene.values(weights), scene.movable()
        unit = float(np.sqrt(np.mean(values[movable] ** 2)))
        for margin in (-level * unit, level * unit):
            seen = count_defects(values - margin)
            for phase, sign in ((seen.solid, 1), (seen.void, -1)):
                errors = _select_interior(phase.labels, phase.errors, movable) if len(phase.errors) else phase.errors
                count += len(errors)
                if not len(errors):
                    continue
                wanted = RepairRequest(values - margin, phase, errors, sign, OVERSHOOT_RMS_FRACTION * unit)
                for stage, weight in enumerate(weights):
                    groups[stage] += propose_repairs(scene.sampled(weights, stage), weight, wanted).groups
        level *= FINE_GRID_MARGIN_RATIO
    return groups, count


def _select_interior(labels: Labels, errors: IntArray, movable: BoolArray) -> IntArray:
    outside = np.bincount(labels[~movable], minlength=int(errors.max()) + 1)
    return errors[outside[errors] == 0]
