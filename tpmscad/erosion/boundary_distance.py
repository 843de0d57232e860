"""Distances of many points from the boundary of a body, in arrays: that from the nearest of its faces, edges and vertices.

A sample of the boundary bounds each distance from above; only sites whose boxes are nearer than that are asked. Points are taken
in groups that are near each other, for which few sites come into question.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.loops import points_in_polygons
from tpmscad.erosion.face_regions import FaceRegion, build_regions, list_carriers
from tpmscad.erosion.sites import BodySites, EdgeSite, FaceSite, Site, VertexSite

BORDER_SAG = 1e-6
"""In body sizes: how far the polygons of borders are off, and by how much the distance of a point near a border may be."""

SAMPLES_PER_AXIS = 33
"""Nodes of a face along each parameter among the samples that bound distances."""

POINTS_AT_ONCE = 2048
"""Points near each other whose distances are sought together: few sites are near them."""


@dataclass(frozen=True, slots=True, eq=False)
class BoundaryDistance:
    """The sites of a closed body with their boxes, and a sample of its boundary."""

    sites: BodySites
    samples: cKDTree

    @classmethod
    def of(cls, brep: Brep, free_form: Mapping[int, FreeFormSurface]) -> BoundaryDistance:
        """That of a body without motions, whose spline carriers are given with their distances, by their numbers."""
        size = float(np.linalg.norm(np.ptp(brep.vertices, axis=0)))
        curves = [brep.curves[c] for c in brep.edges.curve.tolist()]
        regions = build_regions(brep, list_carriers(brep, free_form), curves, BORDER_SAG * size)
        sites: list[Site] = [FaceSite(region, BORDER_SAG * size) for region in regions]
        sites += [EdgeSite(curve, tuple(span)) for curve, span in zip(curves, brep.edges.span.tolist(), strict=True)]
        sites += [VertexSite(point) for point in brep.vertices]
        samples = cKDTree(np.concatenate([_sample(region) for region in regions]))
        return cls(BodySites.of(sites, 0.0, size), samples)

    def feet(self, points: Array) -> tuple[Array, Array]:
        """Distances (n,) of points (n, 3), without a sign, and the nearest points (n, 3) of the boundary."""
        distances, feet = np.empty(len(points)), np.empty((len(points), 3))
        for group in _group_near_points(points):
            distances[group], feet[group] = self._find_feet(points[group])
        return distances, feet

    def _find_feet(self, points: Array) -> tuple[Array, Array]:
        best, nearest = self.samples.query(points)
        feet = np.asarray(self.samples.data)[nearest]
        for s, at in self.sites.near_boxes(points, best):
            site = self.sites.sites[s]
            distance, uv = site.feet(points[at], float(best[at].max()))
            closer = distance < best[at]
            at, uv = at[closer], uv[closer]
            best[at] = distance[closer]
            if isinstance(site, FaceSite):
                feet[at] = site.region.carrier(*uv.T)
            elif isinstance(site, EdgeSite):
                feet[at] = site.curve(uv[:, 0])
            elif isinstance(site, VertexSite):
                feet[at] = site.point
        return best, feet


def _group_near_points(points: Array) -> list[IntArray]:
    """Numbers of points (n, 3) in groups, by the cells of a grid."""
    if not len(points):
        return []
    count = -(-len(points) // POINTS_AT_ONCE)
    edge = float(np.ptp(points, axis=0).max()) / np.cbrt(count)
    cells = np.floor((points - points.min(axis=0)) / edge) if edge else points
    return np.array_split(np.lexsort(cells.T), count)


def _sample(region: FaceRegion) -> Array:
    """Points (n, 3) of a face: nodes of a grid in it, and of its border."""
    low, high = region.segments.min(axis=(0, 1)), region.segments.max(axis=(0, 1))
    lines = (np.linspace(a, b, SAMPLES_PER_AXIS) for a, b in zip(low, high, strict=True))
    uv = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2)
    inside = points_in_polygons(region.segments[:, 0], region.segments[:, 1], uv)
    return np.concatenate([region.carrier(*uv[inside].T), region.border[:, 0]])
