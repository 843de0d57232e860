"""Sample points of OCCT shapes: points with outward normals on faces, sharp edges, and points inside solids.

A face is sampled on a grid of its parameters whose spacing follows the requested distance and the turn of the normal. On trimmed
faces the even-odd rule along each grid row selects the nodes inside the loops. Points and normals are evaluated on the surface.

Points inside a solid lie on parallel lines, which OCCT intersects with the faces: one intersection serves many points.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from OCP.BOPTools import BOPTools_AlgoTools3D
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.GeomAbs import GeomAbs_BSplineCurve, GeomAbs_Line
from OCP.gp import gp_Dir, gp_Lin, gp_Pnt, gp_Pnt2d
from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector
from OCP.IntTools import IntTools_Context, IntTools_FClass2d
from OCP.TopAbs import TopAbs_IN, TopAbs_ON, TopAbs_OUT
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Solid
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.index_ranges import expand_ranges
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    edges_of,
    faces_of,
    orientation_sign,
    solids_of,
)
from tpmscad.kernel.occt.geometry_evaluators import OutwardNormals, SplineSurfaceEvaluator

CREASE_COSINE = np.cos(np.radians(15.0))
"""Cosine of the angle between face normals beyond which an edge is sharp; smooth joints of solids made here differ by 0.01."""

EXTENT_SAMPLES = 17
"""Grid lines along u and along v on which a face's extent is measured."""

MIN_CHORDS_PER_PCURVE = 32
"""Chords per trimming curve, and at least 4 per knot span; nodes closer to the curve than a chord may be misclassified."""

MAX_NORMAL_TURN = np.radians(4.0)
"""Radians between the normals of neighbouring nodes; samples then resolve faces that touch along a single line."""

MAX_PROBES_PER_FACE = 5
"""Samples per face that are classified; a face that crosses the surface meets it along a curve only."""

ROUND_OFF = 1e-6
"""Part of a distance by which it may be wrong, and more. Of a grid with a plane on the boundary of a coupling, three quarters of
the points inside came out outside: the next plane is as far from the boundary as from the points on it."""

NEAREST_POINTS = 7
"""Points, itself included, to which one is linked: in a grid those along the axes."""

NEAREST_SAMPLES = 9
"""Neighbours queried per sample: of two equally dense sets on one plane, the other set is among the nearest nine."""

