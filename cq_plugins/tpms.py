"""Lattices on the CadQuery stack: `import cq_plugins.tpms` gives every Workplane the method `tpms`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import cadquery as cq

from tpmscad.errors import InvalidRequest, NotMet
from tpmscad.workflows import lattice


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
    reference: str = "minimal",
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
    if not model.certificate.met:
        raise NotMet(
            f"the {model.name} misses the request: {'; '.join(model.certificate.shortfalls)}", model.certificate
        )
    size = (n * edge for n, edge in zip(_triple(cells), _triple(cell), strict=True))
    shift = (-length / 2 if half else 0.0 for length, half in zip(size, middle, strict=True))
    shape = cq.Shape.cast(model.built.shape).move(cq.Location(cq.Vector(*shift)))
    return self.eachpoint(shape, True, combine, clean and bool(combine))


def _triple(value: Any) -> tuple[float, float, float]:
    """One number for each axis."""
    try:
        x, y, z = value
    except TypeError:
        x = y = z = value
    return float(x), float(y), float(z)


def _register() -> None:
    """Make `tpms` a method of Workplane; ImportError if some other plug-in has taken the name."""
    taken = getattr(cq.Workplane, "tpms", tpms)
    if taken.__module__ != __name__:
        raise ImportError(
            f"cadquery.Workplane already has a method tpms, from {taken.__module__}: import only one of the two"
        )
    cq.Workplane.tpms = tpms


_register()
