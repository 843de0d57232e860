"""The values that the passes of an optimisation share: the problem, the weights with their defects, and the outcome so far."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import IntArray
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.defects import DefectCensus, PhaseComponents, count_defects
from tpmscad.blending.composition.sampled_composition import SampledComposition, sample_composition
from tpmscad.blending.weights.volume_weight_fit import refine_weight
from tpmscad.blending.weights.weight_protocol import SplineWeight, WeightFunction
from tpmscad.fields.analysis.saddles import Neck
from tpmscad.fields.data.sample_grid import SampleGrid


@dataclass(frozen=True, slots=True, eq=False)
class BlendProblem:
    """What is to be blended: the field without weights, its samples on the working grid and on the doubled grid.

    `max_rounds` limits the rounds of the optimiser, and those of the widening of necks.
    """

    field: BlendedField
    coarse: SampledComposition
    fine: SampledComposition
    max_rounds: int

    @property
    def compositions(self) -> tuple[SampledComposition, SampledComposition]:
        """The samples on the working grid and on that of twice its samples."""
        return self.coarse, self.fine

    def with_level_shifts(self, level_shifts: Sequence[WeightFunction | None]) -> BlendProblem:
        """The problem with level shifts, one or None for each stage."""
        return replace(
            self,
            field=self.field.with_level_shifts(level_shifts),
            coarse=self.coarse.with_level_shifts(level_shifts),
            fine=self.fine.with_level_shifts(level_shifts),
        )

    def refine(self, stage: int, weight: SplineWeight) -> SplineWeight | None:
        """A weight of the same values with more free coefficients, or None if the samples do not allow more."""
        return refine_weight(weight, self.coarse.stage_masks(stage), self.fine.stage_masks(stage))

    def refine_all(self, weights: Sequence[SplineWeight]) -> list[SplineWeight] | None:
        """The weights of all stages, refined where possible; None if no weight can be refined."""
        refined = [self.refine(stage, weight) for stage, weight in enumerate(weights)]
        if all(weight is None for weight in refined):
            return None
        return [old if new is None else new for new, old in zip(refined, weights, strict=True)]


def make_blend_problem(field: BlendedField, grid: SampleGrid, max_rounds: int) -> BlendProblem:
    """The problem of a field without weights, sampled on a grid and on that of twice its samples."""
    fine = grid.double_samples()
    return BlendProblem(field, sample_composition(field, grid), sample_composition(field, fine), max_rounds)


@dataclass(frozen=True, slots=True, eq=False)
class GridDefects:
    """The components on one grid, and the labels of the defects of each phase that are charged to the blend."""

    grid_index: int
    census: DefectCensus
    solid_defects: IntArray
    void_defects: IntArray

    @property
    def n_defects(self) -> int:
        """Number of defects of both phases that are charged to the blend."""
        return len(self.solid_defects) + len(self.void_defects)

    def phases(self) -> Iterator[tuple[PhaseComponents, IntArray]]:
        """The solid and the void phase, each with the labels of its defects that are charged to the blend."""
        yield self.census.solid, self.solid_defects
        yield self.census.void, self.void_defects


@dataclass(frozen=True, slots=True, eq=False)
class BlendState:
    """Weights, and the defects with them on each grid from coarse to fine, up to the first grid that has any.

    `score` is the number of grids not yet clean and the number of defects on the first of these; the least is best.
    """

    weights: tuple[SplineWeight, ...]
    grid_defects: tuple[GridDefects, ...]
    score: tuple[int, int]

    @property
    def is_clean(self) -> bool:
        """Whether no grid has a defect that is charged to the blend."""
        return self.score[0] == 0

    @property
    def coarsest_defective(self) -> GridDefects:
        """The defects on the coarsest grid that has any (on the finest grid if the state is clean)."""
        return self.grid_defects[-1]


@dataclass(frozen=True, slots=True, eq=False)
class OptimisationOutcome:
    """The state reached by the passes so far, the rounds they took, and a line of text for each notable event.

    `narrow_necks` stay narrower than requested. `n_subgrid_defects` is None if subgrid defects were not searched for.
    """

    state: BlendState
    rounds: int = 0
    log: tuple[str, ...] = ()
    narrow_necks: tuple[Neck, ...] = ()
    n_subgrid_defects: int | None = None

    def advance(self, state: BlendState, rounds: int, *lines: str) -> OptimisationOutcome:
        """The outcome after a pass with this result, rounds and log lines."""
        return replace(self, state=state, rounds=self.rounds + rounds, log=(*self.log, *lines))


def find_grid_defects(
    composition: SampledComposition, grid_index: int, weights: Sequence[WeightFunction]
) -> GridDefects:
    """The defects of the blend with these weights on one grid; input defects are not charged to it."""
    census = count_defects(composition.values(weights))
    solid, void = (
        np.setdiff1d(phase.defects, composition.input_defect_labels(phase)) for phase in (census.solid, census.void)
    )
    return GridDefects(grid_index, census, solid, void)


def evaluate_weights(compositions: Sequence[SampledComposition], weights: Sequence[SplineWeight]) -> BlendState:
    """The state of weights: grids are evaluated from coarse to fine, up to the first with defects."""
    evaluated = []
    for index, composition in enumerate(compositions):
        evaluated.append(find_grid_defects(composition, index, weights))
        if n_defects := evaluated[-1].n_defects:
            return BlendState(tuple(weights), tuple(evaluated), (len(compositions) - index, n_defects))
    return BlendState(tuple(weights), tuple(evaluated), (0, 0))


def evaluate_all_grids(compositions: Sequence[SampledComposition], state: BlendState) -> tuple[GridDefects, ...]:
    """The defects of a state on all grids; those that the state lacks are evaluated now."""
    n_known = len(state.grid_defects)
    rest = [
        find_grid_defects(composition, index, state.weights)
        for index, composition in enumerate(compositions)
        if index >= n_known
    ]
    return (*state.grid_defects, *rest)
