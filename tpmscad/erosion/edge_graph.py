"""The graph of edges and vertices of an eroded body, and what its offset shell says of points."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.erosion.offset_shell import OffsetShell, SheetEdge
from tpmscad.erosion.sites import FaceSite, OpenSite, depth_limit
from tpmscad.trimming.operands.patch_polynomials import PatchPolynomials, tabulate_carriers

MERGE_REL_TOL = 1e-6
"""In body sizes: vertices within it are one."""

BEYOND_RTOL = 1e-6
"""Of the skin: by how much farther a point outside a face must be from the sheet than one on it."""

GRID = 33
"""Nodes along each parameter of a sheet, at which its depth is sampled."""


NEAR_NODES = np.array([0.5, 2.0])
"""In skins: more nodes at these distances from the ends of a sheet, where the skin is thinner than a gap between nodes."""

MIN_SPEED = 1e-12
"""Lower bound of the speed of a parameter, at a pole."""


def _place_nodes(low: float, high: float, skin: float) -> Array:
    """The nodes of a range of parameters, of which the skin takes as much as `skin`."""
    even = np.linspace(low, high, GRID + 2)
    near = NEAR_NODES * skin
    near = near[near < even[1] - low]
    return np.sort(np.concatenate([even[1:-1], low + near, high - near]))


@dataclass(frozen=True, slots=True, eq=False)
class TracedEdge:
    """An edge of two sheets, between two vertices: `path` (m, 10) of points, parameters on both sheets, and unit tangents.

    The tangent is the product of the outward normals: the face on the first sheet is on its left, the other on its right.
    """

    sheets: tuple[int, int]
    path: Array
    start: int
    end: int


@dataclass(frozen=True, slots=True, eq=False)
class SheetGrid:
    """Nodes (m, n) of a sheet, at least `GRID` each: (u, v), which are in the domain, and which are deep enough as well."""

    uv: Array
    inside: BoolArray
    deep: BoolArray


@dataclass(slots=True, eq=False)
class EdgeGraph:
    """Vertices with the sheets that meet there and the parameters on them, traced edges, and pieces of rims with their vertices.

    patches: the sheets as polynomials, as the cut of networks takes them.
    """

    shell: OffsetShell
    patches: PatchPolynomials
    vertices: list[Array] = field(default_factory=list)
    incident: list[list[tuple[int, Array]]] = field(default_factory=list)
    edges: list[TracedEdge] = field(default_factory=list)
    rim_pieces: list[tuple[SheetEdge, int, int]] = field(default_factory=list)
    grids: dict[int, SheetGrid] = field(default_factory=dict)

    @classmethod
    def of(cls, shell: OffsetShell) -> EdgeGraph:
        """A graph without edges of the sheets of a shell."""
        sheets = shell.sheets
        boxes, senses = [sheet.box() for sheet in sheets], [sheet.sense for sheet in sheets]
        return cls(shell, tabulate_carriers([sheet.carrier for sheet in sheets], boxes, senses))

    @property
    def limit(self) -> float:
        """Depth from which a point counts as deep enough."""
        return depth_limit(self.shell.skin, self.shell.size)

    def vertex_at(self, point: Array, entries: list[tuple[int, Array]]) -> int:
        """The vertex at a point, made if there is none, with sheets and parameters added."""
        gaps = np.linalg.norm(np.reshape(self.vertices, (-1, 3)) - point, axis=1)
        if len(gaps) and gaps.min() <= MERGE_REL_TOL * self.shell.size:
            vertex = int(gaps.argmin())
        else:
            vertex = len(self.vertices)
            self.vertices.append(point)
            self.incident.append([])
        own = self.incident[vertex]
        for sheet, uv in entries:
            if all(s != sheet or not self._same_place(sheet, w, uv) for s, w in own):
                own.append((sheet, uv))
        return vertex

    def _same_place(self, sheet: int, one: Array, other: Array) -> bool:
        """Whether parameters that belong to one point are the same place of a sheet."""
        extent = np.ptp(self.shell.sheets[sheet].box(), axis=0)
        return bool((np.abs(one - other) <= 1e-3 * extent).all())

    def contain(self, pair: tuple[int, int], y: Array) -> BoolArray:
        """Which parameters (n, 4) lie in the domains of both sheets: (n,)."""
        one, other = (self.shell.sheets[s] for s in pair)
        return one.contains(y[:, :2]) & other.contains(y[:, 2:])

    def are_deep(self, points: Array) -> BoolArray:
        """Which points (n, 3) are deep enough: (n,)."""
        return self.shell.sites.are_deeper(points, self.limit)

    def nearest_sheet(self, point: Array) -> tuple[int, Array] | None:
        """The sheet of the site that is too near to a point (3,), and parameters on it to start from; None if it has no sheet."""
        shell = self.shell
        near = shell.sites.nearest(point[None], shell.skin)
        site = int(near.site[0])
        sheet = int(shell.sheet_of_site[site]) if site >= 0 else -1
        if (
            sheet >= 0
            and isinstance(shell.sites.sites[site], FaceSite)
            and self._is_beyond(sheet, near.parameters[0], point)
        ):
            # below an open face beside a concave edge, which is as near as the border of the face beyond it
            near = shell.sites.nearest(point[None], shell.skin, without=site)
            site = int(near.site[0])
            sheet = int(shell.sheet_of_site[site]) if site >= 0 else -1
        if sheet < 0:
            return None
        if isinstance(shell.sites.sites[site], FaceSite | OpenSite):
            return sheet, near.parameters[0]
        return sheet, shell.sheets[sheet].parameters_near(point)

    def _is_beyond(self, sheet: int, uv: Array, point: Array) -> bool:
        """Whether a point (3,) is farther than the skin from a face's sheet at the (u, v) of its foot: outside the face."""
        return (
            float(np.linalg.norm(self.shell.sheets[sheet].carrier(*uv) - point)) > (1 + BEYOND_RTOL) * self.shell.skin
        )

    def grid(self, number: int) -> SheetGrid:
        """The nodes of a sheet, sampled when they are first asked for."""
        if number not in self.grids:
            sheet = self.shell.sheets[number]
            low, high = sheet.box()
            u, v = 0.5 * (low + high)
            speeds = (np.linalg.norm(sheet.carrier(u, v, *order)) for order in ((1, 0), (0, 1)))
            axes = [
                _place_nodes(a, b, self.shell.skin / max(float(speed), MIN_SPEED))
                for a, b, speed in zip(low, high, speeds, strict=True)
            ]
            uv = np.stack(np.meshgrid(*axes, indexing="ij"), axis=2)
            inside = sheet.contains(uv.reshape(-1, 2)).reshape(uv.shape[:2])
            deep = inside.copy()
            deep[inside] = self.are_deep(sheet.carrier(*uv[inside].T))
            self.grids[number] = SheetGrid(uv, inside, deep)
        return self.grids[number]
