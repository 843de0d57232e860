"""The result of `fluid_domains`: three models that share their faces, and what touches each face of the body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from tpmscad._typing import BoxCorners
from tpmscad.api.public_calls import validate_call, validate_method_options
from tpmscad.api.shared_kinds import PATH, TEXT
from tpmscad.brep.solid_names import name_pieces
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import vertices_of
from tpmscad.kernel.occt.shape_pickling import pack_results, unpack_results
from tpmscad.kernel.render.palette import DOMAIN_COLOURS
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.requests.study_options import DomainsPictureOptions, ExportOptions, MeshOptions
from tpmscad.results.certificate import CHIP_VOLUME_FRACTION, Certificate
from tpmscad.results.model import Model
from tpmscad.results.result_summary import count_pieces, format_html, format_size

if TYPE_CHECKING:
    from tpmscad.files.file_formats import ExportedFile
    from tpmscad.studies.flow_results import ExchangerEstimate, FlowEstimate

WALL, PLUS, MINUS = "wall", "channel +", "channel -"
"""Names of the domains; a channel is named by the sign of the surface's nodal value in it."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceContact:
    """One face of the body, by its index and its label, the area of each domain on it, model units squared, and its centre.

    `centre` is None if the body is no CAD body.
    """

    face: int
    label: str
    areas: Mapping[str, float]
    centre: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False, repr=False)
