"""The coarsest layout of a level set that passes: uniform leaves first, split where layouts fold or fits miss.

A layout is made and looked at in a small part of the time of a fit. So leaves are split first until nothing is folded that no fit
could save, and only then by what the fit misses. What passes is simplified, where no periods have to stay alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.errors import LevelSetError
from tpmscad.fields.field import Field
from tpmscad.levelset.fit_simplification import merge_failing_polygons, simplify_fit
from tpmscad.levelset.level_set_fit import LevelSetFit, fit_level_set, mesh_level_set, split_numbered_leaves
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.periodicity import crop_to_searched_periods, tile_octree
from tpmscad.levelset.quadmesh.refinement import find_coarse_leaves
from tpmscad.parallel import TaskRunner, run_serial

LEAF_SIZE_TIMES_CURVATURE, CURVATURE_QUANTILE = 1.5, 0.7
"""Size of the first leaves times the curvature that this part of the surface stays below: four leaves to a gyroid's period."""

LEAF_SIZE_DIVISORS = (1.0, 0.8, 1.25, 1.6, 2.0)
"""First layouts tried: leaves per length of the first. How the leaves happen to lie to the surface's necks makes a difference
of up to a half in the faces that splitting leads to, and layouts are cheap. The first does where nothing has to be split."""

MIN_CONE_COSINE = 0.5
"""Cosine of the angle that normals in a leaf may make with their mean, in the layout that is tried last."""

MAX_DEPTH, MAX_FINEST_CELLS = 5, 2**27
"""Greatest refinement of a first leaf: thirty-two to one, or sixteen where the finest grid would have more cells than this (half
a gigabyte). Four places of a figure of the porous-blending paper stayed folded at sixteen to one, and none at thirty-two."""

PRESPLIT_LEVELS = 3
"""Levels by which leaves are split that hide crossings or in which normals turn too far, before there is a layout."""

MAX_MESHES_BEFORE_FIT, MAX_FITS_PER_START, MAX_IDLE_FITS, MAX_STARTS = 8, 12, 2, 5
"""Layouts before a fit, fits of a first layout, fits without an improvement, and first layouts that are fitted."""

TRIAL_MESHES, PATCHES_PER_BAD_LEAF = 2, 30
"""Layouts after which first ones are compared, and the patches that each leaf still bad will have made in the end: 17 to 62 in
ten layouts of two blends. With it the first of the fewest patches, or one within 1 %, was found in a quarter of the time."""

MAX_BAD_LEAVES_AT_END = 16
"""Bad leaves that are mended at most where splitting them has not helped."""

MAX_BAD_LEAF_FRACTION = 0.15
"""Above this share of leaves that the first fit finds bad another layout is tried."""

SINGULAR_SLOPE_FRACTION = 0.15
"""Slopes below this part of the usual one are named as the cause of a failure."""


def fit_level_set_adaptively(
    field: Field, lo: Array, hi: Array, tol: float, samples: Array, probed: bool = False, work: TaskRunner = run_serial
) -> LevelSetFit:
    """The coarsest layout of {field = 0} in the box that passes; LayoutError where none does. samples (n, 3) of the surface.

    `probed`: leaves that hide crossings from their corners are split, too, so that nothing the probes see is lost.
    """
    best: LevelSetFit | None = None
    for tree, mesh in _generate_starts(field, lo, hi, _choose_leaf_size(field, samples), probed):
        found = _refine_from(field, tree, mesh, tol, samples, work)
        if not len(found.bad):
            return simplify_fit(found, tol, samples, work)
        if best is None or found.bad_volume < best.bad_volume:
            best = found
    assert best is not None
    raise LevelSetError(_explain_failure(field, best))


def _generate_starts(
    field: Field, lo: Array, hi: Array, first: float, probed: bool
) -> Iterator[tuple[Octree, QuadMesh]]:
    """Layouts to start from, those first that seem to need the fewest patches. Of periodic fields a piece is searched."""
    found: list[tuple[int, _MeshedTree]] = []
    seen: set[tuple[int, ...]] = set()
    end, periods = crop_to_searched_periods(field, lo, hi)

    def whole(piece: _MeshedTree) -> tuple[Octree, QuadMesh]:
        piece = _split_until_unfolded(field, piece)
        if periods.any():
            piece = _split_until_unfolded(field, _MeshedTree.of(tile_octree(piece.tree, hi, periods), field, None))
        return piece.tree, piece.mesh

    for finer in LEAF_SIZE_DIVISORS:
        counts = _count_leaves(field, lo, end, first / finer)
        if tuple(counts) in seen:
            continue
        seen.add(tuple(counts))
        tree = octree.uniform_octree(lo, end, counts)
        sketch = _split_until_unfolded(
            field, _MeshedTree.of(_presplit(tree, field, None) if probed else tree, field, None), TRIAL_MESHES
        )
        if finer == LEAF_SIZE_DIVISORS[0] and sketch.tree.size.max() == 1 and not len(sketch.bad):
            yield whole(sketch)
        else:
            found.append((_count_patches(sketch.mesh) + PATCHES_PER_BAD_LEAF * len(sketch.bad), sketch))
    for _, sketch in sorted(found, key=lambda each: each[0])[:MAX_STARTS]:
        yield whole(sketch)
    tree = _presplit(octree.uniform_octree(lo, end, _count_leaves(field, lo, end, first)), field, MIN_CONE_COSINE)
    yield whole(_MeshedTree.of(tree, field, None))


