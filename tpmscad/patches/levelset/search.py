"""The coarsest layout of a level set that passes: uniform leaves first, split where layouts fold or fits miss.

A layout is made and looked at in a small part of the time of a fit. So leaves are split first until nothing is folded that no fit
could save, and only then by what the fit misses. What passes is simplified, where no periods have to stay alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.caps import LayoutError
from tpmscad.patches.levelset.fewer import fewer
from tpmscad.patches.levelset.layer import Layer, fitted, laid, split
from tpmscad.patches.levelset.layout import octree
from tpmscad.patches.levelset.layout.dual import Mesh
from tpmscad.patches.levelset.layout.octree import Array, Ints, Octree
from tpmscad.patches.levelset.layout.refine import too_coarse
from tpmscad.patches.levelset.mended import mended
from tpmscad.patches.levelset.period_tree import piece_of, repeated_tree
from tpmscad.patches.levelset.work import Work, here

TURN, USUAL = 1.5, 0.7
"""Size of the first leaves times the curvature that this part of the surface stays below: four leaves to a gyroid's period."""

TRIED = (1.0, 0.8, 1.25, 1.6, 2.0)
"""First layouts tried: leaves per length of the first. How the leaves happen to lie to the surface's necks makes a difference
of up to a half in the faces that splitting leads to, and layouts are cheap. The first does where nothing has to be split."""

CONE = 0.5
"""Cosine of the angle that normals in a leaf may make with their mean, in the layout that is tried last."""

DEPTH, MOST_CELLS = 5, 2**27
"""Greatest refinement of a first leaf: thirty-two to one, or sixteen where the finest grid would have more cells than this (half
a gigabyte). Four places of a figure of the porous-blending paper stayed folded at sixteen to one, and none at thirty-two."""

REFINED = 3
"""Levels by which leaves are split that hide crossings or in which normals turn too far, before there is a layout."""

LAYOUTS, ROUNDS, IDLE, MOST = 8, 12, 2, 5
"""Layouts before a fit, fits of a first layout, fits without an improvement, and first layouts that are fitted."""

SKETCHES, GROWTH = 2, 30
"""Layouts after which first ones are compared, and the patches that each leaf still bad will have made in the end: 17 to 62 in
ten layouts of two blends. With it the first of the fewest patches, or one within 1 %, was found in a quarter of the time."""

LAST = 16
"""Bad leaves that are mended at most where splitting them has not helped."""

FEW = 0.15
"""Above this share of leaves that the first fit finds bad another layout is tried."""

SINGULAR = 0.15
"""Slopes below this part of the usual one are named as the cause of a failure."""


def laid_out(
    field: Field, lo: Array, hi: Array, tol: float, samples: Array, probed: bool = False, work: Work = here
) -> Layer:
    """The coarsest layout of {field = 0} in the box that passes; LayoutError where none does. samples (n, 3) of the surface.

    `probed`: leaves that hide crossings from their corners are split, too, so that nothing the probes see is lost.
    """
    best: Layer | None = None
    for tree, mesh in _starts(field, lo, hi, _first_spacing(field, samples), probed):
        found = _followed(field, tree, mesh, tol, samples, work)
        if not len(found.bad):
            return fewer(found, tol, samples, work)
        if best is None or found.doubtful < best.doubtful:
            best = found
    assert best is not None
    raise LayoutError(_refusal(field, best))


def _starts(field: Field, lo: Array, hi: Array, first: float, probed: bool) -> Iterator[tuple[Octree, Mesh]]:
    """Layouts to start from, those first that seem to need the fewest patches. Of periodic fields a piece is searched."""
    found: list[tuple[int, _Laid]] = []
    seen: set[tuple[int, ...]] = set()
    end, periods = piece_of(field, lo, hi)

    def whole(piece: _Laid) -> tuple[Octree, Mesh]:
        piece = _unfolded(field, piece)
        if periods.any():
            piece = _unfolded(field, _Laid.of(repeated_tree(piece.tree, hi, periods), field, None))
        return piece.tree, piece.mesh

    for finer in TRIED:
        counts = _counts(field, lo, end, first / finer)
        if tuple(counts) in seen:
            continue
        seen.add(tuple(counts))
        tree = octree.uniform(lo, end, counts)
        sketch = _unfolded(field, _Laid.of(_refined(tree, field, None) if probed else tree, field, None), SKETCHES)
        if finer == TRIED[0] and sketch.tree.size.max() == 1 and not len(sketch.bad):
            yield whole(sketch)
        else:
            found.append((_patches(sketch.mesh) + GROWTH * len(sketch.bad), sketch))
    for _, sketch in sorted(found, key=lambda each: each[0])[:MOST]:
        yield whole(sketch)
    tree = _refined(octree.uniform(lo, end, _counts(field, lo, end, first)), field, CONE)
    yield whole(_Laid.of(tree, field, None))


@dataclass(frozen=True, slots=True, eq=False)
class _Laid:
    """A tree, its layout, and the leaves that are bad and can be split."""

    tree: Octree
    mesh: Mesh
    bad: Ints

    @staticmethod
    def of(tree: Octree, field: Field, before: Mesh | None) -> _Laid:
        mesh, bad = laid(tree, field, before)
        return _Laid(tree, mesh, _splittable(tree, bad))


def _unfolded(field: Field, start: _Laid, layouts: int = LAYOUTS) -> _Laid:
    """The tree split until its layout is worth a fit, `layouts` in all at most."""
    for _ in range(layouts - 1):
        if not len(start.bad):
            break
        start = _Laid.of(split(start.tree, start.bad), field, start.mesh)
    return start


def _patches(mesh: Mesh) -> int:
    """How many patches a mesh makes: triangles are cut in three."""
    return len(mesh.corners) + 2 * int(np.count_nonzero(mesh.corners[:, 3] < 0))


def _followed(field: Field, tree: Octree, mesh: Mesh, tol: float, samples: Array, work: Work) -> Layer:
    """The best layer of those that splitting leads to from a first layout."""
    best = layer = mended(fitted(field, tree, mesh, tol, samples, None, work), tol, samples, work)
    idle, least = 0, len(layer.bad)
    for _ in range(ROUNDS - 1):
        deeper = _splittable(tree, layer.bad)
        if not len(deeper) or best.share > FEW:
            break
        made = _unfolded(field, _Laid.of(split(tree, deeper), field, mesh))
        tree, mesh = made.tree, made.mesh
        layer = mended(fitted(field, tree, mesh, tol, samples, layer, work), tol, samples, work)
        if not len(layer.bad):
            return layer
        # beside what a split cures larger leaves may turn bad: those few are cured in their turn
        idle = 0 if layer.doubtful < best.doubtful or len(layer.bad) < least else idle + 1
        least = min(least, len(layer.bad))
        if layer.doubtful < best.doubtful:
            best = layer
        elif idle == IDLE:
            break
    return mended(best, tol, samples, work, LAST)


def _splittable(tree: Octree, leaves: Ints) -> Ints:
    first = np.prod(tree.shape / tree.size.max())
    depth = DEPTH if first * 8**DEPTH <= MOST_CELLS else DEPTH - 1
    return leaves[tree.size[leaves] * 2**depth > tree.size.max()]


def _refined(tree: Octree, field: Field, cosine: float | None) -> Octree:
    for _ in range(REFINED):
        flagged = too_coarse(tree, field, cosine) & (tree.size * 2 ** (REFINED + 1) > tree.size.max())
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
