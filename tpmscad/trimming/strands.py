"""Where placed curves cross the planes of a tool, found once for each class of curves that see a plane from the same place.

A strand is an edge's piece of a curve: a side of a patch, or the curve cut on one by a plane. A vertex nearer than `snap` to a
plane counts as *on* it. Symbolically such a vertex is outside; strands that end there have no root within a few `snap` of it,
so that no edge is shorter than that. A strand that lies in a plane altogether has no sign there at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.patches.carriers import EdgeCurve
from tpmscad.splines.bspline import Curve, design
from tpmscad.trimming.levels import Levels
from tpmscad.trimming.tool import Array, Flags, Ints, TrimmingError

SAMPLES = 34
"""Samples along a strand: between them the distance from a plane is taken to have at most one extremum."""

SHORTEST = 3.0
"""Roots nearer than this many `snap` to a vertex on the plane are that vertex."""

FLAT = 0.05
"""Saddles, and strands that leave a vertex on the plane tangentially, lie in the plane within this part of the tolerance."""

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
    else p with the parameters root[root_start[p]:root_start[p + 1]], rising. `root_strand`, `root_surface`: of each root.
    `off`: how far strands in a plane are from it at most, (n,). `touch`, `touch_strand`, `touch_surface`: where strands come
    within `snap` of a surface and turn back.
    """

    sign: Ints
    pair: Ints
    root_start: Ints
    root: Array
    root_strand: Ints
    root_surface: Ints
    off: Array
    touch: Array
    touch_strand: Ints
    touch_surface: Ints
    n_classes: int

    def of(self, strand: int, plane: int) -> Array:
        """The roots of one strand on one plane, rising."""
        p = self.pair[strand, plane]
        return self.root[self.root_start[p] : self.root_start[p + 1]] if p >= 0 else np.zeros(0)


def points_on(curves: Sequence[EdgeCurve], strands: Strands, index: Ints, t: Array) -> Array:
    """Points at parameters t (m,) of the strands `index` (m,): (m, 3)."""
    local = np.empty((len(t), 3))
    owner = strands.curve[index]
    order = np.argsort(owner, kind="stable")
    cuts = np.flatnonzero(np.diff(owner[order])) + 1
    for at in np.split(order, cuts):
        if len(at):
            local[at] = curves[owner[at[0]]](t[at])
    return np.einsum("mij,mj->mi", strands.rotation[index], local) + strands.translation[index]


def cross(
    curves: Sequence[Curve], strands: Strands, levels: Levels, on: Flags, wanted: Flags, snap: float, flat: float
) -> Crossings:
    """All roots of strands on surfaces. `on` (V, K): vertices on surfaces; `wanted` (n, K): the pairs to look at.

    Nearer than `snap` a vertex is on a surface; the strand is taken to stay there as long as it is nearer than `flat`.
    """
    n, k = len(strands), len(levels)
    poles = {int(c): curves[c].poles for c in np.unique(strands.curve)}
    low = np.zeros((len(curves), 3))
    high = np.zeros((len(curves), 3))
    for c, p in poles.items():
        low[c], high[c] = p.min(axis=0), p.max(axis=0)
    middle, radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
    centre = np.einsum("nij,nj->ni", strands.rotation, middle[strands.curve]) + strands.translation
    distance = levels.distances(centre)
    sign = np.where(distance < 0, -1, 1)
    near = wanted & (np.abs(distance) <= radius[strands.curve][:, None] + snap)
    s, surface = np.nonzero(near)

    seen = levels.of(surface).framed(strands.rotation[s], strands.translation[s])
    ends_on = np.column_stack([on[strands.start[s], surface], on[strands.end[s], surface]])
    size = max(float(radius.max(initial=0.0)), snap)
    key = np.column_stack([strands.curve[s], strands.span[s], seen.key(size), ends_on])
    _, first, label = np.unique(key, axis=0, return_index=True, return_inverse=True)
    label = label.ravel()

    class_sign, class_off, roots, touches = _class_roots(
        curves, strands, s[first], seen.of(first), ends_on[first], snap, flat
    )

    sign[s, surface] = class_sign[label]
    off = np.zeros(n)
    np.maximum.at(off, s, class_off[label])
    count, touched = (np.array([len(r) for r in found], np.int64)[label] for found in (roots, touches))
    rooted = np.flatnonzero(count)
    pair = np.full((n, k), -1)
    pair[s[rooted], surface[rooted]] = np.arange(len(rooted))
    return Crossings(
        sign=sign,
        pair=pair,
        root_start=np.concatenate([[0], np.cumsum(count[rooted])]),
        root=np.concatenate([np.zeros(0), *(roots[label[p]] for p in rooted)]),
        root_strand=np.repeat(s[rooted], count[rooted]),
        root_surface=np.repeat(surface[rooted], count[rooted]),
        off=off,
        touch=np.concatenate([np.zeros(0), *(touches[label[p]] for p in np.flatnonzero(touched))]),
        touch_strand=np.repeat(s, touched),
        touch_surface=np.repeat(surface, touched),
        n_classes=len(first),
    )


