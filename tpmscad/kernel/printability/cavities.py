"""Closed cavities of a part: voids without a way out, in which powder or resin stays.

The faces of a solid fall into closed surfaces, found by the edges that they share whatever shells the file has. A closed surface
that encloses a negative volume bounds a cavity. Solids that lie in a cavity, and touch nothing, take up a part of its volume.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeSolid
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.TopAbs import TopAbs_IN
from OCP.TopoDS import TopoDS_Face, TopoDS_Shell, TopoDS_Solid
from scipy.spatial import cKDTree

from tpmscad._typing import Array
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.local_thickness import shrink_tangent_balls
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.measure.shape_sampling import sample_faces
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, faces_of, first_vertex, solids_of

SAMPLES_ACROSS = 16
"""Samples along the diagonal of a cavity, among which the place of its largest ball is sought."""


@dataclass(frozen=True, slots=True, eq=False)
class Cavity:
    """A closed cavity: the volume of its void, and the centre (3,) of a large ball in it."""

    volume: float
    place: Array


def find_cavities(shape: Any) -> tuple[Cavity, ...]:
    """Closed cavities of the solids of a shape, largest first. The solids must be valid and must not touch."""
    outer: list[tuple[list[TopoDS_Face], float]] = []
    inner: list[tuple[list[TopoDS_Face], float]] = []
    for solid in solids_of(shape):
        for faces in _closed_surfaces(solid):
            volume = float(solid_moments(make_compound(faces))[1])
            (inner if volume < 0.0 else outer).append((faces, abs(volume)))
    taken = np.zeros(len(inner))
    regions = [_Region(faces) for faces, _ in inner]
    smallest_first = np.argsort([volume for _, volume in inner]).tolist()
    for faces, volume in outer if inner else ():
        point = np.array(BRep_Tool.Pnt_s(first_vertex(edges_of(faces[0])[0])).Coord())
        host = next((i for i in smallest_first if volume < inner[i][1] and regions[i].contains(point)), None)
        if host is not None:
            taken[host] += volume
    found = [Cavity(volume - taken[i], _find_place(faces)) for i, (faces, volume) in enumerate(inner)]
    return tuple(sorted(found, key=lambda one: -one.volume))


def _closed_surfaces(solid: TopoDS_Solid) -> list[list[TopoDS_Face]]:
    """The faces of a solid by connected surfaces."""
    faces = faces_of(solid)
    first: dict[ShapeKey, int] = {}
    links = [(i, first.setdefault(ShapeKey(edge), i)) for i, face in enumerate(faces) for edge in edges_of(face)]
    surfaces: dict[int, list[TopoDS_Face]] = {}
    for face, label in zip(faces, label_linked(len(faces), np.array(links)).tolist(), strict=True):
        surfaces.setdefault(label, []).append(face)
    return list(surfaces.values())


class _Region:
    """The region that the surface of a cavity encloses."""

    def __init__(self, faces: list[TopoDS_Face]) -> None:
        shell, builder = TopoDS_Shell(), BRep_Builder()
        builder.MakeShell(shell)
        for face in faces:
            builder.Add(shell, face.Reversed())
        self.low, self.high = enclosing_box(shell)
        self.classifier = BRepClass3d_SolidClassifier(BRepBuilderAPI_MakeSolid(shell).Solid())

    def contains(self, point: Array) -> bool:
        """Whether a point (3,) lies inside."""
        if not ((point > self.low) & (point < self.high)).all():
            return False
        self.classifier.Perform(convert.point(point), convert.CONFUSION_TOLERANCE)
        return bool(self.classifier.State() == TopAbs_IN)


def _find_place(faces: list[TopoDS_Face]) -> Array:
    """Centre (3,) of the largest ball in a cavity that touches one of the samples of its surface."""
    low, high = enclosing_box(make_compound(faces))
    size = float(np.linalg.norm(high - low))
    samples = sample_faces(faces, size / SAMPLES_ACROSS)
    everyone = np.arange(len(samples.points))
    radius, _ = shrink_tangent_balls(samples.points, -samples.normals, size, everyone, cKDTree(samples.points))
    best = int(radius.argmax())
    return np.asarray(samples.points[best] + radius[best] * samples.normals[best])
