"""The initial weight of one stage: the kind that fits the blending region, the ends of its layer, its coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from tpmscad.blend.composition import BlendedField
from tpmscad.blend.coordinates import Along, Coordinate, CylinderRadius, SphereRadius
from tpmscad.blend.grid import Array, Field, Mask
from tpmscad.blend.scene import Scene
from tpmscad.blend.weights_fit import Zones, volume_weight
from tpmscad.blend.weights_line import LineWeight, line_weight
from tpmscad.blend.weights_volume import Triple, VolumeWeight
from tpmscad.errors import InvalidRequest
from tpmscad.fields.regions import Cylinder, HalfSpace, Sphere

SAMPLES_PER_COEFFICIENT = 2.0
"""Samples per knot span of a volume weight: at one, weights were seen to build bridges a single sample wide."""

SPANS_ACROSS = 12
"""Least knot spans across the thickest part of a blending region: fewer leave too little between the fixed coefficients."""

BISECTIONS = 60


@dataclass(frozen=True, slots=True)
class Line:
    """A one-dimensional weight of a coordinate: `count` coefficients over the regions, or None to span the layer with 19."""

    coordinate: Coordinate
    count: int | None = None
    degree: int = 3


@dataclass(frozen=True, slots=True)
class Volume:
    """A three-dimensional weight: coefficients along x, y, z over the domain, or None for one in two samples."""

    count: Triple | None = None
    degree: Triple = (3, 3, 3)


Spec = Line | Volume | str
NAMES = ("auto", "x", "y", "z", "volume")


def initial_weight(
    spec: Spec, field: BlendedField, scenes: Sequence[Scene], stage: int, *, refine: bool = True
) -> LineWeight | VolumeWeight:
    """The weight a stage starts from: 0 in what there was before, 1 in structure stage + 1.

    "auto" takes a line along x, y or z, or along a coordinate that the regions are made with (the normal of a half-space, the
    radius of a cylinder or a sphere), if the blending region is a layer of it, else a volume. Raises InvalidRequest for an
    unknown name, a region that is no layer of the coordinate asked for, or coefficients too few to leave any free.
    """
    if isinstance(spec, str):
        if spec not in NAMES:
            raise InvalidRequest(f"weight {spec!r}: must be one of {', '.join(NAMES)}, or a Line or Volume")
        if spec == "auto":
            for coordinate in _candidates(field, stage):
                made = _line(Line(coordinate), field, scenes[0], stage, refine)
                if not isinstance(made, str):
                    return made
        spec = Volume() if spec in ("auto", "volume") else Line(_axis("xyz".index(spec)))
    if isinstance(spec, Line):
        line = _line(spec, field, scenes[0], stage, refine)
        if isinstance(line, str):
            raise InvalidRequest(f"blending region {stage}: {line}; use weight='volume'")
        return line
    count = spec.count or _count(scenes[0], stage)
    coarse, fine = (zones(scene, stage) for scene in scenes)
    return volume_weight(coarse, fine, count, spec.degree, refine=refine)


def zones(scene: Scene, stage: int) -> Zones:
    """What the samples of a scene are to a stage."""
    inside = scene.mixing[stage]
    return Zones(scene.grid, (scene.owner <= stage) & ~inside, (scene.owner == stage + 1) & ~inside, inside)


def sides(field: BlendedField, stage: int) -> tuple[Field, Field, Field]:
    """The two regions of a stage as fields, where the structures so far are and where structure stage + 1 is, and where it mixes:
    its blending region and, continued, the later regions."""

    def first(points: Array) -> Array:
        return np.where(field.owner(points) <= stage, -1.0, 1.0)

    def second(points: Array) -> Array:
        return np.where(field.owner(points) == stage + 1, -1.0, 1.0)

    def mixing(points: Array) -> Array:
        return np.where(field.owner(points) > stage + 1, -1.0, np.asarray(field.blending[stage](points)))

    return first, second, mixing


def _candidates(field: BlendedField, stage: int) -> list[Coordinate]:
    """x, y, z and the coordinates of the half-spaces, cylinders and spheres that the regions are made of."""
    found: list[Coordinate] = [_axis(axis) for axis in range(3)]
    pending: list[object] = [field.blending[stage], *field.regions[: stage + 2]]
    while pending:
        part = pending.pop()
        if isinstance(part, HalfSpace):
            found.append(Along(part.normal))
        elif isinstance(part, Cylinder):
            found.append(CylinderRadius(part.center, part.axis))
        elif isinstance(part, Sphere):
            found.append(SphereRadius(part.center))
        elif is_dataclass(part) and not isinstance(part, type):
            pending += [getattr(part, entry.name) for entry in fields(part)]
    return list(dict.fromkeys(found))


def _axis(axis: int) -> Along:
    unit = np.eye(3)[axis]
    return Along((float(unit[0]), float(unit[1]), float(unit[2])))


def _count(scene: Scene, stage: int) -> Triple:
    thickness = 2 * float(distance_transform_edt(scene.blending[stage], sampling=scene.grid.spacing).max())
    spans = [
        max(4, int(np.ceil(max(e / (s * SAMPLES_PER_COEFFICIENT), min(e * SPANS_ACROSS / thickness, e / s)))))
        for e, s in zip(scene.grid.extent, scene.grid.spacing, strict=True)
    ]
    return spans[0] + 3, spans[1] + 3, spans[2] + 3


def _line(spec: Line, field: BlendedField, scene: Scene, stage: int, refine: bool) -> LineWeight | str:
    """The line weight, or why the blending region is no layer of that coordinate."""
    t = spec.coordinate(scene.grid.points())
    mask, area = scene.blending[stage], scene.owner <= stage + 1
    used = mask & area
    low, high = float(t[used].min()), float(t[used].max())
    rest = area & ~mask
    if np.any((t[rest] > low) & (t[rest] < high)):
        return "it is no layer between two values of the coordinate"
    before, after = rest & (t <= low), rest & (t >= high)
    second_after = _only(scene.owner[after] == stage + 1)
    second_before = _only(scene.owner[before] == stage + 1)
    if second_after is None or second_before is None or second_after == second_before:
        return "the two regions do not lie on the two sides of it along the coordinate"
    ends = [_edge(spec.coordinate, field.blending[stage], scene, used, t, way) for way in (-1.0, 1.0)]
    span = float(t[area].min()), float(t[area].max())
    layer = max(ends[0], span[0]), min(ends[1], span[1])
    return line_weight(
        spec.coordinate, layer, span, rising=second_after, count=spec.count, degree=spec.degree, refine=refine
    )


def _only(flags: Mask) -> bool | None:
    """The one truth value of the flags; None if they differ or there are none."""
    if flags.size == 0 or flags.any() != flags.all():
        return None
    return bool(flags.all())


def _edge(coordinate: Coordinate, blending: Field, scene: Scene, used: Mask, t: Array, way: float) -> float:
    """Where the blending region ends along the coordinate, by bisection outwards from its outermost samples."""
    index = np.flatnonzero(used.ravel())
    outermost = index[np.argsort(way * t.ravel()[index])[-8:]]
    points = scene.grid.points(outermost)
    direction = way * coordinate.gradient(points)
    inner, outer = np.zeros(len(points)), np.full(len(points), 2 * float(scene.grid.spacing.max()))
    for _ in range(BISECTIONS):
        middle = (inner + outer) / 2
        within = np.asarray(blending(points + middle[:, None] * direction)) <= 0
        inner, outer = np.where(within, middle, inner), np.where(within, outer, middle)
    return float(way * np.max(way * coordinate(points + inner[:, None] * direction)))
