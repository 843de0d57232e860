"""tpmscad surfaces"""

from __future__ import annotations

PRIMITIVE_LABELS = {"exact": "exact patches", "mirrored": "mirrored pieces", None: "by solidify"}


def surfaces() -> None:
    """List the catalogue: names, what lattices are made of, references, patches per cell, space group, genus, formula."""
    from tpmscad.catalogue import CATALOGUE

    head = ("name", "also", "lattice", "references", "patches per cell", "space group", "genus", "formula")
    rows = [
        (
            i.name,
            ", ".join(i.aliases),
            PRIMITIVE_LABELS[i.primitives],
            ", ".join(i.references) or "formula",
            i.patches_per_cell or "-",
            i.space_group,
            i.genus,
            i.formula,
        )
        for i in CATALOGUE.values()
    ]
    table = [[str(entry) for entry in row] for row in (head, *rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        print("  ".join(entry.ljust(width) for entry, width in zip(row, widths, strict=True)).rstrip())
