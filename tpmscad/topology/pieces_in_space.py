"""Pieces of a periodic solid in all of space, at every level at once, from samples of one period.

The components of {f <= c} in one period are not those in space: a component whose paths through the period lead by no translation
back to it is a ball that repeats, and one whose paths lead by the even translations only is a part of several networks that
interpenetrate. If L is the lattice of the translations along the closed paths of a component, its copies in space are as many as
L has cosets among the translations Z^3 by whole periods: |det L|, or without end where L spans no volume.

One sweep over the samples in ascending order unites them in a union-find forest, whose elements hold their translation from
their root. A translation that closes a path is added to the lattice of its component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import SampleConnectivity, Samples
from tpmscad.errors import InvalidRequest
from tpmscad.topology.voxels import CONNECTIVITY, Labels, as_sample_array

ENDLESS = 0
"""Number of pieces in place of infinity: some piece does not reach through space along all directions."""

LEAST_SAMPLES = 4
"""Along each axis: with fewer, the neighbours of a sample on both sides are the same."""


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicPieces:
    """Numbers of pieces of {f <= c} in space: `counts[k]` from `levels[k]` on, up to `levels[k + 1]`.

    Below the first level there is no piece. A count of `ENDLESS` (0) stands for infinitely many, such as separate balls.
    """

    levels: Array
    counts: IntArray

    def count_at(self, level: float) -> int | None:
        """The number of pieces at a level; None where there is no solid."""
        at = int(np.searchsorted(self.levels, level, side="right")) - 1
        return None if at < 0 else int(self.counts[at])

    @property
    def one_piece_levels(self) -> Array:
        """Ranges of levels (n, 2), ascending, in which the solid is one piece; the last one may end at infinity."""
        ends = np.append(self.levels[1:], np.inf)
        one = self.counts == 1
        return np.stack([self.levels[one], ends[one]], axis=1)


@validate_call()
def periodic_pieces(values: Samples, convention: SampleConnectivity = "strict") -> PeriodicPieces:
    """Count the pieces of the periodic solid {f <= c} in space, for every level c.

    The samples are those of one period without its end: sample n along an axis would be sample 0 again.

    Returns
    -------
    PeriodicPieces
        Levels at which the number of pieces changes, and the numbers.

    Raises
    ------
    InvalidRequest
        If there are fewer than four samples along an axis.

    Notes
    -----
    With 26 neighbours ("top_cells") samples join at too low a level, with 6 ("strict") at too high a one, by the change of f
    between them: both together bracket the levels.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import topology
    >>> x, y, z = np.meshgrid(*[2 * np.pi * np.arange(16) / 16] * 3, indexing="ij")
    >>> found = topology.periodic_pieces(np.cos(x) + np.cos(y) + np.cos(z))  # balls that join at -1
    >>> found.count_at(-2.0), found.count_at(0.0)
    (0, 1)
    """
    samples = as_sample_array(values)
    if min(samples.shape) < LEAST_SAMPLES:
        raise InvalidRequest(
            f"{' x '.join(map(str, samples.shape))} samples are too few: at least {LEAST_SAMPLES} along each axis"
        )
    order = np.argsort(samples, axis=None, kind="stable").astype(np.int32)
    steps = np.indices((3, 3, 3)).reshape(3, -1).T - 1
    reach = np.abs(steps).sum(axis=1)
    steps = steps[(reach > 0) & (reach <= (1 if CONNECTIVITY[convention][0] == 6 else 3))].astype(np.int64)
    ranked, counts = _sweep(order, np.array(samples.shape, np.int64), steps)
    levels = samples.reshape(-1)[ranked]
    last = np.append(np.flatnonzero(np.diff(levels)), len(levels) - 1)  # of equal samples the last one decides
    levels, counts = levels[last], counts[last]
    kept = np.append(True, np.diff(counts) != 0)
    return PeriodicPieces(levels[kept], counts[kept])


@njit_cached
def _find(parent: Labels, shift: Labels, element: int) -> int:
    """Root of an element, with path compression; `shift` (n, 3) of the element becomes its translation from the root."""
    root, x, y, z = element, 0, 0, 0
    while parent[root] != root:
        x, y, z = x + shift[root, 0], y + shift[root, 1], z + shift[root, 2]
        root = parent[root]
    at = element
    while at != root:
        following = parent[at]
        dx, dy, dz = shift[at, 0], shift[at, 1], shift[at, 2]
        shift[at, 0], shift[at, 1], shift[at, 2] = x, y, z
        x, y, z = x - dx, y - dy, z - dz
        parent[at] = root
        at = following
    return root


@njit_cached
def _add_translation(lattice: Labels, d: Labels) -> bool:
    """Add a translation to a lattice (3, 3) in echelon form, by Euclid's algorithm; whether it was new. Overwrites d."""
    changed = False
    for k in range(3):
        while d[k] != 0:
            if lattice[k, k] == 0:
                lattice[k] = d
                return True
            d -= (d[k] // lattice[k, k]) * lattice[k]
            if d[k] != 0:  # the remainder is smaller: it takes the row
                for c in range(3):
                    lattice[k, c], d[c] = d[c], lattice[k, c]
                changed = True
    return changed


@njit_cached
def _index(lattice: Labels) -> int:
    """Number of copies of a component in space, 0 for infinity."""
    return abs(lattice[0, 0] * lattice[1, 1] * lattice[2, 2])


@njit_cached
def _sweep(order: Labels, shape: IntArray, steps: IntArray) -> tuple[Labels, IntArray]:
    """Flat indices of the samples after which the number of pieces differs from that before, and the numbers."""
    n = len(order)
    nx, ny, nz = shape
    parent = np.full(n, -1, np.int32)
    shift = np.zeros((n, 3), np.int32)
    lattices = np.zeros((n, 3, 3), np.int32)  # those of roots are in use
    finite, endless = 0, 0  # pieces of components that span space; components that do not
    ranked, counts = np.empty(n, np.int32), np.empty(n, np.int64)
    found, last = 0, -1
    d = np.zeros(3, np.int32)
    for v in order:
        parent[v] = v
        endless += 1
        x, y, z = v // (ny * nz), (v // nz) % ny, v % nz
        for step in steps:
            i, j, k = x + step[0], y + step[1], z + step[2]
            u = ((i % nx) * ny + j % ny) * nz + k % nz
            if parent[u] < 0:
                continue
            a, b = _find(parent, shift, v), _find(parent, shift, u)
            # v in period shift[v] is joined to a in period 0, u in period shift[u] to b
            d[0] = shift[v, 0] - shift[u, 0] + i // nx
            d[1] = shift[v, 1] - shift[u, 1] + j // ny
            d[2] = shift[v, 2] - shift[u, 2] + k // nz
            before = _index(lattices[a])
            if a == b:
                if (d[0] != 0 or d[1] != 0 or d[2] != 0) and _add_translation(lattices[a], d):
                    after = _index(lattices[a])
                    endless += (after == 0) - (before == 0)
                    finite += after - before
                continue
            other = _index(lattices[b])
            endless -= (before == 0) + (other == 0)
            finite -= before + other
            parent[b] = a
            shift[b] = d
            for row in range(3):
                _add_translation(lattices[a], lattices[b, row])
            after = _index(lattices[a])
            endless += after == 0
            finite += after
        count = ENDLESS if endless > 0 else finite
        if count != last:
            ranked[found], counts[found] = v, count
            found, last = found + 1, count
    return ranked[:found], counts[:found]
