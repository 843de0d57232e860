"""Lattices bent by a coordinate map: every patch fitted to the mapped exact surface, its walls offset along the mapped normal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.patches import smooth_fit
from tpmscad.patches.complex import Array, PatchComplex
from tpmscad.patches.deviation import Deviation, deviation
from tpmscad.patches.joints import curvature
from tpmscad.patches.lattice import TAGS, MidPatch, Placements, open_sides, ruled
from tpmscad.patches.maps import Map
from tpmscad.patches.weld import weld
from tpmscad.splines.bspline import Surface

DEGREES = (9, 10, 11, 12, 14, 16)
"""Bezier degrees tried in turn; every patch of a lattice takes the same, so that borders share their spline space."""

SAMPLES = 25
"""Samples along each parameter for the deviation of each of the many patches."""


@dataclass(frozen=True, slots=True, eq=False)
class MappedSurface:
    """The mapped mid surface over given placements: lattice coordinates are cell edges times cells."""

    mid: MidPatch
    placements: Placements
    map: Map
    cell: float

    def offset(self, u: Array, v: Array, distance: float, index: int | slice = slice(None)) -> Array:
        """Points at the signed normal distance from the mapped surface, on every placement (P, ..., 3) or on one (..., 3)."""
        jet = self.mid.surface.jet(u, v)
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
            np.einsum("fij,nj->fni", self.placements.rotation, self.mid.surface.jet(u, v).position)
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


def fit_layers(
    mapped: MappedSurface,
    distances: tuple[float, ...],
    tol: float,
    progress: Callable[[float], None] = lambda done: None,
) -> tuple[list[list[Surface]], list[Deviation]]:
    """For each distance the fitted patch of every placement, and each layer's deviation (the worst patch's).

    The lowest degree whose patches all meet `tol` is taken, or the last tried: the caller compares.
    """
    t = smooth_fit.sample_parameters()
    u, v = np.meshgrid(t, t, indexing="ij")
    samples = [mapped.offset(u, v, d) for d in distances]
    layers: list[list[Surface]] = []
    measured: list[Deviation] = []
    for degree in DEGREES:
        fitted = [smooth_fit.fit(s, degree) for s in samples]
        if degree != DEGREES[-1] and max(_estimate(f, s) for f, s in zip(fitted, samples, strict=True)) > tol:
            continue
        layers = [[smooth_fit.surface(p) for p in poles] for poles in fitted]
        measured = []
        total = sum(map(len, layers))
        for k, (distance, layer) in enumerate(zip(distances, layers, strict=True)):
            each = []
            for i, surface in enumerate(layer):
                each.append(
                    deviation(surface, lambda a, b, i=i, d=distance: mapped.offset(a, b, d, i), SAMPLES)  # type: ignore[misc]  # loop variables bound as defaults
                )
                progress((k * len(layer) + i + 1) / total)
            measured.append(_worst(each))
        if max(m.max for m in measured) <= tol:
            break
    return layers, measured


def greatest_offset(mapped: MappedSurface) -> float:
    """The least curvature radius of the mapped mid surface, sampled: offsets must stay below it."""
    t = smooth_fit.sample_parameters()
    poles = smooth_fit.fit(mapped.offset(*np.meshgrid(t, t, indexing="ij"), 0.0), 12)
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
    largest = max(np.linalg.norm(curvature(smooth_fit.surface(p), u, v)[2], ord=2, axis=(1, 2)).max() for p in poles)
    return float(1.0 / largest)


def assemble(
    mapped: MappedSurface, lower: list[Surface] | None, upper: list[Surface] | None, *, natural: bool
) -> PatchComplex:
    """The layers as one complex: closed by ruled gap faces along the border when `natural`, open otherwise."""
    facing = mapped.mid.handedness * mapped.orientation()
    carriers: list[Surface] = []
    sense: list[int] = []
    tag: list[str] = []
    for layer, outward, name in ((lower, -1, "offset-"), (upper, 1, "offset+")):
        if layer is not None:
            carriers += layer
            sense += [outward * facing] * len(layer)
            tag += [name] * len(layer)
    if natural:
        if lower is None or upper is None:
            raise ValueError("a natural boundary bridges two surfaces; a skeletal solid has one")
        open_at = list(zip(*open_sides(mapped.mid, mapped.placements), strict=True))
        carriers += [ruled(lower[p].side(s), upper[p].side(s)) for p, s in open_at]
        sense += [facing] * len(open_at)
        tag += ["gap"] * len(open_at)
    n = len(carriers)
    return weld(
        carriers,
        np.arange(n),
        np.tile(np.eye(3), (n, 1, 1)),
        np.zeros((n, 3)),
        np.array(sense),
        np.array([TAGS.index(t) for t in tag]),
        TAGS,
    )


def _estimate(poles: Array, samples: Array) -> float:
    """Greatest parametric difference at the inner samples, no less than the orthogonal one."""
    t = smooth_fit.sample_parameters()
    inside = (t >= 0) & (t <= 1)
    surface_points = np.stack([smooth_fit.surface(p).grid(t[inside], t[inside]) for p in poles])
    return float(np.linalg.norm(surface_points - samples[:, inside][:, :, inside], axis=-1).max() / PARAMETRIC_EXCESS)


PARAMETRIC_EXCESS = 3.0
"""Parametric differences are this much larger than orthogonal distances at least; a degree ruled out misses by far."""


def _worst(each: list[Deviation]) -> Deviation:
    return Deviation(
        max=max(d.max for d in each),
        rms=float(np.sqrt(np.mean([d.rms**2 for d in each]))),
        to_reference=max(d.to_reference for d in each),
        from_reference=max(d.from_reference for d in each),
    )
