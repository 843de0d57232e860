"""Minimum neck width: no solid and no void narrower than requested at the saddle points inside the blending regions.

A phase is narrowest at a saddle point of the field: an index-1 or index-2 critical point whose distance to {f = 0} is half the
width of the neck. A ball around the saddle that lies in the phase bounds this width from below. As the field is affine in each
weight, the ball is a set of linear constraints on the weight. A neck that is too narrow is widened so or, where that contradicts
other constraints, cut: the ball is then requested of the opposite phase.

Topology comes first: after each round the defects that it made are repaired under the constraints of the balls. The paper has no
counterpart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.blending.composition.affine_form import evaluate_affine_form
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.blend_state import BlendProblem, BlendState, OptimisationOutcome
from tpmscad.blending.optimise.constraint_rounds import ConstrainedWeights, evaluate_and_repair, start_unconstrained
from tpmscad.blending.weights.constraints import WeightConstraints, make_sign_constraints
from tpmscad.blending.weights.line_weight import LineWeight
from tpmscad.fields.analysis.saddles import (
    RAY_DIRECTIONS,
    Neck,
    Saddles,
    find_saddles,
    measure_neck_widths,
    spread_directions,
)

MAX_WIDENING_ROUNDS = 8

ACCEPTED_WIDTH_FRACTION = 0.98
"""Fraction of the requested width from which a neck is accepted."""

TARGET_WIDTH_FRACTION = 1.04
"""Diameter of the balls as a fraction of the requested width: the saddle moves a little when its neck is widened."""

BALL_RADIUS_FRACTIONS = (0.5, 0.8, 1.0)
"""Radii of the spheres of points that stand for a ball, as fractions of its radius."""

BALL_CLEARANCE_RMS = 1e-3
"""Margin of |f| at the points of a ball, as a fraction of the field's rms in the blending regions."""

SADDLE_SEARCH_WIDTHS, RAY_LENGTH_WIDTHS = 1.5, 0.75
"""Estimated width up to which saddles are searched for, and length of the rays to the surface, in requested widths."""


def widen_necks(problem: BlendProblem, outcome: OptimisationOutcome, width: float) -> OptimisationOutcome:
    """The outcome without necks under `width` (model units) inside the blending regions, as far as that can be reached."""
    state, rounds = outcome.state, 0
    constrained = start_unconstrained(state.weights, fixed_origin=True)
    best: tuple[tuple[tuple[int, int], int], BlendState, tuple[Neck, ...]] | None = None
    for _ in range(MAX_WIDENING_ROUNDS):
        saddles, widths, directions = measure_necks(problem.coarse, problem.field.with_weights(state.weights), width)
        narrow = np.flatnonzero(widths < ACCEPTED_WIDTH_FRACTION * width)
        score = state.score, len(narrow)
        if best is None or score < best[0]:
            best = score, state, make_necks(saddles, widths, narrow)
        if len(narrow) == 0 or rounds >= problem.max_rounds:
            break
        balls = [
            _sample_ball(problem, saddles, directions, k, TARGET_WIDTH_FRACTION * width / 2) for k in map(int, narrow)
        ]
        values = problem.coarse.values(state.weights)
        clearance = BALL_CLEARANCE_RMS * problem.coarse.rms_in_blending_regions(values)
        constrained, changed = _run_widening_round(
            problem, replace(constrained, weights=state.weights), balls, clearance
        )
        if not changed:
            break
        state, used = evaluate_and_repair(problem.compositions, constrained, problem.max_rounds - rounds - 1)
        rounds += 1 + used
    assert best is not None
    _, state, narrow_necks = best
    lines = []
    if narrow_necks:
        least = min(neck.width for neck in narrow_necks)
        lines.append(f"{len(narrow_necks)} necks stay narrower than {width:g}, the narrowest {least:.3g}")
    return replace(outcome.advance(state, rounds, *lines), narrow_necks=narrow_necks)


