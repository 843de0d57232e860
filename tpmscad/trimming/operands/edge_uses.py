"""Edges of a network and their uses in loops: points in space, (u, v) on the faces, and polygons that stand for the loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Carrier, Circle, ConicalSurface, Ellipse, Plane, SphericalSurface
from tpmscad.brep.quadrics import MIN_POLE_STEP_ANGLE
from tpmscad.errors import InvalidRequest
from tpmscad.index_ranges import list_following
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, is_segment
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.trimming.operands.conic_splines import approximate_conic

SEGMENTS_PER_USE = 24
"""Segments of the polygon that stands for a curved edge in (u, v)."""

MAX_POLE_EXTENT = 1e-9
"""Extent of a side that is a point, relative to the surface."""


def list_spline_curves(brep: Brep) -> tuple[BSplineCurve, ...]:
    """The curves of a network's edges as splines: conics equal to them up to round-off, on the spans of their edges."""
    if brep not in _spline_curves:
        edges = brep.edges
        _spline_curves[brep] = tuple(
            curve if isinstance(curve, BSplineCurve) else _approximate_used(curve, edges.span[edges.curve == c])
            for c, curve in enumerate(brep.curves)
        )
    return _spline_curves[brep]


_spline_curves: WeakKeyDictionary[Brep, tuple[BSplineCurve, ...]] = WeakKeyDictionary()
"""What `list_spline_curves` has made of networks that are in use."""


def _approximate_used(conic: Circle | Ellipse, spans: Array) -> BSplineCurve:
    """A conic on the spans (n, 2) of its edges; a line in its place if it has none."""
    return approximate_conic(conic, float(spans.min()), float(spans.max())) if len(spans) else _NO_CURVE


_NO_CURVE = BSplineCurve(np.zeros((2, 3)), np.array([0.0, 0.0, 1.0, 1.0]), 1)


class UseSegments(NamedTuple):
    """The segments of all loops' polygons, in the order of the uses.

    `use`: the use of each; `begin`: the fraction of its way where it starts; `length`: the fraction that it covers, 0 of a step
    along a pole.
    """

    use: IntArray
    begin: Array
    length: Array


def divide_uses(brep: Brep, rows: IntArray | None = None) -> UseSegments:
    """Segments that stand for the edge uses, all or those of the faces `rows` (n,) in ascending order.

    A use has one where it is straight in (u, v), and one more for a step along a pole.

    At the pole of a sphere or a spline, or the apex of a cone, a loop runs from the end of a use to another u, where the next one
    starts.
    """
    uses = brep.uses
    is_line = np.array([is_segment(c) for c in brep.pcurves], bool)
    straight_edge = np.array([is_segment(c) for c in brep.curves], bool)[brep.edges.curve[uses.edge]]
    straight = np.where(uses.pcurve >= 0, is_line[uses.pcurve] if len(is_line) else False, straight_edge)
    regular = np.where(straight, 1, SEGMENTS_PER_USE)
    count = regular + _step_along_poles(brep)
    if rows is not None:
        count[~np.isin(brep.face_of_use, rows)] = 0
    owner = np.repeat(np.arange(len(uses)), count)
    position = np.arange(len(owner)) - (np.cumsum(count) - count)[owner]
    length = np.where(position < regular[owner], 1.0 / regular[owner], 0.0)
    return UseSegments(owner, position / regular[owner], length)


def _step_along_poles(brep: Brep) -> BoolArray:
    """Uses (K,) behind whose end the loop steps along a pole."""
    faces = brep.faces
    result = np.zeros(len(brep.uses), bool)
    has_pole = np.array([_has_pole(c) for c in brep.carriers], bool)
    use = np.flatnonzero(has_pole[faces.carrier][brep.face_of_use])
    if len(use):
        following = list_following(faces.use_start)
        end, start = (evaluate_uses(brep, k, np.full(len(use), x)) for k, x in ((use, 1.0), (following[use], 0.0)))
        result[use] = np.abs(end - start)[:, 0] > MIN_POLE_STEP_ANGLE
    return result


