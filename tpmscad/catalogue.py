"""The catalogue of triply periodic surfaces: names, formulas, symmetry, genus and sources, each stated once.

A surface has one nodal formula, a trigonometric polynomial in x = 2 pi X / period, y = 2 pi Y / period and z = 2 pi Z / period
whose zero set approximates the minimal surface of the same name; negative values are solid. It is written in the language of
`fields.expression`. The rooms `fields` and `surfaces` take the data they need from here: the fields evaluate the formula, and the
surfaces construct primitive patches.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType
from typing import Annotated

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import RECORD, TEXT
from tpmscad.errors import InvalidRequest

CORES = ("honeycomb", "square", "triangular", "re-entrant")
"""Cores of sandwich panels, which `infill` takes by name as it does surfaces."""

MAX_SUGGESTIONS = 3
"""Greatest number of similar names in the message about an unknown surface."""

Phase = tuple[float, float, float]
"""Shift of a lattice along x, y and z, in cells."""


@dataclass(frozen=True, slots=True)
class OnePiecePhases:
    """Phases at which a lattice in a box of whole cells is one connected piece, at every offset that the surface allows.

    One cell in one piece makes a block of cells one piece, since neighbours share the solid in their common face. Where the
    endless solid itself falls apart, as thin solids between levels do (`fields/kinds/one_piece_ranges.py`), no phase joins it.

    - `sheet`, `minus`, `plus`: phases of the sheet and of the skeletal solids on the sides "-" and "+".
    - `skeletal_chips`: whether chips below 1 % of the solid remain at some offsets of the skeletal solids, because no phase is
      free of them; `tpmscad.lattice` leaves them out and says so.
    """

    sheet: Phase = (0.0, 0.0, 0.0)
    minus: Phase = (0.0, 0.0, 0.0)
    plus: Phase = (0.0, 0.0, 0.0)
    skeletal_chips: bool = False

    def phase_of(self, kind: str = "sheet", side: str = "-") -> Phase:
        """The phase of a kind, "sheet" or "skeletal", and of the solid side of a skeletal lattice."""
        return self.sheet if kind == "sheet" else self.minus if side == "-" else self.plus


_SYMMETRY_PLANES = OnePiecePhases()
"""The faces of the box lie in mirror planes, where they cut nothing off."""


@dataclass(frozen=True, slots=True)
class SurfaceRecord:
    """The data of one triply periodic surface.

    - `name`: the key; `title`: the printed name; `aliases`: further accepted names.
    - `formula`: the nodal function f(x, y, z); {f < 0} is solid.
    - `space_group`: the symmetries that preserve the two sides of the surface. `full_space_group` may exchange the sides; the
      cubic cell is the same unless the text states another edge.
    - `genus`: genus of the nodal surface in the quotient by the primitive lattice of `space_group`.
    - `value_range`: minimum and maximum of f, found by minimisation from the extreme samples of a 128^3 grid, to 1e-12.
    - `patches_per_cell`: number of primitive patches in the cubic cell; 0 if they are fitted to a mesh of one period.
    - `references`: surfaces that fields and lattices are made of, the default first: "nodal" (the level set f = 0), "minimal"
      (mean curvature zero: exact for lattices of exact primitives, else the series of `tpmscad.minimal_series`).
    - `primitives`: "exact" for patches of the minimal surface or its nodal counterpart, "mirrored" for pieces of a level set
      bounded by mirror planes, "level set" for patches fitted to a level set of one period.
    - `source`: origin of the surface; `formula_source`: publication of the formula.
    - `one_piece`: the phases that lattices in a box have unless another is asked for.
    """

    name: str
    title: str
    aliases: tuple[str, ...]
    formula: str
    space_group: str
    full_space_group: str
    genus: int
    value_range: tuple[float, float]
    patches_per_cell: int
    references: tuple[str, ...]
    primitives: str
    source: str
    formula_source: str
    one_piece: OnePiecePhases = _SYMMETRY_PLANES


_WEIERSTRASS = "Enneper-Weierstrass with R = (tau^8 - 14 tau^4 + 1)^(-1/2), Bonnet angle"
_SCHWARZ = "H. A. Schwarz (1865)"
_SCHOEN = "A. H. Schoen, NASA TN D-5541 (1970)"
_NESPER = "H. G. von Schnering, R. Nesper, Z. Phys. B 83 (1991) 407"
_MINISURF = "M.-T. Hsieh, L. Valdevit, Software Impacts 6 (2020) 100026"
_WOHLGEMUTH = "M. Wohlgemuth, N. Yufa, J. Hoffman, E. L. Thomas, Macromolecules 34 (2001) 6083"

_RECORDS = (
    SurfaceRecord(
        name="gyroid",
        title="Gyroid",
        aliases=("G", "schoen gyroid"),
        formula="sin(x)*cos(y) + sin(y)*cos(z) + sin(z)*cos(x)",
        space_group="I4_132 (214)",
        full_space_group="Ia-3d (230)",
        genus=3,
        value_range=(-1.5, 1.5),
        patches_per_cell=24,
        references=("minimal", "nodal"),
        primitives="exact",
        source=f"{_SCHOEN}; {_WEIERSTRASS} arccot(K'/K) = 38.0147740 degrees",
        formula_source=_NESPER,
        one_piece=OnePiecePhases(
            (0.27, 0.385, 0.48), (1 / 48, 5 / 48, 43 / 48), (47 / 48, 43 / 48, 5 / 48), skeletal_chips=True
        ),
    ),
    SurfaceRecord(
        name="diamond",
        title="Diamond",
        aliases=("D", "schwarz d", "schwarz diamond"),
        formula="sin(x)*(sin(y)*sin(z) + cos(y)*cos(z)) + cos(x)*(sin(y)*cos(z) + cos(y)*sin(z))",
        space_group="Fd-3m (227)",
        full_space_group="Pn-3m (224), cell edge 1/2",
        genus=3,
        value_range=(-math.sqrt(2), math.sqrt(2)),
        patches_per_cell=48,
        references=("minimal", "nodal"),
        primitives="exact",
        source=f"{_SCHWARZ}; {_WEIERSTRASS} 0",
        formula_source=_NESPER,
        one_piece=OnePiecePhases((0.0625, 0.128, 0.378), (0.0625, 0.128, 0.378), (0.9375, 0.872, 0.622)),
    ),
    SurfaceRecord(
        name="schwarz_p",
        title="Schwarz P",
        aliases=("P", "primitive", "schwarz primitive"),
        formula="cos(x) + cos(y) + cos(z)",
        space_group="Pm-3m (221)",
        full_space_group="Im-3m (229)",
        genus=3,
        value_range=(-3.0, 3.0),
        patches_per_cell=12,
        references=("minimal", "nodal"),
        primitives="exact",
        source=f"{_SCHWARZ}; {_WEIERSTRASS} 90 degrees",
        formula_source=_NESPER,
    ),
    SurfaceRecord(
        name="iwp",
        title="I-WP",
        aliases=("wrapped package", "schoen iwp"),
        formula="2*(cos(x)*cos(y) + cos(y)*cos(z) + cos(z)*cos(x)) - (cos(2*x) + cos(2*y) + cos(2*z))",
        space_group="Im-3m (229)",
        full_space_group="Im-3m (229)",
        genus=4,
        value_range=(-5.0, 3.0),
        patches_per_cell=48,
        references=("nodal", "minimal"),
        primitives="mirrored",
        source=_SCHOEN,
        formula_source=_NESPER,
    ),
    SurfaceRecord(
        name="neovius",
        title="Neovius",
        aliases=("C(P)", "neovius c(p)"),
        formula="3*(cos(x) + cos(y) + cos(z)) + 4*cos(x)*cos(y)*cos(z)",
        space_group="Pm-3m (221)",
        full_space_group="Im-3m (229)",
        genus=9,
        value_range=(-13.0, 13.0),
        patches_per_cell=48,
        references=("nodal", "minimal"),
        primitives="mirrored",
        source="E. R. Neovius (1883)",
        formula_source=_NESPER,
    ),
    SurfaceRecord(
        name="frd",
        title="F-RD",
        aliases=("schoen frd",),
        formula="4*cos(x)*cos(y)*cos(z) - (cos(2*x)*cos(2*y) + cos(2*y)*cos(2*z) + cos(2*z)*cos(2*x))",
        space_group="Fm-3m (225)",
        full_space_group="Fm-3m (225)",
        genus=6,
        value_range=(-7.0, 2.0),
        patches_per_cell=96,
        references=("nodal", "minimal"),
        primitives="mirrored",
        source=_SCHOEN,
        formula_source=_NESPER,
    ),
    SurfaceRecord(
        name="lidinoid",
        title="Lidinoid",
        aliases=("L", "lidin"),
        formula=(
            "0.5*(sin(2*x)*cos(y)*sin(z) + sin(2*y)*cos(z)*sin(x) + sin(2*z)*cos(x)*sin(y))"
            " - 0.5*(cos(2*x)*cos(2*y) + cos(2*y)*cos(2*z) + cos(2*z)*cos(2*x)) + 0.15"
        ),
        space_group="Ia-3d (230)",
        full_space_group="Ia-3d (230)",
        genus=17,
        value_range=(-1.35, 1.15),
        patches_per_cell=0,
        references=("nodal",),
        primitives="level set",
        source="S. Lidin, S. Larsson, J. Chem. Soc. Faraday Trans. 86 (1990) 769",
        formula_source=_MINISURF,
        one_piece=OnePiecePhases((0.0, 0.0, 0.25), (0.0, 0.0, 0.25), (0.0, 0.0, 0.25)),
    ),
    SurfaceRecord(
        name="split_p",
        title="Split P",
        aliases=("SP",),
        formula=(
            "1.1*(sin(2*x)*cos(y)*sin(z) + sin(2*y)*cos(z)*sin(x) + sin(2*z)*cos(x)*sin(y))"
            " - 0.2*(cos(2*x)*cos(2*y) + cos(2*y)*cos(2*z) + cos(2*z)*cos(2*x)) - 0.4*(cos(2*x) + cos(2*y) + cos(2*z))"
        ),
        space_group="Ia-3 (206)",
        full_space_group="Ia-3 (206)",
        genus=9,
        value_range=(-1.8, 1.81),
        patches_per_cell=0,
        references=("nodal",),
        primitives="level set",
        source=_WOHLGEMUTH,
        formula_source=_WOHLGEMUTH,
        one_piece=OnePiecePhases(minus=(0.0, 0.0, 0.25)),
    ),
    SurfaceRecord(
        name="fischer_koch_s",
        title="Fischer-Koch S",
        aliases=("S", "FKS", "koch s"),
        formula="cos(2*x)*sin(y)*cos(z) + cos(x)*cos(2*y)*sin(z) + sin(x)*cos(y)*cos(2*z)",
        space_group="I-43d (220)",
        full_space_group="Ia-3d (230)",
        genus=11,
        value_range=(-math.sqrt(2), math.sqrt(2)),
        patches_per_cell=0,
        references=("nodal", "minimal"),
        primitives="level set",
        source="W. Fischer, E. Koch, Acta Cryst. A 43 (1987) 559",
        formula_source=_NESPER,
        one_piece=OnePiecePhases((0.0, 0.0, 0.25), (0.0, 0.0, 0.75), (0.0, 0.0, 0.25)),
    ),
    SurfaceRecord(
        name="octo",
        title="O,C-TO",
        aliases=("schoen octo", "schoen o,c-to"),
        formula="0.6*(cos(x)*cos(y) + cos(y)*cos(z) + cos(z)*cos(x)) - 0.4*(cos(x) + cos(y) + cos(z)) + 0.25",
        space_group="Pm-3m (221)",
        full_space_group="Pm-3m (221)",
        genus=10,
        value_range=(-0.75, 3.25),
        patches_per_cell=0,
        references=("nodal",),
        primitives="level set",
        source=_SCHOEN,
        formula_source=_MINISURF,
    ),
)

CATALOGUE: Mapping[str, SurfaceRecord] = MappingProxyType({record.name: record for record in _RECORDS})
"""All surfaces by name."""


def _normalise_name(name: str) -> str:
    """Lower-case letters and digits of a name."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