def _class_roots(
    curves: Sequence[Curve], strands: Strands, strand: Ints, levels: Levels, ends_on: Flags, snap: float, flat: float
) -> tuple[Ints, Array, list[Array], list[Array]]:
    """First sign, distance where it lies in the surface, roots and touches of n classes, by one of each; batched by spline
    space."""
    n = len(strand)
    sign, off, roots, touches = np.zeros(n, np.int64), np.zeros(n), [np.zeros(0)] * n, [np.zeros(0)] * n
    spaces: dict[tuple[int, bytes, bool], list[int]] = {}
    for i, (c, is_plane) in enumerate(zip(strands.curve[strand].tolist(), levels.flat.tolist(), strict=True)):
        spaces.setdefault((curves[c].degree, curves[c].knots.tobytes(), is_plane), []).append(i)
    for members in spaces.values():
        at = np.array(members)
        curve = curves[strands.curve[strand[at[0]]]]
        poles = np.stack([curves[c].poles for c in strands.curve[strand[at]]])
        along = _Along(curve.knots, curve.degree, poles, levels.of(at))
        found = _on_curves(along, strands.span[strand[at]], ends_on[at], snap, flat)
        sign[at], off[at] = found[:2]
        for i, r, t in zip(members, *found[2:], strict=True):
            roots[i], touches[i] = r, t
    return sign, off, roots, touches


class _Along:
    """The distances from m surfaces along m curves (m, N, 3) of one spline space: all planes, or none of them."""

    def __init__(self, knots: Array, degree: int, poles: Array, levels: Levels) -> None:
        self.knots, self.degree, self.poles, self.levels = knots, degree, poles, levels
        self.coefficients = None
        if levels.flat.all():
            self.coefficients = np.einsum("mnk,mk->mn", poles, levels.axis) + levels.a[:, None]

    def __call__(self, row: Ints, t: Array, order: int = 0) -> Array:
        """Values or derivatives on curve row[i] at t[i]: (r,)."""
        basis = [design(self.knots, self.degree, t, k) for k in range(order + 1)]
        if self.coefficients is not None:
            return np.einsum("rn,rn->r", basis[order], self.coefficients[row])
        points = [np.einsum("rn,rnk->rk", b, self.poles[row]) for b in basis]
        jet = [j[:, 0] for j in self.levels.of(row).jet(points[0][:, None], order)]
        if order == 0:
            return jet[0]
        value = np.einsum("rk,rk->r", jet[1], points[order])
        return value if order == 1 else value + np.einsum("ri,rij,rj->r", points[1], jet[2], points[1])


