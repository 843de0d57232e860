"""Poor tetrahedra of a mesh repaired one by one: edges collapsed, swapped and split, faces swapped, corners and middles moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tpmscad.meshing.edge_collapse import collapse_shortest_edge
from tpmscad.meshing.edge_splits import split_edge
from tpmscad.meshing.editable_mesh import EditableMesh, FacesOfFacets
from tpmscad.meshing.element_shapes import TETRA_EDGES
from tpmscad.meshing.node_moves import move_node
from tpmscad.meshing.swaps import swap_around
from tpmscad.meshing.volume_mesh import VolumeMesh

POOR = 0.1
"""Scaled Jacobian below which an element is repaired."""

SHORT = 0.5
"""In element sizes: length above which edges are kept."""

MAX_PASSES = 20
"""Most meshes need three to eight: a pass goes to elements around which the last has changed something."""


def improve_poor_elements(mesh: VolumeMesh, size: float, faces: FacesOfFacets | None = None) -> VolumeMesh:
    """The mesh of tetrahedra with its poor ones repaired, and how often: its `collapsed`, `swapped`, `split` and `shifted`.

    Size: the element size wanted, model units. Corners and middles of edges that move or are new are projected on the faces that
    they lie on, if these are known, and `deviation` is measured.
    """
    state = EditableMesh(mesh, faces)
    methods: dict[str, Callable[[int], int]] = {
        "collapsed": lambda cell: collapse_shortest_edge(state, cell, SHORT * size),
        "swapped": lambda cell: swap_around(state, cell),
        "split": lambda cell: split_edge(state, cell, size),
        "shifted": lambda cell: _move_nodes(state, cell, size),
    }
    counts = dict.fromkeys(methods, 0)
    tried: dict[str, dict[int, int]] = {name: {} for name in methods}
    for _ in range(MAX_PASSES):
        done = {name: _repair_poor(state, method, tried[name]) for name, method in methods.items()}
        counts = {name: count + done[name] for name, count in counts.items()}
        if not any(done.values()):
            break
    if not any(counts.values()):
        return replace(mesh, deviation=state.deviation())
    made = state.build()
    return replace(
        made,
        collapsed=counts["collapsed"],
        swapped=counts["swapped"],
        split=counts["split"],
        shifted=counts["shifted"],
    )


def _repair_poor(state: EditableMesh, method: Callable[[int], int], tried: dict[int, int]) -> int:
    """Apply a method to each poor element, the worst first, that still is poor; the sum of what it returns.

    `tried`: the number of changes made before the method was last used on each element, which grows. Elements around which
    nothing has changed since are left alone.
    """
    count = 0
    numbers, quality = state.quality()
    poor = np.flatnonzero(quality < POOR)
    for cell in numbers[poor[np.argsort(quality[poor])]].tolist():
        last_change = int(state.changed_at[state.cells[cell, :4]].max())
        if state.alive[cell] and last_change >= tried.get(cell, 0) and state.quality_of([cell]) < POOR:
            tried[cell] = state.n_changes + 1
            count += method(cell)
    return count


def _move_nodes(state: EditableMesh, cell: int, size: float) -> int:
    """Move the corners of an element and the middles of its edges until it is no longer poor; the number of nodes moved."""
    nodes = state.cells[cell].tolist()
    edges = [None] * 4 + [(nodes[i], nodes[j]) for i, j in TETRA_EDGES]
    count = 0
    for node, edge in zip(nodes, edges, strict=False):
        count += move_node(state, node, size, edge)
        if count and state.quality_of([cell]) >= POOR:
            break
    return count
