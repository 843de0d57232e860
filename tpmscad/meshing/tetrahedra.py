"""Tetrahedra of first or second order in solids, by gmsh.

Corners lie on the exact surface, and so do the middles of edges of second order. gmsh's HXT makes the elements. A flat element
with four corners on a face would be turned over by the curvature of the face, so such elements are removed before curving;
elements that curving turns over are repaired by the elastic analogy, and at last by straight edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import KernelError
from tpmscad.meshing.editable_mesh import FacesOfFacets
from tpmscad.meshing.element_shapes import TETRA_EDGES, TRIANGLE_EDGES, jacobian_coefficients
from tpmscad.meshing.facet_search import find_facets
from tpmscad.meshing.gmsh_model import (
    GMSH_TETRAHEDRA,
    GMSH_TRIANGLES,
    check_faces,
    match_sides,
    open_model,
    read_elements,
    read_nodes,
)
from tpmscad.meshing.mesh_arrays import AXES, sort_nodes
from tpmscad.meshing.mesh_improvement import improve_poor_elements
from tpmscad.meshing.msh_files import GMSH_KINDS
from tpmscad.meshing.volume_mesh import VolumeMesh

SURFACE_SIZE = 0.83
"""Of the element size wanted, what gmsh is told: it keeps to that on faces and makes elements inside 1.4 times as long."""

SAME_PLACE = 0.01
"""In element sizes: distance along an edge in a side of the box up to which a vertex and the image of one in the opposite side
are one place."""

SIDES_APART = 0.05
"""In element sizes: distance up to which the curves in opposite sides may miss each other, where nodes are moved to images. Those
of a fitted field agree within twice its tolerance, which is thus for elements of 40 tolerances at least."""

ON_SIDE = 1e-5
"""Model units: distance from a side of the box up to which the middle of an edge in a face of the side lies in the side."""

HXT, ELASTIC_ANALOGY = 10, 3
"""gmsh's numbers of algorithms for elements and for curving."""


@dataclass(frozen=True, slots=True)
class MeshRequest:
    """What mesh is wanted.

    size : mean edge length, model units
    order : 1 or 2
    periodic : whether opposite sides of the box have the same nodes
    per_turn : elements along a full turn of curvature at least, or None
    """

    size: float
    order: int = 2
    periodic: bool = False
    per_turn: int | None = None

    @property
    def same(self) -> float:
        """Distance up to which vertices are one place, model units."""
        return SAME_PLACE * self.size

    @property
    def reach(self) -> float:
        """Distance up to which curves and nodes in opposite sides are images, model units."""
        return SIDES_APART * self.size

    def options(self) -> dict[str, float]:
        """Gmsh's options."""
        return {
            "Mesh.MeshSizeMax": SURFACE_SIZE * self.size,
            "Mesh.MeshSizeFromPoints": 0,
            "Mesh.MeshSizeFromCurvature": self.per_turn or 0,
            "Mesh.MeshSizeExtendFromBoundary": 0 if self.per_turn is None else 1,
            "Mesh.Algorithm3D": HXT,  # its worst element is ten times better than that of the default here
            "Mesh.OptimizeThreshold": 0.5,  # more than the default: removes flat elements on faces
            "Mesh.ElementOrder": self.order,
            "Mesh.HighOrderOptimize": ELASTIC_ANALOGY if self.order == 2 else 0,
            # nodes stay on the surface, and periodic ones at their images; optimisation would move them, and takes minutes
            "Mesh.HighOrderFixBoundaryNodes": 1,
        }


@dataclass(frozen=True, slots=True, eq=False)
class SolidFaces:
    """What gmsh does not know of the solids of a BREP file.

    solids : group of each solid, in the order of the file
    groups : groups of each distinct face, in the order of the file
    places : (n, 3) mean of each distinct face's vertices
    low, high : (3,) corners of the box around the solids
    """

    solids: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    places: Array
    low: Array
    high: Array


def mesh_tetrahedra(brep_file: Path, faces: SolidFaces, request: MeshRequest, name: str = "part") -> VolumeMesh:
    """Mesh the solids of a BREP file.

    Raises InvalidRequest if gmsh is missing or opposite sides differ; KernelError if gmsh fails or elements stay inverted.
    """
    mesh = untangle(_generate(brep_file, faces, request))
    inverted = mesh.quality.inverted
    if inverted:
        raise KernelError(
            "mesh",
            f"{inverted} of {mesh.n_cells} elements are inverted at size = {request.size:g}: ask for smaller ones",
        )
    return replace(mesh, name=name)


