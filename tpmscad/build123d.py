"""Lattices and filled bodies as build123d parts, in builder and algebra mode.

from tpmscad.build123d import Struts, Tpms, TpmsInfill

part = Tpms("gyroid", cell=10, cells=(2, 2, 2), thickness=1)
frame = Struts("octet", cell=10, cells=(2, 2, 2), diameter=1)
filled = TpmsInfill(Cylinder(20, 50), "gyroid", cell=8, thickness=0.8, skin=1.5)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeAlias

from tpmscad.api.arguments import select_arguments
from tpmscad.api.public_calls import show_constructor, validate_method_options
from tpmscad.api.shared_kinds import ANYTHING
from tpmscad.errors import InvalidRequest
from tpmscad.kernel_wheels import explained_load_failure
from tpmscad.requests.face_selection import list_given_faces
from tpmscad.requests.lattice_options import InfillOptions, LatticeOptions
from tpmscad.requests.lattice_request import lattice_size, size_of_cells
from tpmscad.requests.strut_options import StrutOptions
from tpmscad.requests.study_options import ModelExportOptions, ModelPictureOptions
from tpmscad.results.certificate import Certificate
from tpmscad.results.model import Model
from tpmscad.results.placed_model import place_model
from tpmscad.results.result_summary import count_pieces
from tpmscad.solids._infill import infill
from tpmscad.solids._lattice import lattice
from tpmscad.solids._struts import struts

if TYPE_CHECKING:
    from tpmscad.files.file_formats import ExportedFile

with explained_load_failure("build123d"):
    from build123d import Align, BasePartObject, BuildPart, Compound, Location, Mode, Part, RotationLike, Vector
    from build123d.build_common import Builder
    from build123d.geometry import to_align_offset

__all__ = ["Struts", "Tpms", "TpmsInfill"]


def __dir__() -> list[str]:
    return sorted(__all__)


AlignOption: TypeAlias = Align | tuple[Align, Align, Align] | None
LatticeRotation = Annotated[RotationLike, ANYTHING, "Rotation of the aligned lattice, degrees."]
PartMode = Annotated[Mode, ANYTHING, "Combination mode in a builder."]


@dataclass(frozen=True)
class PartExportOptions(ModelExportOptions):
    """The arguments of `export` of a part, which is written as it is, without copies of a cell."""

    instanced: bool = field(init=False, default=False)


class ModelPart:
    """What the parts have of the model that they hold: its files, its pictures and its words."""

    model: Model
    certificate: Certificate
    wrapped: Any

    @property
    def placed_model(self) -> Model:
        """The model where the part is: aligned, rotated and moved."""
        return place_model(self.model, self.wrapped)

    @validate_method_options(PartExportOptions, 'export("part.step")')
    def export(self, options: PartExportOptions) -> ExportedFile:
        """Write the part, where it is, to a file whose suffix says the format; the file is read back and compared.

        Returns
        -------
        ExportedFile
            As `Model.export`.

        Raises
        ------
        InvalidRequest
            If the suffix is not known, an option does not apply, or the part is not the model's solid any more.
        KernelError
            If the file does not read back as the solid that was written.

        Examples
        --------
        >>> (Pos(20, 0, 0) * Tpms("gyroid", cell=10, thickness=1)).export("gyroid.step")
        gyroid.step: exact
        """
        return self.placed_model.export(**vars(options))

    @validate_method_options(ModelPictureOptions, 'render("part.png", section="z")')
    def render(self, options: ModelPictureOptions) -> None:
        """Draw the part, where it is, as a PNG picture.

        Raises
        ------
        InvalidRequest
            If an argument is not understood, or the part is not the model's solid any more.

        Examples
        --------
        >>> Tpms("gyroid", cell=10, thickness=1).render("gyroid.png", section="z")
        """
        self.placed_model.render(**vars(options))

    def __repr__(self) -> str:
        found = self.certificate
        return (
            f"{type(self).__name__}: {self.model.name}, {count_pieces(len(found.pieces))}, {found.n_faces} faces, volume "
            f"{found.volume:.7g}, {'met' if found.met else f'NOT met: {found.shortfalls[0]}'}"
        )


class LatticePart(ModelPart, BasePartObject):
    """A lattice that is aligned by a box, and whose parameters are attributes."""

    def _hold(
        self,
        model: Model,
        parameters: dict[str, Any],
        box: tuple[Sequence[float], Sequence[float]],
        *,
        rotation: RotationLike,
        align: AlignOption,
        mode: Mode,
    ) -> None:
        """Become the part of a model: aligned by two corners of a box, then rotated, and combined in a mode."""
        self.__dict__.update({name: value for name, value in parameters.items() if name != "progress"})
        self.align, self.model, self.certificate = align, model, model.certificate
        part = model.solid
        part.label = model.name
        low, high = (Vector(*corner) for corner in box)
        part.move(Location(to_align_offset(low, high, align)))
        BasePartObject.__init__(self, part, rotation=rotation, align=None, mode=mode)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy of the part, as build123d makes it for every placement; model, certificate and map are shared."""
        for shared in (self.model, self.certificate, getattr(self, "map", None)):
            memo[id(shared)] = shared
        return super().__deepcopy__(memo)


