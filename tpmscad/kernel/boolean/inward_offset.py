"""Inward offset of a CAD body by the thickness of its skin, with open faces held fixed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from OCP.BRepOffset import BRepOffset_MakeOffset, BRepOffset_Skin
from OCP.GeomAbs import GeomAbs_Intersection
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE
from OCP.TopoDS import TopoDS_Face, TopoDS_Solid
from scipy.stats import qmc

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel.boolean.boolean_operations import translate_occt_errors
from tpmscad.kernel.measure.cad_body import CadBody, read_body
from tpmscad.kernel.measure.shape_sampling import sample_edge
from tpmscad.kernel.measure.signed_distance import BodyDistance
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import count_subshape_uses, faces_of

OPERATION = "offset by the skin"

JOIN_TOLERANCE = 1e-6
"""Model units: largest gap between neighbouring offset faces."""

DEPTH_SAMPLES = 2048
"""Sample points that estimate the volume deeper than the skin; a wrong offset misses whole corners."""

MAX_STANDARD_ERRORS = 4.0
"""Accepted difference in standard errors of a random sample; the quasi-random one used is more accurate."""

PIECES_PER_EDGE = 4
"""Intervals per edge of the offset body at whose ends its depth is checked."""

DEPTH_REL_TOL = 1e-4
"""Relative tolerance, in skin thicknesses, on the depth of the offset body's edges; self-intersecting offset faces miss
it by a whole fillet radius."""

DEPTH_ABS_TOL = 10 * JOIN_TOLERANCE
"""Model units: absolute tolerance on that depth, for thin skins."""


def offset_inward(body: CadBody, skin: float, open_faces: Sequence[TopoDS_Face] = ()) -> CadBody:
    """The part of the body deeper than `skin` (model units) below its faces; open faces are held fixed.

    Raises InvalidRequest if nothing is that deep, and KernelError if OCCT fails or its result has a wrong volume or depth.
    """
    if not (np.isfinite(skin) and skin > 0):
        raise InvalidRequest(f"skin {skin!r} is a thickness: a finite number above zero, or None for no skin")
    closed = [face for face in faces_of(body.shape) if not any(face.IsSame(o) for o in open_faces)]
    if not closed:
        raise InvalidRequest("open_faces holds all faces of the body: omit the skin instead")
    distance = BodyDistance(body.shape, *enclosing_box(body.shape), tuple(closed))
    depth, points = _sample_depths(body, distance)
    if not (depth > skin).any():
        raise InvalidRequest(
            f"a skin of {skin:g} is thicker than {body.name}, which is nowhere deeper than {depth.max():.4g}: "
            "make it thinner, or leave the body solid"
        )
    maker = BRepOffset_MakeOffset()
    remedy = f"; make the skin thinner than the body's smallest fillets, or offset {body.name} where it was modelled"
    with translate_occt_errors(OPERATION, body.shape, remedy):
        maker.Initialize(body.shape, -skin, JOIN_TOLERANCE, BRepOffset_Skin, False, False, GeomAbs_Intersection, False)
        for face in open_faces:
            maker.SetOffsetOnFace(face, 0.0)
        maker.MakeOffsetShape()
        shape = maker.Shape() if maker.IsDone() else None
        if shape is None or shape.IsNull():
            raise KernelError(OPERATION, f"the kernel found no offset at {skin:g}{remedy}", body.shape)
        try:
            inner = read_body(shape)
        except InvalidRequest as error:
            raise KernelError(OPERATION, f"{error}{remedy}", body.shape) from error
    low, high = enclosing_box(body.shape)
    fraction = float((depth > skin).mean())
    box = float(np.prod(high - low))
    error = MAX_STANDARD_ERRORS * np.sqrt(max(fraction * (1 - fraction), 1 / len(points)) / len(points)) * box
    if abs(inner.volume - fraction * box) > error:
        raise KernelError(
            OPERATION,
            f"the kernel's offset has volume {inner.volume:.4g}, but {fraction * box:.4g} +- {error:.2g} lies deeper than "
            f"{skin:g}{remedy}",
            body.shape,
        )
    points = sample_edges(inner.shape)
    off = np.abs(np.abs(distance(points)) - skin)
    if off.max() > max(DEPTH_REL_TOL * skin, DEPTH_ABS_TOL):
        where = ", ".join(f"{c:.4g}" for c in points[off.argmax()])
        raise KernelError(OPERATION, f"the kernel's offset folds over near ({where}){remedy}", body.shape)
    return inner


def sample_edges(shape: TopoDS_Solid) -> Array:
    """Points along every edge of a solid: (n, 3)."""
    edges = [convert.as_edge(edge) for edge, _ in count_subshape_uses(shape, TopAbs_EDGE, TopAbs_FACE)]
    return np.concatenate([sample_edge(edge, PIECES_PER_EDGE) for edge in edges])


def _sample_depths(body: CadBody, distance: BodyDistance) -> tuple[Array, Array]:
    """Depths (n,) of quasi-random points in the body's box, and the points (n, 3)."""
    low, high = enclosing_box(body.shape)
    points = low + (high - low) * qmc.Sobol(3, seed=np.random.default_rng(0)).random(DEPTH_SAMPLES)
    return -distance(points), points
