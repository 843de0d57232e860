"""A CAD body filled behind a skin whose inner side is a level set of the distance from the body.

Offset faces give a skin its exact thickness, but where they meet at creases, in points of tangency or in corners too sharp, no
arrangement of them closes. The distance from the triangles of the body has a level set there as everywhere: it is fitted as the
cavity of a field's solid is (`field_skin`), with its edges rounded, and the skin is up to 1.6 times as thick there. The faces of
the body stay exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tpmscad.errors import InvalidRequest, KernelError, LevelSetError, TrimmingError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import estimate_volume
from tpmscad.kernel.boolean.hollow_body import count_closed_cavities
from tpmscad.kernel.export.solid_mesh import mesh_solids
from tpmscad.kernel.measure.skin_depth import SkinDepth
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.solids.boolean_strategies import (
    TRIMMED_PATCHES,
    BooleanResult,
    compare_with_sample,
    sample_body,
    signed_distances_to_nodes,
)
from tpmscad.solids.field_bodies import MESH_ANGLE, join_meshes
from tpmscad.solids.field_body_infill import cut_voids
from tpmscad.solids.field_skin import ErosionSource, erode_by_distance
from tpmscad.solids.hollowing import subtract_trimmed_voids
from tpmscad.solids.lattice_block import LatticeBlock
from tpmscad.solids.skin import describe_closed_voids, fill_within_skin


def fill_by_distance(block: LatticeBlock, body: CadBody, skin: float, open_faces: Sequence[Any] = ()) -> BooleanResult:
    """As `fill_within_skin`, with the skin's inner side on patches of the distance; open faces are refused."""
    if open_faces:
        raise KernelError("skin by the distance", "it cannot leave out open faces")
    try:
        cavity = erode_by_distance(_describe_source(body), skin)
    except InvalidRequest as error:  # offset faces found points that are deeper, between these samples
        raise KernelError("skin by the distance", str(error)) from error
    voids = cut_voids(block, cavity)
    void = BooleanResult(voids.built, voids.brep, TRIMMED_PATCHES, ())
    hollowed = subtract_trimmed_voids(body, (), (void,), ())
    filled = sum(map(estimate_volume, hollowed.built.solids)) / body.volume
    points = sample_body(body)
    solid = (signed_distances_to_nodes(block.patches, points) < 0) | (cavity.field(points) >= 0)
    closed = describe_closed_voids(hollowed.closed_cavities, count_closed_cavities(body, ()), False)
    return BooleanResult(
        hollowed.built,
        hollowed.brep,
        TRIMMED_PATCHES,
        (*voids.notes, *closed),
        (*voids.checks, compare_with_sample(filled, solid, body.name)),
        (tuple(voids.shift.tolist()),),
    )


def _describe_source(body: CadBody) -> ErosionSource:
    """The triangles of a CAD body, and its distances from points by the kernel."""
    depth = SkinDepth(body.shape, faces_of(body.shape))
    return ErosionSource(
        body.name,
        body.report.max_tolerance,
        lambda deviation: join_meshes(mesh_solids(body.shape, deviation, MESH_ANGLE)),
        depth.distances,
    )


SKIN_METHODS = Fallbacks(
    (
        Fallback("offset faces", fill_within_skin, "one to three seconds"),
        Fallback("the distance from the body's triangles", fill_by_distance, "one to five minutes"),
    ),
    retry_on=(KernelError, TrimmingError, LevelSetError),
    final=(InvalidRequest,),
    remedy="shift the lattice by `phase`, or give a larger `tol`",
)
"""How a body is filled behind a skin."""
