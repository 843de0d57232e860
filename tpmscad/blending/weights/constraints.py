"""Linear constraints on a weight at points, and the feasible coefficients nearest to given ones.

A blended field is affine in the coefficients of each weight. The request that the field be solid (or void) at some points is
therefore a system of linear inequalities w(p) >= b or w(p) <= b, with a row of basis-function values for each point. The
coefficients that satisfy it and change least solve a least-distance problem: the Euclidean projection of the present
coefficients onto a polyhedron. Two methods solve it:

* for few coefficients, reduction to non-negative least squares (Lawson and Hanson, Solving Least Squares Problems, chapter 23);
* for many, an accelerated projected gradient method on the dual problem (Beck and Teboulle 2009) with adaptive restart
  (O'Donoghue and Candes 2015).

The porous-blending paper descends on a topological objective instead (section 3.2); the projection reaches the same aim in one
step and tells contradictory requests from feasible ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import csr_array

from tpmscad._typing import Array, IntArray
from tpmscad.blending.weights.weight_protocol import SplineWeight

VIOLATION_TOL = 1e-3
"""Violation of a constraint on w that is accepted: constraints carry a margin a hundred times as large."""

MAX_DENSE_COEFFICIENTS = 150
"""Number of coefficients up to which the projection is computed exactly, which is then faster than the iteration."""

MAX_DUAL_STEPS = 800
"""Steps of the dual iteration at most."""

STALL_CHECK_STEPS, STALL_RATIO = 80, 0.8
"""The dual iteration stops unless the violation falls to this ratio within so many steps."""

INFEASIBILITY_TOL = 1e-10
"""Squared residual of the non-negative least-squares problem below which the constraints are infeasible."""

MIN_ROW_NORM = 1e-6
"""Norm of a row over the free coefficients below which they cannot change the weight at its point."""


@dataclass(frozen=True, slots=True, eq=False)
class WeightConstraints:
    """Constraints sense * w(points) >= sense * bound: points (m, 3), bound (m,), sense (m,) of +1 and -1."""

    points: Array
    bound: Array
    sense: Array

    def __len__(self) -> int:
        return len(self.bound)

    def __add__(self, other: WeightConstraints) -> WeightConstraints:
        return WeightConstraints(
            np.concatenate([self.points, other.points]),
            np.concatenate([self.bound, other.bound]),
            np.concatenate([self.sense, other.sense]),
        )

    def split(self) -> list[WeightConstraints]:
        """Each constraint as a group of its own."""
        return [
            WeightConstraints(self.points[k : k + 1], self.bound[k : k + 1], self.sense[k : k + 1])
            for k in range(len(self))
        ]


NO_CONSTRAINTS = WeightConstraints(np.zeros((0, 3)), np.zeros(0), np.zeros(0))


def make_sign_constraints(
    points: Array,
    value: Array,
    slope: Array,
    sign: Array | float,
    margin: Array | float,
    weight: Array | float = 0.0,
) -> WeightConstraints:
    """Constraints sign * f >= margin at points (m, 3), where f has a value (m,) at a weight and a slope (m,) by the weight."""
    return WeightConstraints(points, weight + (sign * margin - value) / slope, np.where(sign * slope > 0, 1.0, -1.0))


class _ScaledConstraints:
    """Constraints as inequalities rows @ C[free_columns] >= bound with rows of unit norm; any subset can be solved.

    Free coefficients stay within the weight's bounds and the others keep their values.
    """

    def __init__(self, weight: SplineWeight, start: Array, constraints: WeightConstraints) -> None:
        is_free = weight.is_free.ravel()
        self.coefficients = np.where(weight.is_free, start, weight.coefficients)
        rows = weight.design_matrix(constraints.points)
        fixed = np.where(is_free, 0.0, weight.coefficients.ravel())
        bound = constraints.sense * (constraints.bound - rows @ fixed)
        self.free_columns = np.unique(rows.indices[is_free[rows.indices]])
        self.is_dense = len(self.free_columns) <= MAX_DENSE_COEFFICIENTS
        rows = csr_array(rows[:, self.free_columns])
        rows.data *= np.repeat(constraints.sense, np.diff(rows.indptr))
        self.norm = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
        self.is_active_row = self.norm > MIN_ROW_NORM
        scale = np.where(self.is_active_row, self.norm, 1.0)
        self.unscaled_bound, self.bound = bound, bound / scale
        rows.data /= np.repeat(scale, np.diff(rows.indptr))
        self.rows = rows.toarray() if self.is_dense else rows
        self.limits = np.stack(
            [
                np.broadcast_to(b, weight.is_free.shape).ravel()[self.free_columns]
                for b in (weight.lower_bounds, weight.upper_bounds)
            ]
        )

    def solve(self, indices: IntArray) -> tuple[Array, float]:
        """Nearest coefficients that satisfy the constraints with these indices, and the greatest violation that remains.

        A violation above VIOLATION_TOL means that the constraints are contradictory or out of reach.
        """
        active = indices[self.is_active_row[indices]]
        inactive = indices[~self.is_active_row[indices]]
        violation = float(np.max(self.unscaled_bound[inactive], initial=0.0))
        coefficients = self.coefficients.copy()
        if len(active):
            flat = coefficients.reshape(-1)
            rows = self.rows[active] if self.is_dense else csr_array(self.rows[active])
            method = _solve_dual_nnls if self.is_dense else _solve_dual_gradient
            flat[self.free_columns], remaining = method(
                rows, self.bound[active], self.norm[active], flat[self.free_columns], self.limits
            )
            violation = max(violation, remaining)
        return coefficients, violation


def _solve_dual_nnls(rows: Array, bound: Array, norm: Array, origin: Array, limits: Array) -> tuple[Array, float]:
    """Least-distance problem by non-negative least squares; the bounds of the coefficients are rows as well."""
    count = len(origin)
    identity = np.eye(count)
    matrix = np.vstack([rows, identity, -identity])
    rhs = np.concatenate([bound, limits[0], -limits[1]]) - matrix @ origin
    # of equal rows only the tightest matters
    keys = np.round(matrix, 9)
    _, unique_rows, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    tightest = np.full(len(unique_rows), -np.inf)
    np.maximum.at(tightest, group.ravel(), rhs)
    system = np.vstack([matrix[unique_rows].T, tightest])
    target = np.zeros(count + 1)
    target[-1] = 1.0
    try:
        dual, _ = nnls(system, target)
    except RuntimeError:  # contradictory constraints exceed the iteration limit of nnls
        return origin, np.inf
    residual = system @ dual - target
    if -residual[-1] < INFEASIBILITY_TOL:
        return origin, np.inf
    solution = np.clip(origin - residual[:-1] / residual[-1], limits[0], limits[1])
    return solution, float(np.max((bound - rows @ solution) * norm, initial=0.0))


def _solve_dual_gradient(
    rows: csr_array, bound: Array, norm: Array, origin: Array, limits: Array
) -> tuple[Array, float]:
    """Least-distance problem by an accelerated dual method: C(m) = clip(origin + A^T m) for multipliers m >= 0."""
    transpose = csr_array(rows.T)
    # ||A||_1 ||A||_inf bounds the Lipschitz constant ||A||_2^2 of the dual gradient
    lipschitz = float(abs(rows).sum(axis=0).max() * abs(rows).sum(axis=1).max())
    dual = extrapolated = np.zeros(len(bound))
    momentum, best, least, checked = 1.0, origin, np.inf, np.inf
    for step in range(MAX_DUAL_STEPS):
        primal = np.clip(origin + transpose @ extrapolated, limits[0], limits[1])
        shortfall = bound - rows @ primal
        violation = float(np.max(shortfall * norm))
        if violation < least:
            best, least = primal, violation
        if violation <= VIOLATION_TOL:
            break
        if step % STALL_CHECK_STEPS == STALL_CHECK_STEPS - 1:
            if least > STALL_RATIO * checked:
                break
            checked = least
        updated = np.maximum(extrapolated + shortfall / lipschitz, 0.0)
        if np.dot(extrapolated - updated, updated - dual) > 0:
            momentum = 1.0
        next_momentum = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        extrapolated = updated + (momentum - 1) / next_momentum * (updated - dual)
        dual, momentum = updated, next_momentum
    return best, max(least, 0.0)


def add_consistent_constraints(
    weight: SplineWeight, start: Array, accepted: WeightConstraints, groups: list[WeightConstraints]
) -> tuple[WeightConstraints, Array, list[int]]:
    """Constraints extended by groups that do not contradict them, and the feasible coefficients nearest to `start`.

    Groups are added greedily: all at once if that is feasible, otherwise by bisection, so that few contradictions cost few
    solutions. Also returns the indices of the groups left out.
    """
    system = _ScaledConstraints(weight, start, sum(groups, accepted))
    ends = np.cumsum([len(accepted), *(len(group) for group in groups)])
    rows_of = [np.arange(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    feasible = np.arange(len(accepted))
    coefficients = system.solve(feasible)[0] if len(accepted) else start
    taken: list[int] = []
    left_out: list[int] = []
    pending = [list(range(len(groups)))]
    while pending:
        trial = pending.pop()
        if not trial:
            continue
        rows = np.concatenate([feasible, *(rows_of[i] for i in trial)])
        solution, violation = system.solve(rows)
        if violation <= VIOLATION_TOL:
            feasible, coefficients = rows, solution
            taken += trial
        elif len(trial) == 1:
            left_out += trial
        else:
            half = len(trial) // 2
            pending += [trial[half:], trial[:half]]
    return sum((groups[i] for i in taken), accepted), coefficients, left_out
