"""Adaptive search for the coarsest octree on which a level set can be fitted within the tolerance.

1. *Starts.* Uniform octrees of several leaf sizes are meshed and split a few times where polygons fold. They are ranked by the
   number of patches that they promise; an octree split by normal cones is the last resort.
2. *Unfolding.* A mesh costs a small fraction of a fit, so leaves are split first until no polygon is left that no fit could save.
3. *Early simplification.* A mesh finer than the tolerance asks is split where it has to be, simplified, and only then fitted
   (`fine_meshes`).
4. *Refinement.* The mesh is fitted. The bad leaves of the fit are split, and the refined mesh is fitted again with the patches
   reused that passed, until all pass or refinement stalls; then the next start is tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import LevelSetError, format_point
from tpmscad.fields.field import Field
from tpmscad.levelset.boundary_level_sets import measure_shape_operators
from tpmscad.levelset.fine_meshes import find_missed_leaves, fit_risky_polygons, is_finer_than_asked
from tpmscad.levelset.fit_simplification import fit_simplified_mesh
from tpmscad.levelset.level_set_fit import FitRequest, LevelSetFit, fit_level_set, locate_leaves, mesh_level_set
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.refinement import find_coarse_leaves
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import count_patches
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR, normalize

LEAF_SIZE_TIMES_CURVATURE = 1.5
CURVATURE_QUANTILE = 0.7
"""The first leaf size times this quantile of the level set's curvature: about four leaves to a period of the gyroid."""

CURVATURE_STEP_FRACTION = 1e-3
"""Step of the finite differences for the curvature, as a fraction of the level set's extent."""

LEAF_SIZE_DIVISORS = (1.0, 0.8, 1.25, 1.6, 2.0)
"""Leaf sizes of the starts, as divisors of the first one: the position of the leaves relative to the necks changes the number of
patches by up to a half."""

MAX_FIRST_LEAVES = 2**18
"""Largest number of leaves of a first octree: 16 periods a side. One small ball in a large box would ask for millions, of which
all but a few are empty; its leaves are split instead."""

PRESPLIT_LEVELS = 3
"""Largest number of splits of a leaf before the first mesh, for hidden crossings or normal cones."""

MIN_CONE_COSINE = 0.5
"""Cosine of the half-angle of the normal cone of a leaf in the last start."""

MAX_DEPTH = 5
MAX_DEPTH_OF_FEW = 10
MAX_DEEP_FRACTION = 0.02
"""Largest number of splits of a first leaf, and that of leaves which are at most this fraction of all: single places of high
curvature take little, an edge too sharp for any patch would take without end."""

MAX_MESHES_BEFORE_FIT = 8
MAX_FITS_PER_START = 12
MAX_SPLITS_BEFORE_SIMPLIFYING = 20
MAX_IDLE_FITS = 2
MAX_STARTS = 5

TRIAL_MESHES = 2
"""Meshes of a start before the starts are compared."""

PATCHES_PER_BAD_LEAF = 30
"""Patches that a leaf still bad when starts are compared is expected to cost in the end."""

MAX_BAD_LEAF_FRACTION = 0.15
"""Largest fraction of leaves that the best fit may find bad before the start is given up."""

MAX_HOPELESS_PATCHES = 20_000
HOPELESS_BAD_FRACTION = 0.01
"""Patches of starts that may end with more than this fraction of their leaves bad before the search is given up. Small starts
fail so where finer ones pass; large ones cost half a minute each, and those after which another passes leave a few leaves bad."""

SINGULAR_SLOPE_FRACTION = 0.15
"""A gradient shorter than this fraction of the median is reported as the cause of a failure."""

NEAR_BOX_LEAVES = 0.05
"""In edges of a leaf: distance from the box at which a surface that cannot be fitted may touch it."""

CREASE_NEIGHBOURS, CREASE_HALVINGS = 9, 5
MIN_CREASE_DEG, CREASE_ANGLE_FRACTION = 5.0, 0.25
"""Nearest samples that normals are compared with, halvings of the distance of the two that differ most, and the angle between
these that is left at a crease, in degrees and of the first one: of a smooth surface a thirty-second is. Differences of functions
blur finer steps."""

