"""Curves of traced edges, and their parameter curves on both sheets with the same parameter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from tpmscad._typing import Array
from tpmscad.brep.carriers import EdgeCurve, Plane
from tpmscad.brep.curve_recognition import recognise_line_or_circle
from tpmscad.erosion.edge_graph import TracedEdge
from tpmscad.erosion.intersections import meet_pair
from tpmscad.erosion.sheets import Sheet
from tpmscad.errors import TrimmingError, format_point
from tpmscad.splines.adaptive_curve_fit import fit_adaptively
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, is_segment, line_segment

KNOWN_REL_TOL = 1e-11
"""In body sizes: distance within which an edge is a line or a circle."""

EDGE_REL_TOL = 5e-10
"""In body sizes: tolerance of fitted edges and pcurves."""

AFFINE_TOL = 1e-11
"""Of the range of parameters: deviation up to which a pcurve is straight."""

MIN_POINTS = 9
"""Fewest points of a trace that is interpolated; a shorter one is filled up."""

MAX_DIVISIONS = 4
"""How often the points of a trace are doubled if Newton's method finds no point of the edge between them."""

SAMPLES = 33
"""Points along a known curve at which pcurves are tested for straightness."""

CROSSING_SAMPLES = 400
"""Points along an edge between which it crosses knot lines of its sheets."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedEdge:
    """A curve, its span, and the pcurves on both sheets, None on a plane."""

    curve: EdgeCurve
    span: tuple[float, float]
    pcurves: tuple[BSplineCurve | None, BSplineCurve | None]


def fit_edge(one: Sheet, other: Sheet, edge: TracedEdge, size: float) -> FittedEdge:
    """The curve of a traced edge, a line or a circle where it is one, within 5e-10 of the size of both sheets.

    Near a centre of curvature the parameters change fast along an edge; its trace is then interpolated through more points.
    """
    parameters, points = _fill_up(one, other, edge)
    for _ in range(MAX_DIVISIONS):
        try:
            return _fit(one, other, parameters, points, size)
        except _LostEdge:
            parameters, points = _divide(one, other, parameters, points)
    return _fit(one, other, parameters, points, size)


class _LostEdge(TrimmingError):
    """A point of an edge that Newton's method does not find from the interpolated trace."""


def _fit(one: Sheet, other: Sheet, parameters: Array, points: Array, size: float) -> FittedEdge:
    """The curve through the parameters (n, 4) and points (n, 3) of a trace."""
    known = recognise_line_or_circle(points, KNOWN_REL_TOL * size)
    if known is not None and is_segment(known[0]):
        t = (points - points[0]) @ known[0](0.5 * known[1][1], 1)
    elif known is not None:
        arm = points - known[0].origin  # type: ignore[union-attr]
        t = np.unwrap(np.arctan2(arm @ known[0].y_axis, arm @ known[0].x_axis))  # type: ignore[union-attr]
    else:
        t = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    span = known[1] if known is not None else (0.0, float(t[-1]))
    t[0], t[-1] = span
    path = make_interp_spline(t, np.concatenate([parameters, points], axis=1), 5)

    def meet(s: Array) -> tuple[Array, Array]:
        """Parameters (n, 4) and points (n, 3) at the curve's parameters (n,)."""
        guess, slope = path(s), path(s, 1)
        at, along = (guess[:, 4:], slope[:, 4:]) if known is None else (known[0](s), known[0](s, 1))
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        found = meet_pair(one, other, guess[:, :4], at, along)
        if not found.converged.all():
            raise _LostEdge(f"an edge of the eroded body is lost near {format_point(at[~found.converged][0])}")
        return found.parameters, found.points

    pcurves: list[BSplineCurve | None] = [None, None]
    curved = [k for k, sheet in enumerate((one, other)) if not isinstance(sheet.carrier, Plane)]
    if known is not None:
        s = np.linspace(*span, SAMPLES)
        y, _ = meet(s) if curved else (np.zeros((SAMPLES, 4)), None)
        for k in list(curved):
            pcurves[k] = _straight(s, y[:, 2 * k : 2 * k + 2], size)
            if pcurves[k] is not None:
                curved.remove(k)
        if not curved:
            return FittedEdge(known[0], span, (pcurves[0], pcurves[1]))

    def values(s: Array) -> Array:
        y, found = meet(s)
        return np.concatenate([y, found], axis=1)

    def error(fit: BSplineCurve, s: Array) -> Array:
        got = fit(s)
        at = got[:, 4:] if known is None else known[0](s)
        off = np.zeros(len(s))
        for k, sheet in enumerate((one, other)):
            if isinstance(sheet.carrier, Plane):
                off = np.maximum(off, np.abs(sheet.carrier.distance(at)))
            elif k in curved:
                off = np.maximum(off, np.linalg.norm(sheet.carrier(*got[:, 2 * k : 2 * k + 2].T) - at, axis=1))
        return off

    breaks = _find_breaks((one, other), path, span)
    fit = fit_adaptively(values, breaks, error, EDGE_REL_TOL * size, breaks[1:-1])
    if fit is None:
        raise TrimmingError(f"an edge of the eroded body at {format_point(points[len(points) // 2])} fits no spline")
    for k in curved:
        pcurves[k] = BSplineCurve(fit.poles[:, 2 * k : 2 * k + 2].copy(), fit.knots, fit.degree)
    curve = BSplineCurve(fit.poles[:, 4:].copy(), fit.knots, fit.degree) if known is None else known[0]
    return FittedEdge(curve, span, (pcurves[0], pcurves[1]))


