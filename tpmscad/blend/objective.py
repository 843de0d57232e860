"""The topological objective of the blending paper (eqs 18-23) and its gradient through the topological inverse map.

A pair (b, d) with b <= 0 < d is an error of {f <= 0}: a component (dimension 0, beside the one that never dies) or a cavity
(dimension 2). It is mended by lifting its birth above zero or lowering its death to zero, whichever is nearer, and the objective
is the sum of these distances: L = sum of d over region III (d < -b) - sum of b over region II.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad import topology
from tpmscad.blend.grid import Array, Ints, Mask
from tpmscad.topology.grid import Convention


@dataclass(frozen=True, slots=True, eq=False)
class Objective:
    """L, its gradient by the samples of f (flat indices `at`, slopes `by`), and how many pairs count and how many are ignored."""

    value: float
    at: Ints
    by: Array
    active: int
    ignored: int

    def on(self, shape: tuple[int, int, int]) -> Array:
        """The gradient by all samples (nx, ny, nz)."""
        full = np.zeros(shape)
        np.add.at(full.reshape(-1), self.at, self.by)
        return full


def objective(
    values: Array, movable: Mask, *, strict: bool = True, convention: Convention = "vertices", level: float = 0.0
) -> Objective:
    """The objective of sampled values (nx, ny, nz), pairs alive at `level`.

    movable: samples of the blending region, where the weight acts. strict: pairs count only if birth and death both are movable
    (eq. 22); otherwise if either is, and then the one that can be moved is, the nearer if both can.
    """
    total, at, by = 0.0, [np.zeros(0, np.int64)], [np.zeros(0)]
    active = ignored = 0
    free = movable.ravel()
    for dimension in (0, 2):
        pairs = topology.straddling(values, dimension, convention, level)
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
    return Objective(total, np.concatenate(at), np.concatenate(by), active, ignored)