N_PLACES_REPORTED = 3

COUNT_TOL = 1e-6
"""Leaves by which a length may exceed a whole number of them without another: round-off of the quotient."""

MIN_LEAVES_PER_AXIS = 2
"""Least number of leaves along an axis of the box: the dual mesh has vertices in inner leaves and in border leaves."""

SHARP_QUANTILE = 0.995
MAX_LEAF_ASPECT = 2.0
"""Largest ratio of the edges of a first leaf in a flat box, if the leaf size for this quantile of the curvature is less than the
box's shortest edge: splits keep the ratio. On the inside of a wing's skin, 1 x 2 x .15, leaves of 1 : 7 : 13 were split to 58,000
patches without an end, since at its rounded edges they are fine in one direction and coarse in another; cubes pass with 6093
patches, leaves of this ratio with 5426. Walls across a thin plate keep their long leaves."""


@dataclass(frozen=True, slots=True, eq=False)
class _MeshedTree:
    """An octree, its smoothed mesh, and the leaves that are bad and may still be split."""

    tree: Octree
    mesh: QuadMesh
    splittable: IntArray


def fit_level_set_adaptively(
    request: FitRequest, lo: Array, hi: Array, detect_hidden_crossings: bool = False
) -> LevelSetFit:
    """The fit of the level set in the box [lo, hi] on the coarsest mesh that passes; LevelSetError if none does.

    `detect_hidden_crossings`: split leaves, too, whose corners hide a crossing of the level set, which gives more patches.
    """
    best: LevelSetFit | None = None
    hopeless_patches = 0
    for start in _generate_starts(request, lo, hi, detect_hidden_crossings):
        fit = _refine_from(request, start)
        if not len(fit.bad_leaves):
            return fit
        if best is None or fit.bad_volume < best.bad_volume:
            best = fit
        if fit.bad_fraction > HOPELESS_BAD_FRACTION:
            hopeless_patches += len(fit.network.curve)
        if hopeless_patches > MAX_HOPELESS_PATCHES:
            break
    if best is None:
        raise LevelSetError(
            f"the surface at {format_point(request.surface_samples[0])} is too small to be fitted: no leaf of the octree has "
            "corners inside and outside of it; change the level, or the domain so that it holds more of the surface"
        )
    raise LevelSetError(_explain_failure(best))


def split_hidden_crossings(fit: LevelSetFit, more_samples: Array, places: Array | None = None) -> LevelSetFit:
    """The fit continued where leaves hide a crossing of the level set, patches elsewhere reused; LevelSetError if it fails.

    Of these only leaves within their size of `places` (m, 3) are split if such are given. Leaves are split as well where
    `more_samples` (n, 3) of the level set are far from its patches. Leaves finer than the fit's largest by more than
    PRESPLIT_LEVELS are split for that only.
    """
    field = fit.request.field
    tree = _presplit(fit.tree, field, None, places)
    if tree is fit.tree and not len(more_samples):
        return fit
    request = replace(fit.request, surface_samples=np.concatenate([fit.request.surface_samples, more_samples]))
    start = _split_until_unfolded(field, _mesh_tree(tree, field, None if fit.is_simplified else fit.mesh))
    refined = _refine_from(request, start, fit)
    if len(refined.bad_leaves):
        raise LevelSetError(_explain_failure(refined))
    return refined


