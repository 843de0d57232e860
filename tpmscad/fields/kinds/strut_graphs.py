"""Round struts along the edges of a graph, with balls at its nodes, as a signed distance: exact outside.

Lattices of unit cells (`tpmscad.strut_cells`) and graphs of any kind, Voronoi and Delaunay among them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import call_for_array, validate_call
from tpmscad.api.shared_kinds import (
    ANGLE,
    CELL_COUNTS,
    END_VALUES,
    GRADED_THICKNESS,
    LENGTHS,
    NOT_NEGATIVE,
    PAIR_ROWS,
    POINT_ROWS,
)
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.fields.data.edge_radii import greatest_radii, order_ends
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.coordinate_transforms import IDENTITY
from tpmscad.fields.kinds.expressions import expression
from tpmscad.fields.kinds.strut_distances import NearStruts, find_near, measure_struts
from tpmscad.fields.tape.evaluation import FieldJet, Triple, stack_points
from tpmscad.memory_limit import require_memory
from tpmscad.strut_cells import DEFAULT_ANGLE, FLAT_KINDS, KINDS, LARGEST_ANGLE, make_cell

BYTES_PER_PART_OF_CELL = 100
"""Memory taken at the peak for each node and each strut of every cell, as measured."""

SAME_NODE = 1e-9
"""In sizes of the graph: distance up to which nodes are one."""

STRAIGHT = 1e-9
"""Sine of the angle up to which two struts continue each other."""

CHANGED_FIELDS = 64
"""Moved and offset fields that are kept: each is asked for several times, and has a grid of its own."""

STRUT_DIAMETERS = GRADED_THICKNESS.or_else(END_VALUES)

NodeRadius = Annotated[
    float,
    NOT_NEGATIVE,
    "Radius of the ball at every node, model units; 0, or less than half the diameter, is that of the struts, which rounds free "
    "ends and fills the outer side of joints.",
]


@dataclass(frozen=True, slots=True, eq=False)
class StrutsField(Field):
    """Distance to the struts (m, 2) between points (n, 3), and to balls at the points.

    radii (m, 2): of each strut at its start and its end, between which it is a cone that touches the balls of these radii. balls
    (n,): radii at the points, at least those of the struts there. parts: starts, vectors and radii of struts and larger balls.
    """

    points: Array
    edges: IntArray
    radii: Array
    balls: Array
    parts: tuple[Array, Array, Array]
    near: NearStruts

    @property
    def diameters(self) -> Array:
        """The diameter of each strut at its start and its end, (m, 2)."""
        return 2 * self.radii

    @property
    def is_even(self) -> bool:
        """Whether all struts have one diameter throughout, and all balls one radius."""
        return bool(self.radii.min() == self.radii.max() and self.balls.min() == self.balls.max())

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        return self.jet(x, y, z)[0]

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast; on an axis the gradient is a unit vector across."""
        points, shape = stack_points(x, y, z)
        values, gradients = measure_struts(
            np.ascontiguousarray(points),
            *self.parts,
            *self.near,
        )
        gx, gy, gz = (gradients[:, axis].reshape(shape) for axis in range(3))
        return values.reshape(shape), gx, gy, gz

    def __repr__(self) -> str:
        low, high = 2 * self.radii.min(), 2 * self.radii.max()
        diameter = f"diameter={low:g}" if low == high else f"diameters from {low:g} to {high:g}"
        return f"StrutsField({len(self.points)} points, {len(self.edges)} struts, {diameter})"


def _list_parts(points: Array, edges: IntArray, radii: Array, balls: Array) -> tuple[Array, Array, Array]:
    """Starts (k, 3), vectors (k, 3) and radii at both ends (k, 2) of struts, and of the balls that are larger than their ends."""
    more = np.flatnonzero(balls > greatest_radii(len(points), edges, radii))
    start = points[edges[:, 0]]
    return (
        np.concatenate([start, points[more]]),
        np.concatenate([points[edges[:, 1]] - start, np.zeros((len(more), 3))]),
        np.concatenate([radii, np.column_stack([balls[more], balls[more]])]),
    )


