"""Volume meshes as scikit-fem's, with groups as subdomains and boundaries."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.element_shapes import SHAPES
from tpmscad.meshing.facet_search import owners_of_facets
from tpmscad.meshing.mesh_arrays import MeshArrays

SKFEM_CLASSES: Mapping[str, str] = MappingProxyType(
    {"tetra": "MeshTet1", "tetra10": "MeshTet2", "hexahedron": "MeshHex1", "hexahedron27": "MeshHex2"}
)
"""Class of scikit-fem for each kind of element."""

SKFEM_HEXAHEDRON = (0, 4, 3, 1, 7, 5, 2, 6, 16, 11, 8, 15, 12, 19, 10, 17, 9, 14, 13, 18, 20, 24, 22, 23, 25, 21, 26)
"""Node of VTK of each node of scikit-fem's hexahedra (`skfem.io.meshio.INV_HEX_MAPPING`)."""

SKFEM_TETRA_FACES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
SKFEM_HEXAHEDRON_FACES = ((0, 1, 4, 2), (0, 2, 6, 3), (0, 3, 5, 1), (2, 4, 7, 6), (1, 5, 7, 4), (3, 6, 7, 5))
"""Corners, in scikit-fem's own numbers, of the faces of its elements (`skfem.refdom`)."""


def make_skfem_mesh(mesh: MeshArrays) -> Any:
    """The mesh as `skfem.Mesh`; the corners of its elements are the first nodes, as scikit-fem wants them.

    Raises InvalidRequest if scikit-fem is missing or has no such elements.
    """
    skfem = import_extra("skfem", "meshes for scikit-fem", "simulation")
    if len(mesh.cells) != 1 or next(iter(mesh.cells)) not in SKFEM_CLASSES:
        raise InvalidRequest(f"scikit-fem takes one kind of {', '.join(SKFEM_CLASSES)}, not {' and '.join(mesh.cells)}")
    ((kind, nodes),) = mesh.cells.items()
    order = skfem_order(kind)
    made = getattr(skfem, SKFEM_CLASSES[kind])(
        np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(nodes[:, order].T)
    )
    if not mesh.facet_groups:
        return made.with_subdomains(dict(mesh.cell_groups))
    owners = owners_of_facets(mesh.cells, mesh.facets)
    faces = made.t2f[skfem_faces(kind)[owners[:, 1]], owners[:, 0]]
    boundaries = {}
    for name, numbers in mesh.facet_groups.items():
        chosen = faces[numbers]
        side = (made.f2t[1, chosen] == owners[numbers, 0]).astype(np.int64)
        boundaries[name] = skfem.generic_utils.OrientedBoundary(chosen, side) if side.any() else chosen
    return made.with_subdomains(dict(mesh.cell_groups)).with_boundaries(boundaries)


def skfem_faces(kind: str) -> IntArray:
    """Number in scikit-fem of each face of an element."""
    shape = SHAPES[kind]
    order = skfem_order(kind)
    theirs = SKFEM_TETRA_FACES if shape.is_simplex else SKFEM_HEXAHEDRON_FACES
    number = {frozenset(order[i] for i in face): i for i, face in enumerate(theirs)}
    n_corners = SHAPES[shape.face_kind].corners
    return np.array([number[frozenset(face[:n_corners])] for face in shape.faces])


def skfem_order(kind: str) -> list[int]:
    """Node of VTK of each node of scikit-fem's element."""
    count = len(SHAPES[kind].nodes)
    return list(range(count)) if SHAPES[kind].is_simplex else list(SKFEM_HEXAHEDRON[:count])