def _generate_starts(request: FitRequest, lo: Array, hi: Array, detect_hidden_crossings: bool) -> Iterator[_MeshedTree]:
    """Meshes to start from, those first that promise the fewest patches; none if the level set lies between all corners.

    The first leaf size comes before all others if nothing had to be split.
    """
    field = request.field
    size = _choose_leaf_size(field, request.surface_samples, float((hi - lo).min()))
    sketches: list[_MeshedTree] = []
    seen: set[tuple[int, ...]] = set()
    for divisor in LEAF_SIZE_DIVISORS:
        counts = _count_leaves(field, lo, hi, size / divisor)
        if tuple(counts) in seen:
            continue
        seen.add(tuple(counts))
        tree = octree.uniform_octree(lo, hi, counts)
        if detect_hidden_crossings:
            tree = _presplit(tree, field, None)
        found = _split_until_found(request, _mesh_tree(tree, field))
        if found is None:
            continue
        sketch = _split_until_unfolded(field, found, TRIAL_MESHES)
        unsplit = sketch.tree.size.max() == 1 and not len(sketch.splittable)
        if divisor == LEAF_SIZE_DIVISORS[0] and unsplit:
            yield sketch
        else:
            sketches.append(sketch)
    for sketch in sorted(sketches, key=_estimate_patches)[:MAX_STARTS]:
        yield _split_until_unfolded(field, sketch)
    tree = _presplit(octree.uniform_octree(lo, hi, _count_leaves(field, lo, hi, size)), field, MIN_CONE_COSINE)
    if (found := _split_until_found(request, _mesh_tree(tree, field))) is not None:
        yield _split_until_unfolded(field, found)


def _refine_from(request: FitRequest, start: _MeshedTree, previous: LevelSetFit | None = None) -> LevelSetFit:
    """The best fit of those that splitting bad leaves leads to, with patches of a `previous` fit where they remain."""
    if is_finer_than_asked(request, start.tree, start.mesh):
        start = _split_risky_leaves(request, start)
        fit = fit_simplified_mesh(request, start.tree, start.mesh)
        if not len(fit.bad_leaves):
            return fit
        # what fails now fails unmerged: all patches take less time than another simplification and its undoing
        leaves = _select_splittable(start.tree, fit.bad_leaves)
        start = _mesh_tree(octree.split_leaves(start.tree, leaves), request.field, start.mesh)
    fit = fit_level_set(request, start.tree, start.mesh, previous)
    best, stalled, fewest = fit, 0, len(fit.bad_leaves)
    for _ in range(MAX_FITS_PER_START - 1):
        deeper = _select_splittable(start.tree, fit.bad_leaves)
        if not len(deeper) or best.bad_fraction > MAX_BAD_LEAF_FRACTION:
            break
        refined = _mesh_tree(octree.split_leaves(start.tree, deeper), request.field, start.mesh)
        start = _split_until_unfolded(request.field, refined)
        fit = fit_level_set(request, start.tree, start.mesh, fit)
        if not len(fit.bad_leaves):
            return fit
        # a split may turn larger neighbouring leaves bad, so fewer bad leaves count as progress, too
        improved = fit.bad_volume < best.bad_volume
        stalled = 0 if improved or len(fit.bad_leaves) < fewest else stalled + 1
        fewest = min(fewest, len(fit.bad_leaves))
        if improved:
            best = fit
        elif stalled == MAX_IDLE_FITS:
            break
    return best


def _split_risky_leaves(request: FitRequest, start: _MeshedTree) -> _MeshedTree:
    """The octree split where the mesh misses parts of the level set, or has polygons of poor shape that cannot be fitted."""
    fit: LevelSetFit | None = None
    for _ in range(MAX_SPLITS_BEFORE_SIMPLIFYING):
        fit = fit_risky_polygons(request, start.tree, start.mesh, fit)
        missed = find_missed_leaves(start.tree, start.mesh, request.surface_samples)
        bad = np.concatenate([start.splittable, missed, start.splittable if fit is None else fit.bad_leaves])
        leaves = _select_splittable(start.tree, np.unique(bad))
        if not len(leaves):
            break
        start = _mesh_tree(octree.split_leaves(start.tree, leaves), request.field, start.mesh)
    return start


def _mesh_tree(tree: Octree, field: Field, coarser: QuadMesh | None = None) -> _MeshedTree:
    """An octree with its mesh, which reuses the vertices of the mesh of a coarser octree."""
    mesh, bad = mesh_level_set(tree, field, coarser)
    return _MeshedTree(tree, mesh, _select_splittable(tree, bad))