MAX_OPPOSITE_COSINE = -1.0 + 1e-6
"""Cosine below which two normals count as opposite."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceSamples:
    """Points (n, 3), outward unit normals (n, 3), and the index of the face of each point (n,)."""

    points: Array
    normals: Array
    face: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Creases:
    """Smooth face groups and samples of sharp edges.

    smooth_group (F,): faces joined by smooth edges share a number. points (n, 3) on sharp edges; faces (n, 2): the two faces that
    meet there; normals (n, 2, 3): their outward normals.
    """

    smooth_group: IntArray
    points: Array
    faces: IntArray
    normals: Array


def sample_edge(edge: TopoDS_Edge, pieces: int) -> Array:
    """Points that divide an edge into `pieces` equal parameter intervals, along its orientation: (pieces + 1, 3)."""
    curve = BRepAdaptor_Curve(edge)
    t = np.linspace(curve.FirstParameter(), curve.LastParameter(), pieces + 1)
    points = np.array([curve.Value(s).Coord() for s in t.tolist()])
    return points if orientation_sign(edge) > 0 else points[::-1]


def sample_faces(faces: Sequence[TopoDS_Face], spacing: float, exact: bool = False) -> FaceSamples:
    """Grid nodes on the faces, at most `spacing` and 4 degrees apart along u and v.

    A face narrower than the spacing gets one row of nodes; a sliver may get none. With `exact` the kernel confirms each node:
    chords of a trimming curve leave nodes beside it, off a circle by 0.5 % of its radius.
    """
    sampled = [_sample_face(face, spacing, exact) for face in faces]
    return FaceSamples(
        np.concatenate([points for points, _ in sampled]),
        np.concatenate([normals for _, normals in sampled]),
        np.repeat(np.arange(len(sampled)), [len(points) for points, _ in sampled]),
    )


def interior_points(faces: Sequence[TopoDS_Face]) -> Array:
    """A point inside each face: (n, 3); in the middle of an edge of a sliver inside which the kernel finds none."""
    context, found = IntTools_Context(), np.empty((len(faces), 3))
    for i, face in enumerate(faces):
        point, uv = gp_Pnt(), gp_Pnt2d()
        failed = BOPTools_AlgoTools3D.PointInFace_s(face, point, uv, context)
        found[i] = sample_edge(edges_of(face)[0], 2)[1] if failed else point.Coord()
    return found


def find_creases(faces: Sequence[TopoDS_Face], spacing: float) -> Creases:
    """Groups of faces that join smoothly, and points at most `spacing` apart along the sharp edges."""
    uses: dict[ShapeKey, list[tuple[TopoDS_Edge, int]]] = {}
    for i, face in enumerate(faces):
        for edge in edges_of(face):
            if not BRep_Tool.Degenerated_s(edge):
                uses.setdefault(ShapeKey(edge), []).append((edge, i))
    surfaces = [OutwardNormals(face) for face in faces]
    smooth, sharp = [(0, 0)], [(np.zeros((0, 3)), np.zeros((0, 2, 3)), 0, 0)]
    for users in uses.values():
        if len(users) != 2:
            continue
        (edge, i), (other, j) = users
        points, first = _sample_edge_normals(edge, faces[i], surfaces[i], spacing)
        _, second = _sample_edge_normals(other, faces[j], surfaces[j], spacing, len(points))
        turned = (first * second).sum(axis=1) < CREASE_COSINE
        if turned.any():
            sharp.append((points[turned], np.stack([first, second], axis=1)[turned], i, j))
        else:
            smooth.append((i, j))
    return Creases(
        label_linked(len(faces), np.array(smooth)),
        np.concatenate([points for points, *_ in sharp]),
        np.concatenate([np.tile([i, j], (len(points), 1)) for points, _, i, j in sharp]),
        np.concatenate([normals for _, normals, *_ in sharp]),
    )


def lie_on_surface(solid: TopoDS_Solid, samples: FaceSamples, near: float) -> NDArray[np.bool_]:
    """Mask of the samples within `near` of a solid's surface.

    A few samples of each face are classified; the others of that face follow them.
    """
    classifier = BRepClass3d_SolidClassifier(solid)
    result = np.zeros(len(samples.points), bool)
    for face in np.unique(samples.face):
        members = np.flatnonzero(samples.face == face)
        for i in members[np.linspace(0, len(members) - 1, min(len(members), MAX_PROBES_PER_FACE)).astype(int)]:
            classifier.Perform(convert.point(samples.points[i]), near)
            if classifier.State() != TopAbs_ON:
                break
        else:
            result[members] = True
    return result


def have_touching_solids(shape: Any, samples: FaceSamples, near: float, spacing: float) -> bool:
    """True if faces of different solids of the shape lie on each other with opposite normals."""
    solids = [faces_of(solid) for solid in solids_of(shape)]
    if len(solids) < 2:
        return False
    owner = np.repeat(np.arange(len(solids)), [len(faces) for faces in solids])[samples.face]
    tree = cKDTree(samples.points)
    _, next_to = tree.query(samples.points, k=min(NEAREST_SAMPLES, len(samples.points)), distance_upper_bound=spacing)
    for column in next_to.T:
        i = np.flatnonzero(column < len(samples.points))
        j = column[i]
        back = (samples.normals[i] * samples.normals[j]).sum(axis=1) < MAX_OPPOSITE_COSINE
        level = np.abs(((samples.points[i] - samples.points[j]) * samples.normals[i]).sum(axis=1)) < near
        if (back & level & (owner[i] != owner[j])).any():
            return True
    return False


def _sample_face(face: TopoDS_Face, spacing: float, exact: bool) -> tuple[Array, Array]:
    """Grid points and normals inside the trimming loops of a face: (n, 3) each."""
    surface = OutwardNormals(face)
    loops = _trimming_segments(face)
    low, high = loops.reshape(-1, 2).min(axis=0), loops.reshape(-1, 2).max(axis=0)
    if isinstance(
        surface.evaluate, SplineSurfaceEvaluator
    ):  # poles may lie outside the domain although the curve does not
        first, last = np.array(surface.evaluate.spline.domain).T
        low, high = np.maximum(low, first), np.minimum(high, last)
    us, vs = (np.linspace(a, b, EXTENT_SAMPLES) for a, b in zip(low, high, strict=True))
    net = np.stack(surface(_grid_parameters(us, vs))).reshape(2, EXTENT_SAMPLES, EXTENT_SAMPLES, 3)
    counts = []
    for axis in (0, 1):
        length, turn = np.linalg.norm(np.diff(net, axis=1 + axis), axis=-1).sum(axis=1 + axis).max(axis=-1)
        counts.append(max(1, int(np.ceil(max(length / spacing, turn / MAX_NORMAL_TURN)))))
    u, v = (a + (np.arange(n) + 0.5) * (b - a) / n for a, b, n in zip(low, high, counts, strict=True))
    inside = _inside_even_odd(loops, u, v)
    if exact:
        classifier = IntTools_FClass2d(face, CONFUSION_TOLERANCE)
        at = np.argwhere(inside)
        states = [classifier.Perform(gp_Pnt2d(*uv)) for uv in np.stack([u[at[:, 0]], v[at[:, 1]]], axis=1).tolist()]
        inside[tuple(at.T)] = [state != TopAbs_OUT for state in states]
    return surface(_grid_parameters(u, v)[inside.ravel()])


def _grid_parameters(u: Array, v: Array) -> Array:
    """All pairs of u and v: (len(u) * len(v), 2)."""
    return np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)


def divide_pcurves(face: TopoDS_Face, least: int) -> Iterator[tuple[BRepAdaptor_Curve2d, Array]]:
    """The curves that trim a face, and parameters (n + 1,) of the ends of their chords.

    A line is one chord; others have `least` at least, and 4 in each of their knot spans.
    """
    for edge in edges_of(face):
        curve = BRepAdaptor_Curve2d(edge, face)
        kind = curve.GetType()
        chords = 1 if kind == GeomAbs_Line else least
        if kind == GeomAbs_BSplineCurve:
            chords = max(least, 4 * (curve.BSpline().NbKnots() - 1))
        yield curve, np.linspace(curve.FirstParameter(), curve.LastParameter(), chords + 1)


def _trimming_segments(face: TopoDS_Face) -> Array:
    """The face's trimming loops in its parameters, as line segments: (n, 2, 2)."""
    pieces = []
    for curve, t in divide_pcurves(face, MIN_CHORDS_PER_PCURVE):
        line = np.array([curve.Value(s).Coord() for s in t.tolist()])
        pieces.append(np.stack([line[:-1], line[1:]], axis=1))
    return np.concatenate(pieces)


