"""Curves of traced edges, and their parameter curves on both sheets with the same parameter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import brentq

from tpmscad._typing import Array
from tpmscad.brep.carriers import EdgeCurve, Plane
from tpmscad.brep.curve_recognition import recognise_line_or_circle
from tpmscad.erosion.edge_graph import EdgeGraph, TracedEdge
from tpmscad.erosion.offset_shell import SheetEdge
from tpmscad.erosion.sheets import SheetCarrier
from tpmscad.errors import TrimmingError, format_point
from tpmscad.splines.adaptive_curve_fit import fit_adaptively
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, line_segment
from tpmscad.trimming.intersect.common_curves import Paths, correct_points, grade_sites
from tpmscad.trimming.intersect.common_points import make_work
from tpmscad.trimming.intersect.network_hits import evaluate_faces

KNOWN_REL_TOL = 1e-11
"""In body sizes: distance within which an edge is a line or a circle."""

EDGE_REL_TOL = 5e-10
"""In body sizes: tolerance of fitted edges and pcurves."""

AFFINE_TOL = 1e-11
"""Of the range of parameters: deviation up to which a pcurve is straight."""

GUESS_DEGREE = 5
"""Of the spline through a path, from which points between its points are found."""

CROSSING_SAMPLES = 400
"""Points along an edge between which it crosses knot lines of its sheets."""

MIN_BREAK = 1e-4
"""Of the length of an edge: breaks nearer to the next one are left out."""


COLUMNS = slice(3, 5), slice(5, 7)
"""Parameters on the first and the second sheet in the rows of a path."""


def fit_edges(graph: EdgeGraph) -> list[SheetEdge]:
    """The curves of all traced edges, within 5e-10 of the body's size of both sheets; lines and circles where they are such."""
    sheets = np.array([edge.sheets for edge in graph.edges], np.int64).reshape(-1, 2)
    points = [np.zeros((0, 10)), *(edge.path for edge in graph.edges)]
    start = np.cumsum([len(own) for own in points])
    paths = grade_sites(graph.patches, Paths(np.concatenate(points), start, sheets))
    graded = np.split(paths.points, paths.start[1:-1]) if len(sheets) else []
    return [_fit(graph, edge, path) for edge, path in zip(graph.edges, graded, strict=True)]


def _fit(graph: EdgeGraph, edge: TracedEdge, path: Array) -> SheetEdge:
    """The curve of an edge through the points of a path (n, 10), with the first sheet's face on its left."""
    one, other = (graph.shell.sheets[s] for s in edge.sheets)
    senses, pair = (one.sense, -other.sense), np.array([edge.sheets])
    size, carriers = graph.shell.size, (one.carrier, other.carrier)
    known = recognise_line_or_circle(path[:, :3], KNOWN_REL_TOL * size)
    curve, span, at = _choose_parameters(path[:, :3], known)
    guess = make_interp_spline(at, path[:, :7], GUESS_DEGREE)
    pcurves = [
        None if isinstance(c, Plane) or curve is None else _straight(at, path[:, own], size)
        for c, own in zip(carriers, COLUMNS, strict=True)
    ]
    left = [k for k in (0, 1) if pcurves[k] is None and not isinstance(carriers[k], Plane)]
    if curve is not None and not left:
        return SheetEdge(curve, span, edge.sheets, (pcurves[0], pcurves[1]), senses)

    def measure_gaps(y: Array, own: Sequence[int], points: Array) -> Array:
        """The larger distances (n,) of points (n, 3) from those of sheets at parameters in rows y (n, 7)."""
        at = [
            evaluate_faces(graph.patches, np.full(len(y), edge.sheets[k]), y[:, COLUMNS[k]].copy())[:, 0] for k in own
        ]
        return np.asarray(np.linalg.norm(np.array(at) - points, axis=2).max(axis=0))

    def values(t: Array) -> Array:
        """Points and parameters (n, 7) of the edge at parameters (n,)."""
        near, along = guess(t), guess(t, 1)[:, :3].copy()
        if curve is not None:
            near[:, :3], along = curve(t), curve(t, 1)
        rows, good = correct_points(graph.patches, np.repeat(pair, len(t), axis=0), near, along, make_work())
        # what is on both sheets already stays: a vertex in which they are tangent is lost, or moves along the other one's curve
        meets = measure_gaps(near, (0, 1), near[:, :3]) <= KNOWN_REL_TOL * size
        rows[meets, :7], good[meets] = near[meets], True
        if not good.all():
            raise TrimmingError(f"an edge of the eroded body is lost near {format_point(near[~good][0, :3])}")
        return rows[:, :7]

    def error(fit: BSplineCurve, t: Array) -> Array:
        """Distances (n,) of the curve from the points of both sheets at the parameters fitted."""
        y = fit(t)
        return measure_gaps(y, left if curve else (0, 1), curve(t) if curve else y[:, :3])

    breaks = _find_breaks(carriers, guess)
    fit = fit_adaptively(values, breaks, error, EDGE_REL_TOL * size, breaks[1:-1])
    if fit is None:
        raise TrimmingError(f"an edge of the eroded body at {format_point(path[len(path) // 2, :3])} fits no spline")
    for k in left:
        pcurves[k] = BSplineCurve(fit.poles[:, COLUMNS[k]].copy(), fit.knots, fit.degree)
    curve = curve or BSplineCurve(fit.poles[:, :3].copy(), fit.knots, fit.degree)
    return SheetEdge(curve, span, edge.sheets, (pcurves[0], pcurves[1]), senses)


