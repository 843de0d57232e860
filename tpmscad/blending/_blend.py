"""The function `blend`: porous structures joined in blending regions, without isolated components and cavities.

The method is that of "porous blending by persistent homology" (sections 3.1 to 3.3 of the paper): a field blended by B-spline
weights (eqs 2, 6 and 8), whose coefficients are optimised until no topological defect remains, stage by stage for several
structures (Algorithms 2 and 3). We differ in four points. All stages are optimised together, because a defect that an early stage
leaves can be beyond the reach of a later one. Defects are repaired by linear constraints before the paper's gradient descent is
tried (`optimise.optimiser`). Defects are counted on a second grid of twice the samples, and with face connectivity in both phases
(`composition.defects`). Defects of the input structures are told apart and never charged to the blend.

A blend is a list of passes, each a function from the problem and the outcome so far to the next outcome.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated

import numpy as np

from tpmscad._typing import ProgressOption
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import (
    BOX,
    COUNTS,
    FIELDS,
    FLAG,
    NOT_NEGATIVE,
    NUMBER,
    POSITIVE,
    PROGRESS,
    TEXT,
    WHOLE_NUMBER,
)
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.initial_weights import WEIGHTS, WeightSpec, expand_weight_specs, make_initial_weight
from tpmscad.blending.input_defects import repair_input_defects
from tpmscad.blending.optimise.blend_state import (
    BlendProblem,
    OptimisationOutcome,
    evaluate_all_grids,
    evaluate_weights,
    make_blend_problem,
)
from tpmscad.blending.optimise.level_margin import enforce_level_margin
from tpmscad.blending.optimise.neck_width import widen_necks
from tpmscad.blending.optimise.optimiser import keep_initial_weights, optimise, optimise_as_published
from tpmscad.blending.optimise.subgrid_defects import (
    MAX_QUICK_CANDIDATES,
    count_subgrid_defects,
    remove_subgrid_defects,
)
from tpmscad.blending.result import BlendResult, assemble_result
from tpmscad.blending.sampling_domain import choose_resolution, resolve_domain
from tpmscad.blending.validation import check_counts, check_options, check_regions, check_sampling
from tpmscad.blending.volume_fraction_control import fit_level_shift, report_fractions
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.fields import as_field
from tpmscad.fields.data.sample_grid import BoxBounds, FieldFunction, SampleGrid
from tpmscad.stage_timer import StageTimer

Pass = Callable[[BlendProblem, OptimisationOutcome], OptimisationOutcome]

OPTIMISERS: dict[str, Pass] = {
    "topological": optimise,
    "paper": optimise_as_published,
    "initial": keep_initial_weights,
}
"""The methods that start from B-spline weights: the robust optimiser, the paper's descent as printed, no optimisation."""

METHODS = tuple(OPTIMISERS)


