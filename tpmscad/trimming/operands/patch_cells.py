"""Patches divided into cells, with bounds of their points and normals.

In each cell the second derivatives are bounded by the sums of their coefficients: with the point and the first derivatives at the
middle, Taylor's formula bounds the cell, and each smaller part of it. These bounds hold for the polynomials, round-off apart.
"""

from __future__ import annotations

from functools import lru_cache
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array
from tpmscad.brep.foot_surface import span_powers
from tpmscad.splines.basis import apply_span_bases
from tpmscad.splines.bspline import BSplineSurface

CELLS_PER_SIDE = 6
"""Cells along each parameter of a patch of one span, and pieces of an edge of one span; a span is never shared by two."""

MAX_CELLS_PER_SIDE = 32
"""The same at most, however much smaller the patches of the other network are."""

LENGTH_SAMPLES = 17
"""Points along each parameter that show how long a patch is; it takes .2 ms."""

PATCHES_PER_BATCH = 64
"""Patches divided at once: their arrays stay below a few tens of megabytes."""


class PatchCells(NamedTuple):
    """The monomials of one carrier, and its cells, in its own frame."""

    breaks: tuple[Array, Array]
    coefficients: Array
    middle: Array
    half: Array
    centre: Array
    radius: Array
    bend: Array
    normal: Array
    turn: Array


def divide_patches(surfaces: list[BSplineSurface], cell_size: float) -> list[PatchCells]:
    """The monomials and cells of patches, those of equal degrees and spans at once."""
    groups: dict[tuple[int, int, int, int, bytes, bytes], list[int]] = {}
    for i, s in enumerate(surfaces):
        knots = (_relative_knots(*own) for own in zip((s.knots_u, s.knots_v), s.domain, strict=True))
        key = (s.degree_u, s.degree_v, *_count_parts(s, cell_size), *(k.tobytes() for k in knots))
        groups.setdefault(key, []).append(i)  # type: ignore[arg-type]
    result: dict[int, PatchCells] = {}
    for key, members in groups.items():
        for part in range(0, len(members), PATCHES_PER_BATCH):
            own = members[part : part + PATCHES_PER_BATCH]
            result |= dict(zip(own, _divide_like_patches([surfaces[i] for i in own], key[2:4]), strict=True))
    return [result[i] for i in range(len(surfaces))]


def _count_parts(surface: BSplineSurface, cell_size: float) -> tuple[int, int]:
    """Parts of each span of u and of v: `CELLS_PER_SIDE` for the whole surface, or as many as cells of a size ask for."""
    u, v = (np.linspace(*ends, LENGTH_SAMPLES) for ends in surface.domain)
    points = surface(*np.meshgrid(u, v, indexing="ij"))  # poles of high degrees may lie far from the surface
    result = []
    for axis, knots in ((0, surface.knots_u), (1, surface.knots_v)):
        length = np.linalg.norm(np.diff(points, axis=axis), axis=2).sum(axis=axis).max()
        cells = min(max(CELLS_PER_SIDE, length / cell_size), MAX_CELLS_PER_SIDE)
        result.append(int(np.ceil(cells / (len(np.unique(knots)) - 1))))
    return result[0], result[1]


def _relative_knots(knots: Array, domain: tuple[float, float]) -> Array:
    """Knots as fractions of the domain: those of patches of one span are 0 and 1."""
    return np.asarray((knots - domain[0]) / (domain[1] - domain[0]))


def _divide_like_patches(surfaces: list[BSplineSurface], parts: tuple[int, int]) -> list[PatchCells]:
    """The monomials and cells of patches whose knots divide their domains alike; parts: cells of each span along u and v."""
    s = surfaces[0]
    degrees = p, q = s.degree_u, s.degree_v
    (_, left), (_, right) = (
        span_powers(_relative_knots(knots, domain), degree)
        for knots, domain, degree in zip((s.knots_u, s.knots_v), s.domain, degrees, strict=True)
    )
    poles = np.stack([own.poles for own in surfaces])
    coefficients = apply_span_bases(left, poles, right)
    n, nu, nv = coefficients.shape[:3]
    (x, hx, in_u), (y, hy, in_v) = (_part_powers(m, d) for m, d in zip(parts, degrees, strict=True))
    local = apply_span_bases(in_u, coefficients, in_v).swapaxes(2, 3)
    local = local.reshape(n, nu * parts[0] * nv * parts[1], p + 1, q + 1, 3)
    norms = np.linalg.norm(local, axis=4)
    k, m = np.arange(p + 1.0), np.arange(q + 1.0)
    bend = np.stack(
        [
            np.einsum("nckm,k->nc", norms, k * (k - 1)),
            np.einsum("nckm,k,m->nc", norms, k, m),
            np.einsum("nckm,m->nc", norms, m * (m - 1)),
        ],
        axis=2,
    )
    radius = norms.sum(axis=(2, 3)) - norms[:, :, 0, 0]
    normal, turn = _bound_normals(coefficients, parts)
    result = []
    for i, own in enumerate(surfaces):
        breaks = tuple(
            np.unique(knots[degree : len(knots) - degree])
            for knots, degree in zip((own.knots_u, own.knots_v), degrees, strict=True)
        )
        middles, halves = [], []
        for ends, at, h in zip(breaks, (x, y), (hx, hy), strict=True):
            centre, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * np.diff(ends)
            middles.append((centre[:, None] + half[:, None] * at).ravel())
            halves.append(np.repeat(half * h, len(at)))
        middle, half = (
            np.stack(np.meshgrid(*both, indexing="ij"), axis=2).reshape(-1, 2) for both in (middles, halves)
        )
        result.append(
            PatchCells(
                (breaks[0], breaks[1]),
                np.ascontiguousarray(coefficients[i]),
                middle,
                half,
                local[i, :, 0, 0].copy(),
                radius[i],
                bend[i],
                normal[i],
                turn[i],
            )
        )
    return result


