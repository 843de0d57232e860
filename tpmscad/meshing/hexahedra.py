"""Hexahedra of a wall straight from its trivariate splines: nodes at chosen parameters, numbered by connectivity.

The bodies of a wall stand on quadrilaterals that share corners and sides. A node of the lowest layer belongs to a corner, to a
side, at a step along it, or to the inside of a quadrilateral; the same holds for the layers above it. So nodes are shared because
the bodies are neighbours, and no coordinates are compared. The same numbering on the connectivity modulo the periods says which
nodes are translates of each other.

Local nodes of an element follow VTK: its faces are its bottom, its top, then those over the four sides of the quadrilateral. In a
left-handed body bottom and top change places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.lattices.spline_volumes import SideConnectivity, SplineVolumes
from tpmscad.meshing.element_shapes import SHAPES
from tpmscad.meshing.volume_mesh import VolumeMesh, name_translation, sort_nodes

KINDS = {(1, False): "hexahedron", (2, False): "hexahedron27", (2, True): "hexahedron20"}
"""Kinds of elements by order and whether they are serendipity elements, without nodes inside faces and elements."""

SPEED_SAMPLES = 65
"""Samples of the speed along each parameter from which lengths are taken."""

BOTTOM, TOP, FIRST_SIDE = 0, 1, 2
"""Numbers of the faces of an element."""

Index = tuple[slice | int, ...]
SIDE_LINES: tuple[Index, ...] = (np.s_[:, 1:-1, 0], np.s_[:, -1, 1:-1], np.s_[:, -2:0:-1, -1], np.s_[:, 0, -2:0:-1])
"""The inner nodes of each side, counter-clockwise, in an array (bodies, along u, along v)."""

SIDE_ROWS: tuple[Index, ...] = (np.s_[:, :, 0], np.s_[:, -1, :], np.s_[:, :, -1], np.s_[:, 0, :])
"""The elements at each side in an array (bodies, along u, along v, ...)."""


@dataclass(frozen=True, slots=True, eq=False)
class NodeGrid:
    """The nodes of all bodies: points (n, 3), and their numbers on the grid of each body (bodies, N + 1, N + 1, M + 1).

    `mismatch` is the greatest distance between the places that neighbours give to a node that they share.
    """

    points: Array
    numbers: IntArray
    mismatch: float


def mesh_hexahedra(
    volumes: SplineVolumes, order: int, cuts: tuple[int, int], *, serendipity: bool = False, name: str = "part"
) -> VolumeMesh:
    """The mesh of a wall; each body is cut so many times along both sides, and through the wall.

    Its groups of facets are "surface +", "surface -", and the border of the wall: "gap", or caps with their axes.
    """
    kind = KINDS[order, serendipity]
    along, through = (n + 1 for n in cuts)
    grid = place_nodes(volumes, order * along, order * through)
    elements = _list_elements(grid.numbers, kind, volumes.sense)  # (bodies, along, along, through, nodes)
    shared = volumes.connect()
    facets, groups = _list_facets(grid.points, elements, kind, volumes, shared)
    periodic = _pair_nodes(volumes, grid) if any(volumes.periods) else {}
    mesh = VolumeMesh(
        grid.points,
        {kind: elements.reshape(-1, elements.shape[-1])},
        {SHAPES[kind].face_kind: facets},
        {"body": np.arange(elements[..., 0].size)},
        groups,
        periodic,
        np.array([period or np.nan for period in volumes.periods]),
        name,
    )
    return sort_nodes(mesh)


def number_nodes(shared: SideConnectivity, steps: int, steps_through: int) -> IntArray:
    """Numbers of the nodes on the grid of each body, (n, steps + 1, steps + 1, steps_through + 1), layer by layer from w = 0."""
    n, inner = len(shared.corner), steps - 1
    layer = np.empty((n, steps + 1, steps + 1), np.int64)
    first_side = int(shared.corner.max()) + 1
    first_inside = first_side + (int(shared.side.max()) + 1) * inner
    layer[:, 1:-1, 1:-1] = first_inside + np.arange(n * inner**2).reshape(n, inner, inner)
    along = np.arange(inner)
    for side, line in enumerate(SIDE_LINES):
        forward = shared.direction[:, side, None] > 0
        layer[line] = first_side + shared.side[:, side, None] * inner + np.where(forward, along, along[::-1])
    for corner, (i, j) in enumerate(((0, 0), (-1, 0), (-1, -1), (0, -1))):
        layer[:, i, j] = shared.corner[:, corner]
    return layer[..., None] + (first_inside + n * inner**2) * np.arange(steps_through + 1)


def space_parameters(volumes: SplineVolumes, shared: SideConnectivity, steps: int) -> tuple[Array, Array]:
    """Fractions (steps + 1,) of the ranges of u and v at equal lengths along the wall, on the mean over all its lines.

    All bodies take the same ones. They are symmetric if neighbours run along a side in opposite senses, and the same for u and v
    if a line u = const of one body is a line v = const of its neighbour.
    """
    speed = np.zeros((2, SPEED_SAMPLES))
    for body in volumes.primitives:
        (u0, u1), (v0, v1), (w0, w1) = body.domain
        u, v = (np.linspace(*ends, SPEED_SAMPLES) for ends in body.domain[:2])
        middle = [(w0 + w1) / 2]
        speed[0] += (u1 - u0) * np.linalg.norm(body.grid(u, v, middle, (1, 0, 0)), axis=-1).mean(axis=(1, 2))
        speed[1] += (v1 - v0) * np.linalg.norm(body.grid(u, v, middle, (0, 1, 0)), axis=-1).mean(axis=(0, 2))
    kinds = np.broadcast_to(np.arange(4) % 2, shared.side.shape)
    if len(np.unique(np.stack([shared.side, kinds], axis=-1).reshape(-1, 2), axis=0)) > shared.side.max() + 1:
        speed[:] = speed.mean(axis=0)
    if (shared.direction < 0).any():
        speed = speed + speed[:, ::-1]
    t, wanted = np.linspace(0.0, 1.0, SPEED_SAMPLES), np.linspace(0.0, 1.0, steps + 1)
    length = np.pad(np.cumsum(speed[:, 1:] + speed[:, :-1], axis=1), ((0, 0), (1, 0)))
    along_u, along_v = (np.interp(wanted, line / line[-1], t) for line in length)
    return along_u, along_v


def place_nodes(volumes: SplineVolumes, steps: int, steps_through: int) -> NodeGrid:
    """The nodes at steps of equal mean length along the wall and through it, those of neighbours shared."""
    shared = volumes.connect()
    numbers = number_nodes(shared, steps, steps_through)
    u, v = space_parameters(volumes, shared, steps)
    w = np.linspace(0.0, 1.0, steps_through + 1)
    grids = np.stack(
        [
            body.grid(u0 + (u1 - u0) * u, v0 + (v1 - v0) * v, w0 + (w1 - w0) * w)
            for body in volumes.primitives
            for (u0, u1), (v0, v1), (w0, w1) in [body.domain]
        ]
    )
    placed = volumes.motion[:, None].apply(grids.reshape(len(grids), -1, 3)[volumes.carrier]).reshape(-1, 3)
    points = np.empty((int(numbers.max()) + 1, 3))
    points[numbers.ravel()[::-1]] = placed[::-1]  # the first body that has a node places it
    return NodeGrid(points, numbers, float(np.abs(points[numbers.ravel()] - placed).max()))


def _list_elements(numbers: IntArray, kind: str, sense: IntArray) -> IntArray:
    """Nodes of the elements of every body, in the order of VTK: (n, N, N, M, nodes)."""
    order = SHAPES[kind].degree
    offsets = np.rint(order * SHAPES[kind].nodes).astype(np.int64)
    along, _, through = ((count - 1) // order for count in numbers.shape[1:])
    a, b, c = np.meshgrid(*(order * np.arange(n) for n in (along, along, through)), indexing="ij")
    body = np.arange(len(numbers))[:, None, None, None]
    columns = []
    for i, j, k in offsets.tolist():
        rise = np.where(sense > 0, k, order - k)[:, None, None, None]
        columns.append(numbers[body, a + i, b + j, c + rise])
    return np.stack(columns, axis=-1)


def _list_facets(
    points: Array, elements: IntArray, kind: str, volumes: SplineVolumes, shared: SideConnectivity
) -> tuple[IntArray, dict[str, IntArray]]:
    """The facets of the boundary with outward normals, and their numbers in each group."""
    faces = [list(face) for face in SHAPES[kind].faces]
    width = len(faces[0])
    upright = volumes.sense > 0
    bottom, top = elements[:, :, :, 0], elements[:, :, :, -1]
    parts: dict[str, list[IntArray]] = {
        "surface +": [top[upright][..., faces[TOP]], top[~upright][..., faces[BOTTOM]]],
        "surface -": [bottom[upright][..., faces[BOTTOM]], bottom[~upright][..., faces[TOP]]],
    }
    for side, row in enumerate(SIDE_ROWS):
        border = elements[row][shared.is_open[:, side]][..., faces[FIRST_SIDE + side]]
        for own in border:
            parts.setdefault(_name_border(points, own.reshape(-1, width)[0], volumes.border), []).append(own)
    blocks = {name: np.concatenate([p.reshape(-1, width) for p in found]) for name, found in parts.items()}
    ends = np.cumsum([0, *map(len, blocks.values())])
    groups = {name: np.arange(a, b) for name, a, b in zip(blocks, ends[:-1], ends[1:], strict=True) if b > a}
    return np.concatenate(list(blocks.values())), groups


def _name_border(points: Array, facet: IntArray, border: str) -> str:
    """Name of the group of a facet at the border of the wall: caps have the axis that they face."""
    if border != "cap":
        return border
    p = points[facet[:4]]
    normal = np.cross(p[2] - p[0], p[3] - p[1])
    axis = int(np.abs(normal).argmax())
    return f"{border} {'XYZ'[axis]}{'+' if normal[axis] > 0 else '-'}"


def _pair_nodes(volumes: SplineVolumes, grid: NodeGrid) -> dict[str, IntArray]:
    """Pairs (p, 2) of nodes and their images by the translations along the axes, by the translation's name.

    At a border that is not flat, nodes may be images of each other by combined translations only; then one pair, with a name such
    as "x-z", ties what the pairs along the axes leave apart.
    """
    steps, through = grid.numbers.shape[1] - 1, grid.numbers.shape[3] - 1
    classes = np.empty(len(grid.points), np.int64)
    classes[grid.numbers.ravel()] = number_nodes(volumes.connect(volumes.periods), steps, through).ravel()
    _, first, label, count = np.unique(classes, return_index=True, return_inverse=True, return_counts=True)
    repeated = np.flatnonzero(count[label] > 1)
    label, first = label[repeated], first[label[repeated]]
    periods = np.array(volumes.periods)
    gap = np.divide(
        grid.points[repeated] - grid.points[first], periods, where=periods > 0, out=np.zeros((len(first), 3))
    )
    place = np.column_stack([label, np.rint(gap).astype(np.int64)])
    node_at = dict(zip(map(tuple, place.tolist()), repeated.tolist(), strict=True))
    pairs: dict[str, list[tuple[int, int]]] = {}
    for axis in range(3):
        step = np.eye(4, dtype=np.int64)[axis + 1]
        for own, image in zip(repeated.tolist(), map(tuple, (place + step).tolist()), strict=True):
            if image in node_at:
                pairs.setdefault(name_translation(step[1:]), []).append((own, node_at[image]))
    n = len(grid.points)
    tied = np.array([pair for found in pairs.values() for pair in found], np.int64).reshape(-1, 2)
    part = label_linked(n, tied)
    seen = set(part[first].tolist())
    for own, origin, translation in zip(repeated.tolist(), first.tolist(), place[:, 1:], strict=True):
        if part[own] not in seen:
            seen.add(part[own])
            pairs.setdefault(name_translation(translation), []).append((origin, own))
    return {name: np.array(found) for name, found in sorted(pairs.items())}
