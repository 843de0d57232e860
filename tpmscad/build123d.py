"""Lattices and filled parts in build123d, for builder and algebra mode: `from tpmscad.build123d import Tpms, TpmsInfill`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Self

from build123d import Align, BasePartObject, BuildPart, Compound, Location, Mode, Part, RotationLike, Vector
from build123d.build_common import Builder
from build123d.geometry import to_align_offset

from tpmscad.errors import InvalidRequest
from tpmscad.workflows import infill, lattice
from tpmscad.workflows.lattice_request import lattice_size

__all__ = ["Tpms", "TpmsInfill"]


class Tpms(BasePartObject):
    """A lattice of a minimal surface as a part.

    Takes the keywords of `tpmscad.lattice`, kept as attributes, and rotation, align and mode as every part object does.
    What is aligned is the box of `cells` x `cell` that the lattice fills, or that `map` makes of it; the kernel's bounding
    box of B-splines is larger than the shape. align=None leaves the lattice where `tpmscad.lattice` puts it.

    `certificate` holds what was measured; look at `certificate.met`. `model` is the lattice before align and rotation.
    InvalidRequest names what can't be had and what would do.
    """

    def __init__(
        self,
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
        rotation: RotationLike = (0, 0, 0),
        align: Align | tuple[Align, Align, Align] | None = Align.CENTER,
        mode: Mode = Mode.ADD,
    ) -> None:
        if map is not None and boundary == "natural" and align is not None:
            raise InvalidRequest("a mapped lattice of natural boundary fills no box to align: give align=None")
        self.surface = surface
        self.cell = cell
        self.cells = cells
        self.thickness = thickness
        self.offset = offset
        self.volume_fraction = volume_fraction
        self.kind = kind
        self.side = side
        self.reference = reference
        self.boundary = boundary
        self.phase = phase
        self.map = map
        self.tol = tol
        self.align = align
        self.model = lattice(
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
        self.certificate = self.model.certificate
        if map is None:
            low, high = (0.0, 0.0, 0.0), lattice_size(cell, cells)
        else:  # the caps lie in the planes of the box, and so do their vertices
            low, high = (tuple(f(self.model.patches.vertices[:, k]) for k in range(3)) for f in (min, max))
        part = self.model.solid
        part.label = self.model.name
        part.move(Location(to_align_offset(Vector(low), Vector(high), align)))
        super().__init__(part, rotation=rotation, align=None, mode=mode)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy of the part, as build123d makes of everything it moves; what was made and measured once is shared."""
        for shared in (self.model, self.certificate, self.map):
            memo[id(shared)] = shared
        return super().__deepcopy__(memo)


class TpmsInfill(Part):
    """A part filled with a lattice: `TpmsInfill(surface, ...)` the part being built, `TpmsInfill(body, surface, ...)` a shape.

    Takes the keywords of `tpmscad.infill`, kept as attributes; rotation turns the lattice, not the part. In a builder the result
    replaces the part unless mode says otherwise.

    `certificate` holds what was measured; look at `certificate.met`. `model` is what `tpmscad.infill` returned.
    InvalidRequest names what can't be had and what would do.
    """

    def __init__(
        self,
        *body_and_surface: Any,
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
        open_faces: Iterable[Any] = (),
        tol: float | None = None,
        progress: Callable[[str, float], None] | None = None,
        mode: Mode = Mode.REPLACE,
    ) -> None:
        context: Builder | None = Builder._get_context("TpmsInfill")
        if not 1 <= len(body_and_surface) <= 2:
            raise InvalidRequest(
                f"TpmsInfill takes a surface, or a body and a surface, and keywords; not {len(body_and_surface)} values"
            )
        *given, surface = body_and_surface
        if context is not None and not isinstance(context, BuildPart):
            raise RuntimeError(f"{type(context).__name__} has no solids to fill: TpmsInfill applies to BuildPart")
        body = given[0] if given else context and context._obj
        if body is None:
            raise InvalidRequest("there is no part to fill: build one first, or give the shape before the surface")
        self.surface = surface
        self.cell = cell
        self.thickness = thickness
        self.offset = offset
        self.volume_fraction = volume_fraction
        self.kind = kind
        self.side = side
        self.reference = reference
        self.phase = phase
        self.rotation = rotation
        self.skin = skin
        self.open_faces = tuple(open_faces)
        self.tol = tol
        self.mode = mode
        self.model = infill(
            body,
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
            open_faces=self.open_faces,
            tol=tol,
            progress=progress,
        )
        self.certificate = self.model.certificate
        solids = self.model.solid.solids()
        super().__init__(obj=Compound(solids).wrapped, label=self.model.name)
        if context is not None:
            # Merging faces that lie on one surface ("clean") would look at every pair of thousands, and find none.
            context._add_to_context(*solids, mode=mode, clean=False)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy of the part, as build123d makes of everything it moves; what was made and measured once is shared."""
        for shared in (self.model, self.certificate, self.surface, self.open_faces):
            memo[id(shared)] = shared
        return super().__deepcopy__(memo)
