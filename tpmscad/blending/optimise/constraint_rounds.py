"""Rounds of constraints: request signs of the field at points, solve for the weights, repair the defects that this makes.

All passes of the optimisation share this step. They differ only in what they request: the repair of defects on a grid (here), a
margin of the level (`level_margin`), the removal of defects between the samples (`subgrid_defects`) or wider necks
(`neck_width`). Each request is a group of constraints that is met as a whole or left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from tpmscad._typing import Array
from tpmscad.blending.composition.sampled_composition import SampledComposition, root_mean_square
from tpmscad.blending.optimise.blend_state import BlendState, evaluate_weights
from tpmscad.blending.optimise.repair import RepairRequest, propose_repairs
from tpmscad.blending.weights.constraints import NO_CONSTRAINTS, WeightConstraints, add_consistent_constraints
from tpmscad.blending.weights.weight_protocol import SplineWeight

T = TypeVar("T")

REPAIR_MARGIN_RMS = 0.4
"""Margin beyond zero of repaired samples, as a fraction of the field's rms in the blending region: a narrower margin needs
trivariate weights more often."""

MAX_STALLED_ROUNDS = 2
"""Rounds without fewer defects after which repairing stops."""


@dataclass(frozen=True, slots=True, eq=False)
class ConstrainedWeights:
    """The weights of all stages and the constraints that each satisfies.

    A solution takes the feasible coefficients nearest to `origin`, or to the current ones if that is None.
    """

    weights: tuple[SplineWeight, ...]
    constraints: tuple[WeightConstraints, ...]
    origin: tuple[Array, ...] | None = None

    def add(self, stage: int, groups: list[WeightConstraints]) -> tuple[ConstrainedWeights, list[int]]:
        """The weights with those groups met by one stage's weight that do not contradict the constraints so far.

        Also returns the indices of the groups left out.
        """
        weight = self.weights[stage]
        start = weight.coefficients if self.origin is None else self.origin[stage]
        accepted, coefficients, left_out = add_consistent_constraints(weight, start, self.constraints[stage], groups)
        weights = _replace_item(self.weights, stage, weight.with_coefficients(coefficients))
        return replace(self, weights=weights, constraints=_replace_item(self.constraints, stage, accepted)), left_out

    def with_weight(self, stage: int, weight: SplineWeight) -> ConstrainedWeights:
        """The same with another weight of one stage, whose coefficients become the origin."""
        origin = None if self.origin is None else _replace_item(self.origin, stage, weight.coefficients)
        return replace(self, weights=_replace_item(self.weights, stage, weight), origin=origin)


def start_unconstrained(weights: Sequence[SplineWeight], *, fixed_origin: bool = False) -> ConstrainedWeights:
    """Weights without constraints yet; with `fixed_origin` all solutions stay near to the coefficients they have now."""
    origin = tuple(weight.coefficients for weight in weights) if fixed_origin else None
    return ConstrainedWeights(tuple(weights), (NO_CONSTRAINTS,) * len(weights), origin)


Proposal = Callable[[ConstrainedWeights, int], list[WeightConstraints] | None]
"""Groups of constraints for the weight of a stage; None leaves the stage as it is."""


def run_constraint_round(constrained: ConstrainedWeights, propose: Proposal) -> tuple[ConstrainedWeights, bool]:
    """The weights after each stage in turn has met what is proposed for it, and whether any group was accepted."""
    changed = False
    for stage in range(len(constrained.weights)):
        groups = propose(constrained, stage)
        if groups is not None:
            constrained, left_out = constrained.add(stage, groups)
            changed |= len(left_out) < len(groups)
    return constrained, changed


def evaluate_and_repair(
    compositions: Sequence[SampledComposition], constrained: ConstrainedWeights, max_rounds: int
) -> tuple[BlendState, int]:
    """The state of constrained weights after the repair of its defects under the constraints, and the rounds this took."""
    state = evaluate_weights(compositions, constrained.weights)
    if state.is_clean:
        return state, 0
    return repair_defects(compositions, state, max_rounds, constraints=constrained.constraints)


def repair_defects(
    compositions: Sequence[SampledComposition],
    start: BlendState,
    max_rounds: int,
    *,
    margin_rms: float = REPAIR_MARGIN_RMS,
    removal_cost_factor: float = 1.0,
    constraints: Sequence[WeightConstraints] = (),
) -> tuple[BlendState, int]:
    """The best state reached by rounds of repairs, and their number.

    Each round repairs the coarsest grid that has defects. All constraints, the given ones and those of earlier rounds, stay in
    force. The rounds end when no defect is left, no repair is possible, or the number of defects no longer falls.
    """
    state = best = start
    constrained = start_unconstrained(start.weights, fixed_origin=True)
    if constraints:
        constrained = replace(constrained, constraints=tuple(constraints))
    stalled = rounds = 0
    while not best.is_clean and stalled < MAX_STALLED_ROUNDS and rounds < max_rounds:
        composition = compositions[state.coarsest_defective.grid_index]
        propose = _make_repair_proposal(composition, state, margin_rms, removal_cost_factor)
        constrained, changed = run_constraint_round(constrained, propose)
        rounds += 1
        if not changed:
            break
        state = evaluate_weights(compositions, constrained.weights)
        stalled = 0 if state.score < best.score else stalled + 1
        best = min(best, state, key=lambda s: s.score)
    return best, rounds


def _make_repair_proposal(
    composition: SampledComposition, state: BlendState, margin_rms: float, removal_cost_factor: float
) -> Proposal:
    """The repairs of the defects of a state, for one stage after another."""
    values = composition.values(state.weights)

    def propose(constrained: ConstrainedWeights, stage: int) -> list[WeightConstraints] | None:
        affine = composition.affine_form(constrained.weights, stage)
        has_slope = affine.slope != 0
        if not has_slope.any():
            return None
        margin = margin_rms * root_mean_square(values[has_slope])
        groups = []
        for phase, labels in state.coarsest_defective.phases():
            if len(labels):
                request = RepairRequest(
                    values, phase, labels, margin, constrained.constraints[stage], removal_cost_factor
                )
                groups += propose_repairs(affine, constrained.weights[stage], request).groups
        return groups or None

    return propose


def _replace_item(items: tuple[T, ...], index: int, item: T) -> tuple[T, ...]:
    return (*items[:index], item, *items[index + 1 :])
