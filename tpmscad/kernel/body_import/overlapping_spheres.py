"""Faces of one sphere that cover each other, as in bodies of which another program has read one as the rest of its sphere.

`step.sphere_seams` says how that comes about and prevents it in files that are read here. The kernel's check finds nothing in
such a body: a half shell is a ball with a half shell taken off. What remains visible is that the face covers another one.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.Geom import Geom_SphericalSurface
from OCP.GeomAbs import GeomAbs_Sphere
from OCP.gp import gp_Pnt2d
from OCP.IntTools import IntTools_FClass2d
from OCP.TopAbs import TopAbs_IN
from OCP.TopoDS import TopoDS_Face, TopoDS_Solid

from tpmscad._typing import Array, BoolArray
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.sphere_seams import spread_directions

SAME_SPHERE = 1e-6
"""In radii: difference of centres and radii below which two spheres are one."""

DIRECTIONS = 600
"""Directions from the centre of a sphere in which its faces are compared."""

MAX_OVERLAP = 0.002
"""Part of a sphere that two of its faces may have in common: a direction on their edge."""


def require_disjoint_spheres(solid: TopoDS_Solid, name: str) -> None:
    """InvalidRequest if two faces of a solid lie on one sphere and cover each other."""
    faces = faces_of(solid)
    for group in _group_by_sphere(faces):
        if pair := _find_overlap(_sample_faces([faces[i] for i in group])):
            i, j = (group[k] for k in pair)
            raise InvalidRequest(
                f"faces {i} and {j} of {name} lie on one sphere and cover each other, as if one had been read as the rest of the "
                "sphere; give the path of its STEP file instead of the shape, or repair it where it was modelled"
            )


def _sphere(face: TopoDS_Face) -> tuple[Array, float]:
    """Centre (3,) and radius of the sphere of a face."""
    ball = BRepAdaptor_Surface(face, False).Sphere()
    return np.array(ball.Location().Coord()), float(ball.Radius())


def _group_by_sphere(faces: list[TopoDS_Face]) -> list[list[int]]:
    """Numbers of the faces that share a sphere with others."""
    groups: list[tuple[Array, float, list[int]]] = []
    for i, face in enumerate(faces):
        if BRepAdaptor_Surface(face, False).GetType() != GeomAbs_Sphere:
            continue
        centre, radius = _sphere(face)
        for known, size, members in groups:
            if max(float(np.linalg.norm(centre - known)), abs(radius - size)) <= SAME_SPHERE * size:
                members.append(i)
                break
        else:
            groups.append((centre, radius, [i]))
    return [members for _, _, members in groups if len(members) > 1]


def _sample_faces(faces: list[TopoDS_Face]) -> BoolArray:
    """Whether each face of a sphere holds the points in each of the directions from its centre: (faces, DIRECTIONS)."""
    centre, radius = _sphere(faces[0])
    points = centre + radius * spread_directions(DIRECTIONS)
    covered = np.zeros((len(faces), DIRECTIONS), bool)
    for k, face in enumerate(faces):
        classifier = IntTools_FClass2d(face, CONFUSION_TOLERANCE)
        surface = Geom_SphericalSurface(BRepAdaptor_Surface(face, False).Sphere())
        frame = surface.Position()
        axes = np.array([d.Coord() for d in (frame.XDirection(), frame.YDirection(), frame.Direction())])
        x, y, z = axes @ (points - centre).T
        for n, (u, v) in enumerate(zip(np.arctan2(y, x) % (2 * np.pi), np.arcsin(z / radius), strict=True)):
            covered[k, n] = classifier.Perform(gp_Pnt2d(float(u), float(v))) == TopAbs_IN
    return covered


def _find_overlap(covered: BoolArray) -> tuple[int, int] | None:
    """Two rows of a table of samples that overlap, None if there are none."""
    for i, j in combinations(range(len(covered)), 2):
        if (covered[i] & covered[j]).mean() > MAX_OVERLAP:
            return i, j
    return None
