"""Carriers of trimmed faces that end where the faces end.

A face that is cut out of a patch keeps the whole patch as its carrier, and kernels bound a face by the poles of its carrier.
Where these leave the box of the solid, the carrier is restricted to the parameter box of the face: the same polynomials, to
round-off, with the same parameters, so that pcurves, edges and quadratures stay as they are. Copies of a face share one carrier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep, spline_faces
from tpmscad.brep.extents import reach_of_poles
from tpmscad.splines.basis import differentiate_poles
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.splines.knots import restrict_surface

EXCESS_FRACTION = 1e-4
"""Part of the solid's size by which poles may leave its box."""

BOX_STEPS = 1024
"""Parameter boxes are rounded outwards to this many steps of the domain, so that copies of a face share one carrier."""

KNOT_SNAP_FRACTION = 1e-9
"""Part of the domain within which an end of a box is a knot: kernels refuse knots that differ by round-off."""

SAMPLES_PER_USE = 33
"""Points along an edge use, for the parameter box of a face; second derivatives bound how far it bulges between them."""


@dataclass(frozen=True, slots=True, eq=False)
class RestrictedSurface(BSplineSurface):
    """The part of the surface `whole` on a box of its domain, with its own poles."""

    whole: BSplineSurface


def whole_surfaces(brep: Brep) -> tuple[dict[int, BSplineSurface], IntArray]:
    """The B-spline surfaces that faces are parts of, by number, and the number of each carrier's own, or its own number: (n,)."""
    first: dict[int, int] = {}
    number = np.arange(len(brep.carriers))
    wholes: dict[int, BSplineSurface] = {}
    for i, carrier in enumerate(brep.carriers):
        if isinstance(carrier, BSplineSurface):
            whole = carrier.whole if isinstance(carrier, RestrictedSurface) else carrier
            number[i] = first.setdefault(id(whole), i)
            wholes.setdefault(int(number[i]), whole)
    return wholes, number


def restrict_carriers(brep: Brep, low: Array, high: Array) -> Brep:
    """The same faces, those whose poles leave their box on restricted carriers.

    `low` and `high`, (3,) or (F, 3), are the corners of the box that each face should keep to.
    """
    leaving = _find_leaving_faces(brep, np.concatenate(np.broadcast_arrays(-low, high), axis=-1))
    faces = np.flatnonzero(leaving)
    if not len(faces):
        return brep
    carriers, index = list(brep.carriers), brep.faces.carrier.copy()
    rows = np.column_stack([index[faces], _parameter_steps(brep, leaving)[faces]])
    for row in np.unique(rows, axis=0):
        number, *steps = row.tolist()
        if steps == [0, 0, BOX_STEPS, BOX_STEPS]:
            continue
        surface = brep.carriers[number]
        assert isinstance(surface, BSplineSurface)
        index[faces[(rows == row).all(axis=1)]] = len(carriers)
        carriers.append(_restrict(surface, steps))
    return replace(brep, carriers=tuple(carriers), faces=replace(brep.faces, carrier=index))


def _find_leaving_faces(brep: Brep, bounds: Array) -> BoolArray:
    """Whether the poles of a face leave its bounds along -x, -y, -z, x, y or z: (F,); bounds (6,) or (F, 6)."""
    bounds = np.broadcast_to(bounds, (len(brep.faces), 6))
    limit = EXCESS_FRACTION * float((bounds[:, :3] + bounds[:, 3:]).max(initial=0.0))
    leaving = np.zeros(len(brep.faces), bool)
    for own, surface in spline_faces(brep):
        reach = reach_of_poles(brep.faces.motion[own], surface.poles.reshape(-1, 3))
        leaving[own] = (reach > bounds[own] + limit).any(axis=1)
    return leaving


