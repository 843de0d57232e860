"""The robust optimiser: mends what the census counts, on the working grid and on the grid of twice its samples.

Each round takes the coarsest grid that has errors, asks for the cheapest repairs, and moves every weight to the coefficients
nearest to its initial ones that meet all demands so far. Where that stalls the next tool is tried from the best state: a gradient
method on the persistence of the errors, weights with more freedom, demands forgotten and smaller margins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.blending.composition.blended_field import WeightFunction
from tpmscad.blending.composition.defects import DefectCensus, count_defects
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.gradient_descent import descend
from tpmscad.blending.optimise.repair import RepairRequest, propose_repairs
from tpmscad.blending.weights.constraints import NO_CONSTRAINTS, WeightConstraints, add_consistent_constraints
from tpmscad.blending.weights.weight_protocol import SplineWeight

REPAIR_MARGIN_RMS = 0.4
"""How far past zero a repair moves f, in units of the field's own rms in the blending region: at 0.15 one pair in six needed
three dimensions, at 0.4 one in nine."""

REMOVAL_PENALTY, REMOVAL_DISCOUNT = 1e3, 1e-3
"""What removals are taken to cost beside joins where mixing the two contradicts itself."""

MAX_DESCENT_STEPS = 15
"""Steps of a descent: those that got anywhere did within 10."""

MAX_STALLED_ROUNDS = 2
"""Rounds without fewer errors before the next tool is tried."""

WeightRefiner = Callable[[int, SplineWeight], SplineWeight | None]
"""A weight of the same values with more freedom for a stage's weight; None if there is none."""


@dataclass(frozen=True, slots=True)
class Strategy:
    """One way of repairing: with freer weights than before or the same, by descent on the
    persistence of the errors or by repairs, how far past zero, joins or removals preferred."""

    freer: bool = False
    descent: bool = False
    margin: float = REPAIR_MARGIN_RMS
    bias: float = 1.0


STRATEGIES = (
    Strategy(),
    Strategy(bias=REMOVAL_PENALTY),
    Strategy(freer=True),
    Strategy(bias=REMOVAL_PENALTY),
    Strategy(bias=REMOVAL_DISCOUNT),
    Strategy(descent=True),
    Strategy(freer=True, margin=REPAIR_MARGIN_RMS / 2),
    Strategy(margin=REPAIR_MARGIN_RMS / 4, bias=REMOVAL_PENALTY),
    Strategy(margin=REPAIR_MARGIN_RMS / 4, bias=REMOVAL_DISCOUNT),
)
"""Tried in turn, each from the best state so far and with the demands of those before it forgotten."""


@dataclass(frozen=True, slots=True, eq=False)
class GridDefects:
    """A census of one grid, with the errors that are the blend's to mend (labels)."""

    level: int
    census: DefectCensus
    solid: IntArray
    void: IntArray

    @property
    def count(self) -> int:
        return len(self.solid) + len(self.void)


@dataclass(frozen=True, slots=True, eq=False)
class BlendState:
    """Weights and what is counted with them: the views of the grids up to the first with errors, coarse first."""

    weights: tuple[SplineWeight, ...]
    grid_defects: tuple[GridDefects, ...]
    score: tuple[int, int]
    """Grids not yet clean, and the errors on the first of them: the less the better."""

    @property
    def is_clean(self) -> bool:
        return self.score[0] == 0

    @property
    def last(self) -> GridDefects:
        return self.grid_defects[-1]


@dataclass(frozen=True, slots=True, eq=False)
class OptimisationOutcome:
    """The best state reached, the rounds taken and a line on each tool that was needed."""

    state: BlendState
    rounds: int
    log: tuple[str, ...]


def find_grid_defects(scene: SampledComposition, level: int, weights: Sequence[WeightFunction]) -> GridDefects:
    counted = count_defects(scene.values(weights))
    solid = np.setdiff1d(counted.solid.errors, scene.intrinsic(counted.solid, 1))
    void = np.setdiff1d(counted.void.errors, scene.intrinsic(counted.void, -1))
    return GridDefects(level, counted, solid, void)


def evaluate_weights(scenes: Sequence[SampledComposition], weights: Sequence[SplineWeight]) -> BlendState:
    views = []
    for level, scene in enumerate(scenes):
        views.append(find_grid_defects(scene, level, weights))
        if views[-1].count:
            return BlendState(tuple(weights), tuple(views), (len(scenes) - level, views[-1].count))
    return BlendState(tuple(weights), tuple(views), (0, 0))


