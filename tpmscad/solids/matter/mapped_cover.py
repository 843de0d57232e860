"""A lattice under a map that covers a body: the cells whose images come near it, found from cell to cell.

Nothing is known of the inverse of a map. A cell whose image meets the body is sought among those about the origin of the lattice
coordinates; from there neighbours are added while their images come near the body. Where the map repeats after a whole number of
cells, the lattice meets itself; cells that come to lie on each other otherwise are refused.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, FractionProgress, IntArray, triple
from tpmscad.brep.boundary_representation import Brep, move_brep
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.lattices import mapped_lattice
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.lattices.copies import translate_motions
from tpmscad.lattices.mapped_surface import MappedSurface, repeats_after
from tpmscad.lattices.spline_maps import SplineMap
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.rigid_motion import Motion
from tpmscad.solids.matter.body_nearness import BodyNearness, measure_diagonals
from tpmscad.solids.matter.lattice_block import (
    MAX_CELLS_IN_BOX,
    LatticeBlock,
    check_wall_thickness,
    fit_patches_one_by_one,
)
from tpmscad.solids.matter.mapped_block import compose_map, exact_source, find_greatest_offset
from tpmscad.solids.matter.patch_measures import measure_lattice_patches
from tpmscad.solids.matter.reference_distance import lattice_distance
from tpmscad.stage_timer import StageTimer

FIRST_REACHES = (2, 6, 20)
"""Cells about the origin of the lattice coordinates, along each axis, among which those near the body are sought."""

MAX_CELLS_ROUND = 400
"""Cells along an axis after which a map may repeat."""

NEAR_CELLS = 0.3
"""In diagonals of a cell's image: how near to the body one of these points is, half of what lies between them and a margin."""

ON_EACH_OTHER = 0.4
"""In diagonals of a cell's image: distance of the middles of cells that lie on each other."""

CORNERS = np.stack(np.meshgrid(*([0.0, 0.5, 1.0],) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
"""Corners of a cell, and the middles of its edges, faces and body."""

MIDDLE = 13
"""Of these points that in the middle of the cell."""


def build_mapped_block(
    request: LatticeRequest, map: Any, rotation: Array, body: CadBody, stages: StageTimer
) -> LatticeBlock:
    """The lattice under a map around a body; `rotation` (3, 3) takes the model of the map to the body's coordinates."""
    check_wall_thickness(request)
    graded, request = request, request.turned(rotation)
    edges = np.array(request.cell)
    # the domain of a spline is divided; other maps count cells from their own origin, not from the end of a block
    is_spline = isinstance(map, SplineMap)
    counts = np.maximum(1, np.rint(map.mean_edges() / edges)).astype(int) if is_spline else np.zeros(3, int)
    request = replace(request, cells=triple(counts.tolist()))
    mapping, notes = compose_map(request, map)
    assert mapping is not None
    with stages("fit") as done:
        turned = BodyNearness(body, rotation, float(edges.min()))
        origins, periods = _find_cells(mapping, request, turned, map)
        patches, fit = _fit_cover(request, mapping, origins, periods, turned, done)
    with stages("assemble"):
        patches = move_brep(patches, Motion(rotation, np.zeros(3)))
        measures = measure_lattice_patches(request, mapping, patches, fit, notes)
    distance = lattice_distance(replace(graded, cells=request.cells), mapping, rotation)
    return LatticeBlock(f"{request.surface} infill", patches, measures, distance, _refuse_box)


def _refuse_box() -> Brep:
    raise InvalidRequest(
        "a lattice under a map is open and has no solid in a box, which the kernel's boolean would need"
    )


def _image_cells(mapping: Map, cell: float, origins: IntArray) -> Array:
    """The images (n, 27, 3) of the corners and middles of cells."""
    return mapping(cell * (origins[:, None] + CORNERS))


def _find_cells(mapping: Map, request: LatticeRequest, near: BodyNearness, given: Any) -> tuple[IntArray, IntArray]:
    """The origins (n, 3) of the cells near a body, and the periods of the lattice, both in cells."""
    cell, periods = request.cell[0], np.zeros(3, np.int64)
    low, high = np.full(3, -MAX_CELLS_ROUND), np.full(3, MAX_CELLS_ROUND)
    if isinstance(given, SplineMap):
        closed = np.array(given.closed)
        low, high = np.where(closed, 0, -1), np.where(closed, 0, 1) + request.cells
        periods = np.where(closed, request.cells, 0).astype(np.int64)
    start = np.zeros((0, 3), np.int64)
    for reach in FIRST_REACHES:
        axes = [np.arange(max(-reach, a), min(reach + 1, b)) for a, b in zip(low, high, strict=True)]
        tried = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        start = tried[_is_usable(mapping, cell, tried) & near(_image_cells(mapping, cell, tried), NEAR_CELLS)]
        if len(start):
            break
    if not len(start):
        raise InvalidRequest(
            f"{mapping.name} brings no cell within {FIRST_REACHES[-1]} cells of its origin near {near.body.name}: its image must "
            "lie about the body"
        )
    if not isinstance(given, SplineMap):
        periods = np.array([_find_period(mapping, cell, np.asarray(cell * (start + 0.5)), axis) for axis in range(3)])
    found = _spread(mapping, cell, start, near, periods, low, high)
    _require_apart(mapping, cell, found, periods)
    return found, periods


def _is_usable(mapping: Map, cell: float, origins: IntArray) -> BoolArray:
    """Whether the map keeps its orientation in cells: beyond an axis or a pole it does not."""
    jacobian = mapping.jacobian(cell * (origins[:, None] + CORNERS), cell)
    determinant = np.linalg.det(jacobian)
    sign = np.sign(np.median(determinant))
    return np.asarray((sign * determinant > 0).all(axis=1))


def _find_period(mapping: Map, cell: float, points: Array, axis: int) -> int:
    """The number of cells along an axis after which a map repeats, 0 if it does not."""
    step = cell * np.eye(3)[axis]
    return next((n for n in range(1, MAX_CELLS_ROUND + 1) if repeats_after(mapping, n * step, points[:8])), 0)


def _go_round_once(cells: IntArray, periods: IntArray) -> IntArray:
    """Cells, each once, with their numbers along an axis that closes from 0 to below its period."""
    return np.unique(np.where(periods > 0, np.mod(cells, np.maximum(periods, 1)), cells), axis=0)


def _spread(
    mapping: Map, cell: float, start: IntArray, near: BodyNearness, periods: IntArray, low: Any, high: Any
) -> IntArray:
    """All cells near the body that are reached from others, those around a period once, within limits."""
    steps = np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])

    def wrap(cells: IntArray) -> IntArray:
        cells = _go_round_once(cells, periods)
        return cells[((cells >= low) & (cells < high)).all(axis=1)]

    found = front = wrap(start)
    while len(front):
        known = {tuple(each) for each in found.tolist()}
        tried = wrap((front[:, None] + steps).reshape(-1, 3))
        tried = np.array([each for each in tried.tolist() if tuple(each) not in known], np.int64).reshape(-1, 3)
        if not len(tried):
            break
        front = tried[_is_usable(mapping, cell, tried) & near(_image_cells(mapping, cell, tried), NEAR_CELLS)]
        found = np.concatenate([found, front])
        if len(found) > MAX_CELLS_IN_BOX:
            raise InvalidRequest(
                f"the body holds more than {MAX_CELLS_IN_BOX} cells under {mapping.name}: enlarge the cell, or cut the body"
            )
    return found


