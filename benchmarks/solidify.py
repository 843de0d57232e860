"""Solids of fields: faces, poles, seconds and what the certificates say, beside facets of the same deviation.

python benchmarks/solidify.py [catalogue | fine | graded | thin | scale] ...
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from skimage.measure import marching_cubes

from tpmscad import fields
from tpmscad.errors import TpmscadError
from tpmscad.solids import solidify

CELL = ((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
NAMES = (
    "gyroid", "diamond", "schwarz_p", "iwp", "neovius", "frd", "lidinoid", "split_p", "fischer_koch_s",
)  # fmt: skip
LEVELS = {"neovius": (-0.6, 0.6), "iwp": (-0.5, 0.5), "frd": (-0.5, 0.5)}


def catalogue() -> None:
    """One cell of each surface, sheet and skeletal, at a thousandth of the cell."""
    for name in NAMES:
        phi = fields.tpms(name, period=10.0)
        row(f"{name} skeletal", fields.rod(phi, 0.1), CELL, 1e-2, facets=True)
        row(f"{name} sheet", fields.sheet(phi, *LEVELS.get(name, (-0.3, 0.3))), CELL, 1e-2)


def fine() -> None:
    """The gyroid at a ten-thousandth of the cell."""
    phi = fields.tpms("gyroid", period=10.0)
    row("gyroid skeletal", fields.rod(phi, 0.1), CELL, 1e-3, facets=True)
    row("gyroid sheet", fields.sheet(phi, -0.3, 0.3), CELL, 1e-3)


def graded() -> None:
    """A wall from 0.3 to 1.2 mm over four cells: thickness = 2 level / |gradient|, about 2 pi 1.5 / 10 on the mid surface."""
    phi = fields.tpms("gyroid", period=10.0)
    level = fields.ramp("x", (0, 40), (0.15 * 0.87, 0.6 * 0.87))
    row("gyroid wall 0.3 to 1.2", fields.sheet(phi, -level, level), ((0, 0, 0), (40, 10, 10)), 1e-2)


def thin() -> None:
    """Walls of 10, 2 and 0.7 per cent of the cell."""
    phi = fields.tpms("gyroid", period=10.0)
    for share in (0.1, 0.02, 0.007):
        level = 0.5 * 10.0 * share * 0.93
        row(f"gyroid wall {share:.1%}", fields.sheet(phi, -level, level), CELL, 1e-2)
    row("gyroid wall 0.7%, tol 0.1", fields.sheet(phi, -0.03, 0.03), CELL, 1e-1)


def scale() -> None:
    """Gyroid 4 x 4 x 4."""
    phi = fields.tpms("gyroid", period=10.0)
    row("gyroid 4x4x4", fields.rod(phi, -0.3), ((0, 0, 0), (40, 40, 40)), 1e-2)


def row(name: str, field: fields.Field, domain: object, tol: float, *, facets: bool = False) -> None:
    """One line: the solid, its certificate, its STEP file."""
    begun, cpu = time.perf_counter(), time.process_time()
    try:
        model = solidify(field, domain, tol=tol)
    except TpmscadError as error:
        print(f"{name:26s} refused after {time.perf_counter() - begun:.1f} s: {error}", flush=True)
        return
    seconds, cpu = time.perf_counter() - begun, time.process_time() - cpu
    c, more = model.certificate, model.certificate.figures
    with TemporaryDirectory() as folder:
        path = Path(folder) / "solid.step"
        model.export_step(path)
        size = path.stat().st_size / 1e6
    p95 = more["tangent jump in degrees at the 95th percentile"]
    off = c.volume / more["volume of the field"] - 1
    print(
        f"{name:26s} {'met' if c.met else 'NOT met'} faces {c.n_faces} poles {c.n_poles} dev {c.max_deviation:.1e} "
        f"jump {c.tangent_jump_deg:.2f}/{p95:.3f} valid {c.valid} betti {c.betti} "
        f"volume {off:+.1e} {seconds:.1f} s (cpu {cpu:.1f}) STEP {size:.2f} MB {'; '.join(c.shortfalls)}",
        flush=True,
    )
    if facets:
        print(
            f"{'':26s} facets {n_facets(field, domain, c.max_deviation)} of marching cubes at the same deviation",
            flush=True,
        )


def n_facets(field: fields.Field, domain: object, deviation: float) -> int:
    """Triangles that marching cubes needs: counted at 60 samples an edge, scaled by the square of the deviation found there."""
    lo, hi = (np.asarray(p, float) for p in domain)
    axes = [np.linspace(a, b, 61) for a, b in zip(lo, hi, strict=True)]
    points, faces, _, _ = marching_cubes(field.on_grid(*axes), 0.0, spacing=tuple((hi - lo) / 60))
    value, slope = field.value_and_gradient(points[faces].mean(axis=1) + lo)
    found = float((np.abs(value) / np.linalg.norm(slope, axis=1)).max())
    return int(len(faces) * found / deviation)


if __name__ == "__main__":
    for task in sys.argv[1:] or ["catalogue", "fine", "graded", "thin", "scale"]:
        {"catalogue": catalogue, "fine": fine, "graded": graded, "thin": thin, "scale": scale}[task]()
