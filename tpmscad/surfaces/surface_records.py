"""The catalogue: what is known of each surface before anything is computed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType

from tpmscad.errors import InvalidRequest


@dataclass(frozen=True, slots=True)
class SurfaceInfo:
    """A triply periodic minimal surface and its nodal namesake.

    `formula` is the nodal function with x = 2 pi X / cell. `space_group` keeps the two sides of the surface, `full_space_group`
    may swap them; the two have the same cubic cell except where `full_space_group` says so. `genus` is that of the nodal surface
    modulo the primitive lattice of `space_group`, `patches_per_cell` counts in the cubic cell, 0 where there are none.

    `primitives` says what lattices are made of: "exact" patches of the minimal surface or its nodal namesake, "mirrored"
    pieces of the nodal surface, or None: `solidify` makes solids of the formula.
    """

    name: str
    title: str
    aliases: tuple[str, ...]
    formula: str
    space_group: str
    full_space_group: str
    genus: int
    patches_per_cell: int
    references: tuple[str, ...]
    primitives: str | None
    source: str


_WEIERSTRASS = "Enneper-Weierstrass with R = (tau^8 - 14 tau^4 + 1)^(-1/2), Bonnet angle "
_NESPER = "formula as in H. G. von Schnering, R. Nesper, Z. Phys. B 83 (1991) 407"
_MINISURF = "formula as in M.-T. Hsieh, L. Valdevit, Software Impacts 6 (2020) 100026"
_SCHOEN = "A. H. Schoen, NASA TN D-5541 (1970)"

CATALOGUE: Mapping[str, SurfaceInfo] = MappingProxyType(
    {
        info.name: info
        for info in (
            SurfaceInfo(
                name="gyroid",
                title="Gyroid",
                aliases=("G", "schoen gyroid"),
                formula="sin x cos y + sin y cos z + sin z cos x",
                space_group="I4_132 (214)",
                full_space_group="Ia-3d (230)",
                genus=3,
                patches_per_cell=24,
                references=("minimal", "nodal"),
                primitives="exact",
                source=_WEIERSTRASS + "arccot(K'/K) = 38.0147740 degrees; A. H. Schoen, NASA TN D-5541 (1970)",
            ),
            SurfaceInfo(
                name="diamond",
                title="Diamond",
                aliases=("D", "schwarz d", "schwarz diamond"),
                formula="sin x sin y sin z + sin x cos y cos z + cos x sin y cos z + cos x cos y sin z",
                space_group="Fd-3m (227)",
                full_space_group="Pn-3m (224), cell edge 1/2",
                genus=3,
                patches_per_cell=48,
                references=("minimal", "nodal"),
                primitives="exact",
                source=_WEIERSTRASS + "0; H. A. Schwarz (1865)",
            ),
            SurfaceInfo(
                name="schwarz_p",
                title="Schwarz P",
                aliases=("P", "primitive", "schwarz primitive"),
                formula="cos x + cos y + cos z",
                space_group="Pm-3m (221)",
                full_space_group="Im-3m (229)",
                genus=3,
                patches_per_cell=12,
                references=("minimal", "nodal"),
                primitives="exact",
                source=_WEIERSTRASS + "90 degrees; H. A. Schwarz (1865)",
            ),
            SurfaceInfo(
                name="iwp",
                title="I-WP",
                aliases=("wrapped package", "schoen iwp"),
                formula="2 (cos x cos y + cos y cos z + cos z cos x) - (cos 2x + cos 2y + cos 2z)",
                space_group="Im-3m (229)",
                full_space_group="Im-3m (229)",
                genus=4,
                patches_per_cell=48,
                references=("nodal",),
                primitives="mirrored",
                source=f"{_SCHOEN}; {_NESPER}",
            ),
            SurfaceInfo(
                name="neovius",
                title="Neovius",
                aliases=("C(P)", "neovius c(p)"),
                formula="3 (cos x + cos y + cos z) + 4 cos x cos y cos z",
                space_group="Pm-3m (221)",
                full_space_group="Im-3m (229)",
                genus=9,
                patches_per_cell=48,
                references=("nodal",),
                primitives="mirrored",
                source=f"E. R. Neovius (1883); {_NESPER}",
            ),
            SurfaceInfo(
                name="frd",
                title="F-RD",
                aliases=("schoen frd",),
                formula="4 cos x cos y cos z - (cos 2x cos 2y + cos 2y cos 2z + cos 2z cos 2x)",
                space_group="Fm-3m (225)",
                full_space_group="Fm-3m (225)",
                genus=6,
                patches_per_cell=96,
                references=("nodal",),
                primitives="mirrored",
                source=f"{_SCHOEN}; {_NESPER}",
            ),
            SurfaceInfo(
                name="lidinoid",
                title="Lidinoid",
                aliases=("L", "lidin"),
                formula=(
                    "0.5 (sin 2x cos y sin z + sin 2y cos z sin x + sin 2z cos x sin y)"
                    " - 0.5 (cos 2x cos 2y + cos 2y cos 2z + cos 2z cos 2x) + 0.15"
                ),
                space_group="Ia-3d (230)",
                full_space_group="Ia-3d (230)",
                genus=17,
                patches_per_cell=0,
                references=(),
                primitives=None,
                source=f"S. Lidin, S. Larsson, J. Chem. Soc. Faraday Trans. 86 (1990) 769; {_MINISURF}",
            ),
            SurfaceInfo(
                name="split_p",
                title="Split P",
                aliases=("SP",),
                formula=(
                    "1.1 (sin 2x cos y sin z + sin 2y cos z sin x + sin 2z cos x sin y)"
                    " - 0.2 (cos 2x cos 2y + cos 2y cos 2z + cos 2z cos 2x) - 0.4 (cos 2x + cos 2y + cos 2z)"
                ),
                space_group="Ia-3 (206)",
                full_space_group="Ia-3 (206)",
                genus=9,
                patches_per_cell=0,
                references=(),
                primitives=None,
                source="formula as in M. Wohlgemuth, N. Yufa, J. Hoffman, E. L. Thomas, Macromolecules 34 (2001) 6083",
            ),
            SurfaceInfo(
                name="fischer_koch_s",
                title="Fischer-Koch S",
                aliases=("S", "FKS", "koch s"),
                formula="cos 2x sin y cos z + cos x cos 2y sin z + sin x cos y cos 2z",
                space_group="I-43d (220)",
                full_space_group="Ia-3d (230)",
                genus=11,
                patches_per_cell=0,
                references=(),
                primitives=None,
                source=f"W. Fischer, E. Koch, Acta Cryst. A 43 (1987) 559; {_NESPER}",
            ),
            SurfaceInfo(
                name="octo",
                title="O,C-TO",
                aliases=("schoen octo", "schoen o,c-to"),
                formula="0.6 (cos x cos y + cos y cos z + cos z cos x) - 0.4 (cos x + cos y + cos z) + 0.25",
                space_group="Pm-3m (221)",
                full_space_group="Pm-3m (221)",
                genus=10,
                patches_per_cell=0,
                references=(),
                primitives=None,
                source=f"{_SCHOEN}; {_MINISURF}",
            ),
        )
    }
)


def _normalise_name(name: str) -> str:
    return re.sub(r"[\s_-]+", "", name).casefold()


_BY_NAME = {
    _normalise_name(spelling): info
    for info in CATALOGUE.values()
    for spelling in (info.name, info.title, *info.aliases)
}


def find_surface(name: str) -> SurfaceInfo:
    """The entry of that name or alias; case, blanks, hyphens and underscores don't matter.

    InvalidRequest suggests the nearest name.
    """
    info = _BY_NAME.get(_normalise_name(name))
    if info is None:
        near = get_close_matches(_normalise_name(name), _BY_NAME, n=1)
        hint = f"did you mean {_BY_NAME[near[0]].name!r}? " if near else ""
        raise InvalidRequest(f"unknown surface {name!r}: {hint}known are {', '.join(CATALOGUE)}")
    return info


def check_reference(info: SurfaceInfo, reference: str) -> None:
    """InvalidRequest unless lattices of the surface can refer to it."""
    if reference in info.references:
        return
    if not info.references:
        raise InvalidRequest(
            f"the {info.title} has no exact or mirrored primitives: make a solid of its formula, "
            f"tpmscad.solidify(fields.sheet(fields.tpms({info.name!r}, cell), ...), box, tol=...)"
        )
    raise InvalidRequest(
        f"reference {reference!r} of the {info.name} is unknown; choose one of {', '.join(info.references)}"
    )
