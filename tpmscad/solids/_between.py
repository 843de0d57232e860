"""The solid between two four-sided faces of a CAD part as the domain of a coordinate map.

Both faces become splines of one space: of a face on a polynomial spline these are its own knots and poles, of degree raised to
that of the other and with the knots of both. The segments between points of equal parameters fill the domain: a trivariate spline
that is linear from the first face to the second. Its knots are lengths: fields keep their size on average.
"""

from __future__ import annotations

from itertools import product
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import triple
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANYTHING
from tpmscad.kernel.body_import.four_sided_face import convert_four_sided
from tpmscad.lattices.spline_maps import SplineMap, spline_map
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.bspline_volume import BSplineVolume, ruled_volume
from tpmscad.splines.knots import to_common_space, turn_surface

CLOSED_TOL_FRACTION = 1e-9
"""A face closes on itself if opposite sides agree to this fraction of its size."""

CROSSING_REMEDY = (
    "there the segments between corresponding points cross or lie in a face: use faces that lie over each other there, "
    "farther apart than they are bent"
)

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
        If a face has not four edges, has a knot across which it is not C1, or is trimmed in a way that no smooth chart follows;
        or if the segments cross, so that the map folds.

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
    first, second = convert_four_sided(face_a, "face_a"), convert_four_sided(face_b, "face_b")
    lower, upper = _join_seams(to_common_space(*_match(first.spline, second.spline)))
    a, b = lower.grid(COARSE, COARSE), upper.grid(COARSE, COARSE)
    middle = (a + b) / 2
    lengths = [
        float(np.linalg.norm(np.diff(middle, axis=0), axis=-1).sum(axis=0).mean()),
        float(np.linalg.norm(np.diff(middle, axis=1), axis=-1).sum(axis=1).mean()),
        float(np.linalg.norm(b - a, axis=-1).mean()),
    ]
    ruled = ruled_volume(lower, upper)
    knots = triple(t * length for t, length in zip(ruled.knots, lengths, strict=True))
    volume = BSplineVolume(ruled.poles, knots, ruled.degrees)
    return spline_map(volume, "map between two faces", max(first.error, second.error), CROSSING_REMEDY)


def _match(first: BSplineSurface, second: BSplineSurface) -> tuple[BSplineSurface, BSplineSurface]:
    """Both surfaces with corners that correspond, right-handed with the direction from the first to the second."""
    a = first.grid(COARSE, COARSE)
    choices = [turn_surface(second, *how) for how in product((False, True), repeat=3)]
    b = min(choices, key=lambda surface: float(np.square(surface.grid(COARSE, COARSE) - a).sum()))
    across = b.grid(COARSE, COARSE) - a
    du, dv = np.gradient(a, axis=0), np.gradient(a, axis=1)
    if np.einsum("ijd,ijd->", np.cross(du, dv), across) < 0:
        return turn_surface(first, swap=True), turn_surface(b, swap=True)
    return first, b


def _join_seams(surfaces: tuple[BSplineSurface, BSplineSurface]) -> tuple[BSplineSurface, BSplineSurface]:
    """The surfaces with the same poles on both sides of a seam, which they have to round-off."""
    joined = []
    for surface in surfaces:
        poles = surface.poles.copy()
        extent = float(np.ptp(poles.reshape(-1, 3), axis=0).max())
        for one, other in ((poles[0], poles[-1]), (poles[:, 0], poles[:, -1])):
            if np.abs(one - other).max() <= CLOSED_TOL_FRACTION * extent:
                one[:] = other[:] = (one + other) / 2
        joined.append(BSplineSurface(poles, surface.knots_u, surface.knots_v, surface.degree_u, surface.degree_v))
    return joined[0], joined[1]
