"""The changes of a layout that start from one of its polygons: diagonals, sides of triangles, and strips."""

from __future__ import annotations

from tpmscad.patches.levelset.layout.collapse import Change, Polygons

STRIP = 8
"""Quadrilaterals of the longest strips that are collapsed."""


def changes(polygons: Polygons, number: int) -> list[Change]:
    """What may be collapsed or joined that starts from the polygon of that number.

    Of a quadrilateral its diagonals, and the strips from its sides on the box; of a triangle its sides with other triangles,
    taken out or collapsed, those with quadrilaterals, which become triangles, and the strips from its sides.
    """
    polygon = polygons.polygon[number]
    found: list[Change | None] = []
    if len(polygon) == 4:
        for a, c in ((polygon[0], polygon[2]), (polygon[1], polygon[3])):
            into = _merging(polygons, a, c, False)
            if into is not None:
                found.append(polygons.collapsed(into, [number]))
    return [change for change in found if change is not None] + sideways(polygons, number)


def sideways(polygons: Polygons, number: int) -> list[Change]:
    """The changes that start from that polygon but for its diagonals."""
    polygon = polygons.polygon[number]
    found: list[Change | None] = []
    for i, v in enumerate(polygon):
        u = polygon[i - 1]
        other = polygons.beside.get((v, u), -1)
        if len(polygon) == 3:
            if other >= 0 and len(polygons.polygon[other]) == 3:
                found.append(polygons.joined(number, other, u, v))
            found += _strips(polygons, {}, [number], u, v)
        elif other < 0:
            into = _merging(polygons, u, v, True)
            if into is not None:
                found += _strips(polygons, into, [number], polygon[(i + 1) % 4], polygon[(i + 2) % 4])
    return [change for change in found if change is not None]


def _strips(polygons: Polygons, into: dict[int, int], gone: list[int], u: int, v: int) -> list[Change | None]:
    """Collapses of the side u to v and of those opposite, one after another, up to a triangle or the box.

    `into` and `gone`: the side on the box and the quadrilateral that a strip starts with, or nothing and a triangle.
    """
    found: list[Change | None] = []
    into, gone, start = dict(into), list(gone), len(into)
    used = set(into) | set(into.values())
    for _ in range(STRIP):
        other = polygons.beside.get((v, u), -1)
        step = _merging(polygons, u, v, other < 0)
        if step is None or used & {u, v} or other in gone:
            break
        used |= {u, v}
        into.update(step)
        if other < 0:
            found.append(polygons.collapsed(dict(into), gone))
            break
        corners = polygons.polygon[other]
        if len(corners) == 3:
            found.append(polygons.collapsed(dict(into), [*gone, other]))
            break
        if len(gone) == 1 and not start:
            found.append(polygons.collapsed(dict(into), gone))
        gone.append(other)
        i = corners.index(v)
        v, u = corners[i - 1], corners[(i + 2) % 4]
    return found


def _merging(polygons: Polygons, a: int, b: int, on_box: bool) -> dict[int, int] | None:
    """Which of two vertices goes into the other: towards the box and its edges, and along the box only."""
    if polygons.locked[a] or polygons.locked[b]:
        return None
    one, other = polygons.fixed[a], polygons.fixed[b]
    if one and other and (not on_box or one + other == 4):
        return None
    return {a: b} if (other, b) > (one, a) else {b: a}
