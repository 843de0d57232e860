"""Meshes for meshio, and by it VTK's files of unstructured grids, .vtu, with a column of data for each group.

Groups are written in the encoding of scikit-fem, too, so that `skfem.Mesh.load` finds subdomains and boundaries of second-order
meshes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tpmscad._lazy_import import import_extra
from tpmscad.atomic_file import atomic_write
from tpmscad.meshing.facet_search import owners_of_facets
from tpmscad.meshing.mesh_arrays import MeshArrays, split
from tpmscad.meshing.skfem_mesh import SKFEM_CLASSES, skfem_faces


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
