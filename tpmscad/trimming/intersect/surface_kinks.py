"""Where intersection curves are divided: lines of a free-form surface across which it is no smoother than C2, and its seams.

Across such a line the second or third derivative of an intersection curve jumps, so that no fit across it comes near the
tolerance. A seam is an edge of the body as well, so that the point has to lie on it to round-off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.trimming.intersect.patch_distances import PatchDistances

MAX_KINK_CONTINUITY = 2
"""Continuity of a surface across a knot line up to which intersection curves are divided there."""

KINK_STEPS = 12
"""Most steps of false position to such a line."""

KINK_RTOL = 1e-11
"""Distance from the line, in steps of the path, at which the iteration ends."""


@dataclass(frozen=True, slots=True, eq=False)
class CoarseBranch:
    """A path (n, 2) on the patch of a pair, and where it may be divided at lines that are no seams.

    `clear` (n,): points away from the borders of faces, since an edge of the body is there, and short edges would result.
    `clearance`: least distance of such a division from the ends of the path, in model units.
    """

    pair: int
    path: Array
    clear: BoolArray
    clearance: float


@dataclass(frozen=True, slots=True, eq=False)
class _Crossings:
    """Steps of paths that cross lines, all (k,).

    Branch, step and pair, then of the line its parameter, value and period and whether it is a seam, and the distances of the
    step's ends from it.
    """

    branch: IntArray
    step: IntArray
    pair: IntArray
    axis: IntArray
    line: Array
    period: Array
    is_seam: BoolArray
    before: Array
    after: Array


def insert_kinks(distances: PatchDistances, branches: Sequence[CoarseBranch]) -> list[tuple[Array, IntArray]]:
    """The paths with points inserted where they cross such lines, and the numbers (k,) of these points, for each branch."""
    crossings = _find_crossings(distances, branches)
    result: list[tuple[Array, IntArray]] = [(b.path, np.zeros(0, np.int64)) for b in branches]
    if not len(crossings.branch):
        return result
    at = _locate_crossings(distances, branches, crossings)
    own = [branches[b] for b in crossings.branch.tolist()]
    place = distances.jet(crossings.pair, at)[0]
    apart = np.min(
        [
            np.linalg.norm(distances.jet(crossings.pair, np.array([b.path[k] for b in own]))[0] - place, axis=1)
            for k in (0, -1)
        ],
        axis=0,
    )
    kept = apart > np.where(crossings.is_seam, 0.0, np.array([b.clearance for b in own]))
    for number in np.unique(crossings.branch[kept]).tolist():
        rows = np.flatnonzero(kept & (crossings.branch == number))
        rows = rows[np.argsort(crossings.step[rows], kind="stable")]
        before = crossings.step[rows] + 1
        path = np.insert(branches[number].path, before, at[rows], axis=0)
        result[number] = path, before + np.arange(len(rows))
    return result


def _find_crossings(distances: PatchDistances, branches: Sequence[CoarseBranch]) -> _Crossings:
    """The steps of the paths at which the foot crosses a line."""
    placed = distances.implicit.placed
    assert placed is not None
    columns: list[tuple[int, int, int, int, float, float, bool, float, float]] = []
    feet = _find_feet(
        distances,
        np.repeat([b.pair for b in branches], [len(b.path) for b in branches]).astype(np.int64),
        np.vstack([np.zeros((0, 2)), *(b.path for b in branches)]),
    )
    first = np.cumsum([0, *(len(b.path) for b in branches)])
    for number, branch in enumerate(branches):
        own = feet[first[number] : first[number + 1]]
        form = placed.forms[int(placed.number[branch.pair])]
        if not isinstance(form, FreeFormSurface):
            continue
        for axis, lines, is_seam in _list_lines(form):
            period = form.period[axis]
            off = _measure_offset(own[:, axis, None], lines, period)
            near = np.abs(off) < 0.25 * period if period else np.ones(off.shape, bool)
            crossed = ((off[1:] < 0) != (off[:-1] < 0)) & near[1:] & near[:-1]
            crossed &= is_seam | (branch.clear[1:] & branch.clear[:-1])[:, None]
            columns += [
                (
                    number,
                    i,
                    branch.pair,
                    axis,
                    float(lines[k]),
                    period,
                    bool(is_seam[k]),
                    float(off[i, k]),
                    float(off[i + 1, k]),
                )
                for k, i in np.argwhere(crossed.T).tolist()
            ]
    kinds = (np.int64, np.int64, np.int64, np.int64, float, float, bool, float, float)
    arrays = (np.array([c[k] for c in columns], kind) for k, kind in enumerate(kinds))
    return _Crossings(*arrays)


@lru_cache(maxsize=256)
def _list_lines(form: FreeFormSurface) -> list[tuple[int, Array, BoolArray]]:
    """The lines of a surface at which curves bend: for each parameter its number, the values (k,), and which are seams (k,)."""
    found = []
    for axis, values in enumerate(form.knot_lines(MAX_KINK_CONTINUITY)):
        seams = form.domain[axis][:1] if form.bends_at_seam(axis, MAX_KINK_CONTINUITY + 1) else ()
        lines = np.array([*values.tolist(), *seams])
        if len(lines):
            found.append((axis, lines, np.arange(len(lines)) >= len(values)))
    return found


def _locate_crossings(distances: PatchDistances, branches: Sequence[CoarseBranch], crossings: _Crossings) -> Array:
    """The zeros (k, 2) on the lines, by false position along the steps."""
    a, b = (
        np.array(
            [branches[n].path[i + k] for n, i in zip(crossings.branch.tolist(), crossings.step.tolist(), strict=True)]
        )
        for k in (0, 1)
    )
    f, g = crossings.before.copy(), crossings.after.copy()
    scale, found = np.abs(f - g), np.empty_like(a)
    left = np.arange(len(a))
    for _ in range(KINK_STEPS):
        part = (f[left] / (f[left] - g[left]))[:, None]
        found[left] = distances.project_to_zero(crossings.pair[left], a[left] + (b[left] - a[left]) * part)
        left = left[np.isfinite(found[left]).all(axis=1)]
        foot = _find_feet(distances, crossings.pair[left], found[left])[np.arange(len(left)), crossings.axis[left]]
        h = _measure_offset(foot, crossings.line[left], crossings.period[left])
        apart = np.abs(h) > KINK_RTOL * scale[left]
        left, h = left[apart], h[apart]
        if not len(left):
            break
        low = (h < 0) == (f[left] < 0)
        a[left[low]], f[left[low]] = found[left[low]], h[low]
        b[left[~low]], g[left[~low]] = found[left[~low]], h[~low]
    return found


def _measure_offset(foot: Array, line: Array | float, period: Array | float) -> Array:
    """Parameters of feet less those of lines, to within half a period; periods of 0 are none."""
    off = np.asarray(foot - line)
    period = np.broadcast_to(period, off.shape)
    return np.where(period > 0, off - period * np.round(off / np.where(period > 0, period, 1.0)), off)


def _find_feet(distances: PatchDistances, pair: IntArray, at: Array) -> Array:
    """Parameters (m, 2), on the surfaces of the pairs `pair` (m,), of the feet of points `at` (m, 2) of the patches."""
    placed = distances.implicit.placed
    assert placed is not None
    points = placed.place[pair].apply(distances.jet(pair, at)[0])
    found = np.full((len(pair), 2), np.nan)
    for number in np.unique(placed.number[pair]).tolist():
        form, rows = placed.forms[number], np.flatnonzero(placed.number[pair] == number)
        if isinstance(form, FreeFormSurface):
            found[rows] = form.parameters(points[rows])
    return found