_RECORD_OF_SPELLING: Mapping[str, SurfaceRecord] = MappingProxyType(
    {
        _normalise_name(spelling): record
        for record in _RECORDS
        for spelling in (record.name, record.title, *record.aliases)
    }
)


@validate_call()
def find_surface(
    name: Annotated[str, TEXT, "Name, title or alias; case, spaces and punctuation are ignored."],
) -> SurfaceRecord:
    """Return the record of the surface with a name, title or alias.

    Returns
    -------
    SurfaceRecord
        The record, the same object for every spelling.

    Raises
    ------
    InvalidRequest
        If no surface has this name. The message suggests similar names and lists all of them.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> surfaces.find_surface("Schwarz P").name
    'schwarz_p'
    """
    key = _normalise_name(str(name))
    if key in _RECORD_OF_SPELLING:
        return _RECORD_OF_SPELLING[key]
    matches = get_close_matches(key, _RECORD_OF_SPELLING, n=MAX_SUGGESTIONS)
    similar = dict.fromkeys(repr(_RECORD_OF_SPELLING[match].name) for match in matches)
    hint = f"did you mean {' or '.join(similar)}? " if similar else ""
    raise InvalidRequest(f"unknown surface {name!r}: {hint}choose one of {', '.join(CATALOGUE)}")


