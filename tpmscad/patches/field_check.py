"""What a fit of a level set is worth, measured on it: distances, normals and joints of every patch, and what the patches miss.

Distances are to the level set along the field's gradient, and back from points of the level set to their feet on the patches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tpmscad.fields.field import Field
from tpmscad.patches.field_fit import NetFit, bezier, tensor
from tpmscad.patches.field_work import PIECE, Work, here
from tpmscad.patches.layout.net import Net
from tpmscad.patches.layout.octree import Array, Ints, Mask
from tpmscad.patches.layout.relax import onto

SAMPLES = 13
"""Samples along each parameter of a patch, borders included."""

HALF = 17
"""Samples along half a side: joints are measured half by half, so that a side meets the two beyond a T-vertex."""

FEET = 6
"""Newton steps of a foot on a patch."""

NEAREST = (3, 24)
"""Samples from whose patches the nearest foot is taken, and for points that miss with them: near a side that runs askew the
nearest samples may all be of patches beyond it."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Patches sampled: greatest and mean square distance (Q,), least cosine of the normal with the gradient (Q,), where the
    distance is greatest (Q, 3), and normals (Q, 4, m, 3) and curvature tensors (Q, 4, m, 3, 3) along their sides.
    """

    distance: Array
    square: Array
    cosine: Array
    where: Array
    normals: Array
    bends: Array

    def taken(self, patches: Ints) -> Sampled:
        """The measures of these patches; of any where the number is below zero."""
        return Sampled(*(array[patches] for array in _arrays(self)))


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What each patch is worth, and per half side (n,) of curves `curve`: tangent jump in degrees, curvature jump and greatest
    curvature.
    """

    of: Sampled
    curve: Ints
    jump: Array
    bend: Array
    curvature: Array


def measure(
    net: Net, fit: NetFit, field: Field, before: tuple[Sampled, Mask] | None = None, work: Work = here
) -> Measured:
    """Measure every patch and every joint inside the box. `before`: earlier measures, and the patches (Q,) that have changed."""
    count = len(fit.patches)
    wanted = np.arange(count)
    if before is None:
        m = 2 * HALF - 1
        of = Sampled(*(np.empty((count, *s)) for s in ((), (), (), (3,), (4, m, 3), (4, m, 3, 3))))
    else:
        of, wanted = Sampled(*(array.copy() for array in _arrays(before[0]))), np.flatnonzero(before[1])
    parts = [at[i : i + PIECE] for _, at in shapes(fit, wanted) for i in range(0, len(at), PIECE)]
    done = work(sampled, [(field, np.stack([fit.patches[i] for i in part])) for part in parts])
    for part, found in zip(parts, done, strict=True):
        for array, values in zip(_arrays(of), _arrays(found), strict=True):
            array[part] = values
    return Measured(of, *_joints(net, of.normals, of.bends))


def _arrays(of: Sampled) -> tuple[Array, ...]:
    return of.distance, of.square, of.cosine, of.where, of.normals, of.bends


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
    length = np.linalg.norm(normal, axis=-1) * steep
    sides = [_along(poles, s) for s in range(4)]
    return Sampled(
        distance=d.max(axis=1),
        square=(d**2).mean(axis=1),
        cosine=(np.einsum("nki,nki->nk", normal, slope) / np.maximum(length, 1e-300)).min(axis=1),
        where=points[np.arange(len(poles)), d.argmax(axis=1)],
        normals=np.stack([n for n, _ in sides], axis=1),
        bends=np.stack([b for _, b in sides], axis=1),
    )


def shapes(fit: NetFit, patches: Ints | None = None) -> list[tuple[tuple[int, int], Ints]]:
    """The degrees that occur among the patches (all of the fit's if None), each with the patches that have them."""
    of = np.arange(len(fit.patches)) if patches is None else patches
    each = np.array([fit.patches[i].shape[:2] for i in of]) - 1
    return [((int(p), int(q)), of[(each == (p, q)).all(axis=1)]) for p, q in np.unique(each, axis=0)]


def missed(fit: NetFit, points: Array, tol: float) -> Array:
    """Distances (n,) from points of the level set to their feet on the patches; those above half of tol with more care."""
    t = np.linspace(0.0, 1.0, SAMPLES)
    samples, owner = [], []
    for (p, q), at in shapes(fit):
        samples.append(tensor(bezier(p, t), np.stack([fit.patches[i] for i in at]), bezier(q, t)).reshape(-1, 3))
        owner.append(np.repeat(at, SAMPLES**2))
    patch = np.concatenate(owner)
    u, v = (np.tile(g.ravel(), len(fit.patches)) for g in np.meshgrid(t, t, indexing="ij"))
    tree = cKDTree(np.concatenate(samples))
    best = np.full(len(points), np.inf)
    for count in NEAREST:
        chosen = np.flatnonzero(best > 0.5 * tol)
        if not len(chosen):
            break
        _, near = tree.query(points[chosen], k=count)
        for k in range(count):
            i = near[:, k]
            for (p, q), at in shapes(fit):
                rows = np.flatnonzero(np.isin(patch[i], at))
                if len(rows):
                    poles = np.stack([fit.patches[j] for j in at])[np.searchsorted(at, patch[i[rows]])]
                    distance = _feet(poles, points[chosen[rows]], u[i[rows]], v[i[rows]], p, q)
                    best[chosen[rows]] = np.minimum(best[chosen[rows]], distance)
    return best


