"""Arrays of a volume mesh: nodes, elements, facets of boundary and interfaces, named groups, and periodic pairs of nodes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.element_shapes import (
    SHAPES,
    inverse_condition_numbers,
    jacobian_coefficients,
    scaled_jacobians,
)

M = TypeVar("M", bound="MeshArrays")

AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class MeshQuality:
    """What was measured on the elements.

    Attributes
    ----------
    inverted : int
        Elements whose Jacobian determinant is not shown to be positive everywhere: its least Bernstein coefficient is not.
    smallest : float
        Least signed inverse condition number (gmsh's SICN): 1 for a regular element, at most 0 for an inverted one.
    smallest_scaled_jacobian : float
        Least scaled Jacobian at nodes, 1 for a regular element.
    mean : float
        Mean of the elements' signed inverse condition numbers.
    size : float
        Mean over elements of their mean edge length, model units.
    """

    inverted: int
    smallest: float
    smallest_scaled_jacobian: float
    mean: float
    size: float

    def __str__(self) -> str:
        return (
            f"{self.inverted} inverted elements, quality {self.smallest:.3g} at least and {self.mean:.3g} in the mean, "
            f"scaled Jacobian {self.smallest_scaled_jacobian:.3g} at least, edges of {self.size:.4g} in the mean"
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MeshArrays:
    """What a volume mesh holds, and what is measured on it; `VolumeMesh` says what each array is."""

    points: Array
    cells: Mapping[str, IntArray]
    facets: Mapping[str, IntArray] = field(default_factory=dict)
    cell_groups: Mapping[str, IntArray] = field(default_factory=dict)
    facet_groups: Mapping[str, IntArray] = field(default_factory=dict)
    periodic: Mapping[str, IntArray] = field(default_factory=dict)
    periods: Array = field(default_factory=lambda: np.full(3, np.nan))
    name: str = "part"
    straightened: int = 0
    moved: float = 0.0
    collapsed: int = 0
    merged: int = 0
    swapped: int = 0
    split: int = 0
    shifted: int = 0
    deviation: float = 0.0
    openings: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        for key in ("cells", "facets", "cell_groups", "facet_groups", "periodic"):
            frozen = {k: np.ascontiguousarray(v, np.int64) for k, v in getattr(self, key).items()}
            object.__setattr__(self, key, MappingProxyType(frozen))
        for kind, nodes in [*self.cells.items(), *self.facets.items()]:
            if nodes.ndim != 2 or nodes.shape[1] != len(SHAPES[kind].nodes):
                raise InvalidRequest(
                    f"{kind} has {len(SHAPES[kind].nodes)} nodes: its array of shape {nodes.shape} must have as many columns"
                )
            if nodes.size and not 0 <= nodes.min() <= nodes.max() < len(self.points):
                raise InvalidRequest(
                    f"{kind} names the nodes {nodes.min()} to {nodes.max()}: {len(self.points)} points are numbered from 0"
                )
        unknown = sorted(set(self.openings) - self.facet_groups.keys())
        if unknown:
            raise InvalidRequest(
                f"openings: {unknown[0]!r} is no group of facets: give openings={{...}} by their new names"
            )

    def __reduce__(self) -> Any:
        own = {f.name: getattr(self, f.name) for f in fields(self)}  # read-only mappings cannot be pickled
        return type(self), tuple(dict(v) if isinstance(v, Mapping) else v for v in own.values())

    @property
    def n_cells(self) -> int:
        """Number of elements."""
        return sum(map(len, self.cells.values()))

    @property
    def n_facets(self) -> int:
        """Number of facets of boundary and interfaces."""
        return sum(map(len, self.facets.values()))

    @property
    def order(self) -> int:
        """1 if edges are straight between corners, 2 if they have a node in their middle."""
        return max(SHAPES[kind].degree for kind in self.cells)

    @property
    def cell_volumes(self) -> Array:
        """Exact volumes (m,) of the elements, curved or not, model units cubed."""
        return np.concatenate(
            [
                jacobian_coefficients(kind, self.points, nodes).mean(axis=1) * SHAPES[kind].reference_volume
                for kind, nodes in self.cells.items()
            ]
        )

    @property
    def volume(self) -> float:
        """Volume of all elements, model units cubed."""
        return float(self.cell_volumes.sum())

    @property
    def node_sets(self) -> dict[str, IntArray]:
        """Nodes of each group of elements and facets, ascending, by the group's name."""
        groups = [*self.cell_groups.items(), *self.facet_groups.items()]
        blocks = [self.cells] * len(self.cell_groups) + [self.facets] * len(self.facet_groups)
        return {
            name: np.unique(
                np.concatenate([nodes.ravel() for nodes in select(block, numbers).values()] or [np.zeros(0, np.int64)])
            )
            for (name, numbers), block in zip(groups, blocks, strict=True)
        }

    @property
    def quality(self) -> MeshQuality:
        """What is measured on the elements: inverted ones, the worst, the mean, and their size."""
        least, inverse, scaled, sizes = [], [], [], []
        for kind, nodes in self.cells.items():
            least.append(jacobian_coefficients(kind, self.points, nodes).min(axis=1))
            inverse.append(inverse_condition_numbers(kind, self.points, nodes))
            scaled.append(scaled_jacobians(kind, self.points, nodes))
            sizes.append(_edge_lengths(kind, self.points, nodes))
        values = np.concatenate(inverse)
        return MeshQuality(
            int((np.concatenate(least) <= 0.0).sum()),
            float(values.min()),
            float(np.concatenate(scaled).min()),
            float(values.mean()),
            float(np.concatenate(sizes).mean()),
        )

    @property
    def mismatch(self) -> float:
        """Greatest distance of a periodic node's image from the node moved by the period, model units; 0 without any."""
        worst = 0.0
        for name, pairs in self.periodic.items():
            gap = self.points[pairs[:, 1]] - self.points[pairs[:, 0]] - self.translation(name)
            worst = max(worst, float(np.abs(gap).max(initial=0.0)))
        return worst

    def translation(self, name: str) -> Array:
        """The vector (3,) of a translation of `periodic`, model units."""
        steps = read_translation(name)
        return np.where(steps != 0, steps * np.nan_to_num(self.periods), 0.0)

    def periodic_ties(self) -> tuple[IntArray, IntArray]:
        """For each node the node that it repeats (n,), itself if none, and by how many periods (n, 3) it lies from that node."""
        n = len(self.points)
        pairs = np.concatenate([np.zeros((0, 2), np.int64), *self.periodic.values()])
        label = label_linked(n, pairs)
        repeated = np.unique(label, return_index=True)[1][label]
        gap = (self.points - self.points[repeated]) / self.periods
        return repeated, np.rint(np.nan_to_num(gap)).astype(np.int64)


def name_translation(steps: IntArray) -> str:
    """Name of a translation by whole periods (3,) along the axes: "x", "x-z", "-y+z"."""
    letters = [
        ("+" if step > 0 else "-") + axis
        for axis, step in zip(AXES, steps.tolist(), strict=True)
        for _ in range(abs(step))
    ]
    return "".join(letters).removeprefix("+")


def read_translation(name: str) -> IntArray:
    """The whole periods (3,) along the axes that a name stands for."""
    steps = np.zeros(3, np.int64)
    for sign, axis in re.findall(r"([+-]?)([xyz])", name):
        steps[AXES.index(axis)] += -1 if sign == "-" else 1
    return steps


def _edge_lengths(kind: str, points: Array, cells: IntArray) -> Array:
    """Mean distance (m,) between the corners at the ends of each element's edges."""
    shape = SHAPES[kind]
    sides = {
        frozenset(side)
        for face in shape.faces
        for corners in [face[: SHAPES[shape.face_kind].corners]]
        for side in zip(corners, (*corners[1:], corners[0]), strict=True)
    }
    i, j = np.array([sorted(side) for side in sides]).T
    return np.asarray(np.linalg.norm(points[cells[:, i]] - points[cells[:, j]], axis=-1).mean(axis=1))


def split(blocks: Mapping[str, IntArray], numbers: IntArray) -> list[IntArray]:
    """Rows within each block of rows that are numbered through the blocks."""
    ends = np.cumsum([0, *map(len, blocks.values())])
    return [numbers[(numbers >= a) & (numbers < b)] - a for a, b in zip(ends[:-1], ends[1:], strict=True)]


def select(blocks: Mapping[str, IntArray], numbers: IntArray) -> dict[str, IntArray]:
    """Nodes of the numbered rows, by kind; kinds without any are left out."""
    rows = zip(blocks.items(), split(blocks, numbers), strict=True)
    return {kind: nodes[chosen] for (kind, nodes), chosen in rows if len(chosen)}


def sort_nodes(mesh: M) -> M:
    """The mesh without unused nodes, and with the corners of elements before all other nodes."""
    is_corner = np.zeros(len(mesh.points), bool)
    is_used: BoolArray = np.zeros(len(mesh.points), bool)
    for kind, nodes in mesh.cells.items():
        is_corner[nodes[:, : SHAPES[kind].corners]] = True
        is_used[nodes] = True
    order = np.concatenate([np.flatnonzero(is_corner), np.flatnonzero(is_used & ~is_corner)])
    new = np.full(len(mesh.points), -1, np.int64)
    new[order] = np.arange(len(order))
    return replace(
        mesh,
        points=mesh.points[order],
        cells={k: new[v] for k, v in mesh.cells.items()},
        facets={k: new[v] for k, v in mesh.facets.items()},
        periodic={k: new[v[is_used[v].all(axis=1)]] for k, v in mesh.periodic.items()},
    )