def _require_apart(mapping: Map, cell: float, origins: IntArray, periods: IntArray) -> None:
    """InvalidRequest if cells that are no neighbours lie on each other."""
    images = _image_cells(mapping, cell, origins)
    middles, sizes = images[:, MIDDLE], measure_diagonals(images)
    pairs = cKDTree(middles).query_pairs(ON_EACH_OTHER * float(sizes.max()), output_type="ndarray")
    apart = np.abs(origins[pairs[:, 0]] - origins[pairs[:, 1]])
    apart = np.where(periods > 0, np.minimum(apart, np.abs(periods - apart)), apart).max(axis=1)
    distance = np.linalg.norm(middles[pairs[:, 0]] - middles[pairs[:, 1]], axis=1)
    pairs = pairs[(distance < ON_EACH_OTHER * sizes[pairs].min(axis=1)) & (apart > 1)]
    if len(pairs):
        first, second = origins[pairs[0]]
        raise InvalidRequest(
            f"under {mapping.name} the cells {first.tolist()} and {second.tolist()} lie on each other near "
            f"{format_point(middles[pairs[0, 0]], 4)}: a lattice that goes round has a whole number of cells, as with radius = "
            "N * cell / (2 pi) round a cylinder"
        )


def _fit_cover(
    request: LatticeRequest,
    mapping: Map,
    origins: IntArray,
    periods: IntArray,
    near: BodyNearness,
    progress: FractionProgress,
) -> tuple[Brep, Any]:
    """The patches of cells, and their fit."""
    cell, source, phase = request.cell[0], exact_source(request), np.array(request.phase)
    cells = _go_round_once(
        np.concatenate([origins, origins - (phase % 1 > 0)]), periods
    )  # with those that the phase brings in
    placements = translate_motions(source.symmetry.cell_motions, cells + (phase - np.floor(phase)))
    images = mapping(cell * mapped_lattice.sample_placements(source.patch, placements))
    reach = find_greatest_offset(request, lambda: images)
    closed = triple(periods.astype(float).tolist())
    in_body = partial(near.is_reached_from, reach=reach)
    surface = MappedSurface(source.patch, source.symmetry, placements, mapping, cell, closed, in_body=in_body)
    return fit_patches_one_by_one(surface, request, near, reach, progress)