class FluidDomains:
    """The wall and the two channels as conformal solids: adjacent domains share TopoDS faces, edges and vertices.

    Attributes
    ----------
    name : str
        Name of the whole, used in files.
    wall, plus, minus : Model
        The wall, and the channels in which the nodal value of the surface is positive and negative.
    touches : tuple of FaceContact
        For every face of the body, the domains that reach it and their areas on it.
    volume : float
        Volume of the three domains together, which is the body's, model units cubed.
    surface : str
        Name of the surface in the catalogue.
    cell : (float, float, float)
        Edge lengths of its cell, model units.
    offset : (float, float) or None
        Normal distances of the two sides of the wall from the surface, model units; None if they vary.
    """

    name: str
    wall: Model
    plus: Model
    minus: Model
    touches: tuple[FaceContact, ...]
    volume: float
    surface: str
    cell: tuple[float, float, float]
    offset: tuple[float, float] | None = None

    @property
    def certificate(self) -> Certificate:
        """The certificate of the wall, with the checks and notes of the channels."""
        return self.wall.certificate

    @property
    def domains(self) -> dict[str, Model]:
        """The three models by their names "wall", "channel +" and "channel -"."""
        return {WALL: self.wall, PLUS: self.plus, MINUS: self.minus}

    @property
    def wrapped(self) -> Any:
        """All solids as one TopoDS compound with shared faces, in the order wall, channel +, channel -."""
        return make_compound(solid for model in self.domains.values() for solid in model.built.solids)

    @cached_property
    def bounding_box(self) -> BoxCorners:
        """Opposite corners of the box around the domains: ((x0, y0, z0), (x1, y1, z1)), model units."""
        corners = np.array([model.bounding_box for model in self.domains.values()])
        return tuple(corners[:, 0].min(axis=0).tolist()), tuple(corners[:, 1].max(axis=0).tolist())

    @validate_method_options(ExportOptions, 'export("exchanger.step")')
    def export(self, options: ExportOptions) -> ExportedFile:
        """Write the named solids to a file whose suffix says the format; the file is read back and compared with them.

        Returns
        -------
        ExportedFile
            The path, and of meshes the number of triangles and the deviation that was reached.

        Raises
        ------
        InvalidRequest
            If the suffix is not known, or an option does not apply to the format.
        KernelError
            If a mesh cannot be closed or does not keep the deviation, or the file does not read back as it was written.

        Notes
        -----
        A BREP file keeps the faces that domains share, in gmsh, FreeCAD and build123d. STEP has no faces with a solid on either
        side that readers take as solids: the file stores shared vertices, edges and surfaces once, but each solid reads back with
        faces of its own, in the same place; ``fragment`` of gmsh restores the shared ones. STEP is an assembly of named and
        coloured products. 3MF and GLB hold a mesh for each solid, with the same triangles where solids touch.

        Examples
        --------
        >>> parts.export("exchanger.brep")
        """
        from tpmscad.file_suffixes import STEP_SUFFIXES
        from tpmscad.files.file_formats import ExportedFile, check_export, write_mesh_or_brep_file

        suffix = check_export(options)
        if suffix == ".stl":
            raise InvalidRequest("an STL file holds one body: write the domains one by one, or as .3mf")
        if suffix not in STEP_SUFFIXES:
            return write_mesh_or_brep_file(self, options, [model.built for model in self.domains.values()])
        self.export_step(options.path, schema=options.schema)
        return ExportedFile(Path(options.path))

    @validate_call()
    def export_step(
        self,
        path: Annotated[str | Path, PATH, "The file to write. It is left unchanged if the check fails."],
        *,
        schema: Annotated[str, TEXT.described_as(example='"ap242"'), "Application protocol of the file."] = "ap242",
    ) -> None:
        """Write the named solids to a STEP file, which is read back and checked.

        Raises
        ------
        KernelError
            If the file does not read back as it was written.
        """
        from tpmscad.files.checked_write import write_checked_solids

        solids = self.named_solids()
        write_checked_solids(solids, path, schema=schema, name=self.name, volume=self.volume, assembly=True)

    @validate_method_options(DomainsPictureOptions, 'render("exchanger.png", section="z")')
    def render(self, options: DomainsPictureOptions) -> None:
        """Draw the domains, each in its colour, as a PNG picture, without a display.

        Examples
        --------
        >>> parts = tpmscad.fluid_domains(body, "gyroid", cell=10, thickness=1)  # doctest: +SKIP
        >>> parts.render("exchanger.png", section="x,y", hide="channel +")  # doctest: +SKIP
        """
        from tpmscad.studies._render import render

        render(self, **vars(options))

    @validate_method_options(MeshOptions, "mesh(0.5)")
    def mesh(self, options: MeshOptions) -> VolumeMesh:
        """Tetrahedra in wall and channels, which share the nodes of the faces between them; by gmsh.

        Returns
        -------
        VolumeMesh
            The elements are the groups "wall", "channel +" and "channel -"; facets between two of them "wall | channel +" and
            "wall | channel -", those on the body's faces "channel +: opening X-", "wall: body 3" and the like.

        Raises
        ------
        InvalidRequest, KernelError
            As `Model.mesh`.

        Examples
        --------
        >>> parts = tpmscad.fluid_domains(body, "gyroid", cell=10, thickness=1)  # doctest: +SKIP
        >>> parts.mesh(0.8).write("exchanger.msh")  # doctest: +SKIP
        """
        from tpmscad.studies.volume_meshing import mesh_named_solids

        regions = [name for name, model in self.domains.items() for _ in model.built.solids]
        return mesh_named_solids(self.named_solids(), regions, self.bounding_box, options, name=self.name)

    def named_solids(self) -> tuple[NamedSolid, ...]:
        """The solids with their names, colours and the labels of their faces, as files store them.

        In the order wall, channel +, channel -; of each the largest first, which alone has the plain name: another piece of the
        wall, in the corner of the greatest x and the least y and z, is "wall (X+ Y- Z-)".
        """
        result = []
        for domain, model in self.domains.items():
            solids = model.named_solids()
            names = name_pieces(domain, [vertices_of(of.solid) for of in solids])
            result += [
                replace(of, name=name, colour=DOMAIN_COLOURS[domain]) for name, of in zip(names, solids, strict=True)
            ]
        return tuple(result)

    @property
    def hydraulic_diameters(self) -> dict[str, float]:
        """4 x volume / wetted area of each channel by its name, model units; the area on the body's faces is not wetted."""
        on_body = {name: sum(contact.areas.get(name, 0.0) for contact in self.touches) for name in (PLUS, MINUS)}
        return {name: 4.0 * self.domains[name].volume / (self.domains[name].area - on_body[name]) for name in on_body}

    def estimate_flow(self, **arguments: Any) -> FlowEstimate:
        """`tpmscad.estimate_flow` of a channel of these domains: pressure drop and heat transfer by published correlations."""
        from tpmscad.studies._estimate_flow import estimate_flow

        return estimate_flow(self, **arguments)

    def estimate_exchanger(self, **arguments: Any) -> ExchangerEstimate:
        """`tpmscad.estimate_exchanger` of these domains: effectiveness, heat and pressure drops with two fluids."""
        from tpmscad.studies._estimate_exchanger import estimate_exchanger

        return estimate_exchanger(self, **arguments)

    def to_dict(self) -> dict[str, Any]:
        """The certificate and the figures of every domain as plain values, ready for JSON.

        The entries of the certificate, and under "domains" by name: pieces, volume, area, hydraulic diameter (of channels), and
        the areas on the body's faces by their labels.
        """
        diameters = self.hydraulic_diameters
        domains = {
            name: {
                "pieces": model.built.n_solids,
                "volume": model.volume,
                "area": model.area,
                "hydraulic_diameter": diameters.get(name),
                "faces": {contact.label: contact.areas[name] for contact in self.touches if name in contact.areas},
            }
            for name, model in self.domains.items()
        }
        return self.certificate.to_dict() | {"domains": domains}

    def summary(self) -> str:
        """The domains as a table: pieces, volume, hydraulic diameter, and the faces of the body that each reaches.

        A line for each domain, with units.
        """
        lines = []
        for name, found in self.to_dict()["domains"].items():
            line = f"{name:10}  {_describe_pieces(self.domains[name])}, volume {found['volume']:.7g} mm3"
            if found["hydraulic_diameter"] is not None:
                line += f", hydraulic diameter {found['hydraulic_diameter']:.4g} mm"
            faces = ", ".join(f"{face} ({area:.4g} mm2)" for face, area in found["faces"].items())
            lines += [line, f"{'':10}  reaches {faces}" if faces else f"{'':10}  reaches no face of the body"]
        return "\n".join(lines)

    def __reduce__(self) -> Any:
        models = (self.wall, self.plus, self.minus)
        content, parts = pack_results([model.built.dismantle() for model in models])
        states = [{**model.__getstate__(), "built": None} for model in models]
        figures = self.touches, self.volume, self.surface, self.cell, self.offset
        return _restore_domains, (self.name, content, parts, states, figures)

    def __repr__(self) -> str:
        lines = [f"{self.name}: {format_size(self.bounding_box)} mm, volume {self.volume:.7g}"]
        for name, model in self.domains.items():
            lines.append(f"  {name:10}{_describe_pieces(model)}, volume {model.volume:.7g}, area {model.area:.7g}")
        lines += [f"  warning   wall: {warning}" for warning in self.certificate.warnings]
        shortfalls = self.certificate.shortfalls
        lines.append(
            "  met" if not shortfalls else f"  NOT met {shortfalls[0]}" + (" ..." if len(shortfalls) > 1 else "")
        )
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return format_html(self, self.name, self.bounding_box, self.certificate)

    def __dir__(self) -> list[str]:
        return sorted(name for name in object.__dir__(self) if not name.startswith("_"))


def _describe_pieces(model: Model) -> str:
    """The number of a domain's pieces, and how many of them are chips."""
    pieces = model.certificate.pieces
    chips = [volume for volume in pieces if volume < CHIP_VOLUME_FRACTION * pieces[0]]
    loose = f" ({len(chips)} of them loose, {sum(chips):.3g} mm3: shift the lattice by phase)" if chips else ""
    return count_pieces(len(pieces)) + loose


def _restore_domains(
    name: str, content: bytes, parts: Any, states: Sequence[dict[str, Any]], figures: tuple[Any, ...]
) -> FluidDomains:
    """The domains of a pickle, whose solids share their faces as before."""
    models = []
    for state, built in zip(states, unpack_results(content, parts), strict=True):
        model = Model.__new__(Model)
        model.__dict__.update(state, built=built)
        models.append(model)
    wall, plus, minus = models
    return FluidDomains(name, wall, plus, minus, *figures)