def _parameter_steps(brep: Brep, leaving: BoolArray) -> IntArray:
    """The parameter box (u0, v0, u1, v1) of each leaving face, rounded outwards to steps of its carrier's domain: (F, 4)."""
    face = brep.face_of_use
    use = np.flatnonzero(leaving[face])
    lowest, highest = bound_curves(brep.pcurves, brep.uses.pcurve[use], brep.edges.span[brep.uses.edge[use]])
    low, high = np.full((len(brep.faces), 2), np.inf), np.full((len(brep.faces), 2), -np.inf)
    np.minimum.at(low, face[use], lowest)
    np.maximum.at(high, face[use], highest)
    steps = np.zeros((len(brep.faces), 4), np.int64)
    for own, surface in spline_faces(brep):
        kept = own[leaving[own]]
        start, end = np.array(surface.domain).T
        scale = BOX_STEPS / (end - start)
        steps[kept, :2] = np.clip(np.floor((low[kept] - start) * scale), 0, BOX_STEPS)
        steps[kept, 2:] = np.clip(np.ceil((high[kept] - start) * scale), 0, BOX_STEPS)
    return steps


def bound_curves(curves: Sequence[BSplineCurve], number: IntArray, span: Array) -> tuple[Array, Array]:
    """Corners (n, D), (n, D) of boxes that hold the curves of the given numbers (n,) on their spans (n, 2).

    Between samples at distance h a coordinate leaves those of its neighbours by h^2 / 8 times its greatest second derivative at
    most, and the poles of the derivative bound that.
    """
    x = np.linspace(0.0, 1.0, SAMPLES_PER_USE)
    width = np.diff(span, axis=1)
    t = span[:, :1] + width * x
    (points,) = evaluate_curves(curves, np.repeat(number, len(x)), t.ravel())
    points = points.reshape(len(number), len(x), -1)
    used, at = np.unique(number, return_inverse=True)
    curvature = np.array([_greatest_second_derivative(curves[i]) for i in used.tolist()]).reshape(len(used), -1)
    bulge = (width / (len(x) - 1)) ** 2 / 8.0 * curvature[at]
    low, high = points.min(axis=1) - bulge, points.max(axis=1) + bulge
    for i in [
        i for i in used.tolist() if curves[i].degree == 1 and len(curves[i].poles) > 2
    ]:  # polylines turn at their poles
        own, poles = number == i, curves[i].poles
        low[own], high[own] = np.minimum(low[own], poles.min(axis=0)), np.maximum(high[own], poles.max(axis=0))
    return low, high


def _greatest_second_derivative(curve: BSplineCurve) -> Array:
    """Bound of the second derivative of each coordinate, 0 for degree 1: (D,)."""
    poles, knots, degree = curve.poles[:, None, :], curve.knots, curve.degree
    if degree == 1:
        return np.zeros(poles.shape[2])
    for _ in range(2):
        poles, knots, degree = differentiate_poles(poles, knots, degree)
    return np.asarray(np.abs(poles[:, 0]).max(axis=0))


def _restrict(surface: BSplineSurface, steps: list[int]) -> RestrictedSurface:
    """The surface on a box (u0, v0, u1, v1) in steps of its domain."""
    ends = []
    for (low, high), knots, first, last in zip(
        surface.domain, (surface.knots_u, surface.knots_v), steps[:2], steps[2:], strict=True
    ):
        start = low if first == 0 else low + (high - low) * first / BOX_STEPS
        end = high if last == BOX_STEPS else low + (high - low) * last / BOX_STEPS
        near_start, near_end = (float(knots[np.abs(knots - t).argmin()]) for t in (start, end))
        tiny = KNOT_SNAP_FRACTION * (high - low)
        ends.append(
            (near_start if abs(near_start - start) < tiny else start, near_end if abs(near_end - end) < tiny else end)
        )
    part = restrict_surface(surface, *ends)
    whole = surface.whole if isinstance(surface, RestrictedSurface) else surface
    return RestrictedSurface(part.poles, part.knots_u, part.knots_v, part.degree_u, part.degree_v, whole)
