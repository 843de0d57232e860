"""Exact erosion of a body of planes and quadrics by an arrangement of the offset surfaces.

The surfaces of `offset_carriers` are split by each other in one general fuse. The pieces nowhere shallower than the skin bound
cells; the cells inside the body make up its part deeper than the skin. No offset of a shell is needed, so that faces may vanish,
merge or appear, and the body may have cavities, apexes and fillets smaller than the skin.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from OCP.BOPAlgo import BOPAlgo_MakerVolume
from OCP.BOPTools import BOPTools_AlgoTools3D
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAlgoAPI import BRepAlgoAPI_BuilderAlgo
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.BRepGProp import BRepGProp_Face
from OCP.gp import gp_Pnt, gp_Pnt2d, gp_Vec
from OCP.IntTools import IntTools_Context
from OCP.ShapeUpgrade import ShapeUpgrade_UnifySameDomain
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FORWARD, TopAbs_REVERSED, TopAbs_WIRE
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid, TopoDS_Wire

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane, SphericalSurface
from tpmscad.errors import KernelError
from tpmscad.kernel.body_import.body_brep import brep_and_source_faces
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import modified_faces, translate_occt_errors
from tpmscad.kernel.boolean.offset_carriers import CarrierPiece, find_edges_with_tubes, find_face_joints, offset_pieces
from tpmscad.kernel.boolean.shell_assembly import assemble_solids
from tpmscad.kernel.measure.shape_sampling import sample_edge
from tpmscad.kernel.measure.skin_depth import SkinDepth
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_shell
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, faces_of, list_subshapes, solids_of

OPERATION = "erosion by the skin"

SHALLOW_REL_TOL = 1e-5
"""In skins: a piece whose probes are shallower than the skin by more is no part of the boundary."""

MAX_SURFACES = 400
"""Surfaces in one general fuse, which takes about 0.03 s for each."""

MAX_DEPTH_RATIO = 1.45
"""In skins: depth of the mitres that are accepted."""

N_DIRECTIONS = 256
"""Directions in which the neighbourhood of a corner is searched; a gap between them is about 0.2 radians."""

_TURN = np.arange(N_DIRECTIONS) * np.pi * (3.0 - np.sqrt(5.0))
_HEIGHT = 1.0 - (2.0 * np.arange(N_DIRECTIONS) + 1.0) / N_DIRECTIONS
DIRECTIONS = np.stack(
    [np.sqrt(1 - _HEIGHT**2) * np.cos(_TURN), np.sqrt(1 - _HEIGHT**2) * np.sin(_TURN), _HEIGHT], axis=1
)
"""Evenly spread unit vectors (n, 3)."""

PROBE_STEP = 1e-3
"""In skins: step from a face of a cell to the probe that tells whether the cell is deep."""


def erode(
    body: CadBody,
    skin: float,
    open_faces: Sequence[TopoDS_Face],
    depth: SkinDepth,
    margin: float = 0.0,
    mitres: bool = True,
) -> tuple[TopoDS_Solid, ...]:
    """Solids of {depth > skin}, largest first; open faces bound it without a skin.

    `margin` (in skins) is that of `offset_pieces`: the kernel may intersect the surfaces with one and fail with another.
    Raises NotQuadric for a body with free-form faces, and KernelError if the surfaces do not close, or where a concave edge
    between faces with a skin has no exact tube and `mitres` is not set.
    """
    carriers, source = brep_and_source_faces(body.shape)
    own = faces_of(body.shape)
    is_open = np.array([any(own[f].IsSame(face) for face in open_faces) for f in source.tolist()])
    pieces = [*offset_pieces(carriers, is_open, skin, margin, mitres), *_corner_balls(carriers, is_open, skin, depth)]
    if len(pieces) > MAX_SURFACES:
        raise KernelError(OPERATION, f"{len(pieces)} offset surfaces are too many to intersect, at most {MAX_SURFACES}")
    with translate_occt_errors(OPERATION, body.shape):
        split = _split_by_each_other([make_face(piece) for piece in pieces])
        kept = _select_deep(split, skin, depth, np.inf if is_open.any() else MAX_DEPTH_RATIO * skin)
        cells = _deep_cells(kept, skin, depth)
        if not cells:
            raise KernelError(OPERATION, "the offset surfaces bound no cell deeper than the skin", body.shape)
        return assemble_solids(_unite_faces(_outer_faces(cells)))[0]


def _corner_balls(carriers: Brep, is_open: NDArray[np.bool_], skin: float, depth: SkinDepth) -> list[CarrierPiece]:
    """Spheres round the vertices that are the nearest points of the body's faces to some points at the depth of the skin."""
    leaving: dict[int, list[Array]] = {}
    corners: set[int] = set()
    tubes = {edge.index for edge in find_edges_with_tubes(carriers, is_open)}
    for edge in find_face_joints(carriers):
        if is_open[list(edge.faces)].all() or (edge.smooth and edge.index not in tubes):
            continue
        ends = int(carriers.edges.start[edge.index]), int(carriers.edges.end[edge.index])
        leaving.setdefault(ends[0], []).append(edge.tangents[0])
        leaving.setdefault(ends[1], []).append(-edge.tangents[-1])
        corners |= set(ends) if edge.index in tubes else set()
    x_axis, _, axis = np.eye(3)
    balls = []
    for vertex in sorted(corners):
        reach = DIRECTIONS @ np.array(leaving[vertex]).T
        outward = DIRECTIONS[reach.max(axis=1) < 0]
        center = carriers.vertices[vertex]
        if len(outward) and (depth(center + skin * outward) > skin * (1 - SHALLOW_REL_TOL)).any():
            sphere = SphericalSurface(center, x_axis, axis, skin)
            balls.append(CarrierPiece(sphere, ((0.0, 2 * np.pi), (-np.pi / 2, np.pi / 2)), 1, 0.0))
    return balls


