"""The blends of the paper's Table 1 and Figures 9 to 12 as solids in STEP: a row each.

    python -m benchmarks.solidify_figures [--only NAME] [--tol PART_OF_PERIOD] [--part]

NAME is a part of a row's name. With --part it is a box of each blend that holds the blending region's whole width.
Free-form models (the paper's max(phi, model)) are bodies: the blend is laid out around them and trimmed by their own faces. The
Betti numbers of the field are counted on two grids that no part of the program uses, the volume is by quadrature of the field
along lines; files are written, read back and checked, and their joints measured (`benchmarks.joints`).
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blending_cases import Case, figure9, figure10, figure11, pair, table1
from benchmarks.joints import worst_joint

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
import blend_scaffold

from tpmscad import fields, topology
from tpmscad.blending import BlendResult, blend
from tpmscad.errors import TpmscadError
from tpmscad.fields.analysis import volume_quadrature
from tpmscad.kernel.measure.shape_report import check_step
from tpmscad.solids._solidify import solidify

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
FLAT: Corners = (0, 0, 0), (1, 1, 0.25)
BAR: Corners = (0, 0, 0), (1, 0.25, 0.25)
MIDDLE: Corners = (0.25, 0, 0), (0.75, 0.25, 0.25)
"""Of the bar: 4 x 2 x 2 periods round x from .3 to .7."""
WAVE: Corners = (0, 0, 0), (0.5, 1, 0.25)
DISC: Corners = (0.25, 0.125, 0), (0.5, 0.375, 0.25)
LINES = (150, 230)
"""Samples along the longest edge for the field's Betti numbers."""


@dataclass(frozen=True)
class Row:
    """A blend, the box or the body that it fills, and that body as a field (None: a box)."""

    name: str
    period: float
    made: Callable[[], BlendResult]
    box: Corners
    body: Callable[[float], Any] | None = None
    model: fields.Field | None = None
    bare: tuple[fields.Field, ...] = ()
    """The structures without the model."""
    part: Corners | None = None
    """What is made of it with --part."""


def blended(case: Case) -> BlendResult:
    """Looked at between the samples, too: what a solid is made of has no parts that its Betti numbers would miss."""
    return blend(
        case.structures, case.regions, case.blending, weight=case.weight, resolution=case.resolution, subgrid_check=True
    )


def drum(centre: tuple[float, float, float], radius: float, height: float) -> Any:
    from build123d import Cylinder, Location

    return Location(centre) * Cylinder(radius, height)


def octant(radius: float) -> Any:
    from build123d import Align, Box, Sphere

    return Sphere(radius) & Box(radius, radius, radius, align=(Align.MIN,) * 3)


def cut_block(tol: float) -> Any:
    """Figure 9(a)'s model is a cube smoothly intersected with a ball, which has no faces of its own: here it is cut sharply."""
    from build123d import Box, Location, Sphere

    return Location((0.5, 0.5, 0.5)) * (Box(1, 1, 1) & Sphere(0.75))


def _block() -> fields.Field:
    return fields.box((0, 0, 0), (1, 1, 1)) & fields.sphere((0.5, 0.5, 0.5), 0.75)


def rows() -> list[Row]:
    of_table = [Row(c.name, 1 / 8, lambda c=c: blended(c), BAR, part=MIDDLE) for c in table1()]  # type: ignore[misc]
    a, b, c = figure9()
    cylinder = fields.cylinder((0, 0, 0.5), 0.5, axis="z") & fields.box((-1, -1, 0), (1, 1, 1))
    ball = fields.sphere((0, 0, 0), 0.5) & fields.box((0, 0, 0), (1, 1, 1))
    big = fields.cylinder((0, 0, 4), 10, axis="z") & fields.box((-11, -11, 0), (11, 11, 8))
    waves = [figure10(d) for d in (0.1, 0.2, 0.3)]
    return [
        *of_table,
        Row(a.name, 1 / 4, lambda: blended(a), ((0, 0, 0), (1, 1, 1)), cut_block, _block(), pair(),
            ((0.25, 0.5, 0.5), (0.75, 1, 1))),
        Row(b.name, 1 / 4, lambda: blended(b), ((-0.5, -0.5, 0), (0.5, 0.5, 1)), lambda tol: drum((0, 0, 0.5), 0.5, 1.0),
            cylinder, pair(), ((0, 0, 0), (0.5, 0.5, 0.5))),
        Row(c.name, 1 / 8, lambda: blended(c), ((0, 0, 0), (0.5, 0.5, 0.5)), lambda tol: octant(0.5), ball, pair(8),
            ((0, 0, 0), (0.5, 0.25, 0.25))),
        *(Row(w.name, 1 / 4, lambda w=w: blended(w), FLAT, part=WAVE) for w in waves),  # type: ignore[misc]
        Row("Figure 11", 1 / 4, lambda: blended(figure11()), FLAT, part=((0, 0, 0), (0.5, 0.5, 0.25))),
        Row("Figure 11 of 8 periods", 1 / 8, lambda: blended(figure11(periods=8)), FLAT, part=DISC),
        Row("Figure 12 graded", 5.0, blend_scaffold.graded, ((0, 0, 0), (15, 15, 40)), part=((0, 0, 5), (10, 10, 15))),
        Row("Figure 12 quadrants", 5.0, blend_scaffold.quadrants, ((-10, -10, 0), (10, 10, 8)),
            lambda tol: drum((0, 0, 4), 10, 8), big, tuple(blend_scaffold.rods(5.0)), ((-5, -5, 0), (5, 5, 8))),
    ]  # fmt: skip


