"""Straight ducts in front of the openings of a mesh, so that a flow enters and leaves at some distance from the body.

The triangles of each opening are extruded along its normal, layer by layer, and each prism is divided into three tetrahedra: from
the corners in the order of their numbers, so that neighbours divide their common side alike.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.element_shapes import TRIANGLE_EDGES, add_middles, determinants
from tpmscad.meshing.facet_search import find_facets, owners_of_facets
from tpmscad.meshing.mesh_arrays import M, sort_nodes

PLANAR = 1e-6
"""In edges of the triangles: distance from the plane of an opening up to which its nodes lie in it."""

OPENING, STUB = "opening ", "stub "


class _Stub(NamedTuple):
    """The mesh of one duct: nodes after the last so far, elements and their owners, side facets, and the opening at the end."""

    points: Array
    cells: IntArray
    owners: IntArray
    sides: IntArray
    ends: IntArray


def add_stubs(mesh: M, length: float) -> M:
    """The mesh with a straight duct in front of each opening, at whose end the opening then is; see `VolumeMesh.add_stubs`."""
    facet_kind = {"tetra": "triangle", "tetra10": "triangle6"}.get("+".join(mesh.cells))
    if not mesh.openings or facet_kind is None:
        what = "elements other than tetrahedra" if facet_kind is None else "no openings"
        raise InvalidRequest(f"the mesh has {what}: mesh a channel of fluid_domains, or the domains together")
    if mesh.periodic:
        raise InvalidRequest("a periodic mesh has no ends for stubs: mesh without periodic=True")
    (kind,) = mesh.cells
    points, cells, facets = mesh.points, mesh.cells[kind], mesh.facets[facet_kind].copy()
    owners = owners_of_facets(mesh.cells, mesh.facets)[:, 0]
    facet_groups = dict(mesh.facet_groups)
    sources = np.arange(len(cells))
    for name in sorted(mesh.openings):
        numbers = mesh.facet_groups[name]
        stub = _extrude(points, mesh.facets[facet_kind][numbers], owners[numbers], length, name)
        points, cells = np.concatenate([points, stub.points]), np.concatenate([cells, stub.cells])
        sources = np.concatenate([sources, stub.owners])
        facets[numbers] = stub.ends
        sides = find_facets({kind: stub.cells}, facet_kind, stub.sides)
        facet_groups[_name_sides(name)] = len(facets) + np.arange(len(sides))
        facets = np.concatenate([facets, sides])
    cell_groups = {name: np.flatnonzero(np.isin(sources, of)) for name, of in mesh.cell_groups.items()}
    made = replace(
        mesh,
        points=points,
        cells={kind: cells},
        facets={facet_kind: facets},
        cell_groups=cell_groups,
        facet_groups=facet_groups,
    )
    return sort_nodes(made)


def _name_sides(opening: str) -> str:
    """Group of the sides of a duct: "stub X-" of "opening X-", and "inlet: stub" of an opening with a name of its own."""
    return opening.replace(OPENING, STUB) if OPENING in opening else f"{opening}: {STUB.strip()}"


def _extrude(points: Array, triangles: IntArray, owners: IntArray, length: float, name: str) -> _Stub:
    """The duct in front of an opening with triangles (m, 3) or (m, 6)."""
    corners = points[triangles[:, :3]]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    normal = area / np.linalg.norm(area)
    edge = float(np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2).mean())
    height = (points[triangles] - corners[0, 0]) @ normal
    if np.ptp(height) > PLANAR * edge:
        raise InvalidRequest(
            f"{name!r} is not in one plane, its nodes are {np.ptp(height):.3g} apart along its normal: a stub is straight"
        )
    layers = max(1, round(length / edge))
    base, inverse = np.unique(triangles, return_inverse=True)
    local: IntArray = inverse.reshape(triangles.shape)
    levels = np.arange(1, 2 * layers + 1)  # two for each layer: middles of edges lie half-way
    made = points[base] + (levels * length / (2 * layers))[:, None, None] * normal
    numbers = np.concatenate([base[None], len(points) + np.arange(made[..., 0].size).reshape(len(levels), -1)])
    middles: dict[frozenset[int], int] = {}
    for k, (i, j) in enumerate(TRIANGLE_EDGES[: local.shape[1] - 3]):
        middles.update(zip(map(frozenset, local[:, [i, j]].tolist()), local[:, 3 + k].tolist(), strict=True))
    where = dict(zip(numbers.ravel().tolist(), np.ndindex(*numbers.shape), strict=True))

    def middle(i: int, j: int) -> int:
        (level, p), (other, q) = where[i], where[j]
        return int(numbers[(level + other) // 2, p if p == q else middles[frozenset((p, q))]])

    ordered = np.sort(local[:, :3], axis=1)
    rows = np.concatenate([_divide_prisms(numbers[2 * k], numbers[2 * k + 2], ordered) for k in range(layers)])
    places = np.concatenate([points, made.reshape(-1, 3)])[rows]
    wrong = determinants(places[:, 1:] - places[:, :1]) < 0
    rows[wrong] = rows[wrong][:, [1, 0, 2, 3]]
    cells = add_middles([tuple(row) for row in rows.tolist()], middle, 10 if triangles.shape[1] > 3 else 4)
    rim = _find_rim(ordered)
    sides = np.concatenate([_divide_quadrilaterals(numbers[2 * k], numbers[2 * k + 2], rim) for k in range(layers)])
    return _Stub(made.reshape(-1, 3), cells, np.tile(owners, 3 * layers), sides, numbers[-1][local])


def _divide_prisms(near: IntArray, far: IntArray, triangles: IntArray) -> IntArray:
    """Corners (3 m, 4) of the tetrahedra between triangles (m, 3) at two levels."""
    (a, b, c), (d, e, f) = near[triangles].T, far[triangles].T
    return np.concatenate([np.column_stack(rows) for rows in ((a, b, c, f), (a, b, e, f), (a, d, e, f))])


def _divide_quadrilaterals(near: IntArray, far: IntArray, edges: IntArray) -> IntArray:
    """Corners (2 k, 3) of the triangles between edges (k, 2) at two levels."""
    (a, b), (d, e) = near[edges].T, far[edges].T
    return np.concatenate([np.column_stack([a, b, e]), np.column_stack([a, e, d])])


def _find_rim(triangles: IntArray) -> IntArray:
    """The edges (k, 2) that one triangle alone has."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [0, 2]]])
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(edges[first[count == 1]])