def measure_necks(composition: SampledComposition, field: BlendedField, width: float) -> tuple[Saddles, Array, Array]:
    """The n saddles inside the blending regions that may be narrower than `width`, their widths, directions to the surface.

    Widths (n,) are inf beyond the range of the search; directions (n, 3) point to the nearest point of the surface.
    """
    saddles = find_saddles(field, composition.grid, composition.blending_mask, SADDLE_SEARCH_WIDTHS * width)
    inside = np.any([np.asarray(region(saddles.points)) <= 0 for region in field.blending_regions], axis=0)
    saddles = Saddles(saddles.points[inside], saddles.values[inside])
    widths, directions = measure_neck_widths(field, saddles, composition.grid, RAY_LENGTH_WIDTHS * width)
    return saddles, widths, directions


def make_necks(saddles: Saddles, widths: Array, indices: IntArray) -> tuple[Neck, ...]:
    """The necks at the saddles with these indices."""
    return tuple(
        Neck(tuple(saddles.points[k].tolist()), "solid" if saddles.values[k] < 0 else "void", float(widths[k]))
        for k in indices
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Ball:
    """Points (m, 3) of a ball around a saddle, and the sign of f that is requested there."""

    points: Array
    sign: float

    def reversed(self) -> _Ball:
        return _Ball(self.points, -self.sign)


def _run_widening_round(
    problem: BlendProblem, constrained: ConstrainedWeights, balls: Sequence[_Ball], clearance: float
) -> tuple[ConstrainedWeights, bool]:
    """The weights after each stage has met what it can of the balls, and whether any ball was accepted."""
    changed = False
    for stage in range(len(constrained.weights)):
        constrained, accepted, rest = _request_balls(problem, constrained, stage, balls, clearance)
        changed |= accepted
        weight = constrained.weights[stage]
        refined = problem.refine(stage, weight) if rest and isinstance(weight, LineWeight) else None
        if refined is not None:
            constrained = constrained.with_weight(stage, refined)
            constrained, accepted, rest = _request_balls(problem, constrained, stage, rest, clearance)
            changed |= accepted
        if rest:
            cuts = [ball.reversed() for ball in rest]
            constrained, accepted, _ = _request_balls(problem, constrained, stage, cuts, clearance)
            changed |= accepted
    return constrained, changed


def _request_balls(
    problem: BlendProblem, constrained: ConstrainedWeights, stage: int, balls: Sequence[_Ball], clearance: float
) -> tuple[ConstrainedWeights, bool, list[_Ball]]:
    """The weights with the balls met that one stage can meet, whether any was, and the balls that contradict constraints."""
    field = problem.field.with_weights(constrained.weights)
    requests = [(ball, _ball_constraints(field, stage, ball, clearance)) for ball in balls]
    solvable = [(ball, group) for ball, group in requests if group is not None and len(group)]
    if not solvable:
        return constrained, False, []
    constrained, left_out = constrained.add(stage, [group for _, group in solvable])
    return constrained, len(left_out) < len(solvable), [solvable[k][0] for k in left_out]


def _sample_ball(problem: BlendProblem, saddles: Saddles, directions: Array, index: int, radius: float) -> _Ball:
    """Points on spheres around a saddle, with its centre, that are inside the domain; the sign is that of f at the saddle."""
    centre, toward = saddles.points[index], directions[index]
    rays = np.concatenate([spread_directions(RAY_DIRECTIONS), toward[None], -toward[None]])
    shells = [centre + fraction * radius * rays for fraction in BALL_RADIUS_FRACTIONS]
    points = np.concatenate([*shells, centre[None]])
    low, high = np.array(problem.coarse.grid.low), np.array(problem.coarse.grid.high)
    inside = np.all((points >= low) & (points <= high), axis=1)
    return _Ball(points[inside], -1.0 if saddles.values[index] < 0 else 1.0)


def _ball_constraints(field: BlendedField, stage: int, ball: _Ball, clearance: float) -> WeightConstraints | None:
    """Constraints that f has the ball's sign at its points; None if a point with the wrong sign does not depend on the weight."""
    constant, slope = evaluate_affine_form(field, stage, ball.points)
    weight = field.weights[stage]
    wrong = ball.sign * (constant + slope * weight(ball.points)) < clearance
    if np.any(wrong & (slope == 0)):
        return None
    has_slope = slope != 0
    return make_sign_constraints(ball.points[has_slope], constant[has_slope], slope[has_slope], ball.sign, clearance)
