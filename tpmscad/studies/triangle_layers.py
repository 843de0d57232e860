"""Layers of a filled body from the triangles of its lattice, in slabs: where no cell is a copy of another.

The pieces that meet a slab are placed, cut by the body, and cut by the planes of its layers. Every chord lies in a triangle,
within the deviation of the exact surface; areas and volumes are those of the triangles.
"""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.sections.layer_contours import LayerContours, LayerSection
from tpmscad.brep.sections.mesh_sections import cut_mesh, measure_sections
from tpmscad.brep.triangles.closed_mesh import SolidMesh
from tpmscad.brep.triangles.filled_mesh import PieceChoice
from tpmscad.parallel import task_runner
from tpmscad.studies.lattice_triangles import BodyTriangles, TriangulatedLattice, TriangulatedMatter

TRIANGLES_PER_SLAB = 6_000_000
"""Triangles of the lattice that are placed at a time, which limits the memory: about a gigabyte."""


def cut_into_layers(
    filling: TriangulatedLattice | TriangulatedMatter,
    parts: BodyTriangles,
    turn: Array,
    edges: Array,
    error: float,
    executor: Executor | None,
) -> tuple[list[LayerSection], Array]:
    """The sections in the middles of layers, and the volumes of all layers (l,).

    The layers lie between ascending heights (l + 1,) of the model, which `turn` (3, 3) takes the lattice's axes to.
    error: distance of points that are left out from the chords.
    """
    if isinstance(filling, TriangulatedMatter):
        sections, volumes = _cut_filled(filling.fill(parts), turn, edges, error)
        return list(sections), volumes
    low, high = _find_heights(filling, turn)
    used = filling.choice.whole | filling.choice.cut
    height = max(
        float(np.diff(edges).max()), np.ptp(edges) * TRIANGLES_PER_SLAB / max(filling.count_triangles(used), 1.0)
    )
    slab = np.floor((edges[:-1] - edges[0]) / height).astype(int)
    starts = np.append(np.flatnonzero(np.diff(slab, prepend=-1)), len(slab))
    tasks = []
    for first, last in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        meets: BoolArray = (high >= edges[first]) & (low <= edges[last])
        choice = PieceChoice(filling.choice.origin, filling.choice.whole & meets, filling.choice.cut & meets)
        tasks.append((filling, parts, choice, turn, edges[first : last + 1], error))
    with task_runner(executor, tasks[0]) as run_tasks:
        found = run_tasks(_cut_slab, tasks)
    return [section for sections, _ in found for section in sections], np.concatenate([own for _, own in found])


def _find_heights(filling: TriangulatedLattice, turn: Array) -> tuple[Array, Array]:
    """The least and the greatest height of each piece in the model, (x, y, z, P)."""
    pieces, size = filling.pieces, filling.choice.whole.shape[:3]
    corner = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1) + filling.choice.origin
    middle = (corner * pieces.cell)[..., None, :] + 0.5 * (pieces.low + pieces.high)
    reach = 0.5 * (pieces.high - pieces.low) @ np.abs(turn[2])
    return middle @ turn[2] - reach, middle @ turn[2] + reach


def _cut_slab(
    filling: TriangulatedLattice, parts: BodyTriangles, choice: PieceChoice, turn: Array, edges: Array, error: float
) -> tuple[LayerContours, Array]:
    return _cut_filled(filling.fill(parts, choice), turn, edges, error)


def _cut_filled(mesh: SolidMesh, turn: Array, edges: Array, error: float) -> tuple[LayerContours, Array]:
    """Sections in the middles between heights (l + 1,), and the volumes there (l,), by the rule of Gauss with three sections."""
    points, middles, heights = mesh.points @ turn.T, 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)
    sections = cut_mesh(points, mesh.triangles, middles, error)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    levels = (middles[:, None] + 0.5 * heights[:, None] * nodes[[0, 2]]).ravel()
    beside = measure_sections(points, mesh.triangles, levels).reshape(-1, 2).sum(axis=1)
    return sections, 0.5 * heights * (weights[0] * beside + weights[1] * sections.areas)
