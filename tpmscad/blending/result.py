"""The result of a blend: the field, the weights, the defects counted before and after, and how it went."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tpmscad._typing import Array
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.optimise.blend_state import GridDefects, OptimisationOutcome
from tpmscad.blending.weights.weight_protocol import WeightFunction
from tpmscad.fields import Field
from tpmscad.fields.analysis.saddles import Neck
from tpmscad.fields.data.sample_grid import BoxBounds, SampleGrid


@dataclass(frozen=True, slots=True)
class DefectCounts:
    """Numbers of one kind of defect at each resolution checked.

    `initial` and `final` are those of the initial weights and of the result; `intrinsic` are the final defects that the input
    structures bring with them.
    """

    initial: tuple[int, ...]
    final: tuple[int, ...]
    intrinsic: tuple[int, ...]

    @property
    def remaining(self) -> tuple[int, ...]:
        """Numbers of final defects that are charged to the blend, at each resolution."""
        return tuple(f - i for f, i in zip(self.final, self.intrinsic, strict=True))


@dataclass(frozen=True, slots=True)
class DefectReport:
    """The defects of a blend at each of `resolutions`, the working one first.

    `n0` counts isolated solid components: those joined through faces, besides the largest one. `n2` counts cavities: void
    components, joined through faces, that do not reach the domain's border. `n_subgrid` counts the isolated parts found between
    the samples, which no resolution shows; None if they were not searched for.
    """

    resolutions: tuple[tuple[int, int, int], ...]
    n0: DefectCounts
    n2: DefectCounts
    n_subgrid: int | None = None

    @property
    def remaining(self) -> int:
        """Number of defects charged to the blend: at the resolution with the most, and between the samples."""
        return max(a + b for a, b in zip(self.n0.remaining, self.n2.remaining, strict=True)) + (self.n_subgrid or 0)

    def to_dict(self) -> dict[str, object]:
        """The report as plain values.

        `resolutions`, `hidden` (the number of subgrid defects, or None), and for `n0` and `n2` dictionaries with `initial`,
        `final` and `intrinsic`.
        """
        counts = {
            name: {"initial": c.initial, "final": c.final, "intrinsic": c.intrinsic}
            for name, c in (("n0", self.n0), ("n2", self.n2))
        }
        return {"resolutions": self.resolutions, **counts, "hidden": self.n_subgrid}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BlendResult:
    """A blend of porous structures, as `tpmscad.blend` returns it.

    Attributes
    ----------
    field : Field
        The blended field: `field(points)` and `field.gradient(points)` for points (..., 3); solid where it is negative.
    weight : callable
        For two structures the weight of the second, `weight(points)` -> (...), exactly 0 or 1 outside the blending region. For
        more, the weights of all n structures, (..., n), with sum 1.
    weights : tuple
        The weight function of each stage; `coefficients` are those of its spline.
    errors : DefectReport
        Topological defects at each resolution checked, before and after.
    converged : bool
        True if no defect that is charged to the blend remains at any resolution checked, nor between the samples if these were
        searched.
    iterations : int
        Rounds of the optimiser, or steps of the paper's descent.
    message : str
        What remains, and what the optimiser had to do.
    method : str
        The method that was used.
    resolution : tuple of int
        Samples along x, y and z of the working grid.
    seconds : mapping
        CPU seconds by stage of the computation.
    domain : tuple
        The box that was blended and checked: ((x0, y0, z0), (x1, y1, z1)), model units.
    necks : tuple of Neck
        Necks inside the blending regions that stay narrower than the `minimum_neck` requested.
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
    necks: tuple[Neck, ...] = ()

    def __repr__(self) -> str:
        n0, n2 = self.errors.n0, self.errors.n2
        (x0, y0, z0), (x1, y1, z1) = self.domain
        grids = ", ".join(" x ".join(map(str, samples)) for samples in self.errors.resolutions)
        lines = [
            f"blend of {len(self.weights) + 1} structures: {'no defect' if self.converged else 'NOT free of defects'}, by "
            f"{self.method} in {self.iterations} rounds, {sum(self.seconds.values()):.3g} s of CPU",
            f"  box        ({x0:.6g}, {y0:.6g}, {z0:.6g}) to ({x1:.6g}, {y1:.6g}, {z1:.6g}), samples {grids}",
            f"  isolated   {_count_by_grid(n0)} components, {_count_by_grid(n2)} cavities, before to after",
            f"  necks      {len(self.necks)} narrower than asked" if self.necks else "",
            f"  {self.message}" if self.message else "",
        ]
        return "\n".join(line for line in lines if line)

    def to_dict(self) -> dict[str, Any]:
        """The counts and measurements as plain values. Everything but the functions, ready for JSON."""
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


