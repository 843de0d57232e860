"""Finite elements: their nodes, faces and shape functions, and what is measured on them.

Nodes are numbered as in VTK and meshio: corners, middles of edges, of faces, and of the element. Faces are listed in the
order of Abaqus and CalculiX (S1, S2, ...), with normals outwards.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from tpmscad._typing import Array, IntArray

ELEMENTS_AT_ONCE = 20_000
"""Elements whose Jacobians are evaluated at once, which bounds the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class ElementShape:
    """A kind of element.

    nodes : (n, d) reference coordinates; the unit simplex, or the unit square or cube
    exponents : (n, d) exponents of the monomials that span the shape functions
    corners : number of corners, the first nodes
    faces : nodes of each face in the node order of `face_kind`; empty for facets
    degree : order of the element
    """

    nodes: Array
    exponents: IntArray
    corners: int
    faces: tuple[tuple[int, ...], ...]
    face_kind: str
    degree: int

    @property
    def is_simplex(self) -> bool:
        """Whether the element is a triangle or tetrahedron."""
        return self.corners == self.nodes.shape[1] + 1

    @property
    def reference_volume(self) -> float:
        """Volume of the reference element: 1/2, 1/6 or 1."""
        return {2: 0.5, 3: 1.0 / 6.0}[self.nodes.shape[1]] if self.is_simplex else 1.0

    def values(self, at: Array) -> Array:
        """Values (p, n) of the n shape functions at reference coordinates (p, d)."""
        return _monomials(at, self.exponents) @ np.linalg.inv(_monomials(self.nodes, self.exponents))

    def gradients(self, at: Array) -> Array:
        """Gradients (p, n, d) of the n shape functions at reference coordinates (p, d)."""
        coefficients = np.linalg.inv(_monomials(self.nodes, self.exponents))
        slopes = np.empty((*at.shape[:1], len(self.exponents), at.shape[1]))
        for axis in range(at.shape[1]):
            lowered = self.exponents.copy()
            lowered[:, axis] = np.maximum(lowered[:, axis] - 1, 0)
            slopes[..., axis] = self.exponents[:, axis] * _monomials(at, lowered)
        return np.einsum("pmd,mn->pnd", slopes, coefficients)


def _monomials(at: Array, exponents: IntArray) -> Array:
    """Monomials (p, m) with exponents (m, d) at points (p, d)."""
    return np.prod(at[:, None, :] ** exponents, axis=-1)


def _exponents(dimension: int, degree: int, kind: str) -> IntArray:
    """Exponents of polynomials of total degree ("simplex"), of degree in each variable ("tensor"), or of serendipity elements."""
    powers = np.array(list(itertools.product(range(degree + 1), repeat=dimension)))
    total = powers.sum(axis=1)
    superlinear = np.where(powers > 1, powers, 0).sum(axis=1)
    keep = {"simplex": total <= degree, "tensor": total >= 0, "serendipity": superlinear <= degree}[kind]
    return np.asarray(powers[keep], np.int64)


TRIANGLE_CORNERS = ((0, 0), (1, 0), (0, 1))
QUAD_CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))
TETRA_CORNERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
HEXAHEDRON_CORNERS = tuple((x, y, z) for z in (0, 1) for x, y in QUAD_CORNERS)
TETRA_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
HEXAHEDRON_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
TETRA_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
HEXAHEDRON_FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (0, 4, 7, 3))
MIDDLES_OF_HEXAHEDRON_FACES = (24, 25, 22, 21, 23, 20)
"""Node of VTK in the middle of each face of a hexahedron of 27 nodes."""


def _make(
    corners: tuple[tuple[int, ...], ...],
    edges: tuple[tuple[int, int], ...] = (),
    faces: tuple[tuple[int, ...], ...] = (),
    middles: tuple[int, ...] = (),
    face_kind: str = "",
    span: str = "simplex",
) -> ElementShape:
    """An element of first order, or of second order if it has nodes on edges; middles: those of faces, and one of the element."""
    points = np.array(corners, float)
    mid = {frozenset(edge): len(corners) + i for i, edge in enumerate(edges)}
    nodes = [points, *(points[list(edge)].mean(axis=0)[None] for edge in edges)]
    if middles and faces:
        order = np.argsort(middles)
        nodes += [points[list(faces[i])].mean(axis=0)[None] for i in order]
    if middles:
        nodes.append(points.mean(axis=0)[None])
    whole = []
    for i, face in enumerate(faces):
        sides = zip(face, (*face[1:], face[0]), strict=True)
        whole.append(
            (
                *face,
                *((mid[frozenset(side)] for side in sides) if edges else ()),
                *((middles[i],) if middles else ()),
            )
        )
    degree = 2 if edges else 1
    return ElementShape(
        np.concatenate(nodes), _exponents(points.shape[1], degree, span), len(corners), tuple(whole), face_kind, degree
    )