@validate_call()
def struts(
    points: Annotated[Any, POINT_ROWS, "Nodes (n, 3), model units."],
    edges: Annotated[Any, PAIR_ROWS, "The two nodes of each strut, by their numbers from 0: (m, 2)."],
    diameter: Annotated[
        float | Any,
        STRUT_DIAMETERS,
        "Diameter, model units: of all struts, of each edge (m,), or at both ends of each (m, 2), between which it is a cone; or "
        "a function of points (n, 3), a field, or a formula of x, y and z, asked at the nodes.",
    ],
    node_radius: NodeRadius = 0.0,
) -> StrutsField:
    """Return round struts along the edges of a graph.

    Returns
    -------
    StrutsField
        The signed distance, exact outside. `points` and `edges` are those in use: without nodes that no strut reaches, and
        with one strut in place of two of the same diameter that continue each other.

    Raises
    ------
    InvalidRequest
        If an edge names no node, has no length or is given twice, or there is not one diameter for each edge.

    Notes
    -----
    `tpmscad.solidify` and `tpmscad.infill` make exact solids of it, of cylinders, of cones that touch the balls at both ends, and
    of balls. The ball in a node is that of its thickest struts, in which thinner ones end; struts that touch outside their nodes
    are cut by each other. Where struts are nowhere apart, an end may be thinner, by at most half of `tol`, which is told.

    Examples
    --------
    >>> from tpmscad import fields
    >>> tripod = fields.struts([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 1], [0, 2], [0, 3]], 2.0)
    >>> float(tripod((5.0, 3.0, 0.0)))
    2.0
    """
    points, edges = np.asarray(points, float), np.asarray(edges, np.int64)
    if points.shape[1:] != (3,) or edges.shape[1:] != (2,):
        raise InvalidRequest(f"points {points.shape} and edges {edges.shape} must be arrays (n, 3) and (m, 2)")
    outside = np.flatnonzero(((edges < 0) | (edges >= len(points))).any(axis=1))
    if len(outside):
        i, j = edges[outside[0]].tolist()
        raise InvalidRequest(
            f"edge {outside[0]} joins nodes {i} and {j}: the nodes are numbered from 0 to {len(points) - 1}"
        )
    size = float(np.ptp(points, axis=0).max())
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    short = np.flatnonzero(length <= SAME_NODE * size)
    if len(short):
        i, j = edges[short[0]].tolist()
        raise InvalidRequest(
            f"edge {short[0]} between nodes {i} and {j} has no length, at {format_point(points[i], 6)}: leave it out"
        )
    ordered = np.sort(edges, axis=1)
    unique, first = np.unique(ordered, axis=0, return_index=True)
    if len(unique) < len(edges):
        again = int(np.setdiff1d(np.arange(len(edges)), first)[0])
        i, j = edges[again].tolist()
        raise InvalidRequest(f"edge {again} joins nodes {i} and {j} once more: give each strut once")
    diameters = _grade_diameters(diameter, points)[edges] if _is_graded(diameter) else np.asarray(diameter, float)
    if diameters.ndim and len(diameters) != len(edges):
        raise InvalidRequest(
            f"diameter has {len(diameters)} values for {len(edges)} edges: give one number, one for each edge, or a pair"
        )
    radii = np.broadcast_to(diameters[:, None] / 2 if diameters.ndim == 1 else diameters / 2, (len(edges), 2))
    ordered, radii = order_ends(edges, radii)
    if node_radius <= radii.min():
        ordered, radii = _join_straight(points, ordered, radii)
    return build_struts(points, ordered, radii, np.full(len(points), float(node_radius)))


def _is_graded(diameter: Any) -> bool:
    """Whether a diameter is a function of the place."""
    return callable(diameter) or isinstance(diameter, str)


def _grade_diameters(diameter: Any, points: Array) -> Array:
    """The diameters (n,) at nodes (n, 3) by a function, a field or a formula; InvalidRequest where one is not positive."""
    found = call_for_array("diameter", expression(diameter) if isinstance(diameter, str) else diameter, points)
    if found.shape != (len(points),):
        raise InvalidRequest(
            f"diameter returned an array of shape {found.shape} for {len(points)} nodes: give one for each"
        )
    wrong = np.flatnonzero(~(found > 0) | ~np.isfinite(found))
    if len(wrong):
        place = format_point(points[wrong[0]], 5)
        raise InvalidRequest(f"diameter is {found[wrong[0]]:g} at the node {place}, and must be positive at all nodes")
    return found


def build_struts(points: Array, edges: IntArray, radii: Array, balls: Array) -> StrutsField:
    """The field of struts with radii (m, 2) at their ends and balls of at least the radii (n,), and of the points they reach."""
    used, numbers = np.unique(edges, return_inverse=True)
    points, edges = points[used], numbers.reshape(-1, 2)
    balls = np.maximum(balls[used], greatest_radii(len(points), edges, radii))
    parts = _list_parts(points, edges, radii, balls)
    near = find_near(points, 2 * float(balls.max()), *parts)
    return StrutsField(points, edges, radii, balls, parts, near)


@lru_cache(maxsize=CHANGED_FIELDS)
def change_struts(
    field: StrutsField,
    matrix: tuple[Triple, Triple, Triple] = IDENTITY,
    shift: Triple = (0.0, 0.0, 0.0),
    factor: float = 1.0,
    distance: float = 0.0,
) -> StrutsField:
    """The struts with nodes at matrix p + shift, their radii and that of the balls times a factor and greater by a distance."""
    points = field.points @ np.array(matrix).T + np.array(shift)
    radii = factor * field.radii + distance
    return build_struts(points, field.edges, radii, factor * field.balls + distance)


