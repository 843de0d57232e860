"""Facets of a mesh as faces of its elements: those at given corners, and the elements that they belong to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.element_shapes import SHAPES


@dataclass(frozen=True, slots=True, eq=False)
class FaceTable:
    """All faces of one kind of the elements: nodes (m, k) with outward normals, and owner (m, 2), element and which of its faces.

    They are in the order of the elements.
    """

    nodes: IntArray
    owner: IntArray


def tabulate_faces(cells: Mapping[str, IntArray]) -> dict[str, FaceTable]:
    """All faces of elements, by kind."""
    nodes: dict[str, list[IntArray]] = {}
    owners: dict[str, list[IntArray]] = {}
    first = 0
    for kind, rows in cells.items():
        shape = SHAPES[kind]
        faces = rows[:, np.array(shape.faces)]  # (elements, faces, nodes)
        numbers = np.stack(np.meshgrid(first + np.arange(len(rows)), np.arange(len(shape.faces)), indexing="ij"), -1)
        nodes.setdefault(shape.face_kind, []).append(faces.reshape(-1, faces.shape[-1]))
        owners.setdefault(shape.face_kind, []).append(numbers.reshape(-1, 2))
        first += len(rows)
    return {kind: FaceTable(np.concatenate(nodes[kind]), np.concatenate(owners[kind])) for kind in nodes}


def find_facets(cells: Mapping[str, IntArray], kind: str, corners: IntArray) -> IntArray:
    """Nodes (m, k) of the faces of elements with the given corners (m, c) in any order, oriented outwards of the first element.

    Raises InvalidRequest if no element has such a face.
    """
    table = tabulate_faces(cells)[kind]
    return table.nodes[_match(np.sort(table.nodes[:, : SHAPES[kind].corners], axis=1), np.sort(corners, axis=1))]


def owners_of_facets(cells: Mapping[str, IntArray], facets: Mapping[str, IntArray]) -> IntArray:
    """(n, 2): for each facet the element that it is a face of, and which; at an interface, of the two that whose normal agrees.

    Raises InvalidRequest if a facet is no face of an element.
    """
    tables = tabulate_faces(cells)
    result = [np.zeros((0, 2), np.int64)]
    for kind, nodes in facets.items():
        n_corners = SHAPES[kind].corners
        table = tables.get(kind)
        if table is None:
            raise InvalidRequest(f"{len(nodes)} {kind} are faces of no element")
        ours = _cycle_to_least(table.nodes[:, :n_corners])
        result.append(table.owner[_match(ours, _cycle_to_least(nodes[:, :n_corners]))])
    return np.concatenate(result)


def find_rows(table: IntArray, wanted: IntArray) -> IntArray:
    """The first row (n,) of a table that equals each wanted row, -1 where none does."""
    _, first, of = np.unique(np.concatenate([table, wanted]), axis=0, return_index=True, return_inverse=True)
    row = first[of.ravel()[len(table) :]]
    return np.where(row < len(table), row, -1)


def _match(table: IntArray, wanted: IntArray) -> IntArray:
    """The first row (n,) of a table that equals each wanted row; InvalidRequest if there is none."""
    row = find_rows(table, wanted)
    if missing := int((row < 0).sum()):
        raise InvalidRequest(f"{missing} facets are faces of no element, or have the opposite orientation")
    return row


def _cycle_to_least(corners: IntArray) -> IntArray:
    """Corners (m, k) in their cyclic order, the least first."""
    first = corners.argmin(axis=1)
    around = (first[:, None] + np.arange(corners.shape[1])) % corners.shape[1]
    return np.asarray(np.take_along_axis(corners, around, axis=1))
