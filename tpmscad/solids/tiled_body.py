"""What is made of a body and a lattice of equal cells without their solid: layers and triangles begin with this."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.triangle_mesh import TriangleMesh
from tpmscad.fields.kinds.triangle_meshes import MeshField
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.requests.lattice_options import InfillOptions
from tpmscad.requests.lattice_request import LatticeRequest, lattice_in_body, resolve_lattice_request, rotation_matrix
from tpmscad.solids.bodies.body_choice import find_body, leave_open
from tpmscad.solids.bodies.fitted_body import FittedBody, resolve_field
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.passive_regions import PassiveRegions
from tpmscad.stage_timer import StageTimer

TILE_CORNERS = np.array([[0.1237, 0.0871, 0.0631], [0.2913, 0.3371, 0.1913], [0.4421, 0.1193, 0.3677]])
"""In cells: lower corners of the cell that is repeated, out of symmetry planes; the next one is taken where a curve or a surface
touches a side."""


@dataclass(frozen=True, slots=True, eq=False)
class TiledBody:
    """A body, the faces of it that are open, and the lattice that fills it; `turn` (3, 3) takes lattice axes to the body's.

    passive: what is kept and what is cleared of the filled body.
    """

    body: CadBody | TriangleMesh
    openings: tuple[object, ...]
    request: LatticeRequest
    turn: Array
    passive: PassiveRegions


def read_tiled_body(
    options: InfillOptions, instead: str, stages: StageTimer, *, as_triangles: bool = False
) -> TiledBody:
    """The body and the lattice of a request; InvalidRequest if it has no equal cells, with what to do `instead`.

    as_triangles: a triangle mesh stays one, it is not fitted.
    """
    if not isinstance(options.surface, str):
        raise InvalidRequest(f"without a solid only a lattice of equal cells can be made: name a surface, or {instead}")
    if options.map is not None:
        raise InvalidRequest(f"without a solid only a lattice of equal cells can be made: leave map out, or {instead}")
    request, turn = resolve_lattice_request(lattice_in_body(options)), rotation_matrix(options.rotation)
    request.require_even(instead)
    if as_triangles and options.skin is None and not options.open_faces and options.solid is None:
        with stages("read"):
            field = resolve_field(options.body)
        if isinstance(field, MeshField):
            return TiledBody(field.mesh, (), request, turn, PassiveRegions.read(options.keep, options.clear))
    body = find_body(options.body, options.box, options.solid, request.tol, stages, is_default=options.tol is None)
    if isinstance(body, FittedBody) and options.skin is not None:
        raise InvalidRequest(f"a skin without a solid needs a CAD body: leave skin out, or {instead}")
    body = leave_open(body, options.open_faces, options.skin, stages)
    opened = tuple(body.open_faces) if isinstance(body, KernelBody) else ()
    passive = PassiveRegions.read_for(body.cad, isinstance(body, KernelBody), options.keep, options.clear)
    return TiledBody(body.cad, opened, request, turn, passive.cut_within(body.cad))