TRIANGLE_EDGES = ((0, 1), (1, 2), (2, 0))
QUAD_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0))

SHAPES: Mapping[str, ElementShape] = MappingProxyType(
    {
        "triangle": _make(TRIANGLE_CORNERS),
        "triangle6": _make(TRIANGLE_CORNERS, TRIANGLE_EDGES),
        "quad": _make(QUAD_CORNERS, span="tensor"),
        "quad8": _make(QUAD_CORNERS, QUAD_EDGES, span="serendipity"),
        "quad9": _make(QUAD_CORNERS, QUAD_EDGES, middles=(8,), span="tensor"),
        "tetra": _make(TETRA_CORNERS, faces=TETRA_FACES, face_kind="triangle"),
        "tetra10": _make(TETRA_CORNERS, TETRA_EDGES, TETRA_FACES, face_kind="triangle6"),
        "hexahedron": _make(HEXAHEDRON_CORNERS, faces=HEXAHEDRON_FACES, face_kind="quad", span="tensor"),
        "hexahedron20": _make(
            HEXAHEDRON_CORNERS, HEXAHEDRON_EDGES, HEXAHEDRON_FACES, face_kind="quad8", span="serendipity"
        ),
        "hexahedron27": _make(
            HEXAHEDRON_CORNERS,
            HEXAHEDRON_EDGES,
            HEXAHEDRON_FACES,
            MIDDLES_OF_HEXAHEDRON_FACES,
            face_kind="quad9",
            span="tensor",
        ),
    }
)
"""Every kind of element and facet, by its name in meshio."""


def add_middles(rows: Sequence[tuple[int, ...]], middle: Callable[[int, int], int], width: int) -> IntArray:
    """Corners (m, 3) or (m, 4) of triangles or tetrahedra with the nodes in the middles of their edges, if these have any."""
    edges = {3: (), 4: (), 6: TRIANGLE_EDGES, 10: TETRA_EDGES}[width]
    found = [[*row, *(middle(row[i], row[j]) for i, j in edges)] for row in rows]
    return np.array(found, np.int64).reshape(-1, width)


REGULAR_TETRAHEDRON = np.array([[1.0, 0.5, 0.5], [0.0, np.sqrt(3) / 2, np.sqrt(3) / 6], [0.0, 0.0, np.sqrt(2 / 3)]])
"""Columns: edges of a regular tetrahedron of edge 1, from its first corner."""


def jacobians(kind: str, nodes: Array, at: Array) -> Array:
    """Jacobians (m, p, 3, d) of elements with nodes (m, n, 3) at reference coordinates (p, d)."""
    return _map_gradients(nodes, SHAPES[kind].gradients(at))


def _map_gradients(nodes: Array, gradients: Array) -> Array:
    """Jacobians (m, p, 3, d) of elements with nodes (m, n, 3), given the gradients (p, n, d) of the shape functions."""
    p, n, d = gradients.shape
    flat = nodes.swapaxes(1, 2) @ gradients.swapaxes(0, 1).reshape(n, p * d)
    return flat.reshape(-1, 3, p, d).swapaxes(1, 2)


def determinants(matrices: Array) -> Array:
    """Determinants of matrices (..., 3, 3): several times faster than by the elimination of a library for any size."""
    a, b, c = (matrices[..., i, :] for i in range(3))
    across = b[..., [1, 2, 0]] * c[..., [2, 0, 1]] - b[..., [2, 0, 1]] * c[..., [1, 2, 0]]
    return np.asarray((a * across).sum(axis=-1))


@functools.cache
def _gradients_at_nodes(kind: str) -> Array:
    """Gradients (n, n, d) of the shape functions at the nodes."""
    return SHAPES[kind].gradients(SHAPES[kind].nodes)


@functools.cache
def _gradients_at_bernstein_samples(kind: str) -> Array:
    """Gradients (b, n, d) of the shape functions where a Jacobian determinant is sampled."""
    return SHAPES[kind].gradients(_bernstein_samples(kind)[0])


