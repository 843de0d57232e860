"""STEP files: write a model or any shape, read a file back and report its content, draw it as a picture, slice it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tpmscad import kernel
from tpmscad.public_calls import public
from tpmscad.workflows.domain_results import FluidDomains
from tpmscad.workflows.layer_slices import Slices, slice_shape
from tpmscad.workflows.model import Model
from tpmscad.workflows.pictures import render


@public()
def export_step(
    model: Any, path: str | Path, *, schema: str = "ap242", name: str | None = None, verify: str | None = None
) -> None:
    """Write a model, a CAD shape, or several of them as a STEP file.

    The file is written under a temporary name and renamed, so it is complete or absent. A result of this package is also read
    back and compared with what was written (see `Model.export_step`); shapes are not.

    Parameters
    ----------
    model : Model, FluidDomains, shape, or sequence of Model or shape
        A result of this package, or a build123d, CadQuery or TopoDS shape of one or more solids. Those of a sequence become
        solids of one product.
    path : str or Path
        The file to write.
    schema : {"ap242", "ap214"}, optional
        STEP application protocol.
    name : str, optional
        Name of the product. A result of this package is written under its own name.
    verify : {"kernel"}, optional
        Of a model: as in `Model.export_step`. Domains are always read back by the kernel as a whole.

    Raises
    ------
    InvalidRequest
        If a shape has no solid, or faces outside of its solids.
    KernelError
        If the file cannot be written, or does not read back as the model.

    Examples
    --------
    >>> model = tpmscad.lattice("gyroid", cell=10, thickness=1)  # doctest: +SKIP
    >>> tpmscad.export_step(model, "gyroid.step")  # doctest: +SKIP
    """
    if isinstance(model, Model):
        model.export_step(path, schema=schema, verify=verify)
    elif isinstance(model, FluidDomains):
        model.export_step(path, schema=schema)
    elif isinstance(model, list | tuple):
        title = name or Path(path).stem
        solids = [
            solid
            for number, item in enumerate(model, 1)
            for solid in (
                item.named_solids() if isinstance(item, Model) else kernel.name_solids(item, f"{title} {number}")
            )
        ]
        kernel.write_solids(solids, path, schema=schema, name=title)
    else:
        kernel.write_shape(model, path, schema=schema, name=name)


@public()
def check_step(path: str | Path) -> kernel.StepReport:
    """Read a STEP file with the kernel and report its content.

    Parameters
    ----------
    path : str or Path
        The STEP file.

    Returns
    -------
    StepReport
        Products, units and `shape`: numbers of solids, shells and faces, validity, closedness, volume, area and tolerances.
        `ok` is True if the file holds valid closed solids; `to_dict()` is what ``tpmscad check --report`` writes.

    Raises
    ------
    InvalidRequest
        If there is no such file, it is not a STEP file, the kernel cannot read it, or it holds no solid. The file is read in a
        child process, so that a crash of the kernel is such an error, too.

    Examples
    --------
    >>> tpmscad.check_step("gyroid.step").ok  # doctest: +SKIP
    True
    """
    return kernel.check_foreign_step(path)


@public()
def render_step(
    path: str | Path,
    picture: str | Path,
    *,
    view: str | Sequence[float] = "iso",
    section: Any = None,
    size: tuple[int, int] = (1200, 900),
    color_by: str | None = None,
    hide: str | Sequence[str] = (),
) -> None:
    """Draw a STEP file as a PNG picture, without a display.

    Parameters
    ----------
    path : str or Path
        The STEP file.
    picture : str or Path
        The PNG file to write.
    view, section, size, color_by, hide
        As in `tpmscad.render`. By default the solids and faces have the colours that the file holds; ``color_by="piece"`` gives
        every solid its own.

    Raises
    ------
    InvalidRequest
        If there is no such file, it is not a STEP file, the kernel cannot read it or finds no solid in it, or an argument is not
        understood.

    Examples
    --------
    >>> tpmscad.render_step("gyroid.step", "gyroid.png", section="z=5")  # doctest: +SKIP
    """
    render(Path(path), picture, view=view, section=section, size=size, color_by=color_by, hide=hide)


@public()
def slice_step(path: str | Path, height: float, chord_error: float | None = None) -> Slices:
    """Slice the solids of a STEP file for layered manufacturing; see `Model.slices`.

    Parameters
    ----------
    path : str or Path
        The STEP file to read.
    height : float
        Height of a layer in mm; layers begin at the lowest point of the solids and are cut in their middle.
    chord_error : float, optional
        Greatest distance of a chord from the exact contour in mm; by default a quarter of the height.

    Returns
    -------
    Slices
        The layers with their closed contours.

    Raises
    ------
    InvalidRequest
        If the file cannot be read, an argument is not positive, or there would be more than 100,000 layers.
    KernelError
        If the kernel cannot triangulate the solids.

    Examples
    --------
    >>> from tpmscad import workflows
    >>> workflows.slice_step("part.step", 0.05).write("part.cli")  # doctest: +SKIP
    """
    shape = kernel.read_foreign_step(path).shape
    low, high = kernel.shape_bounds(shape)
    return slice_shape(shape, Path(path).stem, height, chord_error, (float(low[2]), float(high[2])))
