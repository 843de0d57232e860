"""Distances of opposite sides, found on samples and refined on the exact faces.

A ball on samples says which two places face each other (`tpmscad.brep.local_thickness`). Between them the distance of the faces
is stationary where the segment is normal to both: Newton's method finds it from there. Steps are those of least length, since
the distance of parallel sides is stationary everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepClass import BRepClass_FaceClassifier
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.gp import gp_Pnt2d
from OCP.ShapeAnalysis import ShapeAnalysis_Surface
from OCP.TopAbs import TopAbs_OUT
from OCP.TopoDS import TopoDS_Face
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.local_thickness import OppositeWidths, SharpEdgePoints, measure_opposite_widths
from tpmscad.errors import KernelError
from tpmscad.kernel.measure.shape_sampling import Creases, FaceSamples
from tpmscad.kernel.occt import convert
from tpmscad.kernel.slicing.geometry_evaluators import SurfaceEvaluator, face_evaluator

MAX_TAPER_COSINE = float(np.cos(np.radians(160.0)))
"""Largest cosine between the normals of opposite sides, which taper by 20 degrees at most."""

MAX_CANDIDATE_OVERLAP = 0.2
"""Of a ball with other samples, relative to its radius, before the width is refined."""

REACH = 1.2
"""Widths sought on samples, in limits: those of samples differ from the refined ones."""

SAMPLES_BEYOND_LIMIT = 4_000
"""Samples at which widths beyond the limit are measured, for information."""

COARSE_SPACING = 0.2
"""Spacing of the samples among which contacts of larger balls are sought, in radii. Along the axis of a bore all samples of a
ring are as near as each other, and the search goes through all of them."""

MAX_CANDIDATES = 48
"""Pairs of places that are refined, the nearest ones first, one for each pair of faces."""

NEWTON_STEPS = 12
"""Steps towards the stationary distance; four or five reach round-off."""

STATIONARY_SINE = 1e-9
"""Sine of the angle between segment and normal at which a distance counts as stationary."""

SINGULAR_RATIO = 1e-6
"""Singular values below this fraction of the largest do not move the ends: the sides are parallel in that direction."""

DIFFERENCE = 1e-6
"""Step of differences in parameters, as a fraction of the range of the face's samples."""

MAX_SHIFT = 2.0
"""Greatest way of the ends from their samples, in spacings."""

DIVERGED_REACHES = 1000.0
"""Multiple of that way beyond which Newton's method has diverged; points of polynomials overflow soon after."""

CANDIDATE_SLACK = 1.5
"""Spacings by which the distance of samples may exceed that of the solids."""

CLASSIFIER_TOL = 1e-7
"""Distance in parameters below which the kernel's classifier puts a point on the border of a face."""


@dataclass(frozen=True, slots=True, eq=False)
class Width:
    """A distance of opposite sides or of solids, and the middle (3,) between them."""

    value: float
    place: Array


@dataclass(frozen=True, slots=True, eq=False)
class SampledSurface:
    """The faces of a shape with samples at most `spacing` apart, on sharp edges, too; size is the diagonal of its box.

    points (n, 3), outward normals (n, 3), face (n,): a sample of a sharp edge stands for both of its faces, one after the other.
    """

    faces: Sequence[TopoDS_Face]
    points: Array
    normals: Array
    face: IntArray
    tree: cKDTree
    creases: Creases
    spacing: float
    size: float

    @classmethod
    def join(
        cls, faces: Sequence[TopoDS_Face], samples: FaceSamples, creases: Creases, spacing: float, size: float
    ) -> SampledSurface:
        """The samples of faces and those of their sharp edges."""
        points = np.concatenate([samples.points, creases.points, creases.points])
        return cls(
            faces,
            points,
            np.concatenate([samples.normals, creases.normals[:, 0], creases.normals[:, 1]]),
            np.concatenate([samples.face, creases.faces[:, 0], creases.faces[:, 1]]),
            cKDTree(points),
            creases,
            spacing,
            size,
        )

    def thin(self, spacing: float) -> SampledSurface:
        """The surface with a random part of its samples, about as dense as this spacing."""
        kept = self.choose(int(len(self.points) * min(1.0, self.spacing / spacing) ** 2))
        points = self.points[kept]
        return replace(
            self,
            points=points,
            normals=self.normals[kept],
            face=self.face[kept],
            tree=cKDTree(points),
            spacing=max(spacing, self.spacing),
        )

    def choose(self, count: int) -> IntArray:
        """Numbers of at most so many samples, at random, ascending; at least one for each face."""
        if count >= len(self.points):
            return np.arange(len(self.points))
        _, of_face = np.unique(self.face, return_index=True)
        chosen = np.random.default_rng(0).choice(len(self.points), count, replace=False)
        return np.union1d(of_face, chosen).astype(np.int64)

    @property
    def sharp_edges(self) -> SharpEdgePoints:
        """The samples of sharp edges with the smooth faces that meet there."""
        return SharpEdgePoints(self.creases.points, np.sort(self.creases.smooth_group[self.creases.faces], axis=1))


