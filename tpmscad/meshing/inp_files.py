"""Abaqus and CalculiX input files: nodes, elements, sets, surfaces, and equations between periodic nodes.

Sources: CalculiX CrunchiX User's Manual, 2.20, sections "C3D10", "*SURFACE", "*EQUATION"; the same keywords are Abaqus'.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from tpmscad._typing import IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.meshing.element_shapes import SHAPES
from tpmscad.meshing.facet_search import owners_of_facets
from tpmscad.meshing.mesh_arrays import AXES, M, MeshArrays, sort_nodes

ABAQUS_KINDS: Mapping[str, str] = MappingProxyType(
    {"tetra": "C3D4", "tetra10": "C3D10", "hexahedron": "C3D8", "hexahedron20": "C3D20"}
)
"""Name of each kind of element; the order of nodes is VTK's."""

PLAINER_KINDS: Mapping[str, str] = MappingProxyType({"hexahedron27": "hexahedron20", "quad9": "quad8"})
"""For kinds of elements and facets that they lack, those of the same first nodes, without the nodes inside faces and elements."""

COORDINATE = ".13g"
"""Format of a coordinate: CalculiX reads 20 characters of a number, and would cut the exponent of a longer one."""

REFERENCE_NODES = """\
** Reference nodes: displacements of one side of the cell against the other along x, y, z.
** No element has them: CalculiX prints 0 for their reactions. The stiffness follows from the energy (*EL PRINT,
** ELSET=EALL, TOTALS=ONLY with ELSE), which is half the box' volume times strain . stiffness . strain.
*NODE
"""

NUMBERS_IN_A_LINE = 12
"""Numbers in a line of a set or an element, of 16 that are allowed."""


def format_name(name: str) -> str:
    """A group's name as the input allows it: capital letters, digits and underscores, as "CAP_X_PLUS" for "cap X+"."""
    words = name.replace("+", " plus ").replace("-", " minus ")
    return "_".join(re.findall(r"[A-Za-z0-9]+", words)).upper()


def write_inp(mesh: MeshArrays, path: Path) -> None:
    """Write a mesh as an input of Abaqus and CalculiX, hexahedra of 27 nodes as C3D20, which the file notes."""
    plainer = drop_inner_nodes(mesh)
    notes = ""
    if plainer is not mesh:
        notes = f"** C3D20: the {len(mesh.points) - len(plainer.points)} nodes inside faces and elements of 27 are left out\n"
    with atomic_write(path) as aside, aside.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"*HEADING\n{format_name(mesh.name)}\n{notes}")
        for text in (*_mesh_lines(plainer), *_set_lines(plainer), *_periodic_lines(plainer)):
            file.write(text)


def drop_inner_nodes(mesh: M) -> M:
    """The mesh with hexahedra of 20 nodes in place of those of 27, which agree on edges; itself if it has none."""
    if not set(mesh.cells) & set(PLAINER_KINDS):
        return mesh

    def drop(blocks: Mapping[str, IntArray]) -> dict[str, IntArray]:
        plain = {kind: PLAINER_KINDS.get(kind, kind) for kind in blocks}
        return {plain[kind]: nodes[:, : len(SHAPES[plain[kind]].nodes)] for kind, nodes in blocks.items()}

    return sort_nodes(replace(mesh, cells=drop(mesh.cells), facets=drop(mesh.facets)))


def _mesh_lines(mesh: MeshArrays) -> Iterator[str]:
    """Nodes and elements, numbered from 1."""
    yield "*NODE, NSET=NALL\n"
    for number, point in enumerate(mesh.points.tolist(), 1):
        yield f"{number}, {', '.join(f'{x:{COORDINATE}}' for x in point)}\n"
    first = 1
    for kind, nodes in mesh.cells.items():
        yield f"*ELEMENT, TYPE={ABAQUS_KINDS[kind]}, ELSET=EALL\n"
        tags = np.arange(first, first + len(nodes))
        yield from (_wrap(row) for row in np.column_stack([tags, nodes + 1]).tolist())
        first += len(nodes)


def _set_lines(mesh: MeshArrays) -> Iterator[str]:
    """Node sets, element sets and surfaces."""
    for name, nodes in mesh.node_sets.items():
        yield f"*NSET, NSET=N_{format_name(name)}\n" + _list(nodes + 1)
    for name, numbers in mesh.cell_groups.items():
        yield f"*ELSET, ELSET=E_{format_name(name)}\n" + _list(numbers + 1)
    owners = owners_of_facets(mesh.cells, mesh.facets) if mesh.facet_groups else np.zeros((0, 2), np.int64)
    for name, numbers in mesh.facet_groups.items():
        yield f"*SURFACE, NAME=S_{format_name(name)}, TYPE=ELEMENT\n"
        yield "".join(f"{cell + 1}, S{face + 1}\n" for cell, face in owners[numbers].tolist())


def _periodic_lines(mesh: MeshArrays) -> Iterator[str]:
    """Sets of the nodes of each side, three reference nodes, an equation for each displacement of a node that repeats another.

    The displacement of a node less that of the node it repeats is the sum over the axes of the periods between them times the
    displacement of the axis' reference node, which is thus the displacement gradient of the cell times its period.
    """
    if not mesh.periodic:
        return
    count = len(mesh.points)
    yield REFERENCE_NODES
    yield "".join(f"{count + 1 + axis}, 0., 0., 0.\n" for axis in range(3))
    for axis, name in enumerate(AXES):
        yield f"*NSET, NSET=N_PERIOD_{name.upper()}\n{count + 1 + axis}\n"
    for name, pairs in mesh.periodic.items():
        for column, side in enumerate(("NEAR", "FAR")):
            yield f"*NSET, NSET=N_PERIODIC_{format_name(name)}_{side}\n" + _list(pairs[:, column] + 1)
    repeated, shift = mesh.periodic_ties()
    yield "*EQUATION\n"
    for node in np.flatnonzero(repeated != np.arange(count)).tolist():
        axes = np.flatnonzero(shift[node]).tolist()
        terms = [(repeated[node] + 1, -1), *((count + 1 + axis, -shift[node, axis]) for axis in axes)]
        for freedom in (1, 2, 3):
            entries = [f"{node + 1}, {freedom}, 1.", *(f"{other}, {freedom}, {factor}." for other, factor in terms)]
            lines = [", ".join(entries[i : i + 4]) for i in range(0, len(entries), 4)]
            yield f"{len(entries)}\n" + "\n".join(lines) + "\n"


def _list(numbers: IntArray) -> str:
    """Numbers in lines of at most as many as are allowed."""
    values = numbers.tolist()
    lines = (values[i : i + NUMBERS_IN_A_LINE] for i in range(0, len(values), NUMBERS_IN_A_LINE))
    return "".join(", ".join(map(str, line)) + ",\n" for line in lines)


def _wrap(numbers: list[int]) -> str:
    """An element in lines; a comma at the end of a line says that the next one continues it."""
    lines = (numbers[i : i + NUMBERS_IN_A_LINE] for i in range(0, len(numbers), NUMBERS_IN_A_LINE))
    return ",\n".join(", ".join(map(str, line)) for line in lines) + "\n"
