"""The coarsest layout of a level set that passes: uniform leaves first, split where layouts fold or fits miss.

A layout is made and looked at in a small part of the time of a fit. So leaves are split first until nothing is folded that no fit
could save, and only then by what the fit misses.
"""

from __future__ import annotations

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.field_caps import LayoutError
from tpmscad.patches.field_layer import Layer, fitted, laid, split
from tpmscad.patches.field_work import Work, here
from tpmscad.patches.layout import octree
from tpmscad.patches.layout.dual import Mesh
from tpmscad.patches.layout.octree import Array, Ints, Octree
from tpmscad.patches.layout.refine import too_coarse

TURN, USUAL = 1.5, 0.7
"""Size of the first leaves times the curvature that this part of the surface stays below: four leaves to a gyroid's period."""

TRIED = ((1.0, None), (1.25, None), (1.6, None), (1.0, 0.5))
"""First layouts tried: leaves per length of the first, and the cosine of the angle that normals in a leaf may make with their
mean (None: as the fits need it)."""

DEPTH = 4
"""Greatest refinement of a first leaf: sixteen to one."""

LAYOUTS, ROUNDS, IDLE = 8, 8, 2
"""Layouts before a fit, fits of a first layout, and fits without an improvement."""

FEW = 0.3
"""Above this share of bad leaves a layout is made finer as a whole."""

SINGULAR = 0.15
"""Slopes below this part of the usual one are named as the cause of a failure."""


def laid_out(
    field: Field, lo: Array, hi: Array, tol: float, samples: Array, probed: bool = False, work: Work = here
) -> Layer:
    """The coarsest layout of {field = 0} in the box that passes; LayoutError where none does. samples (n, 3) of the surface.

    `probed`: leaves that hide crossings from their corners are split, too, so that nothing the probes see is lost.
    """
    first = _first_spacing(field, samples)
    best: Layer | None = None
    for finer, cosine in TRIED:
        tree = octree.uniform(lo, hi, _counts(field, lo, hi, first / finer))
        if probed or cosine is not None:
            tree = _refined(tree, field, cosine)
        found = _followed(field, tree, tol, samples, work)
        if found is not None:
            if not len(found.bad):
                return found
            if best is None or found.doubtful < best.doubtful:
                best = found
    if best is None:
        raise LayoutError("the surface turns too fast everywhere for the leaves tried: use a smoother field")
    raise LayoutError(_refusal(field, best))


def _followed(field: Field, tree: Octree, tol: float, samples: Array, work: Work) -> Layer | None:
    """The best layer of those that splitting leads to from a first tree; None if that is too coarse as a whole."""
    best: Layer | None = None
    mesh: Mesh | None = None
    layer: Layer | None = None
    coarsest, idle = int(tree.size.max()), 0
    for _ in range(ROUNDS):
        for _ in range(LAYOUTS):
            mesh, bad = laid(tree, field, mesh)
            bad = _splittable(tree, bad)
            if not len(bad):
                break
            if tree.size.max() == coarsest and len(bad) > FEW * len(np.unique(mesh.cell)):
                return best
            tree = split(tree, bad)
        assert mesh is not None
        layer = fitted(field, tree, mesh, tol, samples, layer, work)
        if not len(layer.bad):
            return layer
        if best is None and layer.share > FEW:
            return None
        idle = 0 if best is None or layer.doubtful < best.doubtful else idle + 1
        if idle == 0:
            best = layer
        deeper = _splittable(tree, layer.bad)
        if idle == IDLE or not len(deeper):
            break
        tree = split(tree, deeper)
    return best


def _splittable(tree: Octree, leaves: Ints) -> Ints:
    return leaves[tree.size[leaves] * 2**DEPTH > tree.size.max()]


def _refined(tree: Octree, field: Field, cosine: float | None) -> Octree:
    for _ in range(DEPTH - 1):
        flagged = too_coarse(tree, field, cosine) & (tree.size * 2**DEPTH > tree.size.max())
        if not flagged.any():
            break
        tree = octree.split(tree, flagged)
    return tree


def _refusal(field: Field, layer: Layer) -> str:
    where = layer.tree.points(layer.tree.origin[layer.bad] + 0.5 * layer.tree.size[layer.bad][:, None])
    gradient = field.gradient(where)
    slope = np.linalg.norm(gradient, axis=1)
    size = layer.tree.size[layer.bad][:, None] * layer.tree.step
    at_box = (where - size < layer.tree.lo) | (where + size > layer.tree.hi)
    level = np.linalg.norm(np.where(at_box, 0.0, gradient), axis=1)
    usual = np.median(np.linalg.norm(field.gradient(layer.net.vertices), axis=1))
    places = ", ".join("(" + ", ".join(f"{x:.4g}" for x in p) + ")" for p in where[np.argsort(slope)][:3])
    if slope.min() < SINGULAR * usual:
        cause = "the field is nearly singular there: change the level, the transition or the minimum neck"
    elif (at_box.any(axis=1) & (level < SINGULAR * usual)).any():
        cause = "the surface touches the box there without crossing it: move the domain or change the level"
    else:
        cause = "the surface turns too fast for the depth allowed: use a looser tol, or a smoother field"
    return f"{len(where)} places could not be fitted within the request ({layer.why}), near {places}; {cause}"


def _first_spacing(field: Field, samples: Array) -> float:
    """The size of leaf for the curvature of most of the surface."""
    step = 1e-3 * float(np.ptp(samples, axis=0).max())
    slope = field.gradient(samples)
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    normal = slope / np.maximum(length, 1e-300)
    hessian = np.stack(
        [(field.gradient(samples + step * e) - field.gradient(samples - step * e)) / (2 * step) for e in np.eye(3)], -1
    )
    across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    bend = across @ hessian @ across / np.maximum(length, 1e-300)[..., None]
    return TURN / float(np.quantile(np.linalg.norm(bend, ord=2, axis=(1, 2)), USUAL))


def _counts(field: Field, lo: Array, hi: Array, size: float) -> Ints:
    """Leaves along each axis, none longer than size; a whole number to a period, so that periods are laid out alike."""
    leaf = np.full(3, size)
    periods = field.periods()
    if periods is not None:
        leaf = np.array(periods) / np.ceil(np.array(periods) / size - 1e-6)
    return np.maximum(2, np.ceil((hi - lo) / leaf - 1e-6)).astype(np.int64)
