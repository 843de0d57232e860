"""Lattices and filled bodies as build123d parts, in builder and algebra mode.

from tpmscad.build123d import Tpms, TpmsInfill

part = Tpms("gyroid", cell=10, cells=(2, 2, 2), thickness=1)
filled = TpmsInfill(Cylinder(20, 50), "gyroid", cell=8, thickness=0.8, skin=1.5)
"""

from __future__ import annotations

from collections.abc import Sequence
from inspect import signature
from pathlib import Path
from typing import Any, Self, Unpack

from build123d import Align, BasePartObject, BuildPart, Compound, Location, Mode, Part, RotationLike, Vector
from build123d.build_common import Builder
from build123d.geometry import to_align_offset

from tpmscad.api.public_calls import public
from tpmscad.errors import InvalidRequest
from tpmscad.requests.face_selection import list_given_faces
from tpmscad.requests.lattice_request import (
    INFILL_DEFAULTS,
    LATTICE_DEFAULTS,
    InfillOptions,
    LatticeOptions,
    lattice_size,
    with_keywords_of,
)
from tpmscad.results.certificate import Certificate
from tpmscad.results.model import Model
from tpmscad.results.placed_model import place_model
from tpmscad.results.result_summary import count_pieces
from tpmscad.solids._infill import infill
from tpmscad.solids._lattice import lattice

__all__ = ["Tpms", "TpmsInfill"]


def __dir__() -> list[str]:
    return sorted(__all__)


class ModelPart:
    """What `Tpms` and `TpmsInfill` have of the model that they hold: its files, its pictures and its words."""

    model: Model
    certificate: Certificate
    wrapped: Any

    @property
    def placed_model(self) -> Model:
        """The model where the part is: aligned, rotated and moved."""
        return place_model(self.model, self.wrapped)

    @public()
    def export(
        self,
        path: str | Path,
        *,
        deviation: float | None = None,
        angle: float | None = None,
        schema: str = "ap242",
        verify: str | None = None,
    ) -> None:
        """Write the part, where it is, to a file whose suffix says the format; the file is read back and compared.

        Parameters
        ----------
        path : str or Path
            The file to write: ``.step``, ``.stp``, ``.brep``, ``.stl``, ``.3mf`` or ``.glb``.
        deviation, angle, schema, verify
            As in `Model.export`.

        Raises
        ------
        InvalidRequest
            If the suffix is not known, an option does not apply, or the part is not the model's solid any more.
        KernelError
            If the file does not read back as the solid that was written.

        Examples
        --------
        >>> (Pos(20, 0, 0) * Tpms("gyroid", cell=10, thickness=1)).export("gyroid.step")
        """
        self.placed_model.export(path, deviation=deviation, angle=angle, schema=schema, verify=verify)

    @public()
    def render(
        self,
        path: str | Path,
        *,
        view: str | Sequence[float] = "iso",
        section: Any = None,
        size: tuple[int, int] = (1200, 900),
        color_by: str | None = None,
    ) -> None:
        """Draw the part, where it is, as a PNG picture.

        Parameters
        ----------
        path : str or Path
            The PNG file to write.
        view, section, size, color_by
            As in `tpmscad.render`.

        Raises
        ------
        InvalidRequest
            If an argument is not understood, or the part is not the model's solid any more.

        Examples
        --------
        >>> Tpms("gyroid", cell=10, thickness=1).render("gyroid.png", section="z")
        """
        self.placed_model.render(path, view=view, section=section, size=size, color_by=color_by)

    def __repr__(self) -> str:
        found = self.certificate
        return (
            f"{type(self).__name__}: {self.model.name}, {count_pieces(len(found.pieces))}, {found.n_faces} faces, volume "
            f"{found.volume:.7g}, {'met' if found.met else f'NOT met: {found.shortfalls[0]}'}"
        )


