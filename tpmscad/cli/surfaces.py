"""tpmscad surfaces"""

from __future__ import annotations


def surfaces() -> None:
    """List the catalogue: names, space group, genus, references available, patches per cell."""
    from tpmscad.surfaces import CATALOGUE

    head = ("name", "also", "space group", "genus", "references", "patches per cell", "formula")
    rows = [
        (i.name, ", ".join(i.aliases), i.space_group, i.genus, ", ".join(i.references), i.patches_per_cell, i.formula)
        for i in CATALOGUE.values()
    ]
    table = [[str(entry) for entry in row] for row in (head, *rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        print("  ".join(entry.ljust(width) for entry, width in zip(row, widths, strict=True)).rstrip())