@dataclass(frozen=True)
class TpmsOptions(LatticeOptions):
    """The arguments of `Tpms`."""

    _: KW_ONLY
    rotation: LatticeRotation = (0, 0, 0)
    align: Annotated[
        AlignOption,
        ANYTHING,
        "Alignment of the box of `cells` x `cell` that the lattice fills, or of its image under `map`; the kernel's bounding box "
        "of B-splines would be too large. None leaves the lattice where `tpmscad.lattice` puts it.",
    ] = Align.CENTER
    mode: PartMode = Mode.ADD


@show_constructor
class Tpms(LatticePart):
    """A lattice of a minimal surface as a build123d part.

    Attributes
    ----------
    model : Model
        The lattice before alignment and rotation.
    certificate : Certificate
        What was measured; `certificate.met` says whether the lattice meets the request.

    The parameters are attributes, too, except `progress`.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    KernelError
        If the kernel cannot build the solid.

    Examples
    --------
    >>> with BuildPart() as part:
    ...     Tpms("gyroid", cell=10, cells=(2, 2, 2), thickness=1)
    """

    @validate_method_options(TpmsOptions, 'Tpms("gyroid", cell=10, cells=(2, 2, 2), thickness=1)')
    def __init__(self, options: TpmsOptions) -> None:
        align = options.align
        if options.map is not None and options.boundary == "natural" and align is not None:
            raise InvalidRequest("a mapped lattice of natural boundary fills no box to align: give align=None")
        keywords = select_arguments(options, LatticeOptions)
        model = lattice(**keywords)
        if options.map is None:
            low, high = (0.0, 0.0, 0.0), lattice_size(options)
        else:  # the extreme vertices lie in the caps, hence in the planes of the box
            low, high = (tuple(f(model.patches.vertices[:, k]) for k in range(3)) for f in (min, max))
        self._hold(model, keywords, (low, high), rotation=options.rotation, align=align, mode=options.mode)


@dataclass(frozen=True)
class StrutsOptions(StrutOptions):
    """The arguments of `Struts`."""

    _: KW_ONLY
    rotation: LatticeRotation = (0, 0, 0)
    align: Annotated[
        AlignOption,
        ANYTHING,
        "Alignment of the box of `cells` x `cell` that cuts the struts. None leaves its lowest corner in the origin.",
    ] = Align.CENTER
    mode: PartMode = Mode.ADD


