"""Demands on the weight at points, w(p) >= bound or w(p) <= bound, and the nearest coefficients that meet them.

The blended field is affine in the coefficients, so every repair of a topological error is such a set of linear inequalities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, linalg

from tpmscad.blend.grid import Array
from tpmscad.blend.weight import Weight

MAX_STEPS = 600
"""Dual steps: repairs that can be met were met to a hundredth of the slack in 20 to 300."""


@dataclass(frozen=True, slots=True, eq=False)
class Demands:
    """side * w(points) >= side * bound: points (m, 3), bound (m,), side (m,) of +1 and -1."""

    points: Array
    bound: Array
    side: Array

    def __len__(self) -> int:
        return len(self.bound)

    def __add__(self, other: Demands) -> Demands:
        return Demands(
            np.concatenate([self.points, other.points]),
            np.concatenate([self.bound, other.bound]),
            np.concatenate([self.side, other.side]),
        )


NONE = Demands(np.zeros((0, 3)), np.zeros(0), np.zeros(0))


def nearest(weight: Weight, start: Array, demands: Demands, slack: float = 1e-3) -> tuple[Array, float]:
    """The coefficients nearest to `start` (free ones in [0, 1], the others as in the weight) that meet the demands.

    Also the greatest shortfall of w that is left: above `slack` if the demands contradict one another or can't be reached.
    Solved on the dual, min over m >= 0, by accelerated projected gradients: C(m) = clip(start + A' m).
    """
    fixed = np.where(weight.free, 0.0, weight.coefficients).ravel()
    free = np.flatnonzero(weight.free.ravel())
    rows = weight.design(demands.points)
    bound = demands.side * (demands.bound - rows @ fixed)
    rows = csr_array(rows[:, free].multiply(demands.side[:, None]))
    used = np.unique(rows.indices)
    rows = csr_array(rows[:, used])
    free = free[used]
    norm = linalg.norm(rows, axis=1) if len(demands) else np.zeros(0)
    live = norm > 0
    short_for_good = float(np.max(bound[~live], initial=0.0))
    rows, bound, norm = csr_array(rows[live]), bound[live] / norm[live], norm[live]
    rows = csr_array(rows.multiply(1.0 / norm[:, None]))
    back = csr_array(rows.T)
    origin = start.ravel()[free]
    size = float(abs(rows).sum(axis=0).max(initial=0.0) * abs(rows).sum(axis=1).max(initial=0.0))
    step = 1.0 / size if size > 0 else 0.0
    dual = ahead = np.zeros(len(bound))
    pace, best, least = 1.0, origin, np.inf
    for _ in range(MAX_STEPS):
        inside = np.clip(origin + back @ ahead, 0.0, 1.0)
        short = bound - rows @ inside
        worst = float(np.max(short * norm, initial=0.0))
        if worst < least:
            best, least = inside, worst
        if worst <= slack:
            break
        following = np.maximum(ahead + step * short, 0.0)
        if np.dot(ahead - following, following - dual) > 0:
            pace = 1.0
        quicker = (1 + np.sqrt(1 + 4 * pace**2)) / 2
        ahead = following + (pace - 1) / quicker * (following - dual)
        dual, pace = following, quicker
    coefficients = np.where(weight.free, start, weight.coefficients).ravel().copy()
    coefficients[free] = best
    return coefficients.reshape(weight.coefficients.shape), max(least if np.isfinite(least) else 0.0, short_for_good)


def agreed(
    weight: Weight, start: Array, kept: Demands, groups: list[Demands], slack: float = 1e-3
) -> tuple[Demands, Array, list[int]]:
    """`kept` with as many of the groups as do not contradict it or those before them, and the nearest coefficients.

    Also the numbers of the groups left out. Halves what can't be met together, so few contradictions cost few solutions.
    """
    coefficients, short = nearest(weight, start, kept, slack) if len(kept) else (start, 0.0)
    left_out: list[int] = []
    pending = [list(range(len(groups)))]
    while pending:
        some = pending.pop()
        if not some:
            continue
        trial = sum((groups[i] for i in some), kept)
        found, short = nearest(weight, start, trial, slack)
        if short <= slack:
            kept, coefficients = trial, found
        elif len(some) == 1:
            left_out += some
        else:
            half = len(some) // 2
            pending += [some[half:], some[:half]]
    return kept, coefficients, left_out
