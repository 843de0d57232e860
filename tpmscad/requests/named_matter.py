"""Names as the matter of an infill that are of no surface: cores, and files of beams, as the fields that they stand for."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from tpmscad.catalogue import CORES, check_matter_name
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.beam_files import is_beam_path
from tpmscad.fields.kinds.beam_lattices import beams
from tpmscad.fields.kinds.cores import CoreField, core, thickness_of_fraction
from tpmscad.requests.lattice_options import InfillOptions
from tpmscad.requests.lattice_request import DEFAULT_TOL_CELLS, OPTIONS_OF_FIELDS, rotation_matrix

T = TypeVar("T", bound=InfillOptions)

SIZES = ("thickness", "volume_fraction", "porosity")
"""Keywords of which exactly one defines the walls of a core."""


def resolve_named_matter(options: T) -> T:
    """The same options with the field of a core, or of a file of beams, in place of its name; those of other matter as they are.

    A core is turned by `rotation` and shifted by `phase` as a lattice is. InvalidRequest for what it does not take, and for an
    unknown name.
    """
    if not isinstance(options.surface, str):
        return options
    if is_beam_path(options.surface):
        return replace(options, surface=beams(options.surface))
    if options.surface not in CORES:
        check_matter_name(options.surface)
        return options
    taken = {*OPTIONS_OF_FIELDS, "cell", "rotation", "phase", *SIZES}
    defaults: dict[str, Any] = {
        field.name: field.default for field in fields(InfillOptions) if field.name not in OPTIONS_OF_FIELDS
    }
    extra = [name for name, default in defaults.items() if name not in taken and getattr(options, name) != default]
    if extra:
        raise InvalidRequest(f"a {options.surface} core takes no {', '.join(extra)}: leave it out")
    made = _make_core(options)
    tol = DEFAULT_TOL_CELLS * made.cell if options.tol is None else options.tol
    return replace(options, **defaults, surface=made, tol=tol)


def _make_core(options: InfillOptions) -> CoreField:
    """The core in the body's coordinates."""
    name = str(options.surface)
    if not isinstance(options.cell, float | int):
        raise InvalidRequest(f"a {name} core needs cell=, one number: got {options.cell}")
    given = {size: getattr(options, size) for size in SIZES if getattr(options, size) is not None}
    if len(given) != 1:
        raise InvalidRequest(f"a {name} core needs exactly one of {', '.join(SIZES)}: got {', '.join(given) or 'none'}")
    (size, value), cell = next(iter(given.items())), float(options.cell)
    if not isinstance(value, float | int):
        raise InvalidRequest(f"{size} of a {name} core is one number, as its walls are planes: got {value}")
    if size == "thickness":
        thickness = float(value)
    else:
        thickness = thickness_of_fraction(name, cell, value if size == "volume_fraction" else 1 - value)
    made = core(name, cell, thickness)
    shift = cell * np.array(options.phase or (0.0, 0.0, 0.0), float)
    return made.move(np.eye(3), -shift, 1.0).move(rotation_matrix(options.rotation).T, np.zeros(3), 1.0)
