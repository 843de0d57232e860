"""The solid of a field filled with a lattice: two networks of patches, cut by each other.

Without a skin the result is the intersection of body and lattice. With one, the cavity (`field_skin`) without the lattice is
taken from the body: these voids do not touch the body's boundary, so that their faces, reversed, are further shells of it. The
volume is compared with that of a sample of points, classified by the field itself and by the nearest nodes of the lattice's
patches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep, join_breps, reverse_faces
from tpmscad.errors import InvalidRequest, KernelError, NothingLeft, TrimmingError
from tpmscad.kernel.boolean.cut_faces import SKIN
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.results.certificate import Check, PatchMeasures, certify_built_solids
from tpmscad.results.loose_pieces import drop_loose_pieces
from tpmscad.results.model import Model
from tpmscad.solids.boolean_strategies import (
    TRIMMED_PATCHES,
    build_valid_solids,
    compare_with_sample,
    signed_distances_to_nodes,
)
from tpmscad.solids.field_bodies import BODY, FieldBody, join_body_measures
from tpmscad.solids.field_skin import ErodedFieldBody, erode_field_body
from tpmscad.solids.lattice_block import LatticeBlock
from tpmscad.solids.patch_measures import move_patch_measures
from tpmscad.solids.reference_distance import DistanceFunction
from tpmscad.stage_timer import StageTimer
from tpmscad.trimming.network_boolean import Operation, combine_networks

CUT_NOTE = "cut on the patches' parameters"
"""The note of a certificate on the method."""

SAMPLE_POINTS = 20_000
"""Points in the box of the body, at which the volume is counted."""


@dataclass(frozen=True, slots=True, eq=False)
class CutSolids:
    """Solids of two networks that cut each other, their boundary representation, and how they were made.

    `shift` (3,): the translation of the lattice.
    """

    brep: Brep
    built: BrepSolids
    shift: Array
    checks: tuple[Check, ...]
    notes: tuple[str, ...]


def infill_field_body(
    body: FieldBody,
    block: LatticeBlock,
    skin: float | None,
    loose: str,
    stages: StageTimer,
    name: str,
    distance: DistanceFunction,
) -> Model:
    """The model of a field's solid filled with the lattice of a block, within a skin or without."""
    cavity = None
    if skin is not None:
        with stages("erode"):
            cavity = erode_field_body(body, skin)
    with stages("trim"):
        filled = _intersect(body, block) if cavity is None else _fill_within_skin(body, block, cavity)
    with stages("check"):
        volume = float(filled.built.nesting.volume.sum())
        checks = (*filled.checks, _check_volume(volume, body, block, cavity))
        brep, built, dropped = drop_loose_pieces(filled.brep, filled.built, loose)
        measures: PatchMeasures = join_body_measures(
            move_patch_measures(block.measures, float(np.linalg.norm(filled.shift))), body
        )
        certificate = certify_built_solids(
            built,
            measures,
            valid=True,
            checks=checks,
            notes=(*filled.notes, *dropped.notes),
            dropped=dropped.volumes,
        )
    return Model(
        name,
        brep,
        certificate.with_seconds(stages.seconds),
        built,
        trimmed_by=TRIMMED_PATCHES,
        distance_to_reference=distance,
        envelope=Envelope(body.name, body.cad.volume, body.cad.shape),
    )


def _intersect(body: FieldBody, block: LatticeBlock) -> CutSolids:
    """The intersection of body and lattice."""
    return _cut(body.built.brep, block, "intersection")


def _cut(brep: Brep, block: LatticeBlock, operation: Operation) -> CutSolids:
    """The operation on a solid and the lattice of a block."""
    found = combine_networks(
        brep, block.patches, operation, build=build_valid_solids, max_shift=block.max_shift, is_cover=True
    )
    return CutSolids(found.brep, found.built, found.report.shift, (), (CUT_NOTE, *found.report.notes))


def _fill_within_skin(body: FieldBody, block: LatticeBlock, cavity: ErodedFieldBody) -> CutSolids:
    """The body without what the lattice leaves of the cavity."""
    voids = cut_voids(block, cavity)
    brep = join_breps([body.built.brep, reverse_faces(voids.brep)])
    built = build_valid_solids(brep)
    count = len(built.nesting.volume) - built.n_solids - (len(body.built.nesting.volume) - body.built.n_solids)
    closed = (
        f"the skin closes off {'a channel' if count == 1 else f'{count} channels'}: bore through the skin to let powder or "
        "fluid out"
    )
    return replace(voids, brep=brep, built=built, notes=(*voids.notes, closed))


def cut_voids(block: LatticeBlock, cavity: ErodedFieldBody) -> CutSolids:
    """What the lattice leaves of the cavity within a skin."""
    found = _cut(cavity.brep, block, "difference")
    brep = replace(found.brep, tags=tuple(SKIN if tag == BODY else tag for tag in found.brep.tags))
    return replace(found, brep=brep, checks=cavity.checks, notes=(*found.notes, *cavity.notes))


def _check_volume(volume: float, body: FieldBody, block: LatticeBlock, cavity: ErodedFieldBody | None) -> Check:
    """The check of the volume against a sample of points in the body."""
    low, high = (np.array(corner) for corner in body.cad.report.bounds)
    points = low + (high - low) * _sample_cube(SAMPLE_POINTS)
    points = points[body.field(points) < 0]
    solid = signed_distances_to_nodes(block.patches, points) < 0
    if cavity is not None:
        solid |= cavity.field(points) >= 0
    return compare_with_sample(volume / body.cad.volume, solid, body.name)


def _sample_cube(count: int) -> Array:
    """Points (n, 3) in the unit cube, a low-discrepancy sequence of three dimensions (M. Roberts, 2018)."""
    steps = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    return np.asarray(np.modf(0.5 + np.outer(np.arange(count), steps))[0])


def reject_empty(error: TrimmingError, body: FieldBody) -> Exception:
    """The error of a cut that leaves nothing, as an invalid request; others as errors of the kernel's room."""
    if isinstance(error, NothingLeft):
        return InvalidRequest(f"no lattice lies in {body.name}: shift it by phase, or make the cell smaller")
    return KernelError(
        "trim",
        f"{body.name} and the lattice cannot be cut by each other; shift it by `phase`, or change `cell` or `tol` a little: "
        f"{error}",
    )
