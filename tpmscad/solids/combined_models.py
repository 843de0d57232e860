"""Union, intersection and difference of two models on the patches they are made of.

The faces of one model are cut by those of the other (`trimming.network_boolean`); the surfaces stay what they were, so that what
the certificates of both models say of them holds for the result, the greater of each two values.
"""

from __future__ import annotations

from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.edge_continuity import EdgeContinuity
from tpmscad.errors import InvalidRequest, TrimmingError
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.results.certificate import PatchMeasures, certify_built_solids, require
from tpmscad.results.model import Model
from tpmscad.stage_timer import StageTimer
from tpmscad.trimming.network_boolean import Operation, combine_networks
from tpmscad.trimming.trim_pipeline import DEFAULT_TOL


def combine_models(first: Model, second: Model, operation: Operation) -> Model:
    """Return the union, the intersection or the difference (first without second) of two models.

    Parameters
    ----------
    first, second : Model
        Models of spline patches, planes and quadrics, such as those of `lattice`, `infill` and `solidify`.
    operation : {"union", "intersection", "difference"}
        What to make.

    Returns
    -------
    Model
        The solid and its certificate, which is met only if those of both models are. Its notes say if the second model was moved
        by a few tolerances of 1e-7, because edges or planes of both coincided.

    Raises
    ------
    InvalidRequest
        If the kernel made one of the models.
    TrimmingError
        If the models touch along an area, nothing is left, or an intersection is not resolved; the message names the place.
    """
    for model in (first, second):
        if not isinstance(model.built, BrepSolids):
            raise InvalidRequest(
                f"the {model.name} was made by the kernel, without patches of its own: use the kernel's boolean"
            )
    stages = StageTimer(None)
    with stages("cut"):
        result = combine_networks(first.patches, second.patches, operation, DEFAULT_TOL, build=_build_valid_solids)
    with stages("check"):
        notes = (
            (f"the second model was moved by {result.report.shifted:.2g}: {result.report.reason}",)
            if result.report.shifted
            else ()
        )
        certificate = certify_built_solids(result.built, _join_measures(first, second), valid=True, notes=notes)
    return Model(
        f"{operation} of {first.name} and {second.name}",
        result.brep,
        certificate.with_seconds(stages.seconds),
        result.built,
    )


def _build_valid_solids(brep: Brep) -> BrepSolids:
    """The solids; TrimmingError if the kernel rejects one of their faces."""
    built = build_solids(brep)
    if not is_brep_valid(brep, built.known_faces):
        raise TrimmingError("the kernel rejects a face of the result")
    return built


def _join_measures(first: Model, second: Model) -> PatchMeasures:
    """The measures of the patches of both models: the greater of each two."""
    both = first.certificate, second.certificate
    largest, rms = max(c.max_deviation for c in both), max(c.rms_deviation for c in both)
    return PatchMeasures(
        tol=max(c.tol for c in both),
        deviation=Deviation(largest, rms, largest, largest),
        reference=", ".join(dict.fromkeys(c.reference for c in both)),
        continuity=EdgeContinuity(
            max(c.gap for c in both), max(c.tangent_jump_deg for c in both), max(c.curvature_jump for c in both), 0
        ),
        checks=tuple(
            require(c.met, f"the {m.name} misses its request: {'; '.join(c.shortfalls)}")
            for m, c in zip((first, second), both, strict=True)
        ),
    )