def part_of(row: Row) -> Row:
    """The row's part, with what of its body lies in it."""
    assert row.part is not None
    name, corners = f"{row.name}, part", row.part
    if row.body is None or row.model is None:
        return replace(row, name=name, box=corners)
    from build123d import Align, Box, Location

    size = [b - a for a, b in zip(*corners, strict=True)]
    cut, body, model = Location(corners[0]) * Box(*size, align=(Align.MIN,) * 3), row.body, row.model
    return replace(row, name=name, box=corners, body=lambda tol: body(tol) & cut, model=model & fields.box(*corners))


def sampled_betti(field: fields.Field, box: Corners, lines: int) -> tuple[int, int, int]:
    """Of {field < 0} in the box, which bounds it; on a grid shifted off the one that solidify counts on."""
    lo, hi = np.array(box, float)
    counts = np.ceil(lines * (hi - lo) / (hi - lo).max()).astype(int)
    found = topology.betti(field.on_grid(*(np.linspace(a, b, n + 1) for a, b, n in zip(lo, hi, counts, strict=True))))
    return found.b0, found.b1, found.b2


def cpu() -> float:
    """Seconds of this process and of those it has waited for."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def measured(row: Row, tol: float) -> str:
    result = row.made()
    if not result.converged:
        return f"the blend did not converge: {result.message}"
    field = replace(result.field, structures=row.bare) if row.bare else result.field  # type: ignore[type-var]
    whole = field if row.model is None else field & row.model
    begun = cpu()
    try:
        model = solidify(field, row.box if row.body is None else row.body(tol * row.period), tol=tol * row.period)
    except TpmscadError as error:
        return f"REFUSED, CPU {cpu() - begun:.1f} s: {error}"
    solid = cpu() - begun
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "solid.step"
        model.export_step(path)
        stored = cpu() - begun - solid
        megabytes, again = path.stat().st_size / 1e6, check_step(path)
        jump, joints = worst_joint(path)
        kept = "" if row.body is None else f"faces in the file: {faces_of(path)}, "
    c = model.certificate
    lo, hi = np.array(row.box, float)
    volume, spread = volume_quadrature.integrate_volume(
        whole, lo, hi, min(float((hi - lo).max()) / 160, row.period / 40)
    )
    counted = " ".join(str(sampled_betti(whole, row.box, n)) for n in LINES)
    periods = float(np.prod((hi - lo) / row.period)) if row.model is None else _periods(row, lo, hi)
    return (
        f"{'met' if c.met else 'NOT MET'} faces {c.n_faces} ({c.n_faces / periods:.0f} a period) "
        f"deviation {c.max_deviation / row.period:.1e} periods, poles {c.n_poles}, {joints} joints bent by {jump:.0e} degrees, "
        f"betti {c.betti} field {counted}, "
        f"pieces {len(c.pieces)}, volume {c.volume / volume - 1:+.1e} (quadrature +-{spread / volume:.0e}), "
        f"{kept}{megabytes:.1f} MB, re-read {'valid' if again.ok and again.shape.faces == c.n_faces else 'NOT VALID'}, "
        f"CPU {solid:.1f} s + file {stored:.1f} s {'; '.join((*c.shortfalls, *c.notes))}"
    )


def faces_of(path: Path) -> str:
    """How many faces of which kind a file has."""
    from build123d import import_step

    kinds = Counter(face.geom_type.name.lower() for face in import_step(path).faces())
    return " ".join(f"{kind} {number}" for kind, number in sorted(kinds.items()))


def _periods(row: Row, lo: np.ndarray, hi: np.ndarray) -> float:
    """The body's volume in periods."""
    assert row.model is not None
    return volume_quadrature.integrate_volume(row.model, lo, hi, float((hi - lo).max()) / 60)[0] / row.period**3


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--only", default="", help="a part of the rows' names")
    options.add_argument("--tol", type=float, default=5e-3, help="tolerance, in periods")
    options.add_argument("--part", action="store_true", help="a box of each that holds the blending region's width")
    given = options.parse_args()
    for row in rows():
        if given.only in row.name:
            row = part_of(row) if given.part else row
            print(f"{row.name:26s}", measured(row, given.tol), flush=True)


if __name__ == "__main__":
    main()
