"""Periodic fields and the porous structures cut from them, as tables of a recipe.

kind = "rod", surface = "gyroid", period = 10, level = -0.3      # or `of`, a field, instead of surface, period, phase
kind = "sheet", surface = "schwarz_p", period = 5, levels = [-0.2, { kind = "ramp", ... }]
"""

from __future__ import annotations

import numpy as np

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field
from tpmscad.recipe.entry import Entry
from tpmscad.recipe.kind import Kind, Read, edges, kind, triple
from tpmscad.recipe.pictures import numpy_array

SURFACE = "surface period phase"


def tpms(entry: Entry, read: Read) -> Field:
    name = entry["surface"].text()
    try:
        fields.find(name)
    except InvalidRequest as error:
        raise entry["surface"].error(str(error)) from error
    phase = entry.get("phase")
    return fields.tpms(name, edges(entry["period"]), (0.0, 0.0, 0.0) if phase is None else triple(phase))


def bspline(entry: Entry, read: Read) -> Field:
    """The unit of given coefficients (arrays in arrays, or a .npy file), or of normally distributed ones from a seed."""
    given = [key for key in ("coefficients", "file", "seed") if key in entry.value]
    if len(given) != 1:
        raise entry.error(f"give exactly one of coefficients, file and seed, not {' and '.join(given) or 'none'}")
    source = entry[given[0]]
    if given[0] == "seed":
        count = [item.whole() for item in entry["count"].several(3, "whole numbers")]
        coefficients = np.random.default_rng(source.whole(0)).normal(size=count)
    elif "count" in entry.value:
        raise entry["count"].error("is for units made from a seed")
    else:
        coefficients = numpy_array(source) if given[0] == "file" else _nested(source)
    return fields.bspline_unit(coefficients, edges(entry["period"]))


def rod(entry: Entry, read: Read) -> Field:
    phi = _base(entry, read)
    return fields.rod(phi, _level(entry, read, phi, "rod"))


def pore(entry: Entry, read: Read) -> Field:
    phi = _base(entry, read)
    return fields.pore(phi, _level(entry, read, phi, "pore"))


def sheet(entry: Entry, read: Read) -> Field:
    phi = _base(entry, read)
    if _by_fraction(entry, "levels"):
        low, high = _solved(entry["volume_fraction"], phi, "sheet")  # type: ignore[misc]
        return fields.sheet(phi, low, high)
    first, second = entry["levels"].several(2, "levels, the lower one first")
    return fields.sheet(phi, read(first), read(second))


def cell_sizes(entry: Entry, read: Read) -> Field:
    sizes = {}
    for axis in "xyz":
        if (part := entry.get(axis)) is not None:
            part.table("at", "sizes")
            sizes[axis] = [item.number() for item in part["at"].items()], [s.positive() for s in part["sizes"].items()]
    return fields.cell_sizes(_base(entry, read), **sizes)


def _base(entry: Entry, read: Read) -> Field:
    """The field that is cut: `of`, or a surface of the catalogue given in place."""
    inner = entry.get("of")
    if inner is None:
        return tpms(entry, read)
    for key in SURFACE.split():
        if key in entry.value:
            raise entry[key].error("give either `of` or a surface with its period and phase, not both")
    return read(inner)


def _by_fraction(entry: Entry, other: str) -> bool:
    if "volume_fraction" in entry.value and other in entry.value:
        raise entry["volume_fraction"].error(f"give either volume_fraction or {other}, not both")
    return "volume_fraction" in entry.value


def _level(entry: Entry, read: Read, phi: Field, what: str) -> Field | float:
    if _by_fraction(entry, "level"):
        return _solved(entry["volume_fraction"], phi, what)  # type: ignore[return-value]
    return read(entry["level"])


def _solved(entry: Entry, phi: Field, what: str) -> float | tuple[float, float]:
    fraction = entry.number()
    if not 0 < fraction < 1:
        raise entry.error(f"{fraction:g} must be between 0 and 1")
    return fields.threshold_for(phi, fraction, what)


def _nested(entry: Entry) -> np.ndarray:
    planes = [[[number.number() for number in row.items()] for row in plane.items()] for plane in entry.items()]
    try:
        return np.array(planes, float)
    except ValueError:
        raise entry.error("must be an array of arrays of arrays of one length each") from None


PERIODIC = {
    "tpms": kind(SURFACE, tpms),
    "bspline": kind("coefficients file seed count period", bspline),
    "cell_sizes": kind(f"of {SURFACE} x y z", cell_sizes),
}
STRUCTURES: dict[str, Kind] = {
    "rod": kind(f"of {SURFACE} level volume_fraction", rod),
    "pore": kind(f"of {SURFACE} level volume_fraction", pore),
    "sheet": kind(f"of {SURFACE} levels volume_fraction", sheet),
}