@show_constructor
class Struts(LatticePart):
    """A lattice of round struts as a build123d part.

    Attributes
    ----------
    model : Model
        What `tpmscad.struts` returned, before alignment and rotation.
    certificate : Certificate
        What was measured; `certificate.met` says whether the lattice meets the request.

    The parameters are attributes, too, except `progress`.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    KernelError
        If the kernel cannot build the solid.

    Examples
    --------
    >>> with BuildPart() as part:
    ...     Struts("octet", cell=10, cells=(2, 2, 2), diameter=1)
    """

    @validate_method_options(StrutsOptions, 'Struts("octet", cell=10, cells=(2, 2, 2), diameter=1)')
    def __init__(self, options: StrutsOptions) -> None:
        keywords = select_arguments(options, StrutOptions)
        box = (0.0, 0.0, 0.0), size_of_cells(options.cell, options.cells)
        self._hold(struts(**keywords), keywords, box, rotation=options.rotation, align=options.align, mode=options.mode)


@dataclass(frozen=True)
class TpmsInfillOptions(InfillOptions):
    """The arguments of `TpmsInfill`."""

    body: Annotated[
        Any, ANYTHING, "One closed solid, or the path of its STEP file; by default the part being built."
    ] = None
    surface: Annotated[Any, ANYTHING, "Name of a surface of the catalogue, or a field; alone it may stand first."] = (
        None
    )
    _: KW_ONLY
    mode: PartMode = Mode.REPLACE


@show_constructor
class TpmsInfill(ModelPart, Part):
    """A body filled with a lattice, as a build123d part.

    ``TpmsInfill(surface, ...)`` fills the part being built and replaces it, unless `mode` says otherwise;
    ``TpmsInfill(body, surface, ...)`` fills a shape.

    Attributes
    ----------
    model : Model
        What `tpmscad.infill` returned.
    certificate : Certificate
        What was measured; `certificate.met` says whether the solid meets the request.

    The parameters are attributes, too, except `progress`.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    KernelError
        If all methods of trimming fail.
    RuntimeError
        If it is used in a builder without solids.

    Examples
    --------
    >>> filled = TpmsInfill(Cylinder(20, 50), "gyroid", cell=8, thickness=0.8, skin=1.5)
    """

    @validate_method_options(TpmsInfillOptions, 'TpmsInfill(body, "gyroid", cell=8, thickness=0.8)')
    def __init__(self, options: TpmsInfillOptions) -> None:
        body, surface = options.body, options.surface
        context: Builder | None = Builder._get_context("TpmsInfill")
        if context is not None and not isinstance(context, BuildPart):
            raise RuntimeError(f"{type(context).__name__} has no solids to fill: TpmsInfill applies to BuildPart")
        if surface is None:  # a single value is the surface
            body, surface = None, body
        if isinstance(body, str) and hasattr(surface, "wrapped"):
            raise InvalidRequest(
                f'the body comes before the surface: TpmsInfill(body, "{body}", cell=8, thickness=0.8)'
            )
        if surface is None or hasattr(surface, "wrapped"):
            raise InvalidRequest('there is no surface to fill with: TpmsInfill(body, "gyroid", cell=8, thickness=0.8)')
        if body is None:
            body = context and context._obj
        if body is None:
            raise InvalidRequest("there is no part to fill: build one first, or give the shape before the surface")
        keywords = select_arguments(options, InfillOptions)
        keywords |= {"surface": surface, "body": body, "open_faces": list_given_faces(options.open_faces)}
        self.__dict__.update({name: value for name, value in keywords.items() if name not in ("body", "progress")})
        self.mode = options.mode
        self.model = infill(**keywords)
        self.certificate = self.model.certificate
        solids = self.model.solid.solids()
        super().__init__(obj=Compound(solids).wrapped, label=self.model.name)
        if context is not None:
            # clean=False: merging coplanar faces would compare every pair of thousands, and find none to merge
            context._add_to_context(*solids, mode=options.mode, clean=False)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy of the part, as build123d makes it for every placement; model, certificate and what was given are shared."""
        for shared in (self.model, self.certificate, self.surface, self.open_faces, self.keep, self.clear):
            memo[id(shared)] = shared
        return super().__deepcopy__(memo)
