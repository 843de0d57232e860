"""What is made of a body and a lattice of equal cells without their solid: layers and triangles begin with this."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.analysis.exact_leaves import is_of_struts
from tpmscad.fields.data.triangle_mesh import TriangleMesh
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.kinds.cores import CoreField
from tpmscad.fields.kinds.data_domains import bound_data_in_body
from tpmscad.fields.kinds.triangle_meshes import MeshField
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.requests.lattice_options import InfillOptions
from tpmscad.requests.lattice_request import (
    LatticeRequest,
    lattice_in_body,
    reject_lattice_options,
    resolve_lattice_request,
    rotation_matrix,
)
from tpmscad.solids.bodies.body_choice import find_body, leave_open
from tpmscad.solids.bodies.fitted_body import FittedBody, resolve_field
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.matter.field_matter import build_field_matter
from tpmscad.solids.passive_regions import PassiveRegions
from tpmscad.stage_timer import StageTimer

TILE_CORNERS = np.array([[0.1237, 0.0871, 0.0631], [0.2913, 0.3371, 0.1913], [0.4421, 0.1193, 0.3677]])
"""In cells: lower corners of the cell that is repeated, out of symmetry planes; the next one is taken where a curve or a surface
touches a side."""


@dataclass(frozen=True, slots=True, eq=False)
class TiledBody:
    """A body, the faces of it that are open, and what fills it: a lattice, struts or a core as a field, or closed matter.

    turn (3, 3) takes the axes of a lattice, or of a core whose cells are copied, to the body's. tol: of the filling. passive:
    what is kept and what is cleared of the filled body. name: of the filled body.
    """

    body: CadBody | TriangleMesh
    openings: tuple[object, ...]
    filling: LatticeRequest | Field | BrepSolids
    turn: Array
    tol: float
    passive: PassiveRegions
    name: str

    @property
    def request(self) -> LatticeRequest:
        """The lattice, where there is one."""
        assert isinstance(self.filling, LatticeRequest)
        return self.filling


def read_tiled_body(
    options: InfillOptions, instead: str, stages: StageTimer, *, as_triangles: bool = False, copies: bool = False
) -> TiledBody:
    """The body and what fills it; InvalidRequest if it cannot be made without a solid, with what to do `instead`.

    as_triangles: a triangle mesh stays one, it is not fitted. copies: the cells must be copies of one, and a core comes in its
    own axes.
    """
    if options.map is not None:
        raise InvalidRequest(f"without a solid nothing is made under a map: leave map out, or {instead}")
    if not isinstance(options.surface, str):
        if copies and not isinstance(options.surface, CoreField):
            raise InvalidRequest(
                f"only a lattice of equal cells, or a core, can be made of copies: name a surface or a core, or {instead}"
            )
        reject_lattice_options(options)
        if options.tol is None:
            raise InvalidRequest("the solid of a field needs tol=, its greatest deviation from the field")
        filling, tol, turn, name = None, options.tol, np.eye(3), ""
    else:
        filling, turn = resolve_lattice_request(lattice_in_body(options)), rotation_matrix(options.rotation)
        name = f"{filling.surface} infill"
        if copies or filling.kind == "skeletal":
            filling.require_even(instead)
        filling, tol = filling.turned(turn), filling.tol
        if as_triangles and options.skin is None and not options.open_faces and options.solid is None:
            with stages("read"):
                field = resolve_field(options.body)
            if isinstance(field, MeshField):
                passive = PassiveRegions.read(options.keep, options.clear)
                return TiledBody(field.mesh, (), filling, turn, tol, passive, name)
    body = find_body(options.body, options.box, options.solid, tol, stages, is_default=options.tol is None)
    if isinstance(body, FittedBody) and options.skin is not None:
        raise InvalidRequest(f"a skin without a solid needs a CAD body: leave skin out, or {instead}")
    body = leave_open(body, options.open_faces, options.skin, stages)
    opened = tuple(body.open_faces) if isinstance(body, KernelBody) else ()
    passive = PassiveRegions.read_for(body.cad, isinstance(body, KernelBody), options.keep, options.clear, options.skin)
    if filling is not None:
        return TiledBody(body.cad, opened, filling, turn, tol, passive.cut_within(body.cad), name)
    if copies and isinstance(options.surface, CoreField):
        core, axes = options.surface.facing_z()
        return TiledBody(body.cad, opened, core, axes, tol, passive, f"{core.structure} core")
    bounded = bound_data_in_body(as_field(options.surface), *body.cad.box)
    if is_of_struts(bounded):
        return TiledBody(body.cad, opened, bounded, turn, tol, passive.cut_within(body.cad), "field infill")
    matter = build_field_matter(bounded, body.cad, tol, stages)
    return TiledBody(
        body.cad, opened, build_solids(matter.closed), turn, tol, passive.cut_within(body.cad), matter.name
    )