def _split_until_found(request: FitRequest, start: _MeshedTree) -> _MeshedTree | None:
    """The octree split round samples of the level set until its mesh is not empty, None if it stays so.

    A small level set, such as one pore beside a large wall, may lie between the corners of the first leaves.
    """
    field, samples = request.field, request.surface_samples
    while not len(start.mesh.corners):
        tree = start.tree
        within = ((samples >= tree.lo) & (samples <= tree.hi)).all(axis=1)
        leaves = _select_splittable(tree, np.unique(locate_leaves(tree, samples[within])))
        if not len(leaves):
            return None
        start = _mesh_tree(octree.split_leaves(tree, leaves), field)
    return start


def _split_until_unfolded(field: Field, start: _MeshedTree, max_meshes: int = MAX_MESHES_BEFORE_FIT) -> _MeshedTree:
    """The octree split where polygons are hopeless, until its mesh is worth a fit."""
    for _ in range(max_meshes - 1):
        if not len(start.splittable):
            break
        start = _mesh_tree(octree.split_leaves(start.tree, start.splittable), field, start.mesh)
    return start


def _estimate_patches(sketch: _MeshedTree) -> int:
    """Number of patches that a sketch promises."""
    return int(count_patches(sketch.mesh.corners).sum()) + PATCHES_PER_BAD_LEAF * len(sketch.splittable)


def _select_splittable(tree: Octree, leaves: IntArray) -> IntArray:
    """Those of the leaves that may be split: above the greatest depth, and of deeper ones a few."""
    first = tree.size.max()
    shallow = tree.size[leaves] * 2**MAX_DEPTH > first
    few = np.count_nonzero(~shallow) <= MAX_DEEP_FRACTION * len(tree.size)
    return leaves[shallow | (few & (tree.size[leaves] * 2**MAX_DEPTH_OF_FEW > first))]


def _presplit(tree: Octree, field: Field, cosine: float | None, places: Array | None = None) -> Octree:
    """The octree split where it is too coarse by `find_coarse_leaves`, and near `places` (n, 3) if these are given."""
    for _ in range(PRESPLIT_LEVELS):
        flagged = find_coarse_leaves(tree, field, cosine) & (tree.size * 2 ** (PRESPLIT_LEVELS + 1) > tree.size.max())
        if places is not None:
            leaves = np.flatnonzero(flagged)
            distance, _ = cKDTree(places).query(tree.leaf_centres(leaves))
            flagged[leaves] = distance < tree.size[leaves] * tree.cell_edges.max()
        if not flagged.any():
            break
        tree = octree.split_leaves(tree, flagged)
    return tree


def _choose_leaf_size(field: Field, samples: Array, shortest_edge: float) -> float:
    """Leaf size for the curvature of most of the level set, by differences of the gradient at samples (n, 3) of it.

    In a box with a short edge it is limited where the level set has places so curved that leaves will be split to less than that.
    """
    step = CURVATURE_STEP_FRACTION * float(np.ptp(samples, axis=0).max())
    curvature = np.linalg.norm(measure_shape_operators(field, samples, step), ord=2, axis=(1, 2))
    common, sharpest = (
        LEAF_SIZE_TIMES_CURVATURE / max(float(np.quantile(curvature, q)), MIN_DIVISOR)
        for q in (CURVATURE_QUANTILE, SHARP_QUANTILE)
    )
    return min(common, MAX_LEAF_ASPECT * max(sharpest, shortest_edge / MIN_LEAVES_PER_AXIS))


def _count_leaves(field: Field, lo: Array, hi: Array, size: float) -> IntArray:
    """Number of leaves (3,) along each axis, none longer than `size` unless there were too many, a whole number to a period."""
    leaf = np.full(3, size)
    periods = field.periods()
    if periods is not None:
        leaf = np.array(periods) / np.ceil(np.array(periods) / size - COUNT_TOL)
    counts = np.maximum(MIN_LEAVES_PER_AXIS, np.ceil((hi - lo) / leaf - COUNT_TOL))
    excess = float(np.prod(counts)) / MAX_FIRST_LEAVES
    if excess > 1.0:
        return _count_leaves(field, lo, hi, size * max(np.cbrt(excess), 1.01))
    return counts.astype(np.int64)


