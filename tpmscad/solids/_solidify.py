"""Any implicit field as a certified NURBS solid.

The level set {field = 0} is fitted by B-spline patches in the box (`field_patches`), closed by planar caps, built into kernel
solids and measured: deviation in both directions, continuity, validity, Betti numbers, and the volume by two independent
quadratures (of the patches, and of the field along grid lines).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array, BoolArray, BoxCorners
from tpmscad.api.argument_kinds import show_value
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import LoosePieces, StageProgress
from tpmscad.api.shared_kinds import DOMAIN, EXECUTOR, FIELD, POSITIVE, SHAPE
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import CrossingSurfaces, InvalidRequest
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.kinds.data_domains import bound_data_in_body, settle_data
from tpmscad.fields.kinds.linear_extension import extend_level_sets_linearly
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.lattices.spline_maps import SplineMap
from tpmscad.levelset.crossing_operands import has_meeting_quadrics
from tpmscad.levelset.field_solid import validate_box
from tpmscad.results.certificate import PatchMeasures, certify_built_solids, certify_kernel_solids
from tpmscad.results.loose_pieces import (
    KEEP,
    NOTHING_DROPPED,
    DroppedPieces,
    drop_loose_pieces,
    drop_loose_solids,
    drop_specks,
)
from tpmscad.results.model import Model
from tpmscad.solids._infill import infill
from tpmscad.solids.boolean_strategies import KERNEL_BOOLEAN, TRIMMED_PATCHES
from tpmscad.solids.combined_solids import combine_field_solids, label_combined_solids
from tpmscad.solids.field_mapping import solidify_mapped
from tpmscad.solids.field_patches import fit_field_patches
from tpmscad.solids.passive_regions import NO_REGIONS, PassiveRegions
from tpmscad.solids.patch_measures import measure_field_patches
from tpmscad.solids.reference_distance import field_distance
from tpmscad.stage_timer import StageTimer

FIELD_VOLUME = "volume of the field"
"""Name of a figure."""


@validate_call("solidify(field, ((0, 0, 0), (10, 10, 10)), tol=0.01)")
def solidify(
    field: Annotated[
        Field | Callable[..., Any],
        FIELD,
        "A field of `tpmscad.fields`, or a function of points (..., 3) -> (...); negative is solid.",
    ],
    domain: Annotated[
        BoxCorners | Any,
        DOMAIN,
        "A box in model units; or a body in the coordinates of the field: a build123d, CadQuery or TopoDS shape, the "
        "path of a CAD file, or ``fields.box``, ``fields.sphere`` or ``fields.cylinder``. A body's own faces stay "
        "exact, and the field beyond the body's bounding box does not matter. Or a map of `maps.trivariate` or "
        "`maps.between`: the field is then one of the coordinates of its domain, and the solid fills the image of the "
        "domain.",
    ],
    *,
    tol: Annotated[
        float,
        POSITIVE.described_as(example="0.01"),
        "Greatest orthogonal deviation between the surface and the level set, model units.",
    ],
    keep: Annotated[
        Any,
        SHAPE,
        "CAD solids that the result contains with their own, exact faces, such as bosses and flanges, within the box or "
        "reaching beyond it: a build123d or CadQuery shape, or the path of a CAD file, all solids of which are kept. They "
        "must not overlap each other. Of their faces, those inside the solid of the field vanish. For a box.",
    ] = None,
    clear: Annotated[
        Any,
        SHAPE,
        "CAD solids that stay empty, such as bolts in their bores: what of the field's solid and of `keep` lies in them is "
        "cut away, with exact faces. Given as `keep`; for a box.",
    ] = None,
    loose: LoosePieces = "drop",
    executor: Annotated[
        Executor | None,
        EXECUTOR,
        "Runs the fits of a box; its workers must be able to import this package. It pays where the field is a slow "
        "function of Python. By default this process fits. The result is the same, bit for bit. Not for bodies.",
    ] = None,
    progress: StageProgress = None,
) -> Model:
    """Make the solid {field < 0} inside a domain, its surface within `tol` of the level set.

    Returns
    -------
    Model
        The solid and its certificate; `certificate.met` is False if the result misses the request.

    Raises
    ------
    InvalidRequest
        If the domain, the tolerance or the combination of arguments is invalid.
    LevelSetError
        If the field cannot be made a solid; the message names the place and the reason.
    KernelError
        If the kernel cannot build or trim the solid.

    Notes
    -----
    ``solidify(field, body)`` equals ``infill(body, field)`` with `field` extended linearly outside the body's bounding box.

    Examples
    --------
    >>> rod = fields.rod(fields.tpms("gyroid", 10.0), -0.3)
    >>> model = tpmscad.solidify(rod, ((0, 0, 0), (10, 10, 10)), tol=0.01)  # doctest: +SKIP
    >>> model.certificate.met  # doctest: +SKIP
    True
    """
    if (keep is not None or clear is not None) and (isinstance(domain, SplineMap) or not is_numeric_box(domain)):
        raise InvalidRequest("keep and clear are for the solid in a box: give the domain as two corners")
    if isinstance(domain, SplineMap):
        return solidify_mapped(field, domain, tol, loose, executor, StageTimer(progress))
    if not is_numeric_box(domain):
        if executor is not None:
            raise InvalidRequest("an executor is for boxes; a body is filled by one process: leave executor out")
        body = read_body(domain)
        bounds = enclosing_box(body.shape)
        matter = extend_level_sets_linearly(bound_data_in_body(as_field(field), *bounds), *bounds)
        return infill(body, matter, tol=tol, loose=loose, progress=progress)
    stages = StageTimer(progress)
    passive = PassiveRegions.read(keep, clear)
    field, lo, hi, told = settle_data(as_field(field), *validate_box(*parse_corners(domain), tol))
    envelope = Envelope.of_box("the field's box", *parse_corners(domain))
    model = _make_in_box(field, lo, hi, tol, loose, executor, passive, stages)
    certificate = replace(model.certificate, notes=(*told, *model.certificate.notes)) if told else model.certificate
    return replace(model, certificate=certificate, envelope=envelope)


def _make_in_box(
    field: Field,
    lo: Array,
    hi: Array,
    tol: float,
    loose: str,
    executor: Executor | None,
    passive: PassiveRegions,
    stages: StageTimer,
) -> Model:
    """The solid of a field in the box [lo, hi]."""
    domain = (tuple(lo.tolist()), tuple(hi.tolist()))
    if has_meeting_quadrics(field, lo, hi, tol):
        return solidify_crossing(field, domain, tol, loose, stages, passive)
    field, specks = drop_specks(field, lo, hi, KEEP if passive.bodies else loose)
    try:
        found = fit_field_patches(field, lo, hi, tol, stages, executor=executor)
    except CrossingSurfaces:
        return solidify_crossing(field, domain, tol, loose, stages, passive)
    with stages("build"):
        built = build_solids(found.fitted.brep, found.moments)
    with stages("check"):
        measures = measure_field_patches(found)
        volumes = {FIELD_VOLUME: found.field_volume, "uncertainty of that volume": found.field_volume_error}
        measures = replace(measures, figures={**measures.figures, **volumes})
    return _finish(field, domain, _Made(built, found.fitted.brep, measures), loose, passive, stages, specks)


def solidify_crossing(
    field: Field, domain: BoxCorners, tol: float, loose: str, stages: StageTimer, passive: PassiveRegions = NO_REGIONS
) -> Model:
    """The solid of a field whose level sets cross, in a box."""
    combined = combine_field_solids(field, *parse_corners(domain), tol, stages)
    trimmed_by = TRIMMED_PATCHES if isinstance(combined.built, BrepSolids) else KERNEL_BOOLEAN
    made = _Made(combined.built, combined.patches, combined.measures, trimmed_by, valid=True)
    return _finish(field, domain, made, loose, passive, stages)


@dataclass(frozen=True, slots=True, eq=False)
class _Made:
    """Solids in a box, the patches that they are made of, and what was measured on these.

    trimmed_by: of `Model`. valid: what is known of the kernel's check of patches, if anything.
    """

    built: BrepSolids | OcctSolids
    patches: Brep
    measures: PatchMeasures
    trimmed_by: str | None = None
    valid: bool | None = None


def _finish(
    field: Field,
    domain: BoxCorners,
    made: _Made,
    loose: str,
    passive: PassiveRegions,
    stages: StageTimer,
    specks: DroppedPieces = NOTHING_DROPPED,
) -> Model:
    """The model: combined with the passive regions, without its loose pieces, and certified."""
    box = parse_corners(domain)
    if passive.bodies:
        with stages("passive regions"):
            made = _combine(field, box, made, passive)
    built, patches, measures = made.built, made.patches, made.measures
    with stages("check"):
        if isinstance(built, BrepSolids):
            patches, built, dropped = drop_loose_pieces(built.brep, built, loose)
            left_out = specks | dropped
            if dropped.volumes:
                measures = replace(measures, figures=_say_what_is_included(measures.figures))
            certificate = certify_built_solids(
                built, measures, valid=made.valid, notes=left_out.notes, dropped=left_out.volumes
            )
        else:
            solids, dropped = drop_loose_solids(built.solids, loose)
            left_out = specks | dropped
            built = passive.label(solids, patches, label_combined_solids(solids, *box))
            certificate = certify_kernel_solids(
                solids, patches, measures, notes=left_out.notes, dropped=left_out.volumes
            )
    passive.require_kept(dropped.volumes)
    return Model(
        "field solid",
        patches,
        certificate.with_seconds(stages.seconds),
        built,
        trimmed_by=made.trimmed_by,
        distance_to_reference=field_distance(field),
        envelope=Envelope.of_box("the field's box", *box),
    )


def _say_what_is_included(figures: Mapping[str, float]) -> dict[str, float]:
    """The figures, where the name of the field's volume says that it includes the pieces left out of the solid."""
    names = {FIELD_VOLUME: f"{FIELD_VOLUME} with the pieces left out"}
    return {names.get(name, name): value for name, value in figures.items()}


