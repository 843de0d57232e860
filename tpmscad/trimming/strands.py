"""Where placed curves cross the planes of a tool, found once for each class of curves that see a plane from the same place.

A strand is an edge's piece of a curve: a side of a patch, or the curve cut on one by a plane. A vertex nearer than `snap` to a
plane counts as *on* it. Symbolically such a vertex is outside; strands that end there have no root within a few `snap` of it,
so that no edge is shorter than that. A strand that lies in a plane altogether has no sign there at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.splines.bspline import Curve
from tpmscad.trimming.tool import Array, Ints, Tool, TrimmingError

SAMPLES = 34
"""Samples along a strand: between them the distance from a plane is taken to have at most one extremum."""

SHORTEST = 3.0
"""Roots nearer than this many `snap` to a vertex on the plane are that vertex."""

NOISE = 1e-13
"""An extremum nearer to a plane than this part of the strand's size touches it: round-off is a hundred times smaller."""


@dataclass(frozen=True, slots=True, eq=False)
class Strands:
    """n curve pieces: curve index, motion, parameter span (n, 2), start and end vertex."""

    curve: Ints
    rotation: Array
    translation: Array
    span: Array
    start: Ints
    end: Ints

    def __len__(self) -> int:
        return len(self.curve)


@dataclass(frozen=True, slots=True, eq=False)
class Crossings:
    """What n strands and K planes have in common.

    `sign` (n, K): -1 or +1 at the strand's beginning, 0 where the strand lies in the plane. `pair` (n, K): -1 without roots,
    else p with the parameters root[root_start[p]:root_start[p + 1]], rising. `root_strand`, `root_plane`: of each root.
    `off`: how far strands in a plane are from it at most, (n,).
    """

    sign: Ints
    pair: Ints
    root_start: Ints
    root: Array
    root_strand: Ints
    root_plane: Ints
    off: Array
    n_classes: int

    def of(self, strand: int, plane: int) -> Array:
        """The roots of one strand on one plane, rising."""
        p = self.pair[strand, plane]
        return self.root[self.root_start[p] : self.root_start[p + 1]] if p >= 0 else np.zeros(0)


def points_on(curves: Sequence[Curve], strands: Strands, index: Ints, t: Array) -> Array:
    """Points at parameters t (m,) of the strands `index` (m,): (m, 3)."""
    local = np.empty((len(t), 3))
    owner = strands.curve[index]
    order = np.argsort(owner, kind="stable")
    cuts = np.flatnonzero(np.diff(owner[order])) + 1
    for at in np.split(order, cuts):
        if len(at):
            local[at] = curves[owner[at[0]]](t[at])
    return np.einsum("mij,mj->mi", strands.rotation[index], local) + strands.translation[index]


def cross(curves: Sequence[Curve], strands: Strands, tool: Tool, on: Array, skip: Array, snap: float) -> Crossings:
    """All roots of strands on planes. `on` (V, K): vertices on planes; `skip` (n, K): pairs to leave alone (sign 0)."""
    n, k = len(strands), len(tool.planes)
    poles = {int(c): curves[c].poles for c in np.unique(strands.curve)}
    low = np.zeros((len(curves), 3))
    high = np.zeros((len(curves), 3))
    for c, p in poles.items():
        low[c], high[c] = p.min(axis=0), p.max(axis=0)
    middle, radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
    centre = np.einsum("nij,nj->ni", strands.rotation, middle[strands.curve]) + strands.translation
    distance = tool.distances(centre)
    sign = np.where(distance < 0, -1, 1)
    near = (np.abs(distance) <= radius[strands.curve][:, None] + snap) & ~skip
    sign[skip] = 0
    s, plane = np.nonzero(near)

    normal = np.einsum("pi,pij->pj", tool.normals[plane], strands.rotation[s])
    constant = np.einsum("pi,pi->p", tool.normals[plane], strands.translation[s]) - tool.heights[plane]
    ends_on = np.column_stack([on[strands.start[s], plane], on[strands.end[s], plane]])
    size = max(float(radius.max(initial=0.0)), snap)
    key = np.column_stack(
        [strands.curve[s], strands.span[s], np.round(normal, 9), np.round(constant / size, 10), ends_on]
    )
    _, first, label = np.unique(key + 0.0, axis=0, return_index=True, return_inverse=True)
    label = label.ravel()

    class_sign = np.zeros(len(first), np.int64)
    class_off = np.zeros(len(first))
    roots: list[Array] = [np.zeros(0)] * len(first)
    owner = np.column_stack([strands.curve[s[first]], strands.span[s[first]]])
    groups, group = np.unique(owner, axis=0, return_inverse=True)
    for g, (c, t0, t1) in enumerate(groups):
        members = np.flatnonzero(group.ravel() == g)
        of = first[members]
        found = _on_curve(curves[int(c)], (t0, t1), normal[of], constant[of], ends_on[of], snap)
        for m, (m_sign, m_roots, m_off) in zip(members, found, strict=True):
            class_sign[m], roots[m], class_off[m] = m_sign, m_roots, m_off

    sign[s, plane] = class_sign[label]
    off = np.zeros(n)
    np.maximum.at(off, s, class_off[label])
    count = np.array([len(r) for r in roots], np.int64)[label]
    rooted = np.flatnonzero(count)
    pair = np.full((n, k), -1)
    pair[s[rooted], plane[rooted]] = np.arange(len(rooted))
    flat = np.concatenate([np.zeros(0), *(roots[label[p]] for p in rooted)])
    return Crossings(
        sign=sign,
        pair=pair,
        root_start=np.concatenate([[0], np.cumsum(count[rooted])]),
        root=flat,
        root_strand=np.repeat(s[rooted], count[rooted]),
        root_plane=np.repeat(plane[rooted], count[rooted]),
        off=off,
        n_classes=len(first),
    )


