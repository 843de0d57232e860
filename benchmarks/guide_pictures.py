"""The pictures of the guide's pages, each at most PAGE_PICTURE_BYTES, into docs/guide/pictures.

    python -m benchmarks.guide_pictures [NAME ...]

Pictures of the tutorials are drawn by `benchmarks.tutorials`, those of the examples by `benchmarks.gallery`.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np

import tpmscad
from benchmarks.gallery import ROOT, reduce_picture
from tpmscad import fields

FOLDER = ROOT / "docs" / "guide" / "pictures"
PAGE_PICTURE_BYTES = 50_000
SIZE = (640, 480)


def draw_lattice(**keywords: Any) -> Callable[[Path], None]:
    view = {key: keywords.pop(key) for key in ("section", "color_by") if key in keywords}
    surface = keywords.pop("surface")
    return lambda path: tpmscad.lattice(surface, progress=False, **keywords).render(path, size=SIZE, **view)


def draw_graded(path: Path) -> None:
    level = fields.ramp("z", (0, 10), (0.15, 0.6))
    field = fields.sheet(fields.tpms("gyroid", period=5), -level, level)
    tpmscad.solidify(field, ((0, 0, 0), (5, 5, 10)), tol=0.05, progress=False).render(path, size=SIZE)


def draw_density(path: Path) -> None:
    """A density of 24 by 12 by 8 elements as a solid, with a boss and its bore."""
    x, y, z = (np.indices((24, 12, 8)).T + 0.5).T / np.array([24, 12, 8]).reshape(3, 1, 1, 1)
    chords = np.minimum(abs(y - 0.88 + 0.5 * x), abs(y - 0.12 - 0.5 * x))
    web = 1.4 * abs(x - 0.45 - 0.3 * (y - 0.5))
    values = 1 / (1 + np.exp((np.minimum(chords, web) - 0.14) / 0.035))
    values *= 1 - 0.75 * np.exp(-(((z - 0.5) / 0.18) ** 2)) * (chords < 0.3)
    field = fields.sampled(values, 2.5, (1.25,) * 3, volume_fraction=0.45, centred=True)
    boss, bore = (bd.Pos(50, 15, 10) * bd.Cylinder(radius, height) for radius, height in ((6, 26), (3, 30)))
    tpmscad.solidify(field, field.domain, tol=0.2, keep=boss, clear=bore, progress=False).render(
        path, size=SIZE, color_by="tag"
    )


def draw_infill(path: Path) -> None:
    body = fields.cylinder((0, 0, 6), 10, height=12)
    tpmscad.infill(body, "gyroid", cell=8, thickness=0.8, tol=0.1, progress=False).render(path, size=SIZE)


def draw_cores(path: Path) -> None:
    """The four cores within the skin of a part, cut open, side by side."""
    from PIL import Image

    plate = bd.extrude(bd.fillet(bd.Rectangle(24, 18).vertices(), 4), 6) - bd.Pos(-6, 0, 3) * bd.Cylinder(3, 6)
    drawn = []
    with tempfile.TemporaryDirectory() as folder:
        for number, kind in enumerate(("honeycomb", "square", "triangular", "re-entrant")):
            file = Path(folder) / f"{number}.png"
            model = tpmscad.infill(plate, kind, cell=3.2, thickness=0.3, skin=0.6, tol=0.05, progress=False)
            model.render(file, size=(SIZE[0] // 2, SIZE[1] // 2), section="z=3", view=(1, -1.2, 2.5))
            drawn.append(Image.open(file).convert("RGB"))
    joined = Image.new("RGB", SIZE)
    for number, picture in enumerate(drawn):
        joined.paste(picture, (number % 2 * SIZE[0] // 2, number // 2 * SIZE[1] // 2))
    joined.save(path)


def draw_cells_and_layers(path: Path) -> None:
    """The parts of a filled cylinder in a file of whole cells and cut layers, a colour each."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "filled.step"
        tpmscad.export_infill(bd.Cylinder(8, 10), "gyroid", file, cell=5, thickness=0.7, tol=0.1, progress=False)
        tpmscad.render(file, path, color_by="piece", size=SIZE)


def draw_thickness(path: Path) -> None:
    """A section of a gyroid's wall with its middle surface, thickness and offsets."""
    from matplotlib.figure import Figure

    t = np.linspace(0, 10, 400)
    distance = fields.normal_distance(fields.tpms("gyroid", period=10.0)).on_grid(t, t, [2.5])[..., 0].T
    figure = Figure(figsize=(6.4, 2.7), layout="constrained")
    titles = ("thickness=1", "offset=(-0.2, 1.0)", 'kind="skeletal", offset=0.4')
    for axes, title, levels in zip(figure.subplots(1, 3), titles, ((-0.5, 0.5), (-0.2, 1.0), (-9, 0.4)), strict=True):
        axes.contourf(t, t, distance, levels=levels, colors=["#9eb5cc"])
        axes.contour(t, t, distance, levels=[0], colors=["#c1440e"], linewidths=1)
        axes.set(title=title, aspect="equal", xticks=[0, 5, 10], yticks=[0, 5, 10])
        axes.title.set_fontsize(9)
    figure.supxlabel("x, mm; cell=10, z=2.5; red: the middle surface", fontsize=9)
    figure.savefig(path, dpi=100)


def draw_comparison(path: Path) -> None:
    """Faces and megabytes of the table of the page, side by side."""
    from matplotlib.figure import Figure

    names = ("tpmscad", "flat facets", "microgen 1.3.2")
    figure = Figure(figsize=(6.4, 2.2), layout="constrained")
    for axes, title, values in zip(
        figure.subplots(1, 2), ("faces", "STEP, MB"), ((246, 111_296, 6_876), (0.73, 114, 17.1)), strict=True
    ):
        bars = axes.barh(names[::-1], values[::-1], color=["#888c99", "#888c99", "#1f5f8b"], log=True)
        axes.bar_label(bars, [f"{value:,}" for value in values[::-1]], padding=3, fontsize=8)
        axes.set(title=title, xlim=(min(values) / 3, max(values) * 12))
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=100)


PICTURES: dict[str, Callable[[Path], None]] = {
    "sheet": draw_lattice(surface="gyroid", cell=10, thickness=1, tol=0.05),
    "skeletal": draw_lattice(surface="gyroid", cell=10, volume_fraction=0.3, kind="skeletal", tol=0.05),
    "natural": draw_lattice(surface="schwarz_p", cell=10, cells=2, thickness=1, boundary="natural", tol=0.05),
    "section": draw_lattice(surface="diamond", cell=10, thickness=1, tol=0.05, section="z=5", color_by="deviation"),
    "lidinoid": draw_lattice(surface="lidinoid", cell=10, thickness=0.5, tol=0.05),
    "density": draw_density,
    "graded": draw_graded,
    "infill": draw_infill,
    "cores": draw_cores,
    "cells_and_layers": draw_cells_and_layers,
    "thickness": draw_thickness,
    "comparison": draw_comparison,
}
"""Pictures by name."""


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or PICTURES:
        with tempfile.TemporaryDirectory() as folder:
            drawn = Path(folder) / f"{name}.png"
            PICTURES[name](drawn)
            reduce_picture(drawn, FOLDER / f"{name}.png", PAGE_PICTURE_BYTES)
        print(f"{name}: {(FOLDER / f'{name}.png').stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
