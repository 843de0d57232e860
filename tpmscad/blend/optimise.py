"""The robust optimiser: mends what the census counts, on the working grid and on the grid of twice its samples.

Each round takes the coarsest grid that has errors, asks for the cheapest repairs, and moves every weight to the coefficients
nearest to its initial ones that meet all demands so far. When that stalls, the next tool is tried: a gradient method on the
persistence of the errors, then weights with three dimensions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.blend.census import Census, census
from tpmscad.blend.demands import NONE, Demands, agreed
from tpmscad.blend.grid import Array, Ints
from tpmscad.blend.repair import repair
from tpmscad.blend.sampled import tightened
from tpmscad.blend.scene import Scene
from tpmscad.blend.weight import Weight

MARGIN = 0.15
"""How far past zero a repair moves f, in units of the field's own rms in the blending region."""

PATIENCE = 3
"""Rounds without fewer errors before the next tool is tried."""

Promote = Callable[[int, Weight], Weight]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Weights, what is left on each grid (coarse first), the rounds taken and a line on each tool used."""

    weights: tuple[Weight, ...]
    left: tuple[tuple[int, int], ...]
    rounds: int
    log: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A census of one grid with the errors that are the blend's to mend."""

    level: int
    values: Array
    census: Census
    solid: Ints
    void: Ints

    @property
    def count(self) -> int:
        return len(self.solid) + len(self.void)


def view(scene: Scene, level: int, weights: Sequence[Weight]) -> View:
    values = scene.values(weights)
    counted = census(values)
    solid = np.setdiff1d(counted.solid.errors, scene.intrinsic(counted.solid, 1))
    void = np.setdiff1d(counted.void.errors, scene.intrinsic(counted.void, -1))
    return View(level, values, counted, solid, void)


def score(scenes: Sequence[Scene], weights: Sequence[Weight]) -> tuple[tuple[int, int, int], View | None]:
    """(level of the coarsest grid with errors, negative if none; errors there), and its view."""
    for level, scene in enumerate(scenes):
        seen = view(scene, level, weights)
        if seen.count:
            return (len(scenes) - level, seen.count, 0), seen
    return (0, 0, 0), None


def optimise(scenes: Sequence[Scene], weights: Sequence[Weight], promote: Promote, max_rounds: int) -> Outcome:
    """Weights whose blend has no errors of its own on any of the grids, or the best that was reached."""
    state = list(weights)
    log: list[str] = []
    rounds = 0
    best_score, seen = score(scenes, state)
    best = list(state)
    for tool in ("path", "volume", "path"):
        if seen is None or rounds >= max_rounds:
            break
        if tool == "volume":
            state = [promote(k, weight) for k, weight in enumerate(best)]
            log.append(f"weights given three dimensions after {rounds} rounds")
        found, used = _paths(scenes, state, max_rounds - rounds)
        rounds += used
        result, left = score(scenes, found)
        if result < best_score:
            best, best_score, seen = found, result, left
        state = list(best)
    left_over = tuple((len(v.solid), len(v.void)) for v in (view(s, k, best) for k, s in enumerate(scenes)))
    return Outcome(tuple(best), left_over, rounds, tuple(log))


def _paths(scenes: Sequence[Scene], weights: Sequence[Weight], max_rounds: int) -> tuple[list[Weight], int]:
    """Rounds of repairs with all their demands kept, until nothing is left or nothing gets better."""
    state, origin = list(weights), [weight.coefficients for weight in weights]
    memory: list[Demands] = [NONE] * len(state)
    best, best_score, idle = list(state), None, 0
    for used in range(max_rounds + 1):
        result, seen = score(scenes, state)
        if best_score is None or result < best_score:
            best, best_score, idle = list(state), result, 0
        else:
            idle += 1
        if seen is None or idle > PATIENCE or used == max_rounds:
            break
        if not _mend(scenes[seen.level], seen, state, origin, memory):
            break
    return best, used


def _mend(scene: Scene, seen: View, state: list[Weight], origin: list[Array], memory: list[Demands]) -> bool:
    """One round, changing state and memory in place; False if no repair could be had."""
    changed = False
    for stage in range(len(state)):
        sampled = scene.sampled(state, stage)
        if not np.any(sampled.slope):
            continue
        scale = MARGIN * float(np.sqrt(np.mean(seen.values[sampled.slope != 0] ** 2)))
        weight = state[stage]
        reach = tightened(sampled.reach(weight), sampled, weight, memory[stage])
        groups = []
        for phase, errors, sign in ((seen.census.solid, seen.solid, 1), (seen.census.void, seen.void, -1)):
            if len(errors):
                groups += repair(sampled, weight, seen.values, phase, errors, sign, scale, reach).groups
        if not groups:
            continue
        memory[stage], found, left_out = agreed(weight, origin[stage], memory[stage], groups)
        changed |= len(left_out) < len(groups)
        state[stage] = weight.moved(found)
    return changed
