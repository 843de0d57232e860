"""The last steps of every solid: what is kept and cleared, loose pieces, the certificate, the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.results.certificate import certify_built_solids, certify_kernel_solids
from tpmscad.results.loose_pieces import NOTHING_DROPPED, DroppedPieces, drop_loose_pieces, drop_loose_solids
from tpmscad.results.model import Model
from tpmscad.solids.cut import MadeSolids
from tpmscad.solids.matter.crossing_fields import Remake
from tpmscad.solids.matter.reference_distance import DistanceFunction
from tpmscad.solids.passive_regions import NO_REGIONS, PassiveRegions
from tpmscad.stage_timer import StageTimer

FIELD_VOLUME = "volume of the field"
"""Name of a figure."""


def finish_model(
    name: str,
    made: MadeSolids,
    loose: str,
    stages: StageTimer,
    *,
    envelope: Envelope,
    distance: DistanceFunction,
    passive: PassiveRegions = NO_REGIONS,
    remake: Remake | None = None,
    specks: DroppedPieces = NOTHING_DROPPED,
) -> Model:
    """The model of solids: combined with the passive regions, without loose pieces, and certified.

    remake: see `PassiveRegions.combine`. specks: what was left out of the data before the fit.
    """
    if passive.bodies:
        with stages("passive regions"):
            made = passive.combine(made, remake)
    built, patches, measures = made.built, made.patches, made.measures
    with stages("check"):
        if isinstance(built, BrepSolids):
            patches, built, dropped = drop_loose_pieces(built.brep, built, loose)
            left_out = specks | dropped
            if dropped.volumes:
                measures = replace(measures, figures=_say_what_is_included(measures.figures))
            certificate = certify_built_solids(
                built,
                measures,
                valid=made.valid,
                checks=made.checks,
                notes=(*made.notes, *left_out.notes),
                dropped=left_out.volumes,
            )
        else:
            solids, dropped = drop_loose_solids(built.solids, loose)
            left_out = specks | dropped
            built = made.label(solids)
            certificate = certify_kernel_solids(
                solids,
                patches,
                measures,
                checks=made.checks,
                notes=(*made.notes, *left_out.notes),
                dropped=left_out.volumes,
            )
    passive.require_kept(dropped.volumes)
    return Model(
        name,
        patches,
        certificate.with_seconds(stages.seconds),
        built,
        trimmed_by=made.trimmed_by,
        distance_to_reference=distance,
        envelope=envelope,
    )


def _say_what_is_included(figures: Mapping[str, float]) -> dict[str, float]:
    """The figures, where the name of the field's volume says that it includes the pieces left out of the solid."""
    names = {FIELD_VOLUME: f"{FIELD_VOLUME} with the pieces left out"}
    return {names.get(name, name): value for name, value in figures.items()}