def _feet(poles: Array, points: Array, u: Array, v: Array, p: int, q: int) -> Array:
    """Distances from points to patches, one each, from starting parameters: feet kept on the patches."""
    for _ in range(FEET):
        bu, bv, du, dv = bezier(p, u), bezier(q, v), bezier(p, u, 1), bezier(q, v, 1)
        across = np.einsum("nijx,nj->nix", poles, bv)
        residual = points - np.einsum("ni,nix->nx", bu, across)
        xu, xv = np.einsum("ni,nix->nx", du, across), np.einsum("ni,nijx,nj->nx", bu, poles, dv, optimize=True)
        a, b, c = (np.einsum("nx,nx->n", f, g) for f, g in ((xu, xu), (xu, xv), (xv, xv)))
        ru, rv = np.einsum("nx,nx->n", xu, residual), np.einsum("nx,nx->n", xv, residual)
        determinant = np.maximum(a * c - b * b, 1e-300)
        step_u, step_v = (c * ru - b * rv) / determinant, (a * rv - b * ru) / determinant
        stuck_u, stuck_v = (u + step_u < 0) | (u + step_u > 1), (v + step_v < 0) | (v + step_v > 1)
        step_v, step_u = np.where(stuck_u, rv / c, step_v), np.where(stuck_v, ru / a, step_u)
        u, v = np.clip(u + step_u, 0, 1), np.clip(v + step_v, 0, 1)
    foot = np.einsum("ni,nijx,nj->nx", bezier(p, u), poles, bezier(q, v), optimize=True)
    return np.linalg.norm(points - foot, axis=1)


def samples_of(field: Field, lo: Array, hi: Array, spacing: float) -> Array:
    """Points of {field = 0} in the box: where it crosses the lines of a grid of about that spacing, shifted off every layout."""
    counts = np.maximum(2, np.ceil((hi - lo) / spacing)).astype(int) + 1
    axes = [np.linspace(low, high, n) for low, high, n in zip(lo, hi, counts, strict=True)]
    values = field.on_grid(*axes)
    found = []
    for axis in range(3):
        swapped = np.moveaxis(values, axis, 0)
        i, j, k = np.nonzero((swapped[:-1] > 0) != (swapped[1:] > 0))
        f0, f1 = swapped[i, j, k], swapped[i + 1, j, k]
        b, c = (a for a in range(3) if a != axis)
        points = np.empty((len(i), 3))
        points[:, axis] = axes[axis][i] + f0 / (f0 - f1) * (axes[axis][i + 1] - axes[axis][i])
        points[:, b], points[:, c] = axes[b][j], axes[c][k]
        fixed = np.ones(points.shape, bool)
        fixed[:, axis] = False
        found.append(onto(field, points, fixed, np.full(len(points), 0.5 * spacing)))
    points = np.concatenate(found)
    inside = ((points >= lo) & (points <= hi)).all(axis=1)
    value, slope = field.value_and_gradient(points)
    converged = np.abs(value) <= 1e-6 * spacing * np.linalg.norm(slope, axis=1)
    return points[inside & converged]


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


def _joints(net: Net, normals: Array, bends: Array) -> tuple[Ints, Array, Array, Array]:
    """Jumps across the half sides that two patches share."""
    keys, n_rows, k_rows = [], [], []
    for piece in (0, 1, 2):
        q, s = np.nonzero(net.piece == piece)
        n, k = normals[q, s], bends[q, s]
        back = net.sense[q, s] < 0
        n, k = np.where(back[:, None, None], n[:, ::-1], n), np.where(back[:, None, None, None], k[:, ::-1], k)
        for half, part in ((0, slice(None, HALF)), (1, slice(HALF - 1, None))) if piece == 0 else (
            (piece - 1, slice(None, None, 2)),
        ):  # fmt: skip
            keys.append(2 * net.curve[q, s] + half)
            n_rows.append(n[:, part])
            k_rows.append(k[:, part])
    key = np.concatenate(keys)
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order][:-1] == key[order][1:])
    a, b = order[pair], order[pair + 1]
    n, k = np.concatenate(n_rows), np.concatenate(k_rows)
    sine = np.linalg.norm(np.cross(n[a], n[b]), axis=-1)
    jump = np.degrees(np.arctan2(sine, np.einsum("nmi,nmi->nm", n[a], n[b]))).max(axis=1)
    bend = np.linalg.norm(k[a] - k[b], axis=(-2, -1)).max(axis=1)
    size = np.maximum(np.linalg.norm(k[a], axis=(-2, -1)), np.linalg.norm(k[b], axis=(-2, -1))).max(axis=1)
    return key[a] // 2, jump, bend, size