@validate_call()
def check_reference(
    record: Annotated[SurfaceRecord, RECORD, "The surface."],
    reference: Annotated[str, TEXT.described_as(example='"nodal"'), '"minimal" or "nodal".'],
) -> None:
    """Raise InvalidRequest unless fields and lattices of a surface can have a reference.

    Raises
    ------
    InvalidRequest
        If `reference` is not among `record.references`. The message names the alternatives, and why there is no minimal one.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> surfaces.check_reference(surfaces.find_surface("gyroid"), "minimal")
    """
    if reference in record.references:
        return
    choices = ", ".join(record.references)
    if reference == "minimal":
        raise InvalidRequest(
            f"reference 'minimal' of the {record.name} does not exist: no minimal surface with the symmetry of the "
            f"{record.title} lies near its nodal surface; choose {choices}, or another surface"
        )
    raise InvalidRequest(f"reference {reference!r} of the {record.name} is unknown; choose one of {choices}")


def check_matter_name(name: str) -> None:
    """InvalidRequest for a name of no surface, core, file of beams or recipe, with those there are."""
    if name in CORES or name.lower().endswith((".3mf", ".toml")):
        return
    try:
        find_surface(name)
    except InvalidRequest as error:
        raise InvalidRequest(
            f"{error}; or a core, {', '.join(CORES)}, a .3mf file of beams, or a .toml recipe"
        ) from None
