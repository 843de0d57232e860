"""Volume meshes of models, of fluid domains and of STEP files: the checks, the mesh and its named groups.

gmsh makes tetrahedra on the exact faces. Hexahedra and trivariate splines come from a lattice that ends in whole patches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import BoxCorners
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.export.brep_file import number_distinct_faces, write_plain_brep
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.lattices.spline_volumes import SplineVolumes
from tpmscad.meshing.gismo_files import write_gismo
from tpmscad.meshing.hexahedra import mesh_hexahedra
from tpmscad.meshing.tetrahedra import MeshRequest, SolidFaces, mesh_tetrahedra
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.requests.study_options import MeshOptions
from tpmscad.splines.jacobian_bounds import bound_jacobian
from tpmscad.stage_timer import StageTimer

MAX_ELEMENTS = 50_000_000
"""Elements that a box of the solid's volume has at the size wanted; more are taken for a mistake of units."""

EDGES_CUBED_OF_A_TETRAHEDRON = 8.5
"""Cube of a regular tetrahedron's edge over its volume, 6 sqrt(2)."""

MAX_HEXAHEDRA = 2_000_000
"""Elements of a mesh: their nodes and measures take some gigabytes."""

SplineSource = Callable[[], SplineVolumes | None] | None
"""What makes the trivariate splines of a solid; None if none fill it."""


def mesh_named_solids(
    solids: Sequence[NamedSolid],
    regions: Sequence[str],
    bounds: BoxCorners,
    options: MeshOptions,
    *,
    name: str,
) -> VolumeMesh:
    """Mesh solids; those that share faces share the nodes there.

    `regions` names the group of each solid's elements. The groups of its facets are the labels of its faces, and of several
    regions "REGION: LABEL"; facets between two regions are the group "REGION | REGION", the first named first. Raises as
    `Model.mesh`.
    """
    request = _read_request(options)
    import_extra("gmsh", "meshes of tetrahedra", "mesh")  # before the work
    low, high = np.asarray(bounds, float)
    volume = float(np.prod(high - low))
    count = EDGES_CUBED_OF_A_TETRAHEDRON * volume / request.size**3
    if count > MAX_ELEMENTS:
        raise InvalidRequest(
            f"size = {request.size:g} makes about {count:.2g} elements in a box of {volume:.3g} mm3; {MAX_ELEMENTS:.0e} is the "
            "limit: the size is the length of an edge in mm"
        )
    stages = StageTimer(options.progress)
    numbers, places = number_distinct_faces([of.solid for of in solids])
    labels: list[list[tuple[str, str]]] = [[] for _ in places]
    for own, of, region in zip(numbers, solids, regions, strict=True):
        for face, label in zip(own.tolist(), of.labels, strict=True):
            labels[face].append((region, label))
    several = len(set(regions)) > 1
    faces = SolidFaces(tuple(regions), tuple(_face_groups(found, several) for found in labels), places, low, high)
    with TemporaryDirectory() as folder, stages("mesh"):
        file = Path(folder) / "solids.brep"
        write_plain_brep([of.solid for of in solids], file)
        return mesh_tetrahedra(file, faces, request, name)


def _face_groups(uses: Sequence[tuple[str, str]], several: bool) -> tuple[str, ...]:
    """Groups of a face, given the region and label of each solid that it bounds."""
    regions = list(dict.fromkeys(region for region, _ in uses))
    if len(regions) > 1:
        return (" | ".join(regions),)
    return tuple(dict.fromkeys(f"{region}: {label}" if several else label for region, label in uses))


def _read_request(options: MeshOptions) -> MeshRequest:
    """The request of a call; InvalidRequest for an order that is neither 1 nor 2."""
    if options.order not in (1, 2):
        raise InvalidRequest(
            f"order = {options.order} is neither 1 nor 2, the orders of tetrahedra that gmsh curves reliably"
        )
    return MeshRequest(options.size, options.order, options.periodic, options.per_turn)


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


def write_splines(source: SplineSource, name: str, path: str | Path) -> None:
    """Write the trivariate splines of a solid as G+Smo's XML."""
    target = validate_output_path(path, (".xml",))
    write_gismo(fill_with_splines(source, name), target)
