"""Lattices under a coordinate map: every patch is fitted to the mapped exact surface, offset along the mapped normal.

Patches that the map leaves congruent, as the cells of a ring are, form a class that is fitted, measured and stored once. A ring
repeats its cell by a rotation, a screw by a screw motion, a stretched lattice by translations; nothing is assumed about the map.
Samples of all patches on one grid of parameters are compared. Distances between a few samples, which rigid motions keep, separate
nearly all classes; within a class the best rigid motion is computed (Kabsch), and patches that it misses, mirror images above
all, are compared with each other in the same way. The control nets are those of `g2_fit`: each class is fitted on its own, by
CPIA under conditions that make neighbours join with curvature continuity. Where the map closes, the patches at both ends are
neighbours like any others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.welding import SideMismatch, cluster_points
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.lattices import g2_fit
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.lattices.copies import SEARCH_MARGIN_CELLS, cell_origins, find_open_sides, ruled_surface, translate_motions
from tpmscad.lattices.mapped_deviation import (
    PATCHES_AT_ONCE,
    MeasuredPatches,
    SampledPatches,
    measure_patches,
    sample_layers,
)
from tpmscad.lattices.mapped_surface import MappedSurface
from tpmscad.lattices.offset_surfaces import Layers, LayersFit, PlacedFaces, place_faces
from tpmscad.lattices.smooth_gradings import smooth_gradings
from tpmscad.rigid_motion import Motion, match_points
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.cpia import NetConvergence
from tpmscad.surfaces import PatchSymmetry, SurfacePatch

SPLINE_SPACES = ((1, 9), (1, 10), (1, 11), (1, 12), (2, 9), (2, 10), (2, 12))
"""Spans along each parameter and degrees in the order of trial; all patches of a lattice take the same, so that borders share
their spline space. Two spans of degree 10 are as near as one of 12 to 14, whose poles lie far off where a wall bends."""

CONGRUENCE_SAMPLES_PER_PARAMETER = 13
"""Samples along each parameter at which patches are compared."""

CURVATURE_SAMPLES_PER_PARAMETER = 9
"""Samples along each parameter of a patch at which its curvature is found."""

COARSE_SAMPLES = 3
"""The same for the first look at all patches."""

NORMAL_STEP = 1e-4
"""Step of the parameters by which normals are differenced."""

HARD_PATCHES = 64
"""Patches that are farthest off in one spline space, and tried in the next ones before all others."""

MOST_BENT = 2
"""Patches, those over which the map bends most, that are fitted before all others."""

MAX_DEVIATION_CELLS = 0.1
"""Deviation, in cells, beyond which a fit is no image of the surface: its patches oscillate."""

PATCH_BULGE_FRACTION = 0.125
"""Part of its extent by which a patch bulges at most between samples."""

FLATNESS_TOL_FRACTION = 1e-9
"""A side of the box counts as flat if its image spreads by less than this fraction of the box."""


def map_box(map: Map, size: Array) -> tuple[Array, Array]:
    """Corners (3,), (3,) of the image of the box from the origin to `size`, an axis-aligned box.

    InvalidRequest if the map bends or tilts a face of the box: flat caps then have no plane.
    """
    t = np.linspace(0.0, 1.0, 9)
    a, b = (g.ravel() for g in np.meshgrid(t, t))
    bounds = np.empty((2, 3))
    for axis in range(3):
        for end in (0, 1):
            on_face = np.insert(np.stack([a, b], axis=1), axis, float(end), axis=1) * size
            image = map(on_face)[:, axis]
            if np.ptp(image) > FLATNESS_TOL_FRACTION * size.max():
                raise InvalidRequest(
                    f"{map.name} does not keep the box's {'lower' if end == 0 else 'upper'} {'xyz'[axis]} side flat and "
                    f"square to {'xyz'[axis]} (it spreads over {np.ptp(image):.3g}), nor does it turn the box about an axis: "
                    "use boundary='natural'"
                )
            bounds[end, axis] = image.mean()
    return bounds.min(axis=0), bounds.max(axis=0)


def select_placements_near_box(
    patch: SurfacePatch,
    symmetry: PatchSymmetry,
    map: Map,
    box: tuple[Array, Array],
    first: Array,
    cells: tuple[int, int, int],
    phase: Array,
    cell: float,
    reach: float,
) -> Motion:
    """The placements whose mapped mid patch comes within `reach` of the box, among those of the cells from `first` on.

    The map must be valid a cell beyond the lattice.
    """
    placements = translate_motions(
        symmetry.cell_motions, first + cell_origins(cells, SEARCH_MARGIN_CELLS) + (phase - np.floor(phase))
    )
    points = sample_placements(patch, placements)
    near = ((points.max(axis=1) > first - 0.5) & (points.min(axis=1) < first + np.array(cells) + 0.5)).all(axis=1)
    image = map(cell * points[near])
    margin = reach + PATCH_BULGE_FRACTION * np.ptp(image, axis=1).max()
    inside = ((image.max(axis=1) > box[0] - margin) & (image.min(axis=1) < box[1] + margin)).all(axis=1)
    return placements[np.flatnonzero(near)[inside]]


def sample_placements(patch: SurfacePatch, placements: Motion) -> Array:
    """Points (n, 49, 3) of the placed mid patches, in cells."""
    t = np.linspace(0.0, 1.0, 7)
    u, v = (g.ravel() for g in np.meshgrid(t, t))
    return placements[:, None].apply(patch.jet(u, v).position)


def select_placements_in_lattice(
    patch: SurfacePatch,
    symmetry: PatchSymmetry,
    cells: tuple[int, int, int],
    phase: Array,
    margin: float,
    closed: tuple[bool, bool, bool],
    inscribed: float = 0.0,
) -> Motion:
    """The placements whose mid patch comes within `margin` cells of the box in lattice coordinates, once around closed axes.

    Given the radius `inscribed` (cells), only those near the cylinder about the middle line of the box along z.
    """
    axes = [
        np.arange(n) if c else np.arange(-SEARCH_MARGIN_CELLS, n + SEARCH_MARGIN_CELLS)
        for n, c in zip(cells, closed, strict=True)
    ]
    origins = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    placements = translate_motions(symmetry.cell_motions, origins + (phase - np.floor(phase)))
    points = sample_placements(patch, placements)
    margin = margin + PATCH_BULGE_FRACTION * float(np.ptp(points, axis=1).max())
    inside = (points.max(axis=1) > -margin) & (points.min(axis=1) < np.array(cells) + margin)
    keep = (inside | np.array(closed)).all(axis=1)
    if inscribed:
        from_middle = np.hypot(points[..., 0] - cells[0] / 2, points[..., 1] - cells[1] / 2)
        keep &= from_middle.min(axis=1) < inscribed + margin
    return placements[np.flatnonzero(keep)]


@dataclass(frozen=True, slots=True, eq=False)
class MappedLayer:
    """A fitted offset surface: the patch of placement i is patches[label[i]] moved by motion[i]."""

    patches: list[BSplineSurface]
    label: IntArray
    motion: Motion

    def patch(self, index: int) -> BSplineSurface:
        """The patch of one placement."""
        return self.patches[self.label[index]].moved(self.motion[index])


MappedLayers = tuple[MappedLayer | None, MappedLayer | None]
"""The lower and the upper fitted surface; None where there is no surface."""


def fit_mapped_layers(
    mapped: MappedSurface,
    distances: Layers,
    tol: float,
    progress: Callable[[float], None] = lambda done: None,
) -> LayersFit[MappedLayers]:
    """Fit the lower and upper surface at their normal distances (model units; None: no surface).

    The result is in the first of SPLINE_SPACES in which every patch meets `tol`, or in the last one: compare the deviation.
    InvalidRequest if even that deviates by a tenth of a cell.
    """
    given = [d for d in distances if d is not None]
    mapped, error, notes = smooth_gradings(mapped, given, tol)
    classes = group_congruent_patches(mapped, given)
    every = hard = SampledPatches.of(mapped, given, classes.first, 1)
    for number, (spans, degree) in enumerate(SPLINE_SPACES):
        hopeful = True
        if number + 1 < len(SPLINE_SPACES) and len(hard.placement) < len(every.placement):
            hard = hard.divide(mapped, given, spans)
            hopeful = _fit_in_space(mapped, given, hard, degree)[1].deviation.moved(error).max <= tol
        if hopeful:
            every = every.divide(mapped, given, spans)
            fits, measured = _fit_in_space(mapped, given, every, degree)
            deviation = measured.deviation.moved(error)
            hard = every.select(np.argsort(-measured.estimates)[:HARD_PATCHES])
        progress((number + 1) / len(SPLINE_SPACES))
        if deviation.max <= tol:
            break
    layers = [MappedLayer([g2_fit.join_pieces(p) for p in poles], classes.label, classes.motion) for poles, _ in fits]
    if deviation.max > max(tol, MAX_DEVIATION_CELLS * mapped.cell):
        worst = find_most_bent(mapped, 1)
        raise InvalidRequest(
            f"under {mapped.map.name} the patches deviate by {deviation.max:.3g} from the surface, more than a tenth of the "
            f"cell, most {describe_cell(mapped, int(worst[0]))}: the map, or the graded wall, bends too sharply for one patch, "
            "as near the axis of a cylinder; use a larger radius, smaller cells, or a map and a wall that vary less over a cell"
        )
    fitted = iter(layers)
    lower, upper = (None if d is None else next(fitted) for d in distances)
    convergence = NetConvergence.worst(c for _, c in fits)
    return LayersFit((lower, upper), deviation, convergence=convergence, notes=notes)


def _fit_in_space(
    mapped: MappedSurface, distances: Sequence[float], samples: SampledPatches, degree: int
) -> tuple[list[tuple[Array, NetConvergence]], MeasuredPatches]:
    """Of each layer the Bezier poles of all pieces of patches and their convergence, and how far all are from the surface."""
    fits = [g2_fit.fit_g2_patches(nodes, degree) for nodes in samples.nodes]
    return fits, measure_patches(mapped, distances, samples, [poles for poles, _ in fits])


def group_congruent_patches(mapped: MappedSurface, distances: Sequence[float]) -> CongruenceClasses:
    """Classes of congruent patches of the offset surfaces, by samples that reach as far beyond the patch as those of the fit."""
    t = 0.5 + (0.5 + g2_fit.SAMPLE_OVERHANG) * np.linspace(-1.0, 1.0, CONGRUENCE_SAMPLES_PER_PARAMETER)
    samples = np.concatenate(sample_layers(mapped, t, distances, np.arange(len(mapped.placements))), axis=1)
    return group_congruent(samples.reshape(len(samples), -1, 3))


def find_most_bent(mapped: MappedSurface, count: int) -> IntArray:
    """The placements over which the Jacobian of the map changes most, relative to that in their middle: (count,) or fewer."""
    t = np.array([0.5, 0.0, 1.0])
    u, v = (g.ravel() for g in np.meshgrid(t, t, indexing="ij"))
    lattice = mapped.cell * mapped.placements[:, None].apply(mapped.patch.jet(u, v).position)
    jacobian = mapped.map.jacobian(lattice, mapped.cell)
    change = np.linalg.norm(jacobian @ np.linalg.inv(jacobian[:, :1]) - np.eye(3), axis=(-2, -1)).max(axis=1)
    return np.argsort(-change)[:count]


def describe_cell(mapped: MappedSurface, index: int) -> str:
    """Where a placement is in the model, and how long the edges of the cell are there, in words."""
    middle = mapped.points(np.array([0.5]), np.array([0.5]), index)
    jacobian = mapped.map.jacobian(middle.lattice, mapped.cell)[0]
    edges = " x ".join(f"{edge:.3g}" for edge in mapped.cell * np.linalg.norm(jacobian, axis=0))
    return f"near {format_point(middle.position[0])}, where a cell measures {edges}"


def require_patches_that_bend(
    mapped: MappedSurface, distances: Layers, offsets: Sequence[float], name: str, tol: float
) -> None:
    """InvalidRequest, with the place, if cells are too large for the bends of the map: told before all patches are fitted.

    A few samples of all patches are compared with their curvature, and the patches over which the map bends most are fitted.
    `distances` are those of `fit_mapped_layers`, `offsets` and `name` those of `require_offsets_below_curvature_radius`.
    """
    require_offsets_below_curvature_radius(mapped, offsets, name, COARSE_SAMPLES)
    fit_mapped_layers(replace(mapped, placements=mapped.placements[find_most_bent(mapped, MOST_BENT)]), distances, tol)


def find_greatest_reach(
    mapped: MappedSurface, offsets: Sequence[float], samples: int = CURVATURE_SAMPLES_PER_PARAMETER
) -> tuple[float, int]:
    """The greatest of the offsets in local radii of curvature of the mapped mid surface, sampled, and the placement that has it.

    It stays below 1; beyond, only points in the body count, if there is one. The curvature is the derivative of the exact normals
    by central differences: their error is far below what lies between the samples.
    """
    u, v = (g.ravel() for g in np.meshgrid(*[np.linspace(0, 1, samples)] * 2))
    largest, worst = 0.0, 0
    for start in range(0, len(mapped.placements), PATCHES_AT_ONCE):
        index = np.arange(start, min(start + PATCHES_AT_ONCE, len(mapped.placements)))
        here, h = mapped.points(u, v, index), NORMAL_STEP
        by_u = (mapped.points(u + h, v, index).normal - mapped.points(u - h, v, index).normal) / (2 * h)
        by_v = (mapped.points(u, v + h, index).normal - mapped.points(u, v - h, index).normal) / (2 * h)
        tangents = np.stack([here.du, here.dv], axis=-1)
        dual = np.linalg.inv(np.swapaxes(tangents, -1, -2) @ tangents) @ np.swapaxes(tangents, -1, -2)
        curvature = np.linalg.norm(np.stack([by_u, by_v], axis=-1) @ dual, ord=2, axis=(-2, -1))
        unit, centre = mapped.grading(here.position)
        reach = curvature * np.abs([centre + d * unit for d in offsets]).max(axis=0)
        if mapped.in_body is not None:
            sharp = reach >= 1.0
            reach[sharp] *= mapped.in_body(here.position[sharp])
        if reach.max() > largest:
            largest = float(reach.max())
            worst = int(index[np.argmax(reach.max(axis=1))])
    return largest, worst


def require_offsets_below_curvature_radius(
    mapped: MappedSurface, offsets: Sequence[float], name: str, samples: int = CURVATURE_SAMPLES_PER_PARAMETER
) -> None:
    """InvalidRequest if an offset is not below the least radius of curvature; `name` is that of the surface in the message."""
    reach, index = find_greatest_reach(mapped, offsets, samples)
    if reach < 1:
        return
    if mapped.is_graded:
        raise InvalidRequest(
            f"the graded wall reaches beyond the curvature radius of the {name}, {describe_cell(mapped, index)}, by the "
            f"factor {reach:.3g}: make it thinner there, or take larger cells"
        )
    worst = max(offsets, key=abs)
    limit = abs(worst) / reach
    raise InvalidRequest(
        f"offset {worst:g} passes the least curvature radius of the {name}, {limit:.6g} {describe_cell(mapped, index)}: "
        f"offsets stay below it, a symmetric wall's thickness below {2 * limit:.6g}; larger cells have larger radii"
    )


def assemble_mapped_lattice(
    mapped: MappedSurface, lower: MappedLayer | None, upper: MappedLayer | None, *, natural: bool
) -> Brep:
    """The layers as one Brep: closed by ruled gap faces along the border if `natural`, open otherwise.

    InvalidRequest if neighbouring patches do not meet, because the map bends too sharply for their degree.
    """
    orientation = mapped.symmetry.handedness * mapped.orientation()
    carriers: list[BSplineSurface] = []
    parts = []
    for layer, outward, tag in ((lower, -1, "offset-"), (upper, 1, "offset+")):
        if layer is not None:
            parts.append(place_faces(len(carriers) + layer.label, layer.motion, outward * orientation, tag))
            carriers += layer.patches
    if natural:
        if lower is None or upper is None:
            raise ValueError("a natural boundary bridges two surfaces; a skeletal solid has one")
        open_at = list(zip(*find_open_sides(mapped.symmetry, mapped.placements, mapped.periods), strict=True))
        n = len(open_at)
        parts.append(place_faces(len(carriers) + np.arange(n), Motion.identity(n), orientation, "gap"))
        carriers += [ruled_surface(lower.patch(p).side(s), upper.patch(p).side(s)) for p, s in open_at]
    try:
        return PlacedFaces.concatenate(parts).weld(carriers)
    except SideMismatch as mismatch:
        raise InvalidRequest(
            f"under {mapped.map.name} neighbouring patches near {format_point(mismatch.place)} differ by "
            f"{mismatch.gap:.3g} along their common side, more than {mismatch.limit:.3g}: the map, or the graded wall, bends too "
            "sharply there for one patch, as near a branch point; keep the lattice away from there, take smaller cells, or use a "
            "map and a wall that vary less over a cell"
        ) from mismatch


CONGRUENCE_TOL_FRACTION = 1e-11
"""Samples that agree to this fraction of a patch's extent after a rigid motion belong to congruent patches: above the round-off
of maps (1e-14) and of the differences that give a user's map its normals (1e-12)."""

