"""Lattices as build123d part objects, for builder and algebra mode: `from tpmscad.build123d import Tpms`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Self

from build123d import Align, BasePartObject, Location, Mode, RotationLike, Vector
from build123d.geometry import to_align_offset

from tpmscad.errors import InvalidRequest
from tpmscad.workflows import lattice

__all__ = ["Tpms"]


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
        reference: str = "minimal",
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
            low, high = (0.0, 0.0, 0.0), tuple(n * edge for n, edge in zip(_triple(cells), _triple(cell), strict=True))
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


def _triple(value: Any) -> tuple[float, float, float]:
    """One number for each axis."""
    try:
        x, y, z = value
    except TypeError:
        x = y = z = value
    return float(x), float(y), float(z)
