"""Spline maps rounded at their knots, over the cells of a lattice.

The patches of a lattice join with continuous curvature because neighbours read the same derivatives of one smooth surface on
their common border (`g2_fit`). Across a knot at which a map is only C1 or C2, as faces of CAD parts are, these derivatives
differ, and the offset by the normal is a derivative less smooth still. Over a block of cells such a map is replaced by the
nearest spline of degree 7 on spans of half a cell, or shorter ones: C6, and at a measured distance from the map. Where the map is
one polynomial it is the same but for what comes from the knots nearby, which decays from span to span.

Beyond an open end of its domain, where whole cells reach, a map goes on by its second-order Taylor polynomial: polynomials of
higher degree turn over within a cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, triple
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.lattices.spline_maps import BlockMap, SplineMap
from tpmscad.splines.basis import design_matrices, design_matrix
from tpmscad.splines.bspline_volume import BSplineVolume

SMOOTH_ENOUGH = 5
"""Continuous derivatives at knots with which a map is taken as it is: the nodes of a patch resolve the jump of the next."""

DEGREE = 7
"""Degree of the rounded map."""

SPANS_PER_CELL = (2, 4, 8)
"""Spans along the edge of a cell, in the order of trial. A patch is about half a cell long and has 48 nodes."""

SAMPLES_PER_SPAN = 6
"""Samples of the least-squares fit along each span."""

OVERHANG_CELLS = 1
"""The spline reaches so far beyond open ends: whole cells of a natural boundary reach half a cell beyond."""

REACH_CELLS = 0.6
"""How far the patches of a natural boundary reach beyond the ends."""

MAX_SLOPE_CHANGE = 0.7
"""Greatest change of a derivative over that way, as a part of it, with which the polynomials of the last spans are kept."""

ROUNDING_SHARE = 0.5
"""Of the tolerance: how far a map may move where it is rounded."""

CHECKS_PER_CELL = 16
"""Places along the edge of a cell at which the rounded map is compared, besides the knots of the map."""


@dataclass(frozen=True, slots=True, eq=False)
class RoundedMap:
    """The map of a block of cells, and the greatest measured distance from the spline map, 0 if that was smooth."""

    map: Map
    moved: float


def round_over_cells(spline: SplineMap, cells: tuple[int, int, int], cell: Array, tol: float) -> RoundedMap:
    """The map of a block of cells that fills the domain of a spline map, C6 or smoother.

    `cell` (3,) are the edges of a cell in block coordinates, `tol` the tolerance of the lattice in model units. InvalidRequest
    with knot and place if the rounded map moves by more than its share of the tolerance even on the shortest spans.
    """
    size = cell * np.array(cells, float)
    rough = triple(
        _continuity(spline, axis).min(initial=SMOOTH_ENOUGH) < SMOOTH_ENOUGH or _turns_beyond(spline, axis, n)
        for axis, n in enumerate(cells)
    )
    if not any(rough):
        return RoundedMap(spline.over_block(size), 0.0)
    at = [_check_places(spline, axis, n) for axis, n in enumerate(cells)]
    exact = spline.volume.grid(at[0], at[1], at[2])
    for per_cell in SPANS_PER_CELL:
        volume = _fit(spline, cells, rough, per_cell)
        in_cells = [_to_cells(spline, axis, n, t) for axis, (n, t) in enumerate(zip(cells, at, strict=True))]
        miss = np.linalg.norm(volume.grid(in_cells[0], in_cells[1], in_cells[2]) - exact, axis=-1)
        if miss.max() <= ROUNDING_SHARE * tol:
            return RoundedMap(
                BlockMap.over(volume, spline.closed, np.zeros(3), 1.0 / cell, spline.name), float(miss.max())
            )
    worst = np.unravel_index(int(np.argmax(miss)), miss.shape)
    place, parameters = exact[worst], np.array([t[i] for t, i in zip(at, worst, strict=True)])
    raise InvalidRequest(_describe(spline, cells, rough, parameters, place, float(miss.max()), tol))


def _continuity(spline: SplineMap, axis: int) -> Array:
    """Orders of the derivatives that are continuous at each inner knot along an axis."""
    knots, degree = spline.volume.knots[axis], spline.volume.degrees[axis]
    return np.asarray(degree - np.unique(knots[degree + 1 : -degree - 1], return_counts=True)[1])


def _turns_beyond(spline: SplineMap, axis: int, n_cells: int) -> bool:
    """Whether the polynomials of the last spans turn over where cells reach beyond the ends of an axis."""
    if spline.closed[axis]:
        return False
    volume, (low, high) = spline.volume, spline.volume.domain[axis]
    reach = REACH_CELLS * (high - low) / n_cells
    at = [np.linspace(*ends, CHECKS_PER_CELL) for ends in volume.domain]
    orders = (int(axis == 0), int(axis == 1), int(axis == 2))
    slopes = []
    for t in ([low, high], [low - reach, high + reach]):
        at[axis] = np.array(t)
        slopes.append(volume.grid(at[0], at[1], at[2], orders))
    change = np.linalg.norm(slopes[1] - slopes[0], axis=-1) / np.linalg.norm(slopes[0], axis=-1)
    return bool(change.max() > MAX_SLOPE_CHANGE)


def _check_places(spline: SplineMap, axis: int, n_cells: int) -> Array:
    low, high = spline.volume.domain[axis]
    return np.union1d(
        np.linspace(low, high, CHECKS_PER_CELL * n_cells + 1), np.clip(spline.volume.knots[axis], low, high)
    )


def _to_cells(spline: SplineMap, axis: int, n_cells: int, t: Array) -> Array:
    low, high = spline.volume.domain[axis]
    return np.asarray(n_cells * ((t - low) / (high - low)))


def _fit(
    spline: SplineMap, cells: tuple[int, int, int], rough: tuple[bool, bool, bool], per_cell: int
) -> BSplineVolume:
    """The nearest spline in lattice coordinates, in cells, smooth along the axes that are `rough`."""
    poles, volume = spline.volume.poles, spline.volume
    knots, degrees = list(volume.knots), list(volume.degrees)
    for axis in range(3):
        if not rough[axis]:
            knots[axis] = _to_cells(spline, axis, cells[axis], volume.knots[axis])
            continue
        ends = (0, 0) if spline.closed[axis] else (-OVERHANG_CELLS, OVERHANG_CELLS)
        spans = per_cell * (cells[axis] + ends[1] - ends[0])
        knots[axis] = ends[0] + np.arange(-DEGREE, spans + DEGREE + 1) / per_cell
        degrees[axis] = DEGREE
        t = ends[0] + (np.arange(SAMPLES_PER_SPAN * spans) + 0.5) / (SAMPLES_PER_SPAN * per_cell)
        basis = design_matrix(knots[axis], DEGREE, t)
        if spline.closed[axis]:  # the last poles are the first ones again
            wrapped = np.arange(spans + DEGREE) % spans
            basis = basis @ np.eye(spans)[wrapped]
        fitted = np.linalg.lstsq(basis, _rows_beyond(spline, axis, cells[axis], t), rcond=None)[0]
        if spline.closed[axis]:
            fitted = fitted[wrapped]
        poles = np.moveaxis(np.tensordot(fitted, poles, axes=(1, axis)), 0, axis)
    return BSplineVolume(np.ascontiguousarray(poles), triple(knots), triple(degrees))


def _rows_beyond(spline: SplineMap, axis: int, n_cells: int, t: Array) -> Array:
    """Basis functions of the map at t (m,) along an axis, in cells, by Taylor's polynomial beyond the ends: (m, poles)."""
    knots, degree = spline.volume.knots[axis], spline.volume.degrees[axis]
    low, high = spline.volume.domain[axis]
    at = low + (high - low) * t / n_cells
    inside = np.clip(at, low, high)
    step = (at - inside)[:, None]
    value, slope, bend = design_matrices(knots, degree, inside, (0, 1, 2))
    return np.asarray(value + step * slope + step**2 / 2 * bend)