def make_face(piece: CarrierPiece) -> TopoDS_Face:
    """The rectangle of a surface as a face."""
    carrier = piece.carrier
    surface = (
        convert.plane(carrier.origin, carrier.x_axis, carrier.y_axis)
        if isinstance(carrier, Plane)
        else convert.quadric(carrier)
    )
    made = BRepBuilderAPI_MakeFace(surface, *piece.box[0], *piece.box[1], CONFUSION_TOLERANCE)
    if not made.IsDone():
        raise KernelError(OPERATION, f"no face of a {type(carrier).__name__} on {piece.box}")
    return made.Face()


def _split_by_each_other(faces: Sequence[TopoDS_Face]) -> list[TopoDS_Face]:
    """The faces split along their common lines."""
    if len(faces) < 2:
        return list(faces)
    fuse = BRepAlgoAPI_BuilderAlgo()
    fuse.SetArguments(convert.shape_list(faces))
    fuse.SetToFillHistory(True)
    fuse.Build()
    if not fuse.IsDone() or fuse.Shape().IsNull():
        raise KernelError(OPERATION, "the kernel's general fuse failed")
    pieces: dict[ShapeKey, TopoDS_Face] = {}
    for face in faces:
        for image in modified_faces(fuse, face):
            pieces.setdefault(ShapeKey(image), image)
    return list(pieces.values())


def _select_deep(faces: Sequence[TopoDS_Face], skin: float, depth: SkinDepth, most: float) -> dict[ShapeKey, float]:
    """The faces nowhere shallower than the skin with their depths in the middle, which are at most `most`."""
    limit, context = skin * (1 - SHALLOW_REL_TOL), IntTools_Context()
    kept: dict[ShapeKey, float] = {}
    of_edge: dict[ShapeKey, float] = {}
    for face in faces:
        point = _interior_point(face, context)
        if point is None:
            continue
        middle = float(depth(point[None])[0])
        if not limit <= middle <= most:
            continue
        edges = [ShapeKey(edge) for edge in edges_of(face) if not BRep_Tool.Degenerated_s(edge)]
        for key in edges:
            if key not in of_edge:
                of_edge[key] = float(depth(sample_edge(key.shape, 2)[1:2])[0])
        if all(of_edge[key] >= limit for key in edges):
            kept[ShapeKey(face)] = middle
    return kept