def evaluate_all_grids(scenes: Sequence[SampledComposition], state: BlendState) -> tuple[GridDefects, ...]:
    """The views of all grids, those behind the first with errors made now."""
    rest = [
        find_grid_defects(scene, level, state.weights)
        for level, scene in enumerate(scenes)
        if level >= len(state.grid_defects)
    ]
    return (*state.grid_defects, *rest)


def optimise(
    scenes: Sequence[SampledComposition], start: BlendState, free: WeightRefiner, max_rounds: int
) -> OptimisationOutcome:
    """Weights whose blend has no errors of its own on any of the grids, or the best that was reached."""
    best, rounds = start, 0
    log: list[str] = []
    for tool in STRATEGIES:
        if best.is_clean or rounds >= max_rounds:
            break
        begin = best
        if tool.freer:
            more = [free(k, weight) for k, weight in enumerate(best.weights)]
            if all(weight is None for weight in more):
                continue
            begin = evaluate_weights(scenes, [new or old for new, old in zip(more, best.weights, strict=True)])
            log.append(
                f"weights given more freedom after {rounds} rounds: {'; '.join(_format_shape(w) for w in begin.weights)}"
            )
        search = _run_descent if tool.descent else repair_defects
        found, used = search(scenes, begin, tool, max_rounds - rounds)
        rounds += used
        if found.score < best.score or tool.freer:
            best = found
    return OptimisationOutcome(best, rounds, tuple(log))


def _format_shape(weight: SplineWeight) -> str:
    return " x ".join(map(str, weight.coefficients.shape))


def _run_descent(
    scenes: Sequence[SampledComposition], start: BlendState, tool: Strategy, max_rounds: int
) -> tuple[BlendState, int]:
    """Steps down the gradient on the grid that has errors: of a pair, whichever end can be moved is."""
    steps = min(MAX_DESCENT_STEPS, max_rounds)
    moved = descend(scenes[start.last.level], start.weights, steps, strict=False, convention="strict")
    return evaluate_weights(scenes, moved.weights), moved.steps


def repair_defects(
    scenes: Sequence[SampledComposition],
    start: BlendState,
    tool: Strategy,
    max_rounds: int,
    demands: Sequence[WeightConstraints] = (),
) -> tuple[BlendState, int]:
    """Rounds of repairs with all their demands kept, `demands` to begin with, until nothing is left or nothing gets better."""
    state = best = start
    origin = [weight.coefficients for weight in start.weights]
    memory = list(demands) or [NO_CONSTRAINTS] * len(origin)
    idle = used = 0
    while not best.is_clean and idle < MAX_STALLED_ROUNDS and used < max_rounds:
        weights, memory, changed = _run_repair_round(scenes[state.last.level], state, origin, memory, tool)
        used += 1
        if not changed:
            break
        state = evaluate_weights(scenes, weights)
        idle = 0 if state.score < best.score else idle + 1
        best = min(best, state, key=lambda s: s.score)
    return best, used


def _run_repair_round(
    scene: SampledComposition, state: BlendState, origin: list[Array], memory: list[WeightConstraints], tool: Strategy
) -> tuple[list[SplineWeight], list[WeightConstraints], bool]:
    """One round: the weights moved, the demands so far, and whether any repair could be had."""
    seen, weights, kept = state.last, list(state.weights), list(memory)
    values = scene.values(weights)
    changed = False
    for stage, weight in enumerate(state.weights):
        sampled = scene.sampled(weights, stage)
        acts = sampled.slope != 0
        if not acts.any():
            continue
        past = tool.margin * float(np.sqrt(np.mean(values[acts] ** 2)))
        groups = []
        for phase, errors, sign in ((seen.census.solid, seen.solid, 1), (seen.census.void, seen.void, -1)):
            if len(errors):
                wanted = RepairRequest(values, phase, errors, sign, past, kept[stage], tool.bias)
                groups += propose_repairs(sampled, weight, wanted).groups
        if groups:
            kept[stage], found, left_out = add_consistent_constraints(weight, origin[stage], kept[stage], groups)
            changed |= len(left_out) < len(groups)
            weights[stage] = weight.moved(found)
    return weights, kept, changed