class Tpms(ModelPart, BasePartObject):
    """A lattice of a minimal surface as a build123d part.

    Parameters
    ----------
    surface : str
        Name of a surface of the catalogue; see ``tpmscad surfaces``.
    cell, cells, thickness, offset, volume_fraction, porosity, pore_size, kind, side
        The size of the lattice and what is solid in it, as in `tpmscad.lattice`.
    reference, boundary, phase, loose, map, tol, progress
        The other keywords of `tpmscad.lattice`.
    rotation : RotationLike, optional
        Rotation of the aligned lattice, degrees.
    align : Align or tuple of Align or None, optional
        Alignment of the box of `cells` x `cell` that the lattice fills, or of its image under `map`; the kernel's bounding box of
        B-splines would be too large. None leaves the lattice where `tpmscad.lattice` puts it.
    mode : Mode, optional
        Combination mode in a builder.

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

    @public('Tpms("gyroid", cell=10, cells=(2, 2, 2), thickness=1)')
    @with_keywords_of(lattice)
    def __init__(
        self,
        surface: str,
        *,
        rotation: RotationLike = (0, 0, 0),
        align: Align | tuple[Align, Align, Align] | None = Align.CENTER,
        mode: Mode = Mode.ADD,
        **options: Unpack[LatticeOptions],
    ) -> None:
        given = {**LATTICE_DEFAULTS, **options}
        if given["map"] is not None and given["boundary"] == "natural" and align is not None:
            raise InvalidRequest("a mapped lattice of natural boundary fills no box to align: give align=None")
        self.surface = surface
        self.__dict__.update({name: value for name, value in given.items() if name != "progress"})
        self.align = align
        self.model = lattice(surface, **options)
        self.certificate = self.model.certificate
        if given["map"] is None:
            low, high = (0.0, 0.0, 0.0), lattice_size(surface, given)
        else:  # the extreme vertices lie in the caps, hence in the planes of the box
            low, high = (tuple(f(self.model.patches.vertices[:, k]) for k in range(3)) for f in (min, max))
        part = self.model.solid
        part.label = self.model.name
        part.move(Location(to_align_offset(Vector(low), Vector(high), align)))
        super().__init__(part, rotation=rotation, align=None, mode=mode)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy of the part, as build123d makes it for every placement; model and certificate are shared."""
        for shared in (self.model, self.certificate, self.map):
            memo[id(shared)] = shared
        return super().__deepcopy__(memo)


Tpms.__signature__ = signature(
    Tpms.__init__
).replace(  # the metaclass hides that of __init__
    parameters=list(signature(Tpms.__init__).parameters.values())[1:], return_annotation=Tpms
)


class TpmsInfill(ModelPart, Part):
    """A body filled with a lattice, as a build123d part.

    ``TpmsInfill(surface, ...)`` fills the part being built and replaces it, unless `mode` says otherwise;
    ``TpmsInfill(body, surface, ...)`` fills a shape.

    Parameters
    ----------
    body : shape, str or Path, optional
        One closed solid, or the path of its STEP file; by default the part being built.
    surface : str, Field or callable
        Name of a surface of the catalogue, or a field; alone it may stand first.
    cell, thickness, offset, volume_fraction, porosity, pore_size, kind, side
        The size of the lattice and what is solid in it, as in `tpmscad.infill`.
    reference, phase, rotation, skin, open_faces, loose, tol, progress
        The other keywords of `tpmscad.infill`; `rotation` turns the lattice, not the body.
    mode : Mode, optional
        Combination mode in a builder.

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

    @public('TpmsInfill(body, "gyroid", cell=8, thickness=0.8)')
    @with_keywords_of(infill)
    def __init__(
        self,
        body: Any = None,
        surface: Any = None,
        *,
        mode: Mode = Mode.REPLACE,
        **options: Unpack[InfillOptions],
    ) -> None:
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
        options["open_faces"] = list_given_faces(options.get("open_faces", ()))
        self.surface = surface
        given = {**INFILL_DEFAULTS, **options}
        self.__dict__.update({name: value for name, value in given.items() if name != "progress"})
        self.mode = mode
        self.model = infill(body, surface, **options)
        self.certificate = self.model.certificate
        solids = self.model.solid.solids()
        super().__init__(obj=Compound(solids).wrapped, label=self.model.name)
        if context is not None:
            # clean=False: merging coplanar faces would compare every pair of thousands, and find none to merge
            context._add_to_context(*solids, mode=mode, clean=False)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy of the part, as build123d makes it for every placement; model and certificate are shared."""
        for shared in (self.model, self.certificate, self.surface, self.open_faces):
            memo[id(shared)] = shared
        return super().__deepcopy__(memo)
