"""The applications of the gallery at full size: seconds, faces, megabytes, deviation and Betti numbers, and their pictures.

    python -m benchmarks.gallery [NAME ...]

Each script of `examples/` that is named, or all of APPLICATIONS and PLOTS, runs in an empty folder. Its rows go into
docs/gallery/measures.csv and its pictures, reduced, beside it; the page of examples shows both.
"""

from __future__ import annotations

import csv
import os
import runpy
import sys
import tempfile
from contextlib import chdir
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery"
COLUMNS = ("example", "solid", "cpu_seconds", "faces", "megabytes", "deviation_mm", "betti", "met")
PICTURE_WIDTH = 640
PALETTE = 256
"""Colours of a kept picture, for small files."""

APPLICATIONS = ("trimmed", "build123d_bracket", "implant", "bone")
"""Examples that make a solid, without CadQuery."""

PLOTS = ("sweep",)
"""Examples that draw a plot, whose pictures are kept without a row of measures."""

FULL_SIZE: dict[str, dict[str, Any]] = {"bone": {"arrangements": ("quadrants", "layers")}}
"""Arguments of examples that make less by default."""


def flatten(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The measures of each solid of an example by its name; of a single one under the empty name."""
    if "met" in found:
        return {"": found}
    return {name: value for name, value in found.items() if isinstance(value, dict) and "met" in value}


def keep_picture(example: str, path: Path) -> None:
    """A reduced picture under the name of the example, and its own name where that says more."""
    own = path.stem.removeprefix(example).strip("_")
    name = example if not own or own in example else f"{example}-{own}"
    with Image.open(path) as image:
        reduced = image.convert("RGB")
        reduced.thumbnail((PICTURE_WIDTH, PICTURE_WIDTH), Image.Resampling.LANCZOS)
        reduced.quantize(PALETTE).save(GALLERY / f"{name}.png", optimize=True)


def run_example(name: str) -> list[dict[str, Any]]:
    """Run an example, keep its pictures, and return a row for each of its solids."""
    sys.path.insert(0, str(ROOT / "examples"))
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        begun = sum(os.times()[:4])  # with child processes
        found = runpy.run_path(str(ROOT / "examples" / f"{name}.py"))["main"](**FULL_SIZE.get(name, {}))
        seconds = sum(os.times()[:4]) - begun
        for picture in Path().glob("*.png"):
            keep_picture(name, picture)
        if name in PLOTS:
            print(found)
            return []
        for key, value in found.items():
            print(f"{name}: {key}: {value}")
        files = sorted(Path().glob("*.step"), key=lambda file: len(file.stem))
        rows = []
        for solid, values in flatten(found).items():
            written = [file for file in files if solid in file.stem] or files
            rows.append(
                {
                    "example": name,
                    "solid": solid or name,
                    "cpu_seconds": round(seconds),
                    "faces": values["faces"],
                    "megabytes": round(written[0].stat().st_size / 1e6, 1),
                    "deviation_mm": f"{values['deviation']:.2g}",
                    "betti": " ".join(map(str, values["betti"])),
                    "met": values["met"],
                }
            )
        return rows


def main() -> None:
    GALLERY.mkdir(exist_ok=True)
    path = GALLERY / "measures.csv"
    for name in sys.argv[1:] or (*APPLICATIONS, *PLOTS):
        rows = run_example(name)
        if path.exists():
            rows += [row for row in csv.DictReader(path.open(newline="")) if row["example"] != name]
        with path.open("w", newline="") as file:
            table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(sorted(rows, key=lambda row: (row["example"], row["solid"])))
    print(path.read_text())


if __name__ == "__main__":
    main()