def _generate(brep_file: Path, faces: SolidFaces, request: MeshRequest) -> VolumeMesh:
    """The mesh as gmsh makes it, with its groups and periodic pairs, and its poor elements repaired."""
    kinds = ("tetra", "triangle") if request.order == 1 else ("tetra10", "triangle6")
    with open_model(brep_file, request.options()) as gmsh:
        face_tags = check_faces(gmsh, faces.places)
        matched = {
            axis: match_sides(gmsh, axis, float(faces.low[axis]), float(faces.high[axis]), request.reach)
            for axis in range(3 if request.periodic else 0)
        }
        try:
            gmsh.model.mesh.generate(3)
        except Exception as error:  # gmsh raises Exception itself
            raise KernelError("mesh", f"gmsh fails at size = {request.size:g}: {error}") from error
        points, row = read_nodes(gmsh)
        volumes = sorted(tag for _, tag in gmsh.model.getEntities(3))
        blocks = [read_elements(gmsh, tag, GMSH_TETRAHEDRA[request.order], row) for tag in volumes]
        sides = [read_elements(gmsh, tag, GMSH_TRIANGLES[request.order], row)[:, :3] for tag in face_tags]
        cells = {kinds[0]: np.concatenate(blocks)[:, np.argsort(GMSH_KINDS[kinds[0]][1])]}
        facets = {kinds[1]: find_facets(cells, kinds[1], np.concatenate(sides))}
        counts = list(map(len, sides))
        mesh = VolumeMesh(
            points,
            cells,
            facets,
            _number_groups([(name,) for name in faces.solids], list(map(len, blocks))),
            _number_groups(faces.groups, counts),
        )
        face_of = np.repeat(face_tags, counts)
        ends = {axis: tuple(np.isin(face_of, tags) for tags in ends) for axis, ends in matched.items() if ends[0]}
        paired = pair_sides(sort_nodes(mesh), ends, faces.low, faces.high, request.reach)

        def project(face: int, point: Array) -> Array:
            return np.array(gmsh.model.getClosestPoint(2, face, point.tolist())[0])

        return improve_poor_elements(paired, request.size, FacesOfFacets(face_of, project))


def _number_groups(groups: Sequence[tuple[str, ...]], counts: Sequence[int]) -> dict[str, IntArray]:
    """Numbers of the elements in each group, given the groups and the number of elements of each entity in turn."""
    starts = np.cumsum([0, *counts])
    found: dict[str, list[IntArray]] = {}
    for names, start, end in zip(groups, starts[:-1], starts[1:], strict=True):
        for name in names:
            found.setdefault(name, []).append(np.arange(start, end))
    return {name: np.concatenate(found[name]) for name in sorted(found)}


def pair_sides(
    mesh: VolumeMesh, ends: Mapping[int, tuple[BoolArray, ...]], low: Array, high: Array, reach: float
) -> VolumeMesh:
    """The mesh with its periodic pairs along axes, and with nodes on far sides exactly at the images of those on near ones.

    `ends` says for each such axis which facets, of one kind, lie at the near and at the far side: other nodes may be as near to
    these planes as round-off. Corners are matched by place, middles of edges by the edges. A middle that is not in its plane,
    as its edge joins the same corners on another face, too, goes to the middle of the chord, and counts as straightened.
    Raises KernelError if a node on one side has no image on the other.
    """
    periodic, points, periods, straightened = {}, mesh.points.copy(), np.full(3, np.nan), mesh.straightened
    (facets,) = mesh.facets.values()
    for axis, (near_side, far_side) in ends.items():
        near, far = facets[near_side], facets[far_side]
        shift = np.eye(3)[axis] * (high[axis] - low[axis])
        periods[axis] = shift[axis]
        pairs = _match_corners(points, near[:, :3], far[:, :3], shift, AXES[axis], reach)
        if near.shape[1] > 3:
            middles, chords = _match_middles(points, near, far, pairs)
            off = np.abs(points[middles] - np.stack([chords, chords + shift], axis=1))[:, :, axis].max(axis=1) > ON_SIDE
            points[middles[off, 0]] = chords[off]
            straightened += int(off.sum())
            pairs = np.concatenate([pairs, middles])
        points[pairs[:, 0], axis] = low[axis]
        periodic[AXES[axis]] = pairs[np.argsort(pairs[:, 0])]
    paired = replace(mesh, periodic=periodic, periods=periods, straightened=straightened)
    repeated, count = paired.periodic_ties()
    images = points[repeated] + count * np.where(np.isnan(periods), 0.0, periods)
    moved = float(np.linalg.norm(images - points, axis=1).max(initial=0.0))
    return replace(paired, points=images, moved=moved)


