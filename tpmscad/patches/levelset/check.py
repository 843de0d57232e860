"""What a fit of a level set is worth, measured on it: distances along the field's gradient, normals and joints of every patch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.bezier import bezier, tensor
from tpmscad.patches.levelset.fit import NetFit
from tpmscad.patches.levelset.inside import Inside
from tpmscad.patches.levelset.layout.net import Net
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask
from tpmscad.patches.levelset.work import PIECE, Work, here

SAMPLES = 13
"""Samples along each parameter of a patch, borders included."""

HALF = 17
"""Samples along half a side: joints are measured half by half, so that a side meets the two beyond a T-vertex."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Patches sampled: greatest and mean square distance (Q,), least cosine of the normal with the gradient (Q,), where the
    distance is greatest (Q, 3), and along their sides normals and curvature tensors: those of patch q are normals[row[q]], of
    (R, 4, m, 3), and bends[row[q]], of (R, 4, m, 3, 3); copies share theirs.
    """

    distance: Array
    square: Array
    cosine: Array
    where: Array
    row: Ints
    normals: Array
    bends: Array


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What each patch is worth, and per half side (n,) of the net's curves, `half` of them being twice the curve and 0 or 1,
    rising: tangent jump in degrees, curvature jump and greatest curvature.
    """

    of: Sampled
    half: Ints
    jump: Array
    bend: Array
    curvature: Array

    @property
    def curve(self) -> Ints:
        return self.half // 2


@dataclass(frozen=True, slots=True, eq=False)
class Earlier:
    """Measures of an earlier net: which of its patches and curves each of a net's is, (Q,) and (C,), -1 for none, and which
    patches have changed, those that were none among them."""

    measured: Measured
    changed: Mask
    patch: Ints
    curve: Ints


def measure(net: Net, fit: NetFit, field: Field, before: Earlier | None = None, work: Work = here) -> Measured:
    """Measure every patch and every joint inside the box; what is known from `before` is not measured again."""
    own, copies = np.flatnonzero(fit.copies.own_patches), fit.copies
    row = np.searchsorted(own, copies.patch)
    m, count = 2 * HALF - 1, len(own)
    of = Sampled(
        distance=np.empty(count),
        square=np.empty(count),
        cosine=np.empty(count),
        where=np.empty((count, 3)),
        row=np.arange(count),
        normals=np.empty((count, 4, m, 3)),
        bends=np.empty((count, 4, m, 3, 3)),
    )
    wanted = own
    if before is not None:
        old = np.flatnonzero(~before.changed[own])
        known, patch = before.measured.of, before.patch[own[old]]
        for array, values in zip(_each(of), _each(known), strict=True):
            array[old] = values[patch]
        of.normals[old], of.bends[old] = known.normals[known.row[patch]], known.bends[known.row[patch]]
        wanted = own[before.changed[own]]
    parts = [at[i : i + PIECE] for _, at in shapes(fit, wanted) for i in range(0, len(at), PIECE)]
    done = work(sampled, [(field, np.stack([fit.patches[i] for i in part])) for part in parts])
    for part, found in zip(parts, done, strict=True):
        for array, values in zip(
            (*_each(of), of.normals, of.bends), (*_each(found), found.normals, found.bends), strict=True
        ):
            array[row[part]] = values
    of = Sampled(
        of.distance[row], of.square[row], of.cosine[row], of.where[row] + copies.patch_shift, row, of.normals, of.bends
    )
    return Measured(of, *_joints(net, of, before))


def _each(of: Sampled) -> tuple[Array, ...]:
    return of.distance, of.square, of.cosine, of.where


def sampled(field: Field, poles: Array) -> Sampled:
    """Measures of patches of one degree, poles (n, p + 1, q + 1, 3)."""
    t = np.linspace(0.0, 1.0, SAMPLES)
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    bu, bv, du, dv = bezier(p, t), bezier(q, t), bezier(p, t, 1), bezier(q, t, 1)
    points = tensor(bu, poles, bv)
    normal = np.cross(tensor(du, poles, bv), tensor(bu, poles, dv))
    value, slope = field.value_and_gradient(points)
    steep = np.linalg.norm(slope, axis=-1)
    d = np.abs(value) / np.maximum(steep, 1e-300)
    if isinstance(field, Inside):
        # beyond the box there is no solid: borders that leave it between their ends are off by as much
        d += np.maximum(np.maximum(field.lo - points, points - field.hi).max(axis=-1), 0.0)
    length = np.linalg.norm(normal, axis=-1) * steep
    sides = [_along(poles, s) for s in range(4)]
    return Sampled(
        distance=d.max(axis=1),
        square=(d**2).mean(axis=1),
        cosine=(np.einsum("nki,nki->nk", normal, slope) / np.maximum(length, 1e-300)).min(axis=1),
        where=points[np.arange(len(poles)), d.argmax(axis=1)],
        row=np.arange(len(poles)),
        normals=np.stack([n for n, _ in sides], axis=1),
        bends=np.stack([b for _, b in sides], axis=1),
    )


