"""tpmscad surfaces: the catalogue as a table."""

from __future__ import annotations

from tpmscad.catalogue import CATALOGUE

PRIMITIVE_LABELS = {"exact": "exact patches", "mirrored": "mirrored pieces", None: "by solidify"}


def surfaces() -> None:
    """List the catalogue: names, construction of lattices, references, patches per cell, space group, genus, formula."""
    head = ("name", "also", "lattice", "references", "patches per cell", "space group", "genus", "formula")
    rows = [
        (
            info.name,
            ", ".join(info.aliases),
            PRIMITIVE_LABELS[info.primitives],
            ", ".join(info.references) or "formula",
            info.patches_per_cell or "-",
            info.space_group,
            info.genus,
            info.formula,
        )
        for info in CATALOGUE.values()
    ]
    table = [[str(entry) for entry in row] for row in (head, *rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        print("  ".join(entry.ljust(width) for entry, width in zip(row, widths, strict=True)).rstrip())
