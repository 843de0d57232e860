"""Level margin: no component or cavity inside the blending regions that a small shift of the level would isolate.

A solid that is made from the field deviates from its level set, as if the level were shifted a little. The pass counts the
defects of {f <= -margin} and {f <= +margin} inside the blending regions and repairs them like defects of the field itself, as
long as this brings no defect of {f <= 0} back. The paper has no counterpart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import BoolArray, IntArray
from tpmscad.blending.composition.defects import PhaseComponents, count_defects
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.blend_state import BlendProblem, OptimisationOutcome
from tpmscad.blending.optimise.constraint_rounds import (
    Proposal,
    evaluate_and_repair,
    run_constraint_round,
    start_unconstrained,
)
from tpmscad.blending.optimise.repair import RepairRequest, propose_repairs
from tpmscad.blending.weights.constraints import WeightConstraints
from tpmscad.blending.weights.weight_protocol import SplineWeight

FINE_GRID_MARGIN_RATIO = 0.5
"""Ratio of the margin on the doubled grid to that on the working grid."""

MAX_MARGIN_ROUNDS = 4

OVERSHOOT_RMS_FRACTION = 0.15
"""Margin beyond the shifted level of repaired samples, as a fraction of the field's rms."""


def enforce_level_margin(problem: BlendProblem, outcome: OptimisationOutcome, margin_rms: float) -> OptimisationOutcome:
    """The outcome with as few defects at shifted levels as some rounds reach; a state with defects stays as it is.

    `margin_rms` is the margin on the working grid, as a fraction of the field's rms in the blending regions.
    """
    best, rounds = outcome.state, 0
    if not best.is_clean:
        return outcome
    groups, n_defects = _find_marginal_defects(problem.compositions, best.weights, margin_rms)
    while n_defects and rounds < MAX_MARGIN_ROUNDS:
        constrained, _ = run_constraint_round(start_unconstrained(best.weights), _make_proposal(groups))
        state, used = evaluate_and_repair(problem.compositions, constrained, MAX_MARGIN_ROUNDS)
        rounds += 1 + used
        if not state.is_clean:
            break
        groups, n_remaining = _find_marginal_defects(problem.compositions, state.weights, margin_rms)
        if n_remaining >= n_defects:
            break
        best, n_defects = state, n_remaining
    return outcome.advance(best, rounds)


def _make_proposal(groups: list[list[WeightConstraints]]) -> Proposal:
    return lambda _, stage: groups[stage] or None


def _find_marginal_defects(
    compositions: Sequence[SampledComposition], weights: Sequence[SplineWeight], margin_rms: float
) -> tuple[list[list[WeightConstraints]], int]:
    """Constraints for each stage that repair the defects at both shifted levels on all grids, and the number of defects."""
    groups: list[list[WeightConstraints]] = [[] for _ in weights]
    n_defects = 0
    for composition in compositions:
        values = composition.values(weights)
        rms = composition.rms_in_blending_regions(values)
        for level in (-margin_rms * rms, margin_rms * rms):
            census = count_defects(values - level)
            for phase in (census.solid, census.void):
                labels = _select_interior(phase, composition.blending_mask)
                n_defects += len(labels)
                if not len(labels):
                    continue
                request = RepairRequest(values - level, phase, labels, OVERSHOOT_RMS_FRACTION * rms)
                for stage, weight in enumerate(weights):
                    groups[stage] += propose_repairs(composition.affine_form(weights, stage), weight, request).groups
        margin_rms *= FINE_GRID_MARGIN_RATIO
    return groups, n_defects


def _select_interior(phase: PhaseComponents, mask: BoolArray) -> IntArray:
    """The defects of a phase with all their samples in the mask."""
    if len(phase.defects) == 0:
        return phase.defects
    n_outside = np.bincount(phase.labels[~mask], minlength=int(phase.defects.max()) + 1)
    return phase.defects[n_outside[phase.defects] == 0]
