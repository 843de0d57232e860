"""Demands on the weight at points, w(p) >= bound or w(p) <= bound, and the nearest coefficients that meet them.

The blended field is affine in the coefficients, so every repair of a topological error is such a set of linear inequalities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import csr_array, diags_array, linalg

from tpmscad.blend.grid import Array
from tpmscad.blend.weight import Weight

SLACK = 1e-3
"""Shortfall of w that passes: demands carry a margin a hundred times that."""

SMALL = 150
"""Coefficients up to which the nearest point is computed exactly: a millisecond or two, where the iteration takes tens."""

MAX_STEPS, PATIENCE, GAIN = 800, 80, 0.8
"""Dual steps at most, and the steps in which the shortfall must have shrunk to that part of itself for there to be more."""

CONTRADICTION = 1e-10
"""Squared distance from feasibility, in the scaled problem, below which demands contradict one another."""

LEAST_NORM = 1e-6
"""Rows of the basis below this have no free coefficient to speak of."""


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


def nearest(weight: Weight, start: Array, demands: Demands, slack: float = SLACK) -> tuple[Array, float]:
    """The coefficients nearest to `start` (free ones within the weight's bounds, the others as they are) that meet the demands.

    Also the greatest shortfall of w that is left: above `slack` if the demands contradict one another or can't be reached.
    """
    fixed = np.where(weight.free, 0.0, weight.coefficients).ravel()
    rows = weight.design(demands.points)
    bound = demands.side * (demands.bound - rows @ fixed)
    rows = csr_array(csr_array(rows.multiply(demands.side[:, None])) @ diags_array(weight.free.ravel().astype(float)))
    rows.eliminate_zeros()
    used = np.unique(rows.indices)
    rows = csr_array(rows[:, used])
    norm = linalg.norm(rows, axis=1) if len(demands) else np.zeros(0)
    live = norm > LEAST_NORM
    short = float(np.max(bound[~live], initial=0.0))
    coefficients = np.where(weight.free, start, weight.coefficients).ravel().copy()
    if live.any():
        rows = csr_array(csr_array(rows[live]).multiply(1.0 / norm[live][:, None]))
        method = _exact if len(used) <= SMALL else _accelerated
        limits = np.stack([np.broadcast_to(b, weight.free.shape).ravel()[used] for b in (weight.low, weight.high)])
        coefficients[used], more = method(rows, bound[live] / norm[live], norm[live], coefficients[used], limits, slack)
        short = max(short, more)
    return coefficients.reshape(weight.coefficients.shape), short


def _exact(
    rows: csr_array, bound: Array, norm: Array, origin: Array, limits: Array, slack: float
) -> tuple[Array, float]:
    """Least-distance programming by non-negative least squares (Lawson and Hanson, chapter 23), the bounds as rows."""
    count = len(origin)
    wall = np.eye(count)
    matrix = np.vstack([rows.toarray(), wall, -wall])
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
    if -residual[-1] < CONTRADICTION:
        return origin, np.inf
    found = np.clip(origin - residual[:-1] / residual[-1], limits[0], limits[1])
    return found, float(np.max((bound - rows @ found) * norm, initial=0.0))


def _accelerated(
    rows: csr_array, bound: Array, norm: Array, origin: Array, limits: Array, slack: float
) -> tuple[Array, float]:
    """The dual, min over m >= 0 with C(m) = clip(origin + A' m), by projected gradients with momentum and restarts."""
    back = csr_array(rows.T)
    size = float(abs(rows).sum(axis=0).max() * abs(rows).sum(axis=1).max())
    dual = ahead = np.zeros(len(bound))
    pace, best, least, checked = 1.0, origin, np.inf, np.inf
    for step in range(MAX_STEPS):
        inside = np.clip(origin + back @ ahead, limits[0], limits[1])
        short = bound - rows @ inside
        worst = float(np.max(short * norm))
        if worst < least:
            best, least = inside, worst
        if worst <= slack:
            break
        if step % PATIENCE == PATIENCE - 1:
            if least > GAIN * checked:
                break
            checked = least
        following = np.maximum(ahead + short / size, 0.0)
        if np.dot(ahead - following, following - dual) > 0:
            pace = 1.0
        quicker = (1 + np.sqrt(1 + 4 * pace**2)) / 2
        ahead = following + (pace - 1) / quicker * (following - dual)
        dual, pace = following, quicker
    return best, max(least, 0.0)


def agreed(
    weight: Weight, start: Array, kept: Demands, groups: list[Demands], slack: float = SLACK
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
