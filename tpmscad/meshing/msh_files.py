"""gmsh's MSH files, versions 4.1 and 2.2, as text: elements, physical groups and periodic nodes.

gmsh knows no periodic volumes: the nodes of all translations are those of the first surface.

Source: "MSH file format", Gmsh reference manual.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from tpmscad._typing import IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.meshing.mesh_arrays import MeshArrays

GMSH_KINDS: Mapping[str, tuple[int, tuple[int, ...]]] = MappingProxyType(
    {
        "triangle": (2, (0, 1, 2)),
        "triangle6": (9, (0, 1, 2, 3, 4, 5)),
        "quad": (3, (0, 1, 2, 3)),
        "quad8": (16, (0, 1, 2, 3, 4, 5, 6, 7)),
        "quad9": (10, (0, 1, 2, 3, 4, 5, 6, 7, 8)),
        "tetra": (4, (0, 1, 2, 3)),
        "tetra10": (11, (0, 1, 2, 3, 4, 5, 6, 7, 9, 8)),
        "hexahedron": (5, tuple(range(8))),
        "hexahedron20": (17, (*range(9), 11, 16, 9, 17, 10, 18, 19, 12, 15, 13, 14)),
        "hexahedron27": (12, (*range(9), 11, 16, 9, 17, 10, 18, 19, 12, 15, 13, 14, 24, 22, 20, 21, 23, 25, 26)),
    }
)
"""gmsh's number of each kind of element, and which node of VTK each of its nodes is."""


def write_msh(mesh: MeshArrays, path: Path, version: str) -> None:
    """Write a mesh as gmsh's text of version "4.1" or "2.2"."""
    names = [(3, name) for name in mesh.cell_groups] + [(2, name) for name in mesh.facet_groups]
    tags = {key: number for number, key in enumerate(names, 1)}
    entities = [*_entities(mesh.cells, mesh.cell_groups, 3, tags), *_entities(mesh.facets, mesh.facet_groups, 2, tags)]
    writer = _format_4 if version == "4.1" else _format_2
    with atomic_write(path) as aside, aside.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"$MeshFormat\n{version} 0 8\n$EndMeshFormat\n")
        file.write(f"$PhysicalNames\n{len(names)}\n")
        file.writelines(f'{dimension} {tags[dimension, name]} "{name}"\n' for dimension, name in names)
        file.write("$EndPhysicalNames\n")
        for text in writer(mesh, entities):
            file.write(text)


class _Entity(NamedTuple):
    """Elements of one dimension that are in the same groups: a volume or surface in gmsh's sense."""

    dimension: int
    tag: int
    groups: list[int]
    kind: str
    nodes: IntArray


def _entities(
    blocks: Mapping[str, IntArray], groups: Mapping[str, IntArray], dimension: int, tags: Mapping[tuple[int, str], int]
) -> list[_Entity]:
    """Elements by the groups that they are in and by kind, as gmsh gives groups to entities, not to elements."""
    total = sum(map(len, blocks.values()))
    member = np.zeros((total, len(groups)), bool)
    for column, numbers in enumerate(groups.values()):
        member[numbers, column] = True
    of_name = [tags[dimension, name] for name in groups]
    combinations, which = np.unique(member, axis=0, return_inverse=True)
    found: list[_Entity] = []
    start = 0
    for kind, nodes in blocks.items():
        here = which.ravel()[start : start + len(nodes)]
        start += len(nodes)
        for number in np.unique(here):
            inside = [tag for tag, held in zip(of_name, combinations[number], strict=True) if held]
            found.append(_Entity(dimension, len(found) + 1, inside, kind, nodes[here == number]))
    return found


def _format_4(mesh: MeshArrays, entities: list[_Entity]) -> Iterator[str]:
    """The sections of version 4.1. All nodes belong to the first volume."""
    yield f"$Entities\n0 0 {sum(e.dimension == 2 for e in entities)} {sum(e.dimension == 3 for e in entities)}\n"
    for entity in sorted(entities, key=lambda e: (e.dimension, e.tag)):
        points = mesh.points[entity.nodes.ravel()]
        box = " ".join(map(repr, [*points.min(axis=0).tolist(), *points.max(axis=0).tolist()]))
        yield f"{entity.tag} {box} {len(entity.groups)} {' '.join(map(str, entity.groups))} 0\n"
    yield "$EndEntities\n"
    count = len(mesh.points)
    yield f"$Nodes\n1 {count} 1 {count}\n3 1 0 {count}\n"
    yield _rows(np.arange(1, count + 1)[:, None])
    yield "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in mesh.points.tolist())
    yield "$EndNodes\n"
    total = sum(len(e.nodes) for e in entities)
    yield f"$Elements\n{len(entities)} {total} 1 {total}\n"
    first = 1
    for entity in entities:
        number, order = GMSH_KINDS[entity.kind]
        yield f"{entity.dimension} {entity.tag} {number} {len(entity.nodes)}\n"
        tags = np.arange(first, first + len(entity.nodes))
        yield _rows(np.column_stack([tags, entity.nodes[:, list(order)] + 1]))
        first += len(entity.nodes)
    yield "$EndElements\n"
    yield from _periodic_lines(mesh, "16")


def _format_2(mesh: MeshArrays, entities: list[_Entity]) -> Iterator[str]:
    """The sections of version 2.2: an element of several groups is in the first of them, as the version knows one for each."""
    yield f"$Nodes\n{len(mesh.points)}\n"
    numbers = range(1, len(mesh.points) + 1)
    yield "".join(f"{i} {x!r} {y!r} {z!r}\n" for i, (x, y, z) in zip(numbers, mesh.points.tolist(), strict=True))
    yield f"$EndNodes\n$Elements\n{sum(len(e.nodes) for e in entities)}\n"
    first = 1
    for entity in entities:
        number, order = GMSH_KINDS[entity.kind]
        count = len(entity.nodes)
        columns = np.empty((count, 5), np.int64)
        columns[:, 0] = np.arange(first, first + count)
        columns[:, 1:] = number, 2, entity.groups[0] if entity.groups else 0, entity.tag
        yield _rows(np.column_stack([columns, entity.nodes[:, list(order)] + 1]))
        first += count
    yield "$EndElements\n"
    yield from _periodic_lines(mesh, "Affine")


def _periodic_lines(mesh: MeshArrays, head: str) -> Iterator[str]:
    """Periodic nodes, if there are any, each translation with its head and gmsh's matrix of 16 numbers."""
    if not mesh.periodic:
        return
    yield f"$Periodic\n{len(mesh.periodic)}\n"
    for translation, pairs in mesh.periodic.items():
        matrix = np.eye(4)
        matrix[:3, 3] = mesh.translation(translation)
        yield f"2 1 1\n{head} {' '.join(map(repr, matrix.ravel().tolist()))}\n{len(pairs)}\n"
        yield _rows(pairs[:, ::-1] + 1)
    yield "$EndPeriodic\n"


def _rows(numbers: IntArray) -> str:
    """Whole numbers, a line for each row."""
    return "\n".join(" ".join(map(str, row)) for row in numbers.tolist()) + "\n" if len(numbers) else ""
