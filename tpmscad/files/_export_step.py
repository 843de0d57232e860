"""Writing of a model, of domains or of any shapes as a STEP file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import Schema
from tpmscad.api.shared_kinds import ANYTHING, PATH, TEXT
from tpmscad.kernel.export.shape_file import name_solids, write_shape, write_solids
from tpmscad.results.domain_results import FluidDomains
from tpmscad.results.model import Model


@validate_call()
def export_step(
    model: Annotated[
        Any,
        ANYTHING,
        "A result of this package, or a build123d, CadQuery or TopoDS shape of one or more solids. Those of a "
        "sequence become solids of one product.",
    ],
    path: Annotated[str | Path, PATH, "The file to write."],
    *,
    schema: Schema = "ap242",
    name: Annotated[
        str | None, TEXT, "Name of the product. A result of this package is written under its own name."
    ] = None,
    verify: Annotated[
        str | None,
        choice_of("kernel"),
        "Of a model: as in `Model.export_step`. Domains are always read back by the kernel as a whole.",
    ] = None,
) -> None:
    """Write a model, a CAD shape, or several of them as a STEP file.

    The file is written under a temporary name and renamed, so it is complete or absent. A result of this package is also read
    back and compared with what was written (see `Model.export_step`); shapes are not.

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
            for solid in (item.named_solids() if isinstance(item, Model) else name_solids(item, f"{title} {number}"))
        ]
        write_solids(solids, path, schema=schema, name=title)
    else:
        write_shape(model, path, schema=schema, name=name)
