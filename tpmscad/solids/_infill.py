"""A CAD body filled with a lattice, or with the solid of a field, as one certified solid.

Without a skin the result is the intersection of body and lattice. With a skin it is the body without the voids that the lattice
leaves deeper than the skin: the body is offset inwards, the lattice is subtracted from the offset body, and what remains is
subtracted from the body.
"""

from __future__ import annotations

from dataclasses import replace

from tpmscad.api.public_calls import validate_options
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import as_field
from tpmscad.fields.kinds.data_domains import bound_data_in_body
from tpmscad.fields.kinds.strut_graphs import StrutsField, map_struts
from tpmscad.lattices.coordinate_maps import as_map
from tpmscad.requests.face_selection import is_numbered, list_given_faces
from tpmscad.requests.lattice_options import InfillOptions
from tpmscad.requests.lattice_request import (
    lattice_in_body,
    reject_lattice_options,
    resolve_lattice_request,
    rotation_matrix,
)
from tpmscad.requests.named_matter import resolve_named_matter
from tpmscad.results.joined_models import join_models
from tpmscad.results.model import Model
from tpmscad.solids.bodies.body_choice import Body, find_bodies, leave_open
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.cut import Matter
from tpmscad.solids.filled_body import fill_body
from tpmscad.solids.matter.field_matter import build_field_matter
from tpmscad.solids.matter.lattice_block import build_lattice_block
from tpmscad.solids.matter.mapped_cover import build_mapped_block
from tpmscad.solids.passive_regions import PassiveRegions, divide_kept
from tpmscad.stage_timer import StageTimer


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
    name = f"{options.surface} infill" if isinstance(options.surface, str) else "field infill"
    options, stages = resolve_named_matter(options), StageTimer(options.progress)
    tol = _find_tolerance(options)
    bodies = find_bodies(options.body, options.box, options.solid, tol, stages, is_default=options.tol is None)
    if len(bodies) == 1:
        return _fill(options, bodies[0], tol, stages)
    if any(not isinstance(face, str) or is_numbered(face) for face in list_given_faces(options.open_faces)):
        raise InvalidRequest(
            "numbers in open_faces are those of one solid: select the open faces of several as '>Z,<Z' does"
        )
    with stages("read"):
        kept = divide_kept(options.keep, [body for body in bodies if isinstance(body, KernelBody)])
    models = {
        body.cad.title: _fill(replace(options, keep=own or None), body, tol, stages)
        for body, own in zip(bodies, kept, strict=True)
    }
    return join_models(name, models, stages.seconds, "the bodies")


def _find_tolerance(options: InfillOptions) -> float:
    """The tolerance of the matter's patches and of a body's."""
    if isinstance(options.surface, str):
        return resolve_lattice_request(lattice_in_body(options)).tol
    if options.tol is None:
        raise InvalidRequest("the solid of a field needs tol=, its greatest deviation from the field")
    return options.tol


def _fill(options: InfillOptions, body: Body, tol: float, stages: StageTimer) -> Model:
    """One body filled."""
    with stages("read"):
        is_exact = isinstance(body, KernelBody)
        passive = PassiveRegions.read_for(body.cad, is_exact, options.keep, options.clear, options.skin)
    body = leave_open(body, options.open_faces, options.skin, stages)
    if isinstance(options.surface, str):
        request, turn = resolve_lattice_request(lattice_in_body(options)), rotation_matrix(options.rotation)
        matter: Matter
        if options.map is None:
            matter = build_lattice_block(request, turn, body.cad, stages)
        else:
            matter = build_mapped_block(request, options.map, turn, body.cad, stages)
    else:
        reject_lattice_options(options)
        field = as_field(options.surface)
        if options.map is not None:
            if not isinstance(field, StrutsField):
                raise InvalidRequest(
                    "a map takes a surface of the catalogue, or struts, to the model: of another field make the solid with "
                    "solidify(field, map), which ends in the faces of the map, or put the map into the field"
                )
            field = map_struts(field, as_map(options.map))
        field = bound_data_in_body(field, *body.cad.box)
        matter = build_field_matter(field, body.cad, tol, stages)
    return fill_body(body, matter, options.skin, options.loose, stages, passive)