def _reaches_box(fit: LevelSetFit) -> BoolArray:
    """Along which axes (n, 3) the surface comes near the box in each bad leaf, by its samples."""
    tree, samples = fit.tree, fit.request.surface_samples
    gap = np.full((len(tree.size), 3), np.inf)
    np.minimum.at(gap, locate_leaves(tree, samples), np.minimum(samples - tree.lo, tree.hi - samples))
    return np.asarray((gap <= NEAR_BOX_LEAVES * tree.size[:, None] * tree.cell_edges)[fit.bad_leaves])


def _find_crease(fit: LevelSetFit) -> tuple[Array, float] | None:
    """A point (3,) on the surface in the bad leaves where its normal jumps, and the angle in degrees; None if it does not."""
    field, samples = fit.request.field, fit.request.surface_samples
    near = samples[np.isin(locate_leaves(fit.tree, samples), fit.bad_leaves)]
    if len(near) < 2:
        return None
    pair = cKDTree(near).query(near, min(CREASE_NEIGHBOURS, len(near)))[1]
    normals = normalize(field.gradient(near))
    cosine = (normals[pair] @ normals[:, :, None])[..., 0]
    first, k = np.unravel_index(np.argmin(cosine), cosine.shape)
    ends = near[[first, pair[first, k]]]
    least = max(MIN_CREASE_DEG, CREASE_ANGLE_FRACTION * _measure_turn(field, ends))
    for _ in range(CREASE_HALVINGS):
        step = np.array([np.linalg.norm(ends[1] - ends[0])])
        middle = project_to_level_set(field, ends.mean(axis=0)[None], np.zeros((1, 3), bool), step)
        a, m, b = normalize(field.gradient(np.concatenate([ends[:1], middle, ends[1:]])))
        ends = np.concatenate([ends[:1], middle] if a @ m < m @ b else [middle, ends[1:]])
    angle = _measure_turn(field, ends)
    return (ends[0], angle) if angle > least else None


def _measure_turn(field: Field, ends: Array) -> float:
    """The angle in degrees between the normals at two points (2, 3)."""
    one, other = normalize(field.gradient(ends))
    return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))


def _explain_failure(fit: LevelSetFit) -> str:
    """Where a fit fails, why, and what to change, as an error message."""
    field, tree, bad = fit.request.field, fit.tree, fit.bad_leaves
    centre = tree.leaf_centres(bad)
    gradient = field.gradient(centre)
    slope = np.linalg.norm(gradient, axis=1)
    at_box = _reaches_box(fit)
    slope_in_box_face = np.linalg.norm(np.where(at_box, 0.0, gradient), axis=1)
    singular = SINGULAR_SLOPE_FRACTION * np.median(np.linalg.norm(field.gradient(fit.network.vertices), axis=1))
    flattest = centre[np.argsort(slope)][:N_PLACES_REPORTED]
    places = ", ".join(format_point(p) for p in flattest)
    crease = None if slope.min() < singular else _find_crease(fit)
    if slope.min() < singular:
        cause = "the field is nearly singular there: change the level, the transition or the minimum neck"
    elif crease is not None:
        places = format_point(crease[0])
        cause = (
            f"the surface has a crease of {crease[1]:.0f} degrees there, which smooth patches cannot follow: combine fields by "
            "fields.union, fields.intersection and fields.difference, whose creases are exact, not by max, min and abs in a "
            "formula or a function; or round it"
        )
    elif (at_box.any(axis=1) & (slope_in_box_face < singular)).any():
        cause = "the surface touches the box there without crossing it: move the domain or change the level"
    else:
        cause = "the surface turns too fast for the depth allowed: use a looser tol, or a smoother field"
    return f"{len(bad)} places could not be fitted within the request ({fit.failure_text}), near {places}; {cause}"