def shapes(fit: NetFit, patches: Ints | None = None) -> list[tuple[tuple[int, int], Ints]]:
    """The degrees that occur among the patches (all of the fit's if None), each with the patches that have them."""
    of = np.arange(len(fit.patches)) if patches is None else patches
    each = np.array([fit.patches[i].shape[:2] for i in of]) - 1
    return [((int(p), int(q)), of[(each == (p, q)).all(axis=1)]) for p, q in np.unique(each, axis=0)]


def _along(poles: Array, side: int) -> tuple[Array, Array]:
    """Unit normals (n, m, 3) and curvature tensors (n, m, 3, 3) along a side, run counter-clockwise."""
    t = np.linspace(0.0, 1.0, 2 * HALF - 1)
    end = np.array([1.0 if side in (1, 2) else 0.0])
    u, v = (t, end) if side in (0, 2) else (end, t)
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    d = {
        (i, j): tensor(bezier(p, u, i), poles, bezier(q, v, j))
        for i, j in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    }  # fmt: skip
    normal = np.cross(d[1, 0], d[0, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    tangents = np.stack([d[1, 0], d[0, 1]], axis=-1)
    first = np.swapaxes(tangents, -1, -2) @ tangents
    dual = tangents @ _inverse(first)
    second = np.empty(first.shape)
    for (i, j), key in (((0, 0), (2, 0)), ((0, 1), (1, 1)), ((1, 0), (1, 1)), ((1, 1), (0, 2))):
        second[..., i, j] = np.einsum("nmi,nmi->nm", d[key], normal)
    bend = dual @ second @ np.swapaxes(dual, -1, -2)
    return (normal, bend) if side in (0, 1) else (normal[:, ::-1], bend[:, ::-1])


def _inverse(first: Array) -> Array:
    """Inverses of symmetric 2 x 2 matrices, large but finite where there is none: folded patches are measured, too."""
    a, b, c = first[..., 0, 0], first[..., 0, 1], first[..., 1, 1]
    adjugate = np.stack([np.stack([c, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    return adjugate / np.maximum(a * c - b * b, 1e-12 * (a + c) ** 2 + 1e-100)[..., None, None]


PARTS = (slice(None, HALF), slice(HALF - 1, None), slice(None, None, 2))
"""Of a side's samples: either half, or all of a side that is half of a curve."""

JOINTS = 4096
"""Joints measured at once: 70 MB."""


def _joints(net: Net, of: Sampled, before: Earlier | None) -> tuple[Ints, Array, Array, Array]:
    """Jumps across the half sides that two patches share; those between copies of the same two sides are measured once."""
    keys, sides, patches = [], [], []
    for piece in (0, 1, 2):
        q, s = np.nonzero(net.piece == piece)
        for half, part in ((0, 0), (1, 1)) if piece == 0 else ((piece - 1, 2),):
            keys.append(2 * net.curve[q, s] + half)
            patches.append(q)
            sides.append(np.column_stack([of.row[q], s, net.sense[q, s] < 0, np.full(len(q), part)]))
    key, side = np.concatenate(keys), np.concatenate(sides)
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order][:-1] == key[order][1:])
    a, b = order[pair], order[pair + 1]
    halves, joints = key[a], np.empty((3, len(a)))
    new = np.ones(len(a), bool)
    if before is not None:
        patch, curve = np.concatenate(patches), before.curve[halves // 2]
        new = before.changed[patch[a]] | before.changed[patch[b]] | (curve < 0)
        known = np.searchsorted(before.measured.half, 2 * curve[~new] + halves[~new] % 2)
        joints[:, ~new] = [m[known] for m in (before.measured.jump, before.measured.bend, before.measured.curvature)]
        a, b = a[new], b[new]
    distinct, index = np.unique(np.column_stack([side[a], side[b]]), axis=0, return_inverse=True)
    found = np.empty((3, len(distinct)))
    for start in range(0, len(distinct), JOINTS):
        rows = distinct[start : start + JOINTS]
        one, other = (_along_sides(of, rows[:, k : k + 4]) for k in (0, 4))
        sine = np.linalg.norm(np.cross(one[0], other[0]), axis=-1)
        angle = np.arctan2(sine, np.einsum("nmi,nmi->nm", one[0], other[0]))
        size = np.maximum(*(np.linalg.norm(k, axis=(-2, -1)) for k in (one[1], other[1])))
        found[:, start : start + JOINTS] = (
            np.degrees(angle).max(axis=1),
            np.linalg.norm(one[1] - other[1], axis=(-2, -1)).max(axis=1),
            size.max(axis=1),
        )
    joints[:, new] = found[:, index.ravel()]
    return halves, *joints


def _along_sides(of: Sampled, sides: Ints) -> tuple[Array, Array]:
    """Normals (n, m, 3) and curvature tensors (n, m, 3, 3) along parts of sides: rows (row, side, whether run back, part)."""
    n, k = np.empty((len(sides), HALF, 3)), np.empty((len(sides), HALF, 3, 3))
    for back in (0, 1):
        for part, samples in enumerate(PARTS):
            at = np.flatnonzero((sides[:, 2] == back) & (sides[:, 3] == part))
            row, side = sides[at, 0], sides[at, 1]
            for array, values in ((n, of.normals), (k, of.bends)):
                found = values[row, side]
                array[at] = (found[:, ::-1] if back else found)[:, samples]
    return n, k
