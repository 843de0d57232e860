"""Solids of fields: faces, poles, seconds and what the certificates say, beside facets of the same deviation in one run.

python -m benchmarks.solidify [catalogue | fine | thin | scale | copies] ...
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.facets import facets
from benchmarks.joints import worst_joint
from tpmscad import fields
from tpmscad.errors import TpmscadError
from tpmscad.solids._solidify import solidify

CELL = ((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
NAMES = (
    "gyroid", "diamond", "schwarz_p", "iwp", "neovius", "frd", "lidinoid", "split_p", "fischer_koch_s",
)  # fmt: skip
LEVELS = {"neovius": (-0.6, 0.6), "iwp": (-0.5, 0.5), "frd": (-0.5, 0.5)}


def catalogue() -> None:
    """One cell of each surface, sheet and skeletal, at a thousandth of the cell."""
    for name in NAMES:
        phi = fields.tpms(name, period=10.0)
        row(f"{name} skeletal", fields.rod(phi, 0.1), CELL, 1e-2, beside=True)
        row(f"{name} sheet", fields.sheet(phi, *LEVELS.get(name, (-0.3, 0.3))), CELL, 1e-2, beside=True)


def fine() -> None:
    """The gyroid at a ten-thousandth of the cell."""
    phi = fields.tpms("gyroid", period=10.0)
    row("gyroid skeletal", fields.rod(phi, 0.1), CELL, 1e-3, beside=True)
    row("gyroid sheet", fields.sheet(phi, -0.3, 0.3), CELL, 1e-3, beside=True)


def thin() -> None:
    """Walls of 10, 2 and 0.7 per cent of the cell."""
    phi = fields.tpms("gyroid", period=10.0)
    for share in (0.1, 0.02, 0.007):
        level = 0.5 * 10.0 * share * 0.93
        row(f"gyroid wall {share:.1%}", fields.sheet(phi, -level, level), CELL, 1e-2)
    row("gyroid wall 0.7%, tol 0.1", fields.sheet(phi, -0.03, 0.03), CELL, 1e-1)


def scale() -> None:
    """Gyroid 2 x 2 x 2 and 4 x 4 x 4, with the process's peak of memory after each."""
    phi = fields.tpms("gyroid", period=10.0)
    for n in (2, 4):
        row(f"gyroid {n}x{n}x{n}", fields.rod(phi, -0.3), ((0, 0, 0), (10.0 * n,) * 3), 1e-2)
        print(f"{'':26s} {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB at most", flush=True)


def copies() -> None:
    """Surfaces without a lattice of their own in 3 x 3 x 3 periods: what repeats is fitted once."""
    for name in ("lidinoid", "split_p", "fischer_koch_s", "octo"):
        phi = fields.tpms(name, period=10.0)
        row(f"{name} 3x3x3", fields.rod(phi, 0.1), ((0, 0, 0), (30, 30, 30)), 1e-2)


HEAD = (
    "seconds are CPU; deviation in cells; joints: their greatest angle in the STEP file, degrees; volume: relative.\n"
    "facets: triangles of marching cubes at the deviation asked, MB of STEP and seconds; * scaled up from 4000 triangles;\n"
    "last, how many it takes at the deviation that the solid has.\n"
    f"{'':26s} {'':7s} faces  poles seconds    MB deviation   joints    volume  betti           facets       MB  seconds"
)


def row(name: str, field: fields.Field, domain: object, tol: float, *, beside: bool = False) -> None:
    """One line: the solid, its certificate, its STEP file, and what facets of the same deviation take."""
    cpu = seconds()
    try:
        model = solidify(field, domain, tol=tol)
    except TpmscadError as error:
        print(f"{name:26s} refused after {seconds() - cpu:.1f} s: {error}", flush=True)
        return
    with TemporaryDirectory() as folder:
        path = Path(folder) / "solid.step"
        model.export_step(path)
        size, cpu = path.stat().st_size / 1e6, seconds() - cpu
        bent, _ = worst_joint(path)
    c, more = model.certificate, model.certificate.figures
    whole = c.volume + sum(c.dropped)  # the field has the loose pieces, too
    off = whole / next(value for name, value in more.items() if name.startswith("volume of the field")) - 1
    other = ""
    if beside:
        plain = facets(field, *(np.asarray(p, float) for p in domain), tol)
        other = f"{plain} {plain.count * plain.deviation / c.max_deviation:10.1e}"
    print(
        f"{name:26s} {'met' if c.met else 'NOT met':7s} {c.n_faces:5d} {c.n_poles:6d} {cpu:7.1f} {size:5.2f} "
        f"{c.max_deviation / 10.0:9.1e} {bent:8.0e} {off:+9.1e}  {c.betti!s:14s} {other}"
        + "".join(f"\n{'':26s} {text}" for text in c.shortfalls),
        flush=True,
    )


def seconds() -> float:
    """CPU seconds of this process and of its workers that have ended."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in used)


if __name__ == "__main__":
    print(HEAD, flush=True)
    for task in sys.argv[1:] or ["catalogue", "fine", "thin", "scale", "copies"]:
        {"catalogue": catalogue, "fine": fine, "thin": thin, "scale": scale, "copies": copies}[task]()
