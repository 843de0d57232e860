"""The solid between two four-sided faces of a CAD part as the domain of a coordinate map.

Each face is interpolated by a B-spline surface of degree 5 on uniform spans, halved until the surface agrees with the face; a
face that closes on itself gets a periodic spline. The segments between points of equal parameters fill the domain: a trivariate
spline that is linear from the first face to the second. Its knots are lengths: fields keep their size on average.
"""

from __future__ import annotations

from itertools import product
from typing import Annotated, Any

import numpy as np
from scipy.interpolate import make_interp_spline

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANYTHING
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.four_sided_face import FourSidedFace
from tpmscad.lattices.spline_maps import SplineMap, spline_map
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline_volume import BSplineVolume
from tpmscad.splines.knots import bezier_knots

DEGREE = 5
"""Degree along the faces: odd, as periodic interpolation wants it, and smoother than any patch that is fitted to the map."""

SPANS = (1, 2, 4, 8, 16, 32)
"""Numbers of spans along both parameters of a face in the order of trial."""

FACE_TOL_FRACTION = 1e-7
"""Greatest distance of the spline from the face, as a fraction of the face's size."""

CHECKS = (np.arange(80) + 0.37) / 80
"""Parameters off the breaks of the spline at which it is compared with the face."""

LEAST_PERIODIC_SPANS = 8
"""Least number of spans of a periodic spline: more than its degree, so that its knots differ."""

CLOSED_TOL_FRACTION = 1e-9
"""A face closes on itself if opposite sides agree to this fraction of its size."""

COARSE = np.linspace(0.0, 1.0, 13)
"""Parameters at which the sides of both faces are compared."""


@validate_call("maps.between(part.faces().sort_by(Axis.Z)[0], part.faces().sort_by(Axis.Z)[-1])")
def between(
    face_a: Annotated[
        Any,
        ANYTHING,
        "Faces of build123d or CadQuery, or TopoDS faces, with four edges each and without holes; a whole cylinder "
        "counts, its seam being two of the four. The third axis of the domain runs from the first to the second.",
    ],
    face_b: Annotated[Any, ANYTHING, "As `face_a`."],
) -> SplineMap:
    """Return the map of the solid between two four-sided faces of a CAD part.

    Returns
    -------
    SplineMap
        The map of the segments between corresponding points. The edges of its domain have the mean lengths along the faces and
        between them. A lattice closes along an axis in which both faces do.

    Raises
    ------
    InvalidRequest
        If a face has not four edges or is too intricate for a smooth spline, or if the segments cross, so that the map folds.

    Notes
    -----
    The corners of the faces are matched so that the sum of the squared lengths of the segments is least. Walls of a lattice
    keep their thickness in model units, however the map stretches its cells.

    Examples
    --------
    >>> plate = Box(60, 40, 8)  # doctest: +SKIP
    >>> faces = plate.faces().sort_by(Axis.Z)  # doctest: +SKIP
    >>> tpmscad.lattice("gyroid", cell=8, cells=(7, 5, 1), thickness=0.8, boundary="natural",
    ...                 map=maps.between(faces[0], faces[-1]))  # doctest: +SKIP
    """
    lower, upper = _match(FourSidedFace(face_a, "face_a"), FourSidedFace(face_b, "face_b"))
    closed = _closes(lower, 0) and _closes(upper, 0), _closes(lower, 1) and _closes(upper, 1)
    net, *knots = _interpolate((lower, upper), closed)
    a, b = lower(COARSE, COARSE), upper(COARSE, COARSE)
    middle = (a + b) / 2
    lengths = [
        float(np.linalg.norm(np.diff(middle, axis=0), axis=-1).sum(axis=0).mean()),
        float(np.linalg.norm(np.diff(middle, axis=1), axis=-1).sum(axis=1).mean()),
        float(np.linalg.norm(b - a, axis=-1).mean()),
    ]
    u, v, w = (t * length for t, length in zip((*knots, bezier_knots(1)), lengths, strict=True))
    return spline_map(BSplineVolume(net, (u, v, w), (DEGREE, DEGREE, 1)), "map between two faces")


