"""What a picture shows: triangles of pieces, with a colour for each point or a value that a scale turns into a colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.Geom import Geom_BSplineSurface
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

from tpmscad._typing import Array, BoolArray, Colour, IntArray
from tpmscad.brep.triangles.closed_mesh import SolidMesh, point_normals
from tpmscad.errors import KernelError
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of, solids_of, unwrap
from tpmscad.kernel.render.palette import SURFACE_COLOUR
from tpmscad.kernel.render.tessellation import MAX_FACET_ANGLE, mean_curvatures, tessellate

DEFLECTION_FRACTION = 6e-4
"""Distance of the triangles from the shape, in diagonals of its box: half a pixel of a large picture."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Triangles of P pieces with F faces.

    points, normals, colours (n, 3) and `face` (n,), the face of each point. triangles (m, 3); `piece_of_triangle` (m,).
    faces: the TopoDS faces. piece_of_face (F,). closed (P,): solids, whose sections are filled. cut_colours (P, 3).
    values (n,): shown in place of the colours if given; NaN where there is none.
    """

    points: Array
    normals: Array
    parameters: Array
    face: IntArray
    triangles: IntArray
    piece_of_triangle: IntArray
    faces: tuple[TopoDS_Face, ...]
    piece_of_face: IntArray
    closed: BoolArray
    colours: Array
    cut_colours: Array
    values: Array | None = None

    @classmethod
    def of_pieces(cls, pieces: Sequence[TopoDS_Shape], *, angle: float | None = None) -> Scene:
        """The pieces in one colour; `angle`: between neighbouring facets, radians. KernelError if there is no face."""
        if not pieces:
            raise KernelError("draw", "the shape has no face")
        whole = make_compound(pieces)
        found = tessellate(whole, DEFLECTION_FRACTION * box_diagonal(whole), angle or MAX_FACET_ANGLE)
        faces = tuple(faces_of(whole))
        piece_of_face = np.repeat(np.arange(len(pieces)), [len(faces_of(piece)) for piece in pieces])
        piece = piece_of_face[found.face[found.triangles[:, 0]]]
        closed = np.array([len(solids_of(p)) > 0 for p in pieces])
        triangles, normals = found.triangles, found.normals
        a, b, c = (found.points[triangles[:, k]] for k in range(3))
        volume = np.bincount(piece, np.einsum("md,md->m", np.cross(a, b), c), len(pieces))
        inside_out = closed & (volume < 0)
        turned = inside_out[piece]
        triangles = np.where(turned[:, None], triangles[:, ::-1], triangles)
        normals = np.where(inside_out[piece_of_face[found.face]][:, None], -normals, normals)
        colours = np.tile(np.array(SURFACE_COLOUR), (len(found.points), 1))
        cut_colours = np.tile(np.array(SURFACE_COLOUR), (len(pieces), 1))
        return cls(
            found.points,
            normals,
            found.parameters,
            found.face,
            triangles,
            piece,
            faces,
            piece_of_face,
            closed,
            colours,
            cut_colours,
        )

    @classmethod
    def of_mesh(cls, mesh: SolidMesh, colours: Sequence[Colour], cut_colour: Colour, *, closed: bool = True) -> Scene:
        """The triangles of one mesh, with a colour for each face number; normals are means over those of a face."""
        corner = mesh.triangles + len(mesh.points) * mesh.face[:, None]
        used, triangles = np.unique(corner, return_inverse=True)
        triangles, face = triangles.reshape(-1, 3), used // len(mesh.points)
        points = mesh.points[used % len(mesh.points)]
        return cls(
            points,
            point_normals(points, triangles),
            np.zeros((len(points), 2)),
            face,
            triangles,
            np.zeros(len(triangles), np.int64),
            (),
            np.zeros(len(colours), np.int64),
            np.array([closed]),
            np.array(colours, float)[face],
            np.array([cut_colour], float),
        )

    @property
    def box(self) -> tuple[Array, Array]:
        """Opposite corners (3,), (3,) of the box of the points."""
        return self.points.min(axis=0), self.points.max(axis=0)

    def with_piece_colours(self, colours: Sequence[Colour]) -> Scene:
        """The scene with a colour for each piece and its cut."""
        of_piece = np.array(colours, float)
        return replace(self, colours=of_piece[self.piece_of_face[self.face]], cut_colours=of_piece)

    def with_face_colours(self, colours: Sequence[Colour]) -> Scene:
        """The scene with a colour for each face; cuts keep theirs."""
        return replace(self, colours=np.array(colours, float)[self.face])

    def has_spline(self) -> BoolArray:
        """Whether each face (F,) lies on a B-spline surface."""
        return np.array([isinstance(BRep_Tool.Surface_s(face), Geom_BSplineSurface) for face in self.faces])

    def mean_curvature(self) -> Array:
        """Mean curvature at each point (n,), positive where the solid is convex; NaN at singular points."""
        return mean_curvatures(self.faces, self.parameters, self.face)


def pieces_of(shape: Any) -> list[TopoDS_Shape]:
    """The solids of a shape, then its other faces as one compound."""
    topods = unwrap(shape)
    solids = solids_of(topods)
    inside = {ShapeKey(face) for solid in solids for face in faces_of(solid)}
    loose = [face for face in faces_of(topods) if ShapeKey(face) not in inside]
    return [*solids, make_compound(loose)] if loose else [*solids]
