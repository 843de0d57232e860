"""A CAD body filled with a lattice, or with the solid of a field, as one certified solid.

Without a skin the result is the intersection of body and lattice. With a skin it is the body without the voids that the lattice
leaves deeper than the skin: the body is offset inwards, the lattice is subtracted from the offset body, and what remains is
subtracted from the body.
"""

from __future__ import annotations

from dataclasses import fields

from tpmscad.api.public_calls import validate_options
from tpmscad.errors import CrossingSurfaces, InvalidRequest, TrimmingError
from tpmscad.fields.analysis.crease_network import describe_creases, trace_creases
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.kinds.data_domains import bound_data_in_body
from tpmscad.kernel.body_import.cad_body import CadBody, read_bodies
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.boolean.cut_faces import UNKNOWN, label_cut_solids
from tpmscad.kernel.boolean.hollow_body import resolve_open_faces
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.levelset.crossing_operands import has_meeting_quadrics
from tpmscad.requests.face_selection import is_numbered, list_given_faces, resolve_face_selectors
from tpmscad.requests.lattice_options import InfillOptions
from tpmscad.requests.lattice_request import lattice_in_body, resolve_lattice_request, rotation_matrix
from tpmscad.results.certificate import certify_kernel_solids
from tpmscad.results.joined_models import join_models
from tpmscad.results.loose_pieces import drop_loose_solids
from tpmscad.results.model import Model
from tpmscad.solids.boolean_strategies import (
    KERNEL_BOOLEAN,
)
from tpmscad.solids.combined_solids import SURFACE, combine_field_solids
from tpmscad.solids.field_bodies import FieldBody, fit_field_body, reject_box, reject_solid, resolve_field
from tpmscad.solids.field_body_infill import infill_field_body, reject_empty
from tpmscad.solids.filled_body import check_wall_thickness, fill_body
from tpmscad.solids.lattice_block import build_field_block, build_lattice_block, expand_body_box, name_box_of_body
from tpmscad.solids.reference_distance import field_distance, lattice_distance
from tpmscad.stage_timer import StageTimer

OPTIONS_OF_FIELDS = ("body", "box", "surface", "solid", "skin", "open_faces", "loose", "tol", "progress")
"""Arguments that the solid of a field takes."""


@validate_options(InfillOptions, 'infill(body, "gyroid", cell=8, thickness=0.8, skin=1.5)')
def infill(options: InfillOptions) -> Model:
    """Fill a CAD body with a lattice of a minimal surface, or with the solid of a field.

    The lattice is anchored at the origin of the body's coordinates. The faces of the body stay exact. Of several solids each is
    filled by itself; where they touch, the fillings touch and are not joined.

    Returns
    -------
    Model
        The solid and its certificate; `certificate.met` is False if the result misses the request.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    LevelSetError
        If a field cannot be made a solid in the body's box.
    KernelError
        If all methods of trimming fail.

    Examples
    --------
    >>> model = tpmscad.infill("bracket.step", "gyroid", cell=8, thickness=0.8, skin=1.5)  # doctest: +SKIP
    >>> model.export_step("filled.step")  # doctest: +SKIP
    """
    stages = StageTimer(options.progress)
    with stages("read"):
        field = resolve_field(options.body)
    if field is not None:
        reject_solid(options.solid)
        body = fit_field_body(field, options.box, _find_tolerance(options), stages, is_default=options.tol is None)
        return (
            _infill_field_body(body, options, stages) if isinstance(body, FieldBody) else _fill(options, body, stages)
        )
    reject_box(options.box)
    with stages("read"):
        bodies = read_bodies(options.body, options.solid)
    if len(bodies) == 1:
        return _fill(options, bodies[0], stages)
    if any(not isinstance(face, str) or is_numbered(face) for face in list_given_faces(options.open_faces)):
        raise InvalidRequest(
            "numbers in open_faces are those of one solid: select the open faces of several as '>Z,<Z' does"
        )
    models = {body.title: _fill(options, body, stages) for body in bodies}
    name = f"{options.surface} infill" if isinstance(options.surface, str) else "field infill"
    return join_models(name, models, stages.seconds, "the bodies")


