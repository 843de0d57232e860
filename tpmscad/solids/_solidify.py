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
from functools import partial
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array, BoxCorners
from tpmscad.api.argument_kinds import show_value
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import LoosePieces, StageProgress
from tpmscad.api.shared_kinds import DOMAIN, EXECUTOR, FIELD, POSITIVE, SHAPE
from tpmscad.errors import CrossingSurfaces, InvalidRequest
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.kinds.data_domains import bound_data_in_body, settle_data
from tpmscad.fields.kinds.linear_extension import extend_level_sets_linearly
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.lattices.spline_maps import SplineMap
from tpmscad.levelset.crossing_operands import has_meeting_quadrics
from tpmscad.levelset.field_solid import validate_box
from tpmscad.results.loose_pieces import KEEP, drop_specks
from tpmscad.results.model import Model
from tpmscad.solids._infill import infill
from tpmscad.solids.cut import MadeSolids
from tpmscad.solids.finished_model import FIELD_VOLUME, finish_model
from tpmscad.solids.matter.crossing_fields import combine_field_solids, contains_in_box, label_combined_solids
from tpmscad.solids.matter.field_patches import fit_field_patches
from tpmscad.solids.matter.mapped_field import solidify_mapped
from tpmscad.solids.matter.patch_measures import measure_field_patches
from tpmscad.solids.matter.reference_distance import field_distance
from tpmscad.solids.passive_regions import NO_REGIONS, PassiveRegions
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
    if isinstance(domain, SplineMap):
        if keep is not None or clear is not None:
            raise InvalidRequest("keep and clear are for the solid in a box or a body, not under a map")
        return solidify_mapped(field, domain, tol, loose, executor, StageTimer(progress))
    if not is_numeric_box(domain):
        if executor is not None:
            raise InvalidRequest("an executor is for boxes; a body is filled by one process: leave executor out")
        body = read_body(domain)
        bounds = body.box
        matter = extend_level_sets_linearly(bound_data_in_body(as_field(field), *bounds), *bounds)
        return infill(body, matter, tol=tol, keep=keep, clear=clear, loose=loose, progress=progress)
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
    if has_meeting_quadrics(field, lo, hi, tol):
        return solidify_crossing(field, (lo, hi), tol, loose, stages, passive)
    field, specks = drop_specks(field, lo, hi, KEEP if passive.bodies else loose)
    try:
        found = fit_field_patches(field, lo, hi, tol, stages, executor=executor)
    except CrossingSurfaces:
        return solidify_crossing(field, (lo, hi), tol, loose, stages, passive)
    with stages("build"):
        built = build_solids(found.fitted.brep, found.moments)
    with stages("check"):
        measures = measure_field_patches(found)
        volumes = {FIELD_VOLUME: found.field_volume, "uncertainty of that volume": found.field_volume_error}
        measures = replace(measures, figures={**measures.figures, **volumes})
    made = MadeSolids(
        built,
        found.fitted.brep,
        measures,
        partial(contains_in_box, field, lo, hi),
        label=partial(label_combined_solids, lo=lo, hi=hi),
        valid=None,
        is_cut=False,
    )
    return _finish(field, (lo, hi), made, loose, passive, stages, specks=specks)


def solidify_crossing(
    field: Field,
    domain: tuple[Array, Array],
    tol: float,
    loose: str,
    stages: StageTimer,
    passive: PassiveRegions = NO_REGIONS,
) -> Model:
    """The solid of a field whose level sets cross, in a box."""
    made, remake = combine_field_solids(field, *domain, tol, stages)
    return _finish(field, domain, made, loose, passive, stages, remake=remake)


def _finish(
    field: Field,
    domain: tuple[Array, Array],
    made: MadeSolids,
    loose: str,
    passive: PassiveRegions,
    stages: StageTimer,
    **more: Any,
) -> Model:
    """The model of a field's solid in a box."""
    envelope = Envelope.of_box("the field's box", *domain)
    distance = field_distance(field)
    return finish_model(
        "field solid", made, loose, stages, envelope=envelope, distance=distance, passive=passive, **more
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
