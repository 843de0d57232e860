"""What is made of a body and a lattice of equal cells without their solid: layers and triangles begin with this."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.triangle_mesh import TriangleMesh
from tpmscad.fields.kinds.triangle_meshes import MeshField
from tpmscad.kernel.body_import.cad_body import CadBody, read_body
from tpmscad.kernel.boolean.hollow_body import resolve_open_faces
from tpmscad.requests.face_selection import resolve_face_selectors
from tpmscad.requests.lattice_options import InfillOptions
from tpmscad.requests.lattice_request import LatticeRequest, lattice_in_body, resolve_lattice_request, rotation_matrix
from tpmscad.solids.field_bodies import FieldBody, fit_field_body, reject_box, reject_solid, resolve_field
from tpmscad.stage_timer import StageTimer

TILE_CORNERS = np.array([[0.1237, 0.0871, 0.0631], [0.2913, 0.3371, 0.1913], [0.4421, 0.1193, 0.3677]])
"""In cells: lower corners of the cell that is repeated, out of symmetry planes; the next one is taken where a curve or a surface
touches a side."""


@dataclass(frozen=True, slots=True, eq=False)
class TiledBody:
    """A body, the faces of it that are open, and the lattice that fills it; `turn` (3, 3) takes lattice axes to the body's."""

    body: CadBody | TriangleMesh
    openings: tuple[object, ...]
    request: LatticeRequest
    turn: Array


def read_tiled_body(
    options: InfillOptions, instead: str, stages: StageTimer, *, as_triangles: bool = False
) -> TiledBody:
    """The body and the lattice of a request; InvalidRequest if it has no equal cells, with what to do `instead`.

    as_triangles: a triangle mesh stays one, it is not fitted.
    """
    if not isinstance(options.surface, str):
        raise InvalidRequest(f"without a solid only a lattice of equal cells can be made: name a surface, or {instead}")
    request, turn = resolve_lattice_request(lattice_in_body(options)), rotation_matrix(options.rotation)
    with stages("read"):
        field = resolve_field(options.body)
    fitted = None
    if field is not None:
        reject_solid(options.solid)
        if as_triangles and isinstance(field, MeshField) and options.skin is None and not options.open_faces:
            return TiledBody(field.mesh, (), request, turn)
        fitted = fit_field_body(field, options.box, request.tol, stages, is_default=options.tol is None)
        if isinstance(fitted, FieldBody) and options.skin is not None:
            raise InvalidRequest(f"a skin without a solid needs a CAD body: leave skin out, or {instead}")
    else:
        reject_box(options.box)
    with stages("read"):
        body = fitted.cad if isinstance(fitted, FieldBody) else read_body(fitted or options.body, options.solid)
        openings = resolve_open_faces(body, resolve_face_selectors(body, options.open_faces))
        if openings and options.skin is None:
            raise InvalidRequest("open_faces are left out of a skin: give skin=, its thickness")
    return TiledBody(body, openings, request, turn)