def find_least_width(surface: SampledSurface, sign: float, limit: float | None, first_reach: float) -> Width | None:
    """The least distance of opposite sides in the solid (sign = 1) or in the void (-1); None if no sides are opposite.

    Every sample is asked for widths up to the limit, so that none is missed that the samples resolve. If there is none, the
    least width is that of some samples, with balls up to `first_reach` at first.
    """
    if limit is not None:
        reach = 0.5 * REACH * limit
        found = _measure_widths(surface, sign, reach, np.arange(len(surface.points)))
        if len(found.width) and (least := _refine(surface, found)).value < limit:
            return least
        first_reach = max(reach, first_reach)
    while first_reach < 2.0 * surface.size:
        coarse = surface.thin(COARSE_SPACING * first_reach)
        found = _measure_widths(coarse, sign, first_reach, coarse.choose(SAMPLES_BEYOND_LIMIT))
        if len(found.width):
            return _refine(coarse, found)
        first_reach *= 2.0
    return None


def _measure_widths(surface: SampledSurface, sign: float, reach: float, samples: IntArray) -> OppositeWidths:
    """Widths at some of the samples, in the solid or in the void, by balls of radius `reach` at most."""
    return measure_opposite_widths(
        surface.points,
        sign * surface.normals,
        surface.creases.smooth_group[surface.face],
        surface.sharp_edges,
        reach,
        samples,
        surface.tree,
        MAX_TAPER_COSINE,
        MAX_CANDIDATE_OVERLAP,
    )


def find_least_solid_gap(surface: SampledSurface, solid: IntArray) -> Width | None:
    """The least distance between two solids of the shape, edges and vertices included; None if there is only one.

    solid (F,): number of the solid of each face. The nearest samples choose the faces, between which OCCT finds the distance.
    """
    owner = solid[surface.face]
    members = [np.flatnonzero(owner == i) for i in range(int(solid.max()) + 1)]
    boxes = [(surface.points[own].min(axis=0), surface.points[own].max(axis=0)) for own in members]
    slack = CANDIDATE_SLACK * surface.spacing
    least, candidates = np.inf, [(np.zeros((0, 2), np.int64), np.zeros(0))]
    for i, own in enumerate(members):
        tree = cKDTree(surface.points[own])
        for j in range(i):
            apart = np.maximum(boxes[i][0] - boxes[j][1], boxes[j][0] - boxes[i][1]).clip(0.0)
            if np.linalg.norm(apart) > least + slack:
                continue
            distance, nearest = tree.query(surface.points[members[j]], distance_upper_bound=least + slack)
            near = np.flatnonzero(distance < distance.min() + slack)
            candidates.append((np.stack([members[j][near], own[nearest[near]]], axis=1), distance[near]))
            least = min(least, float(distance.min()))
    contacts, distance = (np.concatenate(parts) for parts in zip(*candidates, strict=True))
    order = np.argsort(distance, kind="stable")[: int((distance < least + slack).sum())]
    if not len(order):
        return None
    pairs = surface.face[contacts[order]]
    _, first = np.unique(pairs, axis=0, return_index=True)
    found = [_measure_face_distance(*(surface.faces[k] for k in pairs[i])) for i in np.sort(first)[:MAX_CANDIDATES]]
    return min(found, key=lambda one: one.value)


def _measure_face_distance(one: TopoDS_Face, two: TopoDS_Face) -> Width:
    """The least distance of two faces, by OCCT."""
    measure = BRepExtrema_DistShapeShape(one, two)
    if not measure.IsDone():
        raise KernelError("distance of faces", "no foot points were found", one)
    ends = np.array([measure.PointOnShape1(1).Coord(), measure.PointOnShape2(1).Coord()])
    return Width(float(measure.Value()), ends.mean(axis=0))


