"""Depth of points below the boundary of a body, as the distance from the nearest of its sites.

The sites are those of a Voronoi diagram: the faces, the edges and the vertices. Convex edges are never the nearest site of a
point inside, but of points of offset surfaces that leave the body. A face is a site for the points whose foot on its carrier lies
in it. Beyond a concave edge the edge is nearer, beyond a smooth one the neighbouring face, and a distance d is wrong by
h^2 / (2 d) only where the border is off by h: polygons suffice for the borders.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.carriers import EdgeCurve
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.loops import points_in_polygons
from tpmscad.brep.orthogonal_projection import project_to_curve
from tpmscad.erosion.face_regions import FaceRegion, shift_to_period

BORDER_REL_TOL = 1e-5
"""In body sizes: how far beyond the border of a face a foot may lie. The loops are polygons."""

DEPTH_TOL = 1e-7
"""In skins: a point shallower by more is no part of the boundary."""

DEPTH_REL_TOL = 1e-9
"""The same in body sizes, added: sheets and edges are fitted to a tenth of it."""

BEYOND = 1.46
"""In skins: height above an open face up to which a point is known to be outside; offset surfaces end nearer to it."""

TIE_TOL = 1e-12
"""Of the limit: sites at distances that agree within it are equally near, and the first one counts."""

BOX_MARGIN = 0.02
"""In body sizes: margin of the boxes of sampled sites."""


def depth_limit(skin: float, size: float) -> float:
    """The depth (model units) from which a point counts as deeper than the skin."""
    return skin * (1 - DEPTH_TOL) - DEPTH_REL_TOL * size


@dataclass(frozen=True, slots=True, eq=False)
class FaceSite:
    """A face as a region of its carrier; `tol` (model units) is how far beyond its border a foot may lie.

    `strips` (n, 2, 2) each: polygons in (u, v) by which the face goes on beyond an open one.
    """

    region: FaceRegion
    tol: float
    strips: tuple[Array, ...] = ()

    def feet(self, points: Array, limit: float) -> tuple[Array, Array]:
        """Distances (n,) of points (n, 3), infinite without a foot in the face or from `limit` on, and (u, v) (n, 2)."""
        carrier, all_uv, all_distances = self.region.carrier, np.zeros((len(points), 2)), np.full(len(points), np.inf)
        if isinstance(carrier, FreeFormSurface):
            found = carrier.feet(points)
            distance, uv = np.abs(found.distance), found.parameters
        else:
            distance, uv = np.abs(carrier.distance(points)), None
        near = np.flatnonzero(distance < limit)
        if not len(near):
            return all_distances, all_uv
        uv = carrier.parameters(points[near]) if uv is None else uv[near]
        all_uv[near] = uv = shift_to_period(uv, carrier, self.region.reference_parameters)
        inside = np.zeros(len(near), bool)
        for segments in (self.region.segments, *self.strips):
            inside |= points_in_polygons(segments[:, 0], segments[:, 1], uv)
        outside = np.flatnonzero(~inside)
        if len(outside):
            inside[outside] = self.region.is_near_border(carrier(*uv[outside].T), self.tol)
        all_distances[near[inside]] = distance[near[inside]]
        return all_distances, all_uv

    def box(self) -> Array:
        """Bounding box (2, 3) of samples of the face."""
        low, high = self.region.segments.min(axis=(0, 1)), self.region.segments.max(axis=(0, 1))
        u, v = np.meshgrid(*(np.linspace(a, b, 17) for a, b in zip(low, high, strict=True)))
        points = np.concatenate([self.region.border.reshape(-1, 3), self.region.carrier(u, v).reshape(-1, 3)])
        return np.stack([points.min(axis=0), points.max(axis=0)])


@dataclass(frozen=True, slots=True, eq=False)
class OpenSite:
    """A planar face without a skin: whatever lies beyond it is outside the body, and counts as not deep at all.

    `outward` is +1 if the plane's normal points out of the body, else -1. `least`: distance beyond it that is round-off.
    """

    face: FaceSite
    outward: int
    least: float

    def feet(self, points: Array, limit: float) -> tuple[Array, Array]:
        """The limit less the heights (n,) of points (n, 3) above the face, infinite below it or beside it, and (u, v) (n, 2)."""
        height = self.outward * self.face.region.carrier.distance(points)
        inside, uv = self.face.feet(points, BEYOND * limit)
        above = np.isfinite(inside) & (height > self.least)
        return np.where(above, limit - height, np.inf), uv

    def box(self) -> Array:
        """Bounding box (2, 3) of samples of the face."""
        return self.face.box()


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSite:
    """An edge."""

    curve: EdgeCurve
    span: tuple[float, float]

    def feet(self, points: Array, limit: float) -> tuple[Array, Array]:
        """Distances (n,) of points (n, 3), infinite without a foot on the edge, and its parameters, twice (n, 2)."""
        t, distance = project_to_curve(self.curve, self.span, points)
        return np.where((t >= self.span[0]) & (t <= self.span[1]), distance, np.inf), np.stack([t, t], axis=1)

    def box(self) -> Array:
        """Bounding box (2, 3) of samples of the edge."""
        points = self.curve(np.linspace(*self.span, 33))
        return np.stack([points.min(axis=0), points.max(axis=0)])


@dataclass(frozen=True, slots=True, eq=False)
class VertexSite:
    """A vertex."""

    point: Array

    def feet(self, points: Array, limit: float) -> tuple[Array, Array]:
        """Distances (n,) of points (n, 3); there are no parameters."""
        return np.linalg.norm(points - self.point, axis=1), np.zeros((len(points), 2))

    def box(self) -> Array:
        """The point twice."""
        return np.stack([self.point, self.point])


Site = FaceSite | OpenSite | EdgeSite | VertexSite


@dataclass(frozen=True, slots=True, eq=False)
class NearestSites:
    """Depths (n,) of points, infinite where no site is within the limit, nearest sites (n,), and parameters there (n, 2)."""

    depth: Array
    site: IntArray
    parameters: Array


@dataclass(frozen=True, slots=True, eq=False)
class BodySites:
    """All sites of a body, boxes (S, 2, 3) around them, and in which multiple of a distance sought they are sought (S,)."""

    sites: Sequence[Site]
    boxes: Array
    reaches: Array

    @classmethod
    def of(cls, sites: Sequence[Site], skin: float, size: float) -> BodySites:
        """The sites with their boxes, larger by strips where there are any."""
        boxes = np.array([site.box() for site in sites])
        faces = [site.face if isinstance(site, OpenSite) else site for site in sites]
        wide = [BEYOND * skin if isinstance(site, FaceSite) and site.strips else 0.0 for site in faces]
        margin = np.maximum(BOX_MARGIN * size, wide)[:, None, None]
        reaches = np.array([BEYOND if isinstance(site, OpenSite) else 1.0 for site in sites])
        return cls(sites, boxes + margin * np.array([[-1.0], [1.0]]), reaches)

    def nearest(self, points: Array, limit: float, without: int = -1) -> NearestSites:
        """The nearest sites of points (n, 3), sought up to the distance `limit` (model units), one of them left out."""
        depth, site = np.full(len(points), np.inf), np.full(len(points), -1)
        parameters = np.zeros((len(points), 2))
        for s, at in self.near_boxes(points, limit):
            if s == without:
                continue
            distance, uv = self.sites[s].feet(points[at], limit)
            closer = distance < np.minimum(depth[at] - TIE_TOL * limit, limit)
            depth[at[closer]], site[at[closer]], parameters[at[closer]] = distance[closer], s, uv[closer]
        return NearestSites(depth, site, parameters)

    def are_deeper(self, points: Array, limit: float) -> BoolArray:
        """Which points (n, 3) have no site nearer than `limit` (model units): (n,)."""
        deep = np.ones(len(points), bool)
        for s, near in self.near_boxes(points, limit):
            at = near[deep[near]]
            if len(at):
                deep[at] = ~(self.sites[s].feet(points[at], limit)[0] < limit)
        return deep

    def near_boxes(self, points: Array, limit: float | Array) -> Iterator[tuple[int, IntArray]]:
        """The sites whose boxes any of the points (n, 3) come near to, with these points.

        limit: a distance, or one of each point, (n,), which may shrink between one site and the next.
        """
        if not len(points):
            return
        low, high = points.min(axis=0), points.max(axis=0)
        gap = np.maximum(np.maximum(self.boxes[:, 0] - high, low - self.boxes[:, 1]), 0.0)
        for s in np.flatnonzero((gap * gap).sum(axis=1) < (np.max(limit) * self.reaches) ** 2).tolist():
            outside = np.maximum(np.maximum(self.boxes[s, 0] - points, points - self.boxes[s, 1]), 0.0)
            at = np.flatnonzero(np.einsum("nd,nd->n", outside, outside) < (limit * self.reaches[s]) ** 2)
            if len(at):
                yield s, at
