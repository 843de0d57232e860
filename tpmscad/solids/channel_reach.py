"""Whether the channels of a heat exchanger will connect their openings, by samples of body and wall before any work starts.

The samples are a grid in the body and points of its openings, coarser than necks of the channels. They err towards channels that
connect: samples join across corners, and distances from closed faces are those from points of them. What fails is tried once more
on a grid of half the spacing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import label, map_coordinates
from scipy.spatial import cKDTree

from tpmscad import fields, surfaces
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.triangle_distance import grid_winding_numbers
from tpmscad.fields.kinds.normal_distance import NormalDistance
from tpmscad.kernel.measure.shape_sampling import sample_faces
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.lattices.mapped_surface import grading
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.ended_channels import ChannelEnds

SAMPLES_PER_CELL = 24.0
"""Samples along the shortest edge of a cell where a fault is confirmed: a neck of the gyroid has eight across."""

MAX_SAMPLES = 1_500_000
"""Samples in a body's box, about two seconds; more cells have fewer samples each."""

MIN_SAMPLES_PER_CELL = 10.0
"""Below this necks are too narrow for the grid, and nothing is said."""

TABLE_SIZE = 24
"""Samples of the distance from the mid surface along each edge of a cell; between them it is known to a hundredth of a cell."""

NEIGHBOUR_SPACINGS = 1.8
"""In spacings: distance of a sample from that of an opening to which it is joined, just more than a cube's diagonal."""

TRIED_FRACTIONS = (0.8, 0.65, 0.5, 0.35, 0.25)
"""Fractions of the skin and of the cell that are tried for the remedy."""


