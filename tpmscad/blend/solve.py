"""blend: porous structures joined in regions the user draws, without isolated components or isolated holes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from tpmscad.blend.checks import check_counts, check_regions, check_sampling, domain_of
from tpmscad.blend.composition import BlendedField, StageWeight
from tpmscad.blend.grid import Box, Field, Grid
from tpmscad.blend.initial import Spec, initial_weight, sides
from tpmscad.blend.optimise import Outcome, View, optimise, view
from tpmscad.blend.promote import promoted
from tpmscad.blend.result import BlendResult, Errors, Tally
from tpmscad.blend.scene import Scene, scene
from tpmscad.blend.weight import Weight
from tpmscad.blend.weights_line import LineWeight
from tpmscad.errors import InvalidRequest

METHODS = ("topological", "initial")

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
    progress: Progress | None = None,
) -> BlendResult:
    """Structures joined in the blending regions; outside of these each keeps its values to the last bit.

    structures: fields (f < 0 solid); regions: one each, as fields (<= 0 inside), not overlapping; blending_regions: number k
    joins structure k + 1 to those before it. resolution: samples along x, y, z of the domain (that of the regions' bounds);
    errors are counted there and at twice as many. Raises InvalidRequest for input that can't be blended; what could not be
    mended is told by the result.
    """
    clock = _Clock(progress)
    check_counts(len(structures), len(regions), len(blending_regions))
    if method not in METHODS:
        raise InvalidRequest(f"method {method!r}: must be one of {', '.join(METHODS)}")
    low, high = domain_of(tuple(regions), domain)
    if resolution is None:
        raise InvalidRequest("resolution is needed")
    grid = Grid(low, high, resolution)
    field = BlendedField(tuple(structures), tuple(regions), tuple(blending_regions), ())
    check_regions(field, grid)
    scenes = (scene(field, grid), scene(field, grid.twice()))
    check_sampling(field, *scenes)
    clock.lap("sampling")
    specs = (
        [weight] * len(blending_regions)
        if isinstance(weight, str) or not isinstance(weight, Sequence)
        else list(weight)
    )
    if len(specs) != len(blending_regions):
        raise InvalidRequest(
            f"{len(specs)} weights for {len(blending_regions)} blending regions: give one each, or one for all"
        )
    start = [initial_weight(spec, field, scenes[0], stage) for stage, spec in enumerate(specs)]
    before = [view(s, k, start) for k, s in enumerate(scenes)]
    clock.lap("initial weight")
    outcome = _optimised(method, field, scenes, start, max_iterations)
    after = [view(s, k, outcome.weights) for k, s in enumerate(scenes)]
    clock.lap("optimisation")
    return _result(field.with_weights(outcome.weights), method, scenes, before, after, outcome, clock)


def _optimised(
    method: str, field: BlendedField, scenes: tuple[Scene, ...], start: list[Weight], max_iterations: int
) -> Outcome:
    def promote(stage: int, weight: Weight) -> Weight:
        if not isinstance(weight, LineWeight):
            return weight
        first, second = sides(field, stage)
        return promoted(weight, scenes[0].grid, first, second, field.blending[stage])

    if method == "initial":
        return Outcome(tuple(start), (), 0, ())
    return optimise(scenes, start, promote, max_iterations)


def _result(
    field: BlendedField,
    method: str,
    scenes: Sequence[Scene],
    before: Sequence[View],
    after: Sequence[View],
    outcome: Outcome,
    clock: _Clock,
) -> BlendResult:
    def tally(kind: int) -> Tally:
        phases = [(v.census.solid, v.solid) if kind == 0 else (v.census.void, v.void) for v in after]
        first = [v.census.n0 if kind == 0 else v.census.n2 for v in before]
        final = [len(phase.errors) for phase, _ in phases]
        own = [len(phase.errors) - len(blame) for phase, blame in phases]
        return Tally(tuple(first), tuple(final), tuple(own))

    errors = Errors(tuple(s.grid.shape for s in scenes), tally(0), tally(2))
    return BlendResult(
        field=field,
        weight=StageWeight(field, 0) if len(field.weights) == 1 else field.shares,
        weights=field.weights,
        errors=errors,
        converged=errors.left == 0,
        iterations=outcome.rounds,
        message=_message(errors, outcome),
        method=method,
        resolution=scenes[0].grid.shape,
        seconds=dict(clock.seconds),
    )


def _message(errors: Errors, outcome: Outcome) -> str:
    checked = " and ".join("x".join(map(str, r)) for r in errors.resolutions)
    parts = []
    if errors.left == 0:
        parts.append(f"no topological error of the blend at {checked}")
    else:
        left = "; ".join(
            f"{'x'.join(map(str, r))}: {a} isolated components and {b} isolated holes"
            for r, a, b in zip(errors.resolutions, errors.n0.left, errors.n2.left, strict=True)
        )
        parts.append(f"errors left: {left}")
    if any(errors.n0.intrinsic) or any(errors.n2.intrinsic):
        parts.append(
            f"intrinsic to the inputs: {max(errors.n0.intrinsic)} components, {max(errors.n2.intrinsic)} holes"
        )
    return ". ".join([*parts, *outcome.log])


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
            self._progress(name, len(self.seconds) / 3)
