"""minimum_neck: no solid and no void narrower than asked at the saddles of the field inside the blending regions.

The field is affine in each weight, so that a ball around a saddle lies in its phase is a set of demands on the weight: a neck too
narrow is widened so, or, if that contradicts what else is demanded, cut, the ball then being of the other phase. Topology comes
first: after each round errors are mended with the demands of the necks kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.blend.composition import BlendedField
from tpmscad.blend.demands import NONE, Demands, agreed
from tpmscad.blend.grid import Array, Ints, Mask
from tpmscad.blend.necks import DIRECTIONS, Neck, Saddles, saddles, sphere, widths
from tpmscad.blend.optimise import Free, State, Tool, look, repaired
from tpmscad.blend.pointwise import affine
from tpmscad.blend.scene import Scene
from tpmscad.blend.weight import Weight
from tpmscad.blend.weights_line import LineWeight

ROUNDS = 8
PASSES = 0.98
"""Part of the width asked for from which a neck is left as it is."""

AIM = 1.04
"""What is demanded, in parts of the width asked for: the saddle moves a little when its neck is widened."""

SHELLS = (0.5, 0.8, 1.0)
"""Radii of the balls, in parts of the greatest, at which the field is held to its phase."""

CLEARANCE = 1e-3
"""How far past zero f is held there, in parts of its rms in the blending regions."""


@dataclass(frozen=True, slots=True, eq=False)
class Thickened:
    """The best state, the rounds taken, and the necks that stayed narrower than asked."""

    state: State
    rounds: int
    missed: tuple[Neck, ...]


def thicken(
    scenes: Sequence[Scene], field: BlendedField, start: State, width: float, free: Free, max_rounds: int
) -> Thickened:
    """Weights whose blend has no neck under `width` (model units) inside its blending regions, as far as that can be had."""
    state, rounds = start, 0
    kept = [NONE] * len(start.weights)
    origin = [w.coefficients for w in start.weights]
    best: tuple[int, int, State, tuple[Neck, ...]] | None = None
    for _ in range(ROUNDS):
        found, wide, toward = measured(scenes[0], field.with_weights(state.weights), width)
        narrow = np.flatnonzero(wide < PASSES * width)
        result = (state.score[0] * 1000 + state.score[1], len(narrow), state, named(found, wide, narrow))
        if best is None or result[:2] < best[:2]:
            best = result
        if len(narrow) == 0 or rounds >= max_rounds:
            break
        weights, kept, origin, changed = _widened(
            scenes[0], field, state, found, toward, narrow, width, kept, origin, free
        )
        if not changed:
            break
        state = look(scenes, weights)
        rounds += 1
        if not state.clean:
            state, used = repaired(scenes, state, Tool(), max_rounds - rounds, kept)
            rounds += used
    assert best is not None
    return Thickened(best[2], rounds, best[3])


def measured(scene: Scene, field: BlendedField, width: float) -> tuple[Saddles, Array, Array]:
    """Saddles inside the blending regions that may be narrower than `width`, their widths and the nearest surface's direction."""
    where: Mask = scene.movable()
    found = saddles(field, scene.grid, where, 1.5 * width)
    inside = np.any([np.asarray(region(found.points)) <= 0 for region in field.blending], axis=0)
    found = Saddles(found.points[inside], found.values[inside])
    wide, toward = widths(field, found, scene.grid, 0.75 * width)
    return found, wide, toward


def named(found: Saddles, wide: Array, which: Ints) -> tuple[Neck, ...]:
    return tuple(
        Neck(tuple(found.points[k].tolist()), "solid" if found.values[k] < 0 else "void", float(wide[k])) for k in which
    )


def _widened(
    scene: Scene,
    field: BlendedField,
    state: State,
    found: Saddles,
    toward: Array,
    narrow: Ints,
    width: float,
    kept: list[Demands],
    origin: list[Array],
    free: Free,
) -> tuple[list[Weight], list[Demands], list[Array], bool]:
    weights, kept, origin = list(state.weights), list(kept), list(origin)
    changed = False
    movable = scene.movable()
    clear = CLEARANCE * float(np.sqrt(np.mean(scene.values(state.weights)[movable] ** 2)))
    for stage in range(len(weights)):
        balls = [_ball(field, scene, found.points[k], toward[k], AIM * width / 2) for k in narrow]
        keep = [-1.0 if found.values[k] < 0 else 1.0 for k in narrow]
        for attempt in ("widen", "freer", "cut"):
            if attempt == "freer":
                more = free(stage, weights[stage]) if isinstance(weights[stage], LineWeight) else None
                if more is None:
                    continue
                weights[stage], origin[stage] = more, more.coefficients
            sides = [-s if attempt == "cut" else s for s in keep]
            groups = [
                _held(field.with_weights(weights), stage, ball, s, clear) for ball, s in zip(balls, sides, strict=True)
            ]
            wanted = [k for k, group in enumerate(groups) if group is not None and len(group)]
            if not wanted:
                break
            some = [group for group in groups if group is not None and len(group)]
            kept[stage], coefficients, left_out = agreed(weights[stage], origin[stage], kept[stage], some)
            weights[stage] = weights[stage].moved(coefficients)
            changed |= len(left_out) < len(some)
            balls, keep = [balls[wanted[k]] for k in left_out], [keep[wanted[k]] for k in left_out]
            if not left_out:
                break
    return weights, kept, origin, changed


def _ball(field: BlendedField, scene: Scene, centre: Array, toward: Array, radius: float) -> Array:
    """Points on spheres around a saddle that are inside the domain: (m, 3)."""
    directions = np.concatenate([sphere(DIRECTIONS), toward[None], -toward[None]])
    points = np.concatenate([centre + share * radius * directions for share in SHELLS] + [centre[None]])
    inside = np.all((points >= np.array(scene.grid.low)) & (points <= np.array(scene.grid.high)), axis=1)
    return points[inside]


def _held(field: BlendedField, stage: int, points: Array, sign: float, clear: float) -> Demands | None:
    """Demands that f has the sign at the points; None if a point that has not is out of this weight's reach."""
    none, slope = affine(field, stage, points)
    weight = field.weights[stage]
    wrong = sign * (none + slope * weight(points)) < clear
    if np.any(wrong & (slope == 0)):
        return None
    used = slope != 0
    none, slope, points = none[used], slope[used], points[used]
    return Demands(points, (sign * clear - none) / slope, np.where(sign * slope > 0, 1.0, -1.0))
