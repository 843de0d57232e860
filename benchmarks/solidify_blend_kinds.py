"""Thirty blends of other kinds than `random_pairs` draws, as solids: met, refused with a reason, or wrong.

    python -m benchmarks.solidify_blend_kinds [FIRST [LAST]]

The kinds are other units (metres, micrometres, inches), periods of 1 to 1.7, turned structures, three structures, round regions,
walls of four to one, noise, and images. Boxes have 2 x 1 x 1 periods, or less, and the tolerance is 5e-3 of the period. A solid
is judged by two counts that share nothing with it: Betti numbers by marching cubes of the field (`benchmarks.betti_numbers`) on
two grids, and a third where these disagree with it, and the volume by random points. "met" agrees with both; WRONG is met by its
certificate and disagrees with one.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np

from benchmarks.betti_numbers import count_by_marching_cubes
from benchmarks.solidify_figures import cpu
from tpmscad import fields
from tpmscad._typing import BoxCorners
from tpmscad.blending import CylinderRadius, LineWeightSpec, SphereRadius, blend
from tpmscad.blending.initial_weights import WeightSpec
from tpmscad.errors import TpmscadError
from tpmscad.solids._solidify import solidify

TOL = 5e-3
LINES = 149, 223
FINE_LINES = 401
N_RANDOM_POINTS = 400_000
MAX_VOLUME_ERROR = 4.0
"""Greatest difference of the volumes in standard deviations of the random count, beyond the deviation times the area."""

KINDS = "units", "periods 1:1.7", "turned", "three structures", "round regions", "walls 4:1", "noise", "images"
COUNTS = 4, 4, 4, 3, 4, 3, 4, 4
INCH = 25.4


@dataclass(frozen=True)
class Blend:
    """The arguments of a blend, the box of its solid, and the period that scales the tolerance."""

    name: str
    structures: tuple[fields.Field, ...]
    regions: tuple[fields.Field, ...]
    blending: tuple[fields.Field, ...]
    box: BoxCorners
    period: float = 1.0
    weight: WeightSpec = "auto"


def structure(
    rng: np.random.Generator, period: float = 1.0, surface: str = "", kind: str = ""
) -> tuple[str, fields.Field]:
    """A rod, pore or sheet with a quarter to a half of solid."""
    surface = surface or str(rng.choice(["gyroid", "schwarz_p", "diamond", "iwp", "neovius"]))
    kind = kind or str(rng.choice(["rod", "pore", "sheet"]))
    fraction = rng.uniform(0.25, 0.5)
    values = fields.tpms(surface, period=1.0)(rng.uniform(0, 1, (8000, 3)))
    parts = {"rod": [fraction], "pore": [1 - fraction], "sheet": [0.5 - fraction / 2, 0.5 + fraction / 2]}[kind]
    levels = np.quantile(values, parts).tolist()
    made = getattr(fields, kind)(fields.tpms(surface, period=period), *levels)
    return f"{kind} {surface} {np.round(levels, 2).tolist()}", made


def along_x(*limits: float, unit: float = 1.0) -> tuple[fields.Field, ...]:
    """Slabs of a box of one unit in y and z between successive values of x, in units."""
    return tuple(fields.box((a * unit, 0, 0), (b * unit, unit, unit)) for a, b in zip(limits, limits[1:], strict=False))


def halves(name: str, structures: tuple[fields.Field, ...], unit: float = 1.0, weight: WeightSpec = "auto") -> Blend:
    """Two structures that meet at x = 1.5, blended from 1 to 2."""
    box = (0.5 * unit, 0, 0), (2.5 * unit, unit, unit)
    return Blend(name, structures, along_x(0, 1.5, 3, unit=unit), along_x(1, 2, unit=unit), box, unit, weight)


def noise(rng: np.random.Generator, samples: int = 10) -> fields.Field:
    """Smooth noise through random samples on a grid of the whole box, 40 % solid."""
    values = rng.normal(size=(3 * samples, samples, samples))
    made = fields.sampled(values, spacing=1.0 / (samples - 1) * 1.05, origin=(-0.05, -0.02, -0.02), level=None)
    return fields.rod(made, float(np.quantile(values, 0.4)))


def make_blend(index: int) -> Blend:
    """The blend of an index, with random structures of its kind."""
    number, place = index, 0
    while number >= COUNTS[place]:
        number, place = number - COUNTS[place], place + 1
    kind, rng = KINDS[place], np.random.default_rng(7000 + index)
    (one, f), (two, g) = structure(rng), structure(rng)
    name = f"{kind}: {one} + {two}"
    if kind == "units":
        unit = (1e-3, 500.0, INCH, 1e-6)[number]
        (one, f), (two, g) = structure(rng, unit), structure(rng, unit)
        return halves(f"{kind} {unit:g}: {one} + {two}", (f, g), unit)
    if kind == "periods 1:1.7":
        two, g = structure(rng, 1.7)
        return halves(f"{kind}: {one} + {two}", (f, g) if number % 2 else (g, f))
    if kind == "turned":
        axis, degrees = rng.normal(size=3), float(rng.uniform(10, 80))
        return halves(
            f"{name} by {degrees:.0f} degrees", (f, fields.rotate(g, tuple(axis.tolist()), degrees, (1, 0, 0)))
        )
    if kind == "three structures":
        three, h = structure(rng)
        blending = (*along_x(0.7, 1.3), *along_x(1.7, 2.3))
        return Blend(f"{name} + {three}", (f, g, h), along_x(0, 1, 2, 3), blending, ((0.5, 0, 0), (2.5, 1, 1)))
    if kind == "round regions":
        domain = fields.box((0, 0, 0), (2, 2, 1))
        make = fields.cylinder if number % 2 else fields.sphere
        core, inner, outer = (make((0, 0, 0), radius) for radius in (1.0, 0.7, 1.3))
        weight = LineWeightSpec(CylinderRadius() if number % 2 else SphereRadius(), count=30)
        regions = core & domain, domain & ~core
        return Blend(name, (f, g), regions, (outer & ~inner & domain,), ((0, 0, 0), (1.6, 1, 1)), 1.0, weight)
    if kind == "walls 4:1":
        surface = ("gyroid", "schwarz_p", "diamond")[number]
        thick, thin = (fields.wall(fields.tpms(surface, period=1.0), t) for t in (0.28, 0.07))
        return halves(f"{kind}: {surface}", (thick, thin))
    if kind == "noise":
        if number < 2:
            return halves(f"{kind} of samples + {two}", (noise(rng, (7, 9)[number]), g))
        unit = fields.bspline_unit(rng.normal(size=(4, 4, 4)), period=1.0)
        level = float(np.quantile(unit(rng.uniform(0, 1, (4000, 3))), 0.4))
        return halves(f"{kind}, periodic + {two}", (fields.rod(unit, level), g))
    y, x = np.mgrid[0:64, 0:64] / 64
    disc = (x - 0.5) ** 2 + (y - 0.5) ** 2 < (0.28, 0.25, 0.3, 0.22)[number] ** 2
    second = disc if number % 2 else (abs(x - 0.5) < 0.24) & (abs(y - 0.5) < 0.3)
    from scipy.ndimage import distance_transform_edt

    near = np.where(second, distance_transform_edt(second), distance_transform_edt(~second)) <= 9
    domain, flat = fields.box((0, 0, 0), (2, 2, 1)), ((0, 0), (2, 2))
    inside, band = fields.image_region(second.T, *flat), fields.image_region(near.T, *flat)
    return Blend(name, (f, g), (domain & ~inside, domain & inside), (band,), ((0, 0, 0), (1.2, 1.2, 1)), 1.0, "volume")


def judge(case: Blend) -> tuple[str, str]:
    """The verdict on a blend's solid, and its figures."""
    found = blend(case.structures, case.regions, case.blending, weight=case.weight, subgrid_check=True)
    if not found.converged:
        return "REFUSED", f"by the blend: {found.message}"
    lo, hi = np.array(case.box, float)
    begun = cpu()
    try:
        model = solidify(found.field, case.box, tol=TOL * case.period, loose="keep")
    except TpmscadError as error:
        return "REFUSED", f"cpu {cpu() - begun:.1f} s: {error}"
    taken, c = cpu() - begun, model.certificate
    counted = {count_by_marching_cubes(found.field, lo, hi, lines) for lines in LINES}
    if c.betti not in counted:  # marching cubes tear fragments of less than a voxel off sharp edges
        counted.add(count_by_marching_cubes(found.field, lo, hi, FINE_LINES))
    points = np.random.default_rng(3).uniform(lo, hi, (N_RANDOM_POINTS, 3))
    share = float(np.count_nonzero(found.field(points) < 0)) / N_RANDOM_POINTS
    box_volume = float(np.prod(hi - lo))
    spread = np.sqrt(share * (1 - share) / N_RANDOM_POINTS)
    off = c.volume / box_volume - share
    allowed = MAX_VOLUME_ERROR * spread + c.max_deviation * model.certificate.area / box_volume
    right = c.betti in counted and abs(off) <= allowed
    verdict = "NOT MET" if not c.met else "met" if right else "WRONG"
    return verdict, (
        f"faces {c.n_faces} deviation {c.max_deviation / case.period:.1e} jump {c.tangent_jump_deg:.1e} betti {c.betti} "
        f"counted {' or '.join(map(str, sorted(counted)))} volume {c.volume / box_volume:.4f} random {share:.4f} "
        f"({off / spread:+.1f} sigma) cpu {taken:.1f} s {'; '.join((*c.shortfalls, *c.notes))}"
    )


def main(first: int, last: int) -> None:
    """Print a line a blend, and the totals."""
    totals: Counter[str] = Counter()
    for index in range(first, last):
        case = make_blend(index)
        verdict, text = judge(case)
        totals[verdict] += 1
        print(f"{index:2d} {case.name}: {verdict} {text}", flush=True)
    print(", ".join(f"{totals[verdict]} {verdict}" for verdict in ("met", "REFUSED", "NOT MET", "WRONG")))


if __name__ == "__main__":
    given = sys.argv[1:]
    main(int(given[0]) if given else 0, int(given[1]) if len(given) > 1 else sum(COUNTS))