@validate_call()
def blend(
    structures: Annotated[
        Sequence[FieldFunction],
        FIELDS,
        "Two or more porous structures: functions f(points (..., 3)) -> (...), solid where f < 0. `tpmscad.fields` "
        "makes them.",
    ],
    regions: Annotated[
        Sequence[FieldFunction], FIELDS, "One region for each structure, at most 0 inside. Regions must not overlap."
    ],
    blending_regions: Annotated[
        Sequence[FieldFunction],
        FIELDS,
        "One less than structures. Blending region k joins structure k + 1 to those before it.",
    ],
    *,
    method: Annotated[
        str,
        TEXT.described_as(example='"topological"'),
        '"topological" is the robust optimiser, "paper" the descent of the paper as printed, "initial" keeps the '
        "initial weights.",
    ] = "topological",
    weight: Annotated[
        WeightSpec | Sequence[WeightSpec],
        WEIGHTS,
        'The kind of weight, for all blending regions or for each: "x", "y" or "z" (univariate), "volume" '
        '(trivariate), "auto", or a specification.',
    ] = "auto",
    resolution: Annotated[
        tuple[int, int, int] | None,
        COUNTS,
        "Samples along x, y and z of the domain, chosen from the structures by default. Defects are counted on this "
        "grid and on that of twice the samples.",
    ] = None,
    domain: Annotated[
        BoxBounds | None, BOX, "The box to blend in, in model units; by default the bounding box of the regions."
    ] = None,
    max_iterations: Annotated[int, WHOLE_NUMBER, "Rounds of the optimiser at most."] = 60,
    minimum_neck: Annotated[
        float | None,
        POSITIVE,
        "Width in model units that solid and void are to have at least at saddle points inside the blending regions. "
        "Necks for which this could not be reached are in `BlendResult.necks`.",
    ] = None,
    max_change: Annotated[
        float,
        NUMBER.described_as(example="1.0"),
        "Greatest change of a coefficient from its initial value, above 0 and at most 1, the whole range of a weight.",
    ] = 1.0,
    keep_fraction: Annotated[
        bool,
        FLAG,
        "Add a level shift inside the blending regions, so that the solid fraction stays between those of the "
        "structures.",
    ] = False,
    level_margin: Annotated[
        float,
        NOT_NEGATIVE,
        "Fraction of the field's rms (such as 0.06) by which the level may be shifted without isolating parts, as far "
        "as a few rounds reach. For solids that are made with a tolerance.",
    ] = 0.0,
    remove_input_defects: Annotated[
        bool,
        FLAG,
        "Remove the isolated components and fill the cavities that the structures bring with them, such as chips at "
        "the skin of a trimmed model. Only within a few samples of these does the field then differ from its "
        "structures.",
    ] = False,
    subgrid_check: Annotated[
        bool | None,
        FLAG,
        "Search also between the samples for isolated parts, and remove them. By default they are searched for only "
        "where few samples come into question.",
    ] = None,
    progress: Annotated[
        ProgressOption,
        PROGRESS,
        "Called with the name of each stage of the computation and the fraction of it that is done. By default work "
        "of more than two seconds shows a bar in a terminal or a notebook, of more than ten seconds lines elsewhere; "
        "False shows nothing.",
    ] = None,
) -> BlendResult:
    """Blend porous structures in given regions without isolated components and cavities.

    Outside the blending regions the field of each structure is kept, bit for bit.

    Returns
    -------
    BlendResult
        The blended field, the weights, and the defects before and after. `converged` is False if defects remain.

    Raises
    ------
    InvalidRequest
        If the request cannot be blended: numbers of operands that do not fit, regions that overlap, are empty or do not touch,
        structures that are under-sampled, options out of range.

    Notes
    -----
    The method is that of the porous-blending paper (sections 3.1 to 3.3, Algorithms 1 to 3), with a more robust optimiser.

    Examples
    --------
    >>> from tpmscad import blend, fields
    >>> gyroid = fields.rod(fields.tpms("gyroid", period=0.5), 0.0)
    >>> schwarz = fields.rod(fields.tpms("schwarz_p", period=0.5), 0.0)
    >>> left, right = fields.box((0, 0, 0), (0.5, 0.5, 0.5)), fields.box((0.5, 0, 0), (1, 0.5, 0.5))
    >>> middle = fields.box((0.3, 0, 0), (0.7, 0.5, 0.5))
    >>> result = blend([gyroid, schwarz], [left, right], [middle], resolution=(24, 13, 12))
    >>> result.converged, result.errors.remaining
    (True, 0)
    """
    check_counts(len(structures), len(regions), len(blending_regions))
    check_options(method, METHODS, max_change)
    specs = expand_weight_specs(weight, len(blending_regions))
    timer = StageTimer(progress, clock=time.process_time)
    with timer("sampling"):
        problem = sample_problem(structures, regions, blending_regions, resolution, domain, max_iterations)
    grids = [composition.grid for composition in problem.compositions]
    with timer("weights"):
        start_weights = _make_start_weights(specs, problem, max_change)
        if keep_fraction:
            shifts = [fit_level_shift(problem.coarse, start_weights, stage) for stage in range(len(specs))]
            problem = problem.with_level_shifts(shifts)
        start = evaluate_weights(problem.compositions, start_weights)
    outcome = OptimisationOutcome(start)
    passes = _choose_passes(method, level_margin, subgrid_check, minimum_neck)
    if keep_fraction:
        passes.append(("volume fraction", partial(report_fractions, start=start_weights)))
    for name, run_pass in passes:
        with timer(name):
            outcome = run_pass(problem, outcome)
    with timer("check"):
        before, after = (evaluate_all_grids(problem.compositions, state) for state in (start, outcome.state))
    blended = problem.field.with_weights(outcome.state.weights)
    result = assemble_result(blended, method, grids, before, after, outcome, timer.seconds)
    return repair_input_defects(result, blended, after[-1], grids) if remove_input_defects else result


def sample_problem(
    structures: Sequence[FieldFunction],
    regions: Sequence[FieldFunction],
    blending_regions: Sequence[FieldFunction],
    resolution: tuple[int, int, int] | None,
    domain: BoxBounds | None,
    max_rounds: int,
) -> BlendProblem:
    """The checked problem, sampled on the working grid and on that of twice its samples."""
    structure_fields, region_fields, blending_fields = (
        tuple(map(as_field, given)) for given in (structures, regions, blending_regions)
    )
    box = resolve_domain(region_fields, domain)
    field = BlendedField(structure_fields, region_fields, blending_fields, (), domain=box)
    grid = SampleGrid(*box, resolution or choose_resolution(structure_fields, box))
    check_regions(field, grid)
    problem = make_blend_problem(field, grid, max_rounds)
    check_sampling(field, *problem.compositions)
    return problem


def _make_start_weights(specs: Sequence[WeightSpec], problem: BlendProblem, max_change: float) -> list[SplineWeight]:
    """The initial weight of each stage, with bounds `max_change` around its coefficients."""
    weights: list[SplineWeight] = []
    for stage, spec in enumerate(specs):
        weight = make_initial_weight(spec, problem.field, problem.compositions, stage)
        lower = np.maximum(weight.coefficients - max_change, 0.0)
        upper = np.minimum(weight.coefficients + max_change, 1.0)
        weights.append(replace(weight, lower_bounds=lower, upper_bounds=upper))
    return weights


def _choose_passes(
    method: str, level_margin: float, subgrid_check: bool | None, minimum_neck: float | None
) -> list[tuple[str, Pass]]:
    """The passes that the options request, in order, with the names under which they are timed."""
    passes: list[tuple[str, Pass]] = [("optimisation", OPTIMISERS[method])]
    max_candidates = MAX_QUICK_CANDIDATES if subgrid_check is None else None  # by default only where that is quick
    if level_margin > 0:
        passes.append(("level margin", partial(enforce_level_margin, margin_rms=level_margin)))
    if subgrid_check is not False and method == "topological":
        passes.append(("subgrid defects", partial(remove_subgrid_defects, max_candidates=max_candidates)))
    if minimum_neck is not None:
        passes.append(("necks", partial(widen_necks, width=minimum_neck)))
    if subgrid_check is not False and (method != "topological" or minimum_neck is not None):
        passes.append(("subgrid defects", partial(count_subgrid_defects, max_candidates=max_candidates)))
    return passes
