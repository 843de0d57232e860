"""Many surfaces or curves evaluated at once, each at parameters of its own.

B-splines, planes, quadrics, lines and conics lie side by side in flat arrays, and one compiled loop serves them all: a call for
each face would cost more than the evaluation. Other kinds are evaluated by OCCT, one after another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.kernel.occt.geometry_evaluators import (
    ConicEvaluator,
    CurveEvaluator,
    LineEvaluator,
    PlaneEvaluator,
    RevolutionEvaluator,
    SplineCurveEvaluator,
    SplineSurfaceEvaluator,
    SurfaceEvaluator,
    evaluate_basis,
)

LINEAR, FOREIGN, INCLINED, ROUND = 0, -1, -2, -3
"""Degrees that stand for planes and lines, of which the table holds origin and directions; for what OCCT evaluates; and for
surfaces of revolution with a straight and a circular profile, of which it holds the frame and a row with two lengths or angles.
Conics are ROUND curves: the table holds the centre and both half axes."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTable:
    """Surfaces by number: degrees (F, 2), columns of poles (F,), and where their knots and poles begin in the flat arrays."""

    evaluators: tuple[SurfaceEvaluator, ...]
    degrees: IntArray
    columns: IntArray
    knots: Array
    knots_from: IntArray
    poles: Array
    poles_from: IntArray

    def __call__(self, which: IntArray, uv: Array) -> tuple[Array, Array, Array]:
        """Points and both first derivatives, (n, 3) each, of surfaces (n,) at parameters (n, 2)."""
        found = np.empty((3, len(uv), 3))
        packed = (self.degrees, self.columns, self.knots, self.knots_from, self.poles, self.poles_from)
        _evaluate_surfaces(*packed, which, np.ascontiguousarray(uv), found)
        _ask_foreign(self.evaluators, self.degrees[:, 0], which, uv, found)
        return found[0], found[1], found[2]

    def select(self, chosen: IntArray) -> SurfaceTable:
        """The table of some surfaces (k,)."""
        return pack_surfaces([self.evaluators[i] for i in chosen.tolist()])


@dataclass(frozen=True, slots=True, eq=False)
class CurveTable:
    """Curves by number: degrees (E,), and where their knots and poles begin in the flat arrays."""

    evaluators: tuple[CurveEvaluator, ...]
    degrees: IntArray
    knots: Array
    knots_from: IntArray
    poles: Array
    poles_from: IntArray

    def __call__(self, which: IntArray, t: Array) -> tuple[Array, Array]:
        """Points and first derivatives, (n, 3) each, of curves (n,) at parameters (n,)."""
        found = np.empty((2, len(t), 3))
        packed = (self.degrees, self.knots, self.knots_from, self.poles, self.poles_from)
        _evaluate_curves(*packed, which, np.ascontiguousarray(t), found)
        _ask_foreign(self.evaluators, self.degrees, which, t, found)
        return found[0], found[1]

    def select(self, chosen: IntArray) -> CurveTable:
        """The table of some curves (k,)."""
        return pack_curves([self.evaluators[i] for i in chosen.tolist()])


def pack_surfaces(evaluators: Sequence[SurfaceEvaluator]) -> SurfaceTable:
    """The table of surfaces."""
    degrees, columns, knots, poles = [], [], [], []
    for each in evaluators:
        if isinstance(each, SplineSurfaceEvaluator):
            spline = each.spline
            degrees.append((spline.degree_u, spline.degree_v))
            columns.append(spline.poles.shape[1])
            knots += [spline.knots_u, spline.knots_v]
            poles.append(spline.poles.reshape(-1, 3))
            continue
        columns.append(0)
        knots += [np.zeros(0), np.zeros(0)]
        if isinstance(each, PlaneEvaluator):
            degrees.append((LINEAR, LINEAR))
            poles.append(np.stack([each.origin, each.along_u, each.along_v]))
        elif isinstance(each, RevolutionEvaluator):
            degrees.append((ROUND, ROUND) if each.round else (INCLINED, INCLINED))
            poles.append(np.concatenate([each.frame, [[each.first, each.second, 0.0]]]))
        else:
            degrees.append((FOREIGN, FOREIGN))
            poles.append(np.zeros((0, 3)))
    return SurfaceTable(
        tuple(evaluators),
        np.array(degrees, np.int64).reshape(-1, 2),
        np.array(columns, np.int64),
        *_lay_out(knots, 0),
        *_lay_out(poles, 3),
    )


def pack_curves(evaluators: Sequence[CurveEvaluator]) -> CurveTable:
    """The table of curves."""
    degrees, knots, poles = [], [], []
    for each in evaluators:
        if isinstance(each, SplineCurveEvaluator):
            degrees.append(each.spline.degree)
            knots.append(each.spline.knots)
            poles.append(each.spline.poles)
        elif isinstance(each, LineEvaluator):
            degrees.append(LINEAR)
            knots.append(np.zeros(0))
            poles.append(np.stack([each.origin, each.along]))
        elif isinstance(each, ConicEvaluator):
            degrees.append(ROUND)
            knots.append(np.zeros(0))
            poles.append(np.stack([each.origin, each.major, each.minor]))
        else:
            degrees.append(FOREIGN)
            knots.append(np.zeros(0))
            poles.append(np.zeros((0, 3)))
    return CurveTable(tuple(evaluators), np.array(degrees, np.int64), *_lay_out(knots, 0), *_lay_out(poles, 3))