def _choose_parameters(
    points: Array, known: tuple[EdgeCurve, tuple[float, float]] | None
) -> tuple[EdgeCurve | None, tuple[float, float], Array]:
    """The line or circle through points (n, 3) of an edge, if it is known, its span, and the parameters (n,) of the points.

    Of other curves these are the lengths of the chords.
    """
    if known is None:
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return None, (0.0, float(at[-1])), at
    curve, span = known
    if isinstance(curve, BSplineCurve):
        at = (points - points[0]) @ curve(0.0, 1)
    else:
        arm = points - curve.origin
        at = np.unwrap(np.arctan2(arm @ curve.y_axis, arm @ curve.x_axis))
    at[[0, -1]] = span
    return curve, span, at


def _straight(t: Array, uv: Array, size: float) -> BSplineCurve | None:
    """The pcurve through (u, v) (n, 2) at parameters t (n,) if it is straight and of even speed."""
    w = ((t - t[0]) / (t[-1] - t[0]))[:, None]
    if np.abs(uv - (1 - w) * uv[0] - w * uv[-1]).max() > AFFINE_TOL * max(1.0, size):
        return None
    return line_segment(uv[0], uv[-1], (float(t[0]), float(t[-1])))


def _find_breaks(carriers: Sequence[SheetCarrier], path: BSpline) -> Array:
    """The ends of an edge and the parameters at which it crosses lines in which fitted sheets are less smooth than elsewhere."""
    low, high = float(path.t[0]), float(path.t[-1])
    t, found = np.linspace(low, high, CROSSING_SAMPLES), []
    y = path(t)[:, 3:]
    for k, carrier in enumerate(carriers):
        if not isinstance(carrier, BSplineSurface):
            continue
        for column, knots in ((2 * k, carrier.knots_u), (2 * k + 1, carrier.knots_v)):
            inner, count = np.unique(knots, return_counts=True)
            for knot in inner[1:-1][count[1:-1] > 1].tolist():  # elsewhere it is smooth enough
                off = y[:, column] - knot
                for i in np.flatnonzero(off[1:] * off[:-1] < 0).tolist():
                    found.append(brentq(lambda s, c=column, x=knot: path(s)[3 + c] - x, t[i], t[i + 1]))
    inner, least = np.sort(found), MIN_BREAK * (high - low)
    apart = (np.diff(inner, prepend=low) > least) & (high - inner > least)
    return np.concatenate([[low], inner[apart], [high]])