def _fill_up(one: Sheet, other: Sheet, edge: TracedEdge) -> tuple[Array, Array]:
    """Parameters and points of a trace, with points between where there are few; points too close to the next are left out."""
    parameters, points = edge.parameters, edge.points
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    kept = np.concatenate([[True], chords > 1e-3 * chords.max()])
    kept[-1] = True
    if not chords[-1] > 1e-3 * chords.max() and kept.sum() > 2:
        kept[np.flatnonzero(kept)[-2]] = False
    parameters, points = parameters[kept], points[kept]
    while len(points) < MIN_POINTS:
        parameters, points = _divide(one, other, parameters, points)
    return parameters, points


def _divide(one: Sheet, other: Sheet, parameters: Array, points: Array) -> tuple[Array, Array]:
    """The parameters and points of a trace with a point more between any two."""
    step = np.diff(points, axis=0)
    along = step / np.linalg.norm(step, axis=1, keepdims=True)
    found = meet_pair(one, other, 0.5 * (parameters[1:] + parameters[:-1]), 0.5 * (points[1:] + points[:-1]), along)
    if not found.converged.all():
        raise TrimmingError(f"an edge of the eroded body is lost near {format_point(points[:-1][~found.converged][0])}")
    at = np.arange(1, len(points))
    return np.insert(parameters, at, found.parameters, axis=0), np.insert(points, at, found.points, axis=0)


def _straight(t: Array, uv: Array, size: float) -> BSplineCurve | None:
    """The pcurve through (u, v) (n, 2) at parameters t (n,) if it is straight and of even speed."""
    w = ((t - t[0]) / (t[-1] - t[0]))[:, None]
    line = (1 - w) * uv[0] + w * uv[-1]
    if np.abs(uv - line).max() > AFFINE_TOL * max(1.0, size):
        return None
    return line_segment(uv[0], uv[-1], (float(t[0]), float(t[-1])))


def _find_breaks(sheets: tuple[Sheet, Sheet], path: object, span: tuple[float, float]) -> Array:
    """The ends of an edge and the parameters at which it crosses knot lines of fitted sheets."""
    assert callable(path)
    t = np.linspace(*span, CROSSING_SAMPLES)
    y = path(t)
    found = []
    for k, sheet in enumerate(sheets):
        if not isinstance(sheet.carrier, BSplineSurface):
            continue
        for axis, knots in enumerate((sheet.carrier.knots_u, sheet.carrier.knots_v)):
            values, count = np.unique(knots, return_counts=True)
            for knot in values[1:-1][count[1:-1] > 1].tolist():  # elsewhere it is smooth enough
                off = y[:, 2 * k + axis] - knot
                at = np.flatnonzero(off[1:] * off[:-1] < 0)
                for low, high in zip(t[at].tolist(), t[at + 1].tolist(), strict=True):
                    for _ in range(50):
                        middle = 0.5 * (low + high)
                        same = (path(middle)[2 * k + axis] - knot) * (path(low)[2 * k + axis] - knot) > 0
                        low, high = (middle, high) if same else (low, middle)
                    found.append(0.5 * (low + high))
    breaks = np.unique(np.concatenate([[span[0]], found, [span[1]]]))
    apart = np.diff(breaks) > 1e-4 * (span[1] - span[0])
    kept = np.concatenate([[True], apart])
    kept[-1] = True
    breaks = breaks[kept]
    return breaks if len(breaks) == 2 or breaks[-1] - breaks[-2] > 1e-4 * (span[1] - span[0]) else np.delete(breaks, -2)