def _has_pole(carrier: Carrier) -> bool:
    """Whether a whole line of the carrier's parameters may be one point: of a spline, if the poles of a side are."""
    if not isinstance(carrier, BSplineSurface):
        return isinstance(carrier, SphericalSurface | ConicalSurface)
    p = carrier.poles
    extent = min(float(np.ptp(side, axis=0).max()) for side in (p[0], p[-1], p[:, 0], p[:, -1]))
    return extent <= MAX_POLE_EXTENT * float(np.ptp(p, axis=(0, 1)).max())


def sample_loops(brep: Brep, rows: IntArray) -> list[Array]:
    """The loops of each of the faces `rows` (n,), in ascending order, as segments (m, 2, 2) in the (u, v) of its carrier."""
    faces = brep.faces
    use, begin, _ = divide_uses(brep, rows)
    first = np.searchsorted(use, np.arange(len(brep.uses) + 1))
    points = evaluate_uses(brep, use, begin)
    result = []
    for f in rows.tolist():
        loops = []
        for j in range(faces.loop_start[f], faces.loop_start[f + 1]):
            own = points[first[faces.use_start[j]] : first[faces.use_start[j + 1]]]
            loops.append(np.stack([own, np.roll(own, -1, axis=0)], axis=1))
        result.append(np.concatenate(loops))
    return result


def evaluate_uses(brep: Brep, use: IntArray, fraction: Array) -> Array:
    """(u, v) (n, 2) of edge uses (n,) at fractions of their way, in their direction."""
    uses = brep.uses
    span = brep.edges.span[uses.edge[use]]
    x = np.where(uses.sense[use] > 0, fraction, 1.0 - fraction)
    return evaluate_use_parameters(brep, use, span[:, 0] + x * (span[:, 1] - span[:, 0]))


def evaluate_use_parameters(brep: Brep, use: IntArray, t: Array) -> Array:
    """(u, v) (n, 2) of edge uses (n,) at parameters t (n,) of their edges."""
    uses, result = brep.uses, np.empty((len(use), 2))
    rows = np.flatnonzero(uses.pcurve[use] >= 0)
    if len(rows):
        result[rows] = evaluate_curves(brep.pcurves, uses.pcurve[use[rows]], t[rows])[0]
    rows = np.flatnonzero(uses.pcurve[use] < 0)
    (points,) = evaluate_edges(brep, uses.edge[use[rows]], t[rows])
    result[rows] = project_onto_planes(brep, brep.face_of_use[use[rows]], points)
    return result


def evaluate_edges(brep: Brep, edge: IntArray, t: Array, orders: Sequence[int] = (0,)) -> list[Array]:
    """Points, or derivatives along the curves, (n, 3) for each order, of edges (n,) at parameters (n,)."""
    if not len(edge):
        return [np.zeros((0, 3)) for _ in orders]
    motion = brep.edges.motion[edge]
    found = evaluate_curves(list_spline_curves(brep), brep.edges.curve[edge], t, orders)
    return [
        motion.apply_to_vectors(values) if order else motion.apply(values)
        for order, values in zip(orders, found, strict=True)
    ]


def project_onto_planes(brep: Brep, face: IntArray, points: Array) -> Array:
    """(u, v) (n, 2) of points (n, 3) on the planar faces (n,); InvalidRequest if one is not planar."""
    result, local = np.empty((len(face), 2)), brep.faces.motion[face].apply_inverse(points)
    carrier = brep.faces.carrier[face]
    for c in np.unique(carrier).tolist():
        plane, own = brep.carriers[c], carrier == c
        if not isinstance(plane, Plane):
            raise InvalidRequest("an edge of a face that is no plane lacks its parameter curve")
        result[own] = plane.parameters(local[own])
    return result
