"""Faces of spheres that the kernel has read as the rest of their sphere, found and exchanged.

A closed curve on a sphere bounds two regions. The kernel's reader decides between them by parameter curves, and chooses the wrong
one where edges lie on the seam of the sphere. It then turns the face round, and with it the solid, so that its boundary is closed
and its check finds nothing: a half shell becomes a ball with a half shell taken off. What remains visible is that the face covers
another one on the same sphere.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
from OCP.BRepLib import BRepLib
from OCP.BRepTools import BRepTools_ReShape
from OCP.Geom import Geom_SphericalSurface
from OCP.GeomAbs import GeomAbs_Sphere
from OCP.gp import gp_Ax3, gp_Dir, gp_Pnt, gp_Pnt2d
from OCP.IntTools import IntTools_FClass2d
from OCP.ShapeFix import ShapeFix_Edge, ShapeFix_Face
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FORWARD, TopAbs_IN
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Solid, TopoDS_Wire

from tpmscad._typing import Array, BoolArray
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    faces_of,
    first_vertex,
    last_vertex,
    list_subshapes,
    solids_of,
)

SAME_SPHERE = 1e-6
"""In radii: difference of centres and radii below which two spheres are one."""

DIRECTIONS = 600
"""Directions from the centre of a sphere in which its faces are compared."""

MAX_OVERLAP = 0.002
"""Part of a sphere that two of its faces may have in common: a direction on their edge."""

FRAMES, TURNS = 100, 12
"""Directions of the middle of a seam, and turns about each, that are compared."""

EDGE_SAMPLES = 33
"""Points of each edge that are to keep clear of the seam."""

MIN_SEAM_CLEARANCE = 0.05
"""In radii: least distance of edges from the seam and the poles of the sphere that the kernel is given."""


def exchange_inverted_faces(solid: TopoDS_Solid, name: str) -> tuple[TopoDS_Solid, tuple[str, ...]]:
    """The solid with faces of spheres exchanged for the rest of their spheres where they cover others, and a note on it.

    The solid itself if no two faces of one sphere overlap. InvalidRequest if they still do after each of them was exchanged, or
    if the new face cannot be built.
    """
    faces = faces_of(solid)
    for group in _group_by_sphere(faces):
        covered = _sample_faces([faces[i] for i in group])
        if _find_overlap(covered) is None:
            continue
        for k in np.argsort(-covered.mean(axis=1)).tolist():
            other = covered.copy()
            other[k] = ~covered[k]
            if _find_overlap(other) is None:
                break
        else:
            i, j = (group[k] for k in _find_overlap(covered) or (0, 0))
            raise InvalidRequest(
                f"faces {i} and {j} of {name} lie on one sphere and cover each other; repair it where it was modelled"
            )
        exchanged = _exchange_face(solid, group[k], other[k], name)
        note = (
            f"face {group[k]} of {name}, on a sphere of radius {_sphere(faces[group[k]])[1]:.6g}, covered another face: the "
            "kernel had read the rest of the sphere in its place"
        )
        solid, notes = exchange_inverted_faces(exchanged, name)
        return solid, (note, *notes)
    return solid, ()


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


def _directions() -> Array:
    """Unit vectors (DIRECTIONS, 3) on a spiral about no direction of symmetry."""
    i = np.arange(DIRECTIONS) + 0.5
    z, angle = 1.0 - 2.0 * i / DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * i
    r = np.sqrt(1.0 - z * z)
    turn, _ = np.linalg.qr(np.array([[0.59, -0.41, 0.70], [0.23, 0.83, 0.50], [0.77, 0.38, -0.51]]))
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z]) @ turn.T


def _sample_faces(faces: list[TopoDS_Face]) -> BoolArray:
    """Whether each face of a sphere holds the points in each of the directions from its centre: (faces, DIRECTIONS)."""
    centre, radius = _sphere(faces[0])
    points = centre + radius * _directions()
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


def _exchange_face(solid: TopoDS_Solid, index: int, covered: BoolArray, name: str) -> TopoDS_Solid:
    """A copy of the solid in which a face is the rest of its sphere, which covers the directions (DIRECTIONS,)."""
    copy = BRepBuilderAPI_Copy(solid).Shape()
    face = faces_of(copy)[index]
    centre, radius = _sphere(face)
    # The new face is the complement turned round: in it, and in its wires, edges run as before, and so in the other faces.
    forward = convert.as_face(face.Oriented(TopAbs_FORWARD))
    edges = [
        edge
        for edge in map(convert.as_edge, list_subshapes(forward, TopAbs_EDGE))
        if not BRep_Tool.Degenerated_s(edge) and not BRep_Tool.IsClosed_s(edge, forward)
    ]
    axis, x_axis, clearance = _choose_frame((_sample_edges(edges) - centre) / radius)
    if clearance < MIN_SEAM_CLEARANCE:
        raise InvalidRequest(
            f"face {index} of {name} covers another face on its sphere, and its edges leave no place for a seam; "
            "repair it where it was modelled"
        )
    frame = gp_Ax3(gp_Pnt(*centre.tolist()), gp_Dir(*axis.tolist()), gp_Dir(*x_axis.tolist()))
    builder, made = BRep_Builder(), TopoDS_Face()
    builder.MakeFace(made, Geom_SphericalSurface(frame, radius), TopLoc_Location(), BRep_Tool.Tolerance_s(face))
    for chain in _connect_edges(edges):
        wire = TopoDS_Wire()
        builder.MakeWire(wire)
        for edge in chain:
            builder.Add(wire, edge)
        wire.Closed(True)
        builder.Add(made, wire.Reversed())
    for edge in edges:
        ShapeFix_Edge().FixAddPCurve(edge, made, False, CONFUSION_TOLERANCE)
        BRepLib.SameParameter_s(edge, CONFUSION_TOLERANCE)
    if covered[int((_directions() @ x_axis).argmax())]:  # the seam lies in the face, and is a part of its border then
        fix = ShapeFix_Face(made)
        fix.FixAddNaturalBound()
        made = fix.Face()
    swap = BRepTools_ReShape()
    swap.Replace(face, made.Oriented(face.Orientation()).Reversed())
    (whole,) = solids_of(swap.Apply(copy))
    is_inside_out = face_moments(faces_of(whole))[:, 1].sum() < 0  # BRepLib.OrientClosedSolid errs where faces overlap
    return convert.as_solid(whole.Reversed()) if is_inside_out else whole


def _connect_edges(edges: list[TopoDS_Edge]) -> list[list[TopoDS_Edge]]:
    """The edges, those that are connected by vertices together."""
    chains: list[tuple[set[ShapeKey], list[TopoDS_Edge]]] = []
    for edge in edges:
        ends, own = {ShapeKey(first_vertex(edge)), ShapeKey(last_vertex(edge))}, [edge]
        for chain in [chain for chain in chains if chain[0] & ends]:
            chains.remove(chain)
            ends, own = ends | chain[0], chain[1] + own
        chains.append((ends, own))
    return [own for _, own in chains]


def _sample_edges(edges: list[TopoDS_Edge]) -> Array:
    """Points (n, 3) along edges."""
    points = []
    for edge in edges:
        curve = BRepAdaptor_Curve(edge)
        t = np.linspace(curve.FirstParameter(), curve.LastParameter(), EDGE_SAMPLES)
        points += [curve.Value(s).Coord() for s in t.tolist()]
    return np.array(points)


def _choose_frame(border: Array) -> tuple[Array, Array, float]:
    """Axis and x axis of a sphere whose seam is farthest from points (n, 3) of the unit sphere, and how far it is."""
    best: tuple[Array, Array, float] | None = None
    for x_axis in _directions()[:: DIRECTIONS // FRAMES]:
        across = np.linalg.svd(x_axis[None])[2][1:]
        for angle in np.pi * np.arange(TURNS) / TURNS:
            axis = np.cos(angle) * across[0] + np.sin(angle) * across[1]
            to_pole = np.sqrt(np.maximum(2.0 - 2.0 * np.abs(border @ axis), 0.0))
            beside = np.where(border @ x_axis > 0, np.abs(border @ np.cross(axis, x_axis)), to_pole)
            if best is None or beside.min() > best[2]:
                best = axis, x_axis, float(beside.min())
    assert best is not None
    return best
