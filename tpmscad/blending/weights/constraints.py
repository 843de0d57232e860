"""Demands on the weight at points, w(p) >= bound or w(p) <= bound, and the nearest coefficients that meet them.

The blended field is affine in the coefficients, so every repair of a topological error is such a set of linear inequalities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import csr_array

from tpmscad._typing import Array, IntArray
from tpmscad.blending.weights.weight_protocol import SplineWeight

SHORTFALL_TOL = 1e-3
"""Shortfall of w that passes: demands carry a margin a hundred times that."""

MAX_DENSE_COEFFICIENTS = 150
"""Coefficients up to which the nearest point is computed exactly: a millisecond or two, where the iteration takes tens."""

MAX_DUAL_STEPS, STALL_CHECK_STEPS, STALL_RATIO = 800, 80, 0.8
"""Dual steps at most, and the steps in which the shortfall must have shrunk to that part of itself for there to be more."""

INFEASIBILITY_TOL = 1e-10
"""Squared distance from feasibility, in the scaled problem, below which demands contradict one another."""

MIN_ROW_NORM = 1e-6
"""Rows of the basis below this have no free coefficient to speak of."""


@dataclass(frozen=True, slots=True, eq=False)
class WeightConstraints:
    """side * w(points) >= side * bound: points (m, 3), bound (m,), side (m,) of +1 and -1."""

    points: Array
    bound: Array
    side: Array

    def __len__(self) -> int:
        return len(self.bound)

    def __add__(self, other: WeightConstraints) -> WeightConstraints:
        return WeightConstraints(
            np.concatenate([self.points, other.points]),
            np.concatenate([self.bound, other.bound]),
            np.concatenate([self.side, other.side]),
        )


NO_CONSTRAINTS = WeightConstraints(np.zeros((0, 3)), np.zeros(0), np.zeros(0))


def project_onto_constraints(
    weight: SplineWeight, start: Array, demands: WeightConstraints, slack: float = SHORTFALL_TOL
) -> tuple[Array, float]:
    """The coefficients nearest to `start` (free ones within the weight's bounds, the others as they are) that meet the demands.

    Also the greatest shortfall of w that is left: above `slack` if the demands contradict one another or can't be reached.
    """
    return _ScaledConstraints(weight, start, demands).solved(np.arange(len(demands)), slack)


class _ScaledConstraints:
    """Demands as inequalities rows @ C[used] >= bound of unit rows, read once; any part of them can be solved for."""

    def __init__(self, weight: SplineWeight, start: Array, demands: WeightConstraints) -> None:
        free = weight.free.ravel()
        self.coefficients = np.where(weight.free, start, weight.coefficients)
        rows = weight.design(demands.points)
        bound = demands.side * (demands.bound - rows @ np.where(free, 0.0, weight.coefficients.ravel()))
        self.used = np.unique(rows.indices[free[rows.indices]])
        self.dense = len(self.used) <= MAX_DENSE_COEFFICIENTS
        rows = csr_array(rows[:, self.used])
        rows.data *= np.repeat(demands.side, np.diff(rows.indptr))
        self.norm = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
        self.live = self.norm > MIN_ROW_NORM
        scale = np.where(self.live, self.norm, 1.0)
        self.short, self.bound = bound, bound / scale
        rows.data /= np.repeat(scale, np.diff(rows.indptr))
        self.rows = rows.toarray() if self.dense else rows
        self.limits = np.stack(
            [np.broadcast_to(b, weight.free.shape).ravel()[self.used] for b in (weight.low, weight.high)]
        )

    def solved(self, which: IntArray, slack: float) -> tuple[Array, float]:
        """The nearest coefficients that meet the demands of these numbers, and the shortfall left."""
        live = which[self.live[which]]
        short = float(np.max(self.short[which[~self.live[which]]], initial=0.0))
        coefficients = self.coefficients.copy()
        if len(live):
            flat = coefficients.reshape(-1)
            rows = self.rows[live] if self.dense else csr_array(self.rows[live])
            method = _solve_dual_nnls if self.dense else _solve_dual_gradient
            flat[self.used], more = method(rows, self.bound[live], self.norm[live], flat[self.used], self.limits, slack)
            short = max(short, more)
        return coefficients, short


def _solve_dual_nnls(
    rows: Array, bound: Array, norm: Array, origin: Array, limits: Array, slack: float
) -> tuple[Array, float]:
    """Least-distance programming by non-negative least squares (Lawson and Hanson, chapter 23), the bounds as rows."""
    count = len(origin)
    wall = np.eye(count)
    matrix = np.vstack([rows, wall, -wall])
    right = np.concatenate([bound, limits[0], -limits[1]]) - matrix @ origin
    keys = np.round(matrix, 9)
    _, once, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    tightest = np.full(len(once), -np.inf)
    np.maximum.at(tightest, which.ravel(), right)
    system = np.vstack([matrix[once].T, tightest])
    goal = np.zeros(count + 1)
    goal[-1] = 1.0
    try:
        dual, _ = nnls(system, goal)
    except RuntimeError:  # its iteration limit, met by contradictory demands
        return origin, np.inf
    residual = system @ dual - goal
    if -residual[-1] < INFEASIBILITY_TOL:
        return origin, np.inf
    found = np.clip(origin - residual[:-1] / residual[-1], limits[0], limits[1])
    return found, float(np.max((bound - rows @ found) * norm, initial=0.0))


def _solve_dual_gradient(
    rows: csr_array, bound: Array, norm: Array, origin: Array, limits: Array, slack: float
) -> tuple[Array, float]:
    """The dual, min over m >= 0 with C(m) = clip(origin + A' m), by projected gradients with momentum and restarts."""
    back = csr_array(rows.T)
    size = float(abs(rows).sum(axis=0).max() * abs(rows).sum(axis=1).max())
    dual = ahead = np.zeros(len(bound))
    pace, best, least, checked = 1.0, origin, np.inf, np.inf
    for step in range(MAX_DUAL_STEPS):
        inside = np.clip(origin + back @ ahead, limits[0], limits[1])
        short = bound - rows @ inside
        worst = float(np.max(short * norm))
        if worst < least:
            best, least = inside, worst
        if worst <= slack:
            break
        if step % STALL_CHECK_STEPS == STALL_CHECK_STEPS - 1:
            if least > STALL_RATIO * checked:
                break
            checked = least
        following = np.maximum(ahead + short / size, 0.0)
        if np.dot(ahead - following, following - dual) > 0:
            pace = 1.0
        quicker = (1 + np.sqrt(1 + 4 * pace**2)) / 2
        ahead = following + (pace - 1) / quicker * (following - dual)
        dual, pace = following, quicker
    return best, max(least, 0.0)


def add_consistent_constraints(
    weight: SplineWeight,
    start: Array,
    kept: WeightConstraints,
    groups: list[WeightConstraints],
    slack: float = SHORTFALL_TOL,
) -> tuple[WeightConstraints, Array, list[int]]:
    """`kept` with as many of the groups as do not contradict it or those before them, and the nearest coefficients.

    Also the numbers of the groups left out. Halves what can't be met together, so few contradictions cost few solutions.
    """
    system = _ScaledConstraints(weight, start, sum(groups, kept))
    ends = np.cumsum([len(kept), *(len(group) for group in groups)])
    numbers = [np.arange(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    agreeing = np.arange(len(kept))
    coefficients = system.solved(agreeing, slack)[0] if len(kept) else start
    taken: list[int] = []
    left_out: list[int] = []
    pending = [list(range(len(groups)))]
    while pending:
        some = pending.pop()
        if not some:
            continue
        trial = np.concatenate([agreeing, *(numbers[i] for i in some)])
        found, short = system.solved(trial, slack)
        if short <= slack:
            agreeing, coefficients = trial, found
            taken += some
        elif len(some) == 1:
            left_out += some
        else:
            half = len(some) // 2
            pending += [some[half:], some[:half]]
    return sum((groups[i] for i in taken), kept), coefficients, left_out
