"""How good a layout's polygons would be after changes that start from its triangles and from sides on the box.

Corners where a change leaves only two polygons are taken out with it: which polygons come of that, and whether all that a change
leaves is a surface, is known when it is made. Here polygons at such corners are left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad.patches.levelset.layout.changes import Start
from tpmscad.patches.levelset.layout.fans import MOST
from tpmscad.patches.levelset.layout.merged import Surface
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask
from tpmscad.patches.levelset.layout.shape import badness
from tpmscad.patches.levelset.layout.stars import Stars, most


def rated_starts(stars: Stars, surface: Surface, starts: Sequence[Start]) -> tuple[Array, Ints]:
    """How bad the worst polygon becomes, infinite where it goes with others than are to, and the patches saved: (n,) each."""
    count, vertices, number = len(starts), len(surface.vertices), len(stars.rows)
    of = np.repeat(np.arange(count), [len(start.into) for start in starts])
    goes, stays = np.array([pair for start in starts for pair in start.into], np.int64).reshape(-1, 2).T
    gone_of = np.repeat(np.arange(count), [len(start.gone) for start in starts])
    gone = np.array([polygon for start in starts for polygon in start.gone], np.int64)

    owner, polygon, _ = stars.around(np.concatenate([goes, stays]))
    left = np.setdiff1d(np.concatenate([of, of])[owner] * number + polygon, gone_of * number + gone)
    by, polygon = np.divmod(left, number)
    merged = vertices + np.concatenate([np.arange(len(of))] * 2)
    before = stars.rows[polygon]
    rows, whole = _shrunk(
        _renamed(before, by, np.concatenate([of * vertices + goes, of * vertices + stays]), merged, vertices)
    )
    joints, joint_of = _joined(stars, starts)
    rows, by = np.concatenate([rows, joints]), np.concatenate([by, joint_of])
    whole = np.concatenate([whole, np.ones(len(joints), bool)])

    # corners of polygons that go, or of triangles joined, where two are left inside
    corner_of, corner = np.repeat(gone_of, 4), stars.rows[gone].ravel()
    key, less = np.unique(corner_of[corner >= 0] * vertices + corner[corner >= 0], return_counts=True)
    key_of, corner = np.divmod(key, vertices)
    lone = np.isin(key, np.repeat(joint_of, 4) * vertices + joints.ravel())
    two = (stars.count[corner] - less + lone == 2) & ~surface.fixed[corner].any(axis=1)
    two &= ~np.isin(key, np.concatenate([of * vertices + goes, of * vertices + stays]))
    odd = key[two]
    own = (rows >= 0) & (rows < vertices)
    fine = whole & ~(own & np.isin(by[:, None] * vertices + rows, odd)).any(axis=1)

    there = surface.with_merged(goes, stays)
    bad = most(badness(there.vertices, there.normals, there.fixed, rows[fine]), by[fine], count)
    bad[by[~whole]] = np.inf
    round_each = np.bincount(rows[rows >= vertices] - vertices, minlength=len(of))
    twos = np.bincount(key_of[two], minlength=count)
    bad[of[round_each > MOST + twos[of]]] = np.inf
    saved = np.bincount(gone_of, _patches(stars.rows[gone]), count) + twos - np.bincount(by, _patches(rows), count)
    saved += np.bincount(by[: len(before)], _patches(before), count)
    bad[saved <= 0] = np.inf
    return bad, saved.astype(np.int64)


def _patches(rows: Ints) -> Ints:
    return np.where(rows[:, 3] < 0, 3, 1)


def _renamed(rows: Ints, by: Ints, keys: Ints, names: Ints, vertices: int) -> Ints:
    """Polygons (m, 4) of changes `by`, with the vertices that have a key there under their new names."""
    order = np.argsort(keys, kind="stable")
    keys, names = keys[order], names[order]
    wanted = np.where(rows >= 0, by[:, None] * vertices + rows, -1)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, names[at], rows) if len(keys) else rows


def _shrunk(rows: Ints) -> tuple[Ints, Mask]:
    """Quadrilaterals with a side of no length made triangles; and which polygons have three corners or more, all different."""
    rows = rows.copy()
    same = rows == np.roll(rows, -1, axis=1)
    short = np.flatnonzero((rows[:, 3] >= 0) & (same.sum(axis=1) == 1))
    turn = (same[short].argmax(axis=1)[:, None] + np.arange(1, 5)) % 4
    rows[short] = np.take_along_axis(rows[short], turn, axis=1)
    rows[short, 3] = -1
    a, b, c, d = rows.T
    return rows, (a != b) & (b != c) & (c != a) & (a != d) & (b != d) & (c != d)


def _joined(stars: Stars, starts: Sequence[Start]) -> tuple[Ints, Ints]:
    """The quadrilaterals (j, 4) of two triangles without the side between them, and of which start they are."""
    of = np.array([i for i, start in enumerate(starts) if not start.into], np.int64)
    gone = np.array([starts[i].gone for i in of.tolist()], np.int64).reshape(-1, 2)
    a, b = np.array([starts[i].joint for i in of.tolist()], np.int64).reshape(-1, 2).T
    far = stars.rows[gone][..., :3]
    c, d = (far.sum(axis=2) - (a + b)[:, None]).T
    return np.stack([a, d, b, c], axis=1), of
