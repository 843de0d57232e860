"""The changes of a layout that start from one of its polygons: diagonals, sides of triangles, and strips."""

from __future__ import annotations

from dataclasses import dataclass

from tpmscad.patches.levelset.layout.collapse import Change, Polygons

STRIP = 8
"""Quadrilaterals of the longest strips that are collapsed."""


@dataclass(frozen=True, slots=True)
class Start:
    """What a change starts with: vertices that go `into` others, or none where the side `joint` between two triangles is taken
    out; and the polygons, by number, that are `gone` with it at least."""

    into: tuple[tuple[int, int], ...]
    gone: tuple[int, ...]
    joint: tuple[int, int] = (-1, -1)


def made(polygons: Polygons, start: Start) -> Change | None:
    """The change that starts so, or None where it can't be made, or no longer."""
    if any(number not in polygons.polygon for number in start.gone):
        return None
    if start.into:
        return polygons.collapsed(dict(start.into), start.gone)
    one, other = start.gone
    return polygons.joined(one, other, *start.joint)


def changes(polygons: Polygons, number: int) -> list[Change]:
    """What may be collapsed or joined that starts from the polygon of that number.

    Of a quadrilateral its diagonals, and the strips from its sides on the box; of a triangle its sides with other triangles,
    taken out or collapsed, those with quadrilaterals, which become triangles, and the strips from its sides.
    """
    polygon = polygons.polygon[number]
    found = []
    if len(polygon) == 4:
        for a, c in ((polygon[0], polygon[2]), (polygon[1], polygon[3])):
            into = _merging(polygons, a, c, False)
            if into is not None:
                found.append(Start((into,), (number,)))
    starts = [*found, *sideways(polygons, number)]
    return [change for change in (made(polygons, start) for start in starts) if change is not None]


def sideways(polygons: Polygons, number: int) -> list[Start]:
    """The changes that may start from that polygon but for its diagonals."""
    polygon = polygons.polygon[number]
    found: list[Start] = []
    for i, v in enumerate(polygon):
        u = polygon[i - 1]
        other = polygons.beside.get((v, u), -1)
        if len(polygon) == 3:
            if other >= 0 and len(polygons.polygon[other]) == 3:
                found.append(Start((), (number, other), (u, v)))
            found += _strips(polygons, [], [number], u, v)
        elif other < 0:
            into = _merging(polygons, u, v, True)
            if into is not None:
                found += _strips(polygons, [into], [number], polygon[(i + 1) % 4], polygon[(i + 2) % 4])
    return found


def _strips(polygons: Polygons, into: list[tuple[int, int]], gone: list[int], u: int, v: int) -> list[Start]:
    """Collapses of the side u to v and of those opposite, one after another, up to a triangle or the box.

    `into` and `gone`: the side on the box and the quadrilateral that a strip starts with, or nothing and a triangle.
    """
    found: list[Start] = []
    start = len(into)
    used = {v for pair in into for v in pair}
    for _ in range(STRIP):
        other = polygons.beside.get((v, u), -1)
        step = _merging(polygons, u, v, other < 0)
        if step is None or u in used or v in used or other in gone:
            break
        used |= {u, v}
        into.append(step)
        if other < 0:
            found.append(Start(tuple(into), tuple(gone)))
            break
        corners = polygons.polygon[other]
        if len(corners) == 3:
            found.append(Start(tuple(into), (*gone, other)))
            break
        if len(gone) == 1 and not start:
            found.append(Start(tuple(into), tuple(gone)))
        gone.append(other)
        i = corners.index(v)
        v, u = corners[i - 1], corners[(i + 2) % 4]
    return found


def _merging(polygons: Polygons, a: int, b: int, on_box: bool) -> tuple[int, int] | None:
    """Which of two vertices goes into the other: towards the box and its edges, and along the box only."""
    one, other = polygons.fixed[a], polygons.fixed[b]
    if one and other and (not on_box or one + other == 4):
        return None
    return (a, b) if (other, b) > (one, a) else (b, a)
