"""What a model offers for simulation: tetrahedra by gmsh, and hexahedra and trivariate splines straight from its patches."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Protocol

from tpmscad._typing import BoxCorners
from tpmscad.api.public_calls import validate_call, validate_method_options
from tpmscad.api.shared_kinds import COUNT, FLAG, PATH, REFINEMENT
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.lattices.spline_volumes import SplineVolumes
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.requests.study_options import MeshOptions

BODY_REGION = "body"
"""Group of a mesh's elements."""


class MeshedResult(Protocol):
    """What meshes are made of."""

    @property
    def name(self) -> str:
        """Name of the product."""

    @property
    def bounding_box(self) -> BoxCorners:
        """Corners of the box around the solids."""

    @property
    def make_spline_volumes(self) -> Callable[[], SplineVolumes | None] | None:
        """Makes the trivariate splines that fill the solid; it, or what it makes, is None if there are no whole walls."""

    def named_solids(self) -> tuple[NamedSolid, ...]:
        """The solids with the labels of their faces."""


class MeshableSolid:
    """The methods of a model that make meshes and splines for simulation."""

    @validate_call()
    def hexahedra(
        self: MeshedResult,
        order: Annotated[
            int,
            COUNT,
            "2: elements of 27 nodes with curved edges (20 with `serendipity`); 1: of 8 nodes with straight ones.",
        ] = 2,
        refine: Annotated[
            int | tuple[int, int],
            REFINEMENT,
            "Cuts of each patch's wall: in all three directions, or along the wall and through it. n cuts make n + 1 "
            "elements.",
        ] = 0,
        *,
        serendipity: Annotated[
            bool, FLAG, "Leave out the nodes inside faces and elements of second order, as CalculiX and Abaqus want it."
        ] = False,
    ) -> VolumeMesh:
        """Hexahedra of a lattice's wall straight from its patches, without a mesher.

        Between each patch and its partner on the other side of the wall lies one trivariate spline, linear through the wall:
        one element, or cut into several. Nodes lie on the exact faces.

        Returns
        -------
        VolumeMesh
            Nodes, elements, facets in the groups "surface +", "surface -" and "gap" or "cap X+", and periodic pairs of nodes.

        Raises
        ------
        InvalidRequest
            If the solid is not made of whole walls, a wall folds, or elements are too large for its curvature.

        Examples
        --------
        >>> model = tpmscad.lattice("gyroid", cell=10, thickness=1, boundary="natural")  # doctest: +SKIP
        >>> mesh = model.hexahedra(refine=1)  # doctest: +SKIP
        >>> mesh.write("gyroid.msh")  # doctest: +SKIP
        """
        from tpmscad.studies.hexahedral_meshing import mesh_by_splines

        along, through = refine if isinstance(refine, tuple) else (refine, refine)
        return mesh_by_splines(self.make_spline_volumes, self.name, order, (along, through), serendipity)

    @validate_call()
    def export_splines(
        self: MeshedResult,
        path: Annotated[
            str | Path,
            PATH,
            "An ``.xml`` file of G+Smo, which splinepy reads too: a right-handed body for each patch of the wall, "
            'with exact poles, the interfaces of the bodies, and their outer sides in the groups "surface +", '
            '"surface -" and "gap" or "cap".',
        ],
    ) -> None:
        """Write the lattice's wall as trivariate splines for isogeometric analysis, with their interfaces.

        Raises
        ------
        InvalidRequest
            If the solid is not made of whole walls, a wall folds, or the suffix is another one.

        Examples
        --------
        >>> model = tpmscad.lattice("gyroid", cell=10, thickness=1, boundary="natural")  # doctest: +SKIP
        >>> model.export_splines("gyroid.xml")  # doctest: +SKIP
        """
        from tpmscad.studies.hexahedral_meshing import write_splines

        write_splines(self.make_spline_volumes, self.name, path)

    @validate_method_options(MeshOptions, "mesh(0.5)")
    def mesh(self: MeshedResult, options: MeshOptions) -> VolumeMesh:
        """Tetrahedra in the solid, with corners and middles of edges on its exact faces; by gmsh (pip install "tpmscad[mesh]").

        Returns
        -------
        VolumeMesh
            Nodes, elements, facets, and groups: the elements are the group "body", the facets have the names of faces in STEP
            files, such as "surface +", "surface -", "cap X+" or "gap"; `write` stores it as .msh, .inp or .vtu.

        Raises
        ------
        InvalidRequest
            If gmsh is not installed, the order is another one, there would be too many elements, or opposite sides differ.
        KernelError
            If gmsh fails, or elements stay inverted.

        Examples
        --------
        >>> mesh = tpmscad.lattice("gyroid", cell=10, thickness=1.5).mesh(0.8, periodic=True)  # doctest: +SKIP
        >>> mesh.write("gyroid.inp")  # doctest: +SKIP
        """
        from tpmscad.studies.volume_meshing import mesh_named_solids

        solids = self.named_solids()
        return mesh_named_solids(solids, [BODY_REGION] * len(solids), self.bounding_box, options, name=self.name)
