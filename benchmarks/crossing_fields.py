"""Random unions, intersections and differences of fields as solids, judged apart.

    python -m benchmarks.crossing_fields [--seed 1] [--count 60] [--first 0] [--only 7] [--quadrics]

Trees of two to five leaves (half-spaces, balls, struts, finite cylinders, boxes, sheets, rods, formulas, samples on a grid) in a
box of 10 mm at four tolerances. Columns: the tree, tolerance, outcome, faces, volume and its difference from one random point in
each of 160^3 cells in standard errors, Betti numbers, creases and the sharpest wedge, the curves that creases make within the box
with their length, on the solid and by the field alone, CPU seconds. "no file" is a solid that cannot be
written as a file that reads back valid. WRONG is a volume that is more than 4 standard errors, and the area times the deviation,
off. --quadrics leaves out fields that are fitted.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import tpmscad
from tpmscad import fields

SIZE, CELLS = 10.0, 160
TOLS = (0.05, 0.02, 0.01, 0.005)
STANDARD_ERRORS = 4.0


def draw_leaf(rng: np.random.Generator, quadrics: bool) -> tuple[str, fields.Field]:
    """A random solid and its name."""
    middle = rng.uniform(2, 8, 3)
    axis = rng.normal(size=3)
    kinds = ["half-space", "ball", "strut", "pin", "box"] + ([] if quadrics else ["sheet", "rod", "formula", "samples"])
    kind = str(rng.choice(kinds))
    if kind == "half-space":
        return kind, fields.halfspace(tuple(middle), tuple(axis))
    if kind == "ball":
        return kind, fields.sphere(tuple(middle), rng.uniform(1.5, 4))
    if kind == "strut":
        return kind, fields.cylinder(tuple(middle), rng.uniform(0.6, 2), tuple(axis))
    if kind == "pin":
        return kind, fields.cylinder(tuple(middle), rng.uniform(0.8, 2.5), tuple(axis), rng.uniform(3, 8))
    if kind == "box":
        half = rng.uniform(1, 3, 3)
        return kind, fields.box(tuple(middle - half), tuple(middle + half))
    if kind == "formula":
        a, b = rng.uniform(0.5, 1.2, 2)
        return kind, fields.expression(f"(x-5)^2 + {a:.3f}*(y-5)^2 + {b:.3f}*(z-4.6)^2 - 9 + 2*sin(x)*cos(y)")
    if kind == "samples":
        spacing, origin = 0.5, -1.0
        x, y, z = np.meshgrid(*[origin + spacing * np.arange(25)] * 3, indexing="ij")
        a, b = rng.uniform(0.6, 1.2, 2)
        distance = np.sqrt((x - middle[0]) ** 2 + a * (y - middle[1]) ** 2 + b * (z - middle[2]) ** 2)
        return kind, fields.sampled(distance - 3 + 0.3 * np.sin(x), spacing, (origin,) * 3)
    name, period = str(rng.choice(["gyroid", "schwarz_p", "diamond"])), float(rng.choice([8.0, 10.0, 13.0]))
    surface = fields.tpms(name, period)
    if kind == "sheet":
        return f"{name} sheet", fields.sheet(surface, -0.3, rng.uniform(-0.05, 0.4))
    return f"{name} rod", fields.rod(surface, rng.uniform(-0.6, 0.3))


def draw_tree(rng: np.random.Generator, quadrics: bool) -> tuple[str, fields.Field]:
    """A random tree and its formula."""
    name, field = draw_leaf(rng, quadrics)
    for _ in range(int(rng.integers(1, 5))):
        other_name, other = draw_leaf(rng, quadrics)
        sign = str(rng.choice(["|", "&", "-"]))
        field = {"|": field | other, "&": field & other, "-": field & ~other}[sign]
        name = f"({name} {sign} {other_name})"
    if rng.random() < 0.2:
        name, field = f"~{name}", ~field
    return name, field


def judge(field: fields.Field, model: tpmscad.Model) -> tuple[float, str]:
    """How many standard errors the volume is from a stratified sample's, and why no valid file is written, if none is."""
    grid = np.stack(np.meshgrid(*(np.arange(CELLS),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(3)
    inside = np.concatenate(
        [field((part + rng.random(part.shape)) * (SIZE / CELLS)) < 0 for part in np.array_split(grid, 16)]
    )
    cell = (SIZE / CELLS) ** 3
    crossed = 1.5 * model.area / cell ** (2 / 3) + 8  # only cells that the surface passes vary
    error = 0.5 * np.sqrt(crossed) * cell + model.certificate.rms_deviation * model.area / STANDARD_ERRORS
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.step"
        try:
            model.export_step(path)
            unwritten = "" if tpmscad.check_step(path).ok else ", file not valid"
        except tpmscad.KernelError as failure:
            unwritten = f", not written: {failure}"
    return float((model.volume - inside.sum() * cell) / error), unwritten


def compare_creases(figures: Mapping[str, float]) -> str:
    """The curves of the creases within the box, on the solid and by the field; LOST or MORE if their numbers differ."""
    if "creases of the field" not in figures:
        return ""
    own, expected = figures["creases within the box"], figures["creases of the field"]
    lengths = figures["length of the creases within the box"], figures["length of the field's creases"]
    word = "" if own == expected else "LOST " if own < expected else "MORE "
    return f"{word}{own:g} curves of {lengths[0]:.5g} for {expected:g} of {lengths[1]:.5g}, "


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--only", type=int)
    parser.add_argument("--first", type=int, default=0, help="number of the first tree")
    parser.add_argument("--quadrics", action="store_true")
    options = parser.parse_args(arguments)
    counts: dict[str, int] = {}
    for case in range(options.first, options.first + options.count) if options.only is None else [options.only]:
        rng = np.random.default_rng([options.seed, case])
        name, field = draw_tree(rng, options.quadrics)
        tol = TOLS[case % len(TOLS)]
        begun, words = time.process_time(), ""
        try:
            model = tpmscad.solidify(field, ((0, 0, 0), (SIZE,) * 3), tol=tol, loose="keep", progress=False)
        except tpmscad.TpmscadError as error:
            outcome, words = "refused", str(error)
        else:
            seconds = time.process_time() - begun
            off, unwritten = judge(field, model)
            outcome = "met" if model.certificate.met else "not met"
            if outcome == "met" and not abs(off) <= STANDARD_ERRORS:
                outcome = "WRONG"
            elif unwritten:
                outcome = "no file"
            figures = model.certificate.figures
            words = (
                f"{model.certificate.n_faces} faces, volume {model.volume:.6g} ({off:+.1f}), Betti {model.certificate.betti}, "
                f"{figures.get('creases', 0):g} creases, wedge {figures.get('least wedge in degrees', 180):.1f}, "
                f"{compare_creases(figures)}{seconds:.1f} s"
                f"{unwritten} {'; '.join(model.certificate.shortfalls)}"
            )
        counts[outcome] = counts.get(outcome, 0) + 1
        print(f"{case:>3} {tol:5g} {outcome:>8}  {name}: {words}", flush=True)
    print(counts)


if __name__ == "__main__":
    main()
