"""The result of `lattice`, `solidify`, `infill` and of each domain: a solid, the patches it is made of, and its certificate."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tpmscad._typing import Array, BoxCorners
from tpmscad.api.arguments import select_arguments
from tpmscad.api.public_calls import validate_call, validate_method_options
from tpmscad.api.shared_kinds import COUNT, FLAG, REFINEMENT
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.extents import true_bounds
from tpmscad.brep.solid_names import name_pieces
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.kernel.occt.construction import copy_placement
from tpmscad.kernel.occt.exploration import vertices_of
from tpmscad.kernel.step.face_labels import NamedSolid, label_faces
from tpmscad.kernel.step.product_entities import arrange_cells
from tpmscad.lattices.spline_volumes import SplineVolumes
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.requests.study_options import (
    MeshOptions,
    ModelExportOptions,
    ModelPictureOptions,
    ModelSliceOptions,
    PrintOptions,
    StepExportOptions,
)
from tpmscad.results.certificate import Certificate
from tpmscad.results.result_summary import format_html, format_summary

if TYPE_CHECKING:
    from tpmscad.fields.kinds.strut_graphs import StrutsField
    from tpmscad.files.file_formats import ExportedFile
    from tpmscad.studies._check_print import PrintReport
    from tpmscad.studies.layer_slices import Slices


BODY_REGION = "body"
"""Group of a mesh's elements."""


