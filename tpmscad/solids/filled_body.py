"""A CAD body filled with the lattice of a block of patches, as one certified solid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tpmscad.brep.boundary_representation import translate_brep
from tpmscad.errors import EmptyInfill, InvalidRequest
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.boolean.cut_faces import label_cut_solids
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.results.loose_pieces import DroppedPieces, drop_loose_pieces, drop_loose_solids
from tpmscad.results.model import Model
from tpmscad.solids.boolean_strategies import BooleanResult, certify_cut_solids, intersect_body_with_lattice
from tpmscad.solids.distance_skin import SKIN_METHODS
from tpmscad.solids.lattice_block import LatticeBlock
from tpmscad.solids.reference_distance import DistanceFunction
from tpmscad.stage_timer import StageTimer

MIN_WALL_THICKNESS = 1e-5
"""Model units: a hundred times the kernel's tolerance, at which the trimmed edges of the two walls are still distinct."""


def check_wall_thickness(request: LatticeRequest) -> None:
    """InvalidRequest if the wall of a sheet is too thin for the kernel to trim."""
    if request.kind == "sheet" and np.ptp(request.offset) < MIN_WALL_THICKNESS:
        raise InvalidRequest(
            f"a wall of {np.ptp(request.offset):g} is thinner than {MIN_WALL_THICKNESS:g}, "
            "a hundred times the kernel's tolerance"
        )


def fill_body(
    block: LatticeBlock,
    body: CadBody,
    skin: float | None,
    open_faces: Sequence[Any],
    loose: str,
    stages: StageTimer,
    name: str,
    distance: DistanceFunction | None,
) -> Model:
    """The body filled with the block's lattice, behind a skin if there is one; EmptyInfill if no lattice lies in it.

    distance: that of points from the reference surface, for the model.
    """
    with stages("trim"):
        if skin is not None:
            result = SKIN_METHODS.run(block, body, skin, open_faces).value
        else:
            result = intersect_body_with_lattice(block, body)
            if not result.built.n_solids:
                raise EmptyInfill(f"no lattice lies in {body.name}: shift it by phase, or make the cell smaller")
        result, dropped = _drop_loose_solids(result, loose)
        if result.brep is None:
            placements = [translate_brep(block.patches, np.array(shift)) for shift in result.shifts]
            result = replace(result, built=label_cut_solids(result.solids, placements, body, has_skin=skin is not None))
    with stages("check"):
        notes = (*body.notes, *result.notes, *dropped.notes)
        certificate = certify_cut_solids(
            block, result.built, moved=result.moved, checks=result.checks, notes=notes, dropped=dropped.volumes
        )
    return Model(
        name,
        block.patches if result.brep is None else result.brep,
        certificate.with_seconds(stages.seconds),
        result.built,
        trimmed_by=result.method,
        distance_to_reference=distance,
        envelope=Envelope(body.name, body.volume, body.shape),
    )


def _drop_loose_solids(result: BooleanResult, loose: str) -> tuple[BooleanResult, DroppedPieces]:
    """The result without its loose pieces, and what was left out."""
    if result.brep is None:
        solids, dropped = drop_loose_solids(result.solids, loose)
        return replace(result, built=OcctSolids(solids)), dropped
    brep, built, dropped = drop_loose_pieces(result.brep, result.built, loose)
    return replace(result, brep=brep, built=built), dropped
