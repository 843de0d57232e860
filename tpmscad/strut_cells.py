"""Unit cells of strut lattices: nodes in cells and the struts between them, without NumPy, for the command line.

Cubic (P), body-centred (bcc; bccz with the edges along z), face-centred (fcc), both (fbcc); octahedron (centres of the faces) and
octet (with fcc: Deshpande, Fleck and Ashby, 2001); diamond (eight atoms, Fd-3m); kelvin (truncated octahedron, bcc packing);
rhombic dodecahedron and cuboctahedron about the centre of the cell; re-entrant (two crossed hexagons with inward struts). Flat
cells in the plane y = 0, which a map makes a stent of: rhombi, and the same re-entrant hexagons.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import combinations, product

Point = tuple[float, float, float]
Cell = tuple[tuple[Point, ...], tuple[tuple[int, int], ...]]

CORNERS: tuple[Point, ...] = tuple((float(x), float(y), float(z)) for x, y, z in product((0, 1), repeat=3))
FACE_CENTERS: tuple[Point, ...] = (
    (0.0, 0.5, 0.5),
    (1.0, 0.5, 0.5),
    (0.5, 0.0, 0.5),
    (0.5, 1.0, 0.5),
    (0.5, 0.5, 0.0),
    (0.5, 0.5, 1.0),
)
CENTER: Point = (0.5, 0.5, 0.5)

SAME_LENGTH = 1e-9
"""In cells: differences of lengths that are equal."""

DEFAULT_ANGLE = 20.0
"""Degrees by which the struts of a re-entrant cell lean inwards."""

WALL_END = 0.15
"""In cells: height at which the upright walls of a re-entrant cell begin."""

LARGEST_ANGLE = 30.0
"""Degrees at which the inner nodes of a re-entrant cell, at WALL_END + tan(angle) / 2, come within 0.13 of each other."""


def _join(nodes: tuple[Point, ...], length: float) -> Cell:
    """The nodes with struts between all pairs at a distance."""
    pairs = combinations(range(len(nodes)), 2)
    return nodes, tuple((i, j) for i, j in pairs if abs(math.dist(nodes[i], nodes[j]) - length) < SAME_LENGTH)


def _unite(*cells: Cell) -> Cell:
    """The struts of several cells on common nodes."""
    number: dict[Point, int] = {}
    struts = []
    for nodes, pairs in cells:
        own = [number.setdefault(node, len(number)) for node in nodes]
        struts += [(own[i], own[j]) for i, j in pairs]
    return tuple(number), tuple(struts)


def _cubic() -> Cell:
    return _join(CORNERS, 1.0)


def _bcc() -> Cell:
    return _join((CENTER, *CORNERS), math.sqrt(0.75))


def _bccz() -> Cell:
    nodes, struts = _cubic()
    upright = tuple((i, j) for i, j in struts if nodes[i][2] != nodes[j][2])
    return _unite(_bcc(), (nodes, upright))


def _octahedron() -> Cell:
    return _join(FACE_CENTERS, math.sqrt(0.5))


def _fcc() -> Cell:
    nodes, struts = _octet()
    return nodes, tuple((i, j) for i, j in struts if i < len(CORNERS) <= j)


def _octet() -> Cell:
    return _join((*CORNERS, *FACE_CENTERS), math.sqrt(0.5))


def _fbcc() -> Cell:
    return _unite(_fcc(), _bcc())


def _diamond() -> Cell:
    inner = ((0.25, 0.25, 0.25), (0.75, 0.75, 0.25), (0.75, 0.25, 0.75), (0.25, 0.75, 0.75))
    return _join((*CORNERS, *FACE_CENTERS, *inner), math.sqrt(3) / 4)


def _kelvin() -> Cell:
    steps = product((0.0, 0.25, 0.5, 0.75, 1.0), repeat=3)
    nodes = tuple(
        (a, b, c) for a, b, c in steps if sorted((abs(a - 0.5), abs(b - 0.5), abs(c - 0.5))) == [0.0, 0.25, 0.5]
    )
    return _join(nodes, math.sqrt(2) / 4)


def _rhombic_dodecahedron() -> Cell:
    cube = tuple((x, y, z) for x, y, z in product((0.25, 0.75), repeat=3))
    return _join((*cube, *FACE_CENTERS), math.sqrt(3) / 4)


def _cuboctahedron() -> Cell:
    middles = {tuple((a + b) / 2 for a, b in zip(CORNERS[i], CORNERS[j], strict=True)) for i, j in _cubic()[1]}
    return _join(tuple(sorted((x, y, z) for x, y, z in middles)), math.sqrt(0.5))


def _re_entrant(angle: float, y: float, sides: tuple[tuple[float, float], ...]) -> Cell:
    """Upright walls at (x, y) in the sides of the cell, joined to its axis at (0.5, y) by struts that lean inwards."""
    inner = WALL_END + 0.5 * math.tan(math.radians(angle))
    axis = ((0.5, y, 0.0), (0.5, y, inner), (0.5, y, 1 - inner), (0.5, y, 1.0))
    walls = tuple((*side, z) for side in sides for z in (WALL_END, 1 - WALL_END))
    struts = [(0, 1), (2, 3)]
    for k in range(len(sides)):
        low, high = 4 + 2 * k, 5 + 2 * k
        struts += [(low, high), (low, 1), (high, 2)]
    return (*axis, *walls), tuple(struts)


CELLS: dict[str, Callable[[], Cell]] = {
    "cubic": _cubic,
    "bcc": _bcc,
    "bccz": _bccz,
    "fcc": _fcc,
    "fbcc": _fbcc,
    "octahedron": _octahedron,
    "octet": _octet,
    "diamond": _diamond,
    "kelvin": _kelvin,
    "rhombic-dodecahedron": _rhombic_dodecahedron,
    "cuboctahedron": _cuboctahedron,
}

KINDS = (*CELLS, "re-entrant")
"""The kinds of strut lattices that fill space."""

FLAT_KINDS = ("rhombic-net", "re-entrant-net")
"""Those in the plane y = 0."""


def make_cell(kind: str, angle: float = DEFAULT_ANGLE) -> Cell:
    """The nodes of one cell, in cells, and its struts as pairs of their numbers."""
    if kind == "rhombic-net":
        return _join(((0.5, 0.0, 0.0), (1.0, 0.0, 0.5), (0.5, 0.0, 1.0), (0.0, 0.0, 0.5)), math.sqrt(0.5))
    if kind == "re-entrant-net":
        return _re_entrant(angle, 0.0, ((0.0, 0.0), (1.0, 0.0)))
    if kind == "re-entrant":
        return _re_entrant(angle, 0.5, ((0.0, 0.5), (1.0, 0.5), (0.5, 0.0), (0.5, 1.0)))
    return CELLS[kind]()


LARGEST_DIAMETERS: dict[str, float] = {
    "cubic": 1.0,
    "bcc": math.sqrt(1 / 2),
    "bccz": (math.sqrt(6) - math.sqrt(2)) / 2,
    "fcc": math.sqrt(1 / 3),
    "fbcc": math.sqrt(1 / 6),
    "octahedron": math.sqrt(1 / 6),
    "octet": math.sqrt(1 / 6),
    "diamond": math.sqrt(3) / 4,
    "kelvin": math.sqrt(2) / 4,
    "rhombic-dodecahedron": math.sqrt(1 / 6),
    "cuboctahedron": math.sqrt(1 / 6),
    "re-entrant": 2 * WALL_END,
}
"""In cells, for cubic cells and DEFAULT_ANGLE, without balls: the diameter at which struts begin to touch beside their nodes.

Below it the struts are one piece, however thin, and so is their void (`python -m benchmarks.one_piece_ranges struts`).
"""
