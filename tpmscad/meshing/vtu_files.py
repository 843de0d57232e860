"""VTK's files of unstructured grids, .vtu, with a column of data for each group.

Source: "VTK XML formats", docs.vtk.org. Groups are written in the encoding of scikit-fem, too, so that `skfem.Mesh.load` finds
subdomains and boundaries of second-order meshes.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.meshing.facet_search import owners_of_facets
from tpmscad.meshing.skfem_mesh import SKFEM_CLASSES, skfem_faces
from tpmscad.meshing.volume_mesh import VolumeMesh

VTK_KINDS: Mapping[str, int] = MappingProxyType(
    {
        **{"triangle": 5, "triangle6": 22, "quad": 9, "quad8": 23, "quad9": 28},
        **{"tetra": 10, "tetra10": 24, "hexahedron": 12, "hexahedron20": 25, "hexahedron27": 29},
    }
)
"""VTK's number of each kind of element."""

VTK_TYPES = {"float64": "Float64", "int64": "Int64", "int32": "Int32", "uint8": "UInt8"}
BLOCK = 1 << 20
"""Bytes that are compressed at once."""


def write_vtu(mesh: VolumeMesh, path: Path) -> None:
    """Write elements and facets with a column "group: NAME" of 0 and 1 for each group."""
    blocks = [*mesh.cells.items(), *mesh.facets.items()]
    nodes = np.concatenate([rows.ravel() for _, rows in blocks])
    sizes = np.concatenate([np.full(len(rows), rows.shape[1]) for _, rows in blocks])
    kinds = np.concatenate([np.full(len(rows), VTK_KINDS[kind]) for kind, rows in blocks])
    columns = _group_columns(mesh)
    with atomic_write(path) as aside, aside.open("w", encoding="utf-8", newline="\n") as file:
        file.write(
            '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
            'header_type="UInt32" compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n'
            f'<Piece NumberOfPoints="{len(mesh.points)}" NumberOfCells="{len(kinds)}">\n<Points>\n'
        )
        file.write(_array("Points", mesh.points))
        file.write("</Points>\n<Cells>\n")
        file.write(_array("connectivity", nodes))
        file.write(_array("offsets", np.cumsum(sizes)))
        file.write(_array("types", kinds.astype(np.uint8)))
        file.write("</Cells>\n<CellData>\n")
        file.writelines(_array(name, values) for name, values in columns.items())
        file.write("</CellData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n")


def _group_columns(mesh: VolumeMesh) -> dict[str, NDArray[Any]]:
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


def _skfem_columns(mesh: VolumeMesh) -> dict[str, NDArray[Any]]:
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


def _array(name: str, values: NDArray[Any]) -> str:
    """A compressed array in base64: its header of counts and sizes, and its blocks."""
    raw = np.ascontiguousarray(values).tobytes()
    parts = [raw[i : i + BLOCK] for i in range(0, len(raw), BLOCK)]
    packed = [zlib.compress(part) for part in parts]
    last = len(parts[-1]) % BLOCK if parts else 0
    header: IntArray = np.array([len(parts), BLOCK, last, *map(len, packed)], np.int64)
    text = base64.b64encode(header.astype("<u4").tobytes()).decode() + base64.b64encode(b"".join(packed)).decode()
    columns = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    kind = VTK_TYPES[str(values.dtype)]
    return f'<DataArray type="{kind}" Name={quoteattr(name)}{columns} format="binary">{text}</DataArray>\n'
