"""Periodic fields and the porous structures cut from them, as tables of a recipe.

kind = "rod", surface = "gyroid", period = 10, level = -0.3      # or `of = FIELD` instead of surface, period and phase
kind = "sheet", surface = "schwarz_p", period = 5, levels = [-0.2, { kind = "ramp", ... }]
"""

from __future__ import annotations

import numpy as np

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field
from tpmscad.recipe.field_kind import FieldKind, ReadField, make_kind, read_cell_edges, read_triple
from tpmscad.recipe.image_masks import read_numpy_array
from tpmscad.recipe.toml_entry import Entry

SURFACE_KEYS = "surface period phase"
"""The keys of a periodic surface that is given in place."""


def read_tpms(entry: Entry, read: ReadField) -> Field:
    """The nodal field of a surface of the catalogue."""
    name = entry["surface"].string()
    try:
        fields.find_surface(name)
    except InvalidRequest as error:
        raise entry["surface"].error(str(error)) from error
    phase = entry.get("phase")
    return fields.tpms(name, read_cell_edges(entry["period"]), (0.0, 0.0, 0.0) if phase is None else read_triple(phase))


def read_bspline_unit(entry: Entry, read: ReadField) -> Field:
    """The periodic B-spline unit of given coefficients (nested arrays or a .npy file), or of random ones from a seed."""
    given = [key for key in ("coefficients", "file", "seed") if key in entry.value]
    if len(given) != 1:
        raise entry.error(f"give exactly one of coefficients, file and seed, not {' and '.join(given) or 'none'}")
    source = entry[given[0]]
    if given[0] == "seed":
        count = [item.integer() for item in entry["count"].array_of_length(3, "whole numbers")]
        coefficients = np.random.default_rng(source.integer(0)).normal(size=count)
    elif "count" in entry.value:
        raise entry["count"].error("is for units made from a seed")
    else:
        coefficients = read_numpy_array(source) if given[0] == "file" else _read_nested_array(source)
    return fields.bspline_unit(coefficients, read_cell_edges(entry["period"]))


def read_rod(entry: Entry, read: ReadField) -> Field:
    """The solid {field < level}."""
    phi = _read_base_field(entry, read)
    return fields.rod(phi, _read_level(entry, read, phi, "rod"))


def read_pore(entry: Entry, read: ReadField) -> Field:
    """The solid {field > level}."""
    phi = _read_base_field(entry, read)
    return fields.pore(phi, _read_level(entry, read, phi, "pore"))


def read_sheet(entry: Entry, read: ReadField) -> Field:
    """The solid between two levels."""
    phi = _read_base_field(entry, read)
    if _uses_volume_fraction(entry, "levels"):
        low, high = _solve_threshold(entry["volume_fraction"], phi, "sheet")  # type: ignore[misc]
        return fields.sheet(phi, low, high)
    first, second = entry["levels"].array_of_length(2, "levels, the lower one first")
    return fields.sheet(phi, read(first), read(second))


def read_cell_sizes(entry: Entry, read: ReadField) -> Field:
    """A periodic field whose cell size changes along the axes."""
    sizes = {}
    for axis in "xyz":
        if (part := entry.get(axis)) is not None:
            part.table("at", "sizes")
            sizes[axis] = [item.number() for item in part["at"].items()], [s.positive() for s in part["sizes"].items()]
    return fields.cell_sizes(_read_base_field(entry, read), **sizes)


def _read_base_field(entry: Entry, read: ReadField) -> Field:
    """The field to be thresholded: `of`, or a surface of the catalogue that is given in place."""
    inner = entry.get("of")
    if inner is None:
        return read_tpms(entry, read)
    for key in SURFACE_KEYS.split():
        if key in entry.value:
            raise entry[key].error("give either `of` or a surface with its period and phase, not both")
    return read(inner)


def _uses_volume_fraction(entry: Entry, other: str) -> bool:
    """Whether the level follows from `volume_fraction`; RecipeError if the table has `other`, too."""
    if "volume_fraction" in entry.value and other in entry.value:
        raise entry["volume_fraction"].error(f"give either volume_fraction or {other}, not both")
    return "volume_fraction" in entry.value


def _read_level(entry: Entry, read: ReadField, phi: Field, what: str) -> Field | float:
    """The level of a rod or a pore: a field, or the number that gives the volume fraction."""
    if _uses_volume_fraction(entry, "level"):
        return _solve_threshold(entry["volume_fraction"], phi, what)  # type: ignore[return-value]
    return read(entry["level"])


def _solve_threshold(entry: Entry, phi: Field, what: str) -> float | tuple[float, float]:
    """The level, or the pair of levels of a sheet, that gives the volume fraction of an entry."""
    fraction = entry.number()
    if not 0 < fraction < 1:
        raise entry.error(f"{fraction:g} must be between 0 and 1")
    return fields.threshold_for(phi, fraction, what)


def _read_nested_array(entry: Entry) -> np.ndarray:
    """The array (nx, ny, nz) of an entry of nested arrays."""
    planes = [[[number.number() for number in row.items()] for row in plane.items()] for plane in entry.items()]
    try:
        return np.array(planes, float)
    except ValueError:
        raise entry.error("must be an array of arrays of arrays of one length each") from None


PERIODIC_KINDS = {
    "tpms": make_kind(SURFACE_KEYS, read_tpms),
    "bspline": make_kind("coefficients file seed count period", read_bspline_unit),
    "cell_sizes": make_kind(f"of {SURFACE_KEYS} x y z", read_cell_sizes),
}
STRUCTURE_KINDS: dict[str, FieldKind] = {
    "rod": make_kind(f"of {SURFACE_KEYS} level volume_fraction", read_rod),
    "pore": make_kind(f"of {SURFACE_KEYS} level volume_fraction", read_pore),
    "sheet": make_kind(f"of {SURFACE_KEYS} levels volume_fraction", read_sheet),
}
