"""Volume meshes as Python libraries hold them: scikit-fem's, with groups as subdomains and boundaries, and meshio's.

meshio writes VTK's files of unstructured grids, .vtu, with a column of data for each group. Groups are written in the encoding of
scikit-fem, too, so that `skfem.Mesh.load` finds subdomains and boundaries of second-order meshes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tpmscad._lazy_import import import_extra
from tpmscad._typing import IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.element_shapes import SHAPES
from tpmscad.meshing.facet_search import owners_of_facets
from tpmscad.meshing.mesh_arrays import MeshArrays, split

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


def make_meshio_mesh(mesh: MeshArrays) -> Any:
    """A `meshio.Mesh` of elements and facets, kind by kind, with a cell set for each group."""
    meshio = import_extra("meshio", "meshes for meshio", "mesh")
    no_cells, no_facets = ([np.zeros(0, np.int64)] * len(blocks) for blocks in (mesh.cells, mesh.facets))
    sets = {name: [*split(mesh.cells, rows), *no_facets] for name, rows in mesh.cell_groups.items()}
    sets |= {name: [*no_cells, *split(mesh.facets, rows)] for name, rows in mesh.facet_groups.items()}
    return meshio.Mesh(mesh.points, [*mesh.cells.items(), *mesh.facets.items()], cell_sets=sets)


def write_vtu(mesh: MeshArrays, path: Path) -> None:
    """Write elements and facets with a column "group: NAME" of 0 and 1 for each group; needs meshio."""
    plain = make_meshio_mesh(mesh)
    ends = np.cumsum([len(block) for block in plain.cells])[:-1]
    plain.cell_data = {name: np.split(values, ends) for name, values in _group_columns(mesh).items()}
    plain.cell_sets = {}
    with atomic_write(path) as aside:
        plain.write(aside, file_format="vtu")


def _group_columns(mesh: MeshArrays) -> dict[str, NDArray[Any]]:
    """Membership of each element and facet in each group, for people and for scikit-fem."""
    count = mesh.n_cells + mesh.n_facets
    columns: dict[str, NDArray[Any]] = {}
    for offset, groups in ((0, mesh.cell_groups), (mesh.n_cells, mesh.facet_groups)):
        for name, numbers in groups.items():
            columns[f"group: {name}"] = np.zeros(count, np.uint8)
            columns[f"group: {name}"][offset + numbers] = 1
    if len(mesh.cells) == 1 and next(iter(mesh.cells)) in SKFEM_CLASSES:
        columns.update(_skfem_columns(mesh))
    return columns


def _skfem_columns(mesh: MeshArrays) -> dict[str, NDArray[Any]]:
    """Groups as scikit-fem encodes them: "skfem:s:NAME" marks elements, a bit of "skfem:b:NAME" a face of an element."""
    columns: dict[str, NDArray[Any]] = {
        f"skfem:{letter}:{name}": np.zeros(mesh.n_cells + mesh.n_facets, np.int32)
        for letter, groups in (("s", mesh.cell_groups), ("b", mesh.facet_groups))
        for name in groups
    }
    for name, numbers in mesh.cell_groups.items():
        columns[f"skfem:s:{name}"][numbers] = 1
    if mesh.facet_groups:
        owners, bit = owners_of_facets(mesh.cells, mesh.facets), 1 << skfem_faces(next(iter(mesh.cells)))
        for name, numbers in mesh.facet_groups.items():
            np.bitwise_or.at(columns[f"skfem:b:{name}"], owners[numbers, 0], bit[owners[numbers, 1]].astype(np.int32))
    return columns
