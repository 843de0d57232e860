"""The triply periodic surfaces that have a formula: the trigonometric ("nodal") approximations of minimal surfaces.

x = 2 pi X / period, and so on; negative values are solid. `space_group` is that of the field, which keeps its two sides apart;
`range` its least and greatest value, measured by minimisation from the extreme samples of a 128^3 grid, to 1e-12.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType

from tpmscad.errors import InvalidRequest


@dataclass(frozen=True, slots=True)
class TpmsInfo:
    """A surface as its field knows it: names, formula in x, y, z, symmetry, range of values and source."""

    name: str
    title: str
    aliases: tuple[str, ...]
    formula: str
    space_group: str
    range: tuple[float, float]
    source: str


_NESPER = "H. G. von Schnering, R. Nesper, Z. Phys. B 83 (1991) 407"
_WOHLGEMUTH = "M. Wohlgemuth, N. Yufa, J. Hoffman, E. L. Thomas, Macromolecules 34 (2001) 6083"
_SCHOEN = "A. H. Schoen, NASA TN D-5541 (1970)"
_MINISURF = "M.-T. Hsieh, L. Valdevit, Software Impacts 6 (2020) 100026"

TPMS: Mapping[str, TpmsInfo] = MappingProxyType(
    {
        info.name: info
        for info in (
            TpmsInfo(
                "gyroid",
                "Gyroid",
                ("G", "schoen gyroid"),
                "sin x cos y + sin y cos z + sin z cos x",
                "I4_132 (214)",
                (-1.5, 1.5),
                f"{_SCHOEN}; {_NESPER}",
            ),
            TpmsInfo(
                "diamond",
                "Diamond",
                ("D", "schwarz d", "schwarz diamond"),
                "sin x sin y sin z + sin x cos y cos z + cos x sin y cos z + cos x cos y sin z",
                "Fd-3m (227)",
                (-math.sqrt(2), math.sqrt(2)),
                f"H. A. Schwarz (1865); {_NESPER}",
            ),
            TpmsInfo(
                "schwarz_p",
                "Schwarz P",
                ("P", "primitive", "schwarz primitive"),
                "cos x + cos y + cos z",
                "Pm-3m (221)",
                (-3.0, 3.0),
                f"H. A. Schwarz (1865); {_NESPER}",
            ),
            TpmsInfo(
                "iwp",
                "I-WP",
                ("I-WP", "schoen iwp", "wrapped package"),
                "2 (cos x cos y + cos y cos z + cos z cos x) - (cos 2x + cos 2y + cos 2z)",
                "Im-3m (229)",
                (-5.0, 3.0),
                f"{_SCHOEN}; {_NESPER}",
            ),
            TpmsInfo(
                "neovius",
                "Neovius",
                ("C(P)", "neovius c(p)"),
                "3 (cos x + cos y + cos z) + 4 cos x cos y cos z",
                "Pm-3m (221)",
                (-13.0, 13.0),
                f"E. R. Neovius (1883); {_NESPER}",
            ),
            TpmsInfo(
                "frd",
                "F-RD",
                ("F-RD", "schoen frd"),
                "4 cos x cos y cos z - (cos 2x cos 2y + cos 2y cos 2z + cos 2z cos 2x)",
                "Fm-3m (225)",
                (-7.0, 2.0),
                f"{_SCHOEN}; {_NESPER}",
            ),
            TpmsInfo(
                "lidinoid",
                "Lidinoid",
                ("L", "lidin"),
                "0.5 (sin 2x cos y sin z + sin 2y cos z sin x + sin 2z cos x sin y)"
                " - 0.5 (cos 2x cos 2y + cos 2y cos 2z + cos 2z cos 2x) + 0.15",
                "Ia-3d (230)",
                (-1.35, 1.15),
                f"S. Lidin, S. Larsson, J. Chem. Soc. Faraday Trans. 86 (1990) 769; formula as in {_MINISURF}",
            ),
            TpmsInfo(
                "split_p",
                "Split P",
                ("SP", "split-p"),
                "1.1 (sin 2x cos y sin z + sin 2y cos z sin x + sin 2z cos x sin y)"
                " - 0.2 (cos 2x cos 2y + cos 2y cos 2z + cos 2z cos 2x) - 0.4 (cos 2x + cos 2y + cos 2z)",
                "Ia-3 (206)",
                (-1.8, 1.81),
                _WOHLGEMUTH,
            ),
            TpmsInfo(
                "fischer_koch_s",
                "Fischer-Koch S",
                ("S", "FKS", "fischer koch s", "koch s"),
                "cos 2x sin y cos z + cos x cos 2y sin z + sin x cos y cos 2z",
                "I-43d (220)",
                (-math.sqrt(2), math.sqrt(2)),
                f"W. Fischer, E. Koch, Acta Cryst. A 43 (1987) 559; {_NESPER}",
            ),
            TpmsInfo(
                "octo",
                "O,C-TO",
                ("O,C-TO", "schoen octo", "schoen o,c-to"),
                "0.6 (cos x cos y + cos y cos z + cos z cos x) - 0.4 (cos x + cos y + cos z) + 0.25",
                "Pm-3m (221)",
                (-0.75, 3.25),
                f"{_SCHOEN}; formula as in {_MINISURF}",
            ),
        )
    }
)


def find_surface(name: str) -> TpmsInfo:
    """The entry of a name or alias, upper and lower case, spaces and punctuation left aside.

    Raises InvalidRequest with the nearest names for one that is not there.
    """
    keys = {_normalise_name(alias): info for info in TPMS.values() for alias in (info.name, info.title, *info.aliases)}
    key = _normalise_name(str(name))
    if key in keys:
        return keys[key]
    near = dict.fromkeys(keys[match].name for match in get_close_matches(key, keys, n=3))
    hint = f"did you mean {' or '.join(near)}?" if near else "choose one of " + ", ".join(TPMS)
    raise InvalidRequest(f"no triply periodic surface is called {name!r}: {hint}")


def _normalise_name(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
