"""The part of a field's solid that is deeper than a skin, as patches.

The distance from the body's boundary is sampled on a grid, exactly from triangles of its patches, and interpolated by a cubic
spline; its level set at the depth of the skin is fitted like any other. Ridges of the distance, where two sides of the body are
equally near, are rounded by the spline over about a spacing, which makes the skin thicker there. Parts of the cavity smaller than
a few spacings are left solid. The thickness is measured afterwards, from points of the cavity's patches to their feet on the
patches of the body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter, label
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, spline_faces
from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.errors import InvalidRequest, LevelSetError, format_point
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.fields.data.triangle_distance import TriangleTree, build_triangle_tree, grid_winding_numbers
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.sampled_data import interpolate_samples
from tpmscad.results.certificate import Check
from tpmscad.solids.combined_solids import CAP
from tpmscad.solids.field_bodies import BODY, FieldBody
from tpmscad.solids.field_patches import fit_field_patches
from tpmscad.solids.skin import MAX_THICKNESS_RATIO, MIN_THICKNESS_RATIO
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.stage_timer import StageTimer

SPACINGS_PER_SKIN = 3.0
"""Spacings of the grid in a skin."""

BAND_SPACINGS = 9.0
"""In spacings: within this of the skin's depth, distances are exact. An error of a spacing beyond it is 1e-5 of one at the depth,
as a cubic spline hands on .27 of it from sample to sample."""

MAX_SAMPLES = 3_000_000
"""Samples of the grid; a thinner skin has fewer spacings, which the thickness measured tells."""

TRIANGLE_DEVIATION = 0.002
"""In skins: deviation of the triangles from the body's patches."""

LEAST_DEPTH_SPACINGS = 0.75
"""How much deeper than the skin a part of the cavity must be, in spacings."""

LEAST_FIT_TOL, GREATEST_FIT_TOL = 0.005, 0.02
"""In skins: limits of the tolerance of the cavity's patches, between which it is that of the body's."""

TARGET_THICKNESS = 1.0
"""In skins: the least thickness of the level set that is fitted; the spline overshoots by a twentieth of a spacing at ridges, so
that the level set is taken deeper where it is less."""

THICKNESS_TOL = 0.003
"""In skins: what the least thickness of the level set may be off from that."""

MAX_CORRECTIONS = 4
"""Levels that are tried for it."""

SMOOTHING_WIDTHS = (0.0, 1.0, 2.0)
"""Widths of the Gaussian, in spacings, with which the distance is smoothed where its cavity cannot be fitted."""

PROJECTIONS = 4
"""Newton steps from crossings of grid edges to the level set."""

MARGIN_SPACINGS = 2.37
"""Spacings by which the grid reaches beyond the body; the odd part keeps grid lines out of its planes."""

SKEW = np.array([0.0137, 0.0071, 0.0])
"""In spacings: keeps grid lines apart from vertices of the triangles."""

NODES_PER_DIRECTION, NEAREST_NODES = 7, 4
"""Nodes of each patch of the body along u and v, and the number of them from which a foot point is sought."""


@dataclass(frozen=True, slots=True, eq=False)
class ErodedFieldBody:
    """The patches of what is deeper than the skin, the field that is negative there, and what was measured."""

    brep: Brep
    field: Field
    checks: tuple[Check, ...]
    notes: tuple[str, ...]


def erode_field_body(body: FieldBody, skin: float) -> ErodedFieldBody:
    """The part of a body deeper than its skin; InvalidRequest if there is none, LevelSetError if it cannot be fitted."""
    outcome = CAVITY_FITS.run(body, skin, _sample_depth(body, skin))
    if not outcome.failures:
        return outcome.value
    smoothed = f"the cavity is that of {outcome.name}, since patches of the distance itself were not fitted"
    return replace(outcome.value, notes=(*outcome.value.notes, smoothed))


def _fit_smoothed_cavity(spacings: float, body: FieldBody, skin: float, depth: _SampledDepth) -> ErodedFieldBody:
    """The cavity of the distance after a Gaussian of a width in spacings."""
    if spacings:
        depth = replace(depth, values=gaussian_filter(depth.values, spacings, mode="nearest"))
    return _fit_cavity(_find_excess(depth, skin), body, skin, depth)


CAVITY_FITS: Fallbacks[[FieldBody, float, Any], ErodedFieldBody] = Fallbacks(
    tuple(
        Fallback(f"the distance after a Gaussian of {width:g} spacings", partial(_fit_smoothed_cavity, width))
        for width in SMOOTHING_WIDTHS
    ),
    retry_on=(LevelSetError,),
)
"""Distances whose level sets are fitted, until one can be: ridges of the distance may be sharper than patches can follow. A ball
of voxels, 28 across, with a skin of a tenth of the cell: not fitted; with one spacing the skin is .99 to 1.25 of that asked."""