def jacobian_coefficients(kind: str, points: Array, cells: IntArray) -> Array:
    """Bernstein coefficients (m, b) of each element's Jacobian determinant: it lies between the least and the greatest of them.

    Their mean times the reference volume is the element's volume, exactly, as all Bernstein polynomials have the same integral.
    """
    to_bernstein, gradients = _bernstein_samples(kind)[1], _gradients_at_bernstein_samples(kind)
    parts = [
        determinants(_map_gradients(points[block], gradients)) @ to_bernstein.T
        for block in np.array_split(cells, max(1, -(-len(cells) // ELEMENTS_AT_ONCE)))
    ]
    return np.concatenate(parts)


@functools.cache
def _bernstein_samples(kind: str) -> tuple[Array, Array]:
    """Where a Jacobian determinant is sampled, and the matrix from the samples to its Bernstein coefficients."""
    shape = SHAPES[kind]
    if shape.is_simplex:
        degree = 3 * (shape.degree - 1)
        powers = _exponents(3, degree, "simplex")
        rest = degree - powers.sum(axis=1)
        at = powers / max(degree, 1)
        last = 1.0 - at.sum(axis=1)
        counts = _factorials(degree) / (_factorials(powers).prod(axis=1) * _factorials(rest))
        values = counts * _monomials(at, powers) * last[:, None] ** rest
    else:
        degree = 3 * shape.degree - 1
        powers = _exponents(3, degree, "tensor")
        at = powers / degree
        counts = (_factorials(degree) / (_factorials(powers) * _factorials(degree - powers))).prod(axis=1)
        values = counts * _monomials(at, powers) * _monomials(1.0 - at, degree - powers)
    return at, np.linalg.inv(values)


def _factorials(numbers: IntArray | int) -> Array:
    """The factorial of each number."""
    table = np.cumprod([1.0, *range(1, 12)])
    return np.asarray(table[numbers])


def inverse_condition_numbers(kind: str, points: Array, cells: IntArray) -> Array:
    """Signed inverse condition number (m,) of each element: its least at nodes and middle, 1 if regular, at most 0 if inverted.

    3 det J / (|J| |adj J|) in Frobenius norms, with J the Jacobian from the regular element: gmsh's SICN.
    """
    shape = SHAPES[kind]
    at = np.concatenate([shape.nodes, shape.nodes.mean(axis=0)[None]])
    to_regular = np.linalg.inv(REGULAR_TETRAHEDRON) if shape.is_simplex else np.eye(3)
    found = []
    for block in np.array_split(cells, max(1, -(-len(cells) // ELEMENTS_AT_ONCE))):
        matrix = jacobians(kind, points[block], at) @ to_regular
        adjugate = np.cross(matrix[..., [1, 2, 0]], matrix[..., [2, 0, 1]], axis=-2)
        norms = np.linalg.norm(matrix, axis=(-2, -1)) * np.linalg.norm(adjugate, axis=(-2, -1))
        found.append((3.0 * determinants(matrix) / np.maximum(norms, np.finfo(float).tiny)).min(axis=1))
    return np.concatenate(found)


def scaled_jacobians(kind: str, points: Array, cells: IntArray) -> Array:
    """Scaled Jacobian (m,) of each element: the least at its nodes of det J over the product of its columns' lengths.

    Times the square root of 2 for tetrahedra, so that a regular one has 1, as in Verdict.
    """
    shape = SHAPES[kind]
    matrix = _map_gradients(points[cells], _gradients_at_nodes(kind))
    scale = np.sqrt(2.0) if shape.is_simplex else 1.0
    lengths = np.linalg.norm(matrix, axis=-2)
    if shape.is_simplex:  # the three longest pairs of edges at the corner that is worst
        edges = np.stack(
            [matrix[..., 1] - matrix[..., 0], matrix[..., 2] - matrix[..., 0], matrix[..., 2] - matrix[..., 1]], -1
        )
        a, b, c = (lengths[..., i] for i in range(3))
        between = np.linalg.norm(edges, axis=-2)
        ab, ac, bc = (between[..., i] for i in range(3))
        products = np.max([a * b * c, a * ab * ac, b * ab * bc, c * ac * bc], axis=0)
    else:
        products = lengths.prod(axis=-1)
    return np.asarray((scale * determinants(matrix) / np.maximum(products, np.finfo(float).tiny)).min(axis=1))
