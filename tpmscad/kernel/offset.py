"""A body within its own skin: shrunk by the skin's thickness, and with voids in it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.BRepOffset import BRepOffset_Skin
from OCP.BRepOffsetAPI import BRepOffsetAPI_MakeOffsetShape
from OCP.GeomAbs import GeomAbs_Intersection
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_SHELL
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS_Solid
from scipy.stats import qmc

from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel import convert
from tpmscad.kernel.body import Body, bounds_of, read_body
from tpmscad.kernel.boolean import guarded
from tpmscad.kernel.build import solid_of
from tpmscad.kernel.distance import body_field
from tpmscad.patches.complex import Array

OFFSET = "offset by the skin"

JOIN_TOLERANCE = 1e-6
"""Model units: how far apart two offset faces may meet."""

SAMPLES = 2048
"""Points that tell whether the shrunk body is all that lies deeper than the skin: a wrong one is off by whole corners."""

AGREEMENT = 4.0
"""Standard errors of a plain random sample; the quasi-random one used is better."""

EDGE_POINTS = 5
"""Along every edge of the shrunk body."""

DEPTH = 1e-4
"""Of the skin: how far from it the depth of the shrunk body's edges may be. Faces that fold over miss it by whole radii."""


def shrunk(body: Body, skin: float) -> Body:
    """The part of the body that lies deeper than `skin` (model units).

    InvalidRequest if nothing does; KernelError where the kernel's offset gives up, or leaves out or adds something.
    """
    if not (np.isfinite(skin) and skin > 0):
        raise InvalidRequest(f"skin {skin!r} is a thickness: a finite number above zero, or None for no skin")
    depth, points = _depths(body)
    if not (depth > skin).any():
        raise InvalidRequest(
            f"a skin of {skin:g} is thicker than {body.name}, which is nowhere deeper than {depth.max():.4g}: "
            "make it thinner, or leave the body solid"
        )
    maker = BRepOffsetAPI_MakeOffsetShape()
    remedy = f"; make the skin thinner than the body's smallest fillets, or offset {body.name} where it was modelled"
    with guarded(OFFSET, body.shape, remedy):
        maker.PerformByJoin(
            body.shape, -skin, JOIN_TOLERANCE, BRepOffset_Skin, False, False, GeomAbs_Intersection, False
        )
        shape = maker.Shape() if maker.IsDone() else None
        if shape is None or shape.IsNull():
            raise KernelError(OFFSET, f"the kernel finds no offset at {skin:g}{remedy}", body.shape)
        try:
            inner = read_body(shape)
        except InvalidRequest as error:
            raise KernelError(OFFSET, f"{error}{remedy}", body.shape) from error
    low, high = bounds_of(body.shape)
    share = float((depth > skin).mean())
    box = float(np.prod(high - low))
    error = AGREEMENT * np.sqrt(max(share * (1 - share), 1 / len(points)) / len(points)) * box
    if abs(inner.volume - share * box) > error:
        raise KernelError(
            OFFSET,
            f"the kernel's offset has volume {inner.volume:.4g}, but {share * box:.4g} +- {error:.2g} lies deeper than "
            f"{skin:g}{remedy}",
            body.shape,
        )
    at = edge_points(inner.shape)
    off = np.abs(body_field(body.shape)(at) + skin)
    if off.max() > max(DEPTH * skin, 10 * JOIN_TOLERANCE):
        where = ", ".join(f"{c:.4g}" for c in at[off.argmax()])
        raise KernelError(OFFSET, f"the kernel's offset folds over near ({where}){remedy}", body.shape)
    return inner


def edge_points(shape: TopoDS_Solid) -> Array:
    """Points along every edge of a shape: (n, 3)."""
    points = []
    for edge, _ in convert.ancestors(shape, TopAbs_EDGE, TopAbs_FACE):
        curve = BRepAdaptor_Curve(convert.as_edge(edge))
        span = np.linspace(curve.FirstParameter(), curve.LastParameter(), EDGE_POINTS)
        points += [curve.Value(t).Coord() for t in span.tolist()]
    return np.array(points)


def _depths(body: Body) -> tuple[Array, Array]:
    """How deep points spread evenly over the body's box lie in it (n,), and these points (n, 3)."""
    low, high = bounds_of(body.shape)
    points = low + (high - low) * qmc.Sobol(3, seed=np.random.default_rng(0)).random(SAMPLES)
    return -body_field(body.shape)(points), points


def hollowed(body: Body, voids: Iterable[TopoDS_Solid]) -> TopoDS_Solid:
    """The body without solids that lie strictly inside it and apart: nothing is intersected, their shells turn inwards."""
    return solid_of([*_shells(body.shape), *(convert.as_shell(s.Reversed()) for v in voids for s in _shells(v))])


def _shells(solid: TopoDS_Solid) -> list[Any]:
    explorer, found = TopExp_Explorer(solid, TopAbs_SHELL), []
    while explorer.More():
        found.append(convert.as_shell(explorer.Current()))
        explorer.Next()
    return found