@dataclass(frozen=True, slots=True, eq=False)
class BodySamples:
    """Samples of a body: `points` (n, 3) of a grid, and after them those of its openings.

    `inside` (nx, ny, nz): which nodes of the grid lie in the body. `face` (n,): the number of the opening, or -1. `depth`: for
    each channel the distances (n,) from its closed faces, infinite where the skin is a spacing behind.
    """

    spacing: float
    inside: BoolArray
    points: Array
    face: IntArray
    depth: Mapping[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class WallHeight:
    """How far points of a body lie beyond either side of a wall, about, by a table (m, m, m) over a cell.

    `rotation` (3, 3) takes lattice coordinates to the body's.
    """

    request: LatticeRequest
    rotation: Array
    table: Array

    @classmethod
    def of(cls, request: LatticeRequest, rotation: Array) -> WallHeight:
        """That of a wall of any thickness."""
        phi = fields.tpms(request.surface, request.cell, reference=request.reference)
        axes = [np.arange(TABLE_SIZE) * (edge / TABLE_SIZE) for edge in request.cell]
        return cls(request, rotation, (NormalDistance(phi) if request.levels is None else phi).on_grid(*axes))

    def with_cell(self, edge: float) -> WallHeight:
        """That of a wall of the same thickness, with a cubic cell of another edge."""
        factor = edge / self.request.cell[0]
        return replace(self, request=replace(self.request, cell=(edge,) * 3), table=factor * self.table)

    def __call__(self, points: Array) -> tuple[Array, Array]:
        """Heights above the upper and below the lower side of the wall at points (n, 3), negative within: (n,) each."""
        own = self.request.turned(self.rotation)
        place = (points @ self.rotation / np.array(own.cell) - np.array(own.phase)) % 1.0
        value = map_coordinates(self.table, TABLE_SIZE * place.T, order=1, mode="grid-wrap")
        low, high = own.offset if own.levels is None else own.levels
        unit, centre = grading(own.thickness, own.centre, points)
        return value - centre - high * unit, centre + low * unit - value


def require_connected(body: KernelBody, request: LatticeRequest, rotation: Array, ends: ChannelEnds) -> None:
    """InvalidRequest if a channel does not reach one of its openings, or does not connect them, with what would do."""
    low, high = body.cad.box
    edge = min(request.cell)
    spacing = max(edge / SAMPLES_PER_CELL, float(np.prod(high - low) / MAX_SAMPLES) ** (1 / 3))
    if spacing > edge / MIN_SAMPLES_PER_CELL:
        return
    wall = WallHeight.of(request, rotation)
    coarse = sample_body(body, ends, 2 * spacing)
    if find_fault(body, coarse, wall, ends) is None:
        return
    fine = sample_body(body, ends, spacing)
    fault = find_fault(body, fine, wall, ends)
    if fault is None:
        return
    cell = " x ".join(f"{v:g}" for v in dict.fromkeys(request.cell))
    remedies = _find_remedies(body, fine, wall, ends)
    remedy = (
        f"{' or '.join(remedies)} works" if remedies else "use a smaller cell and skin, or shift the lattice by phase"
    )
    raise InvalidRequest(f"{fault}, with a cell of {cell} and {ends.skin:g} of wall where it is closed: {remedy}")


def _find_remedies(body: KernelBody, samples: BodySamples, wall: WallHeight, ends: ChannelEnds) -> list[str]:
    """The greatest of some smaller skins, and of some smaller cells, with which the channels connect their openings."""
    request = wall.request
    skin = next(
        (s for s in _list_smaller(ends.skin) if find_fault(body, samples, wall, replace(ends, skin=s)) is None), None
    )
    edges = _list_smaller(request.cell[0]) if len(set(request.cell)) == 1 else []
    edge = next(
        (
            e
            for e in edges
            if _is_wall_possible(request, e) and find_fault(body, samples, wall.with_cell(e), ends) is None
        ),
        None,
    )
    return [f"a {name} of {value:g}" for name, value in (("skin", skin), ("cell", edge)) if value is not None]


def _list_smaller(value: float) -> list[float]:
    """Some smaller values, of two digits."""
    return [float(f"{fraction * value:.2g}") for fraction in TRIED_FRACTIONS]


def _is_wall_possible(request: LatticeRequest, edge: float) -> bool:
    """Whether a smaller cell can have the wall."""
    if request.even_offset is None:
        return False
    try:
        for distance in request.offset:
            surfaces.check_offset(request.surface, request.reference, distance, edge)
    except InvalidRequest:
        return False
    return True


def sample_body(body: KernelBody, ends: ChannelEnds, spacing: float) -> BodySamples:
    """The samples of a body at a spacing."""
    own = faces_of(body.cad.shape)
    low, high = body.cad.box
    x, y, z = (np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True))
    mesh = body.mesh(spacing / 4)
    inside = grid_winding_numbers(mesh.points, mesh.triangles, x, y, z) != 0
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)[inside]
    opened = sorted(ends.openings.plus | ends.openings.minus)
    on_face = [sample_faces([own[number]], spacing / 2).points for number in opened]
    points = np.concatenate([nodes, *on_face])
    face = np.repeat([-1, *opened], [len(nodes), *map(len, on_face)])
    depth = {}
    for name, of in ends.openings_of.items():
        closed = [each for number, each in enumerate(own) if number not in of]
        depth[name] = np.full(len(points), np.inf)
        if closed:
            tree = cKDTree(sample_faces(closed, min(spacing, ends.skin)).points)
            depth[name] = tree.query(points, distance_upper_bound=ends.skin + spacing)[0]
    return BodySamples(spacing, inside, points, face, depth)


def find_fault(body: KernelBody, samples: BodySamples, wall: WallHeight, ends: ChannelEnds) -> str | None:
    """What a channel misses, in words; None if each connects its openings."""
    for height, (name, opened) in zip(wall(samples.points), ends.openings_of.items(), strict=True):
        is_free = (height > 0) & (samples.depth[name] >= ends.skin)
        is_node = samples.face < 0
        filled = samples.inside.copy()
        filled[samples.inside] = is_free[is_node]
        piece = label(filled, np.ones((3, 3, 3)))[0][filled]
        reached = []
        for number in sorted(opened):
            points = samples.points[is_free & (samples.face == number)]
            if not len(piece) or not len(points):
                return f"{name} does not reach {body.face_labels[number]}, an opening"
            distance, nearest = cKDTree(samples.points[is_free & is_node]).query(points)
            reached.append(set(piece[nearest[distance < NEIGHBOUR_SPACINGS * samples.spacing]].tolist()))
        if not set.intersection(*reached):
            faces = ", ".join(body.face_labels[number] for number in sorted(opened))
            return f"{name} falls into pieces that do not connect its openings, {faces}"
    return None