def _describe(
    spline: SplineMap,
    cells: tuple[int, int, int],
    rough: tuple[bool, bool, bool],
    at: Array,
    place: Array,
    moved: float,
    tol: float,
) -> str:
    """Why the map can't be rounded: the knot next to the parameters `at` (3,) along the axis whose rounding moves them most."""
    moves = []
    for axis in range(3):
        alone = triple(rough[i] and i == axis for i in range(3))
        volume = _fit(spline, cells, alone, SPANS_PER_CELL[-1])
        in_cells = [_to_cells(spline, i, n, at[i : i + 1]) for i, n in enumerate(cells)]
        moves.append(
            float(
                np.linalg.norm(
                    volume.grid(in_cells[0], in_cells[1], in_cells[2]) - spline.volume.grid(at[:1], at[1:2], at[2:])
                )
            )
        )
    axis = int(np.argmax(moves))
    knots, degree = spline.volume.knots[axis], spline.volume.degrees[axis]
    inner = np.unique(knots[degree + 1 : -degree - 1])
    cause = f"beyond the ends of {'uvw'[axis]} it turns over"
    if len(inner):
        nearest = int(np.argmin(np.abs(inner - at[axis])))
        order = int(_continuity(spline, axis)[nearest])
        if order < SMOOTH_ENOUGH:
            cause = f"at its knot {'uvw'[axis]} = {inner[nearest]:.6g} it is C{order} only"
    return (
        f"the {spline.name} is too rough for cells of this size: {cause}, and rounded there over an eighth of a cell it moves "
        f"by {moved:.3g} near {format_point(place)} in the model, "
        f"more than {ROUNDING_SHARE * tol:.3g}, half of tol: take more cells "
        f"along {'xyz'[axis]}, a greater tol, or a face that is smoother there"
    )
