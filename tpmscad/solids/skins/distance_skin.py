"""The part of a body that is deeper than a skin, as a level set of the distance from the body.

Offset faces give a skin its exact thickness, but where they meet at creases, in points of tangency or in corners too sharp, no
arrangement of them closes, and the solid of a field has too many patches for them.

The distance from the body's boundary is sampled on a grid, exactly from triangles of its patches, and interpolated by a cubic
spline; its level set at the depth of the skin is fitted like any other. The distance has ridges where two sides of the body are
equally near, and its level sets edges there, which in thin parts end in wedges too sharp for any patch. The cavity is therefore
opened (J. Serra, Image Analysis and Mathematical Morphology, 1982): what no element of a spacing fits into becomes skin, and the
rest is smoothed over part of a spacing. This makes the skin thicker at edges. Parts of the cavity smaller than a few spacings are
left solid. The thickness is measured afterwards, from points of the cavity's patches to the triangles, and where it is extreme
to their feet on the patches of the body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.ndimage import (
    binary_dilation,
    distance_transform_edt,
    gaussian_filter,
    generate_binary_structure,
    grey_closing,
    label,
)

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties
from tpmscad.brep.patch_nodes import place_nodes
from tpmscad.errors import InvalidRequest, LevelSetError, format_point
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.fields.data.triangle_distance import TriangleTree, build_triangle_tree, grid_winding_numbers
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.sampled_data import SampledField, interpolate_samples
from tpmscad.kernel.body_import.body_brep import FreeFormBody
from tpmscad.results.certificate import Check
from tpmscad.solids.bodies.body_choice import Body
from tpmscad.solids.bodies.fitted_body import BODY
from tpmscad.solids.matter.field_patches import fit_field_patches
from tpmscad.solids.skins.offset_skin import MIN_THICKNESS_RATIO
from tpmscad.solids.volume_samples import sample_box
from tpmscad.stage_timer import StageTimer

SPACINGS_PER_SKIN = 3.0
"""Spacings of the grid in a skin."""

BAND_SPACINGS = 8.0
"""In spacings: within this of the skin's depth, distances are exact. Opening and smoothing hand an error beyond it on over three
spacings, and a cubic spline .27 of it from sample to sample: 1e-3 of a spacing at the depth."""

MAX_SAMPLES = 60_000_000
"""Samples of the grid; 50 million take 4.4 GB and, before the fit, 110 s. A thinner skin has fewer spacings, which the thickness
measured tells."""

TRIANGLE_DEVIATION = 0.005
"""In skins: deviation of the triangles from the body's patches. Of a ship of 5300 patches with a skin of a sixtieth of its height
0.002 gives 2.7 million, which take 70 s, a third of the whole. 0.01 takes a tenth to a sixth less than this in real parts and
images, and makes the wall of a filled ellipsoid .1 % larger."""

MAX_ROUNDED_RATIO = 1.6
"""In skins: limit of the thickness. At the end of a wedge an opening by a spacing, which is .33 to .4 skins, moves the level by
as much, and the Gaussian by up to .15; beyond 1.45 is one point in a hundred of a ship with thin parts."""

SMOOTHING_WIDTHS = (0.23, 0.46)
"""In skins: widths of the Gaussian, the second where the cavity of the first cannot be fitted. The cavity of a ship of 60 x 31 x
48 with a skin of 0.8 had 94,000 patches after the second fit with a Gaussian of a third of the skin alone, 747 leaves of them
bad; opened as well it has 11,300 that pass and 5,300 after simplification, in 84 s. An opening that is limited to a fourth of the
skin leaves ridges that take thrice as many."""

SHARPENINGS = 4
"""Corrections of the smoothed distance where it makes the skin thinner: below concave edges, where the distance is curved. Of a
housing with a skin of a fourth of its greatest depth none leaves it .945 skins thick at the least, two .989, four .992 and eight
.994."""

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

PROJECTIONS = 4
"""Newton steps from crossings of grid edges to the level set."""

MARGIN_SPACINGS = 2.37
"""Spacings by which the grid reaches beyond the body; the odd part keeps grid lines out of its planes."""

SKEW = np.array([0.0137, 0.0071, 0.0])
"""In spacings: keeps grid lines apart from vertices of the triangles."""

PROJECTED_POINTS = 300
"""Points of the cavity where the skin is thinnest and thickest by triangles, each, whose feet on the patches are sought. The
extremes of 2000, which took up to 25 s, were among the first 50 in a screw and a crank arm."""


@dataclass(frozen=True, slots=True, eq=False)
class DistanceCavity:
    """What is deeper than the skin of a body of a name: patches, the field that is negative there, and what was measured."""

    name: str
    brep: Brep
    field: SampledField
    checks: tuple[Check, ...]
    notes: tuple[str, ...]

    @property
    def volume(self) -> float:
        """Volume in model units cubed."""
        return float(integral_properties.volume(integral_properties.integrate_faces(self.brep))[0])

    def read(self, tol: float) -> FreeFormBody:
        """The boundary representation, whatever the tolerance of what it is cut with."""
        return FreeFormBody(self.brep, {})

    def sample(self) -> Array:
        """An even sample (n, 3) of points in the cavity."""
        low, high = (np.array(corner) for corner in self.field.domain)
        points = sample_box(low, high)
        return points[self.contains(points)]

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in the cavity, by its field."""
        return self.field(points) < 0


