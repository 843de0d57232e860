"""Layers of a filled body from the triangles of its lattice, in slabs: where no cell is a copy of another.

The pieces that meet a slab are placed, cut by the body, and cut by the planes of its layers. Every chord lies in a triangle,
within the deviation of the exact surface; areas and volumes are those of the triangles.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.sections.mesh_sections import MeshSections, cut_mesh, measure_sections
from tpmscad.brep.triangles.filled_mesh import PieceChoice
from tpmscad.parallel import task_runner
from tpmscad.studies.lattice_triangles import BodyTriangles, TriangulatedLattice

TRIANGLES_PER_SLAB = 6_000_000
"""Triangles of the lattice that are placed at a time, which limits the memory: about a gigabyte."""

SECTIONS_OF_LAYER = 3
"""Sections of a layer from which its volume follows: nodes of Gauss and Legendre, one of them in the middle."""


@dataclass(frozen=True, slots=True, eq=False)
class LayersOfTriangles:
    """Sections in the middles of layers, one value for each slab, and the volumes of all layers (l,)."""

    sections: list[MeshSections]
    volumes: Array


def cut_into_layers(
    lattice: TriangulatedLattice,
    parts: BodyTriangles,
    turn: Array,
    edges: Array,
    error: float,
    executor: Executor | None,
) -> LayersOfTriangles:
    """The layers between ascending heights (l + 1,) of the model, which `turn` (3, 3) takes the lattice's axes to.

    error: distance of points that are left out from the chords.
    """
    low, high = _find_heights(lattice, turn)
    used = lattice.choice.whole | lattice.choice.cut
    height = max(
        float(np.diff(edges).max()), np.ptp(edges) * TRIANGLES_PER_SLAB / max(lattice.count_triangles(used), 1.0)
    )
    slab = np.floor((edges[:-1] - edges[0]) / height).astype(int)
    starts = np.append(np.flatnonzero(np.diff(slab, prepend=-1)), len(slab))
    tasks = []
    for first, last in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        meets: BoolArray = (high >= edges[first]) & (low <= edges[last])
        choice = PieceChoice(lattice.choice.origin, lattice.choice.whole & meets, lattice.choice.cut & meets)
        tasks.append((lattice, parts, choice, turn, edges[first : last + 1], error))
    with task_runner(executor, tasks[0]) as run_tasks:
        found = run_tasks(_cut_slab, tasks)
    return LayersOfTriangles([sections for sections, _ in found], np.concatenate([volumes for _, volumes in found]))


def _find_heights(lattice: TriangulatedLattice, turn: Array) -> tuple[Array, Array]:
    """The least and the greatest height of each piece in the model, (x, y, z, P)."""
    pieces, size = lattice.pieces, lattice.choice.whole.shape[:3]
    corner = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1) + lattice.choice.origin
    middle = (corner * pieces.cell)[..., None, :] + 0.5 * (pieces.low + pieces.high)
    reach = 0.5 * (pieces.high - pieces.low) @ np.abs(turn[2])
    return middle @ turn[2] - reach, middle @ turn[2] + reach


def _cut_slab(
    lattice: TriangulatedLattice, parts: BodyTriangles, choice: PieceChoice, turn: Array, edges: Array, error: float
) -> tuple[MeshSections, Array]:
    mesh = lattice.fill(parts, choice, is_closed=False)
    points, middles, heights = mesh.points @ turn.T, 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)
    sections = cut_mesh(points, mesh.triangles, middles, error)
    nodes, weights = np.polynomial.legendre.leggauss(SECTIONS_OF_LAYER)
    levels = (middles[:, None] + 0.5 * heights[:, None] * nodes).ravel()
    areas = measure_sections(points, mesh.triangles, levels).reshape(-1, SECTIONS_OF_LAYER)
    return sections, 0.5 * heights * (areas @ weights)