@dataclass(frozen=True, slots=True, eq=False)
class _SampledDepth:
    """Signed distances at the points of a grid, negative inside, its first point and its spacing, and the body's triangles.

    They are exact near the depth of the skin; elsewhere those from the nearest point of the grid on the other side.
    """

    tree: TriangleTree
    values: Array
    origin: tuple[float, float, float]
    spacing: float


def _sample_depth(body: FieldBody, skin: float) -> _SampledDepth:
    """The distances from the body's boundary on a grid that holds it."""
    made = body.mesh(TRIANGLE_DEVIATION * skin)
    low, high = made.points.min(axis=0), made.points.max(axis=0)
    spacing = skin / SPACINGS_PER_SKIN
    spacing = max(spacing, float((np.prod(high - low + 5 * spacing) / MAX_SAMPLES) ** (1 / 3)))
    first = low - (MARGIN_SPACINGS + SKEW) * spacing
    counts = np.ceil((high - first) / spacing + MARGIN_SPACINGS).astype(int) + 1
    x, y, z = (a + spacing * np.arange(n) for a, n in zip(first.tolist(), counts.tolist(), strict=True))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    tree = build_triangle_tree(made.points, made.triangles)
    inside = grid_winding_numbers(made.points, made.triangles, x, y, z) > 0
    values = spacing * (distance_transform_edt(~inside) - distance_transform_edt(inside))
    near = np.abs(values + skin) < BAND_SPACINGS * spacing
    distance = tree.distances(points[near])
    values[near] = np.where(inside[near], -distance, distance)
    return _SampledDepth(tree, values, (x[0], y[0], z[0]), spacing)


def _find_excess(depth: _SampledDepth, skin: float) -> float:
    """By how many skins the level must be deeper, so that the level set of the spline is nowhere nearer than TARGET_THICKNESS."""
    excess = 0.0
    spline = interpolate_samples(depth.values, (depth.spacing,) * 3, depth.origin)
    for _ in range(MAX_CORRECTIONS):
        points = _find_level_points(spline, depth, (1 + excess) * skin)
        least = float(depth.tree.distances(points).min()) / skin if len(points) else 1.0
        if least >= TARGET_THICKNESS - THICKNESS_TOL:
            break
        excess += TARGET_THICKNESS - least
    return excess


