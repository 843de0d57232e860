"""Graded solids: a wall, a cell size and a volume fraction that change from place to place, with what was measured on each.

python -m benchmarks.graded [wall | sizes | cylinder] ...

Fractions are those of the made solid: along x in slices of the box, or in shells about the cylinder's axis, by vertical lines
through triangles of its faces, beside what was asked for (the mean of the fraction field, or of a wall's own field, there).
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import tpmscad
from tpmscad import fields
from tpmscad.kernel.render.tessellation import tessellate

SPACING = 0.1
"""Of the vertical lines, mm."""


def wall() -> None:
    """A gyroid wall from 0.3 to 1.2 mm over four cells; 0.961 is one over the mean of 1 / slope on the mid surface, per mm."""
    phi = fields.tpms("gyroid", period=10.0)
    level = fields.ramp("x", (0, 40), (0.15 * 0.961, 0.6 * 0.961))
    made = row("wall 0.3 to 1.2 mm", fields.sheet(phi, -level, level), ((0, 0, 0), (40, 10, 10)), 0.01)
    x = np.linspace(0, 40, 5)
    # volume = area x thickness, the sheet's area is 3.0919 cells^2 a cell
    wanted = [3.0919 * 100 * np.mean(2 * level(_on_x(a, b)) / 0.961) / 1000 for a, b in zip(x[:-1], x[1:], strict=True)]
    report("slices along x", shares(made, (0, 40), (0, 10), lambda p: p[:, 0], x), wanted)


def sizes() -> None:
    """Gyroid cells from 5 mm to twice that along x."""
    cells = {"x": ((0, 30), (5, 10)), "y": ((0, 1), (5, 5)), "z": ((0, 1), (5, 5))}
    phi = fields.cell_sizes(fields.tpms("gyroid", period=1.0), **cells)
    box, x = ((0, 0, 0), (30, 10, 10)), np.linspace(0, 30, 4)
    fraction = fields.volume_fraction(fields.rod(fields.tpms("gyroid", period=1.0), -0.3))
    for kind, field in (("rod", fields.rod(phi, -0.3)), ("sheet", fields.sheet(phi, -0.3, 0.3))):
        made = row(f"cells of 5 to 10 mm, {kind}", field, box, 0.005)
        if kind == "rod":
            report("slices along x", shares(made, (0, 30), (0, 10), lambda p: p[:, 0], x), [fraction] * 3)


def cylinder() -> None:
    """Rods in a cylinder of 20 x 10 mm, cells of 5 mm; volume fraction 0.2 on the axis, 0.5 on the outside."""
    import build123d as bd

    phi = fields.tpms("gyroid", period=5.0)
    distance = fields.cylinder((0, 0, 0), 1e-9)
    fraction = fields.ramp(distance, (0, 10), (0.2, 0.5))
    field = fields.rod(phi, fields.graded_threshold(phi, fraction, (0.2, 0.5)))
    made = row("cylinder, fraction 0.2 to 0.5", field, bd.Cylinder(10, 10), 0.01)
    radii = np.array([0.0, 4.0, 6.0, 8.0, 10.0])
    found = shares(made, (-10, 10), (-10, 10), lambda p: np.hypot(p[:, 0], p[:, 1]), radii)
    wanted = []
    for low, high in zip(radii[:-1], radii[1:], strict=True):
        r = np.linspace(low, high, 401)
        wanted.append(np.trapezoid(fraction(np.column_stack([r, 0 * r, 0 * r])) * r, r) / np.trapezoid(r, r))
    report("shells about the axis", found, wanted)


def _on_x(low: float, high: float) -> np.ndarray:
    x = np.linspace(low, high, 201)
    return np.column_stack([x, 0 * x, 0 * x])


def row(name: str, field: fields.Field, domain: Any, tol: float) -> tpmscad.Model:
    """Print a line and return the model."""
    begun = _seconds()
    model = tpmscad.solidify(field, domain, tol=tol)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "solid.step"
        model.export_step(path)
        size = path.stat().st_size / 1e6
    c = model.certificate
    volume = c.figures.get("volume of the field")
    off = f"{c.volume / volume - 1:+.1e}" if volume else "-"
    print(
        f"{name:32s} {'met' if c.met else 'NOT met'} valid {c.valid} faces {c.n_faces} deviation {c.max_deviation:.1e} "
        f"jump {c.tangent_jump_deg:.2f} betti {c.betti} volume {c.volume:.2f} off {off} cpu {_seconds() - begun:.1f} s "
        f"STEP {size:.1f} MB {'; '.join(c.shortfalls)}",
        flush=True,
    )
    return model


def shares(model: Any, x: tuple[float, float], y: tuple[float, float], of: Any, bounds: np.ndarray) -> np.ndarray:
    """The solid's volume fraction where `of`, a function of points (n, 2) across z, lies between bounds: (len(bounds) - 1,).

    Lines stand on a grid of SPACING; on each, upper ends of pieces of the solid less lower ends are its length.
    """
    found = tessellate(model.built.shape, 0.02)
    corner = found.points[found.triangles]
    height = float(np.ptp(found.points[:, 2]))
    start = np.array([x[0], y[0]]) + 0.5 * SPACING
    counts = np.rint((np.array([x[1], y[1]]) - np.array([x[0], y[0]])) / SPACING).astype(int)
    first = np.maximum(np.ceil((corner[:, :, :2].min(axis=1) - start) / SPACING), 0).astype(int)
    last = np.minimum(np.floor((corner[:, :, :2].max(axis=1) - start) / SPACING), counts - 1).astype(int)
    size = np.maximum(last - first + 1, 0)
    t = np.repeat(np.arange(len(corner)), size.prod(axis=1))
    within = np.arange(len(t)) - np.repeat(np.cumsum(size.prod(axis=1)) - size.prod(axis=1), size.prod(axis=1))
    node = first[t] + np.column_stack([within // size[t, 1], within % size[t, 1]])
    p = start + SPACING * node
    a, b, c = (corner[t, k] for k in range(3))
    double = _cross(b - a, c - a)
    at = [corner[t, k, :2] - p for k in range(3)]
    weights = np.stack([_cross(at[1], at[2]), _cross(at[2], at[0]), _cross(at[0], at[1])], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights /= double[:, None]
    inside = (weights >= 0).all(axis=1) & (double != 0)
    z = (weights * np.stack([a[:, 2], b[:, 2], c[:, 2]], axis=1)).sum(axis=1)
    length = np.zeros(counts)
    np.add.at(length, tuple(node[inside].T), (np.sign(double) * z)[inside])
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 2)
    group = np.digitize(of(start + SPACING * grid), bounds) - 1
    ok = (group >= 0) & (group < len(bounds) - 1)
    number = len(bounds) - 1
    solid = np.bincount(group[ok], length.ravel()[ok], number)
    return solid / (height * np.bincount(group[ok], minlength=number))


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def report(what: str, found: np.ndarray, wanted: Any) -> None:
    pairs = ", ".join(f"{f:.3f} ({w:.3f})" for f, w in zip(found, wanted, strict=True))
    print(f"    {what}, fraction found (asked for): {pairs}", flush=True)


def _seconds() -> float:
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in used)


if __name__ == "__main__":
    for task in sys.argv[1:] or ["wall", "sizes", "cylinder"]:
        {"wall": wall, "sizes": sizes, "cylinder": cylinder}[task]()