@dataclass(frozen=True, slots=True, eq=False)
class _MeshedTree:
    """A tree, its layout, and the leaves that are bad and can be split."""

    tree: Octree
    mesh: QuadMesh
    bad: IntArray

    @staticmethod
    def of(tree: Octree, field: Field, before: QuadMesh | None) -> _MeshedTree:
        mesh, bad = mesh_level_set(tree, field, before)
        return _MeshedTree(tree, mesh, _select_splittable(tree, bad))


def _split_until_unfolded(field: Field, start: _MeshedTree, layouts: int = MAX_MESHES_BEFORE_FIT) -> _MeshedTree:
    """The tree split until its layout is worth a fit, `layouts` in all at most."""
    for _ in range(layouts - 1):
        if not len(start.bad):
            break
        start = _MeshedTree.of(split_numbered_leaves(start.tree, start.bad), field, start.mesh)
    return start


def _count_patches(mesh: QuadMesh) -> int:
    """How many patches a mesh makes: triangles are cut in three."""
    return len(mesh.corners) + 2 * int(np.count_nonzero(mesh.corners[:, 3] < 0))


def _refine_from(
    field: Field, tree: Octree, mesh: QuadMesh, tol: float, samples: Array, work: TaskRunner
) -> LevelSetFit:
    """The best layer of those that splitting leads to from a first layout."""
    best = layer = merge_failing_polygons(
        fit_level_set(field, tree, mesh, tol, samples, None, work), tol, samples, work
    )
    idle, least = 0, len(layer.bad)
    for _ in range(MAX_FITS_PER_START - 1):
        deeper = _select_splittable(tree, layer.bad)
        if not len(deeper) or best.bad_fraction > MAX_BAD_LEAF_FRACTION:
            break
        made = _split_until_unfolded(field, _MeshedTree.of(split_numbered_leaves(tree, deeper), field, mesh))
        tree, mesh = made.tree, made.mesh
        layer = merge_failing_polygons(fit_level_set(field, tree, mesh, tol, samples, layer, work), tol, samples, work)
        if not len(layer.bad):
            return layer
        # beside what a split cures larger leaves may turn bad: those few are cured in their turn
        idle = 0 if layer.bad_volume < best.bad_volume or len(layer.bad) < least else idle + 1
        least = min(least, len(layer.bad))
        if layer.bad_volume < best.bad_volume:
            best = layer
        elif idle == MAX_IDLE_FITS:
            break
    return merge_failing_polygons(best, tol, samples, work, MAX_BAD_LEAVES_AT_END)


def _select_splittable(tree: Octree, leaves: IntArray) -> IntArray:
    first = np.prod(tree.shape / tree.size.max())
    depth = MAX_DEPTH if first * 8**MAX_DEPTH <= MAX_FINEST_CELLS else MAX_DEPTH - 1
    return leaves[tree.size[leaves] * 2**depth > tree.size.max()]


def _presplit(tree: Octree, field: Field, cosine: float | None) -> Octree:
    for _ in range(PRESPLIT_LEVELS):
        flagged = find_coarse_leaves(tree, field, cosine) & (tree.size * 2 ** (PRESPLIT_LEVELS + 1) > tree.size.max())
        if not flagged.any():
            break
        tree = octree.split_leaves(tree, flagged)
    return tree


def _explain_failure(field: Field, layer: LevelSetFit) -> str:
    where = layer.tree.points(layer.tree.origin[layer.bad] + 0.5 * layer.tree.size[layer.bad][:, None])
    gradient = field.gradient(where)
    slope = np.linalg.norm(gradient, axis=1)
    size = layer.tree.size[layer.bad][:, None] * layer.tree.step
    at_box = (where - size < layer.tree.lo) | (where + size > layer.tree.hi)
    level = np.linalg.norm(np.where(at_box, 0.0, gradient), axis=1)
    usual = np.median(np.linalg.norm(field.gradient(layer.net.vertices), axis=1))
    places = ", ".join("(" + ", ".join(f"{x:.4g}" for x in p) + ")" for p in where[np.argsort(slope)][:3])
    if slope.min() < SINGULAR_SLOPE_FRACTION * usual:
        cause = "the field is nearly singular there: change the level, the transition or the minimum neck"
    elif (at_box.any(axis=1) & (level < SINGULAR_SLOPE_FRACTION * usual)).any():
        cause = "the surface touches the box there without crossing it: move the domain or change the level"
    else:
        cause = "the surface turns too fast for the depth allowed: use a looser tol, or a smoother field"
    return f"{len(where)} places could not be fitted within the request ({layer.failure_text}), near {places}; {cause}"


def _choose_leaf_size(field: Field, samples: Array) -> float:
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
    return LEAF_SIZE_TIMES_CURVATURE / float(np.quantile(np.linalg.norm(bend, ord=2, axis=(1, 2)), CURVATURE_QUANTILE))


def _count_leaves(field: Field, lo: Array, hi: Array, size: float) -> IntArray:
    """Leaves along each axis, none longer than size; a whole number to a period, so that periods are laid out alike."""
    leaf = np.full(3, size)
    periods = field.periods()
    if periods is not None:
        leaf = np.array(periods) / np.ceil(np.array(periods) / size - 1e-6)
    return np.maximum(2, np.ceil((hi - lo) / leaf - 1e-6)).astype(np.int64)