def _refine(surface: SampledSurface, found: OppositeWidths) -> Width:
    """The least of the widths, each between the places where the distance of its two faces is stationary, or else the samples."""
    distance = np.linalg.norm(surface.points[found.contacts[:, 0]] - surface.points[found.contacts[:, 1]], axis=1)
    contacts = found.contacts[np.argsort(distance, kind="stable")]
    _, first = np.unique(np.sort(surface.face[contacts], axis=1), axis=0, return_index=True)
    best: Width | None = None
    for contact in contacts[np.sort(first)[:MAX_CANDIDATES]].tolist():
        ends = _FacePair(surface, *contact).find_stationary()
        ends = surface.points[contact] if ends is None else ends
        width = Width(float(np.linalg.norm(ends[1] - ends[0])), ends.mean(axis=0))
        if best is None or width.value < best.value:
            best = width
    assert best is not None
    return best


class _FacePair:
    """Two places on faces between which the distance is to be made stationary."""

    def __init__(self, surface: SampledSurface, one: int, two: int) -> None:
        self.faces = [surface.faces[int(surface.face[k])] for k in (one, two)]
        self.start = surface.points[[one, two]]
        self.evaluators: list[SurfaceEvaluator] = [face_evaluator(face) for face in self.faces]
        self.reach = MAX_SHIFT * surface.spacing

    def find_stationary(self) -> Array | None:
        """Ends (2, 3) of the segment that is normal to both faces, or None if there is none nearby on the faces."""
        tol = convert.CONFUSION_TOLERANCE
        uv = np.array(
            [
                ShapeAnalysis_Surface(BRep_Tool.Surface_s(face)).ValueOfUV(convert.point(at), tol).Coord()
                for face, at in zip(self.faces, self.start, strict=True)
            ]
        )
        step = DIFFERENCE * max(1.0, float(np.abs(uv).max()))
        for _ in range(NEWTON_STEPS):
            moved = np.concatenate([uv.reshape(1, 4), uv.reshape(1, 4) + step * np.eye(4)])
            values = self._slopes(moved)
            if np.abs(values[0]).max() < STATIONARY_SINE:
                break
            jacobian = (values[1:] - values[0]).T / step
            change = np.linalg.lstsq(jacobian, -values[0], rcond=SINGULAR_RATIO)[0].reshape(2, 2)
            uv = uv + change
            if self._distance_from_start(uv) > DIVERGED_REACHES * self.reach:
                return None
        ends = self._ends(uv.reshape(1, 4))[0]
        near = self._distance_from_start(uv) < self.reach
        settled = np.abs(self._slopes(uv.reshape(1, 4))).max() < np.sqrt(STATIONARY_SINE)
        if not (near and settled and all(map(_contains, self.faces, uv))):
            return None
        return ends

    def _distance_from_start(self, uv: Array) -> float:
        """How far the farther one of both places (2, 2) has moved."""
        return float(np.linalg.norm(self._ends(uv.reshape(1, 4))[0] - self.start, axis=1).max())

    def _ends(self, uv: Array) -> Array:
        """Ends of segments at parameters (n, 4): (n, 2, 3)."""
        return np.stack([self.evaluators[k](uv[:, 2 * k : 2 * k + 2])[0] for k in (0, 1)], axis=1)

    def _slopes(self, uv: Array) -> Array:
        """Cosines between the segment and the tangents of both faces, at parameters (n, 4): (n, 4)."""
        jets = [self.evaluators[k](uv[:, 2 * k : 2 * k + 2]) for k in (0, 1)]
        chord = jets[0][0] - jets[1][0]
        chord = chord / np.linalg.norm(chord, axis=1, keepdims=True)
        tangents = [jet[k] for jet in jets for k in (1, 2)]
        return np.stack([(chord * t).sum(axis=1) / np.linalg.norm(t, axis=1) for t in tangents], axis=1)


def _contains(face: TopoDS_Face, uv: Array) -> bool:
    """Whether parameters (2,) lie in a face or on its border."""
    at = gp_Pnt2d(float(uv[0]), float(uv[1]))
    return bool(BRepClass_FaceClassifier(face, at, CLASSIFIER_TOL).State() != TopAbs_OUT)