@dataclass(frozen=True, slots=True, eq=False)
class UnitCell:
    """The cell that a lattice repeats, made on demand, the edges of its box (model units), and its copies along each axis."""

    make: Callable[[], Brep]
    edges: tuple[float, float, float]
    counts: tuple[int, int, int]


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """A solid with its certificate, whatever made it.

    Attributes
    ----------
    name : str
        Name of the product in files.
    patches : Brep
        The boundary representation in arrays, in model units. If the kernel made the solid (`trimmed_by` is "kernel", or there
        is a skin), these are the patches of the whole lattice before it was trimmed.
    certificate : Certificate
        What was measured on the solid, and whether it meets the request.
    built : BrepSolids or OcctSolids
        The kernel's solids.
    unit_cell : UnitCell or None
        The cell that the solid repeats; None if it repeats none.
    trimmed_by : {"patches", "kernel"} or None
        How a body trimmed the lattice: on the parameter domains of the patches, or by a Boolean operation of the kernel, as for
        bodies with faces that are neither planes nor quadrics. None if no body did.
    distance_to_reference : callable or None
        Distance (n,) of points (n, 3) from the reference surface, model units, for pictures of the deviation.
    is_fluid : bool
        Whether the solid is a channel full of fluid, which `measure` then takes it for.
    openings : frozenset of str
        Labels of the faces through which the fluid enters and leaves.
    make_spline_volumes : callable or None
        Makes the trivariate splines that fill the solid; it is None, or makes None, if the solid is not made of whole walls.
    envelope : Envelope or None
        What the solid was made in, of which fractions are stated: the body, or the box of the cells or of the field; None if
        neither is known, as after a map.
    struts : StrutsField or None
        The struts of which the solid consists, if it is made of struts alone.
    piece_names : tuple of str
        Names of the solids, largest first, where they are those of several parts; empty if they follow from `name`.

    Notes
    -----
    A model can be pickled: its shapes travel in OCCT's binary format, to the last bit. A pickle leaves `unit_cell`,
    `distance_to_reference` and `make_spline_volumes` out if they hold functions that Python cannot pickle, such as a lambda in
    a map.
    """

    name: str
    patches: Brep
    certificate: Certificate
    built: BrepSolids | OcctSolids
    unit_cell: UnitCell | None = None
    trimmed_by: str | None = None
    distance_to_reference: Callable[[Array], Array] | None = None
    is_fluid: bool = False
    openings: frozenset[str] = frozenset()
    make_spline_volumes: Callable[[], SplineVolumes | None] | None = None
    envelope: Envelope | None = None
    struts: StrutsField | None = None
    piece_names: tuple[str, ...] = ()

    @property
    def solid(self) -> Any:
        """The build123d Solid, or a Compound if there are several solids; moving it leaves the model in place."""
        return self.built.solid

    @property
    def wrapped(self) -> Any:
        """The TopoDS shape, under the name that build123d, CadQuery and viewers use; moving it leaves the model in place."""
        return copy_placement(self.built.shape)

    @property
    def volume(self) -> float:
        """Volume of the solid, model units cubed."""
        return self.certificate.volume

    @property
    def area(self) -> float:
        """Surface area of the solid, model units squared."""
        return self.certificate.area

    @cached_property
    def bounding_box(self) -> BoxCorners:
        """Opposite corners of the box around the solid: ((x0, y0, z0), (x1, y1, z1)), model units."""
        exact = isinstance(self.built, BrepSolids)
        corners = true_bounds(self.patches) if exact else shape_bounds(self.built.shape)
        return tuple(tuple(corner.tolist()) for corner in corners)

    @validate_method_options(ModelExportOptions, 'export("part.step")')
    def export(self, options: ModelExportOptions) -> ExportedFile:
        """Write the model to a file whose suffix says the format; the file is read back and compared with the solid.

        Returns
        -------
        ExportedFile
            The path, and of a mesh the number of triangles and the deviation that was reached, which is `deviation` at most.

        Raises
        ------
        InvalidRequest
            If the suffix is not known, or an option does not apply to the format or to this model.
        KernelError
            If the mesh cannot be closed or does not keep the deviation, or the file does not read back as the solid that was
            written.

        Examples
        --------
        >>> model = tpmscad.lattice("gyroid", cell=10, thickness=1)
        >>> file = model.export("gyroid.3mf", deviation=0.02)
        >>> file.deviation <= 0.02
        True
        """
        from tpmscad.file_suffixes import STEP_SUFFIXES
        from tpmscad.files.file_formats import ExportedFile, check_export, write_mesh_or_brep_file

        if check_export(options) not in STEP_SUFFIXES:
            return write_mesh_or_brep_file(self, options, [self.built])
        self.export_step(**select_arguments(options, StepExportOptions))
        return ExportedFile(Path(options.path))

    @validate_method_options(StepExportOptions, 'export_step("part.step")')
    def export_step(self, options: StepExportOptions) -> None:
        """Write the model as a STEP file, read it back and compare it with the solid.

        Raises
        ------
        InvalidRequest
            If `instanced` is True and the solid repeats no cell.
        KernelError
            If the file does not read back as the valid solid that was written.

        Examples
        --------
        >>> model = tpmscad.lattice("gyroid", cell=10, cells=(2, 2, 2), thickness=1)
        >>> model.export_step("gyroid.step", instanced=True)
        """
        from tpmscad.files.checked_write import (
            REREAD_VOLUME_RTOL,
            limit_reread_volume,
            write_checked_brep,
            write_checked_solids,
        )

        how: dict[str, Any] = {"schema": options.schema, "name": self.name}
        arrays = how | {
            "rtol": REREAD_VOLUME_RTOL
            if self.trimmed_by is None
            else limit_reread_volume(self.volume, self.area, math.dist(*self.bounding_box)),
            "verify": options.verify,
        }
        failure = None
        if options.instanced:
            if self.unit_cell is None:
                raise InvalidRequest(f"the {self.name} has no cell that repeats: leave `instanced` out")
            copies = arrange_cells(self.unit_cell.edges, self.unit_cell.counts)
            write_checked_brep(build_solids(self.unit_cell.make()), options.path, **arrays, instances=copies)
            return
        if isinstance(self.built, BrepSolids):
            try:
                write_checked_brep(self.built, options.path, **arrays)
                return
            except KernelError as error:
                failure = error
        write_checked_solids(self.named_solids(), options.path, **how, volume=self.volume, failure=failure)

    @validate_method_options(ModelPictureOptions, 'render("part.png", section="z")')
    def render(self, options: ModelPictureOptions) -> None:
        """Draw the model as a PNG picture, without a display.

        Examples
        --------
        >>> model = tpmscad.lattice("gyroid", cell=10, cells=(2, 2, 2), thickness=1)  # doctest: +SKIP
        >>> model.render("gyroid.png", section="z=5", color_by="deviation")  # doctest: +SKIP
        """
        from tpmscad.studies._render import render

        render(self, **vars(options))

    @validate_method_options(ModelSliceOptions, "slices(0.05)")
    def slices(self, options: ModelSliceOptions) -> Slices:
        """Contours of every layer for layered manufacturing, straight from the exact faces.

        Returns
        -------
        Slices
            The layers, each with its closed contours, area, perimeter and volume; `write` stores them as SVG, CLI or 3MF.

        Raises
        ------
        InvalidRequest
            If an argument is not positive, or there would be more than 100,000 layers.
        KernelError
            If the kernel cannot triangulate the model.

        Examples
        --------
        >>> slices = tpmscad.lattice("gyroid", cell=10, thickness=1).slices(0.05)  # doctest: +SKIP
        >>> slices.write("gyroid.cli")  # doctest: +SKIP
        """
        from tpmscad.studies.layer_slices import slice_shape

        heights = [z for *_, z in self.bounding_box]
        return slice_shape(self.built, self.name, options.height, options.chord_error, heights, options.executor)

    @validate_method_options(PrintOptions, "check_print(min_wall=0.3)")
    def check_print(self, options: PrintOptions) -> PrintReport:
        """Check the model before printing: smallest wall, smallest gap, overhang and closed cavities.

        Returns
        -------
        PrintReport
            Four findings, each with value, limit and place; `met` is True if all limits are kept and there is no closed cavity.

        Raises
        ------
        InvalidRequest
            If an argument is not understood, or solids of the model touch each other.

        Examples
        --------
        >>> tpmscad.lattice("gyroid", cell=10, thickness=1).check_print(min_wall=0.3).met  # doctest: +SKIP
        """
        from tpmscad.studies._check_print import check_print

        return check_print(self.built.shape, **vars(options))

    @validate_call()
    def hexahedra(
        self,
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

    @validate_method_options(MeshOptions, "mesh(0.5)")
    def mesh(self, options: MeshOptions) -> VolumeMesh:
        """Tetrahedra in the solid, with corners and middles of edges on its exact faces; by gmsh (pip install "tpmscad[mesh]").

        Returns
        -------
        VolumeMesh
            Nodes, elements, facets, and groups: the elements are the group "body", the facets have the names of faces in STEP
            files, such as "surface +", "surface -", "cap X+" or "gap"; those of a filled body are "body 0", "body 1" and
            so on, one group for each of its faces, and "skin" for the inner side of a skin. `write` stores it as .msh, .inp or
            .vtu.

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

    def named_solids(self) -> tuple[NamedSolid, ...]:
        """The solids with their names and the labels of their faces, as files store them.

        Largest first: name, TopoDS solid, labels of its faces in the kernel's order. The first has the name of the model,
        another says where it lies: "gyroid (X+ Y- Z-)". Pieces of several parts have the names of these.
        """
        built = self.built
        if isinstance(built, BrepSolids):
            found, numbers = label_faces(self.patches), range(built.n_solids)
            labels = tuple(tuple(found[f] for f in built.faces_of_solid(k).tolist()) for k in numbers)
            vertices = [built.vertices_of_solid(k) for k in numbers]
            sources: Sequence[Any] = [(built, k) for k in numbers]
        else:
            labels, vertices, sources = built.labels, [vertices_of(solid) for solid in built.solids], built.solids
        return tuple(
            NamedSolid(name, source, of, openings=self.openings)
            for name, source, of in zip(
                self.piece_names or name_pieces(self.name, vertices), sources, labels, strict=True
            )
        )

    def __getstate__(self) -> dict[str, Any]:
        functions = "unit_cell", "distance_to_reference", "make_spline_volumes"
        return self.__dict__ | {key: _portable(self.__dict__[key]) for key in functions}

    def _refuse_operator(self, other: Any) -> Any:
        raise InvalidRequest(
            "a model cannot be cut or joined itself, as its certificate holds for this solid only: take its shape, as in "
            "model.solid - Box(10, 10, 10)"
        )

    __add__ = __radd__ = __sub__ = __rsub__ = __and__ = __rand__ = __or__ = __ror__ = _refuse_operator

    def __repr__(self) -> str:
        return format_summary(self.name, self.bounding_box, self.certificate)

    def _repr_html_(self) -> str:
        return format_html(self, self.name, self.bounding_box, self.certificate)

    def __dir__(self) -> list[str]:
        return sorted(name for name in object.__dir__(self) if not name.startswith("_"))


def _portable(value: Any) -> Any:
    """The value, or None if it holds a function that cannot be pickled."""
    try:
        pickle.dumps(value)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    return value