def _interior_point(face: TopoDS_Face, context: IntTools_Context) -> Array | None:
    """A point inside a trimmed face: (3,), or None if the kernel finds none, in a sliver for example."""
    point, uv = gp_Pnt(), gp_Pnt2d()
    if BOPTools_AlgoTools3D.PointInFace_s(face, point, uv, context):
        return None
    return np.array(point.Coord())


def _deep_cells(faces: dict[ShapeKey, float], skin: float, depth: SkinDepth) -> list[TopoDS_Solid]:
    """The cells bounded by the faces that lie inside the body and deeper than the skin; the faces come with their depths."""
    maker = BOPAlgo_MakerVolume()
    maker.SetArguments(convert.shape_list(key.shape for key in faces))
    maker.SetIntersect(False)
    maker.Perform()
    if maker.HasErrors():
        raise KernelError(OPERATION, "the kernel made no volumes of the offset faces")
    context = IntTools_Context()
    cells = []
    for cell in solids_of(maker.Shape()):
        face = min(faces_of(cell), key=lambda f: faces.get(ShapeKey(f), np.inf))
        point, uv, normal = gp_Pnt(), gp_Pnt2d(), gp_Vec()
        BOPTools_AlgoTools3D.PointInFace_s(face, point, uv, context)
        BRepGProp_Face(face).Normal(uv.X(), uv.Y(), point, normal)
        n = np.array(normal.Coord())
        probe = np.array(point.Coord()) - PROBE_STEP * skin * n / np.linalg.norm(n)
        if depth(probe[None])[0] > skin * (1 + 0.1 * PROBE_STEP):
            cells.append(cell)
    return cells


def _outer_faces(cells: Sequence[TopoDS_Solid]) -> list[TopoDS_Face]:
    """The faces that bound one cell only."""
    uses: dict[ShapeKey, list[TopoDS_Face]] = {}
    for cell in cells:
        for face in faces_of(cell):
            if is_boundary(face):  # others dangle inside the cell
                uses.setdefault(ShapeKey(face), []).append(face)
    return [own[0] for own in uses.values() if len(own) == 1]


def _unite_faces(faces: Sequence[TopoDS_Face]) -> list[TopoDS_Face]:
    """The faces of a closed surface with neighbours on one carrier united, without edges inside them."""
    unite = ShapeUpgrade_UnifySameDomain(make_shell(map(_without_inner_edges, faces)), True, True, False)
    unite.Build()
    return faces_of(unite.Shape())


def _without_inner_edges(face: TopoDS_Face) -> TopoDS_Face:
    """The face without the edges that lie inside it, where other pieces end on it."""
    if all(is_boundary(edge) for edge in edges_of(face)):
        return face
    forward = face.Oriented(TopAbs_FORWARD)
    builder, copy = BRep_Builder(), convert.as_face(forward.EmptyCopied())
    for wire in list_subshapes(forward, TopAbs_WIRE):
        edges = [edge for edge in list_subshapes(wire, TopAbs_EDGE) if is_boundary(edge)]
        if edges:
            kept = TopoDS_Wire()
            builder.MakeWire(kept)
            for edge in edges:
                builder.Add(kept, edge)
            builder.Add(copy, kept)
    return convert.as_face(copy.Oriented(face.Orientation()))


def is_boundary(shape: TopoDS_Shape) -> bool:
    """Whether a face or an edge bounds the shape that it was found in on one side only."""
    return shape.Orientation() in (TopAbs_FORWARD, TopAbs_REVERSED)