def erode_by_distance(body: Body, skin: float) -> DistanceCavity:
    """The part of a body deeper than its skin; InvalidRequest if there is none, LevelSetError if it cannot be fitted."""
    outcome = CAVITY_FITS.run(body, skin, _sample_depth(body, skin))
    if not outcome.failures:
        return outcome.value
    rounded = f"the cavity's edges were rounded by {outcome.name}, since patches of sharper ones were not fitted"
    return replace(outcome.value, notes=(*outcome.value.notes, rounded))


def _fit_rounded_cavity(width: float, body: Body, skin: float, depth: _SampledDepth) -> DistanceCavity:
    """The cavity of the distance after opening and a Gaussian of a width in skins."""
    rounded = replace(depth, values=_round_ridges(depth.values, width * skin / depth.spacing))
    return _fit_cavity(
        _find_excess(rounded, skin), body, skin, rounded, _measure_volume(depth.values + skin, depth.spacing)
    )


def _measure_volume(values: Array, spacing: float) -> float:
    """The volume where samples of a distance are negative, each with its part of a cell."""
    return spacing**3 * float(np.clip(0.5 - values / spacing, 0.0, 1.0).sum())


def _round_ridges(values: Array, width: float) -> Array:
    """The values after an opening of what is below zero by a spacing, and a Gaussian of a width in spacings.

    The Gaussian alone would lower values, and so thin the skin, where they are concave; it is corrected there.
    """
    opened = grey_closing(values, footprint=generate_binary_structure(3, 1), mode="nearest")
    smooth = gaussian_filter(opened, width, mode="nearest")
    for _ in range(SHARPENINGS):
        smooth += gaussian_filter(np.maximum(opened - smooth, 0.0), width, mode="nearest")
    return np.asarray(smooth)


CAVITY_FITS: Fallbacks[[Body, float, Any], DistanceCavity] = Fallbacks(
    tuple(
        Fallback(f"a Gaussian of {width:g} skins", partial(_fit_rounded_cavity, width)) for width in SMOOTHING_WIDTHS
    ),
    retry_on=(LevelSetError,),
)
"""Widths of the Gaussian by which the cavity's edges are rounded, until it is fitted."""


@dataclass(frozen=True, slots=True, eq=False)
class _SampledDepth:
    """Signed distances at the points of a grid, negative inside, its first point and its spacing, and the body's triangles.

    They are exact near the depth of the skin; elsewhere those from the nearest point of the grid on the other side. `deepest` is
    the greatest depth of a point of the grid, before ridges are rounded.
    """

    tree: TriangleTree
    values: Array
    origin: tuple[float, float, float]
    spacing: float
    deepest: float


