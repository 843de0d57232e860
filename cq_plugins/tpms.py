"""Lattices on the CadQuery stack: `import cq_plugins.tpms` adds the methods `tpms` and `tpmsInfill` to Workplane.

import cadquery as cq
import cq_plugins.tpms

part = cq.Workplane().tpms("gyroid", cell=10, cells=(2, 2, 2), thickness=1)
filled = cq.Workplane().cylinder(50, 20).tpmsInfill("gyroid", cell=8, thickness=0.8, skin=1.5)
"""

from __future__ import annotations

from typing import Any, Literal, Unpack

import cadquery as cq

from tpmscad.errors import InvalidRequest, NotMet
from tpmscad.workflows import Model, infill, lattice
from tpmscad.workflows.lattice_request import (
    LATTICE_DEFAULTS,
    InfillOptions,
    LatticeOptions,
    lattice_size,
    with_keywords_of,
)


@with_keywords_of(lattice)
def tpms(
    self: cq.Workplane,
    surface: str,
    *,
    centered: bool | tuple[bool, bool, bool] = False,
    combine: bool | Literal["cut", "a", "s"] = False,
    clean: bool = True,
    **options: Unpack[LatticeOptions],
) -> cq.Workplane:
    """Put a lattice of a minimal surface at each point on the stack, or at the origin of the workplane if there is none.

    The lattice is made once and placed in workplane coordinates.

    Parameters
    ----------
    surface : str
        Name of a surface of the catalogue; see ``tpmscad surfaces``.
    cell, cells, thickness, offset, volume_fraction, kind, side, reference, boundary, phase, map, tol, progress
        The keywords of `tpmscad.lattice`.
    centered : bool or (3,) bools, optional
        Whether the center of the box of `cells` x `cell` lies on the point, or its lowest corner; per axis.
    combine : bool or {"cut", "a", "s"}, optional
        As in ``Workplane.box``, but False by default: the lattices are the new stack, unchanged by the kernel.
    clean : bool, optional
        As in ``Workplane.box``.

    Returns
    -------
    Workplane
        With the lattices, or the combined solid, on the stack.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    NotMet
        If the result misses the request; it carries the certificate.

    Notes
    -----
    To read the certificate of a lattice that meets the request, make it with `tpmscad.lattice` and place it with
    ``eachpoint(cq.Shape.cast(model.wrapped), True)``.

    Examples
    --------
    >>> import cadquery as cq
    >>> lattices = cq.Workplane().rarray(30, 30, 2, 2).tpms("gyroid", cell=10, thickness=1, centered=True)
    """
    given: dict[str, Any] = {**LATTICE_DEFAULTS, **options}
    middle = (centered,) * 3 if isinstance(centered, bool) else centered
    if given["map"] is not None and any(middle):
        raise InvalidRequest("a mapped lattice lies where the map puts it: leave centered out")
    model = lattice(surface, **options)
    size = lattice_size(surface, given)
    shift = (-length / 2 if half else 0.0 for length, half in zip(size, middle, strict=True))
    shape = cq.Shape.cast(_require_met(model).wrapped).move(cq.Location(cq.Vector(*shift)))
    return self.eachpoint(shape, True, combine, clean and bool(combine))


@with_keywords_of(infill)
def tpmsInfill(self: cq.Workplane, surface: Any, **options: Unpack[InfillOptions]) -> cq.Workplane:
    """Fill the solid on the stack, or the nearest up the chain, with a lattice.

    Parameters
    ----------
    surface : str, Field or callable
        Name of a surface, or a field; see `tpmscad.infill`.
    cell, thickness, offset, volume_fraction, kind, side, reference, phase, rotation, skin, open_faces, tol, progress
        The keywords of `tpmscad.infill`, in global coordinates. `open_faces` may also be a selector of the solid's faces, such as
        ``">Z"``.

    Returns
    -------
    Workplane
        With the filled solid on the stack.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    NotMet
        If the result misses the request; it carries the certificate.

    Notes
    -----
    To read the certificate of a solid that meets the request, call `tpmscad.infill` with the workplane and put the result on a
    stack with ``newObject([cq.Shape.cast(model.wrapped)])``.

    Examples
    --------
    >>> import cadquery as cq
    >>> filled = cq.Workplane().box(30, 20, 20).tpmsInfill("gyroid", cell=8, thickness=0.8, skin=1.5, open_faces=">Z")
    """
    open_faces = options.get("open_faces", ())
    if isinstance(open_faces, str):
        options["open_faces"] = self.newObject([self.findSolid()]).faces(open_faces).vals()
    model = infill(self, surface, **options)
    return self.newObject([cq.Shape.cast(_require_met(model).wrapped)])


def _require_met(model: Model) -> Model:
    """The model; NotMet with its certificate if it misses the request."""
    if not model.certificate.met:
        raise NotMet(
            f"the {model.name} misses the request: {'; '.join(model.certificate.shortfalls)}", model.certificate
        )
    return model


def _register_methods() -> None:
    """Make `tpms` and `tpmsInfill` methods of Workplane; ImportError if another plug-in has taken one of the names."""
    for method in (tpms, tpmsInfill):
        taken = getattr(cq.Workplane, method.__name__, method)
        if taken.__module__ != __name__:
            raise ImportError(
                f"cadquery.Workplane already has a method {method.__name__}, from {taken.__module__}: "
                "import only one of the two"
            )
    cq.Workplane.tpms = tpms
    cq.Workplane.tpmsInfill = tpmsInfill


_register_methods()
