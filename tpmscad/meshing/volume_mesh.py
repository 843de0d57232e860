"""The value of a volume mesh: nodes, elements, facets of boundary and interfaces, named groups, and periodic pairs of nodes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FLOW, PATH, POSITIVE
from tpmscad.atomic_file import validate_output_path
from tpmscad.brep.linked_items import label_linked
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.element_shapes import (
    SHAPES,
    inverse_condition_numbers,
    jacobian_coefficients,
    scaled_jacobians,
)

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
class VolumeMesh:
    """A mesh of tetrahedra or hexahedra of first or second order.

    Attributes
    ----------
    points : (n, 3) array
        Nodes, model units; corners of elements before all other nodes.
    cells : mapping of str to (m, k) array
        Nodes of the elements of each kind: "tetra", "tetra10", "hexahedron", "hexahedron20" or "hexahedron27", in the order of
        VTK and meshio. Elements are numbered through the kinds.
    facets : mapping of str to (m, k) array
        Nodes of the facets of boundary and interfaces: "triangle", "triangle6", "quad", "quad8" or "quad9"; on the boundary
        their normals point outwards. Facets are numbered through the kinds.
    cell_groups, facet_groups : mapping of str to (m,) array
        Numbers of the elements and facets of each named group.
    periodic : mapping of str to (p, 2) array
        For each axis "x", "y", "z" along which the mesh is periodic: nodes of the near side, and their images at the far side.
        At borders that are not flat also for combined translations, such as "x-z": pairs that those along the axes leave apart.
    periods : (3,) array
        Distances of the opposite sides along the axes, model units; nan where the mesh is not periodic.
    name : str
        Name of the part in files.
    straightened : int
        Curved edges on faces that are straight instead, as an element beside them would be inverted; their middles are not on the
        exact surface.
    """

    points: Array
    cells: Mapping[str, IntArray]
    facets: Mapping[str, IntArray] = field(default_factory=dict)
    cell_groups: Mapping[str, IntArray] = field(default_factory=dict)
    facet_groups: Mapping[str, IntArray] = field(default_factory=dict)
    periodic: Mapping[str, IntArray] = field(default_factory=dict)
    periods: Array = field(default_factory=lambda: np.full(3, np.nan))
    name: str = "part"
    straightened: int = 0

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

    def __reduce__(self) -> Any:
        own = {f.name: getattr(self, f.name) for f in fields(self)}  # read-only mappings cannot be pickled
        return VolumeMesh, tuple(dict(v) if isinstance(v, Mapping) else v for v in own.values())

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

    def to_meshio(self) -> Any:
        """The mesh as a `meshio.Mesh`, with groups as its cell sets; needs meshio (pip install "tpmscad[mesh]").

        Elements and facets, kind by kind; a cell set for each group.
        """
        meshio = import_extra("meshio", "meshes for meshio", "mesh")
        blocks = [*self.cells.items(), *self.facets.items()]
        sets = {
            **{
                k: [*split(self.cells, v), *([np.zeros(0, np.int64)] * len(self.facets))]
                for k, v in self.cell_groups.items()
            },
            **{
                k: [*([np.zeros(0, np.int64)] * len(self.cells)), *split(self.facets, v)]
                for k, v in self.facet_groups.items()
            },
        }
        return meshio.Mesh(self.points, blocks, cell_sets=sets)

    def to_skfem(self) -> Any:
        """The mesh for scikit-fem, with groups as its subdomains and boundaries; needs tpmscad[simulation].

        Returns
        -------
        skfem.Mesh
            MeshTet1, MeshTet2, MeshHex1 or MeshHex2.

        Raises
        ------
        InvalidRequest
            If the mesh has several kinds of elements, or a kind that scikit-fem has not.
        """
        from tpmscad.meshing.skfem_mesh import make_skfem_mesh

        return make_skfem_mesh(self)

    @validate_call()
    def write(
        self,
        path: Annotated[
            str | Path,
            PATH,
            "``.msh``: gmsh, with groups as physical groups and periodic nodes. ``.inp``: Abaqus and CalculiX, with "
            "node sets, element sets, surfaces, and equations that tie periodic nodes to three reference nodes. "
            "``.vtu``: VTK, with a column for each group, which ParaView, meshio and scikit-fem read.",
        ],
        *,
        version: Annotated[str, choice_of("4.1", "2.2"), "Version of gmsh's format."] = "4.1",
    ) -> None:
        """Write the mesh to a file whose suffix says the format.

        Raises
        ------
        InvalidRequest
            If the suffix is another one, the folder does not exist, or the format has no such elements.

        Examples
        --------
        >>> mesh = tpmscad.lattice("gyroid", cell=10, thickness=1.5).mesh(0.8)  # doctest: +SKIP
        >>> mesh.write("gyroid.msh")  # doctest: +SKIP
        """
        from tpmscad.meshing.inp_files import write_inp
        from tpmscad.meshing.msh_files import write_msh
        from tpmscad.meshing.vtu_files import write_vtu

        target = validate_output_path(path, (".msh", ".inp", ".vtu"))
        suffix = target.suffix.lower()
        if suffix == ".msh":
            write_msh(self, target, version)
        elif version != "4.1":
            raise InvalidRequest(f'version="{version}" is one of gmsh\'s format: {suffix} has none')
        else:
            {".inp": write_inp, ".vtu": write_vtu}[suffix](self, target)

    @validate_call()
    def write_openfoam(
        self,
        folder: Annotated[
            str | Path,
            PATH.described_as("the path of a folder", '"case"'),
            "The folder to make; it must not exist, or be empty.",
        ],
        *,
        flow: Annotated[
            Mapping[str, str] | None,
            FLOW,
            'For each group of elements that a fluid fills, the side to which it flows: ``{"channel +": "X+", '
            '"channel -": "X-"}``. It enters at the openings of the opposite side; other openings are closed. Other '
            "groups are solid. By default every group that is open at both sides of an axis, by turns to and fro.",
        ] = None,
        velocity: Annotated[float, POSITIVE.described_as(example="0.01"), "Mean velocity at the inlets, m/s."] = 0.01,
    ) -> None:
        """Write a case of OpenFOAM: steady laminar flow with conjugate heat transfer, each group of elements a region.

        Its `Allrun` checks the meshes, and runs `simpleFoam` in every channel and `chtMultiRegionSimpleFoam` on all regions.
        Elements have flat faces between their corners. The fluid is water, the solid aluminium; the first channel's inlet has
        350 K, the others' 300 K, and outer walls are adiabatic: change these, with lengths in mm, in the files.

        Raises
        ------
        InvalidRequest
            If the folder holds something, or the mesh has no such openings.

        Examples
        --------
        >>> parts = tpmscad.fluid_domains(body, "gyroid", cell=10, thickness=1)  # doctest: +SKIP
        >>> parts.mesh(0.8).write_openfoam("exchanger")  # doctest: +SKIP
        """
        from tpmscad.meshing.openfoam_case import write_openfoam_case

        write_openfoam_case(self, Path(folder), flow, velocity)

    def __repr__(self) -> str:
        counts = ", ".join(f"{len(nodes)} {kind}" for kind, nodes in self.cells.items())
        groups = ", ".join([*self.cell_groups, *self.facet_groups]) or "none"
        periodic = f"\nperiodic along {', '.join(self.periodic)}" if self.periodic else ""
        head = f"{self.name}: {counts}, {len(self.points)} nodes, volume {self.volume:.9g}"
        straight = f"\n{self.straightened} edges on faces are straight instead of curved" if self.straightened else ""
        return f"{head}\n{self.quality}\ngroups {groups}{periodic}{straight}"


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


def sort_nodes(mesh: VolumeMesh) -> VolumeMesh:
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
