"""Columns of results as lines in axes of matplotlib, labelled with quantities and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad.api.argument_kinds import show_value
from tpmscad.errors import InvalidRequest
from tpmscad.sweeps.cell_text import format_cell

LABELS: Mapping[str, str] = {
    **{f"E{i}": f"Young's modulus $E_{i}$ / that of the solid" for i in (1, 2, 3)},
    **{f"nu{ij}": rf"Poisson's ratio $\nu_{{{ij}}}$" for ij in (12, 13, 23)},
    **{f"G{ij}": f"shear modulus $G_{{{ij}}}$ / Young's modulus of the solid" for ij in (12, 13, 23)},
    "bulk_modulus": "bulk modulus / Young's modulus of the solid",
    "conductivity": "conductivity / that of the solid",
    "property_error": "relative error of the properties",
    "volume": "volume, mm³",
    "area": "area, mm²",
    "max_deviation": "greatest deviation, mm",
    "rms_deviation": "rms deviation, mm",
    "smallest_wall": "smallest wall, mm",
    "smallest_pore": "smallest pore, mm",
    "hydraulic_diameter": "hydraulic diameter, mm",
    **{
        f"{name}_{side}": f"{label} of channel {sign}, {unit}"
        for side, sign in (("plus", "+"), ("minus", "-"))
        for name, label, unit in (
            ("volume", "volume", "mm³"),
            ("wetted_area", "wetted area", "mm²"),
            ("hydraulic_diameter", "hydraulic diameter", "mm"),
            ("opening_area", "area of openings", "mm²"),
            ("pressure_drop", "pressure drop", "Pa"),
        )
    },
    "heat": "heat, W",
    "compactness": "compactness, m²/m³",
    "mass": "mass of the wall, g",
    "seconds": "time, s",
    "volume_fraction": "volume fraction",
    **{name: f"{name}, mm" for name in ("cell", "thickness", "offset", "skin")},
    "pore_size": "pore size, mm",
    "tol": "tolerance, mm",
}
"""Labels of axes by the columns; a column that is missing here is labelled by its name."""

MARKERS = "os^Dv<>P"
"""Of the lines, in turn: they are told apart without colours, too."""


def plot_columns(
    names: tuple[str, str, str | None], rows: Sequence[Sequence[Any]], ax: Any = None, *, joined: bool = True
) -> Any:
    """Axes with the second column over the first, and a line, or points, for each value of the third if it is named.

    `rows` holds for each design the values of the three columns; without a name the third is not looked at.
    """
    x, y, by = names
    lines: dict[str, list[tuple[float, float]]] = {}
    for *pair, value in rows:
        for name, number in zip((x, y), pair, strict=True):
            if number is not None and (isinstance(number, bool | str) or np.ndim(number)):
                raise InvalidRequest(
                    f"column {name!r} holds {show_value(number)}, which is no number: choose a column of numbers"
                )
        if None not in pair:
            lines.setdefault("" if by is None else format_cell(value) or "default", []).append((pair[0], pair[1]))
    if not lines:
        raise InvalidRequest(
            f"no design that is met has numbers in both columns {x!r} and {y!r}: smallest walls and pores are measured with "
            "metrics=True, moduli and conductivity with properties=True"
        )
    if ax is None:
        ax = import_extra("matplotlib.pyplot", "figures", "plot", "matplotlib").subplots(layout="constrained")[1]
    for number, (label, points) in enumerate(lines.items()):
        marker = MARKERS[number % len(MARKERS)]
        ax.plot(
            *zip(*sorted(points), strict=True), marker=marker, label=label if by else None, ls="-" if joined else ""
        )
    ax.set(xlabel=LABELS.get(x, x), ylabel=LABELS.get(y, y))
    if by:
        ax.legend(title=LABELS.get(by, by))
    return ax
