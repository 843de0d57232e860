"""Any implicit field as a certified NURBS solid.

The level set {field = 0} is fitted by B-spline patches in the box (`field_patches`), closed by planar caps, built into kernel
solids and measured: deviation in both directions, continuity, validity, Betti numbers, and the volume by two independent
quadratures (of the patches, and of the field along grid lines).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import BoxCorners
from tpmscad.api.argument_kinds import show_value
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import LoosePieces, StageProgress
from tpmscad.api.shared_kinds import DOMAIN, EXECUTOR, FIELD, POSITIVE
from tpmscad.errors import CrossingSurfaces, InvalidRequest
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.kinds.linear_extension import extend_level_sets_linearly
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.lattices.spline_maps import SplineMap
from tpmscad.levelset.crossing_operands import has_meeting_quadrics
from tpmscad.levelset.field_solid import validate_box
from tpmscad.results.certificate import certify_built_solids, certify_kernel_solids
from tpmscad.results.loose_pieces import drop_loose_pieces, drop_loose_solids, drop_specks
from tpmscad.results.model import Model
from tpmscad.solids._infill import infill
from tpmscad.solids.boolean_strategies import KERNEL_BOOLEAN, TRIMMED_PATCHES
from tpmscad.solids.combined_solids import combine_field_solids, label_combined_solids
from tpmscad.solids.field_mapping import solidify_mapped
from tpmscad.solids.field_patches import fit_field_patches
from tpmscad.solids.patch_measures import measure_field_patches
from tpmscad.solids.reference_distance import field_distance
from tpmscad.stage_timer import StageTimer


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
    if isinstance(domain, SplineMap):
        return solidify_mapped(field, domain, tol, loose, executor, StageTimer(progress))
    if not is_numeric_box(domain):
        if executor is not None:
            raise InvalidRequest("an executor is for boxes; a body is filled by one process: leave executor out")
        body = read_body(domain)
        bounds = enclosing_box(body.shape)
        return infill(
            body, extend_level_sets_linearly(as_field(field), *bounds), tol=tol, loose=loose, progress=progress
        )
    stages = StageTimer(progress)
    if has_meeting_quadrics(as_field(field), *validate_box(*parse_corners(domain), tol), tol):
        return solidify_crossing(as_field(field), domain, tol, loose, stages)
    field, specks = drop_specks(as_field(field), *parse_corners(domain), loose)
    try:
        found = fit_field_patches(field, *parse_corners(domain), tol, stages, executor=executor)
    except CrossingSurfaces:
        return solidify_crossing(as_field(field), domain, tol, loose, stages)
    with stages("build"):
        brep, built, dropped = drop_loose_pieces(
            found.fitted.brep, build_solids(found.fitted.brep, found.moments), loose
        )
    with stages("check"):
        whole = " with the pieces left out" if dropped.volumes else ""
        volumes = {
            f"volume of the field{whole}": found.field_volume,
            "uncertainty of that volume": found.field_volume_error,
        }
        measures = measure_field_patches(found)
        measures = replace(measures, figures={**measures.figures, **volumes})
        left_out = specks | dropped
        certificate = certify_built_solids(built, measures, notes=left_out.notes, dropped=left_out.volumes)
    return Model(
        "field solid",
        brep,
        certificate.with_seconds(stages.seconds),
        built,
        distance_to_reference=field_distance(field),
        envelope=Envelope.of_box("the field's box", *parse_corners(domain)),
    )


def solidify_crossing(field: Field, domain: BoxCorners, tol: float, loose: str, stages: StageTimer) -> Model:
    """The solid of a field whose level sets cross, in a box."""
    combined = combine_field_solids(field, *parse_corners(domain), tol, stages)
    built, patches, trimmed_by = combined.built, combined.patches, KERNEL_BOOLEAN
    with stages("check"):
        if isinstance(built, BrepSolids):
            patches, built, dropped = drop_loose_pieces(patches, built, loose)
            trimmed_by = TRIMMED_PATCHES
            certificate = certify_built_solids(
                built, combined.measures, valid=True, notes=dropped.notes, dropped=dropped.volumes
            )
        else:
            solids, dropped = drop_loose_solids(built.solids, loose)
            built = label_combined_solids(solids, *parse_corners(domain))
            certificate = certify_kernel_solids(
                solids, patches, combined.measures, notes=dropped.notes, dropped=dropped.volumes
            )
    return Model(
        "field solid",
        patches,
        certificate.with_seconds(stages.seconds),
        built,
        trimmed_by=trimmed_by,
        distance_to_reference=field_distance(field),
        envelope=Envelope.of_box("the field's box", *parse_corners(domain)),
    )


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
