"""CAD bodies as patch complexes: faces on planes, cylinders, cones, spheres and tori, exactly; on edges exact or within 1e-10.

Nothing is approximated but parameter curves and edges that are neither straight nor conic, and these to round-off nearly.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from OCP.Bnd import Bnd_Box
from OCP.BRepBndLib import BRepBndLib
from OCP.TopAbs import TopAbs_FACE
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

from tpmscad.errors import InvalidRequest
from tpmscad.kernel import convert
from tpmscad.kernel.quadrature import face_moments
from tpmscad.kernel.read import solids_of
from tpmscad.kernel.tool.body import Body, Refused, unrolled
from tpmscad.kernel.tool.carrier import EXACT, carrier_of
from tpmscad.kernel.tool.edges import NoFit, pcurve
from tpmscad.kernel.tool.read import read
from tpmscad.kernel.tool.seams import without_seams
from tpmscad.patches import connectivity, measure
from tpmscad.patches.carriers import EdgeCurve, Plane, Quadric
from tpmscad.patches.complex import Array, Edges, Faces, Ints, PatchComplex, Uses
from tpmscad.splines.bspline import Curve

TAG = "body"
"""The tag of all faces."""

NAMED = 3
"""Faces that an error names, at most."""

SAME_VOLUME = 1e-7
"""Mean distance, in units of the body's size, by which the complex's border may differ from the kernel's: its edges have
tolerances of that order."""


class NotQuadric(InvalidRequest):
    """The body has faces that a patch complex can't hold exactly; `faces` are their indices in the order of exploration."""

    def __init__(self, message: str, faces: tuple[int, ...]) -> None:
        super().__init__(message)
        self.faces = faces


def body_complex(shape: Any) -> PatchComplex:
    """The solids of a TopoDS shape, or anything that wraps one (build123d, CadQuery), as one closed complex, placed.

    Faces that close on themselves are cut in two, so that there are no seams. NotQuadric where a face is neither plane nor
    quadric, or an edge can't be followed; InvalidRequest where there is no solid.
    """
    return body_faces(shape)[0]


def body_faces(shape: Any) -> tuple[PatchComplex, Ints]:
    """The complex, and for each of its faces the index of the shape's face that it is (a part of)."""
    topods: TopoDS_Shape = getattr(shape, "wrapped", shape)
    faces = [face for solid in solids_of(topods) for face in _faces(solid)]
    if not faces:
        raise InvalidRequest("the shape has no solid: make one of its faces first")
    size = _size(topods)
    _refuse_free_form(faces, size)
    at = -1
    try:
        body = read(faces, size)
        unrolled_faces = []
        for at in range(len(body.faces)):
            unrolled_faces.append(unrolled(body, body.faces[at]))
        at = -1
        body = without_seams(Body(body.vertices, body.edges, tuple(unrolled_faces), size))
        complex = _assembled(body)
    except (Refused, NoFit) as error:
        raise NotQuadric(f"{_name(faces, at)} {error}: use the kernel for it", (at,) if at >= 0 else ()) from None
    _confirm(complex, faces, size)
    return complex, np.array([face.origin for face in body.faces])


def _faces(solid: TopoDS_Shape) -> list[TopoDS_Face]:
    explorer, found = TopExp_Explorer(solid, TopAbs_FACE), []
    while explorer.More():
        found.append(convert.as_face(explorer.Current()))
        explorer.Next()
    return found


def _size(shape: TopoDS_Shape) -> float:
    box = Bnd_Box()
    BRepBndLib.Add_s(shape, box, False)
    return float(np.linalg.norm(np.subtract(box.CornerMax().Coord(), box.CornerMin().Coord())))


def _refuse_free_form(faces: list[TopoDS_Face], size: float) -> None:
    reasons = {}
    for i, face in enumerate(faces):
        try:
            carrier_of(face, size)
        except Refused as reason:
            reasons[i] = f"{_name(faces, i)} {reason}"
    if reasons:
        more = f" and {len(reasons) - NAMED} more" if len(reasons) > NAMED else ""
        raise NotQuadric("; ".join(list(reasons.values())[:NAMED]) + more, tuple(reasons))


