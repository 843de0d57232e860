"""Lattices bent by a coordinate map: every patch fitted to the mapped exact surface, its walls offset along the mapped normal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.patches import smooth_fit
from tpmscad.patches.complex import Array, Ints, PatchComplex
from tpmscad.patches.congruent import translation_classes
from tpmscad.patches.deviation import Deviation, deviation, worst
from tpmscad.patches.joints import curvature
from tpmscad.patches.lattice import Placements, open_sides, ruled, translates
from tpmscad.patches.maps import Map
from tpmscad.patches.sheet import TAGS
from tpmscad.patches.weld import weld
from tpmscad.splines.bspline import Surface
from tpmscad.surfaces import PatchSymmetry, SurfacePatch

DEGREES = (9, 10, 11, 12, 14, 16)
"""Bezier degrees tried in turn; every patch of a lattice takes the same, so that borders share their spline space."""

SAMPLES = 25
"""Samples along each parameter for the deviation of each of the many patches."""

PARAMETRIC_EXCESS = 3.0
"""Differences at equal parameters over orthogonal distances, at the most: measured 1.0 to 2.2 on gyroid, diamond and P."""

FLAT = 1e-9
"""A side of the box counts as flat if its image spreads by less than this fraction of the box."""


@dataclass(frozen=True, slots=True, eq=False)
class MappedSurface:
    """The mapped mid surface over given placements: lattice coordinates are cell edges times cells."""

    patch: SurfacePatch
    symmetry: PatchSymmetry
    placements: Placements
    map: Map
    cell: float

    def offset(self, u: Array, v: Array, distance: float, index: int | slice = slice(None)) -> Array:
        """Points at the signed normal distance from the mapped surface, on every placement (P, ..., 3) or on one (..., 3)."""
        jet = self.patch.jet(u, v)
        rotation, translation = self.placements.rotation[index], self.placements.translation[index]
        shape = (*rotation.shape[:-2], *(1,) * np.ndim(u), 3)
        turn = rotation.reshape(*shape[:-1], 3, 3)
        points = self.cell * ((turn @ jet.position[..., None])[..., 0] + translation.reshape(shape))
        mapped = self.map(points)
        if distance == 0.0:
            return mapped
        normal = (turn @ jet.normal[..., None])[..., 0]
        # A normal goes by the inverse transpose, which keeps it on the side the nodal value grows to.
        normal = np.linalg.solve(np.swapaxes(self.map.jacobian(points, self.cell), -1, -2), normal[..., None])[..., 0]
        return mapped + distance * normal / np.linalg.norm(normal, axis=-1, keepdims=True)

    def orientation(self) -> int:
        """Sign of the map's Jacobian determinant, the same everywhere; InvalidRequest where it vanishes or changes sign."""
        u, v = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)))
        points = self.cell * (
            np.einsum("fij,nj->fni", self.placements.rotation, self.patch.jet(u, v).position)
            + self.placements.translation[:, None]
        )
        determinant = np.linalg.det(self.map.jacobian(points, self.cell))
        worst = np.unravel_index(np.argmin(np.abs(determinant)), determinant.shape)
        if not (np.all(determinant > 0) or np.all(determinant < 0)):
            raise InvalidRequest(
                f"{self.map.name} folds: its Jacobian determinant changes sign near {points[worst].tolist()}; "
                "a map must be one-to-one over the lattice and a cell beyond"
            )
        return int(np.sign(determinant.flat[0]))


def image_box(map: Map, size: Array) -> tuple[Array, Array]:
    """Corners (3,), (3,) of the axis-aligned box that the box from the origin to `size` becomes.

    InvalidRequest if the map bends or tilts one of its faces: flat caps then have no plane to lie in.
    """
    t = np.linspace(0.0, 1.0, 9)
    a, b = (g.ravel() for g in np.meshgrid(t, t))
    bounds = np.empty((2, 3))
    for axis in range(3):
        for end in (0, 1):
            on_face = np.insert(np.stack([a, b], axis=1), axis, float(end), axis=1) * size
            image = map(on_face)[:, axis]
            if np.ptp(image) > FLAT * size.max():
                raise InvalidRequest(
                    f"{map.name} does not keep the box's {'lower' if end == 0 else 'upper'} {'xyz'[axis]} side flat and "
                    f"square to {'xyz'[axis]} (it spreads over {np.ptp(image):.3g}): use boundary='natural'"
                )
            bounds[end, axis] = image.mean()
    return bounds.min(axis=0), bounds.max(axis=0)


