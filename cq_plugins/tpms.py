"""Lattices on the CadQuery stack: `import cq_plugins.tpms` gives every Workplane the methods `tpms` and `tpmsInfill`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal

import cadquery as cq

from tpmscad.errors import InvalidRequest, NotMet
from tpmscad.workflows import infill, lattice
from tpmscad.workflows.lattice_request import lattice_size


def tpms(
    self: cq.Workplane,
    surface: str,
    *,
    cell: float | Sequence[float],
    cells: int | Sequence[int] = (1, 1, 1),
    thickness: float | None = None,
    offset: float | Sequence[float] | None = None,
    volume_fraction: float | None = None,
    kind: str = "sheet",
    side: str = "-",
    reference: str | None = None,
    boundary: str = "box",
    phase: Sequence[float] = (0.0, 0.0, 0.0),
    map: Callable[[Any], Any] | None = None,
    tol: float | None = None,
    progress: Callable[[str, float], None] | None = None,
    centered: bool | tuple[bool, bool, bool] = False,
    combine: bool | Literal["cut", "a", "s"] = False,
    clean: bool = True,
) -> cq.Workplane:
    """A lattice of a minimal surface at each point on the stack, or at the workplane's origin if there is none.

    Takes the keywords of `tpmscad.lattice`. It is made once and placed in workplane coordinates. centered: whether the box of
    `cells` x `cell` has its middle on the point (per axis), not its lowest corner. combine and clean are those of
    `Workplane.box`, but combine is False unless asked for: the lattices are the new stack, untouched by the kernel.

    InvalidRequest names what can't be had and what would do; NotMet carries the certificate of a result that misses the
    request. To read the certificate of one that keeps it, make the model with `tpmscad.lattice` and put it on the stack:
    `eachpoint(cq.Shape.cast(model.solid.wrapped), True)`.
    """
    middle = (centered,) * 3 if isinstance(centered, bool) else centered
    if map is not None and any(middle):
        raise InvalidRequest("a mapped lattice lies where the map puts it: leave centered out")
    model = lattice(
        surface,
        cell=cell,
        cells=cells,
        thickness=thickness,
        offset=offset,
        volume_fraction=volume_fraction,
        kind=kind,
        side=side,
        reference=reference,
        boundary=boundary,
        phase=phase,
        map=map,
        tol=tol,
        progress=progress,
    )
    shift = (-length / 2 if half else 0.0 for length, half in zip(lattice_size(cell, cells), middle, strict=True))
    shape = cq.Shape.cast(_require_met(model).built.shape).move(cq.Location(cq.Vector(*shift)))
    return self.eachpoint(shape, True, combine, clean and bool(combine))


def tpmsInfill(
    self: cq.Workplane,
    surface: Any,
    *,
    cell: float | Sequence[float] | None = None,
    thickness: float | None = None,
    offset: float | Sequence[float] | None = None,
    volume_fraction: float | None = None,
    kind: str = "sheet",
    side: str = "-",
    reference: str | None = None,
    phase: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] = (0.0, 0.0, 0.0),
    skin: float | None = None,
    open_faces: str | Iterable[Any] = (),
    tol: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> cq.Workplane:
    """The solid on the stack, or the nearest up the chain, filled with a lattice; it is the new stack.

    Takes the keywords of `tpmscad.infill`, in global coordinates: the lattice is anchored at their origin. open_faces may be a
    selector of the solid's faces as well (">Z").

    InvalidRequest names what can't be had and what would do; NotMet carries the certificate of a result that misses the
    request. To read the certificate of one that keeps it, call `tpmscad.infill` with the workplane and put the result on a
    stack: `newObject([cq.Shape.cast(model.wrapped)])`.
    """
    if isinstance(open_faces, str):
        open_faces = self.newObject([self.findSolid()]).faces(open_faces).vals()
    model = infill(
        self,
        surface,
        cell=cell,
        thickness=thickness,
        offset=offset,
        volume_fraction=volume_fraction,
        kind=kind,
        side=side,
        reference=reference,
        phase=phase,
        rotation=rotation,
        skin=skin,
        open_faces=open_faces,
        tol=tol,
        progress=progress,
    )
    return self.newObject([cq.Shape.cast(_require_met(model).built.shape)])


def _require_met(model: Any) -> Any:
    if not model.certificate.met:
        raise NotMet(
            f"the {model.name} misses the request: {'; '.join(model.certificate.shortfalls)}", model.certificate
        )
    return model


def _register_methods() -> None:
    """Make `tpms` and `tpmsInfill` methods of Workplane; ImportError if some other plug-in has taken a name."""
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