def _lay_out(parts: Sequence[Array], width: int) -> tuple[Array, IntArray]:
    """Arrays one after another, and where each begins, with the end."""
    empty = np.zeros((0, width)) if width else np.zeros(0)
    return np.concatenate([empty, *parts]), np.cumsum([0, *map(len, parts)])


def _ask_foreign(
    evaluators: Sequence[Callable[[Any], tuple[Array, ...]]],
    degrees: IntArray,
    which: IntArray,
    at: Array,
    found: Array,
) -> None:
    """Fill the rows of `found` whose carriers OCCT evaluates."""
    foreign = np.flatnonzero(degrees[which] == FOREIGN)
    for number in np.unique(which[foreign]).tolist():
        rows = foreign[which[foreign] == number]
        for k, values in enumerate(evaluators[number](at[rows])):
            found[k, rows] = values


@njit_cached
def _evaluate_surfaces(
    degrees: IntArray,
    columns: IntArray,
    knots: Array,
    knots_from: IntArray,
    poles: Array,
    poles_from: IntArray,
    which: IntArray,
    uv: Array,
    found: Array,
) -> None:  # pragma: no cover - compiled
    """Points and derivatives by u and by v into found (3, n, 3); the last spans go on beyond the domain."""
    most = 1
    for f in range(len(degrees)):
        most = max(most, degrees[f, 0] + 1, degrees[f, 1] + 1)
    basis_u, slope_u, basis_v, slope_v = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    for i in range(len(which)):
        f = which[i]
        degree_u, degree_v, first = degrees[f, 0], degrees[f, 1], poles_from[f]
        if degree_u == LINEAR:
            for axis in range(3):
                along_u, along_v = poles[first + 1, axis], poles[first + 2, axis]
                found[0, i, axis] = poles[first, axis] + uv[i, 0] * along_u + uv[i, 1] * along_v
                found[1, i, axis], found[2, i, axis] = along_u, along_v
        elif degree_u in (INCLINED, ROUND):
            p, q, v = poles[first + 4, 0], poles[first + 4, 1], uv[i, 1]
            cosine, sine = np.cos(uv[i, 0]), np.sin(uv[i, 0])
            if degree_u == ROUND:
                r, z = p + q * np.cos(v), q * np.sin(v)
                by_r, by_z = -z, q * np.cos(v)
            else:
                by_r, by_z = np.sin(q), np.cos(q)
                r, z = p + v * by_r, v * by_z
            for axis in range(3):
                e_x, e_y, e_z = poles[first + 1, axis], poles[first + 2, axis], poles[first + 3, axis]
                away = cosine * e_x + sine * e_y
                found[0, i, axis] = poles[first, axis] + r * away + z * e_z
                found[1, i, axis] = r * (cosine * e_y - sine * e_x)
                found[2, i, axis] = by_r * away + by_z * e_z
        elif degree_u > 0:
            knots_u = knots[knots_from[2 * f] : knots_from[2 * f + 1]]
            knots_v = knots[knots_from[2 * f + 1] : knots_from[2 * f + 2]]
            first_u = evaluate_basis(knots_u, degree_u, uv[i, 0], basis_u, slope_u)
            first_v = evaluate_basis(knots_v, degree_v, uv[i, 1], basis_v, slope_v)
            for axis in range(3):
                x, xu, xv = 0.0, 0.0, 0.0
                for a in range(degree_u + 1):
                    row = first + (first_u + a) * columns[f] + first_v
                    along, across = 0.0, 0.0
                    for b in range(degree_v + 1):
                        along += poles[row + b, axis] * basis_v[b]
                        across += poles[row + b, axis] * slope_v[b]
                    x += basis_u[a] * along
                    xu += slope_u[a] * along
                    xv += basis_u[a] * across
                found[0, i, axis], found[1, i, axis], found[2, i, axis] = x, xu, xv


@njit_cached
def _evaluate_curves(
    degrees: IntArray,
    knots: Array,
    knots_from: IntArray,
    poles: Array,
    poles_from: IntArray,
    which: IntArray,
    t: Array,
    found: Array,
) -> None:  # pragma: no cover - compiled
    """Points and derivatives into found (2, n, 3); the last spans go on beyond the domain."""
    most = 1
    for e in range(len(degrees)):
        most = max(most, degrees[e] + 1)
    basis, slope = np.empty(most), np.empty(most)
    for i in range(len(which)):
        e = which[i]
        degree, first = degrees[e], poles_from[e]
        if degree == LINEAR:
            for axis in range(3):
                found[0, i, axis] = poles[first, axis] + t[i] * poles[first + 1, axis]
                found[1, i, axis] = poles[first + 1, axis]
        elif degree == ROUND:
            cosine, sine = np.cos(t[i]), np.sin(t[i])
            for axis in range(3):
                major, minor = poles[first + 1, axis], poles[first + 2, axis]
                found[0, i, axis] = poles[first, axis] + cosine * major + sine * minor
                found[1, i, axis] = cosine * minor - sine * major
        elif degree > 0:
            own = knots[knots_from[e] : knots_from[e + 1]]
            start = first + evaluate_basis(own, degree, t[i], basis, slope)
            for axis in range(3):
                x, along = 0.0, 0.0
                for a in range(degree + 1):
                    x += basis[a] * poles[start + a, axis]
                    along += slope[a] * poles[start + a, axis]
                found[0, i, axis], found[1, i, axis] = x, along
