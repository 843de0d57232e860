"""Regions bounded by closed polygons: boolean operations by Clipper2 (A. Johnson, in the library Manifold), and fewer points.

Polygons are arrays (n, 2) without a repeated point. A region is where their winding number is positive: outer ones run
counter-clockwise, holes clockwise. Clipper2 computes with integers, hundred-millionths of a model unit here, so that its results
are closed and do not intersect themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, BoolArray
from tpmscad.index_ranges import list_following

Region = list[Array]
"""Closed polygons."""

MANIFOLD_FOR_LAYERS = "layers without a solid", "layers"
"""What needs Manifold, and the extra that installs it."""

Operation = Literal["intersection", "union", "difference"]


def combine_regions(first: Region, second: Region, operation: Operation) -> Region:
    """The intersection, union or difference of two regions."""
    manifold = import_extra("manifold3d", *MANIFOLD_FOR_LAYERS)
    one, other = (
        manifold.CrossSection([np.ascontiguousarray(polygon) for polygon in region], manifold.FillRule.Positive)
        if region
        else manifold.CrossSection()
        for region in (first, second)
    )
    found = {"intersection": one.__xor__, "union": one.__add__, "difference": one.__sub__}[operation](other)
    return [np.array(polygon) for polygon in found.to_polygons()]


def thin_curve(points: Array, error: float) -> Array:
    """An open curve (n, 2) with as few of its points as keep all others within `error` of it; both ends stay.

    Source: D. H. Douglas, T. K. Peucker, Cartographica 10 (1973) 112.
    """
    kept = np.zeros(len(points), bool)
    kept[[0, -1]] = True
    mark_kept(np.ascontiguousarray(points, float), 0, len(points) - 1, error, kept)
    return points[kept]


@njit_cached
def mark_kept(
    points: Array, first: int, last: int, error: float, kept: BoolArray
) -> None:  # pragma: no cover - compiled
    """Mark which points (n, 2) between `first` and `last`, which are kept, stay as in `thin_curve`, in `kept` (n,)."""
    spans = [(first, last)]
    while len(spans) > 0:
        a, b = spans.pop()
        if b - a < 2:
            continue
        cx, cy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        square = cx * cx + cy * cy
        at, most = a, -1.0
        for k in range(a + 1, b):
            x, y = points[k, 0] - points[a, 0], points[k, 1] - points[a, 1]
            share = min(1.0, max(0.0, (x * cx + y * cy) / square)) if square > 0.0 else 0.0
            off = (x - share * cx) ** 2 + (y - share * cy) ** 2
            if off > most:
                at, most = k, off
        if most > error * error:
            kept[at] = True
            spans.append((a, at))
            spans.append((at, b))


def thin_polygon(polygon: Array, error: float) -> Array:
    """A closed polygon (n, 2) with fewer points, as `thin_curve`; the first point and the one farthest from it stay."""
    return polygon[choose_points(np.concatenate([polygon, polygon[:1]]), error)]


@njit_cached
def choose_points(path: Array, error: float) -> Any:  # pragma: no cover - compiled
    """Which points (n,) of a closed contour (n + 1, 2) stay, as in `thin_polygon`."""
    n = len(path) - 1
    kept = np.zeros(n + 1, np.bool_)
    kept[0] = kept[n] = True
    if n < 3:
        return kept[:n]
    far, most = 0, 0.0
    for k in range(n):
        away = (path[k, 0] - path[0, 0]) ** 2 + (path[k, 1] - path[0, 1]) ** 2
        if away > most:
            far, most = k, away
    kept[far] = True
    mark_kept(path, 0, far, error, kept)
    mark_kept(path, far, n, error, kept)
    return kept[:n]


def signed_areas(region: Sequence[Array]) -> float:
    """Area of a region: that of outer polygons without holes."""
    (x0, y0), (x1, y1) = (ends.T for ends in _list_sides(region))
    return 0.5 * float(x0 @ y1 - x1 @ y0)


def region_length(region: Sequence[Array]) -> float:
    """Length of the boundary of a region."""
    begin, end = _list_sides(region)
    return float(np.hypot(*(end - begin).T).sum())


def _list_sides(region: Sequence[Array]) -> tuple[Array, Array]:
    """Both ends (n, 2) of all sides of the polygons, from the middle of the points."""
    points = np.concatenate([np.zeros((0, 2)), *region])
    points -= points.sum(axis=0) / max(len(points), 1)
    return points, points[list_following(np.cumsum([0, *map(len, region)]))]
