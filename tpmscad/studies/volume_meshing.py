"""Volume meshes of models, of fluid domains and of STEP files: gmsh's tetrahedra on the exact faces, with named groups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import BoxCorners
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.export.alike_sides import make_sides_alike
from tpmscad.kernel.export.brep_file import number_distinct_faces, write_plain_brep
from tpmscad.kernel.export.short_edges import merge_short_edges
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.meshing.tetrahedra import MeshRequest, SolidFaces, mesh_tetrahedra
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.requests.study_options import MeshOptions
from tpmscad.stage_timer import StageTimer

MAX_ELEMENTS = 50_000_000
"""Elements that a box of the solid's volume has at the size wanted; more are taken for a mistake of units."""

EDGES_CUBED_OF_A_TETRAHEDRON = 8.5
"""Cube of a regular tetrahedron's edge over its volume, 6 sqrt(2)."""


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
    found = merge_short_edges([of.solid for of in solids], low, high, request.same)
    shapes, moved = found.solids, found.moved
    if request.periodic:
        shapes, by_sides = make_sides_alike(shapes, low, high, request.same, request.reach)
        moved = max(moved, by_sides)
    numbers, places = number_distinct_faces(shapes)
    labels: list[list[tuple[str, str]]] = [[] for _ in places]
    several, openings = len(set(regions)) > 1, set()
    for own, kept, of, region in zip(numbers, found.faces, solids, regions, strict=True):
        for face, number in zip(own.tolist(), kept, strict=True):
            labels[face].append((region, of.labels[number]))
        openings |= {_name_group(region, label, several) for label in of.openings}
    groups = tuple(_face_groups(of, several) for of in labels)
    openings &= {name for of in groups for name in of}
    faces = SolidFaces(tuple(regions), groups, places, low, high)
    with TemporaryDirectory() as folder, stages("mesh"):
        file = Path(folder) / "solids.brep"
        write_plain_brep(shapes, file)
        mesh = mesh_tetrahedra(file, faces, request, name)
    return replace(mesh, openings=frozenset(openings), moved=max(moved, mesh.moved), merged=found.merged)


def _face_groups(uses: Sequence[tuple[str, str]], several: bool) -> tuple[str, ...]:
    """Groups of a face, given the region and label of each solid that it bounds."""
    regions = list(dict.fromkeys(region for region, _ in uses))
    if len(regions) > 1:
        return (" | ".join(regions),)
    return tuple(dict.fromkeys(_name_group(region, label, several) for region, label in uses))


def _name_group(region: str, label: str, several: bool) -> str:
    """The group of a face that bounds one region."""
    return f"{region}: {label}" if several else label


def _read_request(options: MeshOptions) -> MeshRequest:
    """The request of a call; InvalidRequest for an order that is neither 1 nor 2."""
    if options.order not in (1, 2):
        raise InvalidRequest(
            f"order = {options.order} is neither 1 nor 2, the orders of tetrahedra that gmsh curves reliably"
        )
    return MeshRequest(options.size, options.order, options.periodic, options.per_turn)
