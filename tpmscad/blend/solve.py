"""blend: porous structures joined in regions the user draws, without isolated components or isolated holes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tpmscad.blend.checks import check_counts, check_regions, check_sampling
from tpmscad.blend.clear import QUICK, cleared, seen_specks
from tpmscad.blend.composition import BlendedField
from tpmscad.blend.descent import descend
from tpmscad.blend.domain import domain_of
from tpmscad.blend.dropped import left_out
from tpmscad.blend.earlier import EARLIER, earlier_weight
from tpmscad.blend.firm import firmed
from tpmscad.blend.fraction import fraction_error, fraction_shift, way_of
from tpmscad.blend.grid import Box, Field, Grid
from tpmscad.blend.initial import Spec, initial_weight, zones
from tpmscad.blend.necks import Neck
from tpmscad.blend.optimise import Free, Outcome, State, all_views, look, optimise, view
from tpmscad.blend.promote import freer
from tpmscad.blend.resolution import automatic_resolution
from tpmscad.blend.result import BlendResult, result_of
from tpmscad.blend.scene import Scene, scene
from tpmscad.blend.thicken import thicken
from tpmscad.blend.weight import Weight
from tpmscad.errors import InvalidRequest
from tpmscad.fields import as_field

METHODS = ("topological", "paper", "initial", *EARLIER)
"""By name: the robust optimiser; the blending paper's as printed; initial weights as they are; the earlier methods."""

Progress = Callable[[str, float], None]
"""Called with a stage's name and the part of the whole that is done, 0 to 1."""


def blend(
    structures: Sequence[Field],
    regions: Sequence[Field],
    blending_regions: Sequence[Field],
    *,
    method: str = "topological",
    weight: Spec | Sequence[Spec] = "auto",
    resolution: tuple[int, int, int] | None = None,
    domain: Box | None = None,
    max_iterations: int = 60,
    minimum_neck: float | None = None,
    max_change: float = 1.0,
    keep_fraction: bool = False,
    level_margin: float = 0.0,
    drop_intrinsic: bool = False,
    specks: bool | None = None,
    progress: Progress | None = None,
) -> BlendResult:
    """Structures joined in the blending regions; outside of these each keeps its values to the last bit.

    structures: fields (f < 0 solid); regions: one each, as fields (<= 0 inside), not overlapping; blending_regions: number k
    joins structure k + 1 to those before it (Algorithm 3). method: one of METHODS. weight: "auto", "x", "y", "z", "volume", a
    Line or a Volume, one for all or one for each blending region. resolution: samples along x, y, z of the domain, chosen from
    the structures if None; errors are counted there and at twice as many. domain: the box of the regions if None. minimum_neck:
    the width, in model units, under which no solid and no void is to be at a saddle inside a blending region; `necks` of the
    result has those for which that could not be had. max_change: how far any weight may move from its initial value, of 1.
    keep_fraction: add to the field, inside the blending regions, what keeps the solid fraction between those of the structures.
    level_margin: part of the field's rms (0.06, say) by which a change of level is to make no isolated parts either, as far as a
    few rounds reach. drop_intrinsic: leave out of the field the isolated components, and fill the holes, that the structures
    bring with them (chips at the skin of a model); only within a few samples of these the field then differs from theirs.
    specks: look between the samples for isolated parts that none of them sees, and mend these, too; None: where few samples are
    so near to a change of sign that it is quick.
    Raises InvalidRequest for input that can't be blended; what could not be mended is told by the result, whose `converged` is
    then False.
    """
    clock = _Clock(progress)
    check_counts(len(structures), len(regions), len(blending_regions))
    if method not in METHODS:
        raise InvalidRequest(f"method {method!r}: must be one of {', '.join(METHODS)}")
    if not 0 < max_change <= 1:
        raise InvalidRequest(f"max_change {max_change:g}: must be above 0 and at most 1, the whole range of a weight")
    if minimum_neck is not None and not 0 < minimum_neck < np.inf:
        raise InvalidRequest(f"minimum_neck {minimum_neck:g}: must be a width above zero, in model units")
    specs = _specs(weight, len(blending_regions))
    parts = [tuple(map(as_field, given)) for given in (structures, regions, blending_regions)]
    low, high = domain_of(parts[1], domain)
    field = BlendedField(parts[0], parts[1], parts[2], (), domain=(low, high))
    grid = Grid(low, high, resolution or automatic_resolution(field.structures, (low, high)))
    check_regions(field, grid)
    scenes = (scene(field, grid), scene(field, grid.twice()))
    check_sampling(field, *scenes)
    clock.lap("sampling")
    if method in EARLIER:
        earlier = [earlier_weight(method, spec, field, scenes, stage) for stage, spec in enumerate(specs)]
        clock.lap("weights")
        views = [view(s, k, earlier) for k, s in enumerate(scenes)]
        clock.lap("check")
        blended = field.with_weights(earlier)
        result = result_of(blended, method, scenes, views, views, 0, (), clock.seconds)
        return left_out(result, blended, views[-1], [s.grid for s in scenes]) if drop_intrinsic else result
    made = _started(specs, field, scenes, max_change)
    if keep_fraction:
        shifts = [fraction_shift(scenes[0], made, stage) for stage in range(len(made))]
        field, scenes = field.with_shifts(shifts), (scenes[0].with_shifts(shifts), scenes[1].with_shifts(shifts))
    start = look(scenes, made)
    clock.lap("weights")
    outcome = _optimised(method, scenes, start, max_iterations)
    clock.lap("optimisation")
    if level_margin > 0 and outcome.state.clean:
        state, rounds = firmed(scenes, outcome.state, level_margin)
        outcome = replace(outcome, state=state, rounds=outcome.rounds + rounds)
    left, most = None, QUICK if specks is None else None
    if method == "topological" and outcome.state.clean and specks is not False:
        state, rounds, left = cleared(scenes, field, outcome.state, _free(scenes), most)
        outcome = replace(outcome, state=state, rounds=outcome.rounds + rounds)
        clock.lap("specks")
    missed: tuple[Neck, ...] = ()
    if minimum_neck is not None:
        outcome, missed = _thickened(field, scenes, outcome, minimum_neck, max_iterations)
        clock.lap("necks")
    if keep_fraction:
        outcome = replace(outcome, log=(*outcome.log, *_fractions(scenes[0], made, outcome.state.weights)))
    before, after = all_views(scenes, start), all_views(scenes, outcome.state)
    clock.lap("check")
    blended = field.with_weights(outcome.state.weights)
    if specks is not False and (method != "topological" or minimum_neck is not None):
        left = seen_specks(scenes[-1], field, outcome.state, most) if outcome.state.clean else None
    hidden = None if left is None else len(left)
    result = result_of(
        blended, method, scenes, before, after, outcome.rounds, outcome.log, clock.seconds, missed, hidden
    )
    return left_out(result, blended, after[-1], [s.grid for s in scenes]) if drop_intrinsic else result