def _inside_even_odd(loops: Array, u: Array, v: Array) -> Array:
    """Mask of the nodes (u_i, v_j) inside the loops: an odd number of segments crosses the row u = u_i below v_j."""
    start, end = loops[:, 0], loops[:, 1]
    first = np.searchsorted(u, np.minimum(start[:, 0], end[:, 0]), side="right")
    last = np.searchsorted(u, np.maximum(start[:, 0], end[:, 0]), side="right")
    segment, row = expand_ranges(first, last)
    a, b = start[segment], end[segment]
    crossing = a[:, 1] + (b[:, 1] - a[:, 1]) * (u[row] - a[:, 0]) / (b[:, 0] - a[:, 0])
    below = np.zeros((len(u), len(v) + 1), np.int64)
    np.add.at(below, (row, np.searchsorted(v, crossing)), 1)
    return np.cumsum(below, axis=1)[:, :-1] % 2 == 1


def _sample_edge_normals(
    edge: TopoDS_Edge, face: TopoDS_Face, surface: OutwardNormals, spacing: float, count: int | None = None
) -> tuple[Array, Array]:
    """Points along an edge at equal parameter steps, and the face's normals there: (n, 3) each."""
    curve = BRepAdaptor_Curve2d(edge, face)
    low, high = curve.FirstParameter(), curve.LastParameter()
    if count is None:
        probe, _ = surface(np.array([curve.Value(s).Coord() for s in np.linspace(low, high, EXTENT_SAMPLES).tolist()]))
        count = max(3, int(np.ceil(np.linalg.norm(np.diff(probe, axis=0), axis=1).sum() / spacing)) + 1)
    t = np.linspace(low, high, count)
    return surface(np.array([curve.Value(s).Coord() for s in t.tolist()]))


