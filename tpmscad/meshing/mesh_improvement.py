"""Poor tetrahedra of a mesh mended one by one: short edges collapsed, edges and faces swapped, corners moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tpmscad.meshing.edge_collapse import collapse_shortest_edge
from tpmscad.meshing.editable_mesh import EditableMesh, Project
from tpmscad.meshing.node_moves import move_node
from tpmscad.meshing.swaps import swap_around
from tpmscad.meshing.volume_mesh import VolumeMesh

POOR = 0.1
"""Scaled Jacobian below which an element is mended."""

SHORT = 0.5
"""In element sizes: length above which edges are kept."""

MAX_PASSES = 8


def improve_poor_elements(mesh: VolumeMesh, size: float, project: Project | None = None) -> VolumeMesh:
    """The mesh of tetrahedra with better ones in place of its poor ones; `collapsed`, `swapped` and `shifted` of the result count.

    Size: the element size wanted, model units. Corners and middles of edges that move or are new are projected on the faces that
    they lie on, if these are known.
    """
    state = EditableMesh(mesh, project)
    collapsed = swapped = shifted = 0
    for _ in range(MAX_PASSES):
        numbers, quality = state.quality()
        poor = np.flatnonzero(quality < POOR)
        before = collapsed, swapped, shifted
        for cell in numbers[poor[np.argsort(quality[poor])]].tolist():
            if not state.alive[cell]:
                continue
            if count := collapse_shortest_edge(state, cell, SHORT * size):
                collapsed += count
            elif count := swap_around(state, cell):
                swapped += count
            else:
                for node in state.cells[cell, :4].tolist():
                    shifted += move_node(state, node, size)
        if (collapsed, swapped, shifted) == before:
            break
    if not collapsed + swapped + shifted:
        return mesh
    return replace(state.build(), collapsed=collapsed, swapped=swapped, shifted=shifted)