def _bound_normals(coefficients: Array, parts: tuple[int, int]) -> tuple[Array, Array]:
    """Mean unit normals (n, cells, 3) of cells, and bounds (n, cells) of how far the unit normals in them differ from these.

    S_u x S_v is a polynomial: its Chebyshev coefficients on a cell, or on each quarter of a coarse one, of which the first is the
    mean, bound how far it leaves the direction of that. coefficients: of patches, (n, spans of u, of v, powers of u, of v, 3).
    """
    n, nu, nv, p, q, _ = coefficients.shape
    ways = 2 if max(nu * parts[0], nv * parts[1]) <= 2 * CELLS_PER_SIDE else 1
    (x, to_u), (y, to_v) = (_chebyshev_parts(ways * m, max(2 * (d - 1), 1)) for m, d in zip(parts, (p, q), strict=True))
    power_u, power_v = np.vander(x, p, increasing=True), np.vander(y, q, increasing=True)
    slope_u, slope_v = (
        np.concatenate([np.zeros((len(t), 1)), w[:, :-1] * np.arange(1.0, w.shape[1])], axis=1)
        for t, w in ((x, power_u), (y, power_v))
    )
    nets = np.moveaxis(coefficients, 5, 3)
    su, sv = (of_u @ nets @ of_v.T for of_u, of_v in ((slope_u, power_v), (power_u, slope_v)))
    values = np.cross(su, sv, axis=3)
    terms = to_u.reshape(-1, len(x)) @ values @ to_v.reshape(-1, len(y)).T
    terms = terms.reshape(n, nu, nv, 3, ways * parts[0], len(x), ways * parts[1], len(y))
    mean = terms[..., 0, :, 0].transpose(0, 1, 4, 2, 5, 3)
    unit, turn = _bound_directions(terms)
    quarters = (n, nu * parts[0], ways, nv * parts[1], ways)
    mean = mean.reshape(*quarters, 3).sum(axis=(2, 4))
    normal = mean / np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-300)
    off = np.linalg.norm(unit.reshape(*quarters, 3) - normal[:, :, None, :, None], axis=-1)
    turn = np.minimum((off + turn.reshape(quarters)).max(axis=(2, 4)), 2.0)
    return normal.reshape(n, -1, 3), turn.reshape(n, -1)


@njit_cached
def _bound_directions(terms: Array) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """Unit vectors along the first of terms (n, a, b, 3, i, k, j, l), and bounds of how far that of any sum with signs is off.

    Sums are those over k and l; the vectors are (n, a, i, b, j, 3), the bounds (n, a, i, b, j).
    """
    n, na, nb, _, ni, nk, nj, nl = terms.shape
    unit, turn = np.zeros((n, na, ni, nb, nj, 3)), np.full((n, na, ni, nb, nj), 2.0)
    for own in np.ndindex((n, na, ni, nb, nj)):
        m, a, i, b, j = own
        x, y, z = terms[m, a, b, 0, i, 0, j, 0], terms[m, a, b, 1, i, 0, j, 0], terms[m, a, b, 2, i, 0, j, 0]
        length = np.sqrt(x * x + y * y + z * z)
        scale = 1.0 / max(length, 1e-300)
        x, y, z = x * scale, y * scale, z * scale
        unit[m, a, i, b, j, 0], unit[m, a, i, b, j, 1], unit[m, a, i, b, j, 2] = x, y, z
        aside, others = 0.0, -length  # the first term itself adds its length
        for k in range(nk):
            for q in range(nl):
                p, r, t = terms[m, a, b, 0, i, k, j, q], terms[m, a, b, 1, i, k, j, q], terms[m, a, b, 2, i, k, j, q]
                ahead = p * x + r * y + t * z
                p, r, t = p - ahead * x, r - ahead * y, t - ahead * z
                aside += np.sqrt(p * p + r * r + t * t)
                others += abs(ahead)
        least = length - others
        if aside < least:
            turn[own] = aside / max(least, 1e-300)
    return unit, turn


@lru_cache(maxsize=32)
def _chebyshev_parts(count: int, n: int) -> tuple[Array, Array]:
    """Nodes (n,) on [-1, 1], and matrices (count, n, n) from values there to Chebyshev coefficients on equal parts."""
    x = np.asarray(chebyshev.chebpts1(n), np.float64)
    local = np.linalg.inv(chebyshev.chebvander(x, n - 1))
    middle = -1.0 + (2 * np.arange(count) + 1) / count
    within = chebyshev.chebvander(middle[:, None] + x / count, n - 1) @ local
    return x, np.asarray(local @ within, np.float64)


@lru_cache(maxsize=32)
def _part_powers(count: int, degree: int) -> tuple[Array, float, Array]:
    """Middles (count,) and half length of equal parts of [-1, 1], and matrices from monomials there to those of each part."""
    half = 1.0 / count
    middle = np.asarray(-1.0 + half * (2 * np.arange(count) + 1), np.float64)
    matrices = np.zeros((count, degree + 1, degree + 1))
    for k in range(degree + 1):
        for j in range(k + 1):
            matrices[:, j, k] = comb(k, j) * middle ** (k - j) * half**j
    return middle, half, matrices