def _combine(field: Field, box: tuple[Array, Array], made: _Made, passive: PassiveRegions) -> _Made:
    """The solids with the bodies that are kept, and without those that are cleared."""

    def is_inside(points: Array) -> BoolArray:
        in_box = ((points > box[0]) & (points < box[1])).all(axis=1)
        found = np.zeros(len(points), bool)
        found[in_box] = field(points[in_box]) < 0
        return found

    combined = passive.combine(made.built, is_inside)
    measures = made.measures
    measures = replace(measures, notes=(*measures.notes, *combined.notes), checks=(*measures.checks, combined.check))
    trimmed_by = TRIMMED_PATCHES if isinstance(combined.built, BrepSolids) else KERNEL_BOOLEAN
    return _Made(combined.built, made.patches, measures, trimmed_by, valid=True)


def is_numeric_box(domain: Any) -> bool:
    """Whether the domain consists of numbers, as a box does."""
    if isinstance(domain, str | os.PathLike):
        return False
    try:
        np.asarray(domain, float)
    except Exception:  # conversions of foreign classes raise what they like
        return isinstance(domain, Sequence)
    return True


def parse_corners(domain: BoxCorners) -> tuple[np.ndarray, np.ndarray]:
    """The two corners (3,), (3,) of a box."""
    try:
        lo, hi = (np.asarray(point, float) for point in domain)
    except Exception as error:  # as above
        raise InvalidRequest(f"domain {show_value(domain)} must be two points ((x0, y0, z0), (x1, y1, z1))") from error
    return lo, hi