def _match_corners(points: Array, near: IntArray, far: IntArray, shift: Array, axis: str, reach: float) -> IntArray:
    """Pairs (p, 2) of the corners of facets at either side."""
    ours, theirs = np.unique(near), np.unique(far)
    if len(ours) != len(theirs):
        raise KernelError("mesh", f"{len(ours)} corners at one side along {axis}, {len(theirs)} at the other")
    distance, other = cKDTree(points[theirs]).query(points[ours] + shift)
    if len(np.unique(other)) != len(ours) or distance.max(initial=0.0) > reach:
        raise KernelError("mesh", f"corners along {axis} are {distance.max():.1e} off their images")
    return np.column_stack([ours, theirs[other]])


def _match_middles(points: Array, near: IntArray, far: IntArray, corners: IntArray) -> tuple[IntArray, Array]:
    """Pairs (p, 2) of the middles of the edges of facets at either side, and the middles (p, 3) of the chords at the near one."""
    image = np.zeros(len(points), np.int64)
    image[corners[:, 0]] = corners[:, 1]
    sides = [list(edge) for edge in TRIANGLE_EDGES]  # their middles are the nodes 3, 4 and 5 of a facet
    ends = np.concatenate([near[:, side] for side in sides])
    keys, found = [], []
    for nodes, of_corners in ((near, image[ends]), (far, np.concatenate([far[:, side] for side in sides]))):
        edges, first = np.unique(np.sort(of_corners, axis=1), axis=0, return_index=True)
        keys.append(edges)
        found.append((nodes[:, 3:].T.ravel()[first], first))
    if not np.array_equal(keys[0], keys[1]):
        raise KernelError("mesh", "facets at opposite sides do not join the same corners")
    (ours, first), (theirs, _) = found
    return np.column_stack([ours, theirs]), points[ends[first]].mean(axis=1)


def untangle(mesh: VolumeMesh) -> VolumeMesh:
    """The mesh of second-order tetrahedra with edges of inverted elements made straight, those on facets last.

    `straightened` of the result counts, with those before, the edges on facets, whose middles are then on a chord instead of the
    exact surface.
    Elements whose corners are in the wrong order stay inverted.
    """
    if "tetra10" not in mesh.cells:
        return mesh
    cells = mesh.cells["tetra10"]
    on_facet = np.zeros(len(mesh.points), bool)
    for nodes in mesh.facets.values():
        on_facet[nodes] = True
    repeated, shift = mesh.periodic_ties()
    periods = np.where(np.isnan(mesh.periods), 0.0, mesh.periods)
    points, moved = mesh.points.copy(), np.zeros(len(mesh.points), bool)
    for movable in (~on_facet, np.ones_like(on_facet)):
        while True:  # to straighten an edge may invert a neighbour
            bad = jacobian_coefficients("tetra10", points, cells).min(axis=1) <= 0.0
            middles, chords = _middles_of_edges(cells[bad], points, movable)
            images = np.isin(repeated, repeated[middles])
            if moved[images].all():
                break
            points[middles] = chords
            points[repeated[middles]] = chords - shift[middles] * periods
            points[images] = points[repeated[images]] + shift[images] * periods
            moved |= images
    straightened = mesh.straightened + int((moved & on_facet).sum())
    return replace(mesh, points=points, straightened=straightened)


def _middles_of_edges(cells: IntArray, points: Array, movable: BoolArray) -> tuple[IntArray, Array]:
    """Nodes in the middle of the edges of elements that may be moved, and the middles of the chords."""
    ends = cells[:, np.array(TETRA_EDGES)]
    middles, first = np.unique(cells[:, 4:].ravel(), return_index=True)
    keep = movable[middles]
    return middles[keep], points[ends.reshape(-1, 2)[first[keep]]].mean(axis=1)
