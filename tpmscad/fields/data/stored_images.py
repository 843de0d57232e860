"""Images as files hold them, and what the readers of the formats share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest

POSITION_TOL_SPACINGS = 1e-2
"""In spacings: differences of positions that rounding in a file explains."""

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "µm": 1e-3, "nm": 1e-6, "in": 25.4, "inch": 25.4}
MILLIMETRES |= {"meter": 1e3, "millimeter": 1.0, "micron": 1e-3, "micrometer": 1e-3}
"""Units of length of image files, in mm."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredImage:
    """Samples as a file holds them, and what it states.

    `values` are (nx, ny, nz), or (nx, ny, nz, n) of n volumes. `affine` (4, 4) takes indices to positions, None without
    positions; `frame` is the name of a frame of the patient, or what else the file calls its coordinates, or empty; `unit` the
    unit of length or empty. `is_chosen`: the reader has read the volume that was asked for, and no other.
    """

    values: Array
    affine: Array | None = None
    frame: str = ""
    unit: str = ""
    centred: bool | None = None
    notes: tuple[str, ...] = ()
    is_chosen: bool = False


@dataclass(frozen=True, slots=True)
class ImageChoice:
    """Which of the things that a file holds is meant; None where it holds one."""

    centred: bool | None = None
    array_name: str | None = None
    volume: int | None = None


def select_name(file_name: str, names: Sequence[str], wanted: str | None) -> str:
    """The name that is wanted, or the only one; InvalidRequest lists them if it is not among them, or they are several."""
    listed = ", ".join(map(repr, names))
    if wanted is not None and wanted not in names:
        raise InvalidRequest(f"{file_name} holds no array {wanted!r}: its arrays are {listed or 'none'}")
    if wanted is None and len(names) != 1:
        raise InvalidRequest(
            f"{file_name} holds {len(names)} arrays, {listed}: name one of them, array_name={names[0]!r}"
            if names
            else f"{file_name} holds no array of numbers in three dimensions"
        )
    return wanted or names[0]


def select_volume(file_name: str, count: int, wanted: int | None, kind: str = "volumes") -> int:
    """The number of the volume that is wanted, or of the only one; InvalidRequest tells how many there are."""
    if wanted is None and count > 1:
        raise InvalidRequest(f"{file_name} holds {count} {kind}: choose one, volume=0 to {count - 1}")
    number = wanted or 0
    if not 0 <= number < count:
        holds = f"{count} {kind}, 0 to {count - 1}" if count > 1 else "one volume: leave `volume` out"
        raise InvalidRequest(f"volume {number}: {file_name} holds {holds}")
    return number