SIGNATURE_POINTS = 7
"""Samples whose mutual distances separate the classes."""


@dataclass(frozen=True, slots=True, eq=False)
class CongruenceClasses:
    """Classes of patches up to proper rigid motions.

    `first` (n,) is the first patch of each class; patch i is patch first[label[i]] moved by `motion[i]`.
    """

    first: IntArray
    label: IntArray
    motion: Motion


def group_congruent(samples: Array) -> CongruenceClasses:
    """Classes of patches by their samples (P, m, 3) at common parameters, any number of points each."""
    count = len(samples)
    tol = CONGRUENCE_TOL_FRACTION * float(np.ptp(samples[0], axis=0).max())
    chosen = samples[:, np.linspace(0, samples.shape[1] - 1, SIGNATURE_POINTS).astype(int)]
    i, j = np.triu_indices(SIGNATURE_POINTS, 1)
    distances = np.linalg.norm(chosen[:, i] - chosen[:, j], axis=2)
    label, first = cluster_points(distances, 10 * tol)
    motion = match_points(samples[first[label]], samples)
    missed = np.flatnonzero(np.abs(motion[:, None].apply(samples[first[label]]) - samples).max(axis=(1, 2)) > 10 * tol)
    if len(missed):
        others = group_congruent(samples[missed])
        label[missed] = len(first) + others.label
        motion.rotation[missed], motion.translation[missed] = others.motion.rotation, others.motion.translation
        first = np.concatenate([first, missed[others.first]])
    own = first[label] == np.arange(count)
    motion.rotation[own], motion.translation[own] = np.eye(3), 0.0
    return CongruenceClasses(first, label, motion)
