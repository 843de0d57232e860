"""Many patches fitted at once by plain least squares, sharing their borders exactly.

A border is fitted first and from its own samples alone, end points interpolated, so that two patches with the same samples along
a common border get the same poles there, bit for bit, whichever way each runs it. The inner poles follow by tensor least
squares with the borders held. One pseudo-inverse per direction serves all patches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.splines.bspline import Array, design

SYMMETRY = 1e-12
"""Knots and points that mirror one another to this, relative to the domain, are symmetric."""


def fit_patches(
    samples: Array,
    u: Array,
    v: Array,
    knots_u: Array,
    knots_v: Array,
    degree_u: int,
    degree_v: int,
) -> Array:
    """Poles (P, U, V, D) of P patches sampled on one grid u (m,), v (n,) that reaches the ends of the domain: (P, m, n, D).

    Knots and points must be symmetric about the middle of the domain, for borders that are run both ways.
    """
    along_u, along_v = _line(u, knots_u, degree_u), _line(v, knots_v, degree_v)
    if samples.ndim != 4 or samples.shape[1:3] != (len(u), len(v)):
        raise ValueError(f"samples {samples.shape} are not (patches, {len(u)}, {len(v)}, dimension)")
    poles = np.zeros((len(samples), along_u.basis.shape[1], along_v.basis.shape[1], samples.shape[3]))
    poles[:, :, 0], poles[:, :, -1] = _border(along_u, samples[:, :, 0]), _border(along_u, samples[:, :, -1])
    poles[:, 0], poles[:, -1] = _border(along_v, samples[:, 0]), _border(along_v, samples[:, -1])
    rest = samples - np.einsum("mu,puvd,nv->pmnd", along_u.basis, poles, along_v.basis, optimize=True)
    poles[:, 1:-1, 1:-1] = np.einsum("um,pmnd,vn->puvd", along_u.inverse, rest, along_v.inverse, optimize=True)
    return poles


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """One direction: the basis at the points (m, n) and the pseudo-inverse of its inner columns (n - 2, m)."""

    basis: Array
    inverse: Array


def _line(points: Array, knots: Array, degree: int) -> _Line:
    low, high = knots[degree], knots[-degree - 1]
    if points[0] != low or points[-1] != high:
        raise ValueError(f"points from {points[0]} to {points[-1]} don't reach the ends of the domain [{low}, {high}]")
    for values in (points, knots):
        if np.abs(values + values[::-1] - low - high).max() > SYMMETRY * (high - low):
            raise ValueError("knots and points must be symmetric about the middle of the domain")
    basis = design(knots, degree, points)
    if len(points) < basis.shape[1]:
        raise ValueError(f"{len(points)} points along a border can't determine {basis.shape[1]} poles")
    return _Line(basis, np.asarray(np.linalg.pinv(basis[:, 1:-1]), np.float64))


def _border(line: _Line, samples: Array) -> Array:
    """Poles (P, n, D) of curves through the first and the last of their samples (P, m, D)."""
    # The mean of both ways is the same, to the bit, whichever way the samples run.
    return (_one_way(line, samples) + _one_way(line, samples[:, ::-1])[:, ::-1]) / 2


def _one_way(line: _Line, samples: Array) -> Array:
    first, last = samples[:, :1], samples[:, -1:]
    rest = samples - line.basis[:, :1] * first - line.basis[:, -1:] * last
    # Without BLAS every sum is added up in the same order, wherever in the batch its patch is.
    inner = np.einsum("im,pmd->pid", line.inverse, np.ascontiguousarray(rest))
    return np.concatenate([first, inner, last], axis=1)