def _on_curves(
    along: _Along, span: Array, ends_on: Flags, snap: float, flat: float
) -> tuple[Ints, Array, list[Array], list[Array]]:
    """First sign, distance where it lies in the surface, roots and touches of m surfaces, each on its own curve."""
    f, poles = along, along.poles
    m = len(poles)
    size = np.linalg.norm(np.ptp(poles, axis=1), axis=1)
    ends = np.einsum("men,mnk->mek", design(f.knots, f.degree, span.ravel(), 1).reshape(m, 2, -1), poles)
    speed = np.maximum(np.linalg.norm(ends, axis=2), 1e-3 * (size / (span[:, 1] - span[:, 0]))[:, None])
    step = SHORTEST * snap / speed * ends_on  # no root is looked for there: no edge comes out shorter
    low, high = span[:, 0] + step[:, 0], span[:, 1] - step[:, 1]
    t = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, SAMPLES)
    row = np.repeat(np.arange(m), SAMPLES)
    value, slope = (f(row, t.ravel(), order).reshape(m, SAMPLES) for order in (0, 1))
    reach = np.abs(value).max(axis=1)
    within = (reach < snap) & ends_on.all(axis=1)

    owner, root, touching, touch = _roots(f, t, value, slope, NOISE * size, snap)
    keep = ~within[owner]
    for i in np.flatnonzero(ends_on[owner].any(axis=1) & keep):
        for end, stop in ((0, low[owner[i]]), (1, high[owner[i]])):
            if ends_on[owner[i], end]:
                between = np.linspace(root[i], stop, 9)[1:-1]
                keep[i] &= bool((np.abs(f(np.full(7, owner[i]), between)) > flat).any())
    owner, root = owner[keep], root[keep]
    roots = np.split(root, np.searchsorted(owner, np.arange(1, m)))
    first = high.copy()  # the sign before the first root is the sign half way to it
    first[owner[::-1]] = root[::-1]
    sign = np.sign(f(np.arange(m), 0.5 * (low + first)))
    rootless = np.array([len(r) == 0 for r in roots])
    strongest = value[np.arange(m), np.abs(value).argmax(axis=1)]
    sign = np.where(np.where(rootless, strongest, sign) > 0, 1, -1)
    sign[within] = 0
    away = ~within[touching]
    touches = np.split(touch[away], np.searchsorted(touching[away], np.arange(1, m)))
    return sign, np.where(within, reach, 0.0), roots, touches


def _roots(
    f: Callable[..., Array], t: Array, value: Array, slope: Array, noise: Array, snap: float
) -> tuple[Ints, Array, Ints, Array]:
    """Simple roots of n functions sampled at t (n, SAMPLES), as (row, parameter) in order, pairs between samples included; and
    the extrema between samples that are nearer to zero than `snap`, alike."""
    a, b = value[:, :-1], value[:, 1:]
    step = np.diff(t, axis=1)
    turning = (a * b > 0) & (a * slope[:, :-1] < 0) & (b * slope[:, 1:] > 0)
    turning &= np.minimum(np.abs(a), np.abs(b)) < np.abs(np.diff(slope, axis=1)) * step  # else too far to reach zero
    row, i = np.nonzero(turning)
    low, high = t[row, i], t[row, i + 1]
    top = bracketed_newton(lambda x: f(row, x, 1), lambda x: f(row, x, 2), low, high)
    at_top = f(row, top)
    crosses = (at_top * value[row, i] < 0) & (np.abs(at_top) > noise[row])
    change, j = np.nonzero((a < 0) != (b < 0))
    owner = np.concatenate([change, row[crosses], row[crosses]])
    low = np.concatenate([t[change, j], low[crosses], top[crosses]])
    high = np.concatenate([t[change, j + 1], top[crosses], high[crosses]])
    root = bracketed_newton(lambda x: f(owner, x), lambda x: f(owner, x, 1), low, high)
    order = np.lexsort((root, owner))
    touches = np.abs(at_top) < snap
    return owner[order], root[order], row[touches], top[touches]


def bracketed_newton(
    f: Callable[[Array], Array], slope: Callable[[Array], Array], low: Array, high: Array, iterations: int = 100
) -> Array:
    """The roots of f in n brackets with a change of sign each, by Newton steps that fall back on bisection."""
    if len(low) == 0:
        return np.zeros(0)
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
