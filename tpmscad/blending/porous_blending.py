"""blend: porous structures joined in regions the user draws, without isolated components or isolated holes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tpmscad._typing import Progress
from tpmscad.blending.baseline_weights import BASELINE_METHODS, make_baseline_weight
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.sampled_composition import SampledComposition, sample_composition
from tpmscad.blending.initial_weights import WeightSpec, classify_samples, make_initial_weight
from tpmscad.blending.input_defects import remove_input_defects
from tpmscad.blending.optimise.gradient_descent import descend
from tpmscad.blending.optimise.level_margin import enforce_level_margin
from tpmscad.blending.optimise.neck_width import widen_necks
from tpmscad.blending.optimise.optimiser import (
    BlendState,
    OptimisationOutcome,
    WeightRefiner,
    evaluate_all_grids,
    evaluate_weights,
    find_grid_defects,
    optimise,
)
from tpmscad.blending.optimise.subgrid_defects import (
    MAX_QUICK_CANDIDATES,
    find_blend_subgrid_defects,
    remove_subgrid_defects,
)
from tpmscad.blending.result import BlendResult, assemble_result
from tpmscad.blending.sampling_domain import choose_resolution, resolve_domain
from tpmscad.blending.validation import check_counts, check_regions, check_sampling
from tpmscad.blending.volume_fraction_control import fit_level_shift, measure_fraction_error, transition_coordinate
from tpmscad.blending.weights.volume_weight_fit import refine_weight
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.errors import InvalidRequest
from tpmscad.fields import as_field
from tpmscad.fields.saddles import Neck
from tpmscad.fields.sample_grid import BoxBounds, FieldFunction, SampleGrid

METHODS = ("topological", "paper", "initial", *BASELINE_METHODS)
"""By name: the robust optimiser; the blending paper's as printed; initial weights as they are; the earlier methods."""


