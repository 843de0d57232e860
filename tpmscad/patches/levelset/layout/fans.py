"""Whether the polygons round the vertices of a layout are one fan each, and as many as are wanted."""

from __future__ import annotations

from collections.abc import Iterable

Polygon = tuple[int, ...]

FEWEST, MOST = 3, 7
"""Polygons round a vertex inside the box."""


def wanted(count: int, inside: bool) -> bool:
    """Whether so many polygons are wanted round a vertex."""
    return count <= MOST and (count >= FEWEST or not inside)


def one_fan(vertex: int, polygons: Iterable[Polygon], inside: bool) -> bool:
    """Whether polygons follow each other round a vertex: all the way inside, from side to side on the box."""
    following = {}
    for polygon in polygons:
        i = polygon.index(vertex)
        following[polygon[(i + 1) % len(polygon)]] = polygon[i - 1]
    first = set(following) - set(following.values())
    if len(first) > 1 or bool(first) == inside:
        return False
    at = start = next(iter(first)) if first else next(iter(following))
    for _ in following:
        at = following.get(at, -1)
    return at not in following if first else at == start and len(set(following.values())) == len(following)
