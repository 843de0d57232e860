"""Poor tetrahedra of a mesh mended one by one: short edges collapsed, edges and faces swapped, corners and middles moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tpmscad.meshing.edge_collapse import collapse_shortest_edge
from tpmscad.meshing.editable_mesh import EditableMesh, FacesOfFacets
from tpmscad.meshing.element_shapes import TETRA_EDGES
from tpmscad.meshing.node_moves import move_node
from tpmscad.meshing.swaps import swap_around
from tpmscad.meshing.volume_mesh import VolumeMesh

POOR = 0.1
"""Scaled Jacobian below which an element is mended."""

SHORT = 0.5
"""In element sizes: length above which edges are kept."""

MAX_PASSES = 6

MOST_MOVED = 20
"""Poor elements of a pass, the worst, whose nodes are moved, .3 s each where elements are curved: where there are many, they
are too large for the curvature of the faces, which moves do not cure. In a cell of 4700 curved elements, 226 of them poor, six
passes took 400 s and left the worst at .012."""


def improve_poor_elements(mesh: VolumeMesh, size: float, faces: FacesOfFacets | None = None) -> VolumeMesh:
    """The mesh of tetrahedra with its poor ones mended; `collapsed`, `swapped` and `shifted` of the result say how often.

    Size: the element size wanted, model units. Corners and middles of edges that move or are new are projected on the faces that
    they lie on, if these are known, and `deviation` is measured.
    """
    state = EditableMesh(mesh, faces)
    methods: dict[str, Callable[[int], int]] = {
        "collapsed": lambda cell: collapse_shortest_edge(state, cell, SHORT * size),
        "swapped": lambda cell: swap_around(state, cell),
        "shifted": lambda cell: _move_nodes(state, cell, size),
    }
    counts = dict.fromkeys(methods, 0)
    for _ in range(MAX_PASSES):
        done = {
            name: _mend_poor(state, method, MOST_MOVED if name == "shifted" else None)
            for name, method in methods.items()
        }
        counts = {name: count + done[name] for name, count in counts.items()}
        if not any(done.values()):
            break
    if not any(counts.values()):
        return replace(mesh, deviation=state.deviation())
    made = state.build()
    return replace(made, collapsed=counts["collapsed"], swapped=counts["swapped"], shifted=counts["shifted"])


def _mend_poor(state: EditableMesh, method: Callable[[int], int], most: int | None = None) -> int:
    """Apply a method to each poor element, the worst first, as long as it is poor; the sum of what it returns.

    At most to the worst `most`, if these are given.
    """
    numbers, quality = state.quality()
    poor = np.flatnonzero(quality < POOR)
    cells = numbers[poor[np.argsort(quality[poor])]][:most].tolist()
    return sum(method(cell) for cell in cells if state.alive[cell] and state.quality_of([cell]) < POOR)


def _move_nodes(state: EditableMesh, cell: int, size: float) -> int:
    """Move the corners of an element and the middles of its edges; the number of nodes moved."""
    corners = state.cells[cell, :4].tolist()
    count = sum(move_node(state, node, size) for node in corners)
    for node, (i, j) in zip(state.cells[cell, 4:].tolist(), TETRA_EDGES, strict=False):
        count += move_node(state, node, size, (corners[i], corners[j]))
    return count