def _sample_depth(body: Body, skin: float) -> _SampledDepth:
    """The distances from the body's boundary on a grid that holds it."""
    made = body.mesh(TRIANGLE_DEVIATION * skin)
    low, high = made.points.min(axis=0), made.points.max(axis=0)
    spacing = skin / SPACINGS_PER_SKIN
    spacing = max(spacing, float((np.prod(high - low + 5 * spacing) / MAX_SAMPLES) ** (1 / 3)))
    first = low - (MARGIN_SPACINGS + SKEW) * spacing
    counts = np.ceil((high - first) / spacing + MARGIN_SPACINGS).astype(int) + 1
    x, y, z = (a + spacing * np.arange(n) for a, n in zip(first.tolist(), counts.tolist(), strict=True))
    tree = build_triangle_tree(made.points, made.triangles)
    inside = grid_winding_numbers(made.points, made.triangles, x, y, z) > 0
    values = spacing * (distance_transform_edt(~inside) - distance_transform_edt(inside))
    near = np.abs(values + skin) < BAND_SPACINGS * spacing
    distance = tree.distances(np.argwhere(near) * spacing + [x[0], y[0], z[0]])
    values[near] = np.where(inside[near], -distance, distance)
    return _SampledDepth(tree, values, (x[0], y[0], z[0]), spacing, -float(values.min()))


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


def _fit_cavity(excess: float, body: Body, skin: float, depth: _SampledDepth, deeper: float) -> DistanceCavity:
    """The cavity at (1 + excess) skins; LevelSetError if it cannot be fitted.

    deeper: volume of all that is deeper than the skin, which a note compares with that of the cavity.
    """
    values, left_out = _fill_small_parts(depth.values + (1 + excess) * skin, depth.spacing)
    if not (values < 0).any():
        raise InvalidRequest(
            f"a skin of {skin:g} leaves nothing of {body.name} that is {LEAST_DEPTH_SPACINGS * depth.spacing:.2g} deeper; "
            f"samples of it, {depth.spacing:.2g} apart, are nowhere deeper than {depth.deepest:.4g}: make it thinner than "
            "that, or leave the body solid"
        )
    field = interpolate_samples(values, (depth.spacing,) * 3, depth.origin)
    tol = min(max(LEAST_FIT_TOL * skin, body.tol), GREATEST_FIT_TOL * skin)
    low, high = (np.array(corner) for corner in field.domain)
    found = fit_field_patches(field, low, high, tol, StageTimer(None))
    brep = replace(found.fitted.brep, tags=(BODY,) * len(found.fitted.brep.tags))
    thickness, points = _measure_thickness(brep, body, depth.tree)
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
            MAX_ROUNDED_RATIO * skin,
            f"the skin is {greatest:.4g} thick near {at[1]}, more than {MAX_ROUNDED_RATIO:g} x {skin:g}",
        ),
    )
    median = float(np.median(thickness))
    notes = (
        f"skin of {skin:g} by the distance from the body's patches, sampled every {depth.spacing:.3g}: {least:.4g} to "
        f"{greatest:.4g} thick, {median:.4g} in the median, measured at {len(thickness)} points of the cavity's patches",
        f"the cavity is {deeper - _measure_volume(values, depth.spacing):.3g} mm3 smaller than all that is deeper than the skin, "
        f"{deeper:.4g} mm3: its edges are rounded, and what is narrow is left solid",
        *left_out,
    )
    return DistanceCavity(body.name, brep, field, checks, notes)


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


def _measure_thickness(cavity: Brep, body: Body, tree: TriangleTree) -> tuple[Array, Array]:
    """Distances (n,) of points (n, 3) of the cavity's patches from the body, the extremes exactly."""
    points = place_nodes(cavity).points
    thickness = tree.distances(points)
    order = np.argsort(thickness)
    extreme = np.unique(np.concatenate([order[:PROJECTED_POINTS], order[-PROJECTED_POINTS:]]))
    thickness[extreme] = body.distances(points[extreme])
    return thickness, points
