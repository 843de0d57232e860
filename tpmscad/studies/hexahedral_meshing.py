"""Hexahedra of a lattice that ends in whole patches, through its trivariate splines: the checks and the mesh."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.lattices.spline_volumes import SplineVolumes
from tpmscad.meshing.hexahedra import mesh_hexahedra
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.splines.jacobian_bounds import bound_jacobian

MAX_HEXAHEDRA = 2_000_000
"""Elements of a mesh: their nodes and measures take some gigabytes."""

SplineSource = Callable[[], SplineVolumes | None] | None
"""What makes the trivariate splines of a solid; None if none fill it."""


def fill_with_splines(source: SplineSource, name: str) -> SplineVolumes:
    """The trivariate splines that fill a solid, with Jacobian determinants proved positive.

    InvalidRequest if none fill it, or if the normals of the wall cross: the message says where.
    """
    volumes = None if source is None else source()
    if volumes is None:
        raise InvalidRequest(
            f"the {name} is not made of whole walls between two surfaces: it is trimmed, one-sided, or has lost loose pieces: "
            'make a sheet with boundary="natural" and loose="keep", or use model.mesh(size)'
        )
    for number, body in enumerate(volumes.right_handed_primitives()):
        bound = bound_jacobian(body.bezier_nets())
        if not bound.positive:
            first = int(np.flatnonzero(volumes.carrier == number)[0])
            (u0, u1), (v0, v1), (w0, w1) = body.domain
            at = np.array([u0, v0, w0]) + np.array(bound.parameters) * [u1 - u0, v1 - v0, w1 - w0]
            place = volumes.motion[first].apply(body.grid(*at[:, None])[0, 0, 0])
            raise InvalidRequest(
                f"the wall of the {name} folds near ({', '.join(f'{x:.4g}' for x in place)}): the Jacobian determinant of its "
                f"trivariate spline is {bound.attained:.3g} there; make the wall thinner, the cell larger, or tol smaller"
            )
    return volumes


def mesh_by_splines(
    source: SplineSource, name: str, order: int, refine: tuple[int, int], serendipity: bool
) -> VolumeMesh:
    """The hexahedra of a solid; InvalidRequest for orders that do not exist, too many elements, or inverted ones."""
    if order not in (1, 2):
        raise InvalidRequest(f"order = {order} has no elements: 1 makes hexahedra of 8 nodes, 2 of 27 or 20")
    if serendipity and order == 1:
        raise InvalidRequest("hexahedra of 8 nodes have none inside: leave serendipity out, or ask for order=2")
    volumes = fill_with_splines(source, name)
    count = len(volumes) * (refine[0] + 1.0) ** 2 * (refine[1] + 1.0)
    if count > MAX_HEXAHEDRA:
        raise InvalidRequest(f"refine = {refine} makes {count:.3g} hexahedra, more than {MAX_HEXAHEDRA}: refine less")
    mesh = mesh_hexahedra(volumes, order, refine, serendipity=serendipity, name=name)
    inverted = mesh.quality.inverted
    if inverted:
        raise InvalidRequest(
            f"{inverted} of {mesh.n_cells} hexahedra of order {order} are not shown to be regular: the wall curves too much for "
            f"elements of their size: refine {refine[0] + 1} times{', or take order 2' if order == 1 else ''}"
        )
    return mesh