def sobol_points(count: int, dimension: int, rng: np.random.Generator) -> Array:
    """Points (count, dimension) of a scrambled Sobol sequence in the unit cube."""
    from scipy.stats import qmc  # imported where it is used: scipy.stats takes a fifth of the start of a lattice

    return np.asarray(qmc.Sobol(dimension, seed=rng).random(count))


def contains_points(solid: TopoDS_Solid, points: Array, clearance: Array | None = None) -> BoolArray:
    """Whether points (n, 3) lie inside a solid, by the kernel's classifier: (n,).

    clearance (n,): distances that points keep from the boundary at least. Of points that are linked by steps shorter than the
    clearance at one end, by more than round-off, only the one of the greatest clearance is asked; a point on the boundary is
    linked to none.
    """
    if clearance is not None and len(points):
        label = _link_by_clearance(points, (1 - ROUND_OFF) * clearance)
        return contains_points(solid, points[_find_greatest(label, clearance)])[label]
    classifier, found = BRepClass3d_SolidClassifier(solid), np.zeros(len(points), bool)
    for i, point in enumerate(points.tolist()):
        classifier.Perform(gp_Pnt(*point), CONFUSION_TOLERANCE)
        found[i] = classifier.State() == TopAbs_IN
    return found


def _link_by_clearance(points: Array, clearance: Array) -> IntArray:
    """Labels (n,) of points (n, 3), n > 0, that are linked by steps shorter than the clearance (n,) at one end.

    Steps from one point to the next are looked at, which link those of a grid in rows, and then those from the point of greatest
    clearance in each row to the nearest others.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    row = np.cumsum(np.append(0, steps >= np.maximum(clearance[1:], clearance[:-1])))
    deepest = _find_greatest(row, clearance)
    distance, other = cKDTree(points).query(points[deepest], k=np.arange(1, min(NEAREST_POINTS, len(points)) + 1))
    linked, column = np.nonzero(distance < np.maximum(clearance[deepest, None], clearance[other]))
    return label_linked(len(deepest), np.column_stack([linked, row[other[linked, column]]]))[row]


def _find_greatest(label: IntArray, size: Array) -> IntArray:
    """The number of the item of greatest size (n,) under each label (n,), of labels from 0 without gaps."""
    order = np.lexsort((-size, label))
    return np.asarray(order[np.flatnonzero(np.diff(label[order], prepend=-1))])


def sample_solid(solid: TopoDS_Solid, lines: int, points_per_line: int) -> Array:
    """Random points inside the solid: (n, 3).

    `lines` lines run along the longest side of its box, each with `points_per_line` random points, of which those inside are
    kept. A line with an odd number of intersections grazes an edge and is skipped.
    """
    low, high = enclosing_box(solid)
    along = int(np.argmax(high - low))
    length = high[along] - low[along]
    starts = low + (high - low) * np.insert(sobol_points(lines, 2, np.random.default_rng(1)), along, 0.0, axis=1)
    rng = np.random.default_rng(2)
    shooter = IntCurvesFace_ShapeIntersector()
    shooter.Load(solid, CONFUSION_TOLERANCE)
    line_direction = gp_Dir(*np.eye(3)[along].tolist())
    samples = [np.zeros((0, 3))]
    for start in starts:
        shooter.Perform(gp_Lin(convert.point(start), line_direction), -length, 2.0 * length)
        hits = np.sort([shooter.WParameter(i + 1) for i in range(shooter.NbPnt())])
        hits = hits[np.diff(hits, prepend=-np.inf) > CONFUSION_TOLERANCE]
        if len(hits) % 2:
            continue
        t = length * rng.random(points_per_line)
        t = t[np.searchsorted(hits, t) % 2 == 1]
        samples.append(start + t[:, None] * np.eye(3)[along])
    return np.concatenate(samples)