def _fill(options: InfillOptions, read: CadBody, stages: StageTimer) -> Model:
    """One body filled."""
    surface, skin = options.surface, options.skin
    with stages("read"):
        openings = resolve_open_faces(read, resolve_face_selectors(read, options.open_faces))
        if openings and skin is None:
            raise InvalidRequest("open_faces are left out of a skin: give skin=, its thickness")
    if isinstance(surface, str):
        request = resolve_lattice_request(lattice_in_body(options))
        check_wall_thickness(request)
        turn = rotation_matrix(options.rotation)
        block, name = build_lattice_block(request, turn, read, stages), f"{request.surface} infill"
        distance = lattice_distance(request, None, turn)
    else:
        _reject_lattice_options(options)
        surface = bound_data_in_body(as_field(surface), *enclosing_box(read.shape))
        if skin is None and options.tol is not None and _has_meeting_quadrics(surface, read, options.tol):
            return _infill_crossing(surface, read, options, stages)
        try:
            block, name = build_field_block(surface, read, options.tol, stages), "field infill"
        except CrossingSurfaces as error:
            if skin is not None:
                creases = trace_creases(surface, *enclosing_box(read.shape))
                raise InvalidRequest(
                    f"{describe_creases(creases) or error}: within a skin the field must be smooth; round it (`width` of a "
                    "smooth intersection or union), or leave skin out, and make it one of the field's operands"
                ) from error
            return _infill_crossing(surface, read, options, stages)
        distance = field_distance(surface)
    return fill_body(block, read, skin, openings, options.loose, stages, name, distance)


def _find_tolerance(options: InfillOptions) -> float:
    """The tolerance of the body's patches and the lattice's."""
    if isinstance(options.surface, str):
        return resolve_lattice_request(lattice_in_body(options)).tol
    if options.tol is None:
        raise InvalidRequest("the solid of a field needs tol=, its greatest deviation from the field")
    return options.tol


def _infill_field_body(body: FieldBody, options: InfillOptions, stages: StageTimer) -> Model:
    """The solid of a field filled with a lattice or with the solid of another field."""
    surface = options.surface
    if list(options.open_faces):
        raise InvalidRequest(
            f"open_faces are plane faces of a CAD body; {body.name} has none: leave open_faces out, and bore through the skin"
        )
    if isinstance(surface, str):
        request = resolve_lattice_request(lattice_in_body(options))
        check_wall_thickness(request)
        turn = rotation_matrix(options.rotation)
        block, name = build_lattice_block(request, turn, body.cad, stages), f"{request.surface} infill"
        distance = lattice_distance(request, None, turn)
    else:
        _reject_lattice_options(options)
        surface = bound_data_in_body(as_field(surface), *enclosing_box(body.cad.shape))
        block, name = build_field_block(surface, body.cad, options.tol, stages), "field infill"
        distance = field_distance(surface)
    try:
        return infill_field_body(body, block, options.skin, options.loose, stages, name, distance)
    except TrimmingError as error:
        raise reject_empty(error, body) from error


def _has_meeting_quadrics(field: Field, body: CadBody, tol: float) -> bool:
    """Whether level sets of a field are known to cross in the box of a body, before they are sampled and fitted."""
    return tol > 0 and has_meeting_quadrics(field, *expand_body_box(*enclosing_box(body.shape)), tol)


def _infill_crossing(field: Field, body: CadBody, options: InfillOptions, stages: StageTimer) -> Model:
    """The solid of a field whose level sets cross, in a body."""
    assert options.tol is not None  # `build_field_block` asks for it
    box = expand_body_box(*enclosing_box(body.shape))
    with name_box_of_body(body):
        combined = combine_field_solids(field, *box, options.tol, stages, body)
    solids, dropped = drop_loose_solids(combined.built.solids, options.loose)
    with stages("check"):
        labelled = label_cut_solids(solids, [combined.patches], body)
        labels = tuple(tuple(SURFACE if label == UNKNOWN else label for label in of) for of in labelled.labels)
        notes = (*body.notes, *dropped.notes)
        certificate = certify_kernel_solids(
            solids, combined.patches, combined.measures, notes=notes, dropped=dropped.volumes
        )
    return Model(
        "field infill",
        combined.patches,
        certificate.with_seconds(stages.seconds),
        OcctSolids(solids, labels),
        trimmed_by=KERNEL_BOOLEAN,
        distance_to_reference=field_distance(field),
        envelope=Envelope(body.name, body.volume, body.shape),
    )


def _reject_lattice_options(options: InfillOptions) -> None:
    """InvalidRequest for keywords of a lattice together with a field, which defines the whole shape."""
    extra = [
        field.name
        for field in fields(options)
        if field.name not in OPTIONS_OF_FIELDS and getattr(options, field.name) != field.default
    ]
    if extra:
        raise InvalidRequest(
            f"a field is taken as it is: leave {', '.join(extra)} out, and scale or turn the field itself"
        )
