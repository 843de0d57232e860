"""minimum_neck: no solid and no void narrower than asked at the saddles of the field inside the blending regions.

The field is affine in each weight, so that a ball around a saddle lies in its phase is a set of demands on the weight: a neck too
narrow is widened so, or, if that contradicts what else is demanded, cut, the ball then being of the other phase. Topology comes
first: after each round errors are mended with the demands of the necks kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.composition.affine_form import evaluate_affine_form
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.optimiser import BlendState, Strategy, WeightRefiner, evaluate_weights, repair_defects
from tpmscad.blending.weights.constraints import NO_CONSTRAINTS, WeightConstraints, add_consistent_constraints
from tpmscad.blending.weights.line_weight import LineWeight
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.fields.saddles import RAY_DIRECTIONS, Neck, Saddles, find_saddles, measure_neck_widths, spread_directions

MAX_WIDENING_ROUNDS = 8
ACCEPTED_WIDTH_FRACTION = 0.98
"""Part of the width asked for from which a neck is left as it is."""

TARGET_WIDTH_FRACTION = 1.04
"""What is demanded, in parts of the width asked for: the saddle moves a little when its neck is widened."""

BALL_RADIUS_FRACTIONS = (0.5, 0.8, 1.0)
"""Radii of the balls, in parts of the greatest, at which the field is held to its phase."""

BALL_CLEARANCE_RMS = 1e-3
"""How far past zero f is held there, in parts of its rms in the blending regions."""


@dataclass(frozen=True, slots=True, eq=False)
class NeckWidening:
    """The best state, the rounds taken, and the necks that stayed narrower than asked."""

    state: BlendState
    rounds: int
    missed: tuple[Neck, ...]


def widen_necks(
    scenes: Sequence[SampledComposition],
    field: BlendedField,
    start: BlendState,
    width: float,
    free: WeightRefiner,
    max_rounds: int,
) -> NeckWidening:
    """Weights whose blend has no neck under `width` (model units) inside its blending regions, as far as that can be had."""
    state, rounds = start, 0
    kept = [NO_CONSTRAINTS] * len(start.weights)
    origin = [w.coefficients for w in start.weights]
    best: tuple[int, int, BlendState, tuple[Neck, ...]] | None = None
    for _ in range(MAX_WIDENING_ROUNDS):
        found, wide, toward = measure_necks(scenes[0], field.with_weights(state.weights), width)
        narrow = np.flatnonzero(wide < ACCEPTED_WIDTH_FRACTION * width)
        result = (state.score[0] * 1000 + state.score[1], len(narrow), state, make_necks(found, wide, narrow))
        if best is None or result[:2] < best[:2]:
            best = result
        if len(narrow) == 0 or rounds >= max_rounds:
            break
        weights, kept, origin, changed = _run_widening_round(
            scenes[0], field, state, found, toward, narrow, width, kept, origin, free
        )
        if not changed:
            break
        state = evaluate_weights(scenes, weights)
        rounds += 1
        if not state.is_clean:
            state, used = repair_defects(scenes, state, Strategy(), max_rounds - rounds, kept)
            rounds += used
    assert best is not None
    return NeckWidening(best[2], rounds, best[3])


def measure_necks(scene: SampledComposition, field: BlendedField, width: float) -> tuple[Saddles, Array, Array]:
    """Saddles inside the blending regions that may be narrower than `width`, their widths and the nearest surface's direction."""
    where: BoolArray = scene.movable()
    found = find_saddles(field, scene.grid, where, 1.5 * width)
    inside = np.any([np.asarray(region(found.points)) <= 0 for region in field.blending], axis=0)
    found = Saddles(found.points[inside], found.values[inside])
    wide, toward = measure_neck_widths(field, found, scene.grid, 0.75 * width)
    return found, wide, toward


def make_necks(found: Saddles, wide: Array, which: IntArray) -> tuple[Neck, ...]:
    return tuple(
        Neck(tuple(found.points[k].tolist()), "solid" if found.values[k] < 0 else "void", float(wide[k])) for k in which
    )


def _run_widening_round(
    scene: SampledComposition,
    field: BlendedField,
    state: BlendState,
    found: Saddles,
    toward: Array,
    narrow: IntArray,
    width: float,
    kept: list[WeightConstraints],
    origin: list[Array],
    free: WeightRefiner,
) -> tuple[list[SplineWeight], list[WeightConstraints], list[Array], bool]:
    weights, kept, origin = list(state.weights), list(kept), list(origin)
    changed = False
    movable = scene.movable()
    clear = BALL_CLEARANCE_RMS * float(np.sqrt(np.mean(scene.values(state.weights)[movable] ** 2)))
    for stage in range(len(weights)):
        balls = [
            _sample_ball(field, scene, found.points[k], toward[k], TARGET_WIDTH_FRACTION * width / 2) for k in narrow
        ]
        keep = [-1.0 if found.values[k] < 0 else 1.0 for k in narrow]
        for attempt in ("widen", "freer", "cut"):
            if attempt == "freer":
                more = free(stage, weights[stage]) if isinstance(weights[stage], LineWeight) else None
                if more is None:
                    continue
                weights[stage], origin[stage] = more, more.coefficients
            sides = [-s if attempt == "cut" else s for s in keep]
            groups = [
                _ball_constraints(field.with_weights(weights), stage, ball, s, clear)
                for ball, s in zip(balls, sides, strict=True)
            ]
            wanted = [k for k, group in enumerate(groups) if group is not None and len(group)]
            if not wanted:
                break
            some = [group for group in groups if group is not None and len(group)]
            kept[stage], coefficients, left_out = add_consistent_constraints(
                weights[stage], origin[stage], kept[stage], some
            )
            weights[stage] = weights[stage].moved(coefficients)
            changed |= len(left_out) < len(some)
            balls, keep = [balls[wanted[k]] for k in left_out], [keep[wanted[k]] for k in left_out]
            if not left_out:
                break
    return weights, kept, origin, changed


def _sample_ball(field: BlendedField, scene: SampledComposition, centre: Array, toward: Array, radius: float) -> Array:
    """Points on spheres around a saddle that are inside the domain: (m, 3)."""
    directions = np.concatenate([spread_directions(RAY_DIRECTIONS), toward[None], -toward[None]])
    points = np.concatenate([centre + share * radius * directions for share in BALL_RADIUS_FRACTIONS] + [centre[None]])
    inside = np.all((points >= np.array(scene.grid.low)) & (points <= np.array(scene.grid.high)), axis=1)
    return points[inside]


def _ball_constraints(
    field: BlendedField, stage: int, points: Array, sign: float, clear: float
) -> WeightConstraints | None:
    """Demands that f has the sign at the points; None if a point that has not is out of this weight's reach."""
    none, slope = evaluate_affine_form(field, stage, points)
    weight = field.weights[stage]
    wrong = sign * (none + slope * weight(points)) < clear
    if np.any(wrong & (slope == 0)):
        return None
    used = slope != 0
    none, slope, points = none[used], slope[used], points[used]
    return WeightConstraints(points, (sign * clear - none) / slope, np.where(sign * slope > 0, 1.0, -1.0))
