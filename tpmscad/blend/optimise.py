"""The robust optimiser: mends what the census counts, on the working grid and on the grid of twice its samples.

Each round takes the coarsest grid that has errors, asks for the cheapest repairs, and moves every weight to the coefficients
nearest to its initial ones that meet all demands so far. Where that stalls the next tool is tried from the best state: a gradient
method on the persistence of the errors, weights with more freedom, demands forgotten and smaller margins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.blend.census import Census, census
from tpmscad.blend.composition import Weighting
from tpmscad.blend.demands import NONE, Demands, agreed
from tpmscad.blend.descent import descend
from tpmscad.blend.grid import Array, Ints
from tpmscad.blend.repair import Wanted, repair
from tpmscad.blend.scene import Scene
from tpmscad.blend.weight import Weight

MARGIN = 0.4
"""How far past zero a repair moves f, in units of the field's own rms in the blending region: at 0.15 one pair in six needed
three dimensions, at 0.4 one in nine."""

PREFER_JOINS, PREFER_REMOVALS = 1e3, 1e-3
"""What removals are taken to cost beside joins where mixing the two contradicts itself."""

DESCENT_STEPS = 15
"""Steps of a descent: those that got anywhere did within 10."""

PATIENCE = 2
"""Rounds without fewer errors before the next tool is tried."""

Free = Callable[[int, Weight], Weight | None]
"""A weight of the same values with more freedom for a stage's weight; None if there is none."""


@dataclass(frozen=True, slots=True)
class Tool:
    """One way of repairing: with freer weights than before or the same, by descent on the
    persistence of the errors or by repairs, how far past zero, joins or removals preferred."""

    freer: bool = False
    descent: bool = False
    margin: float = MARGIN
    bias: float = 1.0


TOOLS = (
    Tool(),
    Tool(bias=PREFER_JOINS),
    Tool(freer=True),
    Tool(bias=PREFER_JOINS),
    Tool(bias=PREFER_REMOVALS),
    Tool(descent=True),
    Tool(freer=True, margin=MARGIN / 2),
    Tool(margin=MARGIN / 4, bias=PREFER_JOINS),
    Tool(margin=MARGIN / 4, bias=PREFER_REMOVALS),
)
"""Tried in turn, each from the best state so far and with the demands of those before it forgotten."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A census of one grid, with the errors that are the blend's to mend (labels)."""

    level: int
    census: Census
    solid: Ints
    void: Ints

    @property
    def count(self) -> int:
        return len(self.solid) + len(self.void)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Weights and what is counted with them: the views of the grids up to the first with errors, coarse first."""

    weights: tuple[Weight, ...]
    views: tuple[View, ...]
    score: tuple[int, int]
    """Grids not yet clean, and the errors on the first of them: the less the better."""

    @property
    def clean(self) -> bool:
        return self.score[0] == 0

    @property
    def last(self) -> View:
        return self.views[-1]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """The best state reached, the rounds taken and a line on each tool that was needed."""

    state: State
    rounds: int
    log: tuple[str, ...]


def view(scene: Scene, level: int, weights: Sequence[Weighting]) -> View:
    counted = census(scene.values(weights))
    solid = np.setdiff1d(counted.solid.errors, scene.intrinsic(counted.solid, 1))
    void = np.setdiff1d(counted.void.errors, scene.intrinsic(counted.void, -1))
    return View(level, counted, solid, void)


def look(scenes: Sequence[Scene], weights: Sequence[Weight]) -> State:
    views = []
    for level, scene in enumerate(scenes):
        views.append(view(scene, level, weights))
        if views[-1].count:
            return State(tuple(weights), tuple(views), (len(scenes) - level, views[-1].count))
    return State(tuple(weights), tuple(views), (0, 0))


def all_views(scenes: Sequence[Scene], state: State) -> tuple[View, ...]:
    """The views of all grids, those behind the first with errors made now."""
    rest = [view(scene, level, state.weights) for level, scene in enumerate(scenes) if level >= len(state.views)]
    return (*state.views, *rest)


def optimise(scenes: Sequence[Scene], start: State, free: Free, max_rounds: int) -> Outcome:
    """Weights whose blend has no errors of its own on any of the grids, or the best that was reached."""
    best, rounds = start, 0
    log: list[str] = []
    for tool in TOOLS:
        if best.clean or rounds >= max_rounds:
            break
        begin = best
        if tool.freer:
            more = [free(k, weight) for k, weight in enumerate(best.weights)]
            if all(weight is None for weight in more):
                continue
            begin = look(scenes, [new or old for new, old in zip(more, best.weights, strict=True)])
            log.append(
                f"weights given more freedom after {rounds} rounds: {'; '.join(_shape(w) for w in begin.weights)}"
            )
        search = _descended if tool.descent else repaired
        found, used = search(scenes, begin, tool, max_rounds - rounds)
        rounds += used
        if found.score < best.score or tool.freer:
            best = found
    return Outcome(best, rounds, tuple(log))


def _shape(weight: Weight) -> str:
    return " x ".join(map(str, weight.coefficients.shape))


def _descended(scenes: Sequence[Scene], start: State, tool: Tool, max_rounds: int) -> tuple[State, int]:
    """Steps down the gradient on the grid that has errors: of a pair, whichever end can be moved is."""
    steps = min(DESCENT_STEPS, max_rounds)
    moved = descend(scenes[start.last.level], start.weights, steps, strict=False, convention="strict")
    return look(scenes, moved.weights), moved.steps


def repaired(
    scenes: Sequence[Scene], start: State, tool: Tool, max_rounds: int, demands: Sequence[Demands] = ()
) -> tuple[State, int]:
    """Rounds of repairs with all their demands kept, `demands` to begin with, until nothing is left or nothing gets better."""
    state = best = start
    origin = [weight.coefficients for weight in start.weights]
    memory = list(demands) or [NONE] * len(origin)
    idle = used = 0
    while not best.clean and idle < PATIENCE and used < max_rounds:
        weights, memory, changed = _mended(scenes[state.last.level], state, origin, memory, tool)
        used += 1
        if not changed:
            break
        state = look(scenes, weights)
        idle = 0 if state.score < best.score else idle + 1
        best = min(best, state, key=lambda s: s.score)
    return best, used


def _mended(
    scene: Scene, state: State, origin: list[Array], memory: list[Demands], tool: Tool
) -> tuple[list[Weight], list[Demands], bool]:
    """One round: the weights moved, the demands so far, and whether any repair could be had."""
    seen, weights, kept = state.last, list(state.weights), list(memory)
    values = scene.values(weights)
    changed = False
    for stage, weight in enumerate(state.weights):
        sampled = scene.sampled(weights, stage)
        acts = sampled.slope != 0
        if not acts.any():
            continue
        past = tool.margin * float(np.sqrt(np.mean(values[acts] ** 2)))
        groups = []
        for phase, errors, sign in ((seen.census.solid, seen.solid, 1), (seen.census.void, seen.void, -1)):
            if len(errors):
                wanted = Wanted(values, phase, errors, sign, past, kept[stage], tool.bias)
                groups += repair(sampled, weight, wanted).groups
        if groups:
            kept[stage], found, left_out = agreed(weight, origin[stage], kept[stage], groups)
            changed |= len(left_out) < len(groups)
            weights[stage] = weight.moved(found)
    return weights, kept, changed
