"""Specks taken away: the weight is asked to give f the sign at them that it has around, and what else was demanded is kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad.blend.composition import BlendedField
from tpmscad.blend.demands import NONE, Demands, agreed
from tpmscad.blend.optimise import State, Tool, look, repaired
from tpmscad.blend.pointwise import affine
from tpmscad.blend.scene import Scene
from tpmscad.blend.specks import Specks, specks

ROUNDS = 6
PAST = 0.05
"""How far past zero f is moved, in parts of its rms in the blending regions, or half of the way within reach."""


def seen_specks(scene: Scene, field: BlendedField, state: State) -> Specks:
    """The specks of a state that some weight could take away: the others are the inputs' own."""
    blended = field.with_weights(state.weights)
    found = specks(scene, blended, scene.values(state.weights))
    if len(found) == 0:
        return found
    signs = -np.sign(found.values)
    best = np.full(len(found), -np.inf)
    for stage in range(len(state.weights)):
        none, slope = affine(blended, stage, found.points)
        best = np.maximum(best, signs * none + np.maximum(signs * slope, 0.0))
    return Specks(found.points[best > 0], found.values[best > 0])


def cleared(scenes: Sequence[Scene], field: BlendedField, start: State) -> tuple[State, int, Specks]:
    """A clean state with as few specks as some rounds reach, the rounds taken, and the specks that are left."""
    best, rounds = start, 0
    least = seen_specks(scenes[-1], field, best)
    state, found = best, least
    kept = [NONE] * len(best.weights)
    while len(found) and rounds < ROUNDS:
        weights = list(state.weights)
        for stage, weight in enumerate(weights):
            groups = _turned(field.with_weights(weights), stage, found, scenes[-1])
            kept[stage], coefficients, _ = agreed(weight, weight.coefficients, kept[stage], groups)
            weights[stage] = weight.moved(coefficients)
        state = look(scenes, weights)
        rounds += 1
        if not state.clean:
            state, used = repaired(scenes, state, Tool(), ROUNDS, kept)
            rounds += used
        if not state.clean:
            break
        found = seen_specks(scenes[-1], field, state)
        if len(found) < len(least):
            best, least = state, found
    return best, rounds, least


def _turned(field: BlendedField, stage: int, found: Specks, scene: Scene) -> list[Demands]:
    """Of each speck that the weight of the stage can turn the demand to do so."""
    movable = scene.movable()
    unit = float(np.sqrt(np.mean(scene.values(field.weights)[movable] ** 2)))  # type: ignore[arg-type]
    none, slope = affine(field, stage, found.points)
    signs = -np.sign(found.values)
    farthest = signs * none + np.maximum(signs * slope, 0.0)
    reachable = (slope != 0) & (farthest > 0)
    past = np.minimum(PAST * unit, 0.5 * farthest)
    return [
        Demands(
            found.points[k : k + 1],
            np.array([(signs[k] * past[k] - none[k]) / slope[k]]),
            np.array([1.0 if signs[k] * slope[k] > 0 else -1.0]),
        )
        for k in np.flatnonzero(reachable)
    ]