def _name(faces: list[TopoDS_Face], index: int) -> str:
    if index < 0:
        return "a face"
    box = Bnd_Box()
    BRepBndLib.Add_s(faces[index], box)
    x, y, z = (0.5 * np.add(box.CornerMin().Coord(), box.CornerMax().Coord())).tolist()
    return f"face {index} (about {x:.4g}, {y:.4g}, {z:.4g})"


def _assembled(body: Body) -> PatchComplex:
    """The complex of a body without seams; every edge's deviation measured."""
    curves: list[EdgeCurve] = []
    pcurves: list[Curve] = []
    index: dict[int, int] = {}
    for edge in body.edges:
        if id(edge.curve) not in index:
            index[id(edge.curve)] = len(curves)
            curves.append(edge.curve)
    deviation = np.zeros(len(body.edges))
    rows, use_start, loop_start = [], [0], [0]
    for face in body.faces:
        for loop in face.loops:
            for use in loop:
                edge, number = body.edges[use.edge], -1
                if not isinstance(face.carrier, Plane):
                    assert use.near is not None
                    number = len(pcurves)
                    pcurves.append(pcurve(face.carrier, edge.curve, edge.span, use.near, body.size, EXACT * body.size))
                rows.append((use.edge, use.sense, number))
                off = _deviation(body, face.carrier, use.edge, pcurves[number] if number >= 0 else None)
                deviation[use.edge] = max(deviation[use.edge], off)
            use_start.append(len(rows))
        loop_start.append(len(use_start) - 1)
    edges, n = body.edges, len(body.faces)
    return PatchComplex(
        carriers=tuple(face.carrier for face in body.faces),
        curves=tuple(curves),
        pcurves=tuple(pcurves),
        vertices=np.array(body.vertices),
        edges=Edges(
            np.array([index[id(e.curve)] for e in edges]),
            *_at_rest(len(edges)),
            np.array([e.span for e in edges]),
            np.array([e.start for e in edges]),
            np.array([e.end for e in edges]),
            deviation,
        ),
        uses=Uses(*np.array(rows).T),
        faces=Faces(
            np.arange(n),
            *_at_rest(n),
            np.array([face.sense for face in body.faces]),
            np.zeros(n, np.int64),
            np.array(loop_start),
            np.array(use_start),
        ),
        tags=(TAG,),
    )


def _at_rest(count: int) -> tuple[Array, Array]:
    return np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))


DEVIATION_SAMPLES = 33


def _deviation(body: Body, carrier: Plane | Quadric, edge: int, along: Curve | None) -> float:
    t = np.linspace(*body.edges[edge].span, DEVIATION_SAMPLES)
    points: Array = body.edges[edge].curve(t)
    if along is None:
        return float(np.abs(carrier.distance(points)).max())
    return float(np.linalg.norm(carrier(*along(t).T) - points, axis=1).max())


def _confirm(complex: PatchComplex, faces: list[TopoDS_Face], size: float) -> None:
    """NotQuadric unless the complex is closed and has the kernel's volume."""
    unmatched = connectivity.unmatched_edges(complex)
    if len(unmatched):
        at = complex.vertices[complex.edges.start[unmatched[0]]].round(6)
        raise NotQuadric(f"{len(unmatched)} edges of the body do not join two of its faces, the first at {at}", ())
    moments = measure.face_moments(complex)
    volume, expected = float(measure.volume(moments)[0]), float(face_moments(faces)[:, 1].sum())
    if not abs(volume - expected) <= SAME_VOLUME * size * moments.area.sum():
        raise NotQuadric(
            f"the body's faces bound {volume:.9g}, not {expected:.9g}, when read exactly: use the kernel", ()
        )
