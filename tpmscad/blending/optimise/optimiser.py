"""The topological optimiser: weights whose blend has no defect on the working grid nor on that of twice its samples.

The paper (section 3.2) minimises a topological objective by gradient descent on the coefficients. As the field is
affine in the coefficients, a defect can also be repaired directly: a path of samples that joins a component to another one,
or the removal of all its samples, are linear inequalities. The optimiser therefore repairs by constraints first: each round takes
the coarsest grid with defects, finds the cheapest repairs and moves each weight to the nearest coefficients that satisfy all
constraints so far (`constraint_rounds`, `repair`).

Where this stalls, the next of the STRATEGIES continues from the best state: removals preferred to joins or the reverse, weights
refined to more coefficients, the paper's descent, smaller margins. Counting defects on a second grid guards against blends that
are clean only at the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.blend_state import BlendProblem, BlendState, OptimisationOutcome, evaluate_weights
from tpmscad.blending.optimise.constraint_rounds import REPAIR_MARGIN_RMS, repair_defects
from tpmscad.blending.optimise.gradient_descent import descend

REMOVAL_PENALTY_FACTOR, REMOVAL_DISCOUNT_FACTOR = 1e3, 1e-3
"""Factors on the cost of removals, so that joins or removals are preferred throughout: a mixture can be contradictory."""

MAX_DESCENT_STEPS = 15
"""Steps of a descent at most; descents that succeed take fewer."""


@dataclass(frozen=True, slots=True)
class Strategy:
    """One setting of the optimiser: weights refined first or not, repairs or gradient descent, their margin and preference.

    `margin_rms` is the margin of repairs as a fraction of the field's rms; `removal_cost_factor` multiplies the cost of removals.
    """

    refine_first: bool = False
    use_gradient: bool = False
    margin_rms: float = REPAIR_MARGIN_RMS
    removal_cost_factor: float = 1.0


STRATEGIES = (
    Strategy(),
    Strategy(removal_cost_factor=REMOVAL_PENALTY_FACTOR),
    Strategy(refine_first=True),
    Strategy(removal_cost_factor=REMOVAL_PENALTY_FACTOR),
    Strategy(removal_cost_factor=REMOVAL_DISCOUNT_FACTOR),
    Strategy(use_gradient=True),
    Strategy(refine_first=True, margin_rms=REPAIR_MARGIN_RMS / 2),
    Strategy(margin_rms=REPAIR_MARGIN_RMS / 4, removal_cost_factor=REMOVAL_PENALTY_FACTOR),
    Strategy(margin_rms=REPAIR_MARGIN_RMS / 4, removal_cost_factor=REMOVAL_DISCOUNT_FACTOR),
)
"""Tried in this order, each from the best state so far and without the constraints of the strategies before it."""


def optimise(problem: BlendProblem, outcome: OptimisationOutcome) -> OptimisationOutcome:
    """The outcome with weights whose blend has no defect of its own on any grid, or with the best ones reached."""
    compositions, best, rounds = problem.compositions, outcome.state, 0
    log: list[str] = []
    for strategy in STRATEGIES:
        if best.is_clean or rounds >= problem.max_rounds:
            break
        start = best
        if strategy.refine_first:
            refined = problem.refine_all(best.weights)
            if refined is None:
                continue
            start = evaluate_weights(compositions, refined)
            shapes = "; ".join(" x ".join(map(str, weight.coefficients.shape)) for weight in refined)
            log.append(f"weights given more freedom after {rounds} rounds: {shapes}")
        state, used = _apply_strategy(compositions, start, strategy, problem.max_rounds - rounds)
        rounds += used
        if state.score < best.score or strategy.refine_first:
            best = state
    return outcome.advance(best, rounds, *log)


def optimise_as_published(problem: BlendProblem, outcome: OptimisationOutcome) -> OptimisationOutcome:
    """The outcome of the paper's descent as printed (eqs 20 to 23): on the working grid only, with the test of eq. 22."""
    descent = descend(problem.coarse, outcome.state.weights, problem.max_rounds, strict=True)
    objective = descent.objective
    line = (
        f"objective {objective.value:.3g} after {descent.steps} steps, {objective.n_active} pairs active, "
        f"{objective.n_ignored} ignored"
    )
    return outcome.advance(evaluate_weights(problem.compositions, descent.weights), descent.steps, line)


def keep_initial_weights(problem: BlendProblem, outcome: OptimisationOutcome) -> OptimisationOutcome:
    """The outcome as it is."""
    return outcome


def _apply_strategy(
    compositions: Sequence[SampledComposition], start: BlendState, strategy: Strategy, max_rounds: int
) -> tuple[BlendState, int]:
    """The state that a strategy reaches, and the rounds or steps it took."""
    if not strategy.use_gradient:
        return repair_defects(
            compositions,
            start,
            max_rounds,
            margin_rms=strategy.margin_rms,
            removal_cost_factor=strategy.removal_cost_factor,
        )
    composition = compositions[start.coarsest_defective.grid_index]
    steps = min(MAX_DESCENT_STEPS, max_rounds)
    descent = descend(composition, start.weights, steps, strict=False, convention="strict")
    return evaluate_weights(compositions, descent.weights), descent.steps