def _count_by_grid(counts: DefectCounts) -> str:
    """The numbers of a defect before and after at each resolution."""
    return ", ".join(f"{first} to {last}" for first, last in zip(counts.initial, counts.final, strict=True))


def assemble_result(
    field: BlendedField,
    method: str,
    grids: Sequence[SampleGrid],
    before: Sequence[GridDefects],
    after: Sequence[GridDefects],
    outcome: OptimisationOutcome,
    seconds: Mapping[str, float],
) -> BlendResult:
    """The result from the defects on all grids before and after."""
    initial, final = [d.census for d in before], [d.census for d in after]
    n0 = _count_defects([c.n0 for c in initial], [c.n0 for c in final], [len(d.solid_defects) for d in after])
    n2 = _count_defects([c.n2 for c in initial], [c.n2 for c in final], [len(d.void_defects) for d in after])
    errors = DefectReport(tuple(grid.shape for grid in grids), n0, n2, outcome.n_subgrid_defects)
    return BlendResult(
        field=field,
        weight=field.weight_of(1) if len(field.weights) == 1 else field.structure_weights,
        weights=field.weights,
        errors=errors,
        converged=errors.remaining == 0,
        iterations=outcome.rounds,
        message=_format_message(errors, outcome.log),
        method=method,
        resolution=grids[0].shape,
        seconds=dict(seconds),
        domain=(grids[0].low, grids[0].high),
        necks=outcome.narrow_necks,
    )


def _count_defects(initial: Sequence[int], final: Sequence[int], charged: Sequence[int]) -> DefectCounts:
    return DefectCounts(tuple(initial), tuple(final), tuple(f - c for f, c in zip(final, charged, strict=True)))


def _format_message(errors: DefectReport, log: tuple[str, ...]) -> str:
    checked = " and ".join("x".join(map(str, r)) for r in errors.resolutions)
    parts = []
    if errors.remaining == 0:
        parts.append(f"no topological error of the blend at {checked}")
    elif errors.remaining == errors.n_subgrid:
        parts.append(f"{errors.n_subgrid} isolated parts between the samples of {checked}, which show no error")
    else:
        left = "; ".join(
            f"{'x'.join(map(str, r))}: {a} isolated components and {b} isolated holes"
            for r, a, b in zip(errors.resolutions, errors.n0.remaining, errors.n2.remaining, strict=True)
        )
        parts.append(f"errors left: {left}")
    if any(errors.n0.intrinsic) or any(errors.n2.intrinsic):
        parts.append(
            f"intrinsic to the inputs: {max(errors.n0.intrinsic)} components, {max(errors.n2.intrinsic)} holes"
        )
    return ". ".join([*parts, _describe_search(errors), *log])


def _describe_search(errors: DefectReport) -> str:
    """What was looked for between the samples, and what that leaves open."""
    if errors.n_subgrid is None:
        return (
            "between these samples nothing was looked for: smaller parts may be loose; a finer `resolution` shows them"
        )
    return (
        "between these samples loose parts were looked for near samples that are close to the surface; others may appear at a "
        "finer `resolution`"
    )
