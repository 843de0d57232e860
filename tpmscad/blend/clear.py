"""Specks taken away: the weight is asked to give f the sign at them that it has around, and what else was demanded is kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad.blend.composition import BlendedField
from tpmscad.blend.demands import NONE, Demands, agreed
from tpmscad.blend.optimise import Free, State, Tool, look, repaired
from tpmscad.blend.pointwise import affine
from tpmscad.blend.scene import Scene
from tpmscad.blend.specks import NO_SPECKS, Specks, isolated, specks

ROUNDS = 8

QUICK = 400
"""Doubtful samples up to which specks are looked for unless told otherwise: a tenth of a second, and nine random pairs in ten."""

PAST = 0.05
"""How far past zero f is moved, in parts of its rms in the blending regions, or half of the way within reach."""


def seen_specks(scene: Scene, field: BlendedField, state: State, most: int | None = None) -> Specks | None:
    """The specks of a state, those left aside that a structure has by itself: they are the inputs' own. None: not looked for."""
    found = specks(scene, field.with_weights(state.weights), scene.values(state.weights), most)
    if found is None:
        return None
    theirs = [
        any(-sign * f(point) > 0 and isolated(f, scene.grid, point, sign) for f in field.structures)
        for point, sign in zip(found.points, -np.sign(found.values), strict=True)
    ]
    own = ~np.array(theirs, bool)
    return Specks(found.points[own], found.values[own])


def cleared(
    scenes: Sequence[Scene], field: BlendedField, start: State, free: Free, most: int | None
) -> tuple[State, int, Specks | None]:
    """A clean state with as few specks as some rounds reach, the rounds taken, and the specks that are left (None: see above)."""
    best, least, rounds = start, seen_specks(scenes[-1], field, start, most), 0
    for freed in (False, True):
        begin = best
        if least is None or len(least) == 0:
            break
        if freed:
            more = [free(k, weight) for k, weight in enumerate(best.weights)]
            begin = look(scenes, [new or old for new, old in zip(more, best.weights, strict=True)])
        state, found, kept = begin, least, [NONE] * len(best.weights)
        while len(found) and rounds < ROUNDS * (1 + freed):
            state, kept, used = _round(scenes, field, state, found, kept)
            rounds += used
            if not state.clean:
                break
            found = seen_specks(scenes[-1], field, state) or NO_SPECKS
            if len(found) < len(least):
                best, least = state, found
    return best, rounds, least


def _round(
    scenes: Sequence[Scene], field: BlendedField, state: State, found: Specks, kept: list[Demands]
) -> tuple[State, list[Demands], int]:
    """The specks turned and the errors that this makes mended: the state, all that is demanded, the rounds taken."""
    weights, kept = list(state.weights), list(kept)
    for stage, weight in enumerate(weights):
        groups = _turned(field.with_weights(weights), stage, found, scenes[-1])
        kept[stage], coefficients, _ = agreed(weight, weight.coefficients, kept[stage], groups)
        weights[stage] = weight.moved(coefficients)
    state = look(scenes, weights)
    if state.clean:
        return state, kept, 1
    state, used = repaired(scenes, state, Tool(), ROUNDS, kept)
    return state, kept, 1 + used


def _turned(field: BlendedField, stage: int, found: Specks, scene: Scene) -> list[Demands]:
    """Of each speck that the weight of the stage can turn the demand to do so."""
    movable = scene.movable()
    unit = float(np.sqrt(np.mean(scene.values(field.weights)[movable] ** 2)))
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