def blend(
    structures: Sequence[FieldFunction],
    regions: Sequence[FieldFunction],
    blending_regions: Sequence[FieldFunction],
    *,
    method: str = "topological",
    weight: WeightSpec | Sequence[WeightSpec] = "auto",
    resolution: tuple[int, int, int] | None = None,
    domain: BoxBounds | None = None,
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
    clock = _StageClock(progress)
    check_counts(len(structures), len(regions), len(blending_regions))
    if method not in METHODS:
        raise InvalidRequest(f"method {method!r}: must be one of {', '.join(METHODS)}")
    if not 0 < max_change <= 1:
        raise InvalidRequest(f"max_change {max_change:g}: must be above 0 and at most 1, the whole range of a weight")
    if minimum_neck is not None and not 0 < minimum_neck < np.inf:
        raise InvalidRequest(f"minimum_neck {minimum_neck:g}: must be a width above zero, in model units")
    specs = _expand_weight_specs(weight, len(blending_regions))
    parts = [tuple(map(as_field, given)) for given in (structures, regions, blending_regions)]
    low, high = resolve_domain(parts[1], domain)
    field = BlendedField(parts[0], parts[1], parts[2], (), domain=(low, high))
    grid = SampleGrid(low, high, resolution or choose_resolution(field.structures, (low, high)))
    check_regions(field, grid)
    scenes = (sample_composition(field, grid), sample_composition(field, grid.double_samples()))
    check_sampling(field, *scenes)
    clock.lap("sampling")
    if method in BASELINE_METHODS:
        earlier = [make_baseline_weight(method, spec, field, scenes, stage) for stage, spec in enumerate(specs)]
        clock.lap("weights")
        views = [find_grid_defects(s, k, earlier) for k, s in enumerate(scenes)]
        clock.lap("check")
        blended = field.with_weights(earlier)
        result = assemble_result(blended, method, scenes, views, views, 0, (), clock.seconds)
        return remove_input_defects(result, blended, views[-1], [s.grid for s in scenes]) if drop_intrinsic else result
    made = _make_start_weights(specs, field, scenes, max_change)
    if keep_fraction:
        shifts = [fit_level_shift(scenes[0], made, stage) for stage in range(len(made))]
        field, scenes = field.with_shifts(shifts), (scenes[0].with_shifts(shifts), scenes[1].with_shifts(shifts))
    start = evaluate_weights(scenes, made)
    clock.lap("weights")
    outcome = _run_optimiser(method, scenes, start, max_iterations)
    clock.lap("optimisation")
    if level_margin > 0 and outcome.state.is_clean:
        state, rounds = enforce_level_margin(scenes, outcome.state, level_margin)
        outcome = replace(outcome, state=state, rounds=outcome.rounds + rounds)
    left, most = None, MAX_QUICK_CANDIDATES if specks is None else None
    if method == "topological" and outcome.state.is_clean and specks is not False:
        state, rounds, left = remove_subgrid_defects(scenes, field, outcome.state, _make_refiner(scenes), most)
        outcome = replace(outcome, state=state, rounds=outcome.rounds + rounds)
        clock.lap("specks")
    missed: tuple[Neck, ...] = ()
    if minimum_neck is not None:
        outcome, missed = _widen_necks_of_outcome(field, scenes, outcome, minimum_neck, max_iterations)
        clock.lap("necks")
    if keep_fraction:
        outcome = replace(outcome, log=(*outcome.log, *_report_fractions(scenes[0], made, outcome.state.weights)))
    before, after = evaluate_all_grids(scenes, start), evaluate_all_grids(scenes, outcome.state)
    clock.lap("check")
    blended = field.with_weights(outcome.state.weights)
    if specks is not False and (method != "topological" or minimum_neck is not None):
        left = find_blend_subgrid_defects(scenes[-1], field, outcome.state, most) if outcome.state.is_clean else None
    hidden = None if left is None else len(left)
    result = assemble_result(
        blended, method, scenes, before, after, outcome.rounds, outcome.log, clock.seconds, missed, hidden
    )
    return remove_input_defects(result, blended, after[-1], [s.grid for s in scenes]) if drop_intrinsic else result


def _report_fractions(
    seen: SampledComposition, start: Sequence[SplineWeight], weights: Sequence[SplineWeight]
) -> list[str]:
    told = []
    for stage, first in enumerate(start):
        bare = measure_fraction_error(seen.with_shifts([None] * len(start)), start, transition_coordinate(first), stage)
        kept = measure_fraction_error(seen, weights, transition_coordinate(first), stage)
        told.append(f"solid fraction {kept:.3f} from the interpolated one in the mean, {bare:.3f} without the shift")
    return told


def _expand_weight_specs(weight: WeightSpec | Sequence[WeightSpec], stages: int) -> list[WeightSpec]:
    one_for_all = isinstance(weight, str) or not isinstance(weight, Sequence)
    specs: list[WeightSpec] = [weight] * stages if one_for_all else list(weight)  # type: ignore[list-item, arg-type]
    if len(specs) != stages:
        raise InvalidRequest(f"{len(specs)} weights for {stages} blending regions: give one each, or one for all")
    return specs


def _make_start_weights(
    specs: list[WeightSpec], field: BlendedField, scenes: Sequence[SampledComposition], max_change: float
) -> list[SplineWeight]:
    made: list[SplineWeight] = []
    for stage, spec in enumerate(specs):
        weight = make_initial_weight(spec, field, scenes, stage)
        low, high = np.maximum(weight.coefficients - max_change, 0.0), np.minimum(weight.coefficients + max_change, 1.0)
        made.append(replace(weight, low=low, high=high))
    return made


def _make_refiner(scenes: tuple[SampledComposition, SampledComposition]) -> WeightRefiner:
    return lambda stage, weight: refine_weight(
        weight, classify_samples(scenes[0], stage), classify_samples(scenes[1], stage)
    )


def _widen_necks_of_outcome(
    field: BlendedField,
    scenes: tuple[SampledComposition, SampledComposition],
    outcome: OptimisationOutcome,
    width: float,
    max_rounds: int,
) -> tuple[OptimisationOutcome, tuple[Neck, ...]]:
    done = widen_necks(scenes, field, outcome.state, width, _make_refiner(scenes), max_rounds)
    log = outcome.log
    if done.missed:
        least = min(neck.width for neck in done.missed)
        log = (*log, f"{len(done.missed)} necks stay narrower than {width:g}, the narrowest {least:.3g}")
    return OptimisationOutcome(done.state, outcome.rounds + done.rounds, log), done.missed


def _run_optimiser(
    method: str, scenes: tuple[SampledComposition, SampledComposition], start: BlendState, max_iterations: int
) -> OptimisationOutcome:
    if method == "initial":
        return OptimisationOutcome(start, 0, ())
    if method == "paper":
        found = descend(scenes[0], start.weights, max_iterations, strict=True)
        last = found.last
        log = (
            f"objective {last.value:.3g} after {found.steps} steps, {last.active} pairs active, {last.ignored} ignored"
        )
        return OptimisationOutcome(evaluate_weights(scenes, found.weights), found.steps, (log,))
    return optimise(scenes, start, _make_refiner(scenes), max_iterations)


class _StageClock:
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