def map_struts(field: StrutsField, function: Callable[[Array], Array]) -> StrutsField:
    """Straight struts of the same radii between the images of the nodes; nodes that a map lays on each other are one."""
    points = np.asarray(function(field.points))
    near = SAME_NODE**0.5 * float(np.ptp(points, axis=0).max())
    pairs = cKDTree(points).query_pairs(near, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    _, number = connected_components(links, directed=False)
    _, first = np.unique(number, return_index=True)
    ordered, radii = order_ends(number[field.edges], field.radii)
    edges, kept = np.unique(ordered, axis=0, return_index=True)
    balls = np.zeros(len(first))
    np.maximum.at(balls, number, field.balls)
    return build_struts(points[first], edges, radii[kept], balls)


def _join_straight(points: Array, edges: IntArray, radii: Array) -> tuple[IntArray, Array]:
    """The edges and radii with one in place of two equal cylinders that continue each other at a node without others."""
    at: dict[int, dict[int, tuple[float, float]]] = {}
    for (i, j), (first, last) in zip(edges.tolist(), radii.tolist(), strict=True):
        at.setdefault(i, {})[j] = first, last
        at.setdefault(j, {})[i] = last, first
    for node in list(at):
        if len(at[node]) != 2:
            continue
        i, j = sorted(at[node])
        if len({*at[node][i], *at[node][j]}) > 1:
            continue
        back, on = points[i] - points[node], points[j] - points[node]
        cross = np.linalg.norm(np.cross(back, on))
        if back @ on < 0 and cross <= STRAIGHT * np.linalg.norm(back) * np.linalg.norm(on) and j not in at[i]:
            at[i][j] = at[j][i] = at[node][i]
            del at[node], at[i][node], at[j][node]
    joined = sorted((i, j) for i, others in at.items() for j in others if i < j)
    return np.array(joined, np.int64), np.array([at[i][j] for i, j in joined])


@validate_call()
def strut_lattice(
    structure: Annotated[str, choice_of(*KINDS, *FLAT_KINDS), "Kind of cell; nets lie in the plane y = 0."],
    cell: Annotated[float | Sequence[float], LENGTHS, "Edge length of the cell, or one for each axis, model units."],
    diameter: Annotated[
        float | str | Callable[[Array], Array],
        GRADED_THICKNESS,
        "Diameter of the struts, model units; or a function of points (n, 3), a field, or a formula of x, y and z, asked at the "
        "nodes, between which struts are cones.",
    ],
    cells: Annotated[int | Sequence[int], CELL_COUNTS, "Number of cells along every axis, or along each."] = (1, 1, 1),
    node_radius: NodeRadius = 0.0,
    angle: Annotated[
        float, ANGLE, "Degrees by which struts of `re-entrant` and its net lean inwards, up to 30."
    ] = DEFAULT_ANGLE,
) -> StrutsField:
    """Return a lattice of round struts in the box from the origin to `cells` x `cell`.

    Returns
    -------
    StrutsField
        The signed distance, exact outside; struts in the sides of the box reach beyond them by half their diameter.

    Raises
    ------
    InvalidRequest
        If the angle is none of a re-entrant cell.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.strut_lattice("bcc", 10.0, 1.0)((5.0, 5.0, 5.0)))
    -0.5
    """
    return struts(*make_strut_graph(structure, cell, cells, angle), diameter, node_radius)


def make_strut_graph(
    kind: str, cell: float | Sequence[float], cells: int | Sequence[int], angle: float = DEFAULT_ANGLE
) -> tuple[Array, IntArray]:
    """The nodes (n, 3) and struts (m, 2) of whole cells."""
    if not 0 < angle <= LARGEST_ANGLE:
        raise InvalidRequest(
            f"angle {angle:g} of the re-entrant cell must be more than 0 and at most {LARGEST_ANGLE:g} degrees"
        )
    nodes, pairs = (np.array(each) for each in make_cell(kind, angle))
    edge = np.broadcast_to(np.asarray(cell, float), 3)
    counts = np.broadcast_to(np.asarray(cells, float), 3)  # an int64 may be too small for what was asked
    require_memory(
        float(np.prod(counts)) * (len(nodes) + len(pairs)),
        BYTES_PER_PART_OF_CELL,
        f"struts of {' x '.join(f'{count:.15g}' for count in counts.tolist())} cells",
        "use fewer cells",
    )
    numbers = (np.arange(count) for count in counts.astype(np.int64).tolist())
    origins = np.stack(np.meshgrid(*numbers, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    placed = (origins + nodes).reshape(-1, 3)
    _, first, number = np.unique((placed / SAME_NODE**0.5).round(), axis=0, return_index=True, return_inverse=True)
    struts_of_cells = (len(nodes) * np.arange(len(origins))[:, None, None] + pairs).reshape(-1, 2)
    edges = np.unique(np.sort(number.ravel()[struts_of_cells], axis=1), axis=0)
    return placed[first] * edge, edges
