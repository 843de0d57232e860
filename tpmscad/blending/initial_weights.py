"""The initial weight of one stage: the kind that fits the blending region, the ends of its layer, its coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from tpmscad._typing import Array, BoolArray
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.weights.coordinates import Coordinate, CylinderRadius, LinearCoordinate, SphereRadius
from tpmscad.blending.weights.line_weight import LineWeight, make_line_weight
from tpmscad.blending.weights.volume_weight import IntTriple, VolumeWeight
from tpmscad.blending.weights.volume_weight_fit import StageMasks, fit_volume_weight
from tpmscad.errors import InvalidRequest
from tpmscad.fields.primitive_regions import CylinderRegion, HalfSpaceRegion, SphereRegion
from tpmscad.fields.sample_grid import FieldFunction

SAMPLES_PER_COEFFICIENT = 2.0
"""Samples per knot span of a volume weight: at one, weights were seen to build bridges a single sample wide."""

MIN_SPANS_ACROSS_REGION = 12
"""Least knot spans across the thickest part of a blending region: fewer leave too little between the fixed coefficients."""

BISECTION_STEPS = 60


@dataclass(frozen=True, slots=True)
class LineWeightSpec:
    """A one-dimensional weight of a coordinate: `count` coefficients over the regions, or None to span the layer with 19."""

    coordinate: Coordinate
    count: int | None = None
    degree: int = 3


@dataclass(frozen=True, slots=True)
class VolumeWeightSpec:
    """A three-dimensional weight: coefficients along x, y, z over the domain, or None for one in two samples."""

    count: IntTriple | None = None
    degree: IntTriple = (3, 3, 3)


WeightSpec = LineWeightSpec | VolumeWeightSpec | str
WEIGHT_NAMES = ("auto", "x", "y", "z", "volume")


def make_initial_weight(
    spec: WeightSpec, field: BlendedField, scenes: Sequence[SampledComposition], stage: int, *, refine: bool = True
) -> LineWeight | VolumeWeight:
    """The weight a stage starts from: 0 in what there was before, 1 in structure stage + 1.

    "auto" takes a line along x, y or z, or along a coordinate that the regions are made with (the normal of a half-space, the
    radius of a cylinder or a sphere), if the blending region is a layer of it, else a volume. Raises InvalidRequest for an
    unknown name, a region that is no layer of the coordinate asked for, or coefficients too few to leave any free.
    """
    if isinstance(spec, str):
        if spec not in WEIGHT_NAMES:
            raise InvalidRequest(f"weight {spec!r}: must be one of {', '.join(WEIGHT_NAMES)}, or a Line or Volume")
        if spec == "auto":
            for coordinate in _candidate_coordinates(field, stage):
                made = _try_line_weight(LineWeightSpec(coordinate), field, scenes[0], stage, refine)
                if not isinstance(made, str):
                    return made
        spec = VolumeWeightSpec() if spec in ("auto", "volume") else LineWeightSpec(_axis_coordinate("xyz".index(spec)))
    if isinstance(spec, LineWeightSpec):
        line = _try_line_weight(spec, field, scenes[0], stage, refine)
        if isinstance(line, str):
            raise InvalidRequest(f"blending region {stage}: {line}; use weight='volume'")
        return line
    count = spec.count or _choose_coefficient_counts(scenes[0], stage)
    coarse, fine = (classify_samples(scene, stage) for scene in scenes)
    return fit_volume_weight(coarse, fine, count, spec.degree, refine=refine)


def classify_samples(scene: SampledComposition, stage: int) -> StageMasks:
    """What the samples of a scene are to a stage."""
    inside = scene.mixing_masks[stage]
    return StageMasks(scene.grid, (scene.owner <= stage) & ~inside, (scene.owner == stage + 1) & ~inside, inside)


def make_stage_regions(field: BlendedField, stage: int) -> tuple[FieldFunction, FieldFunction, FieldFunction]:
    """The two regions of a stage as fields, where the structures so far are and where structure stage + 1 is, and where it mixes:
    its blending region and, continued, the later regions."""

    def first(points: Array) -> Array:
        return np.where(field.owner(points) <= stage, -1.0, 1.0)

    def second(points: Array) -> Array:
        return np.where(field.owner(points) == stage + 1, -1.0, 1.0)

    def mixing(points: Array) -> Array:
        return np.where(field.owner(points) > stage + 1, -1.0, np.asarray(field.blending[stage](points)))

    return first, second, mixing


def _candidate_coordinates(field: BlendedField, stage: int) -> list[Coordinate]:
    """x, y, z and the coordinates of the half-spaces, cylinders and spheres that the regions are made of."""
    found: list[Coordinate] = [_axis_coordinate(axis) for axis in range(3)]
    pending: list[object] = [field.blending[stage], *field.regions[: stage + 2]]
    while pending:
        part = pending.pop()
        if isinstance(part, HalfSpaceRegion):
            found.append(LinearCoordinate(part.normal))
        elif isinstance(part, CylinderRegion):
            found.append(CylinderRadius(part.center, part.axis))
        elif isinstance(part, SphereRegion):
            found.append(SphereRadius(part.center))
        elif is_dataclass(part) and not isinstance(part, type):
            pending += [getattr(part, entry.name) for entry in fields(part)]
    return list(dict.fromkeys(found))


def _axis_coordinate(axis: int) -> LinearCoordinate:
    unit = np.eye(3)[axis]
    return LinearCoordinate((float(unit[0]), float(unit[1]), float(unit[2])))


def _choose_coefficient_counts(scene: SampledComposition, stage: int) -> IntTriple:
    thickness = 2 * float(distance_transform_edt(scene.blending[stage], sampling=scene.grid.spacing).max())
    spans = [
        max(
            4, int(np.ceil(max(e / (s * SAMPLES_PER_COEFFICIENT), min(e * MIN_SPANS_ACROSS_REGION / thickness, e / s))))
        )
        for e, s in zip(scene.grid.extent, scene.grid.spacing, strict=True)
    ]
    return spans[0] + 3, spans[1] + 3, spans[2] + 3


def _try_line_weight(
    spec: LineWeightSpec, field: BlendedField, scene: SampledComposition, stage: int, refine: bool
) -> LineWeight | str:
    """The line weight, or why the blending region is no layer of that coordinate."""
    t = spec.coordinate(scene.grid.points())
    mask, area = scene.blending[stage], scene.owner <= stage + 1
    used = mask & area
    low, high = float(t[used].min()), float(t[used].max())
    rest = area & ~mask
    if np.any((t[rest] > low) & (t[rest] < high)):
        return "it is no layer between two values of the coordinate"
    before, after = rest & (t <= low), rest & (t >= high)
    second_after = _common_value(scene.owner[after] == stage + 1)
    second_before = _common_value(scene.owner[before] == stage + 1)
    if second_after is None or second_before is None or second_after == second_before:
        return "the two regions do not lie on the two sides of it along the coordinate"
    ends = [_find_layer_end(spec.coordinate, field.blending[stage], scene, used, t, way) for way in (-1.0, 1.0)]
    span = float(t[area].min()), float(t[area].max())
    layer = max(ends[0], span[0]), min(ends[1], span[1])
    return make_line_weight(
        spec.coordinate, layer, span, rising=second_after, count=spec.count, degree=spec.degree, refine=refine
    )


def _common_value(flags: BoolArray) -> bool | None:
    """The one truth value of the flags; None if they differ or there are none."""
    if flags.size == 0 or flags.any() != flags.all():
        return None
    return bool(flags.all())


def _find_layer_end(
    coordinate: Coordinate, blending: FieldFunction, scene: SampledComposition, used: BoolArray, t: Array, way: float
) -> float:
    """Where the blending region ends along the coordinate, by bisection outwards from its outermost samples."""
    index = np.flatnonzero(used.ravel())
    outermost = index[np.argsort(way * t.ravel()[index])[-8:]]
    points = scene.grid.points(outermost)
    direction = way * coordinate.gradient(points)
    inner, outer = np.zeros(len(points)), np.full(len(points), 2 * float(scene.grid.spacing.max()))
    for _ in range(BISECTION_STEPS):
        middle = (inner + outer) / 2
        within = np.asarray(blending(points + middle[:, None] * direction)) <= 0
        inner, outer = np.where(within, middle, inner), np.where(within, outer, middle)
    return float(way * np.max(way * coordinate(points + inner[:, None] * direction)))
