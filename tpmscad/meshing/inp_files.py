"""Abaqus and CalculiX input files: nodes, elements, sets, surfaces, and equations between periodic nodes.

Sources: CalculiX CrunchiX User's Manual, 2.20, sections "C3D10", "*SURFACE", "*EQUATION"; the same keywords are Abaqus'.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from tpmscad._typing import IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.facet_search import owners_of_facets
from tpmscad.meshing.mesh_arrays import AXES, MeshArrays

ABAQUS_KINDS: Mapping[str, str] = MappingProxyType(
    {"tetra": "C3D4", "tetra10": "C3D10", "hexahedron": "C3D8", "hexahedron20": "C3D20"}
)
"""Name of each kind of element; the order of nodes is VTK's."""

COORDINATE = ".13g"
"""Format of a coordinate: CalculiX reads 20 characters of a number, and would cut the exponent of a longer one."""

NUMBERS_IN_A_LINE = 12
"""Numbers in a line of a set or an element, of 16 that are allowed."""


def format_name(name: str) -> str:
    """A group's name as the input allows it: capital letters, digits and underscores, as "CAP_X_PLUS" for "cap X+"."""
    words = name.replace("+", " plus ").replace("-", " minus ")
    return "_".join(re.findall(r"[A-Za-z0-9]+", words)).upper()


def write_inp(mesh: MeshArrays, path: Path) -> None:
    """Write a mesh as an input of Abaqus and CalculiX; InvalidRequest if they have no such elements."""
    unknown = [kind for kind in mesh.cells if kind not in ABAQUS_KINDS]
    if unknown:
        raise InvalidRequest(
            f"CalculiX and Abaqus have no {unknown[0]}: make a mesh of {', '.join(ABAQUS_KINDS)} (hexahedra of 20 nodes are "
            "those with serendipity), or write .msh or .vtu"
        )
    with atomic_write(path) as aside, aside.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"*HEADING\n{format_name(mesh.name)}\n")
        for text in (*_mesh_lines(mesh), *_set_lines(mesh), *_periodic_lines(mesh)):
            file.write(text)


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
    yield "** Reference nodes: displacements of one side of the cell against the other along x, y, z\n*NODE\n"
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