def reaching(
    patch: SurfacePatch,
    symmetry: PatchSymmetry,
    map: Map,
    box: tuple[Array, Array],
    cells: tuple[int, int, int],
    phase: Array,
    cell: float,
    reach: float,
) -> Placements:
    """The placements whose mapped mid patch comes within `reach` of the box; the map must hold a cell beyond the lattice."""
    origin = np.stack(np.meshgrid(*[np.arange(-2, n + 2) for n in cells], indexing="ij"), axis=-1).reshape(-1, 3)
    placements = translates(symmetry, origin + (phase - np.floor(phase)))
    t = np.linspace(0.0, 1.0, 7)
    u, v = (g.ravel() for g in np.meshgrid(t, t))
    points = np.einsum("fij,nj->fni", placements.rotation, patch.jet(u, v).position)
    points += placements.translation[:, None]
    near = ((points.max(axis=1) > -0.5) & (points.min(axis=1) < np.array(cells) + 0.5)).all(axis=1)
    image = map(cell * points[near])
    # Between the samples a patch bulges by less than an eighth of its extent.
    margin = reach + 0.125 * np.ptp(image, axis=1).max()
    inside = ((image.max(axis=1) > box[0] - margin) & (image.min(axis=1) < box[1] + margin)).all(axis=1)
    keep = np.flatnonzero(near)[inside]
    return Placements(placements.rotation[keep], placements.translation[keep])


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A fitted bounding surface: over placement i lies patches[label[i]] moved by translation[i]."""

    patches: list[Surface]
    label: Ints
    translation: Array

    def patch(self, index: int) -> Surface:
        return self.patches[self.label[index]].moved(np.eye(3), self.translation[index])


def fit_layers(
    mapped: MappedSurface,
    distances: tuple[float | None, float | None],
    tol: float,
    progress: Callable[[float], None] = lambda done: None,
) -> tuple[Layer | None, Layer | None, Deviation]:
    """The lower and the upper fitted surface (None where there is none), and the worst patch's deviation.

    The lowest degree whose patches all meet `tol` is taken, or the last tried: the caller compares. Patches that the map leaves
    translates of one another, as an anisotropic cell does, are fitted once.
    """
    t = smooth_fit.sample_parameters()
    u, v = np.meshgrid(t, t, indexing="ij")
    sampled = [(d, mapped.offset(u, v, d)) for d in distances if d is not None]
    classes = [translation_classes(s) for _, s in sampled]
    total = sum(len(c.first) for c in classes)
    for degree in DEGREES:
        last = degree == DEGREES[-1]
        fitted = [smooth_fit.fit(s[c.first], degree) for (_, s), c in zip(sampled, classes, strict=True)]
        estimates = [_least_error(p, s[c.first]) for p, (_, s), c in zip(fitted, sampled, classes, strict=True)]
        if not last and max(estimates) > tol:
            continue
        layers = [
            Layer([smooth_fit.surface(p) for p in poles], c.label, c.translation)
            for poles, c in zip(fitted, classes, strict=True)
        ]
        each = []
        for (distance, _), layer, c in zip(sampled, layers, classes, strict=True):
            for patch, index in zip(layer.patches, c.first, strict=True):
                each.append(deviation(patch, _reference(mapped, distance, int(index)), SAMPLES))
                progress(len(each) / total)
        if last or max(d.max for d in each) <= tol:
            break
    of_side = iter(layers)
    lower, upper = (None if d is None else next(of_side) for d in distances)
    return lower, upper, worst(each)


def _reference(mapped: MappedSurface, distance: float, index: int) -> Callable[[Array, Array], Array]:
    return lambda u, v: mapped.offset(u, v, distance, index)


def greatest_offset(mapped: MappedSurface) -> float:
    """The least curvature radius of the mapped mid surface, sampled: offsets must stay below it."""
    t = smooth_fit.sample_parameters()
    samples = mapped.offset(*np.meshgrid(t, t, indexing="ij"), 0.0)
    poles = smooth_fit.fit(samples[translation_classes(samples).first], DEGREES[-1])
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
    largest = max(np.linalg.norm(curvature(smooth_fit.surface(p), u, v)[2], ord=2, axis=(1, 2)).max() for p in poles)
    return float(1.0 / largest)


def within_curvature(mapped: MappedSurface, offsets: Sequence[float], name: str) -> None:
    """InvalidRequest where an offset passes the greatest there is; `name` says which surface it is of."""
    limit, worst = greatest_offset(mapped), max(offsets, key=abs)
    if abs(worst) >= limit:
        raise InvalidRequest(
            f"offset {worst:g} passes the least curvature radius of the {name}, {limit:.6g}: "
            f"offsets stay below it, a symmetric wall's thickness below {2 * limit:.6g}"
        )


def assemble(mapped: MappedSurface, lower: Layer | None, upper: Layer | None, *, natural: bool) -> PatchComplex:
    """The layers as one complex: closed by ruled gap faces along the border when `natural`, open otherwise."""
    facing = mapped.symmetry.handedness * mapped.orientation()
    carriers: list[Surface] = []
    parts = []
    for layer, outward, tag in ((lower, -1, "offset-"), (upper, 1, "offset+")):
        if layer is not None:
            n = len(layer.label)
            parts.append((len(carriers) + layer.label, layer.translation, np.full(n, outward * facing), [tag] * n))
            carriers += layer.patches
    if natural:
        if lower is None or upper is None:
            raise ValueError("a natural boundary bridges two surfaces; a skeletal solid has one")
        open_at = list(zip(*open_sides(mapped.symmetry, mapped.placements), strict=True))
        n = len(open_at)
        parts.append((len(carriers) + np.arange(n), np.zeros((n, 3)), np.full(n, facing), ["gap"] * n))
        carriers += [ruled(lower.patch(p).side(s), upper.patch(p).side(s)) for p, s in open_at]
    carrier, translation, sense, tags = (np.concatenate(part) for part in zip(*parts, strict=True))
    return weld(
        carriers,
        carrier,
        np.tile(np.eye(3), (len(carrier), 1, 1)),
        translation,
        sense,
        np.array([TAGS.index(tag) for tag in tags]),
        TAGS,
    )


def _least_error(poles: Array, samples: Array) -> float:
    """A cautious low estimate of the deviation from the differences at the inner samples: a degree it rules out misses."""
    t = smooth_fit.sample_parameters()
    inside = (t >= 0) & (t <= 1)
    fitted = np.stack([smooth_fit.surface(p).grid(t[inside], t[inside]) for p in poles])
    return float(np.linalg.norm(fitted - samples[:, inside][:, :, inside], axis=-1).max() / PARAMETRIC_EXCESS)
