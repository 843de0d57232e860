"""What every result made of solids offers, a model as well as the domains of an exchanger: files, pictures and a table.

Each method imports the room that does the work when it is called: a result itself is solids with a certificate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol

from tpmscad._typing import BoxCorners
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import ColorBy, PicturePath, PictureSize, Section, View
from tpmscad.api.shared_kinds import TEXTS
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.results.certificate import Certificate
from tpmscad.results.result_summary import format_html


class SolidResult(Protocol):
    """Solids with a certificate, as files, meshes and pictures are made of them."""

    @property
    def name(self) -> str:
        """Name of the whole."""

    @property
    def volume(self) -> float:
        """Volume of all solids."""

    @property
    def bounding_box(self) -> BoxCorners:
        """Corners of the box around the solids."""

    @property
    def certificate(self) -> Certificate:
        """The certificate, whose tolerance meshes keep to by default."""

    @property
    def wrapped(self) -> Any:
        """The TopoDS shape of all solids."""

    def named_solids(self) -> tuple[NamedSolid, ...]:
        """The solids with their names and the labels of their faces."""

    @property
    def export_step(self) -> Callable[..., None]:
        """Writes the solids as a STEP file."""


class ResultMethods:
    """The methods that a model and the domains of an exchanger have in common."""

    @validate_call()
    def render(
        self,
        path: PicturePath,
        *,
        view: View = "iso",
        section: Section = None,
        size: PictureSize = (1200, 900),
        color_by: ColorBy = None,
        hide: Annotated[str | Sequence[str], TEXTS.described_as(example='"skin"'), "As in `tpmscad.render`."] = (),
    ) -> None:
        """Draw the solids as a PNG picture, without a display; the domains of an exchanger each in its colour.

        Examples
        --------
        >>> model = tpmscad.lattice("gyroid", cell=10, cells=(2, 2, 2), thickness=1)  # doctest: +SKIP
        >>> model.render("gyroid.png", section="z=5", color_by="deviation")  # doctest: +SKIP
        """
        from tpmscad.studies._render import render

        render(self, path, view=view, section=section, size=size, color_by=color_by, hide=hide)

    def _export(
        self: SolidResult, path: str | Path, deviation: float | None, angle: float | None, **step_options: Any
    ) -> None:
        """Write the file whose suffix `path` has; options of STEP go to `export_step`."""
        from tpmscad.files.file_formats import STEP_SUFFIXES, check_options, find_suffix, write_mesh_or_brep_file

        suffix = find_suffix(path)
        check_options(suffix, deviation=deviation, angle=angle, **step_options)
        if suffix in STEP_SUFFIXES:
            self.export_step(path, **step_options)
        else:
            write_mesh_or_brep_file(self, path, deviation=deviation, angle=angle)

    def _repr_html_(self: SolidResult) -> str:
        return format_html(self, self.name, self.bounding_box, self.certificate)

    def __dir__(self) -> list[str]:
        return sorted(name for name in object.__dir__(self) if not name.startswith("_"))
