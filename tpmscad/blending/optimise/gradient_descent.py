"""The topological objective of the porous-blending paper, its gradient, and the descent on it (section 3.2).

A persistence pair (b, d) with b <= 0 < d is a defect of {f <= 0}: a component besides the one that never dies (dimension 0) or a
cavity (dimension 2). The defect vanishes if its birth is lifted above zero or its death lowered to zero. The objective is the sum
of the shorter of these distances (eqs 18 to 21): L = sum of d over region III, where d < -b, minus the sum of b over region II.
Births and deaths are values of f at critical samples, so that the gradient of L by the samples has entries -1 and +1 there (the
topological inverse map), and the chain rule gives the gradient by the coefficients.

The paper counts a pair only if both its critical samples lie in the blending region (eq. 22). A component whose lowest sample
lies outside is then never seen, and L = 0 is no proof of success. Without `strict`, one movable critical sample suffices.

The paper descends by an adaptive gradient method; here it is Adam (Kingma and Ba 2015). L is piecewise linear in the
coefficients, so that step sizes from differences of gradients (Malitsky and Mishchenko 2020) would grow without bound.
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

LINE_STEP_SIZE, VOLUME_STEP_SIZE = 0.1, 0.05
"""Adam's step sizes for univariate and trivariate weights."""

ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON = 0.9, 0.999, 1e-8
"""Adam's decay rates and regularisation, as published."""


@dataclass(frozen=True, slots=True, eq=False)
class TopologicalObjective:
    """L and its gradient by the samples of f, as flat indices and derivatives; how many pairs count and how many do not."""

    value: float
    indices: IntArray
    derivatives: Array
    n_active: int
    n_ignored: int

    def to_dense(self, shape: tuple[int, int, int]) -> Array:
        """The gradient by all samples: (nx, ny, nz)."""
        dense = np.zeros(shape)
        np.add.at(dense.reshape(-1), self.indices, self.derivatives)
        return dense


def evaluate_objective(
    values: Array, movable: BoolArray, *, strict: bool = True, convention: Convention = "vertices"
) -> TopologicalObjective:
    """The objective of sampled values (nx, ny, nz), over the pairs alive at zero.

    `movable` (nx, ny, nz) masks the samples that the weights change. With `strict` a pair counts if both its critical samples are
    movable (eq. 22). Otherwise one suffices, and of two movable ones that nearer to zero is moved.
    """
    total, indices, derivatives = 0.0, [np.zeros(0, np.int64)], [np.zeros(0)]
    n_active = n_ignored = 0
    is_movable = movable.ravel()
    for dimension in (0, 2):
        pairs = topology.compute_pairs_at_level(values, dimension, convention)
        mortal = np.isfinite(pairs.death)
        birth, death = pairs.birth[mortal], pairs.death[mortal]
        birth_at, death_at = pairs.birth_at[mortal], pairs.death_at[mortal]
        can_lift, can_lower = is_movable[birth_at], is_movable[death_at]
        death_is_nearer = death < -birth
        if strict:
            counts = can_lift & can_lower
        else:
            counts = can_lift | can_lower
            death_is_nearer = np.where(can_lift & can_lower, death_is_nearer, can_lower)
        lift_birth, lower_death = counts & ~death_is_nearer, counts & death_is_nearer
        total += float(death[lower_death].sum() - birth[lift_birth].sum())
        indices += [birth_at[lift_birth], death_at[lower_death]]
        derivatives += [np.full(int(lift_birth.sum()), -1.0), np.full(int(lower_death.sum()), 1.0)]
        n_active += int(counts.sum())
        n_ignored += int((~counts).sum())
    return TopologicalObjective(total, np.concatenate(indices), np.concatenate(derivatives), n_active, n_ignored)


@dataclass(frozen=True, slots=True, eq=False)
class DescentResult:
    """The weights of all stages after a descent, its number of steps, and the objective at the end."""

    weights: tuple[SplineWeight, ...]
    steps: int
    objective: TopologicalObjective


def descend(
    composition: SampledComposition,
    weights: Sequence[SplineWeight],
    max_steps: int,
    *,
    strict: bool,
    convention: Convention = "vertices",
) -> DescentResult:
    """The weights after Adam steps on the objective of one grid, until L = 0 or `max_steps`; coefficients keep their bounds.

    L = 0 means that no active persistence pair remains; pairs that do not count may remain (`TopologicalObjective.n_ignored`).
    """
    current = list(weights)
    first_moment = [np.zeros(w.coefficients.shape) for w in current]
    second_moment = [np.zeros(w.coefficients.shape) for w in current]
    for step in range(1, max_steps + 1):
        affine = [composition.affine_form(current, stage) for stage in range(len(current))]
        objective = _evaluate_blend_objective(affine, current, strict, convention)
        if objective.value == 0.0:
            return DescentResult(tuple(current), step - 1, objective)
        sample_derivatives = objective.to_dense(composition.grid.shape)
        for stage, weight in enumerate(current):
            gradient = affine[stage].gradient(weight, sample_derivatives)
            first_moment[stage] = ADAM_BETA1 * first_moment[stage] + (1 - ADAM_BETA1) * gradient
            second_moment[stage] = ADAM_BETA2 * second_moment[stage] + (1 - ADAM_BETA2) * gradient**2
            mean = first_moment[stage] / (1 - ADAM_BETA1**step)
            deviation = np.sqrt(second_moment[stage] / (1 - ADAM_BETA2**step))
            rate = LINE_STEP_SIZE if weight.coefficients.ndim == 1 else VOLUME_STEP_SIZE
            updated = weight.coefficients - rate * mean / (deviation + ADAM_EPSILON)
            updated = np.clip(updated, weight.lower_bounds, weight.upper_bounds)
            current[stage] = weight.with_coefficients(np.where(weight.is_free, updated, weight.coefficients))
    affine = [composition.affine_form(current, stage) for stage in range(len(current))]
    return DescentResult(tuple(current), max_steps, _evaluate_blend_objective(affine, current, strict, convention))


def _evaluate_blend_objective(
    affine: Sequence[AffineBlend], weights: Sequence[SplineWeight], strict: bool, convention: Convention
) -> TopologicalObjective:
    movable: BoolArray = np.any([form.slope != 0 for form in affine], axis=0)
    return evaluate_objective(affine[-1].values(weights[-1]), movable, strict=strict, convention=convention)
