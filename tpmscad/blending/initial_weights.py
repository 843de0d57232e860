"""The initial weight of a stage: its kind, the ends of its layer, and its number of coefficients.

The porous-blending paper lets the user choose the weight: univariate along a coordinate (section 3.1.1) or trivariate
(section 3.1.2). Here "auto" tries the coordinates that fit the regions first, since a univariate weight has few coefficients, and
takes a trivariate weight where the blending region is a layer of none of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated

import numpy as np
from scipy.ndimage import distance_transform_edt

from tpmscad._typing import Array, BoolArray
from tpmscad.api.argument_kinds import ArgumentKind, WrongType, sequence_of
from tpmscad.api.public_calls import validate_constructor
from tpmscad.api.shared_kinds import ANYTHING, COUNT, COUNTS
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.weights.coordinates import Coordinate, CylinderRadius, LinearCoordinate, SphereRadius
from tpmscad.blending.weights.line_weight import LineWeight, make_line_weight
from tpmscad.blending.weights.volume_weight import IntTriple, VolumeWeight
from tpmscad.blending.weights.volume_weight_fit import MIN_SPANS_PER_AXIS, SAMPLES_PER_COEFFICIENT, fit_volume_weight
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.sample_grid import FieldFunction
from tpmscad.fields.kinds.primitive_regions import CylinderRegion, HalfSpaceRegion, SphereRegion

MIN_SPANS_ACROSS_REGION = 12
"""Knot spans across the thickest part of a blending region at least; most of them go to the fixed coefficients beside it."""

BISECTION_STEPS = 60

OUTERMOST_SAMPLES = 8
"""Number of samples from which the end of a layer is searched."""


@validate_constructor
@dataclass(frozen=True, slots=True)
class LineWeightSpec:
    """Specification of a univariate weight.

    Examples
    --------
    >>> from tpmscad.blending import LinearCoordinate, LineWeightSpec
    >>> LineWeightSpec(LinearCoordinate((1, 0, 0)), count=50).degree
    3
    """

    coordinate: Annotated[
        Coordinate,
        ANYTHING,
        "The coordinate of which the blending region is a layer: a LinearCoordinate, CylinderRadius or SphereRadius.",
    ]
    count: Annotated[
        int | None,
        COUNT,
        "Number of coefficients over all regions, as in the paper. By default the knots start and end on the layer and leave "
        "enough coefficients free.",
    ] = None
    degree: Annotated[int, COUNT, "Degree of the spline: at least 1, and 2 for a continuous gradient."] = 3


@validate_constructor
@dataclass(frozen=True, slots=True)
class VolumeWeightSpec:
    """Specification of a trivariate weight.

    Examples
    --------
    >>> from tpmscad.blending import VolumeWeightSpec
    >>> VolumeWeightSpec((80, 80, 20)).degree
    (3, 3, 3)
    """

    count: Annotated[
        IntTriple | None,
        COUNTS,
        "Numbers of coefficients along x, y and z over the domain. By default about one for two samples.",
    ] = None
    degree: Annotated[IntTriple, COUNTS.described_as(example="(3, 3, 3)"), "Degrees along x, y and z."] = (3, 3, 3)


def _read_weight(value: object) -> object:
    """A word, or a specification of a weight."""
    if not isinstance(value, str | LineWeightSpec | VolumeWeightSpec):
        raise WrongType("is no specification of a weight")
    return value


WeightSpec = LineWeightSpec | VolumeWeightSpec | str
WEIGHT = ArgumentKind("a word, a LineWeightSpec or a VolumeWeightSpec", '"auto"', _read_weight)
WEIGHTS = WEIGHT.or_else(sequence_of(WEIGHT.read, "a sequence of these", ""))
WEIGHT_NAMES = ("auto", "x", "y", "z", "volume")


def expand_weight_specs(weight: WeightSpec | Sequence[WeightSpec], n_stages: int) -> list[WeightSpec]:
    """One weight specification for each stage, from one for all or a sequence."""
    one_for_all = isinstance(weight, str) or not isinstance(weight, Sequence)
    specs: list[WeightSpec] = [weight] * n_stages if one_for_all else list(weight)  # type: ignore[list-item, arg-type]
    if len(specs) != n_stages:
        raise InvalidRequest(f"{len(specs)} weights for {n_stages} blending regions: give one each, or one for all")
    return specs


def make_initial_weight(
    spec: WeightSpec,
    field: BlendedField,
    compositions: Sequence[SampledComposition],
    stage: int,
) -> LineWeight | VolumeWeight:
    """The initial weight of a stage: 0 in the regions of the field so far, 1 in that of structure stage + 1.

    "auto" tries x, y, z and the coordinates that the regions are made with (the normal of a half-space, the radius of a cylinder
    or a sphere), and takes a trivariate weight if the blending region is a layer of none. Raises InvalidRequest for an unknown
    name, for a region that is no layer of the given coordinate, and if too many coefficients were needed.
    """
    if isinstance(spec, str):
        if spec not in WEIGHT_NAMES:
            raise InvalidRequest(
                f"weight {spec!r}: must be one of {', '.join(WEIGHT_NAMES)}, or a LineWeightSpec or VolumeWeightSpec"
            )
        if spec == "auto":
            for coordinate in _candidate_coordinates(field, stage):
                line = _try_line_weight(LineWeightSpec(coordinate), field, compositions[0], stage)
                if not isinstance(line, str):
                    return line
        spec = VolumeWeightSpec() if spec in ("auto", "volume") else LineWeightSpec(_axis_coordinate("xyz".index(spec)))
    if isinstance(spec, LineWeightSpec):
        line = _try_line_weight(spec, field, compositions[0], stage)
        if isinstance(line, str):
            raise InvalidRequest(f"blending region {stage}: {line}; use weight='volume'")
        return line
    count = spec.count or _choose_coefficient_counts(compositions[0], stage)
    coarse, fine = (composition.stage_masks(stage) for composition in compositions)
    return fit_volume_weight(coarse, fine, count, spec.degree)


def _candidate_coordinates(field: BlendedField, stage: int) -> list[Coordinate]:
    """The coordinates x, y, z and those of the half-spaces, cylinders and spheres in the expressions of the regions."""
    found: list[Coordinate] = [_axis_coordinate(axis) for axis in range(3)]
    pending: list[object] = [field.blending_regions[stage], *field.regions[: stage + 2]]
    while pending:
        node = pending.pop()
        if isinstance(node, HalfSpaceRegion):
            found.append(LinearCoordinate(node.normal))
        elif isinstance(node, CylinderRegion):
            found.append(CylinderRadius(node.center, node.axis))
        elif isinstance(node, SphereRegion):
            found.append(SphereRadius(node.center))
        elif is_dataclass(node) and not isinstance(node, type):
            pending += [getattr(node, entry.name) for entry in fields(node)]
    return list(dict.fromkeys(found))


def _axis_coordinate(axis: int) -> LinearCoordinate:
    unit = np.eye(3)[axis]
    return LinearCoordinate((float(unit[0]), float(unit[1]), float(unit[2])))


def _choose_coefficient_counts(composition: SampledComposition, stage: int) -> IntTriple:
    """Numbers of coefficients along x, y, z: one for some samples, more for a thin region, never more than samples."""
    grid = composition.grid
    thickness = 2 * float(distance_transform_edt(composition.blending_masks[stage], sampling=grid.spacing).max())
    nx, ny, nz = (
        max(
            MIN_SPANS_PER_AXIS,
            int(np.ceil(max(e / (s * SAMPLES_PER_COEFFICIENT), min(e * MIN_SPANS_ACROSS_REGION / thickness, e / s)))),
        )
        for e, s in zip(grid.extent, grid.spacing, strict=True)
    )
    return nx + 3, ny + 3, nz + 3


def _try_line_weight(
    spec: LineWeightSpec, field: BlendedField, composition: SampledComposition, stage: int
) -> LineWeight | str:
    """The univariate weight, or the reason why the blending region is no layer of the coordinate."""
    t = spec.coordinate(composition.grid.points())
    region_index = composition.region_index
    blending, in_stage = composition.blending_masks[stage], region_index <= stage + 1
    in_layer, beside_layer = blending & in_stage, in_stage & ~blending
    low, high = float(t[in_layer].min()), float(t[in_layer].max())
    if np.any((t[beside_layer] > low) & (t[beside_layer] < high)):
        return "it is no layer between two values of the coordinate"
    before, after = beside_layer & (t <= low), beside_layer & (t >= high)
    second_is_after = _common_value(region_index[after] == stage + 1)
    second_is_before = _common_value(region_index[before] == stage + 1)
    if second_is_after is None or second_is_before is None or second_is_after == second_is_before:
        return "the two regions do not lie on the two sides of it along the coordinate"
    blending_region = field.blending_regions[stage]
    start, end = (
        _find_layer_end(spec.coordinate, blending_region, composition, in_layer, t, side) for side in (-1.0, 1.0)
    )
    domain = float(t[in_stage].min()), float(t[in_stage].max())
    layer = max(start, domain[0]), min(end, domain[1])
    return make_line_weight(
        spec.coordinate, layer, domain, rising=second_is_after, count=spec.count, degree=spec.degree
    )


def _common_value(flags: BoolArray) -> bool | None:
    """The value that all flags have; None if they differ or there are none."""
    if flags.size == 0 or flags.any() != flags.all():
        return None
    return bool(flags.all())


def _find_layer_end(
    coordinate: Coordinate,
    blending_region: FieldFunction,
    composition: SampledComposition,
    in_layer: BoolArray,
    t: Array,
    side: float,
) -> float:
    """The coordinate at which the blending region ends on one side, by bisection outwards from its outermost samples."""
    index = np.flatnonzero(in_layer.ravel())
    outermost = index[np.argsort(side * t.ravel()[index])[-OUTERMOST_SAMPLES:]]
    points = composition.grid.points(outermost)
    direction = side * coordinate.gradient(points)
    inner = np.zeros(len(points))
    outer = np.full(len(points), 2 * float(composition.grid.spacing.max()))
    for _ in range(BISECTION_STEPS):
        middle = (inner + outer) / 2
        within = np.asarray(blending_region(points + middle[:, None] * direction)) <= 0
        inner, outer = np.where(within, middle, inner), np.where(within, outer, middle)
    return float(side * np.max(side * coordinate(points + inner[:, None] * direction)))