def _match(first: Any, second: Any) -> tuple[Any, Any]:
    """Two charts (s, t) -> points whose corners correspond, right-handed with the direction from the first to the second."""
    a = first(COARSE, COARSE)
    choices = [_turn(second, *how) for how in product((False, True), repeat=3)]
    b = min(choices, key=lambda chart: float(np.square(chart(COARSE, COARSE) - a).sum()))
    across = b(COARSE, COARSE) - a
    du, dv = np.gradient(a, axis=0), np.gradient(a, axis=1)
    if np.einsum("ijd,ijd->", np.cross(du, dv), across) < 0:
        return _turn(first, True, False, False), _turn(b, True, False, False)
    return first, b


def _turn(chart: Any, swap: bool, reverse_s: bool, reverse_t: bool) -> Any:
    """The chart with its parameters swapped and reversed."""

    def evaluate(s: Array, t: Array) -> Array:
        s, t = (1 - s if reverse_s else s), (1 - t if reverse_t else t)
        return np.asarray(chart(t, s).swapaxes(0, 1) if swap else chart(s, t))

    return evaluate


def _closes(chart: Any, axis: int) -> bool:
    """Whether the ends of a chart along an axis are one curve."""
    points = chart(COARSE, COARSE)
    first, last = np.take(points, 0, axis), np.take(points, -1, axis)
    return bool(np.abs(first - last).max() <= CLOSED_TOL_FRACTION * np.ptp(points.reshape(-1, 3), axis=0).max())


def _interpolate(charts: tuple[Any, Any], closed: tuple[bool, bool]) -> tuple[Array, Array, Array]:
    """Control net (U, V, 2, 3) and both knot vectors on [0, 1] of the spline between two charts, of the fewest spans."""
    size = max(float(np.ptp(chart(COARSE, COARSE).reshape(-1, 3), axis=0).max()) for chart in charts)
    along = [
        _fewest_spans([_turn(chart, axis == 1, False, False) for chart in charts], ends_meet, FACE_TOL_FRACTION * size)
        for axis, ends_meet in enumerate(closed)
    ]
    (s, by_s, knots_u), (t, by_t, knots_v) = along
    nets = [np.einsum("is,jt,std->ijd", by_s, by_t, chart(s, t), optimize=True) for chart in charts]
    return np.stack(nets, axis=2), knots_u, knots_v


def _fewest_spans(charts: list[Any], closed: bool, tol: float) -> tuple[Array, Array, Array]:
    """Sites, matrix and knots of the interpolation along the first parameter of both charts, to the tolerance."""
    exact = [chart(CHECKS, COARSE) for chart in charts]
    for n in SPANS:
        sites, from_values, knots = _interpolation(n, closed)
        rows = design_matrix(knots, DEGREE, CHECKS) @ from_values
        fitted = [np.einsum("ij,jtd->itd", rows, chart(sites, COARSE)) for chart in charts]
        miss = max(float(np.abs(f - points).max()) for f, points in zip(fitted, exact, strict=True))
        if miss <= tol:
            return sites, from_values, knots
    raise InvalidRequest(
        f"a face is too intricate for a map: a spline of {SPANS[-1]} spans misses it by {miss:.3g}, more than {tol:.3g}; "
        "use faces without creases, or split them"
    )


def _interpolation(n_spans: int, closed: bool) -> tuple[Array, Array, Array]:
    """Sites (m,) on [0, 1], the matrix (poles, m) from values there to poles, and the clamped knots."""
    n = max(n_spans, LEAST_PERIODIC_SPANS) if closed else n_spans
    breaks = np.linspace(0.0, 1.0, n + 1)
    knots = np.concatenate([np.zeros(DEGREE), breaks, np.ones(DEGREE)])
    greville = np.array([float(knots[i + 1 : i + DEGREE + 1].mean()) for i in range(n + DEGREE)])
    from_values: Array = np.asarray(np.linalg.inv(design_matrix(knots, DEGREE, greville)), np.float64)
    if not closed:
        return greville, from_values, knots
    values = np.eye(n + 1)
    values[-1] = values[0]  # one site, met twice
    periodic = make_interp_spline(breaks, values, DEGREE, bc_type="periodic")
    return breaks, from_values @ np.asarray(periodic(greville), float), knots