def _on_curve(
    curve: Curve, span: tuple[float, float], normal: Array, constant: Array, ends_on: Array, snap: float
) -> list[tuple[int, Array, float]]:
    """(first sign, roots, greatest distance if it lies in the plane) of m planes on one curve piece."""
    a, b = span
    t = np.linspace(a, b, SAMPLES)
    value = curve(t) @ normal.T + constant  # (SAMPLES, m)
    size = float(np.linalg.norm(np.ptp(curve.poles, axis=0)))
    reach = np.abs(value).max(axis=0)
    speed = np.maximum(np.linalg.norm(curve(np.array([a, b]), 1), axis=1), size / (b - a) * 1e-3)
    step = SHORTEST * snap / speed  # an edge shorter than `SHORTEST` snaps isn't made
    result = []
    for m in range(len(normal)):
        if reach[m] < snap and ends_on[m].all():
            result.append((0, np.zeros(0), float(reach[m])))
            continue
        lo, hi = a + step[0] * ends_on[m, 0], b - step[1] * ends_on[m, 1]
        sites = np.concatenate([[lo], t[(t > lo) & (t < hi)], [hi]])

        def f(x: Array, order: int = 0, m: int = m) -> Array:
            return curve(x, order) @ normal[m] + (constant[m] if order == 0 else 0.0)

        roots = roots_between(f, sites, NOISE * size)
        middle = 0.5 * (lo + (roots[0] if len(roots) else hi))
        g = f(np.concatenate([[middle], sites]))
        first = g[0] if len(roots) else g[np.argmax(np.abs(g))]
        result.append((1 if first > 0 else -1, roots, 0.0))
    return result


def roots_between(f: Callable[..., Array], sites: Array, noise: float) -> Array:
    """Simple roots of f(t, order=0) within [sites[0], sites[-1]], rising, pairs between two sites included."""
    g, slope = f(sites), f(sites, 1)
    turning = (g[:-1] * g[1:] > 0) & (g[:-1] * slope[:-1] < 0) & (g[1:] * slope[1:] > 0)
    turning &= np.abs(g[:-1]) < np.abs(slope[:-1]) * np.diff(sites)  # else the tangent doesn't reach zero
    turning |= (
        (g[:-1] * g[1:] > 0)
        & (g[:-1] * slope[:-1] < 0)
        & (g[1:] * slope[1:] > 0)
        & (np.minimum(np.abs(g[:-1]), np.abs(g[1:])) < np.abs(np.diff(slope)) * np.diff(sites))
    )
    if turning.any():
        i = np.flatnonzero(turning)
        extremum = bracketed_newton(lambda t: f(t, 1), lambda t: f(t, 2), sites[i], sites[i + 1])
        value = f(extremum)
        crosses = (value * g[i] < 0) & (np.abs(value) > noise)
        if crosses.any():
            sites = np.sort(np.concatenate([sites, extremum[crosses]]))
            g = f(sites)
    change = np.flatnonzero((g[:-1] < 0) != (g[1:] < 0))
    if len(change) == 0:
        return np.zeros(0)
    return bracketed_newton(f, lambda t: f(t, 1), sites[change], sites[change + 1])


def bracketed_newton(
    f: Callable[[Array], Array], slope: Callable[[Array], Array], low: Array, high: Array, iterations: int = 100
) -> Array:
    """The roots of f in n brackets with a change of sign each, by Newton steps that fall back on bisection."""
    low, high = low.astype(float), high.astype(float)
    rising = f(low) < 0
    t = 0.5 * (low + high)
    for _ in range(iterations):
        g, d = f(t), slope(t)
        below = (g < 0) == rising
        low, high = np.where(below, t, low), np.where(below, high, t)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = t - g / d
        good = (step > low) & (step < high)
        new = np.where(good, step, 0.5 * (low + high))
        new = np.where(g == 0, t, new)
        if (np.abs(new - t) <= 4e-16 * np.maximum(1.0, np.abs(t))).all():
            return new
        t = new
    raise TrimmingError(f"a root between {low[0]} and {high[0]} did not converge in {iterations} steps")
