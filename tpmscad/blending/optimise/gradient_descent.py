"""The topological objective of the blending paper (eqs 18-23) and its gradient through the topological inverse map.

A pair (b, d) with b <= 0 < d is an error of {f <= 0}: a component (dimension 0, beside the one that never dies) or a cavity
(dimension 2). It is mended by lifting its birth above zero or lowering its death to zero, whichever is nearer, and the objective
is the sum of these distances: L = sum of d over region III (d < -b) - sum of b over region II.

Gradient descent on the topological objective by Adam (Kingma, Ba 2015), the blending paper's adaptive gradient method.

L is piecewise linear in the coefficients, so that step-size rules built on differences of gradients (Malitsky, Mishchenko 2020)
see none and grow without bound; Adam does not. Its steps here: 0.1 for line weights, 0.05 for volume weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad import topology
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.composition.affine_form import AffineBlend
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.topology.voxels import Convention


@dataclass(frozen=True, slots=True, eq=False)
class TopologicalObjective:
    """L, its gradient by the samples of f (flat indices `at`, slopes `by`), and how many pairs count and how many are ignored."""

    value: float
    at: IntArray
    by: Array
    active: int
    ignored: int

    def to_dense(self, shape: tuple[int, int, int]) -> Array:
        """The gradient by all samples (nx, ny, nz)."""
        full = np.zeros(shape)
        np.add.at(full.reshape(-1), self.at, self.by)
        return full


def evaluate_objective(
    values: Array, movable: BoolArray, *, strict: bool = True, convention: Convention = "vertices", level: float = 0.0
) -> TopologicalObjective:
    """The objective of sampled values (nx, ny, nz), pairs alive at `level`.

    movable: samples of the blending region, where the weight acts. strict: pairs count only if birth and death both are movable
    (eq. 22); otherwise if either is, and then the one that can be moved is, the nearer if both can.
    """
    total, at, by = 0.0, [np.zeros(0, np.int64)], [np.zeros(0)]
    active = ignored = 0
    free = movable.ravel()
    for dimension in (0, 2):
        pairs = topology.compute_pairs_at_level(values, dimension, convention, level)
        mortal = np.isfinite(pairs.death)
        birth, death = pairs.birth[mortal] - level, pairs.death[mortal] - level
        birth_at, death_at = pairs.birth_at[mortal], pairs.death_at[mortal]
        can_lift, can_lower = free[birth_at], free[death_at]
        lower = death < -birth
        counts = can_lift & can_lower if strict else can_lift | can_lower
        if not strict:
            lower = np.where(can_lift & can_lower, lower, can_lower)
        up, down = counts & ~lower, counts & lower
        total += float(death[down].sum() - birth[up].sum())
        at += [birth_at[up], death_at[down]]
        by += [np.full(int(up.sum()), -1.0), np.full(int(down.sum()), 1.0)]
        active += int(counts.sum())
        ignored += int((~counts).sum())
    return TopologicalObjective(total, np.concatenate(at), np.concatenate(by), active, ignored)


LINE_STEP_SIZE, VOLUME_STEP_SIZE = 0.1, 0.05
ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON = 0.9, 0.999, 1e-8
"""Adam's decay rates and guard, as published."""


@dataclass(frozen=True, slots=True, eq=False)
class DescentResult:
    """Weights, steps taken and the objective at the end (with what it ignored)."""

    weights: tuple[SplineWeight, ...]
    steps: int
    last: TopologicalObjective


def descend(
    scene: SampledComposition,
    weights: Sequence[SplineWeight],
    max_steps: int,
    *,
    strict: bool,
    convention: Convention = "vertices",
    step: float | None = None,
) -> DescentResult:
    """Weights moved down the gradient until L = 0 on this grid, or max_steps. Coefficients keep within their bounds.

    L = 0 says that nothing which counts is left, not that nothing is left: see `Objective.ignored`.
    """
    state = list(weights)
    first = [np.zeros(w.coefficients.shape) for w in state]
    second = [np.zeros(w.coefficients.shape) for w in state]
    for count in range(1, max_steps + 1):
        sampled = [scene.sampled(state, stage) for stage in range(len(state))]
        seen = _evaluate_blend_objective(sampled, state, strict, convention)
        if seen.value == 0.0:
            return DescentResult(tuple(state), count - 1, seen)
        slopes = seen.to_dense(scene.grid.shape)
        for stage, weight in enumerate(state):
            gradient = sampled[stage].gradient(weight, slopes)
            first[stage] = ADAM_BETA1 * first[stage] + (1 - ADAM_BETA1) * gradient
            second[stage] = ADAM_BETA2 * second[stage] + (1 - ADAM_BETA2) * gradient**2
            mean = first[stage] / (1 - ADAM_BETA1**count)
            spread = np.sqrt(second[stage] / (1 - ADAM_BETA2**count))
            rate = step or (LINE_STEP_SIZE if weight.coefficients.ndim == 1 else VOLUME_STEP_SIZE)
            moved = np.clip(weight.coefficients - rate * mean / (spread + ADAM_EPSILON), weight.low, weight.high)
            state[stage] = weight.moved(np.where(weight.free, moved, weight.coefficients))
    sampled = [scene.sampled(state, stage) for stage in range(len(state))]
    return DescentResult(tuple(state), max_steps, _evaluate_blend_objective(sampled, state, strict, convention))


def _evaluate_blend_objective(
    sampled: Sequence[AffineBlend], weights: Sequence[SplineWeight], strict: bool, convention: Convention
) -> TopologicalObjective:
    movable: BoolArray = np.any([s.slope != 0 for s in sampled], axis=0)
    return evaluate_objective(sampled[-1].values(weights[-1]), movable, strict=strict, convention=convention)
