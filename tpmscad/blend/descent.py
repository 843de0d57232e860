"""Gradient descent on the topological objective by Adam (Kingma, Ba 2015), the blending paper's adaptive gradient method.

L is piecewise linear in the coefficients, so that step-size rules built on differences of gradients (Malitsky, Mishchenko 2020)
see none and grow without bound; Adam does not. Its steps here: 0.1 for line weights, 0.05 for volume weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.blend.grid import Mask
from tpmscad.blend.objective import Objective, objective
from tpmscad.blend.sampled import Sampled
from tpmscad.blend.scene import Scene
from tpmscad.blend.weight import Weight
from tpmscad.topology.grid import Convention

STEP_LINE, STEP_VOLUME = 0.1, 0.05
FIRST, SECOND, TINY = 0.9, 0.999, 1e-8
"""Adam's decay rates and guard, as published."""


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Weights, steps taken and the objective at the end (with what it ignored)."""

    weights: tuple[Weight, ...]
    steps: int
    last: Objective


def descend(
    scene: Scene,
    weights: Sequence[Weight],
    max_steps: int,
    *,
    strict: bool,
    convention: Convention = "vertices",
    step: float | None = None,
) -> Descent:
    """Weights moved down the gradient until L = 0 on this grid, or max_steps. Coefficients keep within their bounds.

    L = 0 says that nothing which counts is left, not that nothing is left: see `Objective.ignored`.
    """
    state = list(weights)
    first = [np.zeros(w.coefficients.shape) for w in state]
    second = [np.zeros(w.coefficients.shape) for w in state]
    for count in range(1, max_steps + 1):
        sampled = [scene.sampled(state, stage) for stage in range(len(state))]
        seen = _objective(sampled, state, strict, convention)
        if seen.value == 0.0:
            return Descent(tuple(state), count - 1, seen)
        slopes = seen.on(scene.grid.shape)
        for stage, weight in enumerate(state):
            gradient = sampled[stage].gradient(weight, slopes)
            first[stage] = FIRST * first[stage] + (1 - FIRST) * gradient
            second[stage] = SECOND * second[stage] + (1 - SECOND) * gradient**2
            mean = first[stage] / (1 - FIRST**count)
            spread = np.sqrt(second[stage] / (1 - SECOND**count))
            rate = step or (STEP_LINE if weight.coefficients.ndim == 1 else STEP_VOLUME)
            moved = np.clip(weight.coefficients - rate * mean / (spread + TINY), weight.low, weight.high)
            state[stage] = weight.moved(np.where(weight.free, moved, weight.coefficients))
    sampled = [scene.sampled(state, stage) for stage in range(len(state))]
    return Descent(tuple(state), max_steps, _objective(sampled, state, strict, convention))


def _objective(
    sampled: Sequence[Sampled], weights: Sequence[Weight], strict: bool, convention: Convention
) -> Objective:
    movable: Mask = np.any([s.slope != 0 for s in sampled], axis=0)
    return objective(sampled[-1].values(weights[-1]), movable, strict=strict, convention=convention)