def _fractions(seen: Scene, start: Sequence[Weight], weights: Sequence[Weight]) -> list[str]:
    told = []
    for stage, first in enumerate(start):
        bare = fraction_error(seen.with_shifts([None] * len(start)), start, way_of(first), stage)
        kept = fraction_error(seen, weights, way_of(first), stage)
        told.append(f"solid fraction {kept:.3f} from the interpolated one in the mean, {bare:.3f} without the shift")
    return told


def _specs(weight: Spec | Sequence[Spec], stages: int) -> list[Spec]:
    one_for_all = isinstance(weight, str) or not isinstance(weight, Sequence)
    specs: list[Spec] = [weight] * stages if one_for_all else list(weight)  # type: ignore[list-item, arg-type]
    if len(specs) != stages:
        raise InvalidRequest(f"{len(specs)} weights for {stages} blending regions: give one each, or one for all")
    return specs


def _started(specs: list[Spec], field: BlendedField, scenes: Sequence[Scene], max_change: float) -> list[Weight]:
    made: list[Weight] = []
    for stage, spec in enumerate(specs):
        weight = initial_weight(spec, field, scenes, stage)
        low, high = np.maximum(weight.coefficients - max_change, 0.0), np.minimum(weight.coefficients + max_change, 1.0)
        made.append(replace(weight, low=low, high=high))
    return made


def _free(scenes: tuple[Scene, Scene]) -> Free:
    return lambda stage, weight: freer(weight, zones(scenes[0], stage), zones(scenes[1], stage))


def _thickened(
    field: BlendedField, scenes: tuple[Scene, Scene], outcome: Outcome, width: float, max_rounds: int
) -> tuple[Outcome, tuple[Neck, ...]]:
    done = thicken(scenes, field, outcome.state, width, _free(scenes), max_rounds)
    log = outcome.log
    if done.missed:
        least = min(neck.width for neck in done.missed)
        log = (*log, f"{len(done.missed)} necks stay narrower than {width:g}, the narrowest {least:.3g}")
    return Outcome(done.state, outcome.rounds + done.rounds, log), done.missed


def _optimised(method: str, scenes: tuple[Scene, Scene], start: State, max_iterations: int) -> Outcome:
    if method == "initial":
        return Outcome(start, 0, ())
    if method == "paper":
        found = descend(scenes[0], start.weights, max_iterations, strict=True)
        last = found.last
        log = (
            f"objective {last.value:.3g} after {found.steps} steps, {last.active} pairs active, {last.ignored} ignored"
        )
        return Outcome(look(scenes, found.weights), found.steps, (log,))
    return optimise(scenes, start, _free(scenes), max_iterations)


class _Clock:
    """CPU seconds of each stage, and the caller's progress."""

    def __init__(self, progress: Progress | None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress
        self._last = time.process_time()

    def lap(self, name: str) -> None:
        now = time.process_time()
        self.seconds[name] = now - self._last
        self._last = now
        if self._progress is not None:
            self._progress(name, min(1.0, len(self.seconds) / 4))
