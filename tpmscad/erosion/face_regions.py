"""Faces of a body as regions of their carriers' parameter domains, bounded by polygonal trimming loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import EdgeCurve, Plane
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.brep.loops import pair_with_intervals
from tpmscad.splines.bspline import is_segment

LEAST_SEGMENTS = 256
"""Least polygon segments per curved edge; a circle's polygon deviates by at most 8e-5 of the radius."""

MIN_SQUARED_LENGTH = 1e-300
"""Lower bound of squared segment lengths used as divisors: a segment at a pole has length zero."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceRegion:
    """The region of one face of the body in its carrier's parameter domain.

    `segments` (n, 2, 2): the trimming loops in (u, v). `border` (m, 2, 3): the edges in space. `reference_parameters` (2,): the
    centre of the region's bounding box in (u, v), which selects one of the periodic copies of a parameter.
    """

    carrier: BodyCarrier
    segments: Array
    border: Array
    reference_parameters: Array

    def is_near_border(self, points: Array, distance: float) -> BoolArray:
        """Which points (n, 3) lie within a small distance of the border: (n,)."""
        start, end = self.border[:, 0], self.border[:, 1]
        axis = int(np.ptp(start, axis=0).argmax())
        one, other = start[:, axis], end[:, axis]
        low, high = np.minimum(one, other) - distance, np.maximum(one, other) + distance
        segment, point = pair_with_intervals(points[:, axis], low, high)
        arm, step = points[point] - start[segment], (end - start)[segment]
        along = np.clip((arm * step).sum(axis=1) / np.maximum((step * step).sum(axis=1), MIN_SQUARED_LENGTH), 0.0, 1.0)
        near = np.linalg.norm(arm - along[:, None] * step, axis=1) <= distance
        found = np.zeros(len(points), bool)
        found[point[near]] = True
        return found


def shift_to_period(uv: Array, carrier: BodyCarrier, reference: Array) -> Array:
    """(u, v) (..., 2) shifted by whole periods to within half a period of `reference`."""
    uv = uv.copy()
    for axis, period in enumerate(carrier.period):
        if period:
            uv[..., axis] -= period * np.round((uv[..., axis] - reference[axis]) / period)
    return uv


def list_carriers(brep: Brep, free_form: Mapping[int, FreeFormSurface]) -> list[BodyCarrier]:
    """The carrier of each face (F), of which splines are given with their distances, by the numbers of the carriers."""
    found = [free_form.get(c, brep.carriers[c]) for c in brep.faces.carrier.tolist()]
    return [c for c in found if not hasattr(c, "poles")]


def build_regions(
    brep: Brep, carriers: Sequence[BodyCarrier], curves: Sequence[EdgeCurve], sag: float
) -> list[FaceRegion]:
    """The regions of faces on the carriers (F), bounded by edges on the curves (M); polygons keep to `sag` (model units)."""
    result = []
    for f, carrier in enumerate(carriers):
        segments, border = [], []
        for k in range(*brep.faces.use_start[brep.faces.loop_start[f : f + 2]].tolist()):
            e = brep.uses.edge[k]
            curve, sense = curves[e], brep.uses.sense[k]
            pcurve = None if isinstance(carrier, Plane) else brep.pcurves[brep.uses.pcurve[k]]
            low, high = brep.edges.span[e][:: 1 if sense > 0 else -1]
            points = _divide_curve(curve, (low, high), sag)
            if pcurve is None or isinstance(carrier, Plane):
                uv = carrier.parameters(points)
            else:
                uv = _divide_curve(pcurve, (low, high), sag, carrier)
            segments.append(uv)
            border.append(points)
        everything = np.concatenate(segments)
        reference = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
        loops = _close_loops(brep.faces.loop_start[f], brep.faces.loop_start[f + 1], brep.faces.use_start, segments)
        result.append(FaceRegion(carrier, loops, np.concatenate([_split_polyline(p) for p in border]), reference))
    return result


def _divide_curve(curve: EdgeCurve, span: tuple[float, float], sag: float, carrier: BodyCarrier | None = None) -> Array:
    """The corners (n, d) of a polygon for a curve, or for a pcurve of a carrier, by its points in space."""
    if is_segment(curve):
        return curve(np.array(span))
    points = curve(np.linspace(*span, 2 * LEAST_SEGMENTS + 1))
    middles, chords = points[1::2], 0.5 * (points[2::2] + points[:-2:2])
    if carrier is not None:
        middles, chords = carrier(*middles.T), carrier(*chords.T)
    off = np.linalg.norm(middles - chords, axis=1).max()
    return curve(np.linspace(*span, LEAST_SEGMENTS * max(1, int(np.ceil(np.sqrt(off / sag)))) + 1))


def _split_polyline(points: Array) -> Array:
    """The segments (n - 1, 2, d) of a polyline (n, d)."""
    return np.stack([points[:-1], points[1:]], axis=1)


def _close_loops(first: int, last: int, use_start: IntArray, uses: list[Array]) -> Array:
    """The segments of trimming loops; a segment joins two uses whose pcurves do not meet, as at a pole."""
    result = []
    offset = int(use_start[first])
    for loop in range(first, last):
        own = uses[use_start[loop] - offset : use_start[loop + 1] - offset]
        path = np.concatenate([*own, own[0][:1]])
        result.append(_split_polyline(path))
    return np.concatenate(result)
