"""A volume mesh as its users have it: arrays, and the files and objects of other programs that are made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FLOW, PATH, POSITIVE
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import MESH_WRITERS, load_writer
from tpmscad.meshing.library_meshes import make_meshio_mesh, make_skfem_mesh
from tpmscad.meshing.mesh_arrays import MeshArrays
from tpmscad.meshing.msh_files import write_msh
from tpmscad.meshing.openfoam_case import write_openfoam_case
from tpmscad.meshing.stubs import add_stubs
from tpmscad.result_display import list_names

MOVED = 1e-6
"""Model units: a move of nodes that is worth telling."""


REPAIRED = ("merged", "moved", "collapsed", "swapped", "split", "shifted", "straightened", "deviation")
"""What was done to the solid and to the mesh so that elements are good, and what it cost."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class VolumeMesh(MeshArrays):
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
    moved : float
        Greatest distance by which a node at a side of the box was moved to the image of one at the opposite side, or a vertex to
        another with which it was merged, model units: the sides of a fitted field agree within the tolerance of the fit only.
    collapsed, swapped, split, shifted : int
        What was done to repair poor elements: short edges collapsed to one of their ends, edges and faces swapped, edges inside
        split, and nodes moved on the faces that they lie on. Each image counts.
    merged : int
        Edges of the solid that were merged before it was meshed: shorter than a hundredth of the element size, or twins at both
        sides of a face that is as narrow.
    deviation : float
        Greatest distance of a node on facets from the faces that it lies on, model units, but for middles of straightened edges.
        0 where there are no faces to measure from.
    openings : frozenset of str
        Groups of facets through which a fluid enters and leaves, for cases of flow.
    """

    def to_meshio(self) -> Any:
        """The mesh as a `meshio.Mesh`, with groups as its cell sets; needs meshio (pip install "tpmscad[mesh]").

        Elements and facets, kind by kind; a cell set for each group.
        """
        return make_meshio_mesh(self)

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
        return make_skfem_mesh(self)

    @validate_call()
    def write(
        self,
        path: Annotated[
            str | Path,
            PATH,
            "``.msh``: gmsh, with groups as physical groups and periodic nodes. ``.inp``: Abaqus and CalculiX, with "
            "node sets, element sets, surfaces, and equations that tie periodic nodes to three reference nodes; hexahedra of 27 "
            "nodes as C3D20, without the nodes inside faces and elements, which a comment says. "
            "``.vtu``: VTK, with a column for each group, which ParaView, meshio and scikit-fem read; by meshio. "
            "``.feb``: FEBio 4, with node sets, surfaces, and a material to be replaced.",
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
        target = validate_output_path(path, tuple(MESH_WRITERS))
        suffix = target.suffix.lower()
        if suffix == ".msh":
            write_msh(self, target, version)
        elif version != "4.1":
            raise InvalidRequest(f'version="{version}" is one of gmsh\'s format: {suffix} has none')
        else:
            load_writer(MESH_WRITERS, suffix)(self, target)

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
            "groups are solid. By default every group that is open at both sides of an axis, by turns to and fro. Along an "
            "axis of a periodic mesh a body force drives the fluid, and the case has no heat.",
        ] = None,
        velocity: Annotated[
            float, POSITIVE.described_as(example="0.01"), "Mean velocity at the inlets, or over a periodic fluid, m/s."
        ] = 0.01,
    ) -> None:
        """Write a case of OpenFOAM: steady laminar flow with conjugate heat transfer, each group of elements a region.

        Its `Allrun` checks the meshes, and runs `simpleFoam` in every channel and `chtMultiRegionSimpleFoam` on all regions. They
        stop on convergence; it prints pressure drops, heat and its imbalance, and fails if something has not converged.
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
        write_openfoam_case(self, Path(folder), flow, velocity)

    @validate_call()
    def add_stubs(
        self,
        length: Annotated[float, POSITIVE.described_as(example="10"), "Length of the ducts, model units."],
    ) -> VolumeMesh:
        """Return the mesh with a straight duct of elements in front of every opening, so that a flow settles before the body.

        The duct has the opening's cross-section, and belongs to the same group of elements. At its end is the opening, and its
        sides are a group of facets: "channel +: stub X-" of "channel +: opening X-", "inlet: stub" of a group renamed "inlet".

        Raises
        ------
        InvalidRequest
            If the mesh has no openings, is periodic or of hexahedra, or an opening is not in a plane.

        Examples
        --------
        >>> parts = tpmscad.fluid_domains(body, "gyroid", cell=10, thickness=1)  # doctest: +SKIP
        >>> parts.mesh(0.8).add_stubs(10).write_openfoam("exchanger")  # doctest: +SKIP
        """
        return add_stubs(self, length)

    def to_dict(self) -> dict[str, Any]:
        """The mesh in figures, ready for JSON."""
        quality = self.quality
        return {
            "cells": {kind: len(nodes) for kind, nodes in self.cells.items()},
            "nodes": len(self.points),
            "volume": self.volume,
            "size": quality.size,
            "inverted": quality.inverted,
            "smallest_quality": quality.smallest,
            "smallest_scaled_jacobian": quality.smallest_scaled_jacobian,
            "groups": [*self.cell_groups, *self.facet_groups],
            "periodic": list(self.periodic),
            "mismatch": self.mismatch,
            **{name: getattr(self, name) for name in REPAIRED},
        }

    def __repr__(self) -> str:
        counts = ", ".join(f"{len(nodes)} {kind}" for kind, nodes in self.cells.items())
        groups = list_names([*self.cell_groups, *self.facet_groups]) or "none"
        periodic = f"\nperiodic along {', '.join(self.periodic)}" if self.periodic else ""
        head = f"{self.name}: {counts}, {len(self.points)} nodes, volume {self.volume:.9g}"
        straight = f"\n{self.straightened} edges on faces are straight instead of curved" if self.straightened else ""
        moved = f", nodes moved by up to {self.moved:.2g} to images" if self.moved > MOVED else ""
        merged = f"\n{self.merged} short edges of the solid merged" if self.merged else ""
        repaired = ""
        if self.collapsed + self.swapped + self.split + self.shifted:
            repaired = (
                f"\npoor elements repaired: {self.collapsed} short edges collapsed, {self.swapped} edges and faces swapped, "
                f"{self.split} edges inside split, {self.shifted} nodes moved"
            )
        off = f"\nnodes within {self.deviation:.2g} of their faces" if self.deviation > MOVED else ""
        return f"{head}\n{self.quality}\ngroups {groups}{periodic}{moved}{merged}{repaired}{off}{straight}"