def _find_level_points(spline: Field, depth: _SampledDepth, skin: float) -> Array:
    """Points (n, 3) on the level set at the depth of a skin, one for each grid edge that crosses it."""
    values, found = depth.values + skin, []
    for axis in range(3):
        first, second = (np.moveaxis(values, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        at = np.argwhere((first < 0) != (second < 0))
        share = (first / np.where(first == second, 1.0, first - second))[tuple(at.T)]
        index = at.astype(float)
        index[:, 0] += share
        found.append(np.insert(index[:, 1:], axis, index[:, 0], axis=1))
    points = np.array(depth.origin) + depth.spacing * np.concatenate(found)
    for _ in range(PROJECTIONS):
        gradient = spline.gradient(points)
        square = np.maximum((gradient**2).sum(axis=1), 0.25)  # on ridges the gradient vanishes
        step = ((spline(points) + skin) / square)[:, None] * gradient
        length = np.linalg.norm(step, axis=1, keepdims=True)
        points = points - step * np.minimum(1.0, 0.5 * depth.spacing / np.maximum(length, 1e-300))
    return points[np.abs(spline(points) + skin) < 1e-3 * skin]


def _fit_cavity(excess: float, body: FieldBody, skin: float, depth: _SampledDepth) -> ErodedFieldBody:
    """The cavity at (1 + excess) skins; LevelSetError if it cannot be fitted."""
    values, left_out = _fill_small_parts(depth.values + (1 + excess) * skin, depth.spacing)
    if not (values < 0).any():
        deepest = -float(depth.values.min())
        raise InvalidRequest(
            f"a skin of {skin:g} leaves nothing of {body.name} that is {LEAST_DEPTH_SPACINGS * depth.spacing:.2g} deeper; it is "
            f"nowhere deeper than {deepest:.4g}: make it thinner than that, or leave the body solid"
        )
    field = interpolate_samples(values, (depth.spacing,) * 3, depth.origin)
    tol = min(max(LEAST_FIT_TOL * skin, body.measures.tol), GREATEST_FIT_TOL * skin)
    low, high = (np.array(corner) for corner in field.domain)
    found = fit_field_patches(field, low, high, tol, StageTimer(None))
    brep = replace(found.fitted.brep, tags=(BODY,) * len(found.fitted.brep.tags))
    thickness, points = _measure_thickness(brep, body)
    least, greatest = float(thickness.min()), float(thickness.max())
    at = [format_point(points[i], 4) for i in (int(thickness.argmin()), int(thickness.argmax()))]
    checks = (
        Check(
            "skin thinner than requested by",
            skin - least,
            (1 - MIN_THICKNESS_RATIO) * skin,
            f"the skin is only {least:.4g} thick near {at[0]}, less than {MIN_THICKNESS_RATIO:g} x {skin:g}",
        ),
        Check(
            "skin thickness",
            greatest,
            MAX_THICKNESS_RATIO * skin,
            f"the skin is {greatest:.4g} thick near {at[1]}, more than {MAX_THICKNESS_RATIO:g} x {skin:g}",
        ),
    )
    median = float(np.median(thickness))
    notes = (
        f"skin of {skin:g} by the distance from the body's patches, sampled every {depth.spacing:.3g}: {least:.4g} to "
        f"{greatest:.4g} thick, {median:.4g} in the median, measured at {len(thickness)} points of the cavity's patches",
        *left_out,
    )
    return ErodedFieldBody(brep, field, checks, notes)


def _fill_small_parts(values: Array, spacing: float) -> tuple[Array, tuple[str, ...]]:
    """The values without parts below zero that are too shallow to be fitted, and a note on them."""
    parts, count = label(values < 0)
    if not count:
        return values, ()
    deepest = np.full(count + 1, np.inf)
    np.minimum.at(deepest, parts.ravel(), values.ravel())
    shallow = np.flatnonzero(deepest[1:] > -LEAST_DEPTH_SPACINGS * spacing) + 1
    if not len(shallow):
        return values, ()
    near = binary_dilation(np.isin(parts, shallow), np.ones((3, 3, 3)))
    near &= ~np.isin(parts, np.setdiff1d(np.arange(1, count + 1), shallow))
    filled = np.where(near, np.maximum(values, LEAST_DEPTH_SPACINGS * spacing), values)
    one = len(shallow) == 1
    note = (
        f"{len(shallow)} part{'' if one else 's'} of the body less than {LEAST_DEPTH_SPACINGS * spacing:.2g} deeper than the "
        f"skin {'is' if one else 'are'} left solid"
    )
    return filled, (note,)


def _measure_thickness(cavity: Brep, body: FieldBody) -> tuple[Array, Array]:
    """Distances (n,) of points (n, 3) of the cavity's patches from the patches and caps of the body."""
    points = np.concatenate([own.reshape(-1, 3) for own, _, _ in _place_nodes(cavity)])
    nodes, of_face, parameters = zip(*_place_nodes(body.built.brep), strict=True)
    face, start = np.concatenate(of_face), np.concatenate(parameters)
    first, nearest = cKDTree(np.concatenate(nodes)).query(points, NEAREST_NODES)
    best = first[:, 0].copy()
    brep = body.built.brep
    for column in nearest.T:
        for f in np.unique(face[column]).tolist():
            at = np.flatnonzero(face[column] == f)
            patch = brep.carriers[brep.faces.carrier[f]]
            assert isinstance(patch, BSplineSurface)
            local = brep.faces.motion[np.full(len(at), f)].apply_inverse(points[at])
            best[at] = np.minimum(best[at], project_to_patch(patch, local, *start[column[at]].T)[0])
    if CAP in brep.tags and len(brep.faces_with_tag(CAP)):  # beyond a cap's rim the level set is nearer than its plane
        best = np.minimum(best, np.minimum(points - body.low, body.high - points).min(axis=1))
    return best, points


def _place_nodes(brep: Brep) -> list[tuple[Array, IntArray, Array]]:
    """Nodes (n, 3) of the spline faces of each carrier, the face (n,) of each, and its parameters (n, 2)."""
    found = []
    for own, carrier in spline_faces(brep):
        axes = (np.linspace(*domain, NODES_PER_DIRECTION) for domain in carrier.domain)
        u, v = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
        placed = brep.faces.motion[own][:, None].apply(carrier(u, v)).reshape(-1, 3)
        found.append((placed, np.repeat(own, len(u)), np.tile(np.column_stack([u, v]), (len(own), 1))))
    return found
