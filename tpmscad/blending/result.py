"""What a blend returns: the field, the weights, the errors counted before and after, and what became of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tpmscad._typing import Array
from tpmscad.blending.composition.blended_field import BlendedField, StageWeight, WeightFunction
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.optimiser import GridDefects
from tpmscad.fields import Field
from tpmscad.fields.saddles import Neck
from tpmscad.fields.sample_grid import BoxBounds


@dataclass(frozen=True, slots=True)
class DefectCounts:
    """Numbers of one kind of error at each resolution checked: before, after, and of these the inputs' own."""

    initial: tuple[int, ...]
    final: tuple[int, ...]
    intrinsic: tuple[int, ...]

    @property
    def left(self) -> tuple[int, ...]:
        """Final errors that are the blend's, not the inputs'."""
        return tuple(f - i for f, i in zip(self.final, self.intrinsic, strict=True))


@dataclass(frozen=True, slots=True)
class DefectReport:
    """n0: isolated components (solid, joined through faces, beside the greatest); n2: isolated holes (void, joined through faces,
    that do not reach the domain's border); at each of `resolutions`, the working one first."""

    resolutions: tuple[tuple[int, int, int], ...]
    n0: DefectCounts
    n2: DefectCounts
    hidden: int | None = None
    """Specks found between the samples, which no resolution checked has seen; None where they were not looked for."""

    @property
    def left(self) -> int:
        """Errors of the blend itself, at the resolution that has most, and those between the samples."""
        return max(a + b for a, b in zip(self.n0.left, self.n2.left, strict=True)) + (self.hidden or 0)

    def to_dict(self) -> dict[str, object]:
        tallies = {
            name: {"initial": t.initial, "final": t.final, "intrinsic": t.intrinsic}
            for name, t in (("n0", self.n0), ("n2", self.n2))
        }
        return {"resolutions": self.resolutions, **tallies, "hidden": self.hidden}


@dataclass(frozen=True, slots=True, eq=False)
class BlendResult:
    """A blend. `converged` is True only if no error of the blend's own is left at any resolution checked.

    field: f(points), f.gradient(points), f < 0 solid. weight: of two structures the weight of the second, w(points), exactly 0 or
    1 outside the blending region; of more, the shares of all, (..., n). weights: the spline of each stage. seconds: CPU by stage.
    """

    field: Field
    weight: Callable[[Array], Array]
    weights: tuple[WeightFunction, ...]
    errors: DefectReport
    converged: bool
    iterations: int
    message: str
    method: str
    resolution: tuple[int, int, int]
    seconds: Mapping[str, float]
    domain: BoxBounds
    """The box that was blended and checked: ((x0, y0, z0), (x1, y1, z1))."""
    necks: tuple[Neck, ...] = ()
    """Necks inside the blending regions that stay narrower than `minimum_neck` asked for."""

    def to_dict(self) -> dict[str, Any]:
        """What was counted and measured, as plain values ready for JSON."""
        return {
            "converged": self.converged,
            "message": self.message,
            "method": self.method,
            "resolution": list(self.resolution),
            "domain": [list(corner) for corner in self.domain],
            "iterations": self.iterations,
            "errors": self.errors.to_dict(),
            "necks": [asdict(neck) for neck in self.necks],
            "seconds": dict(self.seconds),
        }


def assemble_result(
    field: BlendedField,
    method: str,
    scenes: Sequence[SampledComposition],
    before: Sequence[GridDefects],
    after: Sequence[GridDefects],
    iterations: int,
    log: tuple[str, ...],
    seconds: Mapping[str, float],
    necks: tuple[Neck, ...] = (),
    hidden: int | None = None,
) -> BlendResult:
    """The result from the views of all grids, before and after."""

    def tally(solid: bool) -> DefectCounts:
        total = [[v.census.n0 if solid else v.census.n2 for v in views] for views in (before, after)]
        blamed = [len(v.solid if solid else v.void) for v in after]
        own = [a - b for a, b in zip(total[1], blamed, strict=True)]
        return DefectCounts(tuple(total[0]), tuple(total[1]), tuple(own))

    errors = DefectReport(tuple(s.grid.shape for s in scenes), tally(True), tally(False), hidden)
    return BlendResult(
        field=field,
        weight=StageWeight(field, 0) if len(field.weights) == 1 else field.shares,
        weights=field.weights,
        errors=errors,
        converged=errors.left == 0,
        iterations=iterations,
        message=_format_message(errors, log),
        method=method,
        resolution=scenes[0].grid.shape,
        seconds=dict(seconds),
        domain=(scenes[0].grid.low, scenes[0].grid.high),
        necks=necks,
    )


def _format_message(errors: DefectReport, log: tuple[str, ...]) -> str:
    checked = " and ".join("x".join(map(str, r)) for r in errors.resolutions)
    parts = []
    if errors.left == 0:
        parts.append(f"no topological error of the blend at {checked}")
    elif errors.left == errors.hidden:
        parts.append(f"{errors.hidden} isolated specks between the samples of {checked}, which see no error")
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
    return ". ".join([*parts, *log])
